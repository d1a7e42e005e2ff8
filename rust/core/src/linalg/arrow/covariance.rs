//! The covariance of parameters and initial states.

use nalgebra::DMatrix;

use super::ArrowKkt;
use crate::dense::large::add_product;
use crate::index::VariableId;
use crate::interrupt::current;

/// Columns that are computed between two looks at the interrupt.
const COLUMNS: usize = 32;

impl ArrowKkt {
    /// Computes the covariance from the reduced Hessian; returns whether all `wanted` variables are parameters and first
    /// states, for which this is possible.
    pub(super) fn read_covariance(&mut self, wanted: &[VariableId], out: &mut [f64]) -> bool {
        let (n, border, k) = (self.plan.shape.n, self.plan.shape.border, wanted.len());
        // With the end states that stay in the border beside the parameters.
        let size = self.diagonal.len();
        let mut of_border = DMatrix::<f64>::identity(size, size);
        let interrupt = current();
        for mut column in of_border.column_iter_mut() {
            if interrupt.stops() {
                out.fill(f64::NAN);
                return true;
            }
            self.constraint_side.fill(0.0);
            self.border.solve(column.as_mut_slice(), &mut self.constraint_side);
        }
        for i in (0..border).filter(|&i| self.held[i]) {
            of_border.row_mut(i).fill(0.0);
            of_border.column_mut(i).fill(0.0);
        }
        // Everything wanted follows θ, and initial states of one chain vary beside.
        let mut follow = DMatrix::zeros(k, size);
        let mut beside = DMatrix::<f64>::zeros(k, k);
        let mut found = 0;
        for (row, &i) in wanted.iter().enumerate().filter(|w| w.1.0 < border) {
            follow[(row, i.0)] = 1.0;
            found += 1;
        }
        for (plan, tree) in self.plan.chains.iter().zip(&self.forest.trees) {
            let first = plan.chain.variable.0..plan.chain.variable.0 + n;
            let here: Vec<(usize, usize)> = wanted
                .iter()
                .enumerate()
                .filter(|w| first.contains(&w.1.0))
                .map(|(row, i)| (row, i.0 - first.start))
                .collect();
            if here.is_empty() {
                continue;
            }
            found += here.len();
            let (along, free) = tree.top.first_states(&self.plan.shape, size);
            for &(row, i) in &here {
                follow.row_mut(row).copy_from(&(along.row(i) / self.units[i]));
                for &(other, j) in &here {
                    beside[(row, other)] = free[(i, j)] / (self.units[i] * self.units[j]);
                }
            }
        }
        if found < k {
            return false;
        }
        let mut all = beside;
        let back = follow.transpose();
        for first in (0..k).step_by(COLUMNS) {
            let count = COLUMNS.min(k - first);
            if interrupt.stops() {
                out.fill(f64::NAN);
                return true;
            }
            let (these, own) = (size * first..size * (first + count), k * first..k * (first + count));
            let mut of_these = vec![0.0; size * count];
            add_product(&mut of_these, of_border.as_slice(), &back.as_slice()[these], [size, size, count]);
            add_product(&mut all.as_mut_slice()[own], follow.as_slice(), &of_these, [k, size, count]);
        }
        for (i, row) in out.chunks_exact_mut(k).enumerate() {
            row.iter_mut().enumerate().for_each(|(j, o)| *o = all[(i, j)]);
        }
        true
    }
}
