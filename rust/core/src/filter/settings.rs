//! Assumptions on the process noise.

use crate::error::{Error, did_you_mean};

/// Assumptions on the process noise.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Names of the states that have it.
    pub states: Vec<String>,
    /// Runge-Kutta steps between samples.
    pub substeps: usize,
    /// Terms of the noise of each state within an interval, from 1.
    pub terms: usize,
    /// For each state of the model the mean and standard deviation of its first value, infinite for a flat prior of
    /// density 1; or `None` to maximise over it.
    pub initial: Vec<Option<(f64, f64)>>,
}

impl Settings {
    /// Numbers of the states that have it, among those of a model.
    pub(super) fn noisy(&self, states: &[String]) -> Result<Vec<usize>, Error> {
        let fail = |text: String| Err(Error::option(format!("FilterError: {text}")));
        if self.states.is_empty() {
            return fail("states is empty; name the states that process noise drives".into());
        }
        if self.substeps == 0 {
            return fail("substeps must be at least 1".into());
        }
        if self.terms == 0 {
            return fail("terms must be at least 1".into());
        }
        for (name, count, most) in [("substeps", self.substeps, 10_000), ("terms", self.terms, 100)] {
            if count > most {
                return fail(format!("{name} is {count}; at most {most}"));
            }
        }
        if self.initial.len() != states.len() {
            return fail(format!("initial has {} states, the model {}", self.initial.len(), states.len()));
        }
        let mut found = Vec::new();
        for name in &self.states {
            let Some(i) = states.iter().position(|s| s == name) else {
                let hint = did_you_mean(name, states.iter().map(String::as_str));
                return fail(format!("'{name}' is not a state.{hint}"));
            };
            if found.contains(&i) {
                return fail(format!("state '{name}' is named twice"));
            }
            found.push(i);
        }
        for (name, prior) in states.iter().zip(&self.initial) {
            let sound = |&(mean, std): &(f64, f64)| mean.is_finite() && std > 0.0;
            if prior.is_some() && !prior.as_ref().is_some_and(sound) {
                return fail(format!("initial '{name}' is not a mean and a positive standard deviation"));
            }
        }
        Ok(found)
    }
}
