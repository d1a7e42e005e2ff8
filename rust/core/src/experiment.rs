//! One record of measured inputs and outputs.

use crate::error::Error;
use crate::interpolate::Interpolation;

/// One record. Channels stand in the order of the model's inputs and outputs.
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
    /// How inputs behave between samples.
    pub interpolation: Interpolation,
}

impl Experiment {
    /// Checks lengths, times and finiteness against the channel names.
    ///
    /// # Errors
    /// Names the channel and the time at fault.
    pub fn check(&self, inputs: &[&str], outputs: &[&str]) -> Result<(), Error> {
        let fail = |text: String| Err(Error::Data(format!("experiment '{}': {text}", self.name)));
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
        let channels = inputs.iter().zip(&self.inputs).map(|c| (c, true));
        for ((name, channel), is_input) in
            channels.chain(outputs.iter().zip(&self.outputs).map(|c| (c, false)))
        {
            if channel.len() != n {
                return fail(format!("channel '{name}' has {} samples, time has {n}", channel.len()));
            }
            let wrong = |v: &f64| if is_input { !v.is_finite() } else { v.is_infinite() };
            if let Some(i) = channel.iter().position(wrong) {
                return fail(format!(
                    "channel '{name}' is {} at t = {} s (sample {i})",
                    channel[i], self.t[i]
                ));
            }
            if !is_input && channel.iter().all(|v| v.is_nan()) {
                return fail(format!("output '{name}' has no samples (all NaN); take it out of the model"));
            }
        }
        Ok(())
    }
}
