//! Newton's method for all blocks at once.

use super::super::program::Program;
use super::Restoration;
use super::blocks::BlockEntry;
use crate::dense::solve_factorised;

/// After several steps with one Jacobian, of which the last leaves more than a step of Newton's method, another is taken where
/// defects are above this part of that.
const SATISFIED_AGAIN: f64 = 0.01;
/// Most iterations with the factors of one Jacobian, and how much of the defects one may leave if the next is to be taken with
/// the same factors.
const WITH_ONE: usize = 6;
const LEAVES: f64 = 0.2;
/// Most Jacobians.
const AT_ONCE: usize = 6;

impl Restoration {
    /// Newton's method for all blocks, as long as it contracts. The factors of a Jacobian are used again while they leave little
    /// of the defects.
    pub(super) fn at_once(&mut self, program: &Program<'_>, xi: &mut [f64]) -> bool {
        // Whether the factors are those of other states, and the defects before the first step with them.
        let (mut earlier, mut first) = (self.factorised, f64::INFINITY);
        // Defects before the last step, and before the last one with a Jacobian of its own.
        let (mut last, mut before) = (f64::INFINITY, f64::INFINITY);
        let (mut jacobians, mut steps) = (0, 0);
        loop {
            let size = match program.constraints(xi, &mut self.c) {
                Ok(()) => self.largest_defect(program, 0..self.blocks.len(), xi, last),
                Err(_) => f64::INFINITY,
            };
            if size <= 1.0 {
                let by_newton = steps == 0 || steps == 1 && !earlier;
                return by_newton || size <= SATISFIED_AGAIN || self.step_all(xi);
            }
            if program.interrupt.stops() {
                return false;
            }
            let again = self.factorised && steps < WITH_ONE && size < LEAVES * last;
            if !again && earlier && size > first {
                // These factors have led away.
                xi.copy_from_slice(&self.kept);
                (self.factorised, earlier, steps, last) = (false, false, 0, f64::INFINITY);
                continue;
            }
            if !again {
                if !size.is_finite() || size >= 0.5 * before || jacobians == AT_ONCE {
                    return false;
                }
                self.factorised = false;
                if program.jacobian(xi, &mut self.jacobian).is_err() || !self.factorise_all() {
                    return false;
                }
                (jacobians, steps, before, earlier) = (jacobians + 1, 0, size, false);
            }
            if earlier && steps == 0 {
                first = size;
            }
            (steps, last) = (steps + 1, size);
            if !self.step_all(xi) {
                return false;
            }
        }
    }

    /// Takes a Newton step of all blocks, with the factors of a Jacobian; whether there is one.
    fn step_all(&mut self, xi: &mut [f64]) -> bool {
        self.d.fill(0.0);
        let found = (0..self.blocks.len()).all(|k| self.step_of(k));
        xi.iter_mut().zip(&self.d).for_each(|(x, d)| *x += d);
        found
    }

    /// The Newton step of a block with its factor, given those of the blocks before; whether there is one.
    pub(super) fn step_of(&mut self, k: usize) -> bool {
        let block = &self.blocks[k];
        let n = block.rows.len();
        self.right.clear();
        self.right.extend(block.rows.iter().map(|&r| -self.c[r]));
        for &BlockEntry { entry, row: r, column } in &block.others {
            self.right[r] -= self.jacobian[entry] * self.d[column];
        }
        let (factor, pivots) = (&self.factors[block.factor..][..n * n], &self.pivots[block.pivots..][..n]);
        if !solve_factorised(factor, pivots, &mut self.right, 1) {
            return false;
        }
        block.columns.iter().zip(&self.right).for_each(|(&i, x)| self.d[i] = *x);
        true
    }
}
