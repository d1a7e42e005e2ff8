//! Entries of the Hessian that stand side by side.

use std::ops::Range;

/// Entries of the Hessian of a point that stand side by side: of a state with other states, or with border
/// variables of those coupled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    /// The number of the point among those of a panel.
    pub point: u32,
    pub state: u16,
    /// The first of the others, and their number.
    pub other: u16,
    pub count: u16,
    pub coupled: bool,
}

impl Run {
    /// The places of the others.
    #[inline(always)]
    pub fn others(&self) -> Range<usize> {
        self.other as usize..self.other as usize + self.count as usize
    }

    /// Whether another entry is the next of the run.
    pub fn goes_on(&self, next: &Run) -> bool {
        (self.point, self.state, self.coupled) == (next.point, next.state, next.coupled)
            && self.others().end == next.other as usize
            && self.count < u16::MAX
    }

    /// Runs with their values, which follow each other; those of zeros are left out.
    #[inline(always)]
    pub fn with<'a>(runs: &'a [Run], mut values: &'a [f64]) -> impl Iterator<Item = (&'a Run, &'a [f64])> {
        runs.iter().filter_map(move |run| {
            let (own, after) = values.split_at(run.count as usize);
            values = after;
            own.iter().any(|v| *v != 0.0).then_some((run, own))
        })
    }
}
