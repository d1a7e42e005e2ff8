//! What an estimation gives back.

use std::ops::Index;

use crate::diagnosis::{Information, information};
use crate::error::did_you_mean;
use crate::experiment::Experiment;
use crate::model::Model;
use crate::nlp::Nlp;
use crate::noise::SIGMA;
use crate::solver::{Solution, Status};
use crate::transcription::Collocation;

/// What keeps a parameter where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// Its lower bound.
    Lower,
    /// Its upper bound.
    Upper,
    /// It is fixed.
    Fixed,
}

/// An estimated quantity: a parameter, a standard deviation or an initial state.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Name.
    pub name: String,
    /// Unit, as text; empty where unknown.
    pub unit: String,
    /// Value.
    pub value: f64,
    /// Standard error (Cramér-Rao); NaN where a bound keeps it or the data do not determine it.
    pub std_error: f64,
    /// What keeps it where it is, if anything.
    pub bound: Option<Bound>,
}

/// States, outputs and residuals of one experiment at its samples. Channels stand in the order of the
/// model's states and outputs; by name: [`Fit::state`], [`Fit::output`], [`Fit::residual`].
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Name of the experiment.
    pub name: String,
    /// Sample times, s, N of them.
    pub t: Vec<f64>,
    /// n_x states of N samples.
    pub states: Vec<Vec<f64>>,
    /// n_y outputs of the model of N samples.
    pub outputs: Vec<Vec<f64>>,
    /// Measured less model outputs; NaN where a sample is missing.
    pub residuals: Vec<Vec<f64>>,
    /// The state at the first sample.
    pub initial: Vec<Estimate>,
    /// Number of mesh points.
    pub mesh_points: usize,
}

/// The result of an [`Estimation`](super::Estimation). It prints as a table.
///
/// ```
/// use phugoid::solver::Status;
/// use phugoid::{Estimation, Experiment, Model, Parameter};
///
/// let mut m = Model::new("fall");
/// let (h, v) = (m.state("h", "m")?, m.state("v", "m/s")?);
/// let g = m.parameter(Parameter { unit: "m/s²".into(), ..Parameter::new("g", 0.0) })?;
/// m.equation("h", v, None)?;
/// m.equation("v", -g, None)?;
/// m.output("height", h, "", None)?;
///
/// let t: Vec<f64> = (0..40).map(|k| 0.05 * k as f64).collect();
/// let height = t.iter().map(|t| 20.0 - 0.5 * 9.81 * t * t + 0.01 * (1e4 * t).sin()).collect();
/// let fit = Estimation::new(&m, &[Experiment::new(&m, "drop", t, [("height", height)])?]).solve()?;
///
/// assert_eq!(fit.status, Status::Converged);
/// let g = &fit["g"];
/// assert!((g.value - 9.81).abs() < 4.0 * g.std_error && g.std_error < 0.02);
/// assert!(fit["sigma_height"].value < 0.01);
/// assert_eq!(fit.state(0, "v").unwrap().len(), 40);
/// println!("{fit}"); // status, parameters with standard errors, match of the outputs
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Fit {
    /// The model.
    pub model: Model,
    /// The model's parameters, then the unknown standard deviations `sigma_<output>`; by name: `fit["CLa"]`.
    pub parameters: Vec<Estimate>,
    /// Covariance of the parameters in their order, row-major; NaN where there is no standard error.
    pub covariance: Vec<f64>,
    /// Of the measurements, without the constant −N n_y/2 ln 2π and without priors (Eq. ellz_defn).
    pub log_likelihood: f64,
    /// How it ended.
    pub status: Status,
    /// What that means, and what to do.
    pub message: String,
    /// Number of iterations.
    pub iterations: usize,
    /// One an experiment.
    pub records: Vec<Record>,
    /// What to beware of, in words.
    pub warnings: Vec<String>,
    /// What the solver gave back: all unknowns, multipliers, counts, the iteration table.
    pub solution: Solution,
}

/// A bound is active where the variable lies within this fraction of its size from it.
const AT_BOUND: f64 = 1e-6;
/// A point is the optimum when the Newton step left is this small a part of every standard error.
const CLOSE: f64 = 1e-3;
/// Defects may add up along a path to this part of the noise of the same name.
const SMALL: f64 = 0.01;

impl Index<&str> for Fit {
    type Output = Estimate;

    /// # Panics
    /// When there is no parameter of this name; [`Fit::parameter`] does not.
    fn index(&self, name: &str) -> &Estimate {
        self.parameter(name).unwrap_or_else(|| {
            let hint = did_you_mean(name, self.parameters.iter().map(|p| p.name.as_str()));
            panic!("the fit has no parameter '{name}'.{hint}")
        })
    }
}

impl Fit {
    /// A parameter or standard deviation by name.
    pub fn parameter(&self, name: &str) -> Option<&Estimate> {
        self.parameters.iter().find(|p| p.name == name)
    }

    /// A state at the samples of an experiment.
    pub fn state(&self, experiment: usize, name: &str) -> Option<&[f64]> {
        let i = self.model.states.iter().position(|s| s.name == name)?;
        Some(&self.records.get(experiment)?.states[i])
    }

    /// What the model says of an output at the samples of an experiment.
    pub fn output(&self, experiment: usize, name: &str) -> Option<&[f64]> {
        let i = self.model.outputs.iter().position(|o| o.name == name)?;
        Some(&self.records.get(experiment)?.outputs[i])
    }

    /// Measured less model output at the samples of an experiment; NaN where a sample is missing.
    pub fn residual(&self, experiment: usize, name: &str) -> Option<&[f64]> {
        let i = self.model.outputs.iter().position(|o| o.name == name)?;
        Some(&self.records.get(experiment)?.residuals[i])
    }

    /// The fit at a solution.
    pub(super) fn new(
        model: &Model,
        experiments: &[Experiment],
        problem: &Collocation,
        solution: Solution,
    ) -> Self {
        let (xi, n_theta, n_x) = (&solution.xi, problem.layout.n_theta, problem.layout.n_x);
        let bounds = active_bounds(problem, xi);
        let held: Vec<usize> = (0..n_theta).filter(|&i| bounds[i].is_some()).collect();
        let initial = problem.layout.first_point[..experiments.len()].iter().map(|&p| problem.layout.state(p));
        let mut wanted: Vec<usize> = (0..n_theta).filter(|&i| bounds[i].is_none()).collect();
        let free = wanted.len();
        wanted.extend(initial.flat_map(|first| first..first + n_x));

        let (mut status, mut message) = (solution.status, solution.message.clone());
        let mut warnings = Vec::new();
        let mut errors = vec![f64::NAN; problem.n()];
        let mut covariance = vec![f64::NAN; n_theta * n_theta];
        match information(problem, xi, &solution.multipliers, &wanted, &held) {
            Err(_) => warnings.push("there are no standard errors: the information matrix is singular".into()),
            Ok(found) => {
                judge(problem, &found, &wanted, (&mut status, &mut message), &mut warnings);
                let k = wanted.len();
                // σ = 1/root, so dσ = −droot/root².
                let slope =
                    |i: usize| if i < problem.n_model_parameters { 1.0 } else { -1.0 / (xi[i] * xi[i]) };
                for (a, &i) in wanted.iter().enumerate() {
                    let variance = found.covariance[a * k + a];
                    if variance > 0.0 {
                        errors[i] = variance.sqrt() * if a < free { slope(i).abs() } else { 1.0 };
                    }
                    for (b, &j) in wanted[..free].iter().enumerate().filter(|_| a < free) {
                        covariance[i * n_theta + j] = found.covariance[a * k + b] * slope(i) * slope(j);
                    }
                }
            }
        }

        let estimate = |i: usize| {
            let p = &problem.parameters[i];
            let output = p.name.strip_prefix(SIGMA).and_then(|name| model.outputs.iter().find(|o| o.name == name));
            let (value, unit, bound) = match output.filter(|_| i >= problem.n_model_parameters) {
                Some(output) => (1.0 / xi[i], &output.unit, bounds[i].map(flipped)),
                None => (xi[i], &p.unit, bounds[i]),
            };
            Estimate { name: p.name.clone(), unit: unit.clone(), value, std_error: errors[i], bound }
        };
        let parameters: Vec<Estimate> = (0..n_theta).map(estimate).collect();
        let at_floor = |p: &&Estimate| p.bound == Some(Bound::Lower);
        for p in parameters[problem.n_model_parameters..].iter().filter(at_floor) {
            warnings.push(format!(
                "{} sits at its lower bound {:.3e}: the fit of this output is exact for all we know",
                p.name, p.value
            ));
        }
        warnings.extend(large_defects(model, problem, xi));

        let record = |e: usize| record(model, &experiments[e], problem, xi, &errors, e);
        let priors = problem.parameters.iter().zip(xi);
        let priors: f64 =
            priors.filter_map(|(p, x)| p.prior.map(|(mean, std)| 0.5 * ((x - mean) / std).powi(2))).sum();
        Fit {
            model: model.clone(),
            covariance,
            log_likelihood: priors - solution.objective,
            status,
            message,
            iterations: solution.iterations,
            records: (0..experiments.len()).map(record).collect(),
            warnings,
            parameters,
            solution,
        }
    }
}

/// For each parameter, what keeps it where it is.
fn active_bounds(problem: &Collocation, xi: &[f64]) -> Vec<Option<Bound>> {
    let (lower, upper) = problem.bounds();
    let active = |i: usize| {
        let near = AT_BOUND * xi[i].abs().max((upper[i] - lower[i]).min(1.0));
        if lower[i] == upper[i] {
            Some(Bound::Fixed)
        } else if xi[i] - lower[i] <= near {
            Some(Bound::Lower)
        } else if upper[i] - xi[i] <= near {
            Some(Bound::Upper)
        } else {
            None
        }
    };
    (0..problem.layout.n_theta).map(active).collect()
}

/// The lower bound of a precision root is the upper bound of σ.
fn flipped(bound: Bound) -> Bound {
    match bound {
        Bound::Lower => Bound::Upper,
        Bound::Upper => Bound::Lower,
        Bound::Fixed => Bound::Fixed,
    }
}

/// What the information at the end says about how the run ended.
fn judge(
    problem: &Collocation,
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
            1 => format!("{names} has no influence on the outputs with these data: fix it, or give it a prior"),
            _ => format!("{names} cannot be told apart with these data: fix one of them, or give it a prior"),
        });
        groups.push(names);
    }
    if !groups.is_empty() {
        *status = Status::Unidentifiable;
        *message = format!("{} ({})", status.hint(), groups.join("; "));
    }
    if found.saddle {
        warnings.push("not a proper maximum: the log-likelihood grows from here in some direction".into());
    } else if *status == Status::Acceptable && (0..k).filter(|i| found.covariance[i * k + i] > 0.0).all(close) {
        // Rounding kept the solver from its tolerance, but there is nowhere left to go.
        *status = Status::Converged;
        *message = status.hint().to_owned();
    }
}

/// Defects add up along the path; unless they stay far below σ, the likelihood is not that of a solution.
fn large_defects(model: &Model, problem: &Collocation, xi: &[f64]) -> Vec<String> {
    let mut defects = vec![0.0; problem.m()];
    if problem.constraints(xi, &mut defects).is_err() {
        return vec!["the equations are not finite at the result".into()];
    }
    let sigmas = problem.noise.sigmas(&xi[problem.n_model_parameters..problem.layout.n_theta]);
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

fn record(
    model: &Model,
    experiment: &Experiment,
    problem: &Collocation,
    xi: &[f64],
    errors: &[f64],
    e: usize,
) -> Record {
    let (layout, mesh) = (&problem.layout, &problem.meshes[e]);
    let first = layout.first_point[e];
    let outputs = problem.outputs_at_samples(xi, e);
    let residual = |(z, y): (&Vec<f64>, &Vec<f64>)| z.iter().zip(y).map(|(z, y)| z - y).collect();
    let path = |i: usize| mesh.sample_points.iter().map(|p| xi[layout.state(first + p) + i]).collect();
    let initial = |(i, s): (usize, &crate::model::Variable)| {
        let at = layout.state(first) + i;
        let (name, unit) = (s.name.clone(), s.unit.clone());
        Estimate { name, unit, value: xi[at], std_error: errors[at], bound: None }
    };
    Record {
        name: experiment.name.clone(),
        t: experiment.t.clone(),
        states: (0..layout.n_x).map(path).collect(),
        residuals: experiment.outputs.iter().zip(&outputs).map(residual).collect(),
        outputs,
        initial: model.states.iter().enumerate().map(initial).collect(),
        mesh_points: mesh.n_mesh,
    }
}
