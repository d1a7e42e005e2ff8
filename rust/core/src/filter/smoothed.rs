//! The path given all data, and paths with other noises.

use super::innovations::{Innovations, innovations};
use super::path::Path;
use super::{Filter, Lost};
use crate::dense::dot;

/// The states of one record given all data and the parameters.
#[derive(Clone, Debug, Default)]
pub struct Smoothed {
    /// n columns of N.
    pub states: Vec<Vec<f64>>,
    /// Their standard deviations, for parameters known.
    pub deviations: Vec<Vec<f64>>,
    /// Outputs there, n_y columns of N.
    pub outputs: Vec<Vec<f64>>,
    /// Their standard deviations, without that of a measurement's noise, for parameters known.
    pub output_deviations: Vec<Vec<f64>>,
    /// One-step predictions of each sample from those before it.
    pub innovations: Innovations,
    /// Covariance of the initial state, (n, n), for parameters known, and how it follows the model's parameters, (n, p).
    pub first_covariance: Vec<f64>,
    /// Derivatives of the initial state by the model's parameters, (n, p).
    pub first_follows: Vec<f64>,
}

impl Filter {
    /// Number of noises of an interval.
    pub fn noises(&self) -> usize {
        self.m
    }

    /// States and outputs of each record, columns of N, from its first state (rows of n) with noises that are given:
    /// for each record N−1 rows of [`Filter::noises`], in standard deviations.
    ///
    /// # Panics
    /// When lengths are wrong.
    pub fn simulate(&self, theta: &[f64], first: &[f64], noises: &[f64]) -> Vec<[Vec<Vec<f64>>; 2]> {
        let (n, mut rest) = (self.n(), noises);
        assert_eq!(theta.len(), self.n_theta());
        assert_eq!(first.len(), n * self.runs.len());
        let each = self.runs.iter().zip(first.chunks_exact(n)).map(|(run, first)| {
            let (e, after) = rest.split_at((run.samples() - 1) * self.m);
            rest = after;
            let at = self.at(theta, run);
            let x = self.flow.along(&at.driving, &run.intervals, first, e);
            let column = |i: usize| x.iter().skip(i).step_by(n).copied().collect();
            let (outputs, _) = self.samples.outputs(&theta[..self.n_model], &run.data, self.n_data, &x);
            [(0..n).map(column).collect(), outputs]
        });
        let found = each.collect();
        assert!(rest.is_empty(), "more noises than the records have intervals");
        found
    }

    /// The states of a path as they are, and outputs there; what [`Filter::smooth`] would compute beside is NaN.
    ///
    /// # Panics
    /// When lengths are wrong.
    pub fn unsmoothed(&self, theta: &[f64], path: &[f64]) -> Vec<Smoothed> {
        assert_eq!(path.len(), self.path_length());
        let n = self.n();
        let each = self.runs.iter().zip(self.paths(path)).map(|(run, Path { x, .. })| {
            let (outputs, _) = self.samples.outputs(&theta[..self.n_model], &run.data, self.n_data, &x);
            let unknown = |columns: usize| vec![vec![f64::NAN; run.samples()]; columns];
            let column = |i: usize| x.iter().skip(i).step_by(n).copied().collect();
            Smoothed {
                states: (0..n).map(column).collect(),
                deviations: unknown(n),
                output_deviations: unknown(outputs.len()),
                innovations: Innovations {
                    values: unknown(outputs.len()),
                    deviations: unknown(outputs.len()),
                    states: unknown(n),
                    state_deviations: unknown(n),
                },
                outputs,
                first_covariance: vec![f64::NAN; n * n],
                first_follows: vec![f64::NAN; n * self.n_model],
            }
        });
        each.collect()
    }

    /// States, outputs and innovations of each record at given parameters.
    ///
    /// # Errors
    /// As [`Filter::evaluate`].
    pub fn smooth(&self, theta: &[f64], path: &[f64]) -> Result<Vec<Smoothed>, Lost> {
        let n = self.n();
        let mut out = Vec::new();
        for (run, start) in self.runs.iter().zip(self.paths(path)) {
            let at = self.at(theta, run);
            let found = at.path(start)?;
            let x = &found.path.x;
            let w = found.chain.covariances(&found.factor)?;
            let column = |i: usize| x.iter().skip(i).step_by(n).copied().collect();
            let deviation = |i: usize| w.iter().skip(i * n + i).step_by(n * n).map(|v| v.sqrt()).collect();
            let (outputs, slopes) =
                self.samples.outputs(&at.theta[..self.n_model], &run.data, self.n_data, x);
            let n_y = outputs.len();
            let output_deviation = |c: usize| {
                let each = slopes.chunks_exact(n_y * n).zip(w.chunks_exact(n * n));
                each.map(|(slopes, w)| quadratic(w, &slopes[c * n..(c + 1) * n]).max(0.0).sqrt()).collect()
            };
            out.push(Smoothed {
                states: (0..n).map(column).collect(),
                deviations: (0..n).map(deviation).collect(),
                output_deviations: (0..n_y).map(output_deviation).collect(),
                outputs,
                innovations: innovations(&at, &found)?,
                first_covariance: w[..n * n].to_vec(),
                first_follows: self.border(&at, &found)?.1,
            });
        }
        Ok(out)
    }
}

/// vᵀ W v.
fn quadratic(w: &[f64], v: &[f64]) -> f64 {
    w.chunks_exact(v.len()).zip(v).map(|(row, own)| own * dot(row, v)).sum()
}
