//! Jointly Gaussian noise with a full covariance matrix R.
//!
//! It is parametrised by the root W of the inverse, R⁻¹ = WᵀW, upper triangular with a positive diagonal:
//! e = W r, ℓ_e = Σ ln w_ii − ½|e|², which is concave in W for every residual r, as for one output it is in
//! 1/σ. Row i is what is left of output i given those after it: 1/w_ii is the standard deviation of that.

mod marginal;
mod profile;

use nalgebra::DMatrix;

use super::{Reported, SIGMA, Sigma};
use crate::error::Error;
use crate::parameter::Parameter;

/// The covariance matrix R of the noise, n_y × n_y.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariance {
    /// Standard deviations: given, or with starts and bounds.
    sigmas: Vec<Sigma>,
    /// Correlations: given, or where they start.
    correlation: DMatrix<f64>,
    known: bool,
    /// Output of each row of W.
    order: Vec<usize>,
}

/// A correlation matrix may differ from a symmetric one with unit diagonal by so much.
const ROUNDING: f64 = 1e-9;

impl Covariance {
    /// A known one, row by row.
    ///
    /// # Errors
    /// When its diagonal is not positive, or it is not square.
    pub fn known(n: usize, matrix: &[f64]) -> Result<Covariance, Error> {
        if matrix.len() != n * n {
            let have = matrix.len();
            return Err(Error::option(format!(
                "noise: a covariance of {n} outputs has {n}² entries, not {have}"
            )));
        }
        let r = DMatrix::from_row_slice(n, n, matrix);
        let deviations = r.diagonal().map(f64::sqrt);
        if let Some(i) = deviations.iter().position(|s| !(*s > 0.0 && s.is_finite())) {
            let bad = r[(i, i)];
            return Err(Error::option(format!(
                "noise: the variance {bad} of output number {} is not positive",
                i + 1
            )));
        }
        let correlation = DMatrix::from_fn(n, n, |i, j| r[(i, j)] / (deviations[i] * deviations[j]));
        let sigmas = deviations.iter().map(|&s| Sigma::Known(s)).collect();
        Ok(Covariance { sigmas, correlation, known: true, order: (0..n).collect() })
    }

    /// The matrix, in the order of the outputs, where it is known.
    pub fn matrix(&self) -> Option<DMatrix<f64>> {
        let sigma = |c: usize| match self.sigmas[c] {
            Sigma::Known(value) => value,
            _ => f64::NAN,
        };
        let n = self.sigmas.len();
        self.known.then(|| DMatrix::from_fn(n, n, |a, b| sigma(a) * self.correlation[(a, b)] * sigma(b)))
    }

    /// An unknown one: standard deviations with starts and bounds, correlations at 0 to start with. Bounds are
    /// those of a standard deviation given other outputs: what is left when their noise has said what it can.
    pub fn unknown(sigmas: Vec<Sigma>) -> Covariance {
        let n = sigmas.len();
        Covariance { sigmas, correlation: DMatrix::identity(n, n), known: false, order: (0..n).collect() }
    }

    /// Returns the covariance with correlations that start elsewhere, row by row.
    ///
    /// # Panics
    /// When it has not as many entries as outputs squared.
    pub fn starting_at(mut self, correlation: &[f64]) -> Covariance {
        let n = self.sigmas.len();
        self.correlation = DMatrix::from_row_slice(n, n, correlation);
        self
    }

    fn n(&self) -> usize {
        self.sigmas.len()
    }

    pub(super) fn check(&self, outputs: &[&str]) -> Result<(), Error> {
        let fail = |text: String| Err(Error::option(format!("noise: {text}")));
        if self.n() != outputs.len() {
            return fail(format!("a covariance of {} outputs for {}", self.n(), outputs.len()));
        }
        outputs.iter().zip(&self.sigmas).try_for_each(|(name, sigma)| sigma.check(name))?;
        if let Some(c) = self.sigmas.iter().position(|s| matches!(s, Sigma::Expression(_))) {
            return fail(format!(
                "sigma_{} is an expression; in a covariance all standard deviations are numbers",
                outputs[c]
            ));
        }
        if let Some(c) = self.sigmas.iter().position(|s| s.is_unknown() == self.known) {
            return fail(format!(
                "sigma_{} is {}; in a covariance all standard deviations are known, or none",
                outputs[c],
                if self.known { "unknown" } else { "known" }
            ));
        }
        let what = if self.known { "covariance" } else { "covariance to start from" };
        let c = &self.correlation;
        for i in 0..self.n() {
            for j in 0..=i {
                let expected = if i == j { 1.0 } else { c[(j, i)] };
                let difference = (c[(i, j)] - expected).abs();
                if difference.is_nan() || difference > ROUNDING {
                    return fail(format!(
                        "the {what} is not symmetric in '{}' and '{}'",
                        outputs[i], outputs[j]
                    ));
                }
            }
        }
        match self.correlation.clone().cholesky() {
            Some(_) => Ok(()),
            None => fail(format!(
                "the {what} is not positive definite: correlations contradict each other, or are 1 or -1"
            )),
        }
    }

    /// Rows in the order of the number of measurements, the fewest first.
    pub(super) fn ordered(mut self, measured: &[usize]) -> Covariance {
        self.order.sort_by_key(|&c| (measured[c], c));
        self
    }

    /// Rows and columns of the upper triangle, in the order of the parameters.
    fn places(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let n = self.n();
        (0..n).flat_map(move |i| (i..n).map(move |j| (i, j)))
    }

    pub(super) fn n_parameters(&self) -> usize {
        if self.known { 0 } else { self.n() * (self.n() + 1) / 2 }
    }

    pub(super) fn precision_roots(&self) -> Vec<usize> {
        if self.known {
            return Vec::new();
        }
        (0..).zip(self.places()).filter(|(_, (i, j))| i == j).map(|(k, _)| k).collect()
    }

    /// W as it is known, or where it starts.
    fn start(&self) -> DMatrix<f64> {
        let c = DMatrix::from_fn(self.n(), self.n(), |i, j| self.correlation[(self.order[i], self.order[j])]);
        let inverse = c.cholesky().expect("checked to be positive definite").inverse();
        let mut w = inverse.cholesky().expect("the inverse is as well").l().transpose();
        for (j, &c) in self.order.iter().enumerate() {
            let sigma = match self.sigmas[c] {
                Sigma::Known(value) => value,
                Sigma::Unknown { start, .. } => start,
                Sigma::Expression(_) => unreachable!("checked"),
            };
            w.column_mut(j).scale_mut(1.0 / sigma);
        }
        w
    }

    /// W of given parameters.
    fn root(&self, parameters: &[f64]) -> DMatrix<f64> {
        if self.known {
            return self.start();
        }
        let mut w = DMatrix::zeros(self.n(), self.n());
        for ((i, j), value) in self.places().zip(parameters) {
            w[(i, j)] = *value;
        }
        w
    }

    /// The name of what stands at a place: of a standard deviation, or of a correlation.
    fn name(&self, (i, j): (usize, usize), outputs: &[&str]) -> String {
        let (a, b) = (self.order[i].min(self.order[j]), self.order[i].max(self.order[j]));
        if a == b { format!("{SIGMA}{}", outputs[a]) } else { format!("corr_{}_{}", outputs[a], outputs[b]) }
    }

    pub(super) fn parameters(&self, outputs: &[&str]) -> Vec<Parameter> {
        if self.known {
            return Vec::new();
        }
        // A start given the outputs after may lie outside the bounds.
        let w = self.bounded(self.start());
        let one = |(i, j): (usize, usize)| {
            let name = self.name((i, j), outputs);
            let bounds = if i == j { self.sigmas[self.order[i]].parameter(&name) } else { None };
            Parameter { start: w[(i, j)], ..bounds.unwrap_or_else(|| Parameter::new(&name, 0.0)) }
        };
        self.places().map(one).collect()
    }

    pub(super) fn variable_names(&self, outputs: &[&str]) -> Vec<String> {
        if self.known {
            return Vec::new();
        }
        let one = |(i, j): (usize, usize)| {
            let (row, column) = (outputs[self.order[i]], outputs[self.order[j]]);
            if i == j { format!("1/{SIGMA}{row}") } else { format!("weight of {column} in noise of {row}") }
        };
        self.places().map(one).collect()
    }

    /// W⁻¹, a root of R: R = W⁻¹W⁻ᵀ.
    fn inverse(&self, w: &DMatrix<f64>) -> DMatrix<f64> {
        let identity = DMatrix::identity(self.n(), self.n());
        w.solve_upper_triangular(&identity).unwrap_or(identity * f64::NAN)
    }

    pub(super) fn sigmas(&self, parameters: &[f64]) -> Vec<f64> {
        let b = self.inverse(&self.root(parameters));
        let mut sigmas = vec![0.0; self.n()];
        for (i, &c) in self.order.iter().enumerate() {
            sigmas[c] = b.row(i).norm();
        }
        sigmas
    }

    /// Standard deviations in the order of the outputs, then correlations. From R = BBᵀ, B = W⁻¹:
    /// dB = −B dW B, so ∂R_ij/∂w_ab = −(B_ia R_bj + R_ib B_ja).
    pub(super) fn report(&self, outputs: &[&str], values: &[f64]) -> Vec<Reported> {
        if self.known {
            return Vec::new();
        }
        let b = self.inverse(&self.root(values));
        let r = &b * b.transpose();
        let slope =
            |i: usize, j: usize, (p, q): (usize, usize)| -(b[(i, p)] * r[(q, j)] + r[(i, q)] * b[(j, p)]);
        let row = |output: usize| self.order.iter().position(|&c| c == output).expect("each has a row");
        let one = |(i, j): (usize, usize)| {
            let name = self.name((i, j), outputs);
            let (si, sj) = (r[(i, i)].sqrt(), r[(j, j)].sqrt());
            if i == j {
                let gradient = self.places().map(|at| 0.5 * slope(i, i, at) / si).collect();
                let (output, bounds) = (self.order[i], self.sigmas[self.order[i]].bounds());
                let bounded_by = self.places().position(|at| at == (i, i));
                return Reported { name, output: Some(output), value: si, gradient, bounded_by, bounds };
            }
            let value = r[(i, j)] / (si * sj);
            let gradient = |at: (usize, usize)| {
                let own = 0.5 * (slope(i, i, at) / r[(i, i)] + slope(j, j, at) / r[(j, j)]);
                slope(i, j, at) / (si * sj) - value * own
            };
            let gradient = self.places().map(gradient).collect();
            Reported { name, output: None, value, gradient, bounded_by: None, bounds: (-1.0, 1.0) }
        };
        let outputs = 0..self.n();
        let pairs = outputs.clone().flat_map(|a| (a + 1..self.n()).map(move |b| (a, b)));
        outputs.map(|c| (c, c)).chain(pairs).map(|(a, b)| one((row(a), row(b)))).collect()
    }

    /// W with the diagonal within its bounds: a row beyond is multiplied, so that what it says of how
    /// outputs depend on each other stays.
    fn bounded(&self, mut w: DMatrix<f64>) -> DMatrix<f64> {
        for i in 0..self.n() {
            let (lower, upper) = self.sigmas[self.order[i]].bounds();
            let own = w[(i, i)];
            let within = own.clamp(1.0 / upper, if lower > 0.0 { 1.0 / lower } else { f64::INFINITY });
            w.row_mut(i).scale_mut(within / own);
            w[(i, i)] = within;
        }
        w
    }
}
