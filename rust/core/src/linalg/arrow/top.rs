//! The top: what is left of each chain are its two ends.
//!
//! n constraints C_a a + C_b b + C_θ θ = c, and boundary conditions beside them, leave n or fewer of the 2n
//! end states free: (a, b) = Z₂ u + Y θ + y, by an orthogonal decomposition of [C_a C_b]ᵀ. The reduced
//! Hessian in (u of every chain, θ) is small and dense; its inertia is that of the whole.
//!
//! A condition may be one that the ends alone cannot meet, or hardly: that an integrator without feedback ends where it
//! began, or that a motion begins in a given state from which small changes grow by [`GROWTH`] and more. Such a
//! condition determines θ. It is *deferred* to the border: as many end states w stay beside θ there, with
//! the constraint Rᵀ w + N θ = c. Small R does no harm so, while w = −R⁻ᵀ N θ would be single shooting's.

use nalgebra::DMatrix;

use super::border::{TINY, directions, scale_of};
use super::form::{Form, Side};
use super::shape::Shape;
use crate::dense::{backward, cholesky, forward, triangularise};
use crate::linalg::{Curvature, KktError};

/// A constraint is deferred where the ends meet it with changes that are as many times as large, or larger: the reduced
/// Hessian would have the square of that among its entries.
const GROWTH: f64 = 1e6;

/// Rounding errors, as a part of the terms.
const ROUNDING: f64 = 1e-14;

/// The top of one chain.
#[derive(Clone, Debug)]
pub(super) struct Top {
    /// Number of boundary conditions, k. There are c = n + k constraints; 2n − c end states are free.
    k: usize,
    /// The constraints in the order in which they are eliminated, those last that are deferred, and the number of these.
    order: Vec<usize>,
    deferred: usize,
    /// The place of w in the border.
    pub place: usize,
    /// N, deferred × B, their right-hand side, and their multipliers once the border is solved.
    along: Vec<f64>,
    pub right: Vec<f64>,
    pub forces: Vec<f64>,
    /// Boundary conditions in the layout of a form's constraints: k × (2n + dynamic).
    pub boundary: Vec<f64>,
    /// Their right-hand side, and their multipliers.
    pub target: Vec<f64>,
    pub multipliers: Vec<f64>,
    /// Columns (C_a C_b)ᵀ made triangular, 2n × c, and Zᵀ (2n × 2n): rows 0..c span the constraints.
    r: Vec<f64>,
    z: Vec<f64>,
    /// (a, b) = F (u, θ, w): 2n × (free + B + deferred).
    f: Vec<f64>,
    /// Reduced Hessian in (u, θ, w): (free + B + deferred)².
    reduced: Vec<f64>,
    /// Factor of its (u, u) block with the shift, and L⁻¹ K across to (θ, w).
    l: Vec<f64>,
    side: Vec<f64>,
    scale: Vec<f64>,
    /// Particular (a, b), and the right-hand side in u.
    y: Vec<f64>,
    p: Vec<f64>,
    scratch: Vec<f64>,
    /// Solution (a, b, θ).
    pub v: Vec<f64>,
}

impl Top {
    /// The top of a chain with k ≤ n boundary conditions.
    pub fn new(shape: &Shape, k: usize) -> Top {
        let (n, b, free) = (shape.n, shape.border, shape.n - k);
        Top {
            k,
            order: (0..n + k).collect(),
            deferred: 0,
            place: b,
            along: Vec::new(),
            right: Vec::new(),
            forces: Vec::new(),
            boundary: vec![0.0; k * (n + shape.used())],
            target: vec![0.0; k],
            multipliers: vec![0.0; k],
            r: vec![0.0; 2 * n * (n + k)],
            z: vec![0.0; 4 * n * n],
            f: vec![0.0; 2 * n * (free + b)],
            reduced: vec![0.0; (free + b) * (free + b)],
            l: vec![0.0; free * free],
            side: vec![0.0; free * b],
            scale: vec![0.0; free],
            y: vec![0.0; 2 * n],
            p: vec![0.0; free + b],
            scratch: vec![0.0; (n + b) * (2 * n + b)],
            v: vec![0.0; 2 * n + b],
        }
    }

    /// Number of constraints that are deferred to the border, and of end states that stay there.
    pub fn deferred(&self) -> usize {
        self.deferred
    }

    /// Makes [C_a C_b]ᵀ triangular, its columns in order.
    fn triangularise(&mut self, shape: &Shape, form: &Form) {
        let (n, outer, c) = (shape.n, shape.n + shape.used(), shape.n + self.k);
        let nn = 2 * n;
        for i in 0..nn {
            for (j, &row) in self.order.iter().enumerate() {
                let row = if row < n { &form.c[row * outer..] } else { &self.boundary[(row - n) * outer..] };
                self.r[i * c + j] = row[i];
            }
        }
        self.z.fill(0.0);
        (0..nn).for_each(|i| self.z[i * nn + i] = 1.0);
        triangularise(&mut self.r, nn, c, c, Some(&mut self.z));
    }

    /// Puts the constraints last that the ends do not determine well; whether there are any.
    fn defer(&mut self, c: usize) -> bool {
        let r = &self.r;
        let is_weak = |j: usize| {
            let square: f64 = (0..=j).map(|i| r[i * c + j].powi(2)).sum();
            r[j * c + j].abs() * GROWTH <= square.sqrt()
        };
        // Constraints are still in the order of their numbers.
        self.order.sort_by_key(|&j| is_weak(j));
        self.deferred = (0..c).filter(|&j| is_weak(j)).count();
        self.deferred > 0
    }

    /// The reduced Hessian of a form.
    ///
    /// # Errors
    /// Where its constraint and the boundary conditions are not finite.
    pub fn factorize(&mut self, shape: &Shape, form: &Form) -> Result<(), KktError> {
        let (n, border, full) = (shape.n, shape.border, shape.form());
        let (nn, outer, c, free) = (2 * n, n + shape.used(), n + self.k, n - self.k);
        self.order.sort_unstable();
        self.deferred = 0;
        self.triangularise(shape, form);
        if (0..c).any(|i| !self.r[i * c + i].is_finite()) {
            return Err(KktError::NotFinite);
        }
        if self.k > 0 && self.defer(c) {
            self.triangularise(shape, form);
        }
        let (deferred, met) = (self.deferred, c - self.deferred);
        if (0..met).any(|i| self.r[i * c + i] == 0.0) {
            return Err(KktError::Boundary);
        }
        let width = free + border + deferred;
        self.make_room(shape, width);
        // F = [Z₂ | −Z₁ R⁻ᵀ C_θ | Z of the end states w]
        self.f.fill(0.0);
        for i in 0..nn {
            let row = &mut self.f[i * width..(i + 1) * width];
            for j in 0..free {
                row[j] = self.z[(c + j) * nn + i];
            }
            for j in 0..deferred {
                row[free + border + j] = self.z[(met + j) * nn + i];
            }
        }
        self.along.fill(0.0);
        for (d, &b) in shape.dynamic.iter().enumerate() {
            let t = &mut self.scratch[..c];
            for (i, &row) in self.order.iter().enumerate() {
                let own = if row < n { &form.c[row * outer..] } else { &self.boundary[(row - n) * outer..] };
                let terms = (0..i.min(met)).map(|k| self.r[k * c + i] * t[k]);
                let (sum, size) = terms.fold((0.0, 0.0), |(sum, size), x| (sum + x, size + x.abs()));
                t[i] = own[nn + d] - sum;
                if i < met {
                    t[i] /= self.r[i * c + i];
                } else if t[i].abs() > ROUNDING * (own[nn + d].abs() + size) {
                    self.along[(i - met) * border + b] = t[i];
                }
            }
            for i in 0..nn {
                self.f[i * width + free + b] = -(0..met).map(|k| self.z[k * nn + i] * t[k]).sum::<f64>();
            }
        }
        // [F; I]ᵀ Q [F; I], first Q [F; I].
        let (f, q) = (&self.f, &form.q);
        let product = &mut self.scratch[..full * width];
        for (row, q) in product.chunks_exact_mut(width).zip(q.chunks_exact(full)) {
            row[..free].fill(0.0);
            row[free..free + border].copy_from_slice(&q[nn..]);
            row[free + border..].fill(0.0);
            for (q, f) in q.iter().zip(f.chunks_exact(width)) {
                row.iter_mut().zip(f).for_each(|(r, f)| *r += q * f);
            }
        }
        self.reduced[..free * width].fill(0.0);
        let (of_border, of_ends) = self.reduced[free * width..].split_at_mut(border * width);
        of_border.copy_from_slice(&product[nn * width..]);
        of_ends.fill(0.0);
        for (product, f) in product.chunks_exact(width).zip(f.chunks_exact(width)) {
            for (row, f) in self.reduced.chunks_exact_mut(width).zip(f) {
                row.iter_mut().zip(product).for_each(|(r, p)| *r += f * p);
            }
        }
        Ok(())
    }

    /// Makes room for rows of `width`. Only where more is deferred than ever before is there any to make.
    fn make_room(&mut self, shape: &Shape, width: usize) {
        let (n, b, deferred) = (shape.n, shape.border, self.deferred);
        let free = n - self.k;
        self.along.resize(deferred * b, 0.0);
        self.right.resize(deferred, 0.0);
        self.forces.resize(deferred, 0.0);
        self.f.resize(2 * n * width, 0.0);
        self.reduced.resize(width * width, 0.0);
        self.side.resize(free * (width - free), 0.0);
        let scratch = self.scratch.len().max(shape.form() * width);
        self.scratch.resize(scratch, 0.0);
    }

    /// Adds a row of what the chain has of (θ, w) to one of the border, times a factor.
    fn add_row(&self, shape: &Shape, factor: f64, row: &[f64], to: &mut [f64]) {
        let (theta, ends) = row.split_at(shape.border);
        to.iter_mut().zip(theta).for_each(|(t, x)| *t += factor * x);
        to[self.place..].iter_mut().zip(ends).for_each(|(t, x)| *t += factor * x);
    }

    /// Returns the product with a vector on the border.
    fn dot(&self, shape: &Shape, row: &[f64], with: &[f64]) -> f64 {
        let (theta, ends) = row.split_at(shape.border);
        theta.iter().zip(with).chain(ends.iter().zip(&with[self.place..])).map(|(x, y)| x * y).sum()
    }

    /// Rows of the border that the chain has a part in.
    fn border_rows(&self, shape: &Shape) -> impl Iterator<Item = usize> + use<> {
        (0..shape.border).chain(self.place..self.place + self.deferred)
    }

    /// Adds the part between variables of the border to its matrix, whose rows are `stride` long.
    pub fn add_border(&self, shape: &Shape, to: &mut [f64], stride: usize) {
        let free = shape.n - self.k;
        let width = (free + shape.border + self.deferred).max(1);
        let rows = self.reduced[free * width..].chunks_exact(width);
        for (i, from) in self.border_rows(shape).zip(rows) {
            self.add_row(shape, 1.0, &from[free..], &mut to[i * stride..(i + 1) * stride]);
        }
    }

    /// Writes the constraints that are deferred to rows of the border's, `stride` long.
    pub fn put_constraints(&self, shape: &Shape, to: &mut [f64], stride: usize) {
        let (b, c) = (shape.border, shape.n + self.k);
        let met = c - self.deferred;
        for (j, row) in to.chunks_exact_mut(stride).enumerate() {
            row.fill(0.0);
            row[..b].copy_from_slice(&self.along[j * b..(j + 1) * b]);
            let column = |i: usize| self.r[i * c + met + j];
            let size = (0..=met + j).map(|i| column(i).powi(2)).sum::<f64>().sqrt();
            for i in 0..=j {
                let entry = column(met + i);
                row[self.place + i] = if entry.abs() > ROUNDING * size { entry } else { 0.0 };
            }
        }
    }

    /// Eliminates u: subtracts from the border what that leaves. The curvature of u where it is none.
    pub fn eliminate(
        &mut self,
        shape: &Shape,
        shift: f64,
        (border, stride): (&mut [f64], usize),
        weak: &mut Vec<Vec<(usize, f64)>>,
    ) -> Curvature {
        // n is the number of free end states from here on.
        let (nn, n, b) = (2 * shape.n, shape.n - self.k, shape.border + self.deferred);
        let width = n + b;
        for i in 0..n {
            self.scale[i] = scale_of(self.reduced[i * width + i]);
        }
        for i in 0..n {
            for j in 0..n {
                self.l[i * n + j] = self.reduced[i * width + j] * self.scale[i] * self.scale[j];
            }
            self.l[i * n + i] += shift;
        }
        if cholesky(&mut self.l, n, |_| TINY).is_err() {
            let mut before = vec![0.0; n * n];
            for i in 0..n {
                for j in 0..n {
                    before[i * n + j] = self.reduced[i * width + j] * self.scale[i] * self.scale[j];
                }
                before[i * n + i] += shift;
            }
            // In states at the ends: which of them do not matter.
            let c = nn - n;
            let (found, directions) = directions(&before, n);
            for u in directions {
                let mut part: Vec<(usize, f64)> = (0..nn)
                    .map(|i| (i, (0..n).map(|j| self.z[(c + j) * nn + i] * self.scale[j] * u[j]).sum()))
                    .collect();
                part.sort_by(|x, y| y.1.abs().total_cmp(&x.1.abs()));
                weak.push(part);
            }
            return found;
        }
        for j in 0..b {
            let column = &mut self.scratch[..n];
            for i in 0..n {
                column[i] = self.reduced[i * width + n + j] * self.scale[i];
            }
            forward(&self.l, n, column);
            for i in 0..n {
                self.side[i * b + j] = column[i];
            }
        }
        for row in self.side.chunks_exact(b.max(1)) {
            for (i, s) in self.border_rows(shape).zip(row) {
                self.add_row(shape, -s, row, &mut border[i * stride..(i + 1) * stride]);
            }
        }
        Curvature::default()
    }

    /// Adds to the right-hand side of the border, and finds that of what is deferred.
    pub fn reduce(&mut self, shape: &Shape, form: &Form, side: &Side, border: &mut [f64]) {
        let (n, b, full) = (shape.n, shape.border, shape.form());
        let (nn, c, free) = (2 * n, n + self.k, n - self.k);
        let (width, met) = (free + b + self.deferred, c - self.deferred);
        let t = &mut self.scratch[..c];
        for (i, &row) in self.order.iter().enumerate() {
            let sum: f64 = (0..i.min(met)).map(|k| self.r[k * c + i] * t[k]).sum();
            let right = if row < n { side.c[row] } else { self.target[row - n] };
            if i < met {
                t[i] = (right - sum) / self.r[i * c + i];
            } else {
                self.right[i - met] = right - sum;
            }
        }
        for i in 0..nn {
            self.y[i] = (0..met).map(|k| self.z[k * nn + i] * t[k]).sum();
        }
        // [F; I]ᵀ (p − Q [y; 0])
        self.p[..free].fill(0.0);
        for i in 0..full {
            let q = &form.q[i * full..i * full + nn];
            let rest = side.p[i] - q.iter().zip(&self.y).map(|(q, y)| q * y).sum::<f64>();
            if i < nn {
                let f = &self.f[i * width..(i + 1) * width];
                self.p[..free].iter_mut().zip(f).for_each(|(p, f)| *p += f * rest);
                self.add_row(shape, rest, &f[free..], border);
            } else {
                border[i - nn] += rest;
            }
        }
        let u = &mut self.p[..free];
        u.iter_mut().zip(&self.scale).for_each(|(u, s)| *u *= s);
        forward(&self.l, free, u);
        for (u, row) in self.p[..free].iter().zip(self.side.chunks_exact((b + self.deferred).max(1))) {
            self.add_row(shape, -u, row, border);
        }
    }

    /// Returns the derivatives of the initial states of the chain by the border (n × `columns`), and their inverse
    /// curvature with that held (n × n).
    pub fn first_states(&self, shape: &Shape, columns: usize) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n, b, free) = (shape.n, shape.border + self.deferred, shape.n - self.k);
        let width = free + b;
        let mut follow = DMatrix::zeros(n, columns);
        for (j, at) in self.border_rows(shape).enumerate() {
            for i in 0..n {
                follow[(i, at)] = self.f[i * width + free + j];
            }
            let mut g: Vec<f64> = (0..free).map(|k| self.side[k * b + j]).collect();
            backward(&self.l, free, &mut g);
            for i in 0..n {
                follow[(i, at)] -=
                    (0..free).map(|k| self.f[i * width + k] * self.scale[k] * g[k]).sum::<f64>();
            }
        }
        let mut root = DMatrix::zeros(n, free);
        for i in 0..n {
            let mut t: Vec<f64> = (0..free).map(|k| self.scale[k] * self.f[i * width + k]).collect();
            forward(&self.l, free, &mut t);
            (0..free).for_each(|k| root[(i, k)] = t[k]);
        }
        let free = &root * root.transpose();
        (follow, free)
    }

    /// The ends and the multiplier of the chain's constraint, the border and the multipliers of what is deferred known.
    pub fn expand(&mut self, shape: &Shape, form: &Form, side: &mut Side, border: &[f64]) {
        let (n, b, full) = (shape.n, shape.border, shape.form());
        let (nn, c, free) = (2 * n, n + self.k, n - self.k);
        let (width, met) = (free + b + self.deferred, c - self.deferred);
        for (i, row) in self.side.chunks_exact((b + self.deferred).max(1)).enumerate().take(free) {
            self.p[i] -= self.dot(shape, row, border);
        }
        let u = &mut self.p[..free];
        backward(&self.l, free, u);
        u.iter_mut().zip(&self.scale).for_each(|(u, s)| *u *= s);
        for i in 0..nn {
            let f = &self.f[i * width..(i + 1) * width];
            let own: f64 = f[..free].iter().zip(&self.p).map(|(f, u)| f * u).sum();
            let along = self.dot(shape, &f[free..], border);
            self.v[i] = self.y[i] + own + along;
        }
        self.v[nn..].copy_from_slice(&border[..b]);
        // R σ = Z₁ᵀ (p − Q v) at the ends
        let rest = &mut self.scratch[..nn];
        for (i, r) in rest.iter_mut().enumerate() {
            let q = &form.q[i * full..(i + 1) * full];
            *r = side.p[i] - q.iter().zip(&self.v).map(|(q, v)| q * v).sum::<f64>();
        }
        for i in (0..c).rev() {
            let along: f64 = self.z[i * nn..(i + 1) * nn].iter().zip(&*rest).map(|(z, r)| z * r).sum();
            let known = |row: usize| if row < n { side.multiplier[row] } else { self.multipliers[row - n] };
            let sum: f64 = (i + 1..c).map(|k| self.r[i * c + k] * known(self.order[k])).sum();
            let value = if i < met { (along - sum) / self.r[i * c + i] } else { self.forces[i - met] };
            match self.order[i] {
                row if row < n => side.multiplier[row] = value,
                row => self.multipliers[row - n] = value,
            }
        }
    }
}
