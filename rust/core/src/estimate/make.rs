//! The fit at a solution.

use super::Transcription;
use super::fit::{Bound, Estimate, Fit, Record};
use super::judge::{
    NOT_FEASIBLE, confounded, feasible, few_samples, judge, large_defects, residuals_unlike_noise,
    total_defects,
};
use super::print::short;
use crate::diagnosis::{NoInformation, information};
use crate::experiment::Experiment;
use crate::gaps::gap_warnings;
use crate::index::{ExperimentId, IndexVec, VariableId};
use crate::interrupt::{Cause, Interrupt};
use crate::linalg::KktError;
use crate::model::{Model, Scaling, Variable};
use crate::noise::{NoiseModel, Reported, SIGMA};
use crate::problem::Transcribed;
use crate::solver::{Solution, Status};

/// A bound is active where the variable lies within this part of it: the solver's active set stands exactly on bounds,
/// and σ is given by its inverse. An interior-point method ends short of them.
const AT_BOUND: f64 = 1e-9;
const NEAR_BOUND: f64 = 1e-6;

impl Fit {
    /// The fit at a solution, with standard errors where the limit leaves time for them. Of each of the scalings, which no
    /// output can tell, a parameter was held.
    pub(super) fn new(
        model: &Model,
        experiments: &[Experiment],
        problem: &dyn Transcribed,
        solution: Solution,
        scalings: &[Scaling],
        (transcription, limit): (Transcription, &Interrupt),
    ) -> Self {
        Interrupt::shielded(|| {
            assessed(model, experiments, problem, solution, scalings, (transcription, limit))
        })
    }
}

fn assessed(
    model: &Model,
    experiments: &[Experiment],
    problem: &dyn Transcribed,
    solution: Solution,
    scalings: &[Scaling],
    (transcription, limit): (Transcription, &Interrupt),
) -> Fit {
    let interior =
        solution.bound_multipliers.as_ref().is_some_and(|(l, u)| l.iter().chain(u).any(|z| *z != 0.0));
    let xi = &solution.xi[..];
    let (n_theta, n_x) = (problem.layout().n_theta, problem.layout().n_x);
    let bounds = active_bounds(problem, xi, interior);
    let (held, mut wanted): (Vec<_>, Vec<_>) =
        (0..n_theta).map(VariableId).partition(|i| bounds[*i].is_some());
    let first = problem.layout().first_point.iter().take(experiments.len());
    let initial: Vec<VariableId> = first.map(|&p| problem.layout().state(p)).collect();
    let free = wanted.len();
    wanted.extend(initial.iter().flat_map(|first| (0..n_x).map(move |r| *first + r)));

    let (mut status, mut message) = (solution.status, solution.message.clone());
    let mut warnings = Vec::new();
    let n_model = problem.posed().n_model_parameters;
    let reported = problem.posed().noise_report(xi);
    let mut errors = vec![f64::NAN; problem.n()];
    let mut covariance = vec![f64::NAN; n_theta * n_theta];
    let total = total_defects(problem, xi);
    let feasible = feasible(model, problem, xi, total.as_deref());
    // Preparing the factorisation of a long record takes tens of milliseconds before it first looks at the clock.
    let found = feasible.then(|| {
        if limit.stops() {
            return Err(NoInformation::Stopped);
        }
        limit.run(|| information(problem, xi, &solution.multipliers, &wanted, &held, &solution.kkt))
    });
    drop(solution.kkt.take_made()); // a fit does not keep that much
    match found {
        None => warnings.push(NOT_FEASIBLE.into()),
        Some(Err(why)) => warnings.push(no_errors(problem, xi, why, limit)),
        Some(Ok(found)) => {
            judge(problem, &found, (&mut status, &mut message), &mut warnings);
            let k = wanted.len();
            // The solver sees the logarithm of a parameter, or a part of it.
            let slope = |i: VariableId| {
                let transform = problem.posed().estimands.transforms.get(i);
                transform.map_or(1.0, |t| t.slope(xi[i]))
            };
            for (a, &i) in wanted.iter().enumerate() {
                let variance = found.covariance[a * k + a];
                if variance > 0.0 {
                    errors[i] = variance.sqrt() * slope(i).abs();
                }
                for (b, &j) in wanted[..free].iter().enumerate().filter(|_| a < free) {
                    covariance[i.0 * n_theta + j.0] = found.covariance[a * k + b] * slope(i) * slope(j);
                }
            }
            warnings.extend(confounded(problem.posed().parameters.as_slice(), &covariance));
            noise_covariance(&reported, n_model, n_theta, &mut covariance);
            for i in n_model..n_theta {
                errors[i] = covariance[i * n_theta + i].sqrt();
            }
        }
    }
    let of_model = || problem.posed().parameters.numbered().take(n_model);
    let names: Vec<&str> = of_model().map(|(_, p)| p.name.as_str()).collect();
    for scaling in scalings {
        for i in (0..n_model).filter(|&i| scaling.scales(names[i])) {
            errors[i] = f64::NAN;
            (0..n_theta).for_each(|j| covariance[i * n_theta + j] = f64::NAN);
            (0..n_theta).for_each(|j| covariance[j * n_theta + i] = f64::NAN);
        }
        for (i, _) in model.states.iter().enumerate().filter(|s| scaling.scales(&s.1.name)) {
            initial.iter().for_each(|&first| errors[first + i] = f64::NAN);
        }
        warnings.push(scaling.advice(model));
    }
    if !scalings.is_empty() && status.is_end() {
        let said = if status == Status::Unidentifiable { &message } else { Status::Unidentifiable.hint() };
        let each = scalings.iter().map(|s| {
            let names: Vec<&str> = s.exponents.iter().map(|e| e.0.as_str()).collect();
            match names[..] {
                [one] => format!("{one}: without influence"),
                _ => format!("{}: one scale is free", names.join(", ")),
            }
        });
        message = format!("{said} ({})", each.collect::<Vec<_>>().join("; "));
        status = Status::Unidentifiable;
    }

    let of_model = of_model().map(|(i, p)| Estimate {
        name: p.name.clone(),
        unit: p.unit.clone(),
        value: problem.posed().estimands.value(i, xi),
        std_error: errors[i],
        bounds: (p.lower.unwrap_or(f64::NEG_INFINITY), p.upper.unwrap_or(f64::INFINITY)),
        bound: bounds[i],
    });
    let of_noise = reported.iter().enumerate().map(|(i, r)| {
        let of = |k: usize| {
            let bound = bounds[VariableId(n_model + k)];
            if r.gradient[k] < 0.0 { bound.map(flipped) } else { bound }
        };
        Estimate {
            name: r.name.clone(),
            unit: r.output.map_or_else(String::new, |c| model.outputs[c].unit.clone()),
            value: r.value,
            std_error: errors[n_model + i],
            bounds: r.bounds,
            bound: r.bounded_by.and_then(of),
        }
    });
    let parameters: Vec<Estimate> = of_model.chain(of_noise).collect();
    let at_floor = |p: &&Estimate| p.bound == Some(Bound::Lower) && p.name.starts_with(SIGMA);
    for p in parameters[n_model..].iter().filter(at_floor) {
        warnings.push(format!(
            "{} sits at its lower bound {:.3e}: as far as this bound allows, this output is fitted exactly",
            p.name, p.value
        ));
    }
    warnings.extend(at_bounds(&parameters[..n_model], scalings).filter(|_| feasible));
    if let Some(total) = total.filter(|_| feasible) {
        warnings.extend(large_defects(model, problem, xi, &total));
    }
    warnings.extend(gap_warnings(&model.input_names(), experiments));
    let of_model = held.iter().filter(|i| i.0 < n_model).count();
    // Each constraint, of the path or on its ends, takes one unknown away.
    let unknowns = (problem.n() - of_model - (n_theta - n_model)).saturating_sub(problem.m());
    warnings.extend(few_samples(model, experiments, unknowns));

    let record = |e: usize| record(model, &experiments[e], problem, xi, &errors, ExperimentId(e));
    let log_likelihood = match problem.objective(xi) {
        Ok(objective) if feasible => problem.posed().prior_terms(xi) - objective,
        _ => f64::NAN,
    };
    let records: Vec<Record> = (0..experiments.len()).map(record).collect();
    let unlike = residuals_unlike_noise(&problem.posed().noise, &records, unknowns).filter(|_| feasible);
    let unlike_noise = unlike.is_some();
    warnings.splice(0..0, unlike);
    Fit {
        model: model.clone(),
        transcription,
        records,
        covariance,
        log_likelihood,
        integrated: None,
        feasible,
        status,
        message,
        warnings,
        unlike_noise,
        unknowns,
        parameters,
        iterations: solution.iterations,
        solution,
        noise: NoiseModel::new(),
        refinement: None,
        smoothing: None,
        moved: None,
    }
}

/// Returns a sentence that names all parameters of the model at a bound; of one that could leave it if a parameter that no output
/// tells had been held elsewhere, that, too.
fn at_bounds(parameters: &[Estimate], scalings: &[Scaling]) -> Option<String> {
    let sides = parameters.iter().filter_map(|p| match p.bound? {
        Bound::Lower => Some((p, "lower", p.bounds.0)),
        Bound::Upper => Some((p, "upper", p.bounds.1)),
        Bound::Fixed => None,
    });
    let found: Vec<_> = sides.collect();
    let each: Vec<String> = found
        .iter()
        .enumerate()
        .map(|(k, (p, side, bound))| {
            let lies = if k == 0 { " lies" } else { "" };
            format!("{}{lies} at its {side} bound {}", p.name, short(*bound, 4))
        })
        .collect();
    let (no_error, optimum) = match each.len() {
        0 => return None,
        1 => ("it has no standard error", "it"),
        _ => ("they have no standard errors", "them"),
    };
    let mut text = format!(
        "{}: {no_error}, those of the others take {optimum} as known, and the optimum may be beyond",
        each.join(", ")
    );
    for (p, _, _) in &found {
        if let Some(scaling) = scalings.iter().find(|s| s.scales(&p.name) && !s.holds(&p.name)) {
            let at = short(scaling.at, 4);
            text.push_str(&format!(
                "; {} may be there only because {}, which no output tells, was held at {at}: start {1} elsewhere",
                p.name, scaling.held
            ));
        }
    }
    Some(text)
}

/// Why there are no standard errors.
fn no_errors(problem: &dyn Transcribed, xi: &[f64], why: NoInformation, limit: &Interrupt) -> String {
    let why = match (limit.cause(), why) {
        (Some(Cause::Stopped), NoInformation::Stopped) => {
            return "interrupted: there are no standard errors; to continue, start an estimation from this fit"
                .into();
        }
        (_, NoInformation::Stopped) => {
            return "time limit: there are no standard errors; allow more time, or continue from this fit"
                .into();
        }
        (_, NoInformation::NotFinite) => {
            problem.explain(xi).unwrap_or_else(|| "a derivative of the model is not finite".into())
        }
        (_, NoInformation::Singular(KktError::Dependent { row })) => {
            format!("the {} depends linearly on others", problem.constraint_name(row))
        }
        (_, other) => other.to_string(),
    };
    format!("the standard errors could not be computed: {why}")
}

/// The covariance of the parameters as a user knows them, in place: that of the noise by the delta method.
pub(crate) fn noise_covariance(reported: &[Reported], n_model: usize, n: usize, covariance: &mut [f64]) {
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

/// For each parameter, what keeps it where it is. A bound other than zero is its own measure, so that units do not matter;
/// one of zero is measured by the other.
fn active_bounds(
    problem: &dyn Transcribed,
    xi: &[f64],
    interior: bool,
) -> IndexVec<VariableId, Option<Bound>> {
    let (lower, upper) = problem.bounds();
    let part = if interior { NEAR_BOUND } else { AT_BOUND };
    let at = |i: usize, bound: f64, other: f64| {
        let size = if interior && bound == 0.0 { other.abs().min(1.0) } else { bound.abs() };
        bound.is_finite() && (xi[i] - bound).abs() <= part * size
    };
    let active = |i: usize| match (at(i, lower[i], upper[i]), at(i, upper[i], lower[i])) {
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
    e: ExperimentId,
) -> Record {
    let layout = problem.layout();
    let first = layout.first_point[e];
    let outputs = problem.outputs_at_samples(xi, e);
    let residual = |(z, y): (&Vec<f64>, &Vec<f64>)| z.iter().zip(y).map(|(z, y)| z - y).collect();
    let initial = |(i, s): (usize, &Variable)| {
        let at = layout.state(first) + i;
        let (name, unit) = (s.name.clone(), s.unit.clone());
        Estimate { name, unit, value: xi[at], std_error: errors[at], bounds: s.bounds(), bound: None }
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
