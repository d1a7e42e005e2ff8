//! Defects of blocks, and which of them are none: what rounding leaves.

use std::ops::Range;

use super::super::program::Program;
use super::Restoration;
use super::blocks::{Block, BlockEntry};
use crate::dense::largest;

/// Defects below this part of the unit of their state are none.
const SATISFIED: f64 = 1e-8;
/// The same of the state itself, where its unit is smaller than rounding errors of it.
const ROUNDING: f64 = 1e-13;
/// The same of the terms of which the defect is the difference, which are large where a segment is long for a fast motion.
const CANCELLATION: f64 = 4.0 * f64::EPSILON;
impl Restoration {
    /// Sets what rounding may leave of the defects of some blocks, from the last Jacobian.
    fn measure_rounding(&mut self, blocks: Range<usize>, xi: &[f64]) {
        for block in &self.blocks[blocks] {
            block.rows.iter().for_each(|&row| self.rounding[row] = 0.0);
            let own = block.own.iter().map(|own| BlockEntry { column: block.columns[own.column], ..*own });
            for BlockEntry { entry, row: r, column } in own.chain(block.others.iter().copied()) {
                self.rounding[block.rows[r]] += CANCELLATION * (self.jacobian[entry] * xi[column]).abs();
            }
        }
    }

    /// The largest defect of some blocks. Where a step has not made it less than half of the `last` one, rounding may be all
    /// that is left, and is measured.
    pub(super) fn largest_defect(
        &mut self,
        program: &Program<'_>,
        blocks: Range<usize>,
        xi: &[f64],
        last: f64,
    ) -> f64 {
        let of =
            |this: &Self| largest(this.blocks[blocks.clone()].iter().map(|b| this.defect_of(program, b, xi)));
        let size = of(self);
        if size <= 1.0 || size < 0.5 * last || last == f64::INFINITY {
            return size;
        }
        self.measure_rounding(blocks.clone(), xi);
        of(self)
    }

    /// The largest defect of a block, at most 1 where it counts as none, infinite where it is not a number.
    fn defect_of(&self, program: &Program<'_>, block: &Block, xi: &[f64]) -> f64 {
        let one = |(&row, &column): (&usize, &usize)| {
            let least = (SATISFIED * program.units.of(row)).max(ROUNDING * xi[column].abs());
            self.c[row] / least.max(self.rounding[row])
        };
        largest(block.rows.iter().zip(&block.columns).map(one))
    }
}
