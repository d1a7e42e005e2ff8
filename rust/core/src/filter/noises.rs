//! White noise within an interval of length h, in orthonormal polynomials.
//!
//! ```text
//!   ẋ = f(x, u, θ) + diag(q) v(t),     v(t) = h^(−½) Σ_j ψ_j((t − t_k)/h) ε_kj,     ε ~ N(0, I)
//! ```
//!
//! ψ_j are Legendre's polynomials on (0, 1), ∫ ψ_i ψ_j = δ_ij. White noise is this sum with all its terms. What it does
//! to the state at the end of the interval, ∫ Φ(h, s) diag(q) v ds, needs those terms only that Φ(h, s) has in s: the
//! first is the gain of the noisy state itself, the second what that carries into others, and the covariance of r terms
//! agrees with the exact ∫ Φ Q Φᵀ ds to the order h^{2r}. (Loève's expansion by another basis; J. Foster, T. Lyons,
//! H. Oberhauser, *An optimal polynomial approximation of Brownian motion*, SIAM J. Numer. Anal. 58, 2020.)

use super::jet::symbols;
use crate::expr::graph::{Graph, Id};
use crate::model::Compiled;

/// The state equations with noise in them.
#[derive(Clone, Debug)]
pub(super) struct Driven {
    pub(super) graph: Graph,
    /// Time and inputs, then the polynomials over √h.
    pub(super) data: Vec<Id>,
    /// States, then noises ε of the interval: the terms of the first noisy state, of the second, ...
    pub(super) z: Vec<Id>,
    /// Number of states, n.
    pub(super) n: usize,
    /// Parameters of the model, then intensities q.
    pub(super) theta: Vec<Id>,
    pub(super) f: Vec<Id>,
}

impl Driven {
    pub(super) fn new(model: &Compiled, noisy: &[usize], terms: usize) -> Driven {
        let (mut graph, mut f, n) = (model.graph.clone(), model.dynamics.clone(), model.states.len());
        let polynomials = symbols(&mut graph, "polynomial", terms);
        let noises = symbols(&mut graph, "noise", noisy.len() * terms);
        let q = symbols(&mut graph, "intensity", noisy.len());
        for (i, &state) in noisy.iter().enumerate() {
            let mut v = graph.zero();
            for (j, &polynomial) in polynomials.iter().enumerate() {
                let term = graph.product(polynomial, noises[i * terms + j]);
                v = graph.add(v, term);
            }
            let v = graph.product(q[i], v);
            f[state] = graph.add(f[state], v);
        }
        Driven {
            graph,
            data: [model.data.clone(), polynomials].concat(),
            z: [model.states.clone(), noises].concat(),
            n,
            theta: [model.parameters.clone(), q].concat(),
            f,
        }
    }

    pub(super) fn x(&self) -> &[Id] {
        &self.z[..self.n]
    }

    pub(super) fn noises(&self) -> &[Id] {
        &self.z[self.n..]
    }
}

/// ψ_j at `share` of the interval, for j below `terms`.
pub(super) fn legendre(share: f64, terms: usize) -> Vec<f64> {
    let x = 2.0 * share - 1.0;
    let (mut before, mut now) = (0.0, 1.0);
    (0..terms)
        .map(|j| {
            let value = (2.0 * j as f64 + 1.0).sqrt() * now;
            let next = ((2 * j + 1) as f64 * x * now - j as f64 * before) / (j + 1) as f64;
            (before, now) = (now, next);
            value
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::legendre;

    #[test]
    fn polynomials_are_orthonormal() {
        // Simpson's rule on 2000 parts: exact enough for degree 10.
        let n = 2000;
        for i in 0..6 {
            for j in 0..6 {
                let sum: f64 = (0..=n)
                    .map(|k| {
                        let weight = if k == 0 || k == n { 1.0 } else { 2.0 + 2.0 * f64::from(k % 2) };
                        let p = legendre(f64::from(k) / f64::from(n), 6);
                        weight * p[i] * p[j] / (3.0 * f64::from(n))
                    })
                    .sum();
                let expected = f64::from(u8::from(i == j));
                assert!((sum - expected).abs() < 1e-9, "{i} {j}: {sum}");
            }
        }
    }
}
