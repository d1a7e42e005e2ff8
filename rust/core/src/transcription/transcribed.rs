//! The seam between transcriptions and what is made of their solutions.

use super::boundary::Boundary;
use super::collocation::Collocation;
use super::layout::Layout;
use super::posed::Posed;
use crate::nlp::Nlp;

/// An estimation problem as a nonlinear program, with the way back from its variables to states over time.
pub trait Transcribed: Nlp {
    /// Parameters, noise, records.
    fn posed(&self) -> &Posed;
    /// Which variable is which.
    fn layout(&self) -> &Layout;
    /// For each condition on the ends of records, which follow all other constraints, the state in whose unit it is.
    fn boundary_states(&self) -> Vec<usize>;
    /// Times of the points of an experiment whose states are variables, s.
    fn point_times(&self, experiment: usize) -> &[f64];
    /// States at the samples of an experiment, `[state][sample]`; NaN where there are none.
    fn states_at_samples(&self, xi: &[f64], experiment: usize) -> Vec<Vec<f64>>;
    /// Model outputs at the samples of an experiment, `[output][sample]`.
    fn outputs_at_samples(&self, xi: &[f64], experiment: usize) -> Vec<Vec<f64>>;
    /// Times of the mesh on which the equation is solved, s, and the states there, `[state][time]`.
    fn path(&self, xi: &[f64], experiment: usize) -> (Vec<f64>, Vec<Vec<f64>>);
    /// The collocation problem, if it is one.
    fn collocation(&self) -> Option<&Collocation> {
        None
    }
}

impl Transcribed for Collocation {
    fn posed(&self) -> &Posed {
        &self.posed
    }

    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn boundary_states(&self) -> Vec<usize> {
        self.boundary.as_ref().map_or_else(Vec::new, Boundary::all_states)
    }

    fn point_times(&self, experiment: usize) -> &[f64] {
        &self.meshes[experiment].times
    }

    fn states_at_samples(&self, xi: &[f64], experiment: usize) -> Vec<Vec<f64>> {
        let (first, points) = (self.layout.first_point[experiment], &self.meshes[experiment].sample_points);
        let path = |r: usize| points.iter().map(|p| xi[self.layout.state(first + p) + r]).collect();
        (0..self.layout.n_x).map(path).collect()
    }

    fn outputs_at_samples(&self, xi: &[f64], experiment: usize) -> Vec<Vec<f64>> {
        Collocation::outputs_at_samples(self, xi, experiment)
    }

    fn collocation(&self) -> Option<&Collocation> {
        Some(self)
    }

    fn path(&self, xi: &[f64], experiment: usize) -> (Vec<f64>, Vec<Vec<f64>>) {
        let (first, mesh) = (self.layout.first_point[experiment], &self.meshes[experiment]);
        let path = |r: usize| (0..mesh.n_mesh).map(|p| xi[self.layout.state(first + p) + r]).collect();
        (mesh.times[..mesh.n_mesh].to_vec(), (0..self.layout.n_x).map(path).collect())
    }
}
