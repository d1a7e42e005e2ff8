//! The seam between a transcription and a solver: a nonlinear program with names.
//!
//! minimise φ(ξ) subject to c(ξ) = 0 and bounds on ξ. Derivatives are sparse triplets whose
//! structure never changes; entries at one place add up.

mod chains;
pub mod check;

use std::ops::Range;

use crate::threads::prelude::*;

pub use crate::index::{
    ConstraintId, ExperimentId, IndexVec, Numbering, ParameterId, PointId, StateId, VariableId,
};
pub use crate::threads::Threads;

pub use chains::{Boundary, Chain, Chains, Tie};

/// Rows and columns of sparse entries, 0-based.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Structure {
    /// Row of each entry.
    pub rows: Vec<u32>,
    /// Column of each entry.
    pub columns: Vec<u32>,
}

impl Structure {
    /// Number of entries.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are no entries.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    pub(crate) fn push(&mut self, row: usize, column: usize) {
        self.rows.push(row as u32);
        self.columns.push(column as u32);
    }

    /// Adds entries that come in parts of so many; `fill` writes a part, by its number, and parts are written in
    /// parallel. The first that are added leave room for so many more. Gives the first entry of each part.
    pub(crate) fn add_parts(
        &mut self,
        threads: &Threads,
        (lengths, room): (&[usize], usize),
        fill: impl Fn(usize, &mut Part<'_>) + Sync,
    ) -> Vec<usize> {
        let first = self.len();
        let total: usize = lengths.iter().sum();
        for entries in [&mut self.rows, &mut self.columns] {
            if entries.is_empty() {
                // Zeroed memory costs nothing until a thread writes there.
                *entries = vec![0; total + room];
                entries.truncate(total);
            } else {
                entries.resize(first + total, 0);
            }
        }
        let (mut rows, mut columns) = (&mut self.rows[first..], &mut self.columns[first..]);
        let mut parts = Vec::with_capacity(lengths.len());
        for &length in lengths {
            let (row, column);
            (row, rows) = rows.split_at_mut(length);
            (column, columns) = columns.split_at_mut(length);
            parts.push(Part { rows: row, columns: column, written: 0 });
        }
        let write = |(number, part): (usize, &mut Part<'_>)| {
            fill(number, part);
            assert_eq!(part.written, part.rows.len(), "a part of a structure has another length");
        };
        threads.install(|| parts.par_iter_mut().enumerate().for_each(write));
        let places = lengths.iter().scan(first, |next, length| {
            *next += length;
            Some(*next - length)
        });
        places.collect()
    }
}

/// Entries of a [`Structure`] that are written one after the other.
pub(crate) struct Part<'a> {
    rows: &'a mut [u32],
    columns: &'a mut [u32],
    written: usize,
}

impl Part<'_> {
    pub(crate) fn push(&mut self, row: usize, column: usize) {
        self.rows[self.written] = row as u32;
        self.columns[self.written] = column as u32;
        self.written += 1;
    }
}

/// A function was not finite: in a line search a reason to step less, at the start an error.
/// [`Named::explain`] says what happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a function is not finite")]
pub struct NotFinite;

/// Limits on profiled variables: in terms of the standard deviations that they represent.
#[derive(Clone, Copy, Debug)]
pub enum Reach<'a> {
    /// Limits by these factors.
    Step {
        /// The greatest factor by which one grows.
        up: f64,
        /// The greatest factor by which one shrinks.
        down: f64,
    },
    /// Anywhere, but that those that would shrink by more than a factor of `most` from where they started
    /// stand there: their residuals are nothing.
    Free {
        /// The profiled variables at the start.
        start: &'a [f64],
        /// The factor.
        most: f64,
    },
}

/// The names of a program in messages, in the user's words.
pub trait Named {
    /// The user's name for a variable.
    fn variable_name(&self, i: VariableId) -> String;
    /// The user's name for a constraint.
    fn constraint_name(&self, i: ConstraintId) -> String;
    /// Explains what is not finite at ξ, where and from what; `None` when everything is finite.
    fn explain(&self, xi: &[f64]) -> Option<String>;
}

/// A nonlinear program: what a solver needs.
pub trait Nlp: Named + Send + Sync {
    /// Number of variables.
    fn n(&self) -> usize;
    /// Number of constraints, all of them c(ξ) = 0.
    fn m(&self) -> usize;
    /// Lower and upper bounds of the variables; infinite where there are none.
    fn bounds(&self) -> (Vec<f64>, Vec<f64>);
    /// φ(ξ).
    fn objective(&self, xi: &[f64]) -> Result<f64, NotFinite>;
    /// ∇φ(ξ).
    fn gradient(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite>;
    /// c(ξ).
    fn constraints(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite>;
    /// Places of the entries of ∂c/∂ξ.
    fn jacobian_structure(&self) -> &Structure;
    /// Entries of ∂c/∂ξ.
    fn jacobian(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite>;
    /// Places of the entries of the lower triangle of the Hessian of the Lagrangian.
    fn hessian_structure(&self) -> &Structure;
    /// Entries of factor · ∇²φ + Σ λ_i ∇²c_i.
    fn hessian(&self, xi: &[f64], factor: f64, lambda: &[f64], out: &mut [f64]) -> Result<(), NotFinite>;
    /// Entries, at the same places, of factor times a positive semidefinite approximation of ∇²φ, the
    /// constraints taken as linear: far from the solution a better guide than the exact Hessian.
    fn gauss_newton(&self, xi: &[f64], factor: f64, out: &mut [f64]) -> Result<(), NotFinite>;
    /// c(ξ) in these ranges of constraints at least; others may keep what stands there. Whether they are finite is not said.
    fn constraints_within(&self, xi: &[f64], _rows: &[Range<usize>], out: &mut [f64]) {
        let _ = self.constraints(xi, out);
    }
    /// Entries of ∂c/∂ξ of these ranges of constraints at least, likewise.
    fn jacobian_within(&self, xi: &[f64], _rows: &[Range<usize>], out: &mut [f64]) {
        let _ = self.jacobian(xi, out);
    }
    /// The chains that variables and constraints form, where they do.
    fn chains(&self) -> Option<&Chains> {
        None
    }
    /// Number of variables that are parameters, of the model and of the noise: the first.
    fn n_parameters(&self) -> usize {
        self.chains().map_or(self.n(), |c| c.border)
    }
    /// The longest step of a variable that makes sense far from an optimum; infinite where nothing is known.
    fn longest_step(&self, _i: VariableId) -> f64 {
        f64::INFINITY
    }
    /// The threads that it is evaluated on, for the linear algebra of a solver too.
    fn threads(&self) -> Threads {
        Threads::default()
    }
    /// Variables for which φ has a closed minimum, the others given: standard deviations.
    fn profiled(&self) -> Range<usize> {
        0..0
    }
    /// Writes that minimum, within bounds and within reach, from ξ and the gradient there. The largest relative
    /// change that it is.
    fn profile(&self, _xi: &[f64], _gradient: &[f64], _reach: &Reach<'_>, _out: &mut [f64]) -> f64 {
        0.0
    }
}

/// A program whose outputs and constraints may be linear in some of its parameters: what the search for a place to start
/// needs beside (see [`crate::initial`]).
pub trait Separable: Nlp {
    /// Border variables in which outputs and constraints are not linear, jointly linear in the other ones.
    fn nonlinear(&self) -> Vec<VariableId>;
    /// The same where logarithms take steps of their parameters ([`Separable::moved`]).
    fn nonlinear_by_parameters(&self) -> Vec<VariableId> {
        self.nonlinear()
    }
    /// Pairs of border variables that are multiplied with each other, and in neither of which outputs and constraints are
    /// nonlinear by itself.
    fn products(&self) -> Vec<(VariableId, VariableId)>;
    /// Border variables on which the noise alone depends.
    fn of_noise(&self) -> Vec<VariableId> {
        Vec::new()
    }
    /// Returns where a step leads from x along which outputs and constraints are linear: the variable may be a logarithm.
    fn moved(&self, _i: VariableId, x: f64, step: f64) -> f64 {
        x + step
    }
    /// Moves these variables to another place to start from; which one, `draw` says.
    fn move_elsewhere(&self, xi: &mut [f64], variables: &[VariableId], draw: u64);
}
