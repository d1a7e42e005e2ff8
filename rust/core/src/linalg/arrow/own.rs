//! A vector of the system on a chain, and its way from the program and back.

use super::chain::ChainPlan;
use crate::nlp::Tie;

/// A vector of the system on a chain, in units: of its first point, its own variables, its own rows and its
/// boundary conditions.
#[derive(Clone, Debug)]
pub(super) struct Own {
    pub first: Vec<f64>,
    pub x: Vec<f64>,
    pub lambda: Vec<f64>,
    pub boundary: Vec<f64>,
}

impl Own {
    pub fn new(n: usize, rows: usize, k: usize) -> Own {
        Own { first: vec![0.0; n], x: vec![0.0; rows], lambda: vec![0.0; rows], boundary: vec![0.0; k] }
    }

    pub fn copy(&mut self, other: &Own) {
        self.first.copy_from_slice(&other.first);
        self.x.copy_from_slice(&other.x);
        self.lambda.copy_from_slice(&other.lambda);
        self.boundary.copy_from_slice(&other.boundary);
    }

    pub fn clear(&mut self) {
        self.first.fill(0.0);
        self.x.fill(0.0);
        self.lambda.fill(0.0);
        self.boundary.fill(0.0);
    }

    /// Takes a right-hand side of the program, into units and the order of own rows; `units` are 1/unit of each
    /// state, and its unit.
    pub fn take(&mut self, plan: &ChainPlan, (units, inverse): (&[f64], &[f64]), p: &[f64], q: &[f64]) {
        let (n, variable, boundary) = (units.len(), plan.chain.variable.0, &plan.chain.boundary);
        own_variables(plan, n, |program, own, count| {
            scale(&p[program..program + count], inverse, &mut self.x[own..own + count]);
        });
        own_rows(plan, n, |program, own, count| {
            scale(&q[program..program + count], units, &mut self.lambda[own..own + count]);
        });
        scale(&p[variable..variable + n], inverse, &mut self.first);
        for ((to, q), &s) in self.boundary.iter_mut().zip(&q[boundary.row.0..]).zip(&boundary.states) {
            *to = q * units[s.0];
        }
    }

    /// And back: a solution as the program has it.
    pub fn give(
        &self,
        plan: &ChainPlan,
        (units, inverse): (&[f64], &[f64]),
        d: &mut [f64],
        lambda: &mut [f64],
    ) {
        let (n, variable, boundary) = (units.len(), plan.chain.variable.0, &plan.chain.boundary);
        own_variables(plan, n, |program, own, count| {
            scale(&self.x[own..own + count], inverse, &mut d[program..program + count]);
        });
        own_rows(plan, n, |program, own, count| {
            scale(&self.lambda[own..own + count], units, &mut lambda[program..program + count]);
        });
        scale(&self.first, inverse, &mut d[variable..variable + n]);
        let own = self.boundary.iter().zip(&boundary.states);
        for (to, (x, &s)) in lambda[boundary.row.0..].iter_mut().zip(own) {
            *to = x * units[s.0];
        }
    }
}

fn own_variables(plan: &ChainPlan, n: usize, each: impl FnMut(usize, usize, usize)) {
    stretches(plan, n, plan.chain.variable.0 + n, |t| t.variable.0, each);
}

fn own_rows(plan: &ChainPlan, n: usize, each: impl FnMut(usize, usize, usize)) {
    stretches(plan, n, plan.chain.row.0, |t| t.row.0, each);
}

/// Calls `each` with the first place in the program, the first own row and the number of rows for all
/// that stands together in both.
fn stretches(
    plan: &ChainPlan,
    n: usize,
    core: usize,
    tie: impl Fn(&Tie) -> usize,
    mut each: impl FnMut(usize, usize, usize),
) {
    if plan.chain.ties.is_empty() {
        return each(core, 0, plan.row(plan.chain.segments, n));
    }
    for s in 0..plan.chain.segments {
        let row = plan.row(s, n);
        each(core + s * plan.d, row, plan.d);
        for (i, t) in plan.ties_of(s).iter().enumerate() {
            each(tie(t), row + plan.d + i * n, n);
        }
    }
}

/// Each number multiplied by the factor of its component.
fn scale(from: &[f64], factors: &[f64], to: &mut [f64]) {
    for (to, from) in to.chunks_exact_mut(factors.len()).zip(from.chunks_exact(factors.len())) {
        to.iter_mut().zip(from).zip(factors).for_each(|((t, x), f)| *t = x * f);
    }
}
