//! Innovations: measured outputs minus their predictions from all samples before, with their covariance.

use super::gauss_newton::{Fault, GaussNewton};
use crate::dense::{cholesky, forward, rounding};

/// The innovations of a sample, of the outputs that are there, in standard deviations of the measurement noise.
#[derive(Clone, Debug)]
pub(super) struct Innovation {
    /// Innovations.
    pub(super) values: Vec<f64>,
    /// Their variances.
    pub(super) variances: Vec<f64>,
    /// Innovations times the inverse Cholesky factor of their covariance: independent, of unit variance.
    pub(super) normalised: Vec<f64>,
    /// For each output its part of the innovations that the other outputs do not explain, of unit variance: (S⁻¹ e)_c / (S⁻¹)_cc^½.
    /// Where a sensor fails, its own is the largest.
    pub(super) own: Vec<f64>,
    /// The factor, of (n_y, n_y).
    factor: Vec<f64>,
    /// R⁻ᵀ Hᵀ, n_y rows of m, and the step that the information before the sample has left.
    spread: Vec<f64>,
    step: Vec<f64>,
    unit: Vec<f64>,
    flops: u64,
}

impl Innovation {
    pub(super) fn new(n_y: usize, m: usize) -> Innovation {
        Innovation {
            values: Vec::with_capacity(n_y),
            variances: Vec::with_capacity(n_y),
            normalised: Vec::with_capacity(n_y),
            own: Vec::with_capacity(n_y),
            unit: vec![0.0; n_y],
            factor: vec![0.0; n_y * n_y],
            spread: vec![0.0; n_y * m],
            step: vec![0.0; m],
            flops: 0,
        }
    }

    pub(super) fn flops(&self) -> u64 {
        self.flops
    }

    /// Operations of an update, at most.
    pub(super) fn bound(&self) -> u64 {
        let m = self.step.len();
        let n_y = self.spread.len() / m;
        (m * m + m + n_y * (m * m + 2 * m) + n_y * n_y * (2 * m + 2 * n_y + 6)) as u64
    }

    /// Computes them after a pass forward, from the information on the last node without its outputs. Whether they are finite.
    pub(super) fn update(&mut self, solver: &mut GaussNewton) -> bool {
        let (m, w, count) = (self.step.len(), self.step.len() + 1, solver.present.len());
        let Innovation { values, variances, normalised, own, factor, spread, step, unit, .. } = self;
        values.clear();
        variances.clear();
        normalised.clear();
        solver.predicted.solve(0, m, step);
        for (row, spread) in solver.last_rows.chunks_exact(w).zip(spread.chunks_exact_mut(m)).take(count) {
            let moved: f64 = row.iter().zip(step.iter()).map(|(h, d)| h * d).sum();
            values.push(row[m] - moved);
            spread.copy_from_slice(&row[..m]);
            solver.predicted.solve_transposed(spread);
        }
        for i in 0..count {
            for j in 0..count {
                let (a, b) = (&spread[i * m..(i + 1) * m], &spread[j * m..(j + 1) * m]);
                let noise = f64::from(u8::from(i == j));
                factor[i * count + j] = noise + a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            }
        }
        variances.extend((0..count).map(|i| factor[i * count + i]));
        normalised.extend(values.iter());
        self.flops += (count * (2 * m + count * (2 * m + 2 * count + 6))) as u64;
        let whole = &mut factor[..count * count];
        if count > 0 && cholesky(whole, count, rounding).is_err() {
            return false;
        }
        forward(whole, count, normalised);
        own.clear();
        for c in 0..count {
            let unit = &mut unit[..count];
            unit.fill(0.0);
            unit[c] = 1.0;
            forward(whole, count, unit);
            let along: f64 = unit.iter().zip(normalised.iter()).map(|(a, b)| a * b).sum();
            own.push(along / unit.iter().map(|v| v * v).sum::<f64>().sqrt());
        }
        normalised.iter().all(|v| v.is_finite())
    }

    /// The output that is not finite, of those of these numbers.
    pub(super) fn fault(&self, present: &[usize]) -> Fault {
        let at = self.normalised.iter().position(|v| !v.is_finite()).unwrap_or(0);
        Fault::Output(present.get(at).copied().unwrap_or(0))
    }

    /// Multiplies a change of the outputs, in standard deviations of their noise, by the inverse Cholesky factor.
    pub(super) fn normalise(&self, change: &mut [f64]) {
        let count = self.values.len();
        forward(&self.factor[..count * count], count, change);
    }
}
