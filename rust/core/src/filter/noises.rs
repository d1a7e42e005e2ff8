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

use crate::experiment::Experiment;
use crate::expr::graph::{Graph, Id};
use crate::integrate::group::{Group, Lane, Origin};
use crate::integrate::steps::Track;
use crate::integrate::tableau::Tableau;
use crate::model::Compiled;
use crate::tape::Arguments;

/// Intervals side by side: a block of registers for the largest tapes still fits the second-level cache.
pub(super) const LANES: usize = 32;

/// The state equations with noise in them.
#[derive(Clone, Debug)]
pub(super) struct Driven {
    pub(super) graph: Graph,
    /// Data are time and inputs, then the polynomials over √h. States are followed by the noises ε of the interval: the
    /// terms of the first noisy state, of the second, ... Parameters are those of the model, then intensities q.
    pub(super) arguments: Arguments,
    /// Slopes of the states.
    pub(super) f: Vec<Id>,
}

impl Driven {
    pub(super) fn new(model: &Compiled, noisy: &[usize], terms: usize) -> Driven {
        let (mut graph, mut f) = (model.graph.clone(), model.dynamics.clone());
        let polynomials = graph.symbols("polynomial", terms);
        let noises = graph.symbols("noise", noisy.len() * terms);
        let q = graph.symbols("intensity", noisy.len());
        for ((&state, &q), noises) in noisy.iter().zip(&q).zip(noises.chunks_exact(terms)) {
            let v = graph.weighted_sum(&polynomials, noises);
            let v = graph.product(q, v);
            f[state] = graph.add(f[state], v);
        }
        let arguments = Arguments {
            data: [&model.data[..], &polynomials].concat(),
            states: [&model.states[..], &noises].concat(),
            parameters: [&model.parameters[..], &q].concat(),
        };
        Driven { graph, arguments, f }
    }

    pub(super) fn x(&self) -> &[Id] {
        &self.arguments.states[..self.f.len()]
    }

    pub(super) fn noises(&self) -> &[Id] {
        &self.arguments.states[self.f.len()..]
    }
}

/// The intervals of a record, each in so many steps, with the polynomials over √h among their data. An input that is
/// held and jumps inside a step is its mean there.
pub(super) fn intervals(
    experiment: &Experiment,
    substeps: usize,
    terms: usize,
    tableau: &Tableau,
) -> Vec<Group> {
    let track = Track::between(&experiment.t, substeps);
    let mut groups = Group::cut(Origin::default(), experiment, &track, tableau, LANES);
    let stages = tableau.b.len();
    let share = |point: usize| ((point / stages) as f64 + tableau.c[point % stages]) / substeps as f64;
    let values: Vec<Vec<f64>> = (0..=substeps * stages).map(|point| legendre(share(point), terms)).collect();
    for group in &mut groups {
        let root = |lane: usize| {
            let first = group.node.0 + lane.min(group.n - 1);
            (experiment.t[first + 1] - experiment.t[first]).sqrt()
        };
        let roots: Vec<f64> = (0..LANES).map(root).collect();
        let column = |j: usize| {
            let (values, roots) = (&values, &roots);
            move |point: usize, lane: Lane| values[point][j] / roots[lane.0]
        };
        group.append(stages, &(0..terms).map(column).collect::<Vec<_>>());
    }
    groups
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
