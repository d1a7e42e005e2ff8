//! A running test whether the model still holds, and what has changed where it does not.
//!
//! The statistic is that of Shiryaev and Roberts: the sum over all possible onsets of the likelihood ratio of the innovations since
//! then, of a change against none. While the model holds, each ratio has the mean 1, so that the sum minus the number of samples
//! is a martingale, and the mean number of samples until it exceeds A is at least A (M. Pollak, *Annals of Statistics* 13, 1985).
//! A mean of such statistics over several kinds of change has the same property. So the threshold is the mean number of samples
//! between false alarms itself, for Gaussian innovations and whatever the model is.

use std::sync::Arc;

use super::change::{Best, Changes};
use super::evidence::log_sum;
use super::gauss_newton::GaussNewton;
use super::innovation::Innovation;
use super::shift::Shifts;
use crate::setters::setters;

/// Settings of the test.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Detect {
    /// Mean number of samples between two false alarms, at least. At f Hz an hour has 3600 f of them.
    pub mean_samples: f64,
    /// Time from the first sample until the test begins, s: as long as estimates move from their start values, so do innovations.
    pub after: f64,
    /// Names of the parameters that may change.
    pub watch: Vec<String>,
    /// Possible onsets of a change of a parameter that are followed side by side.
    pub onsets: usize,
    /// Samples between two of them.
    pub spacing: usize,
    /// Standard deviation of a change, over the value of the parameter.
    pub change: f64,
}

impl Detect {
    /// A test with so many samples between two false alarms in the mean, or more.
    pub fn new(mean_samples: f64) -> Detect {
        Detect { mean_samples, after: 0.0, watch: Vec::new(), onsets: 20, spacing: 5, change: 0.5 }
    }

    setters! { after: f64, onsets: usize, spacing: usize, change: f64; }

    /// Adds a parameter that may change.
    #[must_use]
    pub fn watch(mut self, parameter: &str) -> Self {
        self.watch.push(parameter.to_owned());
        self
    }
}

/// What explains innovations best that the model does not.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Cause {
    /// The innovations of an output have another mean or are larger: nothing that is watched explains it better.
    Output {
        /// Name of the output.
        name: Arc<str>,
    },
    /// The innovations of several outputs are larger.
    Several,
    /// A parameter changed.
    Parameter {
        /// Its name.
        name: Arc<str>,
        /// The value before.
        before: f64,
        /// The change.
        change: f64,
        /// Its standard error.
        error: f64,
    },
}

/// The model no longer holds.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Alarm {
    /// Time from which on it does not, as far as can be said, s.
    pub since: f64,
    /// Time of the sample at which that was noticed, s.
    pub noticed: f64,
    /// The most likely cause.
    pub cause: Cause,
    /// Part of the statistic that belongs to this kind of change: 1 where no other one explains anything.
    pub share: f64,
}

/// The state of the test.
#[derive(Debug)]
pub(super) struct Detector {
    /// Logarithm of the statistic at which there is an alarm.
    threshold: f64,
    /// Logarithms of the weights of a shift and of a change of a parameter.
    weights: [f64; 2],
    begin: f64,
    after: f64,
    pub(super) shifts: Shifts,
    pub(super) changes: Changes,
    pub(super) alarm: Option<Alarm>,
    /// The largest logarithm of the statistic since the alarm.
    most: f64,
    outputs: Vec<Arc<str>>,
    watched: Vec<Arc<str>>,
}

impl Detector {
    /// For these outputs, watched parameters with their places among the estimated ones, and n of m unknowns that are states.
    pub(super) fn new(
        detect: &Detect,
        outputs: Vec<Arc<str>>,
        watched: Vec<(Arc<str>, usize)>,
        n: usize,
        m: usize,
    ) -> Detector {
        let (names, places): (Vec<Arc<str>>, Vec<usize>) = watched.into_iter().unzip();
        let shifts = Shifts::new(outputs.len());
        // Half of the weight is that of shifts, half that of watched parameters; kinds of each count alike.
        let half = if names.is_empty() { 1.0 } else { 0.5 };
        let weights = [half / shifts.kinds() as f64, half / names.len().max(1) as f64].map(f64::ln);
        Detector {
            weights,
            threshold: detect.mean_samples.ln(),
            begin: f64::NAN,
            after: detect.after,
            shifts,
            changes: Changes::new(detect, places, n, m, outputs.len()),
            alarm: None,
            most: f64::NEG_INFINITY,
            outputs,
            watched: names,
        }
    }

    /// Forgets all evidence, as at the beginning.
    pub(super) fn reset(&mut self) {
        self.shifts.reset();
        self.changes.reset();
        self.alarm = None;
        self.most = f64::NEG_INFINITY;
    }

    /// Takes the innovations of a sample at time t, after a pass forward.
    pub(super) fn update(&mut self, solver: &mut GaussNewton, innovation: &Innovation, sample: Sampled<'_>) {
        if self.begin.is_nan() {
            self.begin = sample.t;
        }
        if sample.t - self.begin < self.after {
            return;
        }
        self.shifts.update(&solver.present, innovation, sample.t);
        self.changes.update(solver, innovation, sample);
        let statistics = [self.shifts.statistic(), self.changes.statistic()];
        let weighted = |k: usize, statistic: f64| statistic + self.weights[k];
        let total = log_sum((0..2).map(|k| weighted(k, statistics[k])));
        if total < self.threshold && self.alarm.is_none() {
            return;
        }
        let (shift, change) = (self.shifts.best(), self.changes.best());
        let own =
            [weighted(0, shift.statistic), change.map_or(f64::NEG_INFINITY, |c| weighted(1, c.statistic))];
        let cause = match change {
            Some(Best { watched, before, change, error, .. }) if own[1] >= own[0] => {
                Cause::Parameter { name: self.watched[watched].clone(), before, change, error }
            }
            _ => match shift.output {
                Some(c) => Cause::Output { name: self.outputs[c].clone() },
                None => Cause::Several,
            },
        };
        let is_change = matches!(cause, Cause::Parameter { .. });
        let since = if is_change { change.map_or(sample.t, |c| c.since) } else { shift.since };
        let share = (own[usize::from(is_change)] - total).exp();
        match &mut self.alarm {
            None => self.alarm = Some(Alarm { since, noticed: sample.t, cause, share }),
            // Later samples tell changes of parameters apart. What is wrong with an output is seen best at first, as an estimator
            // follows what it is shown.
            Some(alarm) if is_change && total > self.most && since <= alarm.noticed => {
                (alarm.since, alarm.cause, alarm.share) = (since, cause, share);
            }
            Some(_) => return,
        }
        self.most = total;
    }
}

/// What a detector sees of a sample beside its innovations.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sampled<'a> {
    pub(super) t: f64,
    /// Time of the sample before, s.
    pub(super) before: f64,
    /// Parameters that are estimated.
    pub(super) theta: &'a [f64],
    /// Number of the segment that leads to the sample.
    pub(super) segment: Option<usize>,
}
