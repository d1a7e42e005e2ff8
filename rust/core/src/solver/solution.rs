//! What a run hands over.

use std::time::Duration;

use super::iteration::Iteration;
use super::program::Evaluations;
use super::status::Status;

/// Where a run ended.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Variables.
    pub xi: Vec<f64>,
    /// Multipliers of the constraints.
    pub multipliers: Vec<f64>,
    /// How it ended.
    pub status: Status,
    /// The status's hint, with names.
    pub message: String,
    /// φ there.
    pub objective: f64,
    /// Largest defect in units of its state.
    pub defect: f64,
    /// Number of iterations.
    pub iterations: usize,
    /// How often what was evaluated.
    pub evaluations: Evaluations,
    /// Counted floating-point operations of one factorisation.
    pub flops: u64,
    /// Time spent.
    pub time: Duration,
    /// Units of the states.
    pub units: Vec<f64>,
    /// The table.
    pub history: Vec<Iteration>,
}
