//! The remaining quadratic form of a group, and of groups merged.

use super::piece::Piece;
use super::products::Products;
use super::shape::Shape;

/// A quadratic function ½vᵀQv of v = (a, b, θ), with n constraints C_a a + C_b b + C_θ θ = c.
#[derive(Clone, Debug, Default)]
pub(super) struct Form {
    /// n × (2n + dynamic), row-major.
    pub c: Vec<f64>,
    /// (2n + B)², row-major.
    pub q: Vec<f64>,
}

/// The right-hand side of a form, and the solution.
#[derive(Clone, Debug, Default)]
pub(super) struct Side {
    /// c (n).
    pub c: Vec<f64>,
    /// The right-hand side of Q v + Cᵀ multiplier (2n + B).
    pub p: Vec<f64>,
    /// Multiplier of the constraint (n), after the solution is known.
    pub multiplier: Vec<f64>,
}

impl Form {
    pub fn new(shape: &Shape) -> Form {
        let f = shape.form();
        Form { c: vec![0.0; shape.n * (shape.n + shape.used())], q: vec![0.0; f * f] }
    }

    /// Makes the form of a group from the sensitivities at its end, and the sums of its points.
    pub fn put_together(&mut self, shape: &Shape, pieces: &[Piece], products: &Products) {
        let (n, f) = (shape.n, shape.form());
        let columns = n + shape.used();
        self.c.fill(0.0);
        for (part, piece) in shape.parts.iter().zip(pieces) {
            for (&i, z) in part.states.iter().zip(piece.z.chunks_exact(part.width)) {
                let row = &mut self.c[i * columns..(i + 1) * columns];
                let (states, theta) = z.split_at(part.states.len());
                part.states.iter().zip(states).for_each(|(&j, z)| row[j] = -z);
                part.dynamic.iter().zip(theta).for_each(|(&j, z)| row[2 * n + j] = -z);
                row[n + i] = 1.0;
            }
        }
        let q = &mut self.q;
        q.fill(0.0);
        let place = |v: usize| if v < n { v } else { 2 * n + shape.dynamic[v - n] };
        for (i, v) in shape.columns() {
            let v = place(v);
            for (j, w) in shape.columns() {
                q[v * f + place(w)] += products.square(i, j);
            }
            for (c, &b) in shape.coupled.iter().enumerate() {
                let value = products.cross(shape, i, c);
                q[v * f + 2 * n + b] += value;
                q[(2 * n + b) * f + v] += value;
            }
        }
    }
}

impl Side {
    pub fn new(shape: &Shape) -> Side {
        Side { c: vec![0.0; shape.n], p: vec![0.0; shape.form()], multiplier: vec![0.0; shape.n] }
    }
}
