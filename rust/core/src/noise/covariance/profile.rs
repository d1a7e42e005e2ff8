//! The covariance that residuals ask for.

use nalgebra::{DMatrix, SymmetricEigen};

use super::Covariance;
use crate::nlp::Reach;
use crate::noise::Counts;

/// Standard deviations have all but settled when they change by less than this part.
const SETTLED: f64 = 0.1;

impl Covariance {
    /// Profiles as [`Noise::profile`](crate::noise::Noise::profile): R is the mean square of the residuals of the
    /// samples.
    ///
    /// The gradient, W S − n diag(1/w_ii) above the diagonal, gives S = Σ rrᵀ. Where a part of a sample is
    /// missing it gives, by Fisher's identity, what S is expected to be. What is within reach is measured in
    /// units of the noise: by the eigenvalues of W S Wᵀ/n for the W that the reach is counted from.
    ///
    /// Correlations that are 0 stay so until standard deviations have all but settled: those of residuals far from
    /// the optimum lead to other optima, where some combination of outputs is matched too well.
    pub(in crate::noise) fn profile(
        &self,
        counts: &Counts,
        at: &[f64],
        gradient: &[f64],
        reach: &Reach<'_>,
        out: &mut [f64],
    ) -> f64 {
        if self.known {
            return 0.0;
        }
        let (w, g) = (self.root(at), self.root(gradient));
        if is_diagonal(&w) {
            let next = self.bounded(self.diagonal_profile(counts, &w, &g, reach));
            let change = next.diagonal().zip_map(&w.diagonal(), |a, b| (a / b - 1.0).abs()).max();
            let free = matches!(reach, Reach::Free { .. });
            if free || change > SETTLED {
                self.write(&next, out);
                return change;
            }
        }
        let s = squares(&w, &g, counts.samples as f64) / counts.samples as f64;
        let from = match *reach {
            Reach::Step { .. } => w.clone(),
            Reach::Free { start, .. } => self.root(start),
        };
        let seen = &from * s * from.transpose();
        if !seen.iter().all(|x| x.is_finite()) {
            out.copy_from_slice(at);
            return f64::INFINITY;
        }
        let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(seen);
        let mut root = eigenvectors.transpose() * from;
        for (mut row, square) in root.row_iter_mut().zip(&eigenvalues) {
            row.scale_mut(within(*square, reach));
        }
        // RᵀR of its QR factors is WᵀW.
        let mut next = root.qr().r();
        for mut row in next.row_iter_mut() {
            let first = row.iter().find(|x| **x != 0.0).copied().unwrap_or(1.0);
            row.scale_mut(first.signum());
        }
        let next = self.bounded(next);
        let change = &next * self.inverse(&w) - DMatrix::identity(self.n(), self.n());
        self.write(&next, out);
        change.amax()
    }

    /// Profiles with correlations 0, each output by its own measurements: the expectation of missing ones, σ² each,
    /// is in the gradient and taken out.
    fn diagonal_profile(
        &self,
        counts: &Counts,
        w: &DMatrix<f64>,
        g: &DMatrix<f64>,
        reach: &Reach<'_>,
    ) -> DMatrix<f64> {
        let from = match *reach {
            Reach::Step { .. } => w.clone(),
            Reach::Free { start, .. } => DMatrix::from_diagonal(&self.root(start).diagonal()),
        };
        let mut next = DMatrix::zeros(self.n(), self.n());
        for (i, &output) in self.order.iter().enumerate() {
            let n = counts.outputs[output] as f64;
            let own = w[(i, i)];
            let square = (g[(i, i)] + n / own) / (own * n);
            next[(i, i)] = from[(i, i)] * within(square * from[(i, i)].powi(2), reach);
        }
        next
    }

    fn write(&self, w: &DMatrix<f64>, out: &mut [f64]) {
        self.places().zip(out).for_each(|((i, j), value)| *value = w[(i, j)]);
    }
}

/// Whether there are no correlations.
fn is_diagonal(w: &DMatrix<f64>) -> bool {
    (0..w.nrows()).all(|i| (i + 1..w.ncols()).all(|j| w[(i, j)] == 0.0))
}

/// S = Σ rrᵀ of n samples from the upper triangle of W S − n diag(1/w_ii), row by row from the last.
fn squares(w: &DMatrix<f64>, gradient: &DMatrix<f64>, n: f64) -> DMatrix<f64> {
    let size = w.nrows();
    let mut s = DMatrix::zeros(size, size);
    for i in (0..size).rev() {
        for j in (i..size).rev() {
            let after: f64 = (i + 1..size).map(|k| w[(i, k)] * s[(k, j)]).sum();
            let own = if i == j { n / w[(i, i)] } else { 0.0 };
            let entry = (gradient[(i, j)] + own - after) / w[(i, i)];
            (s[(i, j)], s[(j, i)]) = (entry, entry);
        }
    }
    s
}

/// The factor of a precision root within reach whose residual has this mean square in units of it.
fn within(square: f64, reach: &Reach<'_>) -> f64 {
    let best = if square > 0.0 { square.sqrt().recip() } else { f64::INFINITY };
    match *reach {
        Reach::Step { up, down } => best.clamp(1.0 / up, down),
        Reach::Free { most, .. } => {
            if best < most {
                best
            } else {
                1.0
            }
        }
    }
}
