//! Units in which steps and defects are of order one.

use crate::nlp::{Chains, Nlp};

/// Units of states, and of constraints: a defect is measured in that of its state, and so is a boundary
/// condition.
#[derive(Clone, Debug)]
pub(super) struct Units {
    /// Those of the n_x states.
    pub states: Vec<f64>,
    /// Constraints in which they repeat.
    pub rows: usize,
    boundary: Vec<f64>,
}

impl Units {
    pub fn new(nlp: &dyn Nlp, xi: &[f64]) -> Units {
        let states = state_units(nlp, xi);
        let conditions = nlp.chains().into_iter().flat_map(Chains::boundary_states);
        let boundary: Vec<f64> = conditions.map(|s| states[s]).collect();
        Units { rows: nlp.m() - boundary.len(), states, boundary }
    }

    /// The unit of each constraint.
    pub fn each(&self) -> impl Iterator<Item = &f64> {
        self.states.iter().cycle().take(self.rows).chain(&self.boundary)
    }

    /// The unit of a constraint.
    pub fn of(&self, row: usize) -> f64 {
        if row < self.rows { self.states[row % self.states.len()] } else { self.boundary[row - self.rows] }
    }
}

/// What the states do along the path ξ: their spread at all points, else their size, else 1. One for
/// each of the n_x states; a defect is measured in that of its state. A single 1 where the program has
/// no chains.
pub fn state_units(nlp: &dyn Nlp, xi: &[f64]) -> Vec<f64> {
    let Some(chains) = nlp.chains() else { return vec![1.0] };
    let n = chains.n_x;
    let states = &xi[chains.border..];
    let count = (states.len() / n) as f64;
    let unit = |i: usize| {
        let values = || states.iter().skip(i).step_by(n);
        let mean = values().sum::<f64>() / count;
        let spread = (values().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt();
        let size = values().fold(0.0f64, |a, x| a.max(x.abs()));
        // A spread of rounding errors is none.
        if spread > 1e-12 * size {
            spread
        } else if size > 0.0 {
            size
        } else {
            1.0
        }
    };
    (0..n).map(unit).collect()
}
