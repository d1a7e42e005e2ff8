//! The places of the variables and constraints of a program in its chains.

use super::chain::ChainPlan;

/// Instead of the segment of a row, for a boundary condition.
const BOUNDARY: u32 = u32::MAX;

/// Chain, segment and place in the segment's own rows; or in the first point.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub chain: u32,
    /// Segment + 1; 0 for the first point.
    pub after: u32,
    pub index: u32,
}

impl Place {
    const NOWHERE: Place = Place { chain: u32::MAX, after: 0, index: 0 };

    fn new(chain: usize, after: usize, index: usize) -> Place {
        Place { chain: chain as u32, after: after as u32, index: index as u32 }
    }

    fn is_nowhere(&self) -> bool {
        self.chain == u32::MAX
    }

    /// Returns whether a row is a boundary condition.
    pub fn is_boundary(&self) -> bool {
        self.after == BOUNDARY
    }

    /// Returns whether a row is one of a segment's own.
    pub fn is_own(&self) -> bool {
        !self.is_boundary() && !self.is_nowhere()
    }
}

/// The places of all variables and rows.
pub(super) struct Places {
    pub variables: Vec<Place>,
    pub rows: Vec<Place>,
}

impl Places {
    /// Makes the places of a program of n variables and m constraints, with so many states in a point.
    pub fn new(plans: &[ChainPlan], states: usize, (n, m): (usize, usize)) -> Places {
        let (mut variables, mut rows) = (vec![Place::NOWHERE; n], vec![Place::NOWHERE; m]);
        for (c, plan) in plans.iter().enumerate() {
            let (chain, d) = (&plan.chain, plan.d);
            for i in 0..states {
                variables[chain.variable.0 + i] = Place::new(c, 0, i);
            }
            for s in 0..chain.segments {
                for i in 0..d {
                    variables[chain.variable.0 + states + s * d + i] = Place::new(c, s + 1, i);
                    rows[chain.row.0 + s * d + i] = Place::new(c, s + 1, i);
                }
            }
            for (t, tie) in chain.ties.iter().enumerate() {
                let first = d + (t - plan.ties[tie.segment] as usize) * states;
                for i in 0..states {
                    variables[tie.variable.0 + i] = Place::new(c, tie.segment + 1, first + i);
                    rows[tie.row.0 + i] = Place::new(c, tie.segment + 1, first + i);
                }
            }
            for i in 0..chain.boundary.states.len() {
                rows[chain.boundary.row.0 + i] = Place::new(c, BOUNDARY as usize, i);
            }
        }
        Places { variables, rows }
    }

    /// Whether every row stands in a chain, and every variable but those of the border.
    pub fn are_complete(&self, border: usize) -> bool {
        !self.variables[border..].iter().chain(&self.rows).any(Place::is_nowhere)
    }
}
