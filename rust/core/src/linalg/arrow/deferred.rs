//! Constraints of the border: how a basis of their null space turns its matrix.

use crate::dense::{dot_of, triangularise};

/// A constraint that others, and variables that are held, leave less than this part of its own determines nothing.
const NOTHING: f64 = 1e-13;

/// Constraints E x = c, in variables whose curvature is near 1, and of length 1: Eᵀ = Y₁ R, and Y₂ spans what they leave.
#[derive(Clone, Debug, Default)]
pub(super) struct Deferred {
    /// Number of variables.
    b: usize,
    /// The constraints that are met: those that determine something.
    met: Vec<usize>,
    /// The factors that make each row as long as 1.
    length: Vec<f64>,
    /// R, b × met, and [Y₁ Y₂]ᵀ, b × b.
    r: Vec<f64>,
    y: Vec<f64>,
    /// The matrix, and Y₂ᵀ times it.
    k: Vec<f64>,
    product: Vec<f64>,
}

impl Deferred {
    /// Number of constraints that are met.
    pub fn met(&self) -> usize {
        self.met.len()
    }

    /// Takes constraints, rows as long as `scale`, in which some variables are held.
    pub fn turn(&mut self, constraints: &[f64], scale: &[f64], held: &[bool]) {
        let b = scale.len();
        self.b = b;
        self.met.clear();
        self.length.clear();
        if constraints.is_empty() {
            return;
        }
        let free = |i: usize| if held[i] { 0.0 } else { scale[i] };
        for row in constraints.chunks_exact(b) {
            let square: f64 = row.iter().enumerate().map(|(i, e)| (e * free(i)).powi(2)).sum();
            self.length.push(if square > 0.0 { square.sqrt().recip() } else { 0.0 });
        }
        self.met.extend(0..self.length.len());
        loop {
            let m = self.met.len();
            self.r.resize(b * m, 0.0);
            for (j, &row) in self.met.iter().enumerate() {
                for (i, e) in constraints[row * b..(row + 1) * b].iter().enumerate() {
                    self.r[i * m + j] = e * free(i) * self.length[row];
                }
            }
            self.y.clear();
            self.y.resize(b * b, 0.0);
            (0..b).for_each(|i| self.y[i * b + i] = 1.0);
            triangularise(&mut self.r, b, m, m.min(b), Some(&mut self.y));
            let r = &self.r;
            let (mut j, mut found) = (0, false);
            // What determines nothing any more is met by what is held, or not at all.
            self.met.retain(|_| {
                let meets = found || j < b && r[j * m + j].abs() > NOTHING;
                (j, found) = (j + 1, found || !meets);
                meets
            });
            if !found {
                return;
            }
        }
    }

    /// Y₂ᵀ K Y₂ in place of K, where there are constraints.
    pub fn project(&mut self, k: &mut Vec<f64>) {
        let (b, m) = (self.b, self.met.len());
        if self.length.is_empty() {
            return;
        }
        self.k.clone_from(k);
        let left = b - m;
        self.product.clear();
        self.product.resize(left * b, 0.0);
        let basis = &self.y[m * b..];
        for (to, y) in self.product.chunks_exact_mut(b).zip(basis.chunks_exact(b)) {
            for (y, row) in y.iter().zip(self.k.chunks_exact(b)) {
                to.iter_mut().zip(row).for_each(|(t, k)| *t += y * k);
            }
        }
        k.truncate(left * left);
        for (to, row) in k.chunks_exact_mut(left.max(1)).zip(self.product.chunks_exact(b)) {
            for (to, y) in to.iter_mut().zip(basis.chunks_exact(b)) {
                *to = dot_of(row, y);
            }
        }
    }

    /// A direction along the constraints in all variables.
    pub fn outward(&self, v: Vec<f64>) -> Vec<f64> {
        if self.met.is_empty() {
            return v;
        }
        let mut x = vec![0.0; self.b];
        for (v, y) in v.iter().zip(self.y[self.met.len() * self.b..].chunks_exact(self.b)) {
            x.iter_mut().zip(y).for_each(|(x, y)| *x += v * y);
        }
        x
    }

    /// Solves in place for p and the constraints' right-hand sides, where `inner` solves with Y₂ᵀ K Y₂.
    pub fn solve(&self, p: &mut [f64], right: &mut [f64], inner: impl Fn(&mut [f64])) {
        let (b, m) = (self.b, self.met.len());
        let row = |i: usize| &self.y[i * b..(i + 1) * b];
        // Rᵀ t = c, then x = Y₁ t + Y₂ v.
        let mut t = vec![0.0; b];
        for i in 0..m {
            let sum: f64 = (0..i).map(|k| self.r[k * m + i] * t[k]).sum();
            t[i] = (right[self.met[i]] * self.length[self.met[i]] - sum) / self.r[i * m + i];
        }
        let mut x = vec![0.0; b];
        for i in 0..m {
            x.iter_mut().zip(row(i)).for_each(|(x, y)| *x += t[i] * y);
        }
        let rest = |x: &[f64]| -> Vec<f64> {
            p.iter().zip(self.k.chunks_exact(b)).map(|(p, k)| p - dot_of(k, x)).collect()
        };
        let v = &mut t[m..];
        let left = rest(&x);
        v.iter_mut().enumerate().for_each(|(i, v)| *v = dot_of(row(m + i), &left));
        inner(v);
        for (i, v) in v.iter().enumerate() {
            x.iter_mut().zip(row(m + i)).for_each(|(x, y)| *x += v * y);
        }
        // R f = Y₁ᵀ (p − K x)
        let left = rest(&x);
        right.fill(0.0);
        for i in (0..m).rev() {
            let sum: f64 = (i + 1..m).map(|k| self.r[i * m + k] * t[k]).sum();
            t[i] = (dot_of(row(i), &left) - sum) / self.r[i * m + i];
            right[self.met[i]] = t[i] * self.length[self.met[i]];
        }
        p.copy_from_slice(&x);
    }
}
