//! What a solution is worth: how the run ended in the light of the information matrix, and whether the
//! state path is one.

use nalgebra::DMatrix;

use crate::diagnosis::Information;
use crate::model::Model;
use crate::parameter::Parameter;
use crate::solver::Status;
use crate::transcription::Transcribed;

/// A point is the optimum when the Newton step left is this small a part of every standard error.
const CLOSE: f64 = 1e-3;
/// Defects may add up along a path to this part of the noise of the same name.
const SMALL: f64 = 0.01;
/// A correlation matrix with a smaller eigenvalue is singular for all that rounding leaves to see.
const SINGULAR: f64 = 1e-12;
/// Parameters with a larger part in its eigenvector are named.
const PART: f64 = 0.1;
/// What is 0 hides what it multiplies, so that products of parameters have no slope at a start of zeros.
const NO_MAXIMUM: &str = "not a proper maximum: the log-likelihood grows from here in some direction; start from \
                          elsewhere, above all with factors that are not 0";

/// What the information at the end says about how the run ended.
pub(super) fn judge(
    problem: &dyn Transcribed,
    found: &Information,
    wanted: &[usize],
    (status, message): (&mut Status, &mut String),
    warnings: &mut Vec<String>,
) {
    // Elsewhere than at an end, curvature says nothing about the data.
    if !matches!(status, Status::Converged | Status::Acceptable | Status::Unidentifiable) {
        return;
    }
    let k = wanted.len();
    let close = |i: usize| found.step[i].abs() < CLOSE * found.covariance[i * k + i].sqrt();
    let mut groups = Vec::new();
    for group in &found.undetermined {
        let names: Vec<String> = group.iter().map(|&i| problem.variable_name(i)).collect();
        warnings.push(undetermined(&names));
        groups.push(names.join(", "));
    }
    if !groups.is_empty() {
        *status = Status::Unidentifiable;
        *message = format!("{} ({})", status.hint(), groups.join("; "));
    }
    if found.saddle {
        warnings.push(NO_MAXIMUM.into());
    } else if *status == Status::Acceptable && (0..k).filter(|i| found.covariance[i * k + i] > 0.0).all(close)
    {
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
        _ => format!("{list} cannot be told apart with these data: fix one of them, or give it a prior"),
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

/// Defects add up along the path; unless they stay far below σ, the likelihood is not that of a solution.
pub(super) fn large_defects(model: &Model, problem: &dyn Transcribed, xi: &[f64]) -> Vec<String> {
    let mut defects = vec![0.0; problem.m()];
    if problem.constraints(xi, &mut defects).is_err() {
        return vec!["the equations are not finite at the result".into()];
    }
    defects.truncate(problem.layout().m()); // conditions on the ends are none
    let sigmas = problem.posed().sigmas(xi);
    let mut found = Vec::new();
    for (i, state) in model.states.iter().enumerate() {
        let total: f64 = defects.iter().skip(i).step_by(model.states.len()).map(|c| c.abs()).sum();
        let same = model.outputs.iter().position(|o| o.name == state.name);
        if let Some(sigma) = same.map(|c| sigmas[c]).filter(|s| total > SMALL * s) {
            found.push(format!(
                "the defects of {0} sum to {total:.1e}, not far below sigma_{0} = {sigma:.1e}: the state path is \
                 not a solution to that accuracy; tighten the solver's tolerance",
                state.name
            ));
        }
    }
    found
}
