//! Radau IIA of order 5 (Hairer and Wanner, *Solving Ordinary Differential Equations II*, 2nd edition, section IV.8): a
//! step of the stiff, with exact derivatives, and its error.

#![allow(clippy::needless_range_loop)] // the notation of matrices: one index into several arrays

use nalgebra::{Complex, DMatrix, DVector, Dyn, LU};

use super::field::Field;

const S6: f64 = 2.449_489_742_783_178;
const C: [f64; 3] = [(4.0 - S6) / 10.0, (4.0 + S6) / 10.0, 1.0];
/// Error estimate: weights of the stages.
const E: [f64; 3] = [(-13.0 - 7.0 * S6) / 3.0, (-13.0 + 7.0 * S6) / 3.0, -1.0 / 3.0];
/// A⁻¹ = T Λ T⁻¹ of the coefficients A of the method, where Λ has the real eigenvalue 3 + ∛9 − ∛3 and a complex pair, of
/// which this is one (Eqs. IV.8.12 to 14).
const REAL: f64 = 3.637_834_252_744_496;
const PAIR: (f64, f64) = (2.681_082_873_627_752, -3.050_430_199_247_410_5);
const T: [[f64; 3]; 3] = [
    [0.094_438_762_488_975_24, -0.141_255_295_020_954_2, 0.030_029_194_105_147_42],
    [0.250_213_122_965_333_3, 0.204_129_352_293_799_94, -0.382_942_112_757_261_9],
    [1.0, 1.0, 0.0],
];
const INVERSE: [[f64; 3]; 3] = [
    [4.178_718_591_551_904, 0.327_682_820_761_062_4, 0.523_376_445_499_449_5],
    [-4.178_718_591_551_904, -0.327_682_820_761_062_4, 0.476_623_554_500_550_44],
    [0.502_872_634_945_786_8, -2.571_926_949_855_605, 0.596_039_204_828_224_9],
];
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
        let (real, pair) = (REAL / h, Complex::new(PAIR.0 / h, PAIR.1 / h));
        let filter = DMatrix::from_fn(n, n, |r, c| {
            let own = if r == c { real } else { 0.0 };
            own - self.jacobian[r * n + c]
        })
        .lu();
        let system = DMatrix::from_fn(n, n, |r, c| {
            let own = if r == c { pair } else { Complex::new(0.0, 0.0) };
            own - self.jacobian[r * n + c]
        })
        .lu();
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
            // In the coordinates w of z = T w, one real system and one complex one (Eq. IV.8.13).
            let rest = |k: usize, i: usize| -> (f64, f64) {
                let sum = |x: &[f64]| (0..3).map(|s| INVERSE[k][s] * x[s * n + i]).sum::<f64>();
                (sum(&self.f), sum(self.z.as_slice()))
            };
            let of_real = DVector::from_fn(n, |i, _| {
                let (f, w) = rest(0, i);
                f - real * w
            });
            let of_pair = DVector::from_fn(n, |i, _| {
                let ((f, w), (g, v)) = (rest(1, i), rest(2, i));
                Complex::new(f, g) - pair * Complex::new(w, v)
            });
            let (of_real, of_pair) = (filter.solve(&of_real)?, system.solve(&of_pair)?);
            let step = DVector::from_fn(3 * n, |r, _| {
                let (s, i) = (r / n, r % n);
                T[s][0] * of_real[i] + T[s][1] * of_pair[i].re + T[s][2] * of_pair[i].im
            });
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
        self.error(field, (t, h), (x, slope), &filter, |i, next| {
            absolute[i] + relative * x[i].abs().max(next[i].abs())
        })
    }

    /// (REAL/h − J)⁻¹ (f + Σ E z / h), filtered once more where it is large.
    fn error(
        &mut self,
        field: &mut Field<'_>,
        (t, h): (f64, f64),
        (x, slope): (&[f64], &[f64]),
        filter: &LU<f64, Dyn, Dyn>,
        size: impl Fn(usize, &[f64]) -> f64,
    ) -> Option<f64> {
        let n = x.len();
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The coefficients of the method.
    const A: [[f64; 3]; 3] = [
        [(88.0 - 7.0 * S6) / 360.0, (296.0 - 169.0 * S6) / 1800.0, (-2.0 + 3.0 * S6) / 225.0],
        [(296.0 + 169.0 * S6) / 1800.0, (88.0 + 7.0 * S6) / 360.0, (-2.0 - 3.0 * S6) / 225.0],
        [(16.0 - S6) / 36.0, (16.0 + S6) / 36.0, 1.0 / 9.0],
    ];

    #[test]
    fn the_coordinates_part_the_stages_into_one_real_and_one_complex_system() {
        let product = |a: &dyn Fn(usize, usize) -> f64,
                       b: &dyn Fn(usize, usize) -> f64,
                       r: usize,
                       c: usize| { (0..3).map(|k| a(r, k) * b(k, c)).sum::<f64>() };
        // w' = Λ w, where (w2 + i w3)' = PAIR (w2 + i w3).
        let (alpha, beta) = PAIR;
        let lambda = [[REAL, 0.0, 0.0], [0.0, alpha, -beta], [0.0, beta, alpha]];
        let (t, l, i) = (|r: usize, c| T[r][c], |r: usize, c| lambda[r][c], |r: usize, c| INVERSE[r][c]);
        let back = |r, c| product(&l, &i, r, c);
        let inverse = |r, c| product(&t, &back, r, c);
        for r in 0..3 {
            for c in 0..3 {
                let one = f64::from(u8::from(r == c));
                assert!((product(&t, &i, r, c) - one).abs() < 1e-14, "T T⁻¹, {r}, {c}");
                assert!(
                    (product(&|r, c| A[r][c], &inverse, r, c) - one).abs() < 1e-13,
                    "A T Λ T⁻¹, {r}, {c}"
                );
            }
        }
    }
}
