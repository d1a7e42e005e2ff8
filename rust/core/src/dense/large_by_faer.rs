//! Work on large dense matrices, and the order in which large sparse ones are eliminated, by faer.

use std::cell::RefCell;

use faer::diag::DiagMut;
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::{LltError, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::cholesky::llt::inverse::{inverse as llt_inverse, inverse_scratch as llt_inverse_scratch};
use faer::linalg::evd::{self, ComputeEigenvectors};
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::prelude::{ReborrowMut, default};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;
use faer::{Accum, MatMut, MatRef, Par};

/// The memory that faer needs, kept by each thread: to factorise again allocates nothing.
#[derive(Default)]
struct Scratch {
    columns: Vec<f64>,
    diagonal: Vec<f64>,
    size: usize,
    memory: Option<MemBuffer>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Cholesky's factor of a symmetric matrix, row by row, as `super::cholesky` gives it.
pub fn cholesky(a: &mut [f64], n: usize, least: impl Fn(f64) -> f64) -> Result<(), usize> {
    SCRATCH.with_borrow_mut(|scratch| {
        if scratch.size < n {
            let needed = cholesky_in_place_scratch::<f64>(n, Par::Seq, default());
            (scratch.memory, scratch.size) = (Some(MemBuffer::new(needed)), n);
        }
        let Scratch { columns, diagonal, memory, .. } = scratch;
        let stack = MemStack::new(memory.as_mut().expect("just made"));
        // faer reads the lower triangle by columns.
        columns.clear();
        columns.resize(n * n, 0.0);
        let mut matrix = MatMut::from_column_major_slice_mut(columns, n, n);
        matrix.copy_from_triangular_lower(MatRef::from_row_major_slice(&a[..n * n], n, n));
        diagonal.clear();
        diagonal.extend((0..n).map(|i| a[i * n + i]));
        let done = cholesky_in_place(matrix.rb_mut(), default(), Par::Seq, stack, default());
        let reached = match done {
            Ok(_) => n,
            Err(LltError::NonPositivePivot { index }) => index,
        };
        // The first small pivot, where the factor is defined.
        let small = |i: &usize| {
            let pivot = columns[i * n + i].powi(2);
            pivot.is_nan() || pivot <= least(diagonal[*i])
        };
        if let Some(i) = (0..reached).find(small).or((reached < n).then_some(reached)) {
            return Err(i);
        }
        let factor = MatRef::from_column_major_slice(columns, n, n);
        MatMut::from_row_major_slice_mut(&mut a[..n * n], n, n).copy_from_triangular_lower(factor);
        Ok(())
    })
}

/// out += a b, with a (m, k) and b (k, n), column by column.
pub fn add_product(out: &mut [f64], a: &[f64], b: &[f64], [m, k, n]: [usize; 3]) {
    let (a, b) = (MatRef::from_column_major_slice(a, m, k), MatRef::from_column_major_slice(b, k, n));
    matmul(MatMut::from_column_major_slice_mut(out, m, n), Accum::Add, a, b, 1.0, Par::Seq);
}

/// out = aᵀ b, with a (k, m) and b (k, n), column by column.
pub fn transposed_product(out: &mut [f64], a: &[f64], b: &[f64], [m, k, n]: [usize; 3]) {
    let (a, b) = (MatRef::from_column_major_slice(a, k, m), MatRef::from_column_major_slice(b, k, n));
    matmul(MatMut::from_column_major_slice_mut(out, m, n), Accum::Replace, a.transpose(), b, 1.0, Par::Seq);
}

/// Adds the lower triangle of aᵀ b to that of `to` (k, k), which stands column by column. Of a and b, row by row, the first k
/// numbers of so many rows count; rows and columns are `stride` numbers apart.
pub fn add_lower_product(to: &mut [f64], a: &[f64], b: &[f64], [k, stride, rows]: [usize; 3]) {
    let a = MatRef::from_row_major_slice_with_stride(&a[..rows * stride], rows, k, stride);
    let b = MatRef::from_row_major_slice_with_stride(&b[..rows * stride], rows, k, stride);
    let to = MatMut::from_column_major_slice_with_stride_mut(to, k, k, stride);
    let full = BlockStructure::Rectangular;
    let lower = BlockStructure::TriangularLower;
    triangular::matmul(to, lower, Accum::Add, a.transpose(), full, b, full, 1.0, Par::Seq);
}

/// The inverse of L Lᵀ, as `super::inverse_of_first` gives it.
pub fn inverse_of_first(factor: &[f64], m: usize, inverse: &mut [f64], k: usize) {
    let factor = MatRef::from_row_major_slice_with_stride(&factor[..k * m], k, k, m);
    let mut memory = MemBuffer::new(llt_inverse_scratch::<f64>(k, Par::Seq));
    let out = MatMut::from_row_major_slice_mut(inverse, k, k);
    llt_inverse(out, factor, Par::Seq, MemStack::new(&mut memory));
    for i in 0..k {
        (0..i).for_each(|j| inverse[j * k + i] = inverse[i * k + j]);
    }
}

/// Solves L Lᵀ x = b in place, with L in the lower triangle, column by column.
pub fn solve(factor: &[f64], n: usize, b: &mut [f64]) {
    let factor = MatRef::from_column_major_slice(&factor[..n * n], n, n);
    let mut right = MatMut::from_column_major_slice_mut(b, n, 1);
    solve_lower_triangular_in_place(factor, right.rb_mut(), Par::Seq);
    solve_upper_triangular_in_place(factor.transpose(), right, Par::Seq);
}

/// Memory for Cholesky's factorisation and for eigenvalues.
#[derive(Default)]
pub struct Workspace {
    size: usize,
    memory: Option<MemBuffer>,
}

impl std::fmt::Debug for Workspace {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Workspace").field("size", &self.size).finish_non_exhaustive()
    }
}

impl Workspace {
    /// Makes room for matrices of so many rows.
    pub fn reserve(&mut self, n: usize) {
        let n = n.max(1);
        if self.size < n {
            let cholesky = cholesky_in_place_scratch::<f64>(n, Par::Seq, default());
            let eigen =
                evd::self_adjoint_evd_scratch::<f64>(n, ComputeEigenvectors::Yes, Par::Seq, default());
            self.memory = Some(MemBuffer::new(StackReq::any_of(&[cholesky, eigen])));
            self.size = n;
        }
    }

    /// Most rows that there is room for.
    pub fn size(&self) -> usize {
        self.size
    }

    fn stack(&mut self) -> &mut MemStack {
        MemStack::new(self.memory.as_mut().expect("reserved"))
    }

    /// Factorises a symmetric matrix in place, column by column; whether it is positive definite.
    pub fn factorise(&mut self, a: &mut [f64], n: usize) -> bool {
        let matrix = MatMut::from_column_major_slice_mut(a, n, n);
        cholesky_in_place(matrix, default(), Par::Seq, self.stack(), default()).is_ok()
    }

    /// Eigenvalues of a symmetric matrix, ascending, and its eigenvectors, one after the other; whether they were found.
    pub fn eigen(&mut self, a: &[f64], values: &mut [f64], vectors: &mut [f64], n: usize) -> bool {
        let matrix = MatRef::from_column_major_slice(a, n, n);
        let vectors = MatMut::from_column_major_slice_mut(vectors, n, n);
        let values = DiagMut::from_slice_mut(values);
        evd::self_adjoint_evd(matrix, values, Some(vectors), Par::Seq, self.stack(), default()).is_ok()
    }
}

/// The rows of a symmetric sparse matrix by approximate minimum degree. Those that row i has entries with are from `start[i]` to
/// `start[i + 1]` in `index`, i itself among them or not.
pub fn minimum_degree(start: &[usize], index: &[usize]) -> Vec<u32> {
    let m = start.len() - 1;
    let mut scratch = MemBuffer::new(amd::order_maybe_unsorted_scratch::<usize>(m, index.len()));
    let (mut order, mut inverse) = (vec![0; m], vec![0; m]);
    let graph = SymbolicSparseColMatRef::new_unsorted_checked(m, m, start, None, index);
    let stack = MemStack::new(&mut scratch);
    match amd::order_maybe_unsorted(&mut order, &mut inverse, graph, amd::Control::default(), stack) {
        Ok(_) => order.into_iter().map(|i| i as u32).collect(),
        // Too many entries to count: any order is right.
        Err(_) => (0..m as u32).collect(),
    }
}
