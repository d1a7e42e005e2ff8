//! One record at given values of the shared variables.

use std::collections::HashMap;
use std::sync::Arc;

use super::held::Held;
use super::workshop::{Tools, Workshop};
use crate::collocation::Collocation;
use crate::error::Error;
use crate::experiment::Experiment;
use crate::index::{ExperimentId, VariableId};
use crate::linalg::KktChoice;
use crate::nlp::Nlp;
use crate::problem::Transcribed;
use crate::solver::{Control, Newton, Point, Program, Schur, Settings, Solution, Status};

/// Where a record's own variables were at the last trial: the start of the next.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    xi: Vec<f64>,
    multipliers: Vec<f64>,
}

impl Kept {
    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.xi) + size_of_val(&*self.multipliers)
    }
}

/// Paths that are kept, by name of the record.
pub(super) type Paths = HashMap<String, Kept>;

/// Why a record has no likelihood at a trial.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Failure {
    /// Name of the record.
    pub record: String,
    /// What happened, in words.
    pub message: String,
    /// Whether the record itself cannot be used, whatever the parameters.
    pub of_data: bool,
}

/// What the estimation says of one record.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RecordResult {
    /// Name of the record.
    pub name: String,
    /// Log-likelihood, without the constant −N n_y/2 ln 2π and without priors.
    pub log_likelihood: f64,
    /// Number of samples.
    pub samples: usize,
    /// The parameters that each record has of its own, in the order of the model.
    pub own: Vec<f64>,
    /// Their standard errors, the shared parameters taken as known; NaN where the record does not determine one.
    pub own_errors: Vec<f64>,
    /// States at the first sample.
    pub initial: Vec<f64>,
    /// Root mean square of the residuals of each output; NaN where it is not measured.
    pub rms: Vec<f64>,
    /// Derivatives of V with respect to the shared variables.
    pub gradient: Vec<f64>,
    /// Correlation of successive residuals of each output, lag 1; NaN where it is not measured.
    pub correlation: Vec<f64>,
}

/// What is asked for beside the sums.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Detail {
    /// A description of each record.
    pub described: bool,
    /// The Hessian of Gauss and Newton in place of the exact one: without the curvature of residuals, which is large where a model
    /// misses the motion, and with which a test of what it misses would go wrong.
    pub gauss_newton: bool,
}

impl Detail {
    /// With a description of each record, or without.
    pub fn described(mut self, described: bool) -> Self {
        self.described = described;
        self
    }

    /// With the Hessian of Gauss and Newton, or the exact one.
    pub fn gauss_newton(mut self, gauss_newton: bool) -> Self {
        self.gauss_newton = gauss_newton;
        self
    }
}

/// A record that was evaluated.
pub(super) struct Evaluated {
    pub schur: Schur,
    pub kept: Kept,
    pub factorizations: usize,
    pub result: Option<RecordResult>,
}

/// Tolerance of a record's path, in its standard errors. The derivatives are corrected for the rest to first order.
const CLOSE: f64 = 0.1;
/// A path from the last trial is followed in a single step where that is not longer than this, squared, in standard errors.
const NEAR: f64 = 1.0;

/// Evaluates a record with the shared variables at values `at`, from the path that is kept.
pub(super) fn evaluate(
    workshop: &Workshop,
    experiment: &Experiment,
    at: &[f64],
    kept: Option<&Kept>,
    detail: Detail,
) -> Result<Evaluated, Failure> {
    let failed = |message: String, of_data| Failure { record: experiment.name.clone(), message, of_data };
    let wrong = |e: Error| failed(e.to_string(), true);
    let Tools { problem, kkt } = workshop.take(experiment).map_err(wrong)?;
    let shared = workshop.shared(&problem);
    if shared.len() != at.len() {
        return Err(failed(
            "its missing measurements give the noise other parameters than the first record".into(),
            true,
        ));
    }
    let kept = kept.filter(|k| (k.xi.len(), k.multipliers.len()) == (problem.n(), problem.m()));
    let result = match kept {
        Some(kept) => {
            minimise(workshop, &problem, (kept.xi.clone(), Some(&kept.multipliers)), at, kkt, detail)
        }
        None => {
            let start = workshop.start(&problem, experiment, at).map_err(wrong)?;
            minimise(workshop, &problem, (start, None), at, kkt, detail).or_else(|first| {
                let start = workshop.start_by_estimation(&problem, experiment, at).ok_or(first)?;
                minimise(workshop, &problem, (start, None), at, KktChoice::default(), detail)
            })
        }
    };
    result.map_err(|message| failed(message, false))
}

/// Minimises over all variables of a record but the shared ones, from a point and, if they are known, its multipliers.
fn minimise(
    workshop: &Workshop,
    problem: &Arc<Collocation>,
    (mut xi, multipliers): (Vec<f64>, Option<&[f64]>),
    at: &[f64],
    kkt: KktChoice,
    detail: Detail,
) -> Result<Evaluated, String> {
    let shared = workshop.shared(problem);
    shared.iter().zip(at).for_each(|(i, at)| xi[i.0] = *at);
    let held = Held::new(problem, &shared, at);
    let settings = Settings::default().tolerance(CLOSE).kkt(kkt);
    let program = Program::new(&held, &xi);
    let not_finite = |_| {
        let what = problem.why_not_finite(&xi);
        what.unwrap_or_else(|| "a function of the model is not finite".into())
    };
    let point = Point::first(&program, &xi).map_err(not_finite)?;
    let mut newton = Newton::new(program, point, multipliers, &settings);
    let ending = match multipliers.is_some() && newton.step_if_near(NEAR) {
        true => Status::Converged.into(),
        false => newton.minimise(&mut |_| Control::Continue).map_err(not_finite)?,
    };
    let ended = ending.status.is_end();
    let schur = if ended { newton.schur(&shared, detail.gauss_newton) } else { None };
    let solution = newton.finish(ending);
    if !ended {
        return Err(solution.message);
    }
    let open = "a derivative of the model is not finite, or the record does not determine its states";
    let schur = schur.ok_or(open)?;
    let result = detail.described.then(|| described(workshop, problem, &solution, &schur.gradient));
    if let Some(kkt) = solution.kkt.take_made() {
        workshop.put_back(Arc::clone(problem), kkt);
    }
    Ok(Evaluated {
        schur,
        factorizations: solution.evaluations.factorizations,
        kept: Kept { xi: solution.xi, multipliers: solution.multipliers },
        result,
    })
}

/// Describes a record at its solution.
fn described(
    workshop: &Workshop,
    problem: &Collocation,
    solution: &Solution,
    gradient: &[f64],
) -> RecordResult {
    let (e, xi) = (ExperimentId(0), &solution.xi[..]);
    let experiment = &problem.posed().experiments[e];
    let layout = problem.layout();
    let outputs = problem.outputs_at_samples(xi, e);
    let residuals =
        |(z, y): (&Vec<f64>, &Vec<f64>)| -> Vec<f64> { z.iter().zip(y).map(|(z, y)| z - y).collect() };
    let residuals: Vec<Vec<f64>> = experiment.outputs.iter().zip(&outputs).map(residuals).collect();
    let squares = |r: &[f64]| r.iter().filter(|r| r.is_finite()).map(|r| r * r).sum::<f64>();
    let count = |r: &[f64]| r.iter().filter(|r| r.is_finite()).count() as f64;
    let lagged = |r: &[f64]| {
        let pairs = r.windows(2).map(|w| w[0] * w[1]).filter(|v| v.is_finite());
        pairs.sum::<f64>() / squares(r)
    };
    let own: Vec<VariableId> = workshop.own(problem);
    RecordResult {
        name: experiment.name.clone(),
        log_likelihood: problem.objective(xi).map_or(f64::NAN, |v| problem.posed().prior_terms(xi) - v),
        samples: experiment.t.len(),
        own: own.iter().map(|&i| problem.posed().estimands.value(i, xi)).collect(),
        own_errors: workshop.own_errors(problem, solution),
        initial: xi[layout.states(layout.first_point[e])].to_vec(),
        rms: residuals.iter().map(|r| (squares(r) / count(r)).sqrt()).collect(),
        gradient: gradient.to_vec(),
        correlation: residuals.iter().map(|r| lagged(r)).collect(),
    }
}
