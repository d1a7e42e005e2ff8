//! A line of the iteration table, and the answer to it.

use super::point::Point;

/// One line of the iteration table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// From 0, the start.
    pub number: usize,
    /// φ: minus the log-likelihood, priors included.
    pub objective: f64,
    /// Largest defect in units of its state.
    pub defect: f64,
    /// What the next step promises to gain in log-likelihood, and defects to pretend: half the square of
    /// the distance from the optimum in standard errors. Infinite where there is no next step.
    pub promise: f64,
    /// Length of the step taken, 1 for a full one.
    pub step: f64,
    /// Points tried on the way.
    pub trials: usize,
    /// Shift of the reduced Hessian.
    pub shift: f64,
    /// Whether the Hessian was exact.
    pub exact: bool,
}

impl Iteration {
    /// A line of a point that nothing is known of yet but what it is.
    pub(super) fn at(number: usize, point: &Point, exact: bool) -> Iteration {
        let Point { objective, worst: defect, .. } = *point;
        Iteration {
            number,
            objective,
            defect,
            promise: f64::INFINITY,
            step: 0.0,
            trials: 0,
            shift: 0.0,
            exact,
        }
    }
}

/// Whether to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// On.
    Continue,
    /// The best point so far is the result.
    Stop,
}
