//! The Newton step.

use super::program::Program;

/// The Newton step, and the multipliers at its end.
pub(super) struct Step {
    pub d: Vec<f64>,
    pub multipliers: Vec<f64>,
}

impl Step {
    pub fn new(program: &Program<'_>) -> Step {
        Step { d: vec![0.0; program.nlp.n()], multipliers: vec![0.0; program.nlp.m()] }
    }

    /// Takes over another step.
    pub fn copy(&mut self, other: &Step) {
        self.d.copy_from_slice(&other.d);
        self.multipliers.copy_from_slice(&other.multipliers);
    }
}
