//! Parts that the dynamics fall into.

use std::ops::Range;

use super::items::Items;

/// States that no others enter: a system that falls apart, like one of modes, is eliminated part by part.
///
/// Only the Hessian couples parts, through outputs that depend on several.
#[derive(Clone, Debug)]
pub(super) struct Part {
    /// The states, in ascending order.
    pub states: Vec<usize>,
    /// Places among the [dynamic border](super::shape::Shape::dynamic) of what enters their equations.
    pub dynamic: Vec<usize>,
    /// Length of a row of sensitivities to (initial states of a group, dynamic border) of the part, padded.
    pub width: usize,
    /// The first of these columns in a row of all parts.
    pub first: usize,
    /// Columns of [H Z, K], from the part's own on, that are not zero in its rows: whole vectors.
    pub meets: Vec<Range<usize>>,
}

impl Part {
    /// Length of a row of sensitivities without the padding.
    pub fn used(&self) -> usize {
        self.states.len() + self.dynamic.len()
    }

    /// Rows of a segment with so many points.
    pub fn rows(&self, points: usize) -> usize {
        points * self.states.len()
    }

    /// Returns the place of the right-hand side for M in the panel of a segment with d own core rows.
    pub fn right(d: usize) -> usize {
        d.next_multiple_of(8)
    }

    /// Length of a row of the panel of a segment with so many core points: M, then what it is solved for.
    pub fn panel(&self, points: usize) -> usize {
        Part::right(self.rows(points)) + self.width
    }

    /// Returns the place of a row of the part among the rows of a segment, all states together.
    #[inline(always)]
    pub fn row(&self, own: usize, n: usize) -> usize {
        own / self.states.len() * n + self.states[own % self.states.len()]
    }
}

/// A part along a chain.
#[derive(Clone, Debug)]
pub(super) struct PartPlan {
    pub jacobian: Items,
    /// The factors of the rows of a panel, 1/unit of each state, and of its columns: the unit of own states, then
    /// −unit of states before, −1 for θ.
    pub rows: Vec<f64>,
    pub columns: Vec<f64>,
    /// For each row of a segment its state in the part, and its place among the segment's own rows.
    pub place: Vec<(u32, u32)>,
}

impl PartPlan {
    pub fn new(part: &Part, (points, most): (usize, usize), jacobian: Items, units: &[f64]) -> PartPlan {
        let own: Vec<f64> = part.states.iter().map(|&s| units[s]).collect();
        let (n, d) = (own.len(), part.rows(points));
        let right = Part::right(d);
        let mut columns = vec![0.0; part.panel(points)];
        columns[..d].iter_mut().zip(own.iter().cycle()).for_each(|(c, u)| *c = *u);
        columns[right..right + n].iter_mut().zip(&own).for_each(|(c, u)| *c = -u);
        columns[right + n..right + part.used()].fill(-1.0);
        let place = (0..part.rows(most)).map(|i| ((i % n) as u32, part.row(i, units.len()) as u32)).collect();
        PartPlan { jacobian, place, rows: own.iter().map(|u| 1.0 / u).collect(), columns }
    }
}
