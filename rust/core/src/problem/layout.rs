//! The places and names of variables and constraints.

use crate::mesh::{Between, Mesh};
use crate::nlp::{Boundary, Chain, Chains, Tie};

/// The meaning of a variable or constraint of the problem.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// The i-th parameter, noise parameters after the model's.
    Parameter(usize),
    /// A state at a point of an experiment.
    State {
        /// Experiment.
        experiment: usize,
        /// Point within the experiment's mesh.
        point: usize,
        /// State.
        state: usize,
    },
}

/// The meaning of a constraint on the states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConstraintPlace {
    /// Experiment.
    pub experiment: usize,
    /// Vector constraint within the experiment.
    pub row: usize,
    /// State.
    pub state: usize,
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
    pub first_point: Vec<usize>,
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

    pub(crate) fn new(n_theta: usize, n_x: usize, meshes: &[Mesh]) -> Self {
        Self::of_counts(n_theta, n_x, meshes.iter().map(Mesh::len))
    }

    /// Makes the layout for these numbers of points in the experiments.
    pub(crate) fn of_counts(n_theta: usize, n_x: usize, points: impl Iterator<Item = usize>) -> Self {
        let mut first_point = vec![0];
        for n in points {
            first_point.push(first_point.last().unwrap() + n);
        }
        Layout { n_theta, n_x, first_point }
    }

    /// Number of points of all experiments.
    pub fn points(&self) -> usize {
        *self.first_point.last().unwrap()
    }

    /// Number of variables.
    pub fn n(&self) -> usize {
        self.n_theta + self.n_x * self.points()
    }

    /// Number of constraints.
    pub fn m(&self) -> usize {
        self.n_x * (self.points() - (self.first_point.len() - 1))
    }

    /// Index of the first state of a point (counted over all experiments).
    #[inline(always)]
    pub fn state(&self, point: usize) -> usize {
        self.n_theta + point * self.n_x
    }

    /// First vector constraint of an experiment.
    pub fn first_row(&self, experiment: usize) -> usize {
        self.first_point[experiment] - experiment
    }

    /// Returns the layout as the linear algebra sees it.
    pub(crate) fn chains(&self, meshes: &[Mesh]) -> Chains {
        let chain = |(e, mesh): (usize, &Mesh)| {
            let (first, row) = (self.first_point[e], self.first_row(e));
            let tie = |b: &Between| Tie {
                segment: b.segment,
                variable: self.state(first + b.point),
                row: (row + b.point - 1) * self.n_x,
            };
            Chain {
                variable: self.state(first),
                row: row * self.n_x,
                segments: mesh.segments.len(),
                points: mesh.rule.order() - 1,
                ties: mesh.between.iter().map(tie).collect(),
                boundary: Boundary::default(),
            }
        };
        let chains = meshes.iter().enumerate().map(chain).collect();
        Chains { border: self.n_theta, n_x: self.n_x, chains }
    }

    /// Returns the meaning of a variable.
    pub fn place(&self, i: usize) -> Place {
        if i < self.n_theta {
            return Place::Parameter(i);
        }
        let (point, state) = ((i - self.n_theta) / self.n_x, (i - self.n_theta) % self.n_x);
        let experiment = self.first_point.partition_point(|&p| p <= point) - 1;
        Place::State { experiment, point: point - self.first_point[experiment], state }
    }

    /// Returns the meaning of a constraint.
    pub fn constraint(&self, i: usize) -> ConstraintPlace {
        let (row, state) = (i / self.n_x, i % self.n_x);
        let last = self.first_point.len() - 2;
        let experiment = (0..=last).rev().find(|&e| self.first_row(e) <= row).unwrap_or(0);
        ConstraintPlace { experiment, row: row - self.first_row(experiment), state }
    }
}
