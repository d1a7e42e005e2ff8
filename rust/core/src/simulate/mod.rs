//! Simulation of a model for given parameters, by integration.

mod flow;
mod path;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

pub use crate::integrate::Method;
pub use path::Path;

use crate::condition::End;
use crate::error::{Error, did_you_mean};
use crate::experiment::{Experiment, Signal};
use crate::interrupt::Interrupt;
use crate::model::{Model, TIME};
use crate::noise::SIGMA;
use flow::Flow;

/// A simulation over the inputs of a record, as it is put together.
///
/// The initial states are those given, else those of the fit for an experiment of this name, else what the model's
/// initial conditions say, else as measured at the first sample that has a value, else 0. Delays are those of the
/// model itself: a late input is the input moved, a late output that of a time before, NaN where it reaches back
/// beyond the first sample.
///
/// ```
/// use phugoid::{Experiment, Model, Parameter, Simulation};
///
/// let mut m = Model::new("lag");
/// let (x, u) = (m.state("x", "")?, m.input("u", "")?);
/// let tau = m.parameter(Parameter::new("tau", 1.0))?;
/// m.equation("x", (u - &x) / tau)?;
/// m.output("y", x, "")?;
///
/// let t: Vec<f64> = (0..11).map(|k| 0.1 * k as f64).collect();
/// let run = Experiment::of_inputs(&m, "step", t, [("u", vec![1.0; 11])])?;
/// let path = Simulation::new(&m, &run).parameter("tau", 0.5).initial("x", 0.0).run()?;
/// assert!((path.output("y").unwrap()[10] - (1.0 - (-2.0f64).exp())).abs() < 1e-8);
///
/// let error = Simulation::new(&m, &run).run().unwrap_err();
/// assert_eq!(error.to_string(), "simulate: no value was given for tau");
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Simulation<'a> {
    model: &'a Model,
    pub(crate) experiment: &'a Experiment,
    /// Parameters and initial states of a fit, which those given go before.
    pub(crate) known: Vec<(String, f64)>,
    pub(crate) known_initial: Vec<(String, f64)>,
    parameters: Vec<(String, f64)>,
    initial: Vec<(String, f64)>,
    tolerance: f64,
    method: Method,
    time_limit: Option<Duration>,
    slopes: bool,
}

impl<'a> Simulation<'a> {
    /// Prepares the simulation of a model over the inputs of a record.
    pub fn new(model: &'a Model, experiment: &'a Experiment) -> Self {
        let (parameters, initial) = (Vec::new(), Vec::new());
        Simulation {
            model,
            experiment,
            known: Vec::new(),
            known_initial: Vec::new(),
            parameters,
            initial,
            tolerance: 1e-9,
            method: Method::Automatic,
            time_limit: None,
            slopes: false,
        }
    }

    /// The value of a parameter; `name[experiment]` is that of one experiment.
    pub fn parameter(mut self, name: &str, value: f64) -> Self {
        self.parameters.push((name.to_owned(), value));
        self
    }

    /// A state at the first sample.
    pub fn initial(mut self, state: &str, value: f64) -> Self {
        self.initial.push((state.to_owned(), value));
        self
    }

    /// Relative tolerance of the integration, 1e-9 unless said.
    pub fn tolerance(mut self, tolerance: f64) -> Self {
        self.tolerance = tolerance;
        self
    }

    /// Sets the integration method, [`Method::Automatic`] unless set.
    pub fn method(mut self, method: Method) -> Self {
        self.method = method;
        self
    }

    /// Sets the greatest time that the integration may take.
    pub fn time_limit(mut self, limit: Duration) -> Self {
        self.time_limit = Some(limit);
        self
    }

    /// Keeps the slopes of the states at both ends of each interval between samples.
    pub(crate) fn with_slopes(mut self) -> Self {
        self.slopes = true;
        self
    }

    /// Integrates, interval by interval between the times at which inputs bend, with control of the step: by Dormand
    /// and Prince's method of order 8, and from where that is stiff by Radau IIA of order 5.
    ///
    /// # Errors
    /// For missing or unknown parameters and states, a wrong tolerance, inputs that cannot be used, and where the
    /// solution ceases to exist or an output is not finite, with the time; but for samples at which an output that the
    /// experiment has is missing.
    pub fn run(&self) -> Result<Path, Error> {
        let (model, run) = (self.model, self.experiment);
        model.check()?;
        if !(self.tolerance > 0.0 && self.tolerance < 1.0) {
            let tolerance = self.tolerance;
            return Err(Error::option(format!(
                "simulate: tolerance {tolerance} is not a number between 0 and 1"
            )));
        }
        let outputs: Vec<&str> = model.outputs.iter().map(|o| o.name.as_str()).collect();
        run.check_shapes(&model.input_names(), &outputs)?;
        let rate = |s: &Option<Signal>| s.as_ref().is_some_and(|s| s.derivative > 0);
        if let Some((name, _)) = model.input_names().iter().zip(&run.signals).find(|s| rate(s.1)) {
            return Err(Error::data(format!(
                "experiment '{}': input '{name}' is a derivative of its samples, which may jump there; a simulation \
                 takes inputs themselves",
                run.name
            )).about(&run.name).about(name));
        }
        let parameters = self.values()?;
        let first = self.first_states(&parameters)?;
        let delays: HashMap<&str, f64> =
            model.parameters.iter().zip(&parameters).map(|(p, v)| (p.name.as_str(), *v)).collect();
        let mut flow = Flow::new(model, run, &parameters, &delays)?;
        let limit = Interrupt::within(self.time_limit);
        limit.run(|| flow.path(&first, self.tolerance, self.method, self.slopes))
    }

    /// Values of the model's parameters, in their order.
    fn values(&self) -> Result<Vec<f64>, Error> {
        let (model, run) = (self.model, self.experiment);
        let names = || model.parameters.iter().map(|p| p.name.as_str());
        let own = |name: &str| format!("{name}[{}]", run.name);
        for (name, value) in &self.parameters {
            let of_one = name.split_once('[').is_some_and(|(stem, rest)| {
                rest.ends_with(']') && model.parameters.iter().any(|p| p.local && p.name == stem)
            });
            if !names().any(|n| n == name) && !of_one && !name.starts_with(SIGMA) {
                let hint = did_you_mean(name, names());
                return Err(Error::model(format!("simulate: '{name}' is not a parameter.{hint}")).about(name));
            }
            if !value.is_finite() {
                let text = format!("simulate: parameter '{name}' is {value}, not a finite number");
                return Err(Error::model(text));
            }
        }
        let given = |name: &str| self.parameters.iter().rev().find(|p| p.0 == name).map(|p| p.1);
        let fitted = |name: &str| self.known.iter().find(|p| p.0 == name).map(|p| p.1);
        let value = |p: &crate::model::Parameter| {
            let local = if p.local { given(&own(&p.name)) } else { None };
            let of_fit = || if p.local { fitted(&own(&p.name)) } else { None };
            local.or_else(|| given(&p.name)).or_else(of_fit).or_else(|| fitted(&p.name))
        };
        let found: Vec<Option<f64>> = model.parameters.iter().map(value).collect();
        let missing = names().zip(&found).filter(|f| f.1.is_none()).map(|f| f.0);
        let missing: Vec<&str> = missing.collect();
        if !missing.is_empty() {
            let missing = missing.join(", ");
            return Err(Error::model(format!("simulate: no value was given for {missing}")));
        }
        Ok(found.into_iter().flatten().collect())
    }

    fn first_states(&self, parameters: &[f64]) -> Result<Vec<f64>, Error> {
        let (model, run) = (self.model, self.experiment);
        let names = || model.states.iter().map(|s| s.name.as_str());
        for (name, value) in &self.initial {
            if !names().any(|n| n == name) {
                let hint = did_you_mean(name, names());
                return Err(
                    Error::model(format!("simulate: initial '{name}' is not a state.{hint}")).about(name)
                );
            }
            if !value.is_finite() {
                return Err(Error::model(format!(
                    "simulate: initial '{name}' is {value}, not a finite number"
                ))
                .about(name));
            }
        }
        let said = |name: &str| {
            let given = self.initial.iter().rev().find(|s| s.0 == name).map(|s| s.1);
            given.or_else(|| self.known_initial.iter().find(|s| s.0 == name).map(|s| s.1))
        };
        let measured = model.measured_states(parameters);
        let start = |(name, m): (&str, &Option<crate::measured::Measured>)| {
            let as_measured = || m.as_ref().and_then(|m| m.samples(run).1.first().copied());
            said(name).or_else(as_measured).unwrap_or(0.0)
        };
        let mut found: Vec<f64> = names().zip(&measured).map(start).collect();
        let inputs = first_inputs(model, run, parameters);
        let quantities = model.definitions();
        for c in model.conditions.iter().filter(|c| c.end == End::Initial && said(&c.state).is_none()) {
            let mut numbers: HashMap<Arc<str>, f64> = HashMap::from([(TIME.into(), run.t[0])]);
            numbers
                .extend(model.parameters.iter().zip(parameters).map(|(p, v)| (p.name.as_str().into(), *v)));
            numbers.extend(names().map(Arc::from).zip(found.iter().copied()));
            numbers.extend(inputs.iter().map(|(name, v)| (Arc::from(*name), *v)));
            let value = c.expr.substitute(&quantities).evaluate(&numbers).map_err(|symbol| {
                Error::model(format!("simulate: the initial condition of {} has no '{symbol}'", c.state))
                    .about(&symbol)
            })?;
            let place = names().position(|n| n == c.state).expect("conditions are of states");
            found[place] = value;
        }
        Ok(found)
    }
}

/// Inputs of the model at the first sample, late ones as they are then.
fn first_inputs<'a>(model: &'a Model, run: &Experiment, parameters: &[f64]) -> Vec<(&'a str, f64)> {
    let names = model.input_names();
    let value = |name: &str| {
        let place = model.parameters.iter().position(|p| p.name == name).expect("a delay is a parameter");
        parameters[place]
    };
    let one = |input: &'a crate::model::Variable| {
        let (of, by) = match model.delays.input(&input.name) {
            Some(late) => (late.of.as_str(), value(&late.by)),
            None => (input.name.as_str(), 0.0),
        };
        let place = names.iter().position(|n| *n == of).expect("a late input is one of the model's");
        (input.name.as_str(), run.input(place, &[run.t[0] - by])[0])
    };
    model.inputs.iter().map(one).collect()
}
