//! Parts that the dynamics fall into.

use std::ops::Range;

use super::items::Items;
use super::places::Places;
use super::shape::{Shape, positions};
use crate::nlp::Structure;

/// States that no others enter: a system that falls apart, like one of modes, is eliminated part by part.
///
/// Only the Hessian couples parts, through outputs that depend on several.
#[derive(Clone, Debug)]
pub(super) struct Part {
    /// The states, in ascending order.
    pub states: Vec<usize>,
    /// Places in [`Shape::dynamic`] of what enters their equations.
    pub dynamic: Vec<usize>,
    /// Length of a row of sensitivities to (first states of a group, dynamic border) of the part, padded.
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

/// The parts that the dynamics fall into: sets of states that no entry of the Jacobian joins.
pub(super) fn parts(shape: &Shape, places: &Places, jacobian: &Structure) -> Vec<Part> {
    let n = shape.n;
    let of_row = |t: usize| {
        let row = places.rows[jacobian.rows[t] as usize];
        row.is_own().then(|| row.index as usize % n)
    };
    // Each state points to one of its part, the first of them to itself.
    let mut to: Vec<usize> = (0..n).collect();
    let root = |to: &[usize], mut i: usize| {
        while to[i] != i {
            i = to[i];
        }
        i
    };
    for (t, &column) in jacobian.columns.iter().enumerate().filter(|(_, c)| **c as usize >= shape.border) {
        if let Some(i) = of_row(t) {
            let (a, b) = (root(&to, i), root(&to, places.variables[column as usize].index as usize % n));
            to[a.max(b)] = a.min(b);
        }
    }
    let roots: Vec<usize> = (0..n).map(|i| root(&to, i)).collect();
    let place = positions(&shape.dynamic, shape.border, 0);
    let mut enters = vec![false; n * shape.dynamic.len()];
    for (t, &column) in jacobian.columns.iter().enumerate().filter(|(_, c)| (**c as usize) < shape.border) {
        if let Some(i) = of_row(t) {
            enters[roots[i] * shape.dynamic.len() + place[column as usize]] = true;
        }
    }
    let mut first = 0;
    let part = |root: usize| {
        let states: Vec<usize> = (0..n).filter(|&i| roots[i] == root).collect();
        let count = shape.dynamic.len();
        let dynamic: Vec<usize> = (0..count).filter(|d| enters[root * count + d]).collect();
        let width = (states.len() + dynamic.len()).next_multiple_of(8);
        first += width;
        Part { states, dynamic, width, first: first - width, meets: Vec::new() }
    };
    (0..n).filter(|&i| roots[i] == i).map(part).collect()
}
