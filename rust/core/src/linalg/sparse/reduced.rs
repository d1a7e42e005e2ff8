//! The reduced Hessian ZᵀHZ: its inertia, its weak directions, its solutions.

use super::basis::Basis;
use super::holding::Holding;
use super::products::Products;
use super::rows::Rows;
use crate::dense::large::{self, Workspace};
use crate::linalg::Curvature;

/// Eigenvalues of the reduced Hessian, its columns scaled to 1, of this size or less are zero.
const ZERO: f64 = 1e-12;
/// Pivots of Cholesky's factor above this leave no doubt that no eigenvalue is zero.
const CLEAR: f64 = 1e-6;
/// A free variable whose curvature is below this part of the greatest entry of H has none: (10⁻¹²)², what
/// is left of an effect that has been cancelled.
const NO_EFFECT: f64 = 1e-24;

/// The reduced Hessian and what `finish` makes of it.
#[derive(Debug, Default)]
pub(super) struct Reduced {
    products: Products,
    /// Free variables that are not held, and what makes their columns of order one.
    active: Vec<usize>,
    root: Vec<f64>,
    holding: Holding,
    /// ZᵀHZ in coordinates of which the first are held: `active` squared, both triangles.
    matrix: Vec<f64>,
    /// Cholesky's factor, or eigenvectors, of the block that is free, column-major.
    factor: Vec<f64>,
    copy: Vec<f64>,
    values: Vec<f64>,
    by_eigenvalues: bool,
    side: Vec<f64>,
    workspace: Workspace,
}

impl Reduced {
    /// Counted floating-point operations of the last [`Reduced::assemble`], and of a factorisation.
    pub fn operations(&self) -> u64 {
        self.products.operations() + (self.workspace.size() as u64).pow(3) / 3
    }

    /// Forms ZᵀHZ.
    pub fn assemble(&mut self, h: &Rows, basis: &Basis) {
        self.products.assemble(h, basis);
        self.workspace.reserve(basis.free().len());
    }

    /// Factorises with some variables held and `shift` times the diagonal `d` added to H.
    pub fn finish(&mut self, basis: &Basis, held: &[bool], shift: f64, d: &[f64]) -> Curvature {
        if shift > 0.0 {
            self.products.assemble_shift(d, basis);
        }
        self.active.clear();
        self.active.extend((0..basis.free().len()).filter(|&j| !held[basis.free()[j] as usize]));
        self.scale(shift);
        self.holding.choose(basis, held, &self.active, &self.root);
        self.holding.turn_matrix(&mut self.matrix);
        let mut found = self.factorize();
        found.zero += self.holding.immovable().len();
        found
    }

    /// The matrix over active variables with rows and columns of order one.
    fn scale(&mut self, shift: f64) {
        let (active, products) = (&self.active, &self.products);
        self.matrix.clear();
        for &i in active {
            self.matrix.extend(active.iter().map(|&j| products.entry(i, j, shift)));
        }
        let least = if products.largest() > 0.0 { NO_EFFECT * products.largest() } else { 1.0 };
        self.root.clear();
        self.root.extend(active.iter().map(|&j| products.size(j, shift).max(least).sqrt().recip()));
        scale_both(&mut self.matrix, &self.root);
        // A positive matrix has no entry above 1 now. In others, such as saddles with a zero diagonal,
        // rows are divided by the root of their greatest entry until none is far above it.
        for _ in 0..4 {
            self.side.clear();
            for row in self.matrix.chunks_exact(active.len().max(1)) {
                let largest = row.iter().fold(0.0f64, |a, v| a.max(v.abs()));
                self.side.push(if largest > 2.0 { largest.sqrt().recip() } else { 1.0 });
            }
            if self.side.iter().all(|&s| s == 1.0) {
                break;
            }
            scale_both(&mut self.matrix, &self.side);
            self.root.iter_mut().zip(&self.side).for_each(|(root, s)| *root *= s);
        }
    }

    /// Numbers of coordinates that are held, and of all.
    fn sizes(&self) -> (usize, usize) {
        (self.holding.kept().len(), self.active.len())
    }

    /// Factorises the block that is free: by Cholesky where it is clearly positive, else by eigenvalues.
    fn factorize(&mut self) -> Curvature {
        let (held, all) = self.sizes();
        let k = all - held;
        self.by_eigenvalues = false;
        self.values.clear();
        self.factor.clear();
        if k == 0 {
            return Curvature::default();
        }
        for row in self.matrix.chunks_exact(all).skip(held) {
            self.factor.extend(&row[held..]);
        }
        self.values.resize(k, 0.0);
        self.copy.clone_from(&self.factor);
        if !self.factor.iter().all(|x| x.is_finite()) {
            return self.unknown();
        }
        let positive = self.workspace.factorise(&mut self.factor, k);
        if positive && (0..k).all(|i| self.factor[i * k + i].powi(2) > CLEAR) {
            return Curvature::default();
        }
        if !self.workspace.eigen(&self.copy, &mut self.values, &mut self.factor, k) {
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
        self.by_eigenvalues = true;
        self.values.fill(0.0);
        self.factor.fill(0.0);
        Curvature { negative: 0, zero: self.values.len() }
    }

    /// Eigenvalues of this size or less are zero.
    fn zero(&self) -> f64 {
        ZERO * self.values.iter().fold(1.0f64, |a, v| a.max(v.abs()))
    }

    /// Held variables of the basis.
    pub fn holding(&self) -> &Holding {
        &self.holding
    }

    /// Number of directions of no curvature, or negative; the most negative first.
    pub fn weak(&self) -> usize {
        // Values ascend.
        let zero = self.zero();
        if self.by_eigenvalues { self.values.iter().filter(|&&v| v <= zero).count() } else { 0 }
    }

    /// Writes such a direction into the free variables of d.
    pub fn weak_direction(&mut self, number: usize, basis: &Basis, d: &mut [f64]) {
        let (held, all) = self.sizes();
        let k = all - held;
        self.side.clear();
        self.side.resize(held, 0.0);
        self.side.extend(&self.factor[number * k..(number + 1) * k]);
        self.back(basis, d);
    }

    /// The step along the constraints that changes kept variables by `target` and is the best that does.
    /// Reads g = Zᵀp and writes d at free variables; leaves in `target` the forces on kept variables.
    pub fn solve(&mut self, basis: &Basis, g: &[f64], target: &mut [f64], d: &mut [f64]) {
        let (held, all) = self.sizes();
        let scaled = |(&j, root): (&usize, &f64)| g[basis.free()[j] as usize] * root;
        self.side.clear();
        self.side.extend(self.active.iter().zip(&self.root).map(scaled));
        self.holding.turn(&mut self.side);
        self.holding.coordinates(target);
        let rows = || self.matrix.chunks_exact(all.max(1));
        for (value, row) in self.side.iter_mut().zip(rows()) {
            *value -= row.iter().zip(&*target).map(|(m, c)| m * c).sum::<f64>();
        }
        let zero = self.zero();
        let (first, u) = self.side.split_at_mut(held);
        if self.by_eigenvalues {
            // Directions of no curvature are left alone.
            self.copy.clear();
            self.copy.extend(&*u);
            u.fill(0.0);
            for (vector, &value) in self.factor.chunks_exact(self.copy.len().max(1)).zip(&self.values) {
                if value.abs() > zero {
                    let along = vector.iter().zip(&self.copy).map(|(v, b)| v * b).sum::<f64>() / value;
                    u.iter_mut().zip(vector).for_each(|(u, v)| *u += along * v);
                }
            }
        } else {
            large::solve(&self.factor, u.len(), u);
        }
        for (value, row) in first.iter_mut().zip(rows()) {
            *value -= row[held..].iter().zip(&*u).map(|(m, u)| m * u).sum::<f64>();
        }
        self.holding.pull(first);
        target.swap_with_slice(first);
        self.back(basis, d);
    }

    /// Maps coordinates in `side` to free variables.
    fn back(&mut self, basis: &Basis, d: &mut [f64]) {
        self.holding.turn_back(&mut self.side);
        basis.free().iter().for_each(|&v| d[v as usize] = 0.0);
        for ((&j, root), value) in self.active.iter().zip(&self.root).zip(&self.side) {
            d[basis.free()[j] as usize] = root * value;
        }
    }
}

/// Multiplies rows and columns.
fn scale_both(matrix: &mut [f64], by: &[f64]) {
    for (row, i) in matrix.chunks_exact_mut(by.len().max(1)).zip(by) {
        row.iter_mut().zip(by).for_each(|(value, j)| *value *= i * j);
    }
}
