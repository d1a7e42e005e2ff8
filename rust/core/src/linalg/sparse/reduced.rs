//! The reduced Hessian ZᵀHZ, dense: its inertia, its weak directions, its solutions.

use faer::diag::DiagMut;
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt;
use faer::linalg::evd::{self, ComputeEigenvectors};
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::prelude::default;
use faer::{Accum, MatMut, MatRef, Par};

use super::basis::{Basis, axpy};
use super::rows::Rows;
use crate::linalg::Curvature;
use crate::simd::kernel;

/// Eigenvalues of the reduced Hessian, its columns scaled to 1, of this size or less are zero.
const ZERO: f64 = 1e-12;
/// Pivots of Cholesky's factor above this leave no doubt that no eigenvalue is zero.
const CLEAR: f64 = 1e-6;
/// A held variable of which others held leave less than this part free cannot be held.
const IMMOVABLE: f64 = 1e-10;
/// Nor can one that moves by less than this, in units, with any of the free variables.
const UNMOVED: f64 = 1e-12;
/// A free variable whose curvature is below this part of the greatest entry of H has none: (10⁻¹²)², what
/// is left of an effect that has been cancelled.
const NO_EFFECT: f64 = 1e-24;
/// Rows of Z that are multiplied at once.
const PANEL: usize = 96;

/// Symmetric matrices over the free variables, column-major, and what `finish` makes of them.
#[derive(Debug, Default)]
pub(super) struct Reduced {
    k: usize,
    stride: usize,
    /// ZᵀHZ and Zᵀ D Z, the lower triangles.
    hessian: Vec<f64>,
    shift: Vec<f64>,
    has_shift: bool,
    /// Σ |H_ii| z_ij², for each free variable j: its curvature if nothing cancelled.
    size: Vec<f64>,
    largest: f64,
    /// Free variables that are not held, and what makes their columns of order one.
    active: Vec<usize>,
    root: Vec<f64>,
    /// Held variables of the basis, each with its position, and those that cannot be held.
    kept: Vec<u32>,
    immovable: Vec<u32>,
    /// Reflections that turn held variables into coordinates, one row each, and the triangle (row-major,
    /// `kept` squared) that is left.
    reflections: Vec<f64>,
    triangle: Vec<f64>,
    /// ZᵀHZ in these coordinates: `active` squared, both triangles.
    matrix: Vec<f64>,
    /// Cholesky's factor, or eigenvectors, of its trailing block, column-major.
    factor: Vec<f64>,
    vectors: Vec<f64>,
    values: Vec<f64>,
    by_eigenvalues: bool,
    curvature: Curvature,
    panels: (Vec<f64>, Vec<f64>),
    mixed: Vec<f64>,
    side: Vec<f64>,
    scratch: Scratch,
    operations: u64,
}

/// Memory for Cholesky's factorisation and for eigenvalues.
#[derive(Default)]
struct Scratch {
    size: usize,
    memory: Option<MemBuffer>,
}

impl Scratch {
    fn reserve(&mut self, k: usize) {
        if self.size < k || self.memory.is_none() {
            let k = k.max(1);
            let cholesky = llt::factor::cholesky_in_place_scratch::<f64>(k, Par::Seq, default());
            let eigen =
                evd::self_adjoint_evd_scratch::<f64>(k, ComputeEigenvectors::Yes, Par::Seq, default());
            self.memory = Some(MemBuffer::new(StackReq::any_of(&[cholesky, eigen])));
            self.size = k;
        }
    }

    fn stack(&mut self) -> &mut MemStack {
        MemStack::new(self.memory.as_mut().expect("reserved by assemble"))
    }
}

impl std::fmt::Debug for Scratch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Scratch").field("size", &self.size).finish_non_exhaustive()
    }
}

impl Reduced {
    /// Counted floating-point operations of the last [`Reduced::assemble`], and of a factorisation.
    pub fn operations(&self) -> u64 {
        self.operations + (self.k as u64).pow(3) / 3
    }

    /// ZᵀHZ from H, both triangles.
    pub fn assemble(&mut self, h: &Rows, basis: &Basis) {
        let k = basis.free().len();
        (self.k, self.stride) = (k, basis.stride());
        self.has_shift = false;
        for all in [&mut self.hessian, &mut self.shift, &mut self.mixed] {
            all.clear();
            all.resize(k * self.stride, 0.0);
        }
        self.size.clear();
        self.size.resize(self.stride, 0.0);
        self.largest = h.values().iter().fold(0.0f64, |a, v| a.max(v.abs()));
        self.panels.0.resize(PANEL * self.stride, 0.0);
        self.panels.1.resize(PANEL * self.stride, 0.0);
        products(self, h, basis);
        // H between free and other variables counts twice, as two triangles.
        for j in 0..k {
            for i in j..k {
                let both = self.mixed[i * self.stride + j] + self.mixed[j * self.stride + i];
                self.hessian[j * self.stride + i] += both;
            }
        }
        for (i, &v) in basis.free().iter().enumerate() {
            for (w, value) in h.row(v as usize) {
                if let Err(j) = basis.place(w)
                    && j <= i
                {
                    self.hessian[j * self.stride + i] += value;
                    self.size[i] += if i == j { value.abs() } else { 0.0 };
                }
            }
        }
        self.scratch.reserve(k);
    }

    /// Zᵀ D Z, D diagonal.
    fn assemble_shift(&mut self, d: &[f64], basis: &Basis) {
        weighted_squares(self, d, basis);
        for (i, &v) in basis.free().iter().enumerate() {
            self.shift[i * self.stride + i] += d[v as usize];
        }
        self.has_shift = true;
    }

    /// Factorises with some variables held and `shift` times the diagonal `d` added to H.
    pub fn finish(&mut self, basis: &Basis, held: &[bool], shift: f64, d: &[f64]) -> Curvature {
        if shift > 0.0 && !self.has_shift {
            self.assemble_shift(d, basis);
        }
        self.active.clear();
        self.active.extend((0..self.k).filter(|&j| !held[basis.free()[j] as usize]));
        self.scale(shift);
        self.hold(basis, held);
        self.curvature = self.factorize();
        self.curvature.zero += self.immovable.len();
        self.curvature
    }

    /// The matrix over active variables with rows and columns of order one.
    fn scale(&mut self, shift: f64) {
        let ka = self.active.len();
        let at = |i: usize, j: usize| i.min(j) * self.stride + i.max(j);
        self.matrix.clear();
        for &i in &self.active {
            let value = |&j: &usize| {
                let shifted = if shift > 0.0 { shift * self.shift[at(i, j)] } else { 0.0 };
                self.hessian[at(i, j)] + shifted
            };
            self.matrix.extend(self.active.iter().map(value));
        }
        let least = if self.largest > 0.0 { NO_EFFECT * self.largest } else { 1.0 };
        self.root.clear();
        for &j in &self.active {
            let shifted = if shift > 0.0 { shift * self.shift[at(j, j)] } else { 0.0 };
            self.root.push((self.size[j] + shifted).max(least).sqrt().recip());
        }
        for (row, &i) in self.matrix.chunks_exact_mut(ka.max(1)).zip(&self.root) {
            row.iter_mut().zip(&self.root).for_each(|(value, j)| *value *= i * j);
        }
        // A positive matrix has no entry above 1 now. In others, such as saddles with a zero diagonal,
        // rows are divided by the root of their greatest entry until none is far above it.
        for _ in 0..4 {
            self.side.clear();
            for row in self.matrix.chunks_exact(ka.max(1)) {
                let largest = row.iter().fold(0.0f64, |a, v| a.max(v.abs()));
                self.side.push(if largest > 2.0 { largest.sqrt().recip() } else { 1.0 });
            }
            if self.side.iter().all(|&s| s == 1.0) {
                break;
            }
            for (row, &i) in self.matrix.chunks_exact_mut(ka.max(1)).zip(&self.side) {
                row.iter_mut().zip(&self.side).for_each(|(value, j)| *value *= i * j);
            }
            self.root.iter_mut().zip(&self.side).for_each(|(root, s)| *root *= s);
        }
    }

    /// Turns held variables of the basis into the first coordinates, by reflections (Householder's QR with
    /// column exchanges), so that they can be struck off. Held variables that follow from others held, or
    /// from the constraints alone, are left out.
    fn hold(&mut self, basis: &Basis, held: &[bool]) {
        let ka = self.active.len();
        self.kept.clear();
        self.immovable.clear();
        self.reflections.clear();
        self.kept.extend(basis.pivots().iter().filter(|&&v| held[v as usize]));
        if self.kept.is_empty() {
            return;
        }
        // Rows of Z in scaled coordinates, and their lengths.
        self.side.clear();
        for &v in &self.kept {
            let z = basis.place(v as usize).map_or(&[][..], |j| basis.z(j));
            let start = self.reflections.len();
            let moves = self.active.iter().any(|&j| z[j].abs() > UNMOVED);
            self.reflections.extend(self.active.iter().zip(&self.root).map(|(&j, root)| z[j] * root));
            let length = norm(&self.reflections[start..]);
            let scale = if moves { length.recip() } else { 0.0 };
            self.reflections[start..].iter_mut().for_each(|z| *z *= scale);
            self.side.push(length);
        }
        let count = self.kept.len();
        self.triangle.clear();
        self.triangle.resize(count * count, 0.0);
        let mut rank = 0;
        while rank < count.min(ka) {
            let rest = |i: usize| norm(&self.reflections[i * ka + rank..(i + 1) * ka]);
            let (best, length) =
                (rank..count).map(|i| (i, rest(i))).fold((rank, -1.0), |a, b| if b.1 > a.1 { b } else { a });
            if length <= IMMOVABLE {
                break;
            }
            self.kept.swap(rank, best);
            self.side.swap(rank, best);
            for c in 0..ka {
                self.reflections.swap(rank * ka + c, best * ka + c);
            }
            for c in 0..rank {
                self.triangle.swap(c * count + rank, c * count + best);
            }
            // The reflection that turns what is left of this row into the next coordinate.
            let (done, after) = self.reflections.split_at_mut((rank + 1) * ka);
            let v = &mut done[rank * ka..];
            v[..rank].fill(0.0);
            let head = if v[rank] > 0.0 { -length } else { length };
            v[rank] -= head;
            let size = norm(v);
            v.iter_mut().for_each(|x| *x /= size);
            self.triangle[rank * count + rank] = head;
            for (i, row) in after.chunks_exact_mut(ka).enumerate() {
                reflect(v, row);
                self.triangle[rank * count + rank + 1 + i] = row[rank];
            }
            rank += 1;
        }
        self.immovable.extend(self.kept.drain(rank..));
        self.reflections.truncate(rank * ka);
        // Rᵀ c = target for rows of the original length.
        for r in 0..rank {
            for c in r..rank {
                self.triangle[r * rank + c] = self.triangle[r * count + c] * self.side[c];
            }
        }
        for v in self.reflections.chunks_exact(ka.max(1)) {
            self.matrix.chunks_exact_mut(ka).for_each(|row| reflect(v, row));
            // And from the left: the matrix is symmetric before, so rows take the place of columns.
            self.side.clear();
            self.side.resize(ka, 0.0);
            for (row, v) in self.matrix.chunks_exact(ka).zip(v) {
                self.side.iter_mut().zip(row).for_each(|(s, value)| *s += v * value);
            }
            for (row, v) in self.matrix.chunks_exact_mut(ka).zip(v) {
                row.iter_mut().zip(&self.side).for_each(|(value, s)| *value -= 2.0 * v * s);
            }
        }
    }

    /// Factorises what is left of the matrix: by Cholesky where it is clearly positive, else by eigenvalues.
    fn factorize(&mut self) -> Curvature {
        let (ka, rank) = (self.active.len(), self.kept.len());
        let k = ka - rank;
        self.by_eigenvalues = false;
        self.values.clear();
        self.factor.clear();
        for row in self.matrix.chunks_exact(ka.max(1)).skip(rank) {
            self.factor.extend(&row[rank..]);
        }
        if k == 0 {
            return Curvature::default();
        }
        self.values.resize(k, 0.0);
        self.vectors.clear();
        self.vectors.extend(&self.factor);
        if !self.factor.iter().all(|x| x.is_finite()) {
            return self.unknown();
        }
        let matrix = MatMut::from_column_major_slice_mut(&mut self.factor, k, k);
        let positive =
            llt::factor::cholesky_in_place(matrix, default(), Par::Seq, self.scratch.stack(), default())
                .is_ok();
        if positive && (0..k).all(|i| self.factor[i * k + i].powi(2) > CLEAR) {
            return Curvature::default();
        }
        // EVD reads one copy and writes its vectors over the factor.
        let whole = MatRef::from_column_major_slice(&self.vectors, k, k);
        let vectors = MatMut::from_column_major_slice_mut(&mut self.factor, k, k);
        let values = DiagMut::from_slice_mut(&mut self.values);
        let stack = self.scratch.stack();
        if evd::self_adjoint_evd(whole, values, Some(vectors), Par::Seq, stack, default()).is_err() {
            return self.unknown();
        }
        self.by_eigenvalues = true;
        let zero = self.zero();
        Curvature {
            negative: self.values.iter().filter(|&&value| value < -zero).count(),
            zero: self.values.iter().filter(|&&value| value.abs() <= zero).count(),
        }
    }

    /// Numbers that are not finite have no curvature.
    fn unknown(&mut self) -> Curvature {
        let k = self.values.len();
        self.by_eigenvalues = true;
        self.values.fill(0.0);
        self.factor.fill(0.0);
        Curvature { negative: 0, zero: k }
    }

    /// Eigenvalues of this size or less are zero.
    fn zero(&self) -> f64 {
        ZERO * self.values.iter().fold(1.0f64, |a, v| a.max(v.abs()))
    }

    /// Held variables that `solve` holds: those of the basis that can be.
    pub fn kept(&self) -> &[u32] {
        &self.kept
    }

    /// Held variables that constraints and others held leave no choice.
    pub fn immovable(&self) -> &[u32] {
        &self.immovable
    }

    /// Number of directions of no curvature, or negative; the most negative first.
    pub fn weak(&self) -> usize {
        // Values ascend.
        let zero = self.zero();
        if self.by_eigenvalues { self.values.iter().filter(|&&v| v <= zero).count() } else { 0 }
    }

    /// Writes such a direction into the free variables of d.
    pub fn weak_direction(&mut self, number: usize, basis: &Basis, d: &mut [f64]) {
        let (ka, rank) = (self.active.len(), self.kept.len());
        let k = ka - rank;
        self.side.clear();
        self.side.resize(rank, 0.0);
        self.side.extend(&self.factor[number * k..(number + 1) * k]);
        self.back(basis, d);
    }

    /// Solves Z̄ᵀHZ̄ u = Z̄ᵀg over directions Z̄ that move no held variable, after a step that takes kept
    /// variables to `target`. Reads g = Zᵀp and writes d at free variables; leaves in `target` what holds
    /// the kept ones.
    pub fn solve(&mut self, basis: &Basis, g: &[f64], target: &mut [f64], d: &mut [f64]) {
        let (ka, rank) = (self.active.len(), self.kept.len());
        let k = ka - rank;
        self.side.clear();
        self.side
            .extend(self.active.iter().zip(&self.root).map(|(&j, root)| g[basis.free()[j] as usize] * root));
        self.reflections.chunks_exact(ka.max(1)).for_each(|v| reflect(v, &mut self.side));
        // Coordinates of the held: Rᵀ c = target.
        for i in 0..rank {
            let sum: f64 = (0..i).map(|r| self.triangle[r * rank + i] * target[r]).sum();
            target[i] = (target[i] - sum) / self.triangle[i * rank + i];
        }
        for (value, row) in self.side.iter_mut().zip(self.matrix.chunks_exact(ka.max(1))) {
            *value -= row.iter().zip(&*target).map(|(m, c)| m * c).sum::<f64>();
        }
        let zero = self.zero();
        let u = &mut self.side[rank..];
        if self.by_eigenvalues {
            // Directions of no curvature are left alone.
            self.vectors.clear();
            self.vectors.resize(k, 0.0);
            for (vector, &value) in self.factor.chunks_exact(k.max(1)).zip(&self.values) {
                if value.abs() > zero {
                    let along = vector.iter().zip(&*u).map(|(v, u)| v * u).sum::<f64>() / value;
                    self.vectors.iter_mut().zip(vector).for_each(|(to, v)| *to += along * v);
                }
            }
            u.copy_from_slice(&self.vectors);
        } else {
            cholesky_solve(&self.factor, u);
        }
        // R ν = what is left at the held.
        let (head, u) = self.side.split_at_mut(rank);
        for (value, row) in head.iter_mut().zip(self.matrix.chunks_exact(ka.max(1))) {
            *value -= row[rank..].iter().zip(&*u).map(|(m, u)| m * u).sum::<f64>();
        }
        for i in (0..rank).rev() {
            let sum: f64 = (i + 1..rank).map(|c| self.triangle[i * rank + c] * head[c]).sum();
            head[i] = (head[i] - sum) / self.triangle[i * rank + i];
        }
        // Both are small: c takes the place of ν and the other way round.
        target.iter_mut().zip(head).for_each(|(t, h)| std::mem::swap(t, h));
        self.back(basis, d);
    }

    /// From coordinates in `side` to free variables.
    fn back(&mut self, basis: &Basis, d: &mut [f64]) {
        let ka = self.active.len();
        self.reflections.chunks_exact(ka.max(1)).rev().for_each(|v| reflect(v, &mut self.side));
        basis.free().iter().for_each(|&v| d[v as usize] = 0.0);
        for ((&j, root), value) in self.active.iter().zip(&self.root).zip(&self.side) {
            d[basis.free()[j] as usize] = root * value;
        }
    }
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Reflects x at the plane across the unit vector v.
fn reflect(v: &[f64], x: &mut [f64]) {
    let along: f64 = v.iter().zip(&*x).map(|(v, x)| v * x).sum();
    x.iter_mut().zip(v).for_each(|(x, v)| *x -= 2.0 * along * v);
}

/// Solves L Lᵀ u = b in place, L column-major.
fn cholesky_solve(l: &[f64], u: &mut [f64]) {
    let k = u.len();
    for i in 0..k {
        u[i] /= l[i * k + i];
        let (done, rest) = u.split_at_mut(i + 1);
        rest.iter_mut().zip(&l[i * k + i + 1..(i + 1) * k]).for_each(|(u, l)| *u -= l * done[i]);
    }
    for i in (0..k).rev() {
        let sum: f64 = l[i * k + i + 1..(i + 1) * k].iter().zip(&u[i + 1..]).map(|(l, u)| l * u).sum();
        u[i] = (u[i] - sum) / l[i * k + i];
    }
}

/// Adds the product of the first rows of two panels, AᵀB, of which only the lower triangle is wanted.
fn multiply(to: &mut [f64], k: usize, stride: usize, panels: &(Vec<f64>, Vec<f64>), rows: usize) {
    if rows == 0 || k == 0 {
        return;
    }
    let a = MatRef::from_row_major_slice_with_stride(&panels.0[..rows * stride], rows, k, stride);
    let b = MatRef::from_row_major_slice_with_stride(&panels.1[..rows * stride], rows, k, stride);
    let to = MatMut::from_column_major_slice_with_stride_mut(to, k, k, stride);
    let full = BlockStructure::Rectangular;
    let lower = BlockStructure::TriangularLower;
    triangular::matmul(to, lower, Accum::Add, a.transpose(), full, b, full, 1.0, Par::Seq);
}

kernel! {
    /// Parts of ZᵀHZ that come from the basis: with itself, and with free variables.
    fn products(r: &mut Reduced, h: &Rows, basis: &Basis) {
        let (k, stride) = (r.k, r.stride);
        let mut rows = 0;
        r.operations = 0;
        for (j, &v) in basis.pivots().iter().enumerate() {
            let z = basis.z(j);
            let product = &mut r.panels.1[rows * stride..(rows + 1) * stride];
            product.fill(0.0);
            let mut any = false;
            for (w, value) in h.row(v as usize) {
                if value == 0.0 {
                    continue;
                }
                match basis.place(w) {
                    Ok(other) => {
                        axpy(product, value, basis.z(other));
                        any = true;
                    }
                    Err(column) => axpy(&mut r.mixed[column * stride..(column + 1) * stride], value, z),
                }
                if w == v as usize {
                    for (size, z) in r.size.iter_mut().zip(z) {
                        *size += value.abs() * z * z;
                    }
                }
                r.operations += 2 * k as u64;
            }
            // Points between samples have no part in the likelihood.
            if any {
                r.panels.0[rows * stride..(rows + 1) * stride].copy_from_slice(z);
                r.operations += (k * k) as u64;
                rows += 1;
            }
            if rows == PANEL {
                multiply(&mut r.hessian, k, stride, &r.panels, rows);
                rows = 0;
            }
        }
        multiply(&mut r.hessian, k, stride, &r.panels, rows);
    }
}

kernel! {
    /// The part of Zᵀ D Z that comes from the basis.
    fn weighted_squares(r: &mut Reduced, d: &[f64], basis: &Basis) {
        let stride = r.stride;
        for (number, pivots) in basis.pivots().chunks(PANEL).enumerate() {
            let to = r.panels.0.chunks_exact_mut(stride.max(1)).zip(r.panels.1.chunks_exact_mut(stride.max(1)));
            for ((j, &v), (plain, weighted)) in pivots.iter().enumerate().zip(to) {
                let z = basis.z(number * PANEL + j);
                plain.copy_from_slice(z);
                weighted.iter_mut().zip(z).for_each(|(to, z)| *to = d[v as usize] * z);
            }
            multiply(&mut r.shift, r.k, stride, &r.panels, pivots.len());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::multiply;

    /// faer 0.24.4 writes the other triangle of a row-major matrix, so this is not taken for granted.
    #[test]
    fn products_are_added_to_the_lower_triangle() {
        for k in 1..50usize {
            for rows in [1, 2, 7, 96] {
                let stride = k.next_multiple_of(8);
                let entry =
                    |i: usize, j: usize, of: usize| if j < k { ((i * 7 + j * of) % 11) as f64 } else { 0.0 };
                let panel = |of| (0..rows * stride).map(|at| entry(at / stride, at % stride, of)).collect();
                let mut to = vec![1.0; k * stride];
                multiply(&mut to, k, stride, &(panel(3), panel(5)), rows);
                for i in 0..k {
                    for j in 0..=i {
                        let sum: f64 = (0..rows).map(|r| entry(r, i, 3) * entry(r, j, 5)).sum();
                        assert_eq!(to[j * stride + i], 1.0 + sum, "{i}, {j} of {k}, {rows} rows");
                    }
                }
            }
        }
    }
}
