//! What a solution is worth: how the run ended in the light of the information matrix, and whether the
//! state path is one.

use crate::diagnosis::Information;
use crate::model::Model;
use crate::solver::Status;
use crate::transcription::Transcribed;

/// A point is the optimum when the Newton step left is this small a part of every standard error.
const CLOSE: f64 = 1e-3;
/// Defects may add up along a path to this part of the noise of the same name.
const SMALL: f64 = 0.01;
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
        let names = names.join(", ");
        warnings.push(match group.len() {
            1 => {
                format!("{names} has no influence on the outputs with these data: fix it, or give it a prior")
            }
            _ => format!("{names} cannot be told apart with these data: fix one of them, or give it a prior"),
        });
        groups.push(names);
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
