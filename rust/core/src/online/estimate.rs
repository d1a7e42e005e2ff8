//! What is known after a sample.

use super::detector::Alarm;

/// What became of a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Arrival {
    /// It is the latest one.
    #[default]
    Latest,
    /// It is older than the latest one, but within the window, where it was put in.
    Late,
    /// It is older than the window, and was not used.
    TooLate,
}

/// The estimate after a sample: n states, p parameters of the model, n_y outputs. m is n plus the number of parameters that are
/// estimated.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Estimate {
    /// Time of the latest sample, s: what the states refer to.
    pub t: f64,
    /// What became of the sample that was pushed.
    pub arrival: Arrival,
    /// States, n.
    pub states: Vec<f64>,
    /// Their standard errors, n.
    pub state_errors: Vec<f64>,
    /// Parameters, p.
    pub parameters: Vec<f64>,
    /// Their standard errors, p; 0 for a fixed one.
    pub parameter_errors: Vec<f64>,
    /// Whether each parameter lies at a bound, p.
    pub at_bound: Vec<bool>,
    /// Covariance of states and estimated parameters, (m, m), without regard to bounds.
    pub covariance: Vec<f64>,
    /// Standard deviations of the measurement noise, n_y.
    pub sigma: Vec<f64>,
    /// Innovations: measured outputs minus their predictions from all samples before, n_y; NaN where missing, and for all outputs
    /// of a late sample.
    pub innovations: Vec<f64>,
    /// Standard deviations of the innovations, n_y.
    pub innovation_errors: Vec<f64>,
    /// Innovations made independent, with unit variances, by the Cholesky factor of their covariance, n_y; NaN where missing.
    pub normalised: Vec<f64>,
    /// Gauss-Newton iterations done.
    pub iterations: usize,
    /// Whether the last step was below the tolerance.
    pub converged: bool,
    /// Whether the iterations ended without the deadline.
    pub in_time: bool,
    /// What the detector says: `None` while the model holds, or without a detector.
    pub alarm: Option<Alarm>,
}
