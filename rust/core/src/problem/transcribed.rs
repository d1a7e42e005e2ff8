//! The seam between transcriptions and what is made of their solutions.

use super::layout::Layout;
use super::posed::Posed;
use crate::index::{ExperimentId, StateId};
use crate::nlp::Separable;

/// An estimation problem as a nonlinear program, with the way back from its variables to states over time.
pub trait Transcribed: Separable {
    /// Parameters, noise, records.
    fn posed(&self) -> &Posed;
    /// Returns the layout of the variables.
    fn layout(&self) -> &Layout;
    /// Returns for each condition on the ends of records, which follow all other constraints, the state in whose unit
    /// it is.
    fn boundary_states(&self) -> Vec<StateId>;
    /// Times of the points of an experiment whose states are variables, s.
    fn point_times(&self, experiment: ExperimentId) -> &[f64];
    /// States at the samples of an experiment, `[state][sample]`; NaN where there are none.
    fn states_at_samples(&self, xi: &[f64], experiment: ExperimentId) -> Vec<Vec<f64>>;
    /// Model outputs at the samples of an experiment, `[output][sample]`.
    fn outputs_at_samples(&self, xi: &[f64], experiment: ExperimentId) -> Vec<Vec<f64>>;
    /// Times of the mesh on which the equation is solved, s, and the states there, `[state][time]`.
    fn path(&self, xi: &[f64], experiment: ExperimentId) -> (Vec<f64>, Vec<Vec<f64>>);
}
