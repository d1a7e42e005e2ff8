//! Two neighbouring groups become one: the states m between them are eliminated.
//!
//! Of the 2n constraints G_a a + G_m m + … = c₁ and H_m m + H_b b + … = c₂, an orthogonal Qᵀ makes n
//! that determine m, R m + T v = t, and n between the outer ends, which are the new constraint. R is
//! well conditioned whenever the boundary value problem is, however unstable its initial value problem
//! (S. J. Wright, "Stable parallel algorithms for two-point boundary value problems", 1992).

use super::form::{Form, Side};
use super::shape::Shape;
use crate::dense::triangularise;

/// Two forms merged into one.
#[derive(Clone, Debug)]
pub(super) struct Merge {
    pub form: Form,
    pub side: Side,
    /// Qᵀ, 2n × 2n.
    q: Vec<f64>,
    /// R above, and what it eliminates with: columns (m, a, b, θ dynamic), 2n rows.
    rows: Vec<f64>,
    /// m = W (a, b, θ dynamic) + m₀: n × (2n + dynamic).
    w: Vec<f64>,
    /// Row m of the forms together: columns (m; a, b, θ), n × (3n + B).
    middle: Vec<f64>,
    /// p at m, and m₀.
    p: Vec<f64>,
    zero: Vec<f64>,
    scratch: Vec<f64>,
    /// Number of groups below.
    pub groups: usize,
    /// Solution (a, b, θ), and the multipliers of the two constraints.
    pub v: Vec<f64>,
    pub multipliers: Vec<f64>,
}

impl Merge {
    pub fn new(shape: &Shape, groups: usize) -> Merge {
        let (n, f) = (shape.n, shape.form());
        let outer = n + shape.used();
        Merge {
            form: Form::new(shape),
            side: Side::new(shape),
            q: vec![0.0; 4 * n * n],
            rows: vec![0.0; 2 * n * (n + outer)],
            w: vec![0.0; n * outer],
            middle: vec![0.0; n * (n + f)],
            p: vec![0.0; n],
            zero: vec![0.0; n],
            scratch: vec![0.0; (n * f).max(4 * n)],
            groups,
            v: vec![0.0; f],
            multipliers: vec![0.0; 2 * n],
        }
    }

    /// Merges; whether the middle is determined.
    pub fn factorize(&mut self, shape: &Shape, left: &Form, right: &Form) -> bool {
        let (n, f, border) = (shape.n, shape.form(), shape.border);
        let outer = n + shape.used();
        let columns = n + outer;
        // Columns (m, a, b, θ): what the left calls b and the right calls a is m.
        self.rows.fill(0.0);
        for i in 0..n {
            let (top, bottom) = self.rows.split_at_mut(n * columns);
            let (to, from) = (&mut top[i * columns..(i + 1) * columns], &left.c[i * outer..(i + 1) * outer]);
            to[..n].copy_from_slice(&from[n..2 * n]);
            to[n..2 * n].copy_from_slice(&from[..n]);
            to[3 * n..].copy_from_slice(&from[2 * n..]);
            let (to, from) =
                (&mut bottom[i * columns..(i + 1) * columns], &right.c[i * outer..(i + 1) * outer]);
            to[..n].copy_from_slice(&from[..n]);
            to[2 * n..].copy_from_slice(&from[n..]);
        }
        self.q.fill(0.0);
        (0..2 * n).for_each(|i| self.q[i * 2 * n + i] = 1.0);
        triangularise(&mut self.rows, 2 * n, columns, n, Some(&mut self.q));
        for i in 0..n {
            let to = &mut self.form.c[i * outer..(i + 1) * outer];
            to.copy_from_slice(&self.rows[(n + i) * columns + n..(n + i + 1) * columns]);
        }
        // W = −R⁻¹ T
        for i in (0..n).rev() {
            let row = &self.rows[i * columns..(i + 1) * columns];
            if row[i] == 0.0 || !row[i].is_finite() {
                return false;
            }
            let (done, below) = self.w.split_at_mut((i + 1) * outer);
            let w = &mut done[i * outer..];
            for (w, t) in w.iter_mut().zip(&row[n..]) {
                *w = -t;
            }
            for k in i + 1..n {
                let other = &below[(k - i - 1) * outer..(k - i) * outer];
                w.iter_mut().zip(other).for_each(|(w, o)| *w -= row[k] * o);
            }
            w.iter_mut().for_each(|w| *w /= row[i]);
        }
        // The forms together, over (a, b, θ) and the row of m.
        let q = &mut self.form.q;
        let (nn, width) = (2 * n, n + f);
        q.fill(0.0);
        self.middle.fill(0.0);
        for i in 0..n {
            let (l, r) = (&left.q[i * f..(i + 1) * f], &right.q[(n + i) * f..(n + i + 1) * f]);
            let to = &mut q[i * f..(i + 1) * f];
            to[..n].copy_from_slice(&l[..n]);
            to[nn..].copy_from_slice(&l[nn..]);
            let to = &mut q[(n + i) * f..(n + i + 1) * f];
            to[n..].copy_from_slice(&r[n..]);
            let (l, r) = (&left.q[(n + i) * f..(n + i + 1) * f], &right.q[i * f..(i + 1) * f]);
            let to = &mut self.middle[i * width..(i + 1) * width];
            for j in 0..n {
                to[j] = l[n + j] + r[j];
                to[n + j] = l[j];
                to[2 * n + j] = r[n + j];
            }
            for j in 0..border {
                to[3 * n + j] = l[nn + j] + r[nn + j];
            }
        }
        for i in 0..border {
            let to = &mut q[(nn + i) * f..(nn + i + 1) * f];
            let (l, r) = (&left.q[(nn + i) * f..(nn + i + 1) * f], &right.q[(nn + i) * f..(nn + i + 1) * f]);
            to[..n].copy_from_slice(&l[..n]);
            to[n..nn].copy_from_slice(&r[n..nn]);
            for j in nn..f {
                to[j] = l[j] + r[j];
            }
        }
        // Q += Wᵀ P + Pᵀ W with P = Q_m· + ½ Q_mm W.
        let half = &mut self.scratch[..n * f];
        for i in 0..n {
            let (row, middle) = (&mut half[i * f..(i + 1) * f], &self.middle[i * width..(i + 1) * width]);
            row.copy_from_slice(&middle[n..]);
            for k in 0..n {
                let (w, factor) = (&self.w[k * outer..(k + 1) * outer], 0.5 * middle[k]);
                row[..nn].iter_mut().zip(w).for_each(|(r, w)| *r += factor * w);
                for (w, &b) in w[nn..].iter().zip(&shape.dynamic) {
                    row[nn + b] += factor * w;
                }
            }
        }
        for k in 0..n {
            let (p, w) = (&half[k * f..(k + 1) * f], &self.w[k * outer..(k + 1) * outer]);
            for (i, &w) in w.iter().enumerate() {
                let at = if i < nn { i } else { nn + shape.dynamic[i - nn] };
                q[at * f..(at + 1) * f].iter_mut().zip(p).for_each(|(q, p)| *q += w * p);
                for (j, p) in p.iter().enumerate() {
                    q[j * f + at] += w * p;
                }
            }
        }
        true
    }

    /// The right-hand side of the merged form.
    pub fn reduce(&mut self, shape: &Shape, left: &Side, right: &Side) {
        let (n, f) = (shape.n, shape.form());
        let (nn, outer) = (2 * n, n + shape.used());
        let (columns, width) = (n + outer, n + f);
        let turned = &mut self.scratch[..nn];
        for (i, t) in turned.iter_mut().enumerate() {
            let q = &self.q[i * nn..(i + 1) * nn];
            *t = q[..n].iter().zip(&left.c).chain(q[n..].iter().zip(&right.c)).map(|(q, c)| q * c).sum();
        }
        for i in (0..n).rev() {
            let row = &self.rows[i * columns..];
            let sum: f64 = (i + 1..n).map(|k| row[k] * self.zero[k]).sum();
            self.zero[i] = (turned[i] - sum) / row[i];
        }
        self.side.c.copy_from_slice(&turned[n..]);
        let p = &mut self.side.p;
        p[..n].copy_from_slice(&left.p[..n]);
        p[n..nn].copy_from_slice(&right.p[n..nn]);
        for j in nn..f {
            p[j] = left.p[j] + right.p[j];
        }
        for i in 0..n {
            self.p[i] = left.p[n + i] + right.p[i];
            let middle = &self.middle[i * width..(i + 1) * width];
            let rest = self.p[i] - middle[..n].iter().zip(&self.zero).map(|(q, m)| q * m).sum::<f64>();
            let w = &self.w[i * outer..(i + 1) * outer];
            p[..nn].iter_mut().zip(w).for_each(|(p, w)| *p += rest * w);
            for (w, &b) in w[nn..].iter().zip(&shape.dynamic) {
                p[nn + b] += rest * w;
            }
            for (p, q) in p.iter_mut().zip(&middle[n..]) {
                *p -= self.zero[i] * q;
            }
        }
    }

    /// m, and the multipliers of the two constraints, from the solution `v` = (a, b, θ) and the multiplier
    /// of this one.
    pub fn expand(&mut self, shape: &Shape, m: &mut [f64]) {
        let v = &self.v;
        let (n, f) = (shape.n, shape.form());
        let (nn, outer) = (2 * n, n + shape.used());
        let (columns, width) = (n + outer, n + f);
        for i in 0..n {
            let w = &self.w[i * outer..(i + 1) * outer];
            let ends: f64 = w[..nn].iter().zip(v).map(|(w, v)| w * v).sum();
            let theta: f64 = w[nn..].iter().zip(&shape.dynamic).map(|(w, &b)| w * v[nn + b]).sum();
            m[i] = self.zero[i] + ends + theta;
        }
        let turned = &mut self.scratch[..nn];
        for i in 0..n {
            let middle = &self.middle[i * width..(i + 1) * width];
            let inner: f64 = middle[..n].iter().zip(&*m).map(|(q, m)| q * m).sum();
            let rest: f64 = middle[n..].iter().zip(v).map(|(q, v)| q * v).sum();
            turned[i] = self.p[i] - inner - rest;
        }
        for i in 0..n {
            let sum: f64 = (0..i).map(|k| self.rows[k * columns + i] * turned[k]).sum();
            turned[i] = (turned[i] - sum) / self.rows[i * columns + i];
        }
        turned[n..].copy_from_slice(&self.side.multiplier);
        for (i, multiplier) in self.multipliers.iter_mut().enumerate() {
            *multiplier = (0..nn).map(|k| self.q[k * nn + i] * turned[k]).sum();
        }
    }
}
