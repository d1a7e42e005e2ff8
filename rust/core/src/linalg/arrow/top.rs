//! The top: what is left of each chain are its two ends.
//!
//! n constraints C_a a + C_b b + C_θ θ = c, and boundary conditions beside them, leave n or fewer of the 2n
//! end states free: (a, b) = Z₂ u + Y θ + y, by an orthogonal decomposition of [C_a C_b]ᵀ. The reduced
//! Hessian in (u of every chain, θ) is small and dense; its inertia is that of the whole.

use nalgebra::DMatrix;

use super::border::{TINY, directions, scale_of};
use super::dense::{backward, cholesky, forward, triangularise};
use super::form::{Form, Side};
use super::shape::Shape;
use crate::linalg::{Curvature, KktError};

/// The top of one chain.
#[derive(Clone, Debug)]
pub(super) struct Top {
    /// Number of boundary conditions, k. There are c = n + k constraints; 2n − c end states are free.
    k: usize,
    /// Boundary conditions in the layout of a form's constraints: k × (2n + dynamic).
    pub boundary: Vec<f64>,
    /// Their right-hand side, and their multipliers.
    pub target: Vec<f64>,
    pub multipliers: Vec<f64>,
    /// Columns (C_a C_b)ᵀ made triangular, 2n × c, and Zᵀ (2n × 2n): rows 0..c span the constraints.
    r: Vec<f64>,
    z: Vec<f64>,
    /// (a, b) = F (u, θ): 2n × (free + B).
    f: Vec<f64>,
    /// Reduced Hessian in (u, θ): (free + B)².
    reduced: Vec<f64>,
    /// Factor of its (u, u) block with the shift, and L⁻¹ K_uθ.
    l: Vec<f64>,
    side: Vec<f64>,
    scale: Vec<f64>,
    /// Particular (a, b), and the right-hand side in (u, θ).
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

    /// The reduced Hessian of a form.
    ///
    /// # Errors
    /// Where its constraint and the boundary conditions do not determine what they should.
    pub fn factorize(&mut self, shape: &Shape, form: &Form) -> Result<(), KktError> {
        let (n, border, full) = (shape.n, shape.border, shape.form());
        let (nn, outer, c, free) = (2 * n, n + shape.used(), n + self.k, n - self.k);
        let width = free + border;
        let row = |j: usize| if j < n { &form.c[j * outer..] } else { &self.boundary[(j - n) * outer..] };
        for i in 0..nn {
            for j in 0..c {
                self.r[i * c + j] = row(j)[i];
            }
        }
        self.z.fill(0.0);
        (0..nn).for_each(|i| self.z[i * nn + i] = 1.0);
        triangularise(&mut self.r, nn, c, c, Some(&mut self.z));
        let size = |i: usize| self.r[i * c + i].abs();
        let largest = (0..c).map(size).fold(0.0, f64::max);
        // Boundary conditions that the ends cannot meet are for another method.
        let least = if self.k > 0 { 1e-8 } else { 0.0 };
        if !largest.is_finite() || (0..c).any(|i| !size(i).is_finite()) {
            return Err(KktError::NotFinite);
        }
        if (0..c).any(|i| size(i) <= least * largest) {
            return Err(KktError::Boundary);
        }
        // F = [Z₂ | −Z₁ R⁻ᵀ C_θ]
        self.f.fill(0.0);
        for i in 0..nn {
            for j in 0..free {
                self.f[i * width + j] = self.z[(c + j) * nn + i];
            }
        }
        for (d, &b) in shape.dynamic.iter().enumerate() {
            let t = &mut self.scratch[..c];
            for i in 0..c {
                let sum: f64 = (0..i).map(|k| self.r[k * c + i] * t[k]).sum();
                t[i] = (row(i)[nn + d] - sum) / self.r[i * c + i];
            }
            for i in 0..nn {
                self.f[i * width + free + b] = -(0..c).map(|k| self.z[k * nn + i] * t[k]).sum::<f64>();
            }
        }
        // [F; I]ᵀ Q [F; I], first Q [F; I].
        let (f, q) = (&self.f, &form.q);
        let product = &mut self.scratch[..full * width];
        for (row, q) in product.chunks_exact_mut(width).zip(q.chunks_exact(full)) {
            row[..free].fill(0.0);
            row[free..].copy_from_slice(&q[nn..]);
            for (q, f) in q.iter().zip(f.chunks_exact(width)) {
                row.iter_mut().zip(f).for_each(|(r, f)| *r += q * f);
            }
        }
        self.reduced[..free * width].fill(0.0);
        self.reduced[free * width..].copy_from_slice(&product[nn * width..]);
        for (product, f) in product.chunks_exact(width).zip(f.chunks_exact(width)) {
            for (row, f) in self.reduced.chunks_exact_mut(width).zip(f) {
                row.iter_mut().zip(product).for_each(|(r, p)| *r += f * p);
            }
        }
        Ok(())
    }

    /// Adds the part between border variables to a B × B matrix.
    pub fn add_border(&self, shape: &Shape, to: &mut [f64]) {
        let (free, border) = (shape.n - self.k, shape.border);
        let width = (free + border).max(1);
        let rows = self.reduced[free * width..].chunks_exact(width);
        for (to, from) in to.chunks_exact_mut(border.max(1)).zip(rows) {
            to.iter_mut().zip(&from[free..]).for_each(|(t, f)| *t += f);
        }
    }

    /// Eliminates u: subtracts from the border what that leaves. The curvature of u where it is none.
    pub fn eliminate(
        &mut self,
        shape: &Shape,
        shift: f64,
        border: &mut [f64],
        weak: &mut Vec<Vec<(usize, f64)>>,
    ) -> Curvature {
        // n is the number of free end states from here on.
        let (nn, n, b) = (2 * shape.n, shape.n - self.k, shape.border);
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
        if cholesky(&mut self.l, n, TINY).is_err() {
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
            for (to, s) in border.chunks_exact_mut(b.max(1)).zip(row) {
                to.iter_mut().zip(row).for_each(|(t, r)| *t -= s * r);
            }
        }
        Curvature::default()
    }

    /// Adds to the right-hand side of the border.
    pub fn reduce(&mut self, shape: &Shape, form: &Form, side: &Side, border: &mut [f64]) {
        let (n, b, full) = (shape.n, shape.border, shape.form());
        let (nn, c, free) = (2 * n, n + self.k, n - self.k);
        let width = free + b;
        let t = &mut self.scratch[..c];
        for i in 0..c {
            let sum: f64 = (0..i).map(|k| self.r[k * c + i] * t[k]).sum();
            let right = if i < n { side.c[i] } else { self.target[i - n] };
            t[i] = (right - sum) / self.r[i * c + i];
        }
        for i in 0..nn {
            self.y[i] = (0..c).map(|k| self.z[k * nn + i] * t[k]).sum();
        }
        // [F; I]ᵀ (p − Q [y; 0])
        self.p[..free].fill(0.0);
        for i in 0..full {
            let q = &form.q[i * full..i * full + nn];
            let rest = side.p[i] - q.iter().zip(&self.y).map(|(q, y)| q * y).sum::<f64>();
            if i < nn {
                let f = &self.f[i * width..(i + 1) * width];
                self.p[..free].iter_mut().zip(f).for_each(|(p, f)| *p += f * rest);
                border.iter_mut().zip(&f[free..]).for_each(|(p, f)| *p += f * rest);
            } else {
                border[i - nn] += rest;
            }
        }
        let u = &mut self.p[..free];
        u.iter_mut().zip(&self.scale).for_each(|(u, s)| *u *= s);
        forward(&self.l, free, u);
        for (u, row) in u.iter().zip(self.side.chunks_exact(b.max(1))) {
            border.iter_mut().zip(row).for_each(|(p, s)| *p -= u * s);
        }
    }

    /// How the first states of the chain follow θ (n × B), and their inverse curvature with θ held (n × n).
    pub fn first_states(&self, shape: &Shape) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n, b, free) = (shape.n, shape.border, shape.n - self.k);
        let width = free + b;
        let mut follow = DMatrix::from_fn(n, b, |i, j| self.f[i * width + free + j]);
        for j in 0..b {
            let mut g: Vec<f64> = (0..free).map(|k| self.side[k * b + j]).collect();
            backward(&self.l, free, &mut g);
            for i in 0..n {
                follow[(i, j)] -=
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

    /// The ends and the multiplier of the chain's constraint, θ known.
    pub fn expand(&mut self, shape: &Shape, form: &Form, side: &mut Side, theta: &[f64]) {
        let (n, b, full) = (shape.n, shape.border, shape.form());
        let (nn, c, free) = (2 * n, n + self.k, n - self.k);
        let width = free + b;
        let u = &mut self.p[..free];
        for (u, row) in u.iter_mut().zip(self.side.chunks_exact(b.max(1))) {
            *u -= row.iter().zip(theta).map(|(s, t)| s * t).sum::<f64>();
        }
        backward(&self.l, free, u);
        u.iter_mut().zip(&self.scale).for_each(|(u, s)| *u *= s);
        for i in 0..nn {
            let f = &self.f[i * width..(i + 1) * width];
            let own: f64 = f[..free].iter().zip(&*u).map(|(f, u)| f * u).sum();
            let along: f64 = f[free..].iter().zip(theta).map(|(f, t)| f * t).sum();
            self.v[i] = self.y[i] + own + along;
        }
        self.v[nn..].copy_from_slice(theta);
        // R σ = Z₁ᵀ (p − Q v) at the ends
        let rest = &mut self.scratch[..nn];
        for (i, r) in rest.iter_mut().enumerate() {
            let q = &form.q[i * full..(i + 1) * full];
            *r = side.p[i] - q.iter().zip(&self.v).map(|(q, v)| q * v).sum::<f64>();
        }
        for i in (0..c).rev() {
            let along: f64 = self.z[i * nn..(i + 1) * nn].iter().zip(&*rest).map(|(z, r)| z * r).sum();
            let known = |k: usize| if k < n { side.multiplier[k] } else { self.multipliers[k - n] };
            let sum: f64 = (i + 1..c).map(|k| self.r[i * c + k] * known(k)).sum();
            let value = (along - sum) / self.r[i * c + i];
            if i < n {
                side.multiplier[i] = value;
            } else {
                self.multipliers[i - n] = value;
            }
        }
    }
}
