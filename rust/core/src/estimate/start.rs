//! Where an estimation starts: parameters as declared, standard deviations at the spread of the
//! measurements, states as measured.

use super::Estimation;
use super::earlier::Earlier;
use crate::error::{Error, did_you_mean};
use crate::experiment::Experiment;
use crate::index::{ExperimentId, VariableId};
use crate::interpolate::{Interpolation, interpolate};
use crate::model::{Model, Parameter, Variable};
use crate::noise::SIGMA;
use crate::problem::Transcribed;

/// A starting value. It is made from a number, from the path of a state in the only experiment, or from
/// its paths in all of them.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Start {
    /// A number, for a state at all times.
    Value(f64),
    /// Paths of a state, one an experiment, each of one value a sample.
    Paths(Vec<Vec<f64>>),
}

impl From<f64> for Start {
    fn from(value: f64) -> Self {
        Start::Value(value)
    }
}

impl From<Vec<f64>> for Start {
    fn from(path: Vec<f64>) -> Self {
        Start::Paths(vec![path])
    }
}

impl From<Vec<Vec<f64>>> for Start {
    fn from(paths: Vec<Vec<f64>>) -> Self {
        Start::Paths(paths)
    }
}

/// A start may lie outside its bounds by this part of its size.
const AT_BOUND: f64 = 1e-9;

/// Part of its greatest value by which noise may take a state below zero, and which it then starts with at least.
const LITTLE_BELOW: f64 = 0.3;
const LEAST_LEVEL: f64 = 1e-3;
/// Where states are tried of which nothing is known, where the model has no finite derivatives at 0.
const ELSEWHERE: [f64; 4] = [1.0, 10.0, 0.1, -1.0];

/// Starting values of a model: given by name, else those of a fit, else as declared.
#[derive(Clone, Copy, Debug)]
pub struct Given<'a> {
    /// The model.
    pub model: &'a Model,
    /// Of two of one name the later one holds.
    pub values: &'a [(String, Start)],
    /// The fit to go on from.
    pub earlier: Option<&'a Earlier>,
}

impl<'a> Given<'a> {
    /// What is given for a name.
    pub fn of(&self, name: &str) -> Option<&'a Start> {
        self.values.iter().rev().find(|s| s.0 == name).map(|s| &s.1)
    }

    /// Checks that each name is one of the model, of an experiment's own parameters, or of the noise.
    ///
    /// # Errors
    /// For a name that is none.
    pub fn check<'b>(
        &self,
        experiments: impl Iterator<Item = &'b str> + Clone,
        noise: &[String],
    ) -> Result<(), Error> {
        let model = self.model;
        let parameters = model.parameters.iter().map(|p| p.name.clone());
        let sigmas = model.outputs.iter().map(|o| format!("{SIGMA}{}", o.name));
        let states = model.states.iter().map(|s| s.name.clone());
        let local = model.parameters.iter().filter(|p| p.local);
        let local = local.flat_map(|p| experiments.clone().map(|e| format!("{}[{e}]", p.name)));
        let known: Vec<String> =
            parameters.chain(sigmas).chain(noise.iter().cloned()).chain(states).chain(local).collect();
        match self.values.iter().find(|(name, _)| !known.contains(name)) {
            Some((name, _)) => {
                let hint = did_you_mean(name, known.iter().map(String::as_str));
                Err(Error::model(format!("start: '{name}' is not a parameter, sigma or state.{hint}"))
                    .about(name))
            }
            None => Ok(()),
        }
    }

    /// The start of a parameter that is declared to start at a value, with bounds.
    pub(super) fn value(&self, name: &str, declared: f64, bounds: (f64, f64)) -> Result<f64, Error> {
        let fail = |text: String| Err(Error::model(format!("start: '{name}' {text}")).about(name));
        match self.of(name) {
            Some(Start::Paths(_)) => fail("is a parameter: give one number".into()),
            Some(Start::Value(v)) if !v.is_finite() => fail(format!("is {v}, not a finite number")),
            // An estimate at a bound differs from it by the rounding of its transform.
            Some(Start::Value(v))
                if *v < bounds.0 - AT_BOUND * v.abs() || *v > bounds.1 + AT_BOUND * v.abs() =>
            {
                fail(format!("= {v:?} lies outside its bounds {bounds:?}; move one of them"))
            }
            Some(Start::Value(v)) => Ok(v.max(bounds.0).min(bounds.1)),
            None => {
                let fitted = self.earlier.and_then(|fit| fit.value(name));
                Ok(fitted.map_or(declared, |v| v.max(bounds.0).min(bounds.1)))
            }
        }
    }

    /// Starting values of the parameters of the model, those that each experiment has of its own as they are in this
    /// one.
    ///
    /// # Errors
    /// For values that are not finite, outside of bounds, or not that of a parameter that is fixed.
    pub fn parameters(&self, experiment: Option<&str>) -> Result<Vec<f64>, Error> {
        let one = |p: &Parameter| {
            let bounds = (p.lower.unwrap_or(f64::NEG_INFINITY), p.upper.unwrap_or(f64::INFINITY));
            let label = experiment.filter(|_| p.local).map(|e| format!("{}[{e}]", p.name));
            let own = label.as_deref().filter(|label| self.of(label).is_some());
            if let Some(Start::Value(v)) = self.of(own.unwrap_or(&p.name))
                && p.fixed
                && *v != p.start
            {
                return Err(Error::model(format!(
                    "start: '{}' is fixed at {:?} and cannot start at {v:?}",
                    p.name, p.start
                ))
                .about(&p.name));
            }
            let shared = self.value(&p.name, p.start, bounds)?;
            let shared = if p.fixed { p.start } else { shared };
            match label.filter(|_| !p.fixed) {
                Some(label) => self.value(&label, shared, bounds),
                None => Ok(shared),
            }
        };
        self.model.parameters.iter().map(one).collect()
    }

    /// Starting states of the experiment of this number at some times, `[state][time]`: as given, else the path of the
    /// fit, else as measured, else as declared ([`Variable::start`](crate::model::Variable), or an initial condition that
    /// depends on parameters alone), else as an output has it that measures it beside others, else 0; within the bounds of
    /// the states. `parameters` holds those of the experiment.
    ///
    /// # Errors
    /// For a path that is not one finite value a sample.
    pub fn states(
        &self,
        index: usize,
        experiment: &Experiment,
        times: &[f64],
        parameters: &[f64],
    ) -> Result<Vec<Vec<f64>>, Error> {
        let measured = self.model.measured_states(parameters);
        let declared = self.model.declared_paths(parameters);
        let (t, name) = (&experiment.t, &experiment.name);
        let at_times = |t: &[f64], x: &[f64]| interpolate(Interpolation::Linear, t, x, times);
        let path = |(i, state): (usize, &Variable)| {
            let fitted = self.earlier.and_then(|fit| fit.path(index, &state.name));
            let path = match (self.of(&state.name), fitted, &measured[i]) {
                (Some(Start::Value(v)), ..) if v.is_finite() => vec![*v; times.len()],
                (Some(Start::Paths(paths)), ..)
                    if paths
                        .get(index)
                        .is_some_and(|p| p.len() == t.len() && p.iter().all(|x| x.is_finite())) =>
                {
                    at_times(t, &paths[index])
                }
                (Some(_), ..) => {
                    return Err(Error::data(format!(
                        "start: state '{}' takes a finite number, or for each experiment a path of one finite number a \
                         sample ({} for '{name}')",
                        state.name,
                        t.len(),
                    )).about(&state.name).about(name));
                }
                (None, Some((t, x)), _) => interpolate(Interpolation::Cubic, t, x, times),
                (None, None, m) => match m.as_ref().map(|m| m.samples(experiment)) {
                    Some((t, x)) if !t.is_empty() => at_times(&t, &x),
                    _ => match declared[i] {
                        Some(v) => vec![v; times.len()],
                        None => return Ok(None),
                    },
                },
            };
            Ok(Some(path))
        };
        let states = &self.model.states;
        let mut paths: Vec<Option<Vec<f64>>> =
            states.iter().enumerate().map(path).collect::<Result<_, Error>>()?;
        let outputs = if paths.iter().any(Option::is_none) { self.model.expanded().1 } else { Vec::new() };
        // Where one shot ends and the next one begins are two points of one time, and rounding may make it an earlier one.
        let mut distinct: Vec<usize> = Vec::new();
        for k in 0..times.len() {
            if distinct.last().is_none_or(|&last| times[k] > times[last]) {
                distinct.push(k);
            }
        }
        let distinct_times: Vec<f64> = distinct.iter().map(|&k| times[k]).collect();
        // One that is found may tell of another.
        while !outputs.is_empty() {
            let at_samples = |p: &Option<Vec<f64>>| {
                let x: Vec<f64> =
                    distinct.iter().map(|&k| p.as_ref().map(|p| p[k])).collect::<Option<_>>()?;
                Some(interpolate(Interpolation::Linear, &distinct_times, &x, &experiment.t))
            };
            let known: Vec<Option<Vec<f64>>> = paths.iter().map(at_samples).collect();
            let found = |i: usize| {
                let samples = self.model.measured_beside_others(&outputs, i, experiment, parameters, &known);
                samples.map(|s| (i, s))
            };
            let mut unknown = (0..states.len()).filter(|&i| paths[i].is_none());
            let Some((i, (t, x))) = unknown.find_map(found) else { break };
            paths[i] = Some(at_times(&t, &x));
        }
        let within = |(path, state): (Option<Vec<f64>>, &Variable)| {
            let (lower, upper) = state.bounds();
            let path = path.unwrap_or_else(|| vec![0.0; times.len()]);
            path.into_iter().map(|x| x.max(lower).min(upper)).collect()
        };
        Ok(paths.into_iter().zip(states).map(within).collect())
    }

    /// For each state, whether it is known where it starts: given, measured or declared.
    fn known(&self, parameters: &[f64]) -> Vec<bool> {
        let measured = self.model.measured_states(parameters);
        let declared = self.model.declared_paths(parameters);
        let states = self.model.states.iter().zip(measured).zip(declared);
        states.map(|((s, m), d)| m.is_some() || d.is_some() || self.of(&s.name).is_some()).collect()
    }

    /// The points to start from in place of `xi`, where that makes no sense: states that are neither given nor measured
    /// nor declared start at 0, where a square root has no derivative, and which may be outside of their bounds. In these
    /// points they start at each of a few values at which all is finite. Empty where `xi` does, or where nothing helps.
    pub fn elsewhere(&self, problem: &dyn Transcribed, xi: &[f64], parameters: &[f64]) -> Vec<Vec<f64>> {
        let known = self.known(parameters);
        // A path that an output gives varies.
        let is_constant = |i: &usize| {
            let mut path = xi[problem.layout().n_theta..].iter().skip(*i).step_by(known.len());
            let first = path.next();
            path.all(|x| Some(x) == first)
        };
        let unknown: Vec<usize> = (0..known.len()).filter(|&i| !known[i]).filter(is_constant).collect();
        let bounds: Vec<(f64, f64)> = self.model.states.iter().map(Variable::bounds).collect();
        let inside = unknown.iter().all(|&i| bounds[i].0 < 0.0 && 0.0 < bounds[i].1);
        let finite = is_finite(problem, xi);
        if finite && inside {
            return Vec::new();
        }
        let mut found: Vec<Vec<f64>> = Vec::new();
        if !finite {
            found.extend(without_noise_below_zero(problem, xi).filter(|trial| is_finite(problem, trial)));
        }
        for value in if unknown.is_empty() { &[] } else { ELSEWHERE.as_slice() }.iter().copied() {
            let mut trial = xi.to_vec();
            for states in trial[problem.layout().n_theta..].chunks_exact_mut(known.len()) {
                unknown.iter().for_each(|&i| states[i] = value.max(bounds[i].0).min(bounds[i].1));
            }
            if !found.contains(&trial) && is_finite(problem, &trial) {
                found.push(trial);
            }
        }
        found
    }
}

/// Variables whose states that are above zero but for little are so everywhere: noise takes a measured level or concentration
/// below zero, where its root or logarithm is not defined. None where there is no such state.
fn without_noise_below_zero(problem: &dyn Transcribed, xi: &[f64]) -> Option<Vec<f64>> {
    let (first, n_x) = (problem.layout().n_theta, problem.layout().n_x);
    let mut found = xi.to_vec();
    for i in 0..n_x {
        let path = || xi[first + i..].iter().step_by(n_x);
        let (low, high) = path().fold((0.0_f64, 0.0_f64), |(low, high), &x| (low.min(x), high.max(x)));
        if -low < LITTLE_BELOW * high {
            let least = LEAST_LEVEL * high;
            found[first + i..].iter_mut().step_by(n_x).for_each(|x| *x = x.max(least));
        }
    }
    (found != xi).then_some(found)
}

/// Whether functions and first derivatives are finite.
fn is_finite(problem: &dyn Transcribed, xi: &[f64]) -> bool {
    let mut defects = vec![0.0; problem.m()];
    let mut gradient = vec![0.0; problem.n()];
    let mut jacobian = vec![0.0; problem.jacobian_structure().len()];
    problem.objective(xi).is_ok()
        && problem.constraints(xi, &mut defects).is_ok()
        && problem.jacobian(xi, &mut jacobian).is_ok()
        && problem.gradient(xi, &mut gradient).is_ok()
}

impl Estimation<'_> {
    pub(super) fn given(&self) -> Given<'_> {
        Given { model: self.model, values: &self.start, earlier: self.earlier.as_deref() }
    }

    pub(super) fn parameters(&self) -> Result<Vec<f64>, Error> {
        self.given().parameters(None)
    }

    /// Whether all states are measured or given, so that a regression on them makes sense.
    pub(super) fn states_known(&self) -> bool {
        let measured = self.model.measured_states(&self.parameters().unwrap_or_default());
        let given = self.given();
        self.model.states.iter().zip(&measured).all(|(s, m)| m.is_some() || given.of(&s.name).is_some())
    }

    /// Parameters, precision roots of the noise, states at all points.
    pub(super) fn starting_point(&self, problem: &dyn Transcribed) -> Result<Vec<f64>, Error> {
        let given = self.given();
        let own = self.experiments.iter().map(|e| given.parameters(Some(&e.name)));
        let own: Vec<Vec<f64>> = own.collect::<Result<_, _>>()?;
        let shared = given.parameters(None)?;
        point(problem, &shared, &own, |ExperimentId(e), times| {
            given.states(e, &self.experiments[e], times, &own[e])
        })
    }
}

/// The variables of a problem whose parameters start at these values, `shared` by all experiments or each experiment's
/// `own`, and whose states are those of an experiment at some times.
pub fn point(
    problem: &dyn Transcribed,
    shared: &[f64],
    own: &[Vec<f64>],
    states: impl Fn(ExperimentId, &[f64]) -> Result<Vec<Vec<f64>>, Error>,
) -> Result<Vec<f64>, Error> {
    let posed = problem.posed();
    let mut xi = Vec::with_capacity(problem.n());
    for (i, p) in posed.parameters.numbered() {
        xi.push(if i.0 >= posed.n_model_parameters {
            p.start
        } else {
            let values = posed.estimands.experiment[i].map_or(shared, |e| &own[e.0]);
            posed.estimands.transforms[i].inverse(values[posed.estimands.parameter[i].0])
        });
    }
    xi.resize(problem.n(), 0.0);
    let n_x = problem.layout().n_x;
    for e in (0..own.len()).map(ExperimentId) {
        let VariableId(first) = problem.layout().state(problem.layout().first_point[e]);
        for (i, path) in states(e, problem.point_times(e))?.iter().enumerate() {
            path.iter().zip(xi[first + i..].iter_mut().step_by(n_x)).for_each(|(x, to)| *to = *x);
        }
    }
    Ok(xi)
}
