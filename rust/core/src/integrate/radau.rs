//! Radau IIA of order 5 (Hairer and Wanner, *Solving Ordinary Differential Equations II*, 2nd edition, section IV.8): a
//! step of the stiff, with exact derivatives, and its error.

#![allow(clippy::needless_range_loop)] // the notation of matrices: one index into several arrays

use nalgebra::{DMatrix, DVector, Dyn, LU};

use super::field::Field;

const S6: f64 = 2.449_489_742_783_178;
const C: [f64; 3] = [(4.0 - S6) / 10.0, (4.0 + S6) / 10.0, 1.0];
const A: [[f64; 3]; 3] = [
    [(88.0 - 7.0 * S6) / 360.0, (296.0 - 169.0 * S6) / 1800.0, (-2.0 + 3.0 * S6) / 225.0],
    [(296.0 + 169.0 * S6) / 1800.0, (88.0 + 7.0 * S6) / 360.0, (-2.0 - 3.0 * S6) / 225.0],
    [(16.0 - S6) / 36.0, (16.0 + S6) / 36.0, 1.0 / 9.0],
];
/// Error estimate: weights of the stages, and the real eigenvalue of A⁻¹, 3 + ∛9 − ∛3.
const E: [f64; 3] = [(-13.0 - 7.0 * S6) / 3.0, (-13.0 + 7.0 * S6) / 3.0, -1.0 / 3.0];
const REAL: f64 = 3.637_834_252_744_496;
/// Most iterations of Newton's method for the stages, and the part of the allowed error that they may leave.
const ITERATIONS: usize = 10;
const LEFT: f64 = 1e-3;

/// A step and what it needs.
#[derive(Debug)]
pub(crate) struct Radau {
    jacobian: Vec<f64>,
    /// Stages less the state, 3 n of them, and their slopes.
    z: DVector<f64>,
    f: Vec<f64>,
    stage: Vec<f64>,
    /// The state at the end of the last step.
    pub next: Vec<f64>,
}

impl Radau {
    pub fn new(n: usize) -> Radau {
        Radau {
            jacobian: vec![0.0; n * n],
            z: DVector::zeros(3 * n),
            f: vec![0.0; 3 * n],
            stage: vec![0.0; n],
            next: vec![0.0; n],
        }
    }

    /// A step of length h from (t, x), where the slope is `slope`. The error in units of what is allowed; nothing where
    /// something is not finite, or the stages cannot be found.
    pub fn step(
        &mut self,
        field: &mut Field<'_>,
        (t, h): (f64, f64),
        (x, slope): (&[f64], &[f64]),
        (relative, absolute): (f64, &[f64]),
    ) -> Option<f64> {
        let n = x.len();
        if !field.jacobian(t, x, &mut self.jacobian) {
            return None;
        }
        let system = DMatrix::from_fn(3 * n, 3 * n, |r, c| {
            let entry = -h * A[r / n][c / n] * self.jacobian[r % n * n + c % n];
            if r == c { 1.0 + entry } else { entry }
        });
        let system = system.lu();
        let size = |i: usize, x: &[f64]| absolute[i] + relative * x[i].abs();
        self.z.fill(0.0);
        let mut before = f64::INFINITY;
        let mut found = false;
        for _ in 0..ITERATIONS {
            for s in 0..3 {
                for i in 0..n {
                    self.stage[i] = x[i] + self.z[s * n + i];
                }
                if !field.slope(t + C[s] * h, &self.stage, &mut self.f[s * n..(s + 1) * n]) {
                    return None;
                }
            }
            let rest = DVector::from_fn(3 * n, |r, _| {
                let sum: f64 = (0..3).map(|s| A[r / n][s] * self.f[s * n + r % n]).sum();
                h * sum - self.z[r]
            });
            let step = system.solve(&rest)?;
            self.z += &step;
            let moved = (0..3 * n).map(|r| (step[r] / size(r % n, x)).powi(2)).sum::<f64>();
            let moved = (moved / (3 * n) as f64).sqrt();
            let rate = moved / before;
            if !moved.is_finite() || rate >= 1.0 && moved > LEFT {
                return None;
            }
            // What is left is that times rate / (1 − rate).
            found = moved == 0.0 || before.is_finite() && moved * rate <= LEFT * (1.0 - rate).max(0.0);
            if found || rate >= 1.0 {
                found = true;
                break;
            }
            before = moved;
        }
        if !found {
            return None;
        }
        for i in 0..n {
            self.next[i] = x[i] + self.z[2 * n + i];
        }
        self.error(field, (t, h), (x, slope), |i, next| {
            absolute[i] + relative * x[i].abs().max(next[i].abs())
        })
    }

    /// (REAL/h − J)⁻¹ (f + Σ E z / h), filtered once more where it is large.
    fn error(
        &mut self,
        field: &mut Field<'_>,
        (t, h): (f64, f64),
        (x, slope): (&[f64], &[f64]),
        size: impl Fn(usize, &[f64]) -> f64,
    ) -> Option<f64> {
        let n = x.len();
        let filter: LU<f64, Dyn, Dyn> = DMatrix::from_fn(n, n, |r, c| {
            let own = if r == c { REAL / h } else { 0.0 };
            own - self.jacobian[r * n + c]
        })
        .lu();
        let ends = DVector::from_fn(n, |i, _| (0..3).map(|s| E[s] * self.z[s * n + i]).sum::<f64>() / h);
        let mut error = filter.solve(&(DVector::from_column_slice(slope) + &ends))?;
        let norm = |e: &DVector<f64>, next: &[f64]| {
            let sum: f64 = (0..n).map(|i| (e[i] / size(i, next)).powi(2)).sum();
            (sum / n as f64).sqrt()
        };
        if norm(&error, &self.next) > 1.0 {
            for i in 0..n {
                self.stage[i] = x[i] + error[i];
            }
            if field.slope(t, &self.stage, &mut self.f[..n]) {
                error = filter.solve(&(DVector::from_column_slice(&self.f[..n]) + ends))?;
            }
        }
        Some(norm(&error, &self.next)).filter(|e| e.is_finite())
    }
}
