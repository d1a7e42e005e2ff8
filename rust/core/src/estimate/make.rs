//! The fit at a solution.

use super::fit::{Bound, Estimate, Fit, Record};
use super::judge::{NOT_FEASIBLE, confounded, feasible, judge, large_defects, unlike_noise};
use crate::diagnosis::information;
use crate::experiment::Experiment;
use crate::gaps::gap_warnings;
use crate::interrupt::Interrupt;
use crate::model::{Model, Variable};
use crate::noise::{Reported, SIGMA};
use crate::problem::Transcribed;
use crate::solver::Solution;

/// A bound is active where the variable is there, but for this fraction of it: the solver's active set
/// stands exactly on bounds, and σ is given by its inverse.
const AT_BOUND: f64 = 1e-9;

impl Fit {
    /// The fit at a solution, with standard errors where the limit leaves time for them.
    pub(super) fn new(
        model: &Model,
        experiments: &[Experiment],
        problem: &dyn Transcribed,
        solution: Solution,
        limit: &Interrupt,
    ) -> Self {
        let (xi, n_theta, n_x) = (&solution.xi, problem.layout().n_theta, problem.layout().n_x);
        let bounds = active_bounds(problem, xi);
        let held: Vec<usize> = (0..n_theta).filter(|&i| bounds[i].is_some()).collect();
        let initial =
            problem.layout().first_point[..experiments.len()].iter().map(|&p| problem.layout().state(p));
        let mut wanted: Vec<usize> = (0..n_theta).filter(|&i| bounds[i].is_none()).collect();
        let free = wanted.len();
        wanted.extend(initial.flat_map(|first| first..first + n_x));

        let (mut status, mut message) = (solution.status, solution.message.clone());
        let mut warnings = Vec::new();
        let n_model = problem.posed().n_model_parameters;
        let reported = problem.posed().noise_report(xi);
        let mut errors = vec![f64::NAN; problem.n()];
        let mut covariance = vec![f64::NAN; n_theta * n_theta];
        let multipliers = &solution.multipliers;
        let feasible = feasible(model, problem, xi);
        let found = feasible
            .then(|| limit.run(|| information(problem, xi, multipliers, &wanted, &held, &mut || true)));
        match found {
            None => warnings.push(NOT_FEASIBLE.into()),
            Some(Err(why)) => warnings.push(format!("there are no standard errors: {why}")),
            Some(Ok(found)) => {
                judge(problem, &found, &wanted, (&mut status, &mut message), &mut warnings);
                let k = wanted.len();
                // The solver sees the logarithm of a parameter, or a part of it.
                let slope = |i: usize| {
                    let transform = problem.posed().estimands.transforms.get(i);
                    transform.map_or(1.0, |t| t.slope(xi[i]))
                };
                for (a, &i) in wanted.iter().enumerate() {
                    let variance = found.covariance[a * k + a];
                    if variance > 0.0 {
                        errors[i] = variance.sqrt() * slope(i).abs();
                    }
                    for (b, &j) in wanted[..free].iter().enumerate().filter(|_| a < free) {
                        covariance[i * n_theta + j] = found.covariance[a * k + b] * slope(i) * slope(j);
                    }
                }
                warnings.extend(confounded(&problem.posed().parameters, &covariance));
                noise_covariance(&reported, n_model, n_theta, &mut covariance);
                for i in n_model..n_theta {
                    errors[i] = covariance[i * n_theta + i].sqrt();
                }
            }
        }

        let of_model = problem.posed().parameters[..n_model].iter().enumerate().map(|(i, p)| Estimate {
            name: p.name.clone(),
            unit: p.unit.clone(),
            value: problem.posed().estimands.value(i, xi),
            std_error: errors[i],
            bound: bounds[i],
        });
        let of_noise = reported.iter().enumerate().map(|(i, r)| {
            let of = |k: usize| {
                if r.gradient[k] < 0.0 { bounds[n_model + k].map(flipped) } else { bounds[n_model + k] }
            };
            Estimate {
                name: r.name.clone(),
                unit: r.output.map_or_else(String::new, |c| model.outputs[c].unit.clone()),
                value: r.value,
                std_error: errors[n_model + i],
                bound: r.bounded_by.and_then(of),
            }
        });
        let parameters: Vec<Estimate> = of_model.chain(of_noise).collect();
        let at_floor = |p: &&Estimate| p.bound == Some(Bound::Lower) && p.name.starts_with(SIGMA);
        for p in parameters[n_model..].iter().filter(at_floor) {
            warnings.push(format!(
                "{} sits at its lower bound {:.3e}: the fit of this output is exact for all we know",
                p.name, p.value
            ));
        }
        if feasible {
            warnings.extend(large_defects(model, problem, xi));
        }
        let inputs: Vec<&str> = model.inputs.iter().map(|v| v.name.as_str()).collect();
        warnings.extend(gap_warnings(&inputs, experiments));

        let record = |e: usize| record(model, &experiments[e], problem, xi, &errors, e);
        let records: Vec<Record> = (0..experiments.len()).map(record).collect();
        let of_model = held.iter().filter(|&&i| i < n_model).count();
        let unknowns = problem.n() - problem.m() - of_model - (n_theta - n_model);
        if feasible && let Some(warning) = unlike_noise(&problem.posed().noise, &records, unknowns) {
            warnings.insert(0, warning);
        }
        let priors = problem.posed().prior_terms(xi);
        Fit {
            model: model.clone(),
            covariance,
            log_likelihood: if feasible { priors - solution.objective } else { f64::NAN },
            feasible,
            status,
            message,
            iterations: solution.iterations,
            records,
            warnings,
            parameters,
            solution,
        }
    }
}

/// The covariance of the parameters as a user knows them, in place: that of the noise by the delta method.
fn noise_covariance(reported: &[Reported], n_model: usize, n: usize, covariance: &mut [f64]) {
    let of_unknowns = covariance.to_vec();
    let at = |i: usize, j: usize| of_unknowns[i * n + j];
    for (a, one) in reported.iter().enumerate() {
        for j in 0..n_model {
            let terms = one.gradient.iter().enumerate().filter(|g| *g.1 != 0.0);
            let value = terms.map(|(k, g)| g * at(n_model + k, j)).sum();
            (covariance[(n_model + a) * n + j], covariance[j * n + n_model + a]) = (value, value);
        }
        for (b, other) in reported.iter().enumerate() {
            let value = one.covariance(other, |i, j| at(n_model + i, n_model + j));
            covariance[(n_model + a) * n + n_model + b] = value;
        }
    }
}

/// For each parameter, what keeps it where it is.
fn active_bounds(problem: &dyn Transcribed, xi: &[f64]) -> Vec<Option<Bound>> {
    let (lower, upper) = problem.bounds();
    let at = |i: usize, bound: f64| bound.is_finite() && (xi[i] - bound).abs() <= AT_BOUND * bound.abs();
    let active = |i: usize| match (at(i, lower[i]), at(i, upper[i])) {
        _ if lower[i] == upper[i] => Some(Bound::Fixed),
        (true, _) => Some(Bound::Lower),
        (_, true) => Some(Bound::Upper),
        _ => None,
    };
    (0..problem.layout().n_theta).map(active).collect()
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
    problem: &dyn Transcribed,
    xi: &[f64],
    errors: &[f64],
    e: usize,
) -> Record {
    let layout = problem.layout();
    let first = layout.first_point[e];
    let outputs = problem.outputs_at_samples(xi, e);
    let residual = |(z, y): (&Vec<f64>, &Vec<f64>)| z.iter().zip(y).map(|(z, y)| z - y).collect();
    let initial = |(i, s): (usize, &Variable)| {
        let at = layout.state(first) + i;
        let (name, unit) = (s.name.clone(), s.unit.clone());
        Estimate { name, unit, value: xi[at], std_error: errors[at], bound: None }
    };
    let (mesh_t, mesh_states) = problem.path(xi, e);
    Record {
        name: experiment.name.clone(),
        t: experiment.t.clone(),
        states: problem.states_at_samples(xi, e),
        residuals: experiment.outputs.iter().zip(&outputs).map(residual).collect(),
        outputs,
        initial: model.states.iter().enumerate().map(initial).collect(),
        mesh_t,
        mesh_states,
    }
}
