//! Work on large dense matrices, and the order in which large sparse ones are eliminated, by loops and, for eigenvalues, by nalgebra.

use std::collections::{BTreeSet, BinaryHeap};

use nalgebra::{DMatrix, SymmetricEigen};

use super::loops::{by_loops, dot_of, inverse_by_loops};
use crate::simd::kernel;

/// Cholesky's factor of a symmetric matrix, row by row, as `super::cholesky` gives it.
pub fn cholesky(a: &mut [f64], n: usize, least: impl Fn(f64) -> f64) -> Result<(), usize> {
    by_loops(a, n, least)
}

kernel! {
    /// out += a b, with a (m, k) and b (k, n), column by column.
    pub fn add_product(out: &mut [f64], a: &[f64], b: &[f64], sizes: [usize; 3]) {
        let [m, k, n] = sizes;
        for j in 0..n {
            let out = &mut out[j * m..(j + 1) * m];
            for l in 0..k {
                let factor = b[j * k + l];
                out.iter_mut().zip(&a[l * m..(l + 1) * m]).for_each(|(o, a)| *o += factor * a);
            }
        }
    }
}

kernel! {
    /// out = aᵀ b, with a (k, m) and b (k, n), column by column.
    pub fn transposed_product(out: &mut [f64], a: &[f64], b: &[f64], sizes: [usize; 3]) {
        let [m, k, n] = sizes;
        for j in 0..n {
            for i in 0..m {
                out[j * m + i] = dot_of(&a[i * k..(i + 1) * k], &b[j * k..(j + 1) * k]);
            }
        }
    }
}

kernel! {
    /// Adds the lower triangle of aᵀ b to that of `to` (k, k), which stands column by column. Of a and b, row by row, the first k
    /// numbers of so many rows count; rows and columns are `stride` numbers apart.
    pub fn add_lower_product(to: &mut [f64], a: &[f64], b: &[f64], sizes: [usize; 3]) {
        let [k, stride, rows] = sizes;
        for r in 0..rows {
            let (a, b) = (&a[r * stride..r * stride + k], &b[r * stride..r * stride + k]);
            for j in 0..k {
                let column = &mut to[j * stride + j..j * stride + k];
                column.iter_mut().zip(&a[j..]).for_each(|(t, a)| *t += b[j] * a);
            }
        }
    }
}

/// The inverse of L Lᵀ for zeros (k, k), as `super::inverse_of_first` gives it.
pub fn inverse_of_first(factor: &[f64], m: usize, inverse: &mut [f64], k: usize) {
    inverse_by_loops(factor, m, inverse, k);
}

/// Solves L Lᵀ x = b in place, with L in the lower triangle, column by column.
pub fn solve(factor: &[f64], n: usize, b: &mut [f64]) {
    for j in 0..n {
        b[j] /= factor[j * n + j];
        let (x, rest) = (b[j], &mut b[j + 1..n]);
        rest.iter_mut().zip(&factor[j * n + j + 1..(j + 1) * n]).for_each(|(b, l)| *b -= l * x);
    }
    for j in (0..n).rev() {
        let sum = dot_of(&factor[j * n + j + 1..(j + 1) * n], &b[j + 1..n]);
        b[j] = (b[j] - sum) / factor[j * n + j];
    }
}

/// The largest size so far.
#[derive(Debug, Default)]
pub struct Workspace {
    size: usize,
}

impl Workspace {
    /// Makes room for matrices of so many rows.
    pub fn reserve(&mut self, n: usize) {
        self.size = self.size.max(n);
    }

    /// Most rows that there is room for.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Factorises a symmetric matrix in place, column by column; whether it is positive definite.
    pub fn factorise(&mut self, a: &mut [f64], n: usize) -> bool {
        let done = by_loops(a, n, |_| 0.0).is_ok();
        for i in 0..n {
            (0..i).for_each(|j| a[j * n + i] = a[i * n + j]);
        }
        done
    }

    /// Eigenvalues of a symmetric matrix, ascending, and its eigenvectors, one after the other; whether they were found.
    pub fn eigen(&mut self, a: &[f64], values: &mut [f64], vectors: &mut [f64], n: usize) -> bool {
        let Some(found) =
            SymmetricEigen::try_new(DMatrix::from_column_slice(n, n, &a[..n * n]), f64::EPSILON, 0)
        else {
            return false;
        };
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|&i, &j| found.eigenvalues[i].total_cmp(&found.eigenvalues[j]));
        for (to, &from) in order.iter().enumerate() {
            values[to] = found.eigenvalues[from];
            vectors[to * n..(to + 1) * n].copy_from_slice(found.eigenvectors.column(from).as_slice());
        }
        true
    }
}

/// The rows of a symmetric sparse matrix by minimum degree. Those that row i has entries with are from `start[i]` to
/// `start[i + 1]` in `index`, i itself among them or not.
pub fn minimum_degree(start: &[usize], index: &[usize]) -> Vec<u32> {
    let m = start.len() - 1;
    let mut near: Vec<BTreeSet<usize>> =
        (0..m).map(|i| index[start[i]..start[i + 1]].iter().copied().filter(|&j| j != i).collect()).collect();
    let mut degrees: BinaryHeap<_> = (0..m).map(|i| std::cmp::Reverse((near[i].len(), i))).collect();
    let mut done = vec![false; m];
    let mut order = Vec::with_capacity(m);
    while let Some(std::cmp::Reverse((degree, i))) = degrees.pop() {
        // What has changed since stands further down, as it is now.
        if done[i] || degree != near[i].len() {
            continue;
        }
        done[i] = true;
        order.push(i as u32);
        let others = std::mem::take(&mut near[i]);
        for &j in &others {
            near[j].extend(others.iter().filter(|&&other| other != j));
            near[j].remove(&i);
            degrees.push(std::cmp::Reverse((near[j].len(), j)));
        }
    }
    order
}
