//! The shape that transcribed ODEs give a program: chains of segments with a border.
//!
//! A *border* of variables (parameters) enters everything. Beside it stand *chains*, one an
//! experiment: a first state vector, then segments one after the other. Each segment has as many
//! constraints as variables of its own (its points after the first), which these determine from the
//! last variables of the segment before and the border. The objective couples variables of one point,
//! and points with the border.

use crate::index::{ConstraintId, StateId, VariableId};

/// Variables and constraints in chains of segments.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chains {
    /// Variables 0..border are the border.
    pub border: usize,
    /// States of a point.
    pub n_x: usize,
    /// The chains; with the border they hold all variables, and all constraints.
    pub chains: Vec<Chain>,
}

impl Chains {
    /// Returns for each boundary condition, which follow all other constraints, the state in whose unit it is.
    pub fn boundary_states(&self) -> impl Iterator<Item = StateId> + '_ {
        self.chains.iter().flat_map(|c| c.boundary.states.iter().copied())
    }
}

/// A chain of segments.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chain {
    /// First variable. The first point's n_x states stand here, the points of the segments follow.
    pub variable: VariableId,
    /// First constraint; one of n_x rows a point, in the order of the points from the second.
    pub row: ConstraintId,
    /// Number of segments.
    pub segments: usize,
    /// Points of a segment after its first, m − 1.
    pub points: usize,
    /// Points outside the chain, each tied to a segment by n_x constraints of its own, in the order of
    /// their segments. Nothing but the objective depends on them.
    pub ties: Vec<Tie>,
    /// Constraints on its first and its last point (and the border) alone.
    pub boundary: Boundary,
}

/// Constraints on the ends of a chain: initial, final, periodic conditions.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Boundary {
    /// First of the constraints.
    pub row: ConstraintId,
    /// For each condition the state in whose unit it is.
    pub states: Vec<StateId>,
}

/// A point tied to a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tie {
    /// The segment.
    pub segment: usize,
    /// First of its n_x variables.
    pub variable: VariableId,
    /// First of its n_x constraints.
    pub row: ConstraintId,
}
