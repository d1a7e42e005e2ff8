//! The places of the rows, points and entries of a chain.

use std::ops::Range;

use super::items::Items;
use super::part::PartPlan;
use super::run::Run;
use crate::index::ConstraintId;
use crate::nlp::{Chain, Tie};

/// The places of a chain's own rows and points, and the entries that they take.
///
/// The *own rows* of a chain are numbered segment by segment, first those of the points in the chain
/// (its *core*), then those of its ties; own variables alike. Point 0 is the first of the chain, the
/// others follow in the order of own rows.
#[derive(Clone, Debug)]
pub(super) struct ChainPlan {
    pub chain: Chain,
    /// Core rows of a segment, d.
    pub d: usize,
    /// Number of ties before each segment, and the total.
    pub ties: Vec<u32>,
    /// Jacobian entries of each part by segment.
    pub parts: Vec<PartPlan>,
    /// Entries of the boundary conditions, at their places in rows of (initial states, last states, dynamic border).
    pub boundary: Items,
    /// Hessian entries of the first point, and of the own points of each segment.
    pub hessian: Items,
    /// Sums of the entries, point by point, states before the border; the factors of these sums from the program into
    /// units; and the places of both for each panel.
    runs: Vec<Run>,
    factors: Vec<f64>,
    spans: Vec<(Range<u32>, Range<u32>)>,
}

impl ChainPlan {
    /// A chain without its entries. `None` where it has more boundary conditions than its ends can meet, or where
    /// these leave nothing that varies.
    pub fn new(chain: &Chain, n: usize, border: usize) -> Option<ChainPlan> {
        let mut ties = vec![0u32; chain.segments + 1];
        for tie in &chain.ties {
            ties[tie.segment + 1] += 1;
        }
        (0..chain.segments).for_each(|s| ties[s + 1] += ties[s]);
        let k = chain.boundary.states.len();
        let free = k < n || (k == n && border > 0);
        free.then(|| ChainPlan {
            chain: chain.clone(),
            d: chain.points * n,
            ties,
            parts: Vec::new(),
            boundary: Items::default(),
            hessian: Items::default(),
            runs: Vec::new(),
            factors: Vec::new(),
            spans: Vec::new(),
        })
    }

    /// First own row of a segment.
    #[inline(always)]
    pub fn row(&self, segment: usize, n: usize) -> usize {
        self.point(segment) * n
    }

    /// Points before a segment, the chain's first left out.
    #[inline(always)]
    pub fn point(&self, segment: usize) -> usize {
        segment * self.chain.points + self.ties[segment] as usize
    }

    /// Number of points of a segment's own.
    #[inline(always)]
    pub fn points(&self, segment: usize) -> usize {
        self.chain.points + (self.ties[segment + 1] - self.ties[segment]) as usize
    }

    /// All runs, each once.
    pub fn all_runs(&self) -> &[Run] {
        &self.runs
    }

    /// The runs of a panel of the Hessian.
    #[inline(always)]
    pub fn runs(&self, panel: usize) -> &[Run] {
        let span = &self.spans[panel].0;
        &self.runs[span.start as usize..span.end as usize]
    }

    /// Returns for each value of a panel its factor into units.
    #[inline(always)]
    pub fn factors(&self, panel: usize) -> &[f64] {
        let span = &self.spans[panel].1;
        &self.factors[span.start as usize..span.end as usize]
    }

    /// Takes the entries of the Hessian, at places in records of n² pairs of states and n rows across:
    /// entries of one place are one value, and its number takes the place's stead.
    pub fn bend(&mut self, mut hessian: Items, n: usize, across: usize, units: &[f64]) {
        let record = n * n + n * across;
        let mut last = (u32::MAX, 0);
        for &(start, count, _) in &hessian.panels {
            // One without entries starts where the next does.
            if (start, count) == last {
                self.spans.push(self.spans[self.spans.len() - 1].clone());
                continue;
            }
            last = (start, count);
            let (first_run, first) = (self.runs.len(), self.factors.len());
            let items = &mut hessian.items[start as usize..(start + count) as usize];
            items.sort_by_key(|item| item.1);
            let mut before = u32::MAX;
            for (_, place) in items {
                let at = std::mem::replace(&mut before, *place);
                if at != *place {
                    let (point, within) = (*place as usize / record, *place as usize % record);
                    let coupled = within >= n * n;
                    let (state, other) = if coupled {
                        ((within - n * n) / across, (within - n * n) % across - n)
                    } else {
                        (within / n, within % n)
                    };
                    self.factors.push(units[state] * if coupled { 1.0 } else { units[other] });
                    let (point, state, other) = (point as u32, state as u16, other as u16);
                    let next = Run { point, state, other, count: 1, coupled };
                    match self.runs[first_run..].last_mut() {
                        Some(run) if run.goes_on(&next) => run.count += 1,
                        _ => self.runs.push(next),
                    }
                }
                *place = (self.factors.len() - first - 1) as u32;
            }
            let (runs, factors) = (self.runs.len() as u32, self.factors.len() as u32);
            self.spans.push((first_run as u32..runs, first as u32..factors));
        }
        self.hessian = hessian;
    }

    /// The program's constraint of an own row.
    pub fn constraint(&self, row: usize, n: usize) -> ConstraintId {
        let s = (0..self.chain.segments).rev().find(|&s| self.row(s, n) <= row).unwrap_or(0);
        let i = row - self.row(s, n);
        if i < self.d {
            self.chain.row + s * self.d + i
        } else {
            self.ties_of(s)[(i - self.d) / n].row + (i - self.d) % n
        }
    }

    /// Returns the factor of an entry of a boundary condition; `units` are reciprocals.
    pub fn boundary_factor(&self, units: &[f64], row: usize, column: usize) -> f64 {
        let n = units.len();
        let of_column = if column < 2 * n { 1.0 / units[column % n] } else { 1.0 };
        units[self.chain.boundary.states[row].0] * of_column
    }

    /// Most ties of a segment.
    pub fn most_ties(&self) -> usize {
        self.ties.windows(2).map(|t| (t[1] - t[0]) as usize).max().unwrap_or(0)
    }

    /// Ties of a segment.
    pub fn ties_of(&self, segment: usize) -> &[Tie] {
        &self.chain.ties[self.ties[segment] as usize..self.ties[segment + 1] as usize]
    }
}
