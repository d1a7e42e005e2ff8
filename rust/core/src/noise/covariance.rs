//! Jointly Gaussian noise with a full covariance matrix R.
//!
//! It is parametrised by the root W of the inverse, R⁻¹ = WᵀW, upper triangular with a positive diagonal:
//! e = W r, ℓ_e = Σ ln w_ii − ½|e|², which is concave in W for every residual r, as for one output it is in
//! 1/σ. Row i is what is left of output i given those after it: 1/w_ii is the standard deviation of that.
//!
//! Where a part of a sample is missing, its density is the marginal one of the rest. The root of the
//! inverse of a part of R follows from W by plane rotations: an output is moved out by rotating the rows above
//! its own until none but its own depends on it, and that row goes. Outputs are ordered by the number of
//! their measurements, the fewest first: those at the start go without a rotation.

use std::collections::HashSet;

use nalgebra::{DMatrix, SymmetricEigen};

use super::{Counts, Missing, Reported, SIGMA, Sample, Sigma};
use crate::error::Error;
use crate::expr::Op;
use crate::expr::graph::{Graph, Id};
use crate::model::Parameter;
use crate::nlp::Reach;
use crate::tape::Terms;

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

/// Standard deviations have all but settled when they change by less than this part.
const SETTLED: f64 = 0.1;
/// Most second derivatives of roots, as [`Covariance::effort`] estimates them: a tape holds four times as many
/// numbers, and more take minutes.
const MOST_EFFORT: usize = 16_000;
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
            return Err(Error::Option(format!(
                "noise: a covariance of {n} outputs has {n}² entries, not {have}"
            )));
        }
        let r = DMatrix::from_row_slice(n, n, matrix);
        let deviations = r.diagonal().map(f64::sqrt);
        if let Some(i) = deviations.iter().position(|s| !(*s > 0.0 && s.is_finite())) {
            let bad = r[(i, i)];
            return Err(Error::Option(format!(
                "noise: the variance {bad} of output number {} is not positive",
                i + 1
            )));
        }
        let correlation = DMatrix::from_fn(n, n, |i, j| r[(i, j)] / (deviations[i] * deviations[j]));
        let sigmas = deviations.iter().map(|&s| Sigma::Known(s)).collect();
        Ok(Covariance { sigmas, correlation, known: true, order: (0..n).collect() })
    }

    /// An unknown one: standard deviations with starts and bounds, correlations at 0 to start with. Bounds are
    /// those of a standard deviation given other outputs: what is left when their noise has said what it can.
    pub fn unknown(sigmas: Vec<Sigma>) -> Covariance {
        let n = sigmas.len();
        Covariance { sigmas, correlation: DMatrix::identity(n, n), known: false, order: (0..n).collect() }
    }

    /// The same with correlations that start elsewhere, row by row.
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
        let fail = |text: String| Err(Error::Option(format!("noise: {text}")));
        if self.n() != outputs.len() {
            return fail(format!("a covariance of {} outputs for {}", self.n(), outputs.len()));
        }
        outputs.iter().zip(&self.sigmas).try_for_each(|(name, sigma)| sigma.check(name))?;
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
                if !((c[(i, j)] - expected).abs() <= ROUNDING) {
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

    /// Whether the roots of all patterns can be differentiated in good time.
    ///
    /// # Errors
    /// When outputs are missing in too many different combinations.
    pub(super) fn check_missing(&self, missing: &Missing) -> Result<(), Error> {
        if self.known || self.effort(missing) <= MOST_EFFORT {
            return Ok(());
        }
        Err(Error::Data(format!(
            "outputs are missing in {} different combinations, more than noise with an unknown covariance can take in; \
             let samples be missing as a whole (NaN in all outputs) where some outputs are, or take independent noise",
            missing.patterns.len()
        )))
    }

    /// About how many second derivatives the roots of all patterns have. A row depends on which outputs after
    /// it are missing, and on the entries of its own and the rows down to the last of them.
    fn effort(&self, missing: &Missing) -> usize {
        let n = self.n();
        let mut seen: HashSet<(usize, Vec<usize>)> = HashSet::new();
        let mut effort = 0;
        for set in &missing.patterns {
            let present = |i: usize| set[self.order[i]];
            for i in (0..n).filter(|&i| present(i)) {
                let gone: Vec<usize> = (i + 1..n).filter(|&m| !present(m)).collect();
                let Some(&last) = gone.last() else { continue };
                let (own, entries) = (n - i - gone.len(), (i..=last).map(|k| n - k).sum::<usize>());
                if seen.insert((i, gone)) {
                    effort += own * entries * (entries + 1) / 2;
                }
            }
        }
        effort
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

    /// As [`Noise::profile`](super::Noise::profile): R is the mean square of the residuals of the samples.
    ///
    /// The gradient, W S − n diag(1/w_ii) above the diagonal, gives S = Σ rrᵀ. Where a part of a sample is
    /// missing it gives, by Fisher's identity, what S is expected to be. What is within reach is measured in
    /// units of the noise: by the eigenvalues of W S Wᵀ/n for the W that the reach is counted from.
    ///
    /// Correlations that are 0 stay so until standard deviations have all but settled: those of residuals far from
    /// the optimum lead to other optima, where some combination of outputs is matched too well.
    pub(super) fn profile(
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

    /// The same with correlations 0, of each output by its own measurements: what is expected of those missing,
    /// σ² each, is in the gradient and taken out.
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

    pub(super) fn log_density(&self, graph: &mut Graph, sample: &Sample<'_>, parameters: &[Id]) -> Terms {
        let n = self.n();
        let mut rows = vec![vec![graph.zero(); n]; n];
        if self.known {
            let w = self.start();
            self.places().for_each(|(i, j)| rows[i][j] = graph.constant(w[(i, j)]));
        } else {
            self.places().zip(parameters).for_each(|((i, j), id)| rows[i][j] = *id);
        }
        let (mut lanes, mut rest) = (rows.clone(), log_diagonal(graph, &rows, |_| true));
        for (set, flag) in sample.patterns {
            let present = |i: usize| set[self.order[i]];
            let part = marginal(graph, &rows, present);
            for (i, j) in self.places() {
                // Patterns exclude each other: what is as without gaps needs no switch.
                if part[i][j] != rows[i][j] {
                    lanes[i][j] = graph.select(*flag, part[i][j], lanes[i][j]);
                }
            }
            let log = log_diagonal(graph, &part, present);
            rest = graph.select(*flag, log, rest);
        }
        let residuals: Vec<Id> = self.order.iter().map(|&c| sample.residual(graph, c)).collect();
        let mut squares = Vec::with_capacity(n);
        for (i, lane) in lanes.iter().enumerate() {
            let mut sum = graph.zero();
            for j in i..n {
                let term = graph.mul(lane[j], residuals[j]);
                sum = graph.add(sum, term);
            }
            squares.push(sum);
        }
        Terms { squares, losses: Vec::new(), rest }
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

/// Σ ln w_ii over some rows.
fn log_diagonal(graph: &mut Graph, rows: &[Vec<Id>], which: impl Fn(usize) -> bool) -> Id {
    let mut sum = graph.zero();
    for i in (0..rows.len()).filter(|&i| which(i)) {
        let log = graph.unary(Op::Log, rows[i][i]);
        sum = graph.add(sum, log);
    }
    sum
}

/// The root of the inverse of the part of R that belongs to the outputs present, in their rows and columns;
/// the others are 0.
fn marginal(graph: &mut Graph, rows: &[Vec<Id>], present: impl Fn(usize) -> bool) -> Vec<Vec<Id>> {
    let n = rows.len();
    let mut rows = rows.to_vec();
    let zero = graph.zero();
    for m in (0..n).filter(|&m| !present(m)) {
        for i in (0..m).rev().filter(|&i| present(i)) {
            let (below, above) = (rows[m][m], rows[i][m]);
            if graph.as_constant(above) == Some(0.0) {
                continue;
            }
            let (x, y) = (graph.mul(below, below), graph.mul(above, above));
            let square = graph.add(x, y);
            let length = graph.unary(Op::Sqrt, square);
            let inverse = graph.recip(length);
            let (cosine, sine) = (graph.mul(below, inverse), graph.mul(above, inverse));
            for j in i..n {
                let (a, b) = (rows[i][j], rows[m][j]);
                let (ca, sb) = (graph.mul(cosine, a), graph.mul(sine, b));
                let (sa, cb) = (graph.mul(sine, a), graph.mul(cosine, b));
                rows[i][j] = if j == m { zero } else { graph.sub(ca, sb) };
                rows[m][j] = if j == m { length } else { graph.add(sa, cb) };
            }
        }
        rows[m].fill(zero);
    }
    rows
}
