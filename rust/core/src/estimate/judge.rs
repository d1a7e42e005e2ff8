//! What a solution is worth: how the run ended in the light of the information matrix, and whether the
//! state path is one.

use nalgebra::{DMatrix, DVector};

use super::fit::Record;
use super::print::number;
use crate::diagnosis::Information;
use crate::experiment::Experiment;
use crate::model::Model;
use crate::noise::{Noise, Sigma};
use crate::parameter::Parameter;
use crate::problem::Transcribed;
use crate::solver::Status;

/// A point is the optimum when the Newton step left is this small a part of every standard error.
const CLOSE: f64 = 1e-3;
/// Defects may add up along a path to this part of the noise of the same name.
const SMALL: f64 = 0.01;
/// Parts of the total variation and of the range of a state that its defects may sum to; below the second they are rounding.
const VARIATION: f64 = 1e-2;
const ROUNDING: f64 = 1e-6;
/// Residuals are reported to differ from noise that was given where their variance differs by more than this factor, and
/// by more than so many standard deviations: chance does that once in a thousand times.
const FACTOR: f64 = 1.2;
const DEVIATIONS: f64 = 3.09;
pub(super) const NOT_FEASIBLE: &str = "the states do not satisfy the equations where the run ended: there is no \
                                       log-likelihood, no standard error, and nothing is said of how well the outputs \
                                       match";
/// A correlation matrix with a smaller eigenvalue is singular for all that rounding leaves to see.
const SINGULAR: f64 = 1e-12;
/// Parameters with a larger part in its eigenvector are named.
const PART: f64 = 0.1;
/// Limits how many variables at once are said to be undetermined at a point that is no maximum.
const FEW: usize = 3;
/// What is 0 hides what it multiplies, so that products of parameters have no slope at a start of zeros.
const NO_MAXIMUM: &str = "not a proper maximum: the log-likelihood grows from here in some direction; start from \
                          elsewhere, above all with factors that are not 0";

/// What the information at the end says about how the run ended.
pub(super) fn judge(
    problem: &dyn Transcribed,
    found: &Information,
    (status, message): (&mut Status, &mut String),
    warnings: &mut Vec<String>,
) {
    let k = found.step.len();
    let known = || (0..k).filter(|i| found.covariance[i * k + i] > 0.0);
    let close = |i: usize| found.step[i].abs() < CLOSE * found.covariance[i * k + i].sqrt();
    let nowhere_left = known().all(close);
    if *status == Status::Failed && !found.saddle && nowhere_left && known().next().is_some() {
        // No step was found for rounding alone.
        *status = Status::Acceptable;
    }
    // Elsewhere than at an end, curvature says nothing about the data.
    if !status.is_end() {
        return;
    }
    if found.saddle {
        warnings.push(NO_MAXIMUM.into());
    }
    let mut groups = Vec::new();
    // Where the log-likelihood grows in some direction, many names are those of this direction.
    for group in found.undetermined.iter().filter(|group| !found.saddle || group.len() <= FEW) {
        let names: Vec<String> = group.iter().map(|&i| problem.variable_name(i)).collect();
        warnings.push(undetermined(&names));
        groups.push(names.join(", "));
    }
    if !groups.is_empty() {
        *status = Status::Unidentifiable;
        *message = format!("{} ({})", status.hint(), groups.join("; "));
    }
    if found.saddle {
        if groups.is_empty() {
            (*status, *message) = (Status::Acceptable, NO_MAXIMUM.into());
        }
    } else if *status == Status::Acceptable && nowhere_left {
        // Rounding kept the solver from its tolerance, but there is nowhere left to go.
        *status = Status::Converged;
        *message = status.hint().to_owned();
    }
}

/// What to say of variables in a direction without curvature.
fn undetermined(names: &[String]) -> String {
    let list = names.join(", ");
    match names.len() {
        1 => format!("{list} has no influence on the outputs with these data: fix it, or give it a prior"),
        _ => format!("{list} cannot be distinguished with these data: fix one of them, or give it a prior"),
    }
}

/// Parameters of which the data determine a combination only: their correlation matrix, n × n, is singular.
pub(super) fn confounded(parameters: &[Parameter], covariance: &[f64]) -> Vec<String> {
    let n = parameters.len();
    let known: Vec<usize> = (0..n).filter(|&i| covariance[i * n + i] > 0.0).collect();
    if known.len() < 2 {
        return Vec::new();
    }
    let deviation = |i: usize| covariance[i * n + i].sqrt();
    let correlation = DMatrix::from_fn(known.len(), known.len(), |a, b| {
        let (i, j) = (known[a], known[b]);
        covariance[i * n + j] / (deviation(i) * deviation(j))
    });
    if correlation.iter().any(|c| !c.is_finite()) {
        return Vec::new();
    }
    let eigen = correlation.symmetric_eigen();
    let mut singular: Vec<usize> = (0..known.len()).filter(|&k| eigen.eigenvalues[k] < SINGULAR).collect();
    singular.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let names = |k: usize| -> Vec<String> {
        let involved = known.iter().enumerate().filter(|(a, _)| eigen.eigenvectors[(*a, k)].abs() > PART);
        involved.map(|(_, &i)| parameters[i].name.clone()).collect()
    };
    singular.into_iter().map(|k| undetermined(&names(k))).collect()
}

/// Returns the sum of the absolute defects of each state; `None` where they are not finite.
pub(super) fn total_defects(problem: &dyn Transcribed, xi: &[f64]) -> Option<Vec<f64>> {
    let n_x = problem.layout().n_x;
    let mut defects = vec![0.0; problem.m()];
    problem.constraints(xi, &mut defects).ok()?;
    defects.truncate(problem.layout().m()); // conditions on the ends are none
    Some((0..n_x).map(|i| defects.iter().skip(i).step_by(n_x).map(|c| c.abs()).sum()).collect())
}

/// Returns whether the states satisfy the equations. Defects add up along the path: they may do so to a hundredth of the way
/// that a state goes (its total variation), and no further than the noise of the output of the same name. Far below the
/// range of the state they are rounding.
pub(super) fn feasible(model: &Model, problem: &dyn Transcribed, xi: &[f64], total: Option<&[f64]>) -> bool {
    let Some(total) = total else { return false };
    let sigmas = problem.posed().sigmas(xi);
    let n_x = problem.layout().n_x;
    let states = &xi[problem.layout().n_theta..];
    model.states.iter().enumerate().all(|(i, state)| {
        let path = || states.iter().skip(i).step_by(n_x);
        let (low, high) = path().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
        let size = low.abs().max(high.abs());
        let span = if high - low > 1e-12 * size { high - low } else { size };
        let variation: f64 = path().zip(path().skip(1)).map(|(a, b)| (b - a).abs()).sum();
        let noise =
            model.outputs.iter().position(|o| o.name == state.name).map_or(f64::INFINITY, |c| sigmas[c]);
        total[i] <= (ROUNDING * span).max(noise.min(VARIATION * variation))
    })
}

/// Returns a sentence where residuals are not those of the Gaussian noise that is known.
pub(super) fn residuals_unlike_noise(noise: &Noise, records: &[Record], unknowns: usize) -> Option<String> {
    let (mut total, mut count) = (0.0, 0usize);
    match noise {
        Noise::Gaussian(sigmas) => {
            for (c, sigma) in sigmas.iter().enumerate() {
                let Sigma::Known(sigma) = sigma else { continue };
                for r in records.iter().flat_map(|r| &r.residuals[c]).filter(|r| !r.is_nan()) {
                    total += (r / sigma).powi(2);
                    count += 1;
                }
            }
        }
        Noise::Correlated(covariance) => {
            let matrix = covariance.matrix()?;
            for record in records {
                for k in 0..record.t.len() {
                    // Of the samples that are there.
                    let there: Vec<usize> =
                        (0..record.residuals.len()).filter(|&c| !record.residuals[c][k].is_nan()).collect();
                    let r = DVector::from_fn(there.len(), |i, _| record.residuals[there[i]][k]);
                    let of = DMatrix::from_fn(r.len(), r.len(), |i, j| matrix[(there[i], there[j])]);
                    total += r.dot(&of.cholesky()?.solve(&r));
                    count += r.len();
                }
            }
        }
        Noise::Independent(_) => return None,
    }
    unlike_noise(total, count.checked_sub(unknowns)?)
}

/// Returns a sentence where a sum of squared residuals over the variance of noise that is known is not that of chance, with
/// so many degrees of freedom: the chi-square test, with the approximation of Wilson and Hilferty (1931).
pub fn unlike_noise(total: f64, degrees: usize) -> Option<String> {
    if degrees == 0 || !total.is_finite() {
        return None;
    }
    let degrees = degrees as f64;
    let (ratio, spread) = (total / degrees, 2.0 / (9.0 * degrees));
    let deviations = (ratio.cbrt() - 1.0 + spread) / spread.sqrt();
    let numbers = format!("chi-square is {} on {degrees} degrees of freedom", number(total, 4));
    let size = format!("{} times the noise that is given as known", number(ratio.sqrt(), 3));
    if ratio > FACTOR && deviations > DEVIATIONS {
        return Some(format!(
            "the residuals are {size} ({numbers}): the model does not explain the data to that accuracy, or the noise is \
             larger; standard errors and likelihood are those of the noise as given"
        ));
    }
    (ratio < 1.0 / FACTOR && deviations < -DEVIATIONS).then(|| {
        format!("the residuals are only {size} ({numbers}): that noise is too large, and so are the standard errors")
    })
}

/// Defects add up along the path; unless they stay far below σ, the likelihood is not that of a solution.
pub(super) fn large_defects(
    model: &Model,
    problem: &dyn Transcribed,
    xi: &[f64],
    total: &[f64],
) -> Vec<String> {
    let sigmas = problem.posed().sigmas(xi);
    let mut found = Vec::new();
    for (state, total) in model.states.iter().zip(total) {
        let same = model.outputs.iter().position(|o| o.name == state.name);
        if let Some(sigma) = same.map(|c| sigmas[c]).filter(|s| *total > SMALL * s) {
            found.push(format!(
                "the defects of {0} sum to {total:.1e}, not far below sigma_{0} = {sigma:.1e}: the state path is \
                 not a solution to that accuracy; tighten the solver's tolerance",
                state.name
            ));
        }
    }
    found
}

/// Returns a sentence where there are no more measured values than unknowns: a path with as many unknowns passes through
/// them, whatever the truth is. A prior counts as a measurement.
pub(super) fn few_samples(model: &Model, experiments: &[Experiment], unknowns: usize) -> Option<String> {
    let samples =
        experiments.iter().flat_map(|e| e.outputs.iter().flatten()).filter(|z| z.is_finite()).count();
    let measured = samples + model.parameters.iter().filter(|p| p.prior.is_some()).count();
    (measured <= unknowns).then(|| {
        format!(
            "{measured} measured values are no more than the {unknowns} parameters and initial states that they should \
             tell: the fit passes through the noise, and its standard errors say nothing"
        )
    })
}
