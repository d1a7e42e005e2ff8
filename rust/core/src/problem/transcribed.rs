//! The seam between transcriptions and what is made of their solutions.

use super::layout::{ConstraintPlace, Layout, Place};
use super::posed::Posed;
use crate::index::{ConstraintId, ExperimentId, StateId, VariableId};
use crate::nlp::{Named, Separable};

/// An estimation problem as a nonlinear program, with the way back from its variables to states over time. Its names, and what
/// the search for a place to start needs, follow ([`Named`], [`Separable`]).
pub trait Transcribed: Separable {
    /// Parameters, noise, records.
    fn posed(&self) -> &Posed;
    /// Returns the layout of the variables.
    fn layout(&self) -> &Layout;
    /// Returns for each condition on the ends of records, which follow all other constraints, the state in whose unit
    /// it is.
    fn boundary_states(&self) -> Vec<StateId>;
    /// Returns the name of a constraint on a state over time: a defect, or the continuity of two segments.
    fn path_constraint_name(&self, of: ConstraintPlace) -> String;
    /// Returns the name of a condition on the ends of records.
    fn condition_name(&self, i: ConstraintId) -> String;
    /// Explains what is not finite at ξ, where and from what; `None` when everything is finite.
    fn why_not_finite(&self, xi: &[f64]) -> Option<String>;
    /// Times of the points of an experiment whose states are variables, s.
    fn point_times(&self, experiment: ExperimentId) -> &[f64];
    /// States at the samples of an experiment, `[state][sample]`; NaN where there are none.
    fn states_at_samples(&self, xi: &[f64], experiment: ExperimentId) -> Vec<Vec<f64>>;
    /// Model outputs at the samples of an experiment, `[output][sample]`.
    fn outputs_at_samples(&self, xi: &[f64], experiment: ExperimentId) -> Vec<Vec<f64>>;
    /// Times of the mesh on which the equation is solved, s, and the states there, `[state][time]`.
    fn path(&self, xi: &[f64], experiment: ExperimentId) -> (Vec<f64>, Vec<Vec<f64>>);
}

impl<T: Transcribed> Named for T {
    fn variable_name(&self, i: VariableId) -> String {
        match self.layout().place(i) {
            Place::Parameter(p) => self.posed().parameter_name(p),
            Place::State { experiment, point, state } => {
                self.posed().state_name(state, self.point_times(experiment)[point], experiment)
            }
        }
    }

    fn constraint_name(&self, i: ConstraintId) -> String {
        if i.0 >= self.layout().m() {
            return self.condition_name(i);
        }
        self.path_constraint_name(self.layout().constraint(i))
    }

    fn explain(&self, xi: &[f64]) -> Option<String> {
        self.why_not_finite(xi)
    }
}

impl<T: Transcribed> Separable for T {
    fn nonlinear(&self) -> Vec<VariableId> {
        self.posed().nonlinear()
    }

    fn nonlinear_by_parameters(&self) -> Vec<VariableId> {
        self.posed().nonlinear_by_parameters()
    }

    fn products(&self) -> Vec<(VariableId, VariableId)> {
        self.posed().products()
    }

    fn of_noise(&self) -> Vec<VariableId> {
        self.posed().of_noise()
    }

    fn moved(&self, i: VariableId, x: f64, step: f64) -> f64 {
        self.posed().estimands.transforms.get(i).map_or(x + step, |t| t.moved(x, step))
    }

    fn move_elsewhere(&self, xi: &mut [f64], variables: &[VariableId], draw: u64) {
        self.posed().move_elsewhere(xi, variables, draw);
    }
}
