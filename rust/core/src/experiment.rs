//! One record of measured inputs and outputs.

use std::collections::HashSet;

use crate::error::{Error, did_you_mean};
use crate::interpolate::{Interpolant, Interpolation, derivative, interpolate};
use crate::model::Model;

/// One record. Channels stand in the order of the model's inputs ([`Model::input_names`]) and outputs.
///
/// ```
/// use phugoid::{Experiment, Interpolation, Model, Parameter};
///
/// let mut m = Model::new("lag");
/// let (x, u) = (m.state("x", "")?, m.input("u", "")?);
/// let tau = m.parameter(Parameter::new("tau", 1.0))?;
/// m.equation("x", (u - &x) / tau)?;
/// m.output("y", x, "")?;
///
/// // By name, in any order; NaN where a sample is missing.
/// let (t, u, y) = (vec![0.0, 0.1, 0.2], vec![1.0; 3], vec![0.0, f64::NAN, 0.3]);
/// let mut run = Experiment::new(&m, "run 1", t.clone(), [("y", y), ("u", u.clone())])?;
/// run.interpolation = Interpolation::Cubic; // inputs between samples: straight lines unless said
///
/// let error = Experiment::new(&m, "run 2", t, [("u", u)]).unwrap_err();
/// assert_eq!(error.to_string(), "experiment 'run 2': it has no channel 'y'");
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Experiment {
    /// Name, for messages.
    pub name: String,
    /// Sample times, s, strictly increasing, N of them.
    pub t: Vec<f64>,
    /// Inputs, n_u channels of N samples.
    pub inputs: Vec<Vec<f64>>,
    /// Measured outputs, n_y channels of N samples; NaN where a sample is missing.
    pub outputs: Vec<Vec<f64>>,
    /// The behaviour of inputs between samples, unless [`Signal::interpolation`] differs for one.
    pub interpolation: Interpolation,
    /// Inputs that were sampled at times of their own, that behave otherwise between samples, or of which something
    /// else is wanted: by input, or empty for none.
    pub signals: Vec<Option<Signal>>,
}

/// An input sampled at times of its own, how it behaves between them, and what is taken of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Signal {
    /// Its sample times, s, strictly increasing.
    pub t: Vec<f64>,
    /// Its samples.
    pub values: Vec<f64>,
    /// Time by which it is delayed, s.
    pub delay: f64,
    /// The order of the derivative with respect to time that is taken: 0 for none, to 2.
    pub derivative: usize,
    /// The behaviour between its samples; `None` for that of all inputs of the record.
    pub interpolation: Option<Interpolation>,
}

impl Signal {
    /// Returns the values at these times; `kind` is the behaviour of all inputs of the record between samples.
    pub fn at(&self, kind: Interpolation, times: &[f64]) -> Vec<f64> {
        let kind = self.interpolation.unwrap_or(kind);
        let earlier: Vec<f64> = times.iter().map(|t| t - self.delay).collect();
        match self.derivative {
            0 => interpolate(kind, &self.t, &self.values, &earlier),
            order => derivative(kind, &self.t, &self.values, &earlier, order),
        }
    }

    /// Returns the samples of a held signal, with the times from which its values hold.
    fn held(&self) -> (Vec<f64>, Vec<f64>) {
        let mut t: Vec<f64> = self.t.iter().map(|t| t + self.delay).collect();
        if self.derivative == 0 {
            return (t, self.values.clone());
        }
        let middles: Vec<f64> = self.t.windows(2).map(|w| 0.5 * (w[0] + w[1])).collect();
        let mut values = derivative(Interpolation::Hold, &self.t, &self.values, &middles, self.derivative);
        // Nothing changes before the first sample and after the last.
        values.insert(0, 0.0);
        values.push(0.0);
        t.insert(0, t[0] - 1.0);
        (t, values)
    }
}

impl Experiment {
    /// A record for a model, from channels by name. A channel serves an input and an output of its name.
    ///
    /// # Errors
    /// For a channel that the model does not have or that is not there, and as [`Experiment::check`].
    pub fn new<'a>(
        model: &Model,
        name: &str,
        t: Vec<f64>,
        channels: impl IntoIterator<Item = (&'a str, Vec<f64>)>,
    ) -> Result<Self, Error> {
        let inputs = model.input_names();
        let outputs: Vec<&str> = model.outputs.iter().map(|e| e.name.as_str()).collect();
        let channels: Vec<(&str, Vec<f64>)> = channels.into_iter().collect();
        let fail = |text: String| Error::data(format!("experiment '{name}': {text}")).about(name);
        let known = || inputs.iter().chain(&outputs).copied();
        if let Some((other, _)) = channels.iter().find(|c| !known().any(|k| k == c.0)) {
            let hint = did_you_mean(other, known());
            return Err(fail(format!("the model has no input or output '{other}'.{hint}")));
        }
        if let Some(k) = (1..channels.len()).find(|&k| channels[..k].iter().any(|c| c.0 == channels[k].0)) {
            return Err(fail(format!("channel '{}' is given twice", channels[k].0)));
        }
        let find = |wanted: &&str| {
            let found = channels.iter().find(|c| c.0 == *wanted).map(|c| c.1.clone());
            found.ok_or_else(|| fail(format!("it has no channel '{wanted}'")))
        };
        let experiment = Experiment {
            name: name.to_owned(),
            t,
            inputs: inputs.iter().map(find).collect::<Result<_, _>>()?,
            outputs: outputs.iter().map(find).collect::<Result<_, _>>()?,
            interpolation: Interpolation::Linear,
            signals: Vec::new(),
        };
        experiment.check(&inputs, &outputs)?;
        Ok(experiment)
    }

    /// A record of inputs alone, for a simulation; all outputs are missing.
    ///
    /// # Errors
    /// As [`Experiment::new`], for inputs.
    pub fn of_inputs<'a>(
        model: &Model,
        name: &str,
        t: Vec<f64>,
        channels: impl IntoIterator<Item = (&'a str, Vec<f64>)>,
    ) -> Result<Self, Error> {
        // A model without outputs asks for inputs only.
        let bare = Model { outputs: Vec::new(), ..model.clone() };
        let run = Experiment::new(&bare, name, t, channels)?;
        let missing = vec![f64::NAN; run.t.len()];
        Ok(Experiment { outputs: vec![missing; model.outputs.len()], ..run })
    }

    /// Returns the record with one input, by name, that behaves in its own way between its samples.
    ///
    /// # Errors
    /// For a name that is no input of the model.
    pub fn with_interpolation(
        mut self,
        model: &Model,
        input: &str,
        kind: Interpolation,
    ) -> Result<Self, Error> {
        let names = model.input_names();
        let Some(channel) = names.iter().position(|n| *n == input) else {
            let hint = did_you_mean(input, names);
            return Err(Error::data(format!("experiment '{}': it has no input '{input}'.{hint}", self.name))
                .about(&self.name)
                .about(input));
        };
        self.signals.resize(names.len().max(self.signals.len()), None);
        let mut signal = self.signal(channel);
        signal.interpolation = Some(kind);
        self.signals[channel] = Some(signal);
        Ok(self)
    }

    /// An input with its own samples, or those of the record.
    pub(crate) fn signal(&self, channel: usize) -> Signal {
        self.signals.get(channel).cloned().flatten().unwrap_or_else(|| Signal {
            t: self.t.clone(),
            values: self.inputs.get(channel).cloned().unwrap_or_default(),
            delay: 0.0,
            derivative: 0,
            interpolation: None,
        })
    }

    /// Returns the behaviour of an input between its samples.
    pub fn kind(&self, channel: usize) -> Interpolation {
        let own = self.signals.get(channel).and_then(|s| s.as_ref()?.interpolation);
        own.unwrap_or(self.interpolation)
    }

    /// Whether an input is held between its samples, and so may jump at them.
    pub fn is_held(&self, channel: usize) -> bool {
        self.kind(channel) == Interpolation::Hold
    }

    /// Whether any input is.
    pub fn any_held(&self) -> bool {
        (0..self.inputs.len()).any(|c| self.is_held(c))
    }

    /// Times within the record at which inputs that are held jump, in order.
    pub fn jumps(&self) -> Vec<f64> {
        let (first, last) = (self.t[0], self.t[self.t.len() - 1]);
        let mut all = Vec::new();
        for c in (0..self.inputs.len()).filter(|&c| self.is_held(c)) {
            let (t, values) = self.signal(c).held();
            let jumps = values.windows(2).zip(&t[1..]).filter(|(w, _)| w[0] != w[1]).map(|(_, t)| *t);
            all.extend(jumps.filter(|t| first < *t && *t < last));
        }
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    }

    /// Times of the samples and of the inputs' own within the record, in order, s: where inputs bend or jump.
    pub(crate) fn input_times(&self) -> Vec<f64> {
        let (first, last) = (self.t[0], self.t[self.t.len() - 1]);
        let own = self.signals.iter().flatten().flat_map(|s| s.t.iter().map(|t| t + s.delay));
        let mut all: Vec<f64> =
            self.t.iter().copied().chain(own).filter(|t| (first..=last).contains(t)).collect();
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    }

    /// An input at times each of which belongs to a span of time, such as a segment of a mesh or a step: where it is
    /// held, it is what it is inside that span, its mean where it jumps there.
    pub fn input_over(&self, channel: usize, times: &[f64], spans: &[[f64; 2]]) -> Vec<f64> {
        if !self.is_held(channel) {
            return self.input(channel, times);
        }
        let (t, values) = self.signal(channel).held();
        let held = Interpolant::new(Interpolation::Hold, &t, &values);
        let one = |(time, [begin, end]): (&f64, &[f64; 2])| {
            if begin < end { held.over(*begin, *end) } else { held.at(*time) }
        };
        times.iter().zip(spans).map(one).collect()
    }

    /// An input at any times. One that is held jumps to a sample's value at its time.
    pub fn input(&self, channel: usize, times: &[f64]) -> Vec<f64> {
        match self.signals.get(channel) {
            Some(Some(signal)) => signal.at(self.interpolation, times),
            _ => interpolate(self.interpolation, &self.t, &self.inputs[channel], times),
        }
    }

    /// Checks lengths, times and finiteness against the channel names, and that every output has a sample.
    ///
    /// # Errors
    /// Names the channel and the time at fault.
    pub fn check(&self, inputs: &[&str], outputs: &[&str]) -> Result<(), Error> {
        self.check_shapes(inputs, outputs)?;
        let empty = |c: &Vec<f64>| c.iter().all(|v| v.is_nan());
        match outputs.iter().zip(&self.outputs).find(|c| empty(c.1)) {
            Some((name, _)) => Err(Error::data(format!(
                "experiment '{}': output '{name}' has no samples (all NaN); take it out of the model",
                self.name
            ))
            .about(&self.name)
            .about(name)),
            None => Ok(()),
        }
    }

    /// Checks each of the experiments of a problem, and that no two have the same name.
    pub(crate) fn check_all(
        experiments: &[Experiment],
        inputs: &[&str],
        outputs: &[&str],
    ) -> Result<(), Error> {
        if let [single] = experiments {
            return single.check(inputs, outputs);
        }
        experiments.iter().try_for_each(|e| e.check_shapes(inputs, outputs))?;
        // What one experiment does not measure another may.
        for (c, name) in outputs.iter().enumerate() {
            let unmeasured = |e: &Experiment| e.outputs[c].iter().all(|v| v.is_nan());
            if !experiments.is_empty() && experiments.iter().all(unmeasured) {
                return Err(Error::data(format!(
                    "output '{name}' has no samples in any experiment (all NaN); take it out of the model"
                ))
                .about(name));
            }
        }
        let mut names = HashSet::new();
        match experiments.iter().find(|e| !names.insert(&e.name)) {
            Some(Experiment { name, .. }) => {
                Err(Error::data(format!("two experiments are called '{name}'; give each a name of its own"))
                    .about(name))
            }
            None => Ok(()),
        }
    }

    /// Checks a record of which no output need be measured.
    pub(crate) fn check_shapes(&self, inputs: &[&str], outputs: &[&str]) -> Result<(), Error> {
        let fail =
            |text: String| Err(Error::data(format!("experiment '{}': {text}", self.name)).about(&self.name));
        let n = self.t.len();
        if n < 2 {
            return fail(format!("it has {n} samples; at least 2 are needed"));
        }
        if let Some(i) = self.t.iter().position(|t| !t.is_finite()) {
            return fail(format!("time {i} is not finite"));
        }
        if let Some(i) = self.t.windows(2).position(|w| w[0] >= w[1]) {
            return fail(format!(
                "time does not increase from {} (sample {i}) to {}",
                self.t[i],
                self.t[i + 1]
            ));
        }
        if self.inputs.len() != inputs.len() || self.outputs.len() != outputs.len() {
            return fail(format!(
                "it has {} inputs and {} outputs, the model {} and {}",
                self.inputs.len(),
                self.outputs.len(),
                inputs.len(),
                outputs.len()
            ));
        }
        if !self.signals.is_empty() && self.signals.len() != inputs.len() {
            return fail(format!(
                "it has {} signals for {} inputs; give one each, or none",
                self.signals.len(),
                inputs.len()
            ));
        }
        for (name, signal) in inputs.iter().zip(&self.signals).filter_map(|(n, s)| Some((n, s.as_ref()?))) {
            let sound = !signal.t.is_empty()
                && signal.t.len() == signal.values.len()
                && signal.t.windows(2).all(|w| w[0] < w[1])
                && signal.t.iter().chain(&signal.values).chain([&signal.delay]).all(|v| v.is_finite())
                && signal.derivative <= 2;
            if !sound {
                return fail(format!(
                    "input '{name}': its own samples need finite, increasing times and as many finite values"
                ));
            }
        }
        let channels = inputs.iter().zip(&self.inputs).map(|c| (c, true));
        for ((name, channel), is_input) in
            channels.chain(outputs.iter().zip(&self.outputs).map(|c| (c, false)))
        {
            if channel.len() != n {
                return fail(format!("channel '{name}' has {} samples, time has {n}", channel.len()));
            }
            let wrong = |v: &f64| if is_input { !v.is_finite() } else { v.is_infinite() };
            if let Some(i) = channel.iter().position(wrong) {
                return fail(format!("channel '{name}' is {} at t = {} (sample {i})", channel[i], self.t[i]));
            }
        }
        Ok(())
    }
}
