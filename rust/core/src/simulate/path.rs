//! The result of a simulation.

/// Outputs and states of a simulation at the samples of its record. Channels stand in the order of the model's;
/// by name: [`Path::state`], [`Path::output`], [`Path::residual`].
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Path {
    /// Name of the record.
    pub name: String,
    /// Sample times, s, N of them.
    pub t: Vec<f64>,
    /// n_x states of N samples.
    pub states: Vec<Vec<f64>>,
    /// n_y outputs of N samples.
    pub outputs: Vec<Vec<f64>>,
    /// Measured less model outputs; NaN where nothing was measured.
    pub residuals: Vec<Vec<f64>>,
    /// Times at which the steps of the integration end, s, the first sample before them: where the motion is fast they are
    /// close.
    pub steps: Vec<f64>,
    /// Slopes of the states at both ends of each interval between samples, from within; none unless asked for.
    pub(crate) slopes: Vec<[Vec<f64>; 2]>,
    pub(super) state_names: Vec<String>,
    pub(super) output_names: Vec<String>,
}

impl Path {
    /// A state at the samples.
    pub fn state(&self, name: &str) -> Option<&[f64]> {
        let place = self.state_names.iter().position(|n| n == name)?;
        Some(&self.states[place])
    }

    /// An output at the samples.
    pub fn output(&self, name: &str) -> Option<&[f64]> {
        let place = self.output_names.iter().position(|n| n == name)?;
        Some(&self.outputs[place])
    }

    /// Measured less model output at the samples.
    pub fn residual(&self, name: &str) -> Option<&[f64]> {
        let place = self.output_names.iter().position(|n| n == name)?;
        Some(&self.residuals[place])
    }
}
