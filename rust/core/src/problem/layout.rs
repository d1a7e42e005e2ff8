//! The places and names of variables and constraints.

use std::ops::Range;

use crate::index::{ConstraintId, ExperimentId, IndexVec, PointId, StateId, VariableId};
use crate::mesh::{Between, Mesh};
use crate::nlp::{Boundary, Chain, Chains, Tie};

/// The meaning of a variable or constraint of the problem.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// A parameter, those of the noise after the model's.
    Parameter(VariableId),
    /// A state at a point of an experiment.
    State {
        /// Experiment.
        experiment: ExperimentId,
        /// Point within the experiment's mesh.
        point: usize,
        /// State.
        state: StateId,
    },
}

/// The meaning of a constraint on the states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConstraintPlace {
    /// Experiment.
    pub experiment: ExperimentId,
    /// Vector constraint within the experiment.
    pub row: usize,
    /// State.
    pub state: StateId,
}

/// Order of variables: ξ = [θ, x at the points of experiment 1, of experiment 2, ...]
/// (Eq. collocation_decision), states of a point together. Constraints: one vector of n_x rows for
/// every point but the first of each experiment, in the order of segments, then of the samples
/// between mesh points.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Number of parameters, n_θ: the model's and the noise's.
    pub n_theta: usize,
    /// Number of states, n_x.
    pub n_x: usize,
    /// First point of each experiment, and the total at the end.
    pub first_point: IndexVec<ExperimentId, PointId>,
}

impl Layout {
    /// States of some points, state by state.
    pub(crate) fn gather(&self, xi: &[f64], points: &[u32], out: &mut [f64]) {
        let n = points.len();
        let states = &xi[self.n_theta..];
        for r in 0..self.n_x {
            for (o, &p) in out[r * n..(r + 1) * n].iter_mut().zip(points) {
                *o = states[p as usize * self.n_x + r];
            }
        }
    }

    pub(crate) fn new(n_theta: usize, n_x: usize, meshes: &IndexVec<ExperimentId, Mesh>) -> Self {
        Self::of_counts(n_theta, n_x, meshes.iter().map(Mesh::len))
    }

    /// Makes the layout for these numbers of points in the experiments.
    pub(crate) fn of_counts(n_theta: usize, n_x: usize, points: impl Iterator<Item = usize>) -> Self {
        let mut next = PointId(0);
        let mut first_point = IndexVec::default();
        for n in points {
            first_point.push(next);
            next = next + n;
        }
        first_point.push(next);
        Layout { n_theta, n_x, first_point }
    }

    /// Number of experiments.
    pub fn experiments(&self) -> usize {
        self.first_point.len() - 1
    }

    /// Number of points of all experiments.
    pub fn points(&self) -> usize {
        self.first_point[ExperimentId(self.experiments())].0
    }

    /// Number of variables.
    pub fn n(&self) -> usize {
        self.n_theta + self.n_x * self.points()
    }

    /// Number of constraints.
    pub fn m(&self) -> usize {
        self.n_x * (self.points() - self.experiments())
    }

    /// First variable of a point, its first state.
    #[inline(always)]
    pub fn state(&self, point: PointId) -> VariableId {
        VariableId(self.n_theta + point.0 * self.n_x)
    }

    /// The variables of a point, its states, in ξ.
    #[inline(always)]
    pub fn states(&self, point: PointId) -> Range<usize> {
        let first = self.state(point).0;
        first..first + self.n_x
    }

    /// First vector constraint of an experiment.
    pub fn first_row(&self, experiment: ExperimentId) -> usize {
        self.first_point[experiment].0 - experiment.0
    }

    /// First constraint of a vector constraint.
    pub fn constraint_of(&self, row: usize) -> ConstraintId {
        ConstraintId(row * self.n_x)
    }

    /// Returns the layout as the linear algebra sees it.
    pub(crate) fn chains(&self, meshes: &IndexVec<ExperimentId, Mesh>) -> Chains {
        let chain = |(e, mesh): (ExperimentId, &Mesh)| {
            let (first, row) = (self.first_point[e], self.first_row(e));
            let tie = |b: &Between| Tie {
                segment: b.segment,
                variable: self.state(first + b.point),
                row: self.constraint_of(row + b.point - 1),
            };
            Chain {
                variable: self.state(first),
                row: self.constraint_of(row),
                segments: mesh.segments.len(),
                points: mesh.rule.order() - 1,
                ties: mesh.between.iter().map(tie).collect(),
                boundary: Boundary::default(),
            }
        };
        let chains = meshes.numbered().map(chain).collect();
        Chains { border: self.n_theta, n_x: self.n_x, chains }
    }

    /// Returns the meaning of a variable.
    pub fn place(&self, i: VariableId) -> Place {
        let Some(i) = i.0.checked_sub(self.n_theta) else { return Place::Parameter(i) };
        let (point, state) = (PointId(i / self.n_x), StateId(i % self.n_x));
        let experiment = ExperimentId(self.first_point.as_slice().partition_point(|&p| p <= point) - 1);
        Place::State { experiment, point: point.0 - self.first_point[experiment].0, state }
    }

    /// Returns the meaning of a constraint.
    pub fn constraint(&self, i: ConstraintId) -> ConstraintPlace {
        let (row, state) = (i.0 / self.n_x, StateId(i.0 % self.n_x));
        let experiments = (0..self.experiments()).rev().map(ExperimentId);
        let experiment = experiments.into_iter().find(|&e| self.first_row(e) <= row).unwrap_or_default();
        ConstraintPlace { experiment, row: row - self.first_row(experiment), state }
    }
}
