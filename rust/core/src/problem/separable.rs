//! Separable least squares: the parameters that the model is linear in, the others given.

use std::collections::BTreeSet;

use super::posed::Posed;
use crate::expr::graph::{Graph, Id};
use crate::index::VariableId;
use crate::model::{Compiled, Parameter};
use crate::transform::Transform;

/// Greatest factor by which another point to try differs.
const FACTOR: f64 = 5.0;

/// Tells how f, g and the noise depend on a parameter of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Role {
    /// The variable is a logarithm, and f and g are linear in the parameter.
    Straight,
    /// Standard deviations depend on it, f and g do not.
    OfNoise,
    Other,
}

/// Returns the role of each parameter.
pub(crate) fn roles(graph: &mut Graph, parameters: &[Parameter], compiled: &Compiled) -> Vec<Role> {
    let of_model: Vec<Id> = compiled.dynamics.iter().chain(&compiled.outputs).copied().collect();
    let scales: Vec<Id> = compiled.scales.iter().flatten().copied().collect();
    let mut depends = |roots: &[Id], p: Id| roots.iter().any(|&root| graph.gradient(root, &[p])[0].is_some());
    let of_noise: Vec<bool> =
        compiled.parameters.iter().map(|&p| depends(&scales, p) && !depends(&of_model, p)).collect();
    let mut is_linear = |p: Id| of_model.iter().all(|&root| graph.hessian(root, &[p]).values.is_empty());
    let each = parameters.iter().zip(&compiled.parameters).zip(of_noise);
    each.map(|((p, &symbol), of_noise)| match p.transform {
        _ if of_noise => Role::OfNoise,
        Transform::Log if is_linear(symbol) => Role::Straight,
        _ => Role::Other,
    })
    .collect()
}

/// Returns the pairs of parameters by which a second derivative of some functions is other than 0.
pub(crate) fn multiplied(graph: &mut Graph, functions: &[Id], parameters: &[Id]) -> Vec<(usize, usize)> {
    let pairs = functions.iter().flat_map(|&function| {
        let second = graph.hessian(function, parameters);
        second.rows.into_iter().zip(second.columns)
    });
    let distinct: BTreeSet<(usize, usize)> = pairs.collect();
    distinct.into_iter().collect()
}

impl Posed {
    /// Variables that are parameters of the noise alone, as the model has them in expressions.
    pub(crate) fn of_noise(&self) -> Vec<VariableId> {
        let of_model = (0..self.n_model_parameters).map(VariableId);
        of_model.filter(|&i| self.roles[self.estimands.parameter[i].0] == Role::OfNoise).collect()
    }

    /// Variables that are parameters of the model in which f and g are not linear, the least number such that they
    /// are jointly linear in all others, as far as a greedy choice finds it.
    pub(crate) fn nonlinear(&self) -> Vec<VariableId> {
        self.least_nonlinear(&self.meets())
    }

    /// The same where a logarithm takes steps of its parameter, if f and g are linear in that.
    pub(crate) fn nonlinear_by_parameters(&self) -> Vec<VariableId> {
        let (n, mut meets) = (self.n_seen(), self.meets());
        let straight = self.roles.iter().enumerate().filter(|(_, role)| **role == Role::Straight);
        straight.for_each(|(p, _)| meets[p * n + p] = false);
        self.least_nonlinear(&meets)
    }

    fn least_nonlinear(&self, meets: &[bool]) -> Vec<VariableId> {
        let n = self.n_seen();
        let mut nonlinear: Vec<bool> = (0..n).map(|p| meets[p * n + p]).collect();
        // Of those that are multiplied with each other, the ones that meet most others first.
        loop {
            let others = |p: usize| (0..n).filter(|&q| !nonlinear[q] && meets[p * n + q]).count();
            let worst = (0..n).filter(|&p| !nonlinear[p]).max_by_key(|&p| (others(p), n - p));
            match worst.filter(|&p| others(p) > 0) {
                Some(p) => nonlinear[p] = true,
                None => break,
            }
        }
        let of_model = (0..self.n_model_parameters).map(VariableId);
        of_model.filter(|&i| nonlinear[self.estimands.parameter[i].0]).collect()
    }

    /// Pairs of variables that are parameters of the model and multiplied with each other, where f and g are nonlinear in
    /// neither by itself.
    pub(crate) fn products(&self) -> Vec<(VariableId, VariableId)> {
        let (n, meets) = (self.n_seen(), self.meets());
        let seen = |i: usize| self.estimands.parameter[VariableId(i)].0;
        let together = |i: usize, j: usize| {
            let (a, b) = (self.estimands.experiment[VariableId(i)], self.estimands.experiment[VariableId(j)]);
            a.is_none() || b.is_none() || a == b
        };
        let multiplied = |i: usize, j: usize| {
            let (p, q) = (seen(i), seen(j));
            meets[p * n + q] && !meets[p * n + p] && !meets[q * n + q] && together(i, j)
        };
        let all = (0..self.n_model_parameters).flat_map(|j| (0..j).map(move |i| (i, j)));
        all.filter(|&(i, j)| multiplied(i, j)).map(|(i, j)| (VariableId(i), VariableId(j))).collect()
    }

    /// Returns, row by row, whether a second derivative of f or g by two parameters is other than 0.
    fn meets(&self) -> Vec<bool> {
        let (n_x, n) = (self.state_names.len(), self.n_seen());
        let mut meets = vec![false; n * n];
        let of_f = self.f.hessian_pattern.iter().map(|(r, c)| (r.wrapping_sub(n_x), c.wrapping_sub(n_x)));
        for (r, c) in of_f.filter(|&(r, c)| r < n && c < n).chain(self.multiplied.iter().copied()) {
            (meets[r * n + c], meets[c * n + r]) = (true, true);
        }
        meets
    }

    /// ξ with these variables elsewhere: multiplied by factors that a hash of `draw` gives, within bounds; those
    /// that are 0 anywhere between their bounds, where they have some.
    pub(crate) fn move_elsewhere(&self, xi: &mut [f64], variables: &[VariableId], draw: u64) {
        let (lower, upper) = self.bounds_of(self.parameters.len());
        for &i in variables {
            let share = uniform(draw, i.0 as u64);
            let by = FACTOR.ln() * (2.0 * share - 1.0);
            let between = upper[i] - lower[i];
            let value = match self.estimands.transforms[i] {
                Transform::Log => xi[i] + by,
                _ if xi[i] != 0.0 => xi[i] * by.exp(),
                _ if between.is_finite() => share.mul_add(between, lower[i]),
                _ => xi[i],
            };
            xi[i] = value.clamp(lower[i], upper[i]);
        }
    }
}

/// A number between 0 and 1 from two others: SplitMix64 (Steele, Lea and Flood, 2014).
fn uniform(a: u64, b: u64) -> f64 {
    let mut z = a.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(b.wrapping_mul(0xD1B5_4A32_D192_ED03));
    for _ in 0..2 {
        z = z.wrapping_add(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
    }
    (z >> 11) as f64 / (1u64 << 53) as f64
}
