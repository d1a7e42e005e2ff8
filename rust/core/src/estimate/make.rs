//! The fit at a solution.

use super::fit::{Bound, Estimate, Fit, Record};
use super::judge::{judge, large_defects};
use crate::diagnosis::information;
use crate::experiment::Experiment;
use crate::model::{Model, Variable};
use crate::nlp::Nlp;
use crate::noise::SIGMA;
use crate::solver::Solution;
use crate::transcription::Collocation;

/// A bound is active where the variable is there, but for this fraction of it: the solver's active set
/// stands exactly on bounds, and σ is given by its inverse.
const AT_BOUND: f64 = 1e-9;

impl Fit {
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
        let initial =
            problem.layout.first_point[..experiments.len()].iter().map(|&p| problem.layout.state(p));
        let mut wanted: Vec<usize> = (0..n_theta).filter(|&i| bounds[i].is_none()).collect();
        let free = wanted.len();
        wanted.extend(initial.flat_map(|first| first..first + n_x));

        let (mut status, mut message) = (solution.status, solution.message.clone());
        let mut warnings = Vec::new();
        let mut errors = vec![f64::NAN; problem.n()];
        let mut covariance = vec![f64::NAN; n_theta * n_theta];
        match information(problem, xi, &solution.multipliers, &wanted, &held) {
            Err(_) => {
                warnings.push("there are no standard errors: the information matrix is singular".into())
            }
            Ok(found) => {
                judge(problem, &found, &wanted, (&mut status, &mut message), &mut warnings);
                let k = wanted.len();
                // σ = 1/root, so dσ = −droot/root².
                let slope = |i: usize| {
                    if i < problem.n_model_parameters {
                        problem.estimands.transforms[i].slope(xi[i])
                    } else {
                        -1.0 / (xi[i] * xi[i])
                    }
                };
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
            let output =
                p.name.strip_prefix(SIGMA).and_then(|name| model.outputs.iter().find(|o| o.name == name));
            let (value, unit, bound) = match output.filter(|_| i >= problem.n_model_parameters) {
                Some(output) => (1.0 / xi[i], &output.unit, bounds[i].map(flipped)),
                None => (problem.estimands.value(i, xi), &p.unit, bounds[i]),
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
        let priors = problem.prior_terms(xi);
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
    let at = |i: usize, bound: f64| bound.is_finite() && (xi[i] - bound).abs() <= AT_BOUND * bound.abs();
    let active = |i: usize| match (at(i, lower[i]), at(i, upper[i])) {
        _ if lower[i] == upper[i] => Some(Bound::Fixed),
        (true, _) => Some(Bound::Lower),
        (_, true) => Some(Bound::Upper),
        _ => None,
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
    let initial = |(i, s): (usize, &Variable)| {
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
