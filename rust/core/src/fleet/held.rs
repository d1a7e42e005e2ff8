//! The problem of one record with the variables held that all records share.

use std::ops::Range;

use crate::collocation::Collocation;
use crate::index::{ConstraintId, VariableId};
use crate::nlp::{Chains, Named, Nlp, NotFinite, Reach, Structure};
use crate::threads::Threads;

/// A problem some of whose variables stay where they are.
pub(super) struct Held<'a> {
    problem: &'a Collocation,
    held: &'a [VariableId],
    at: &'a [f64],
}

impl<'a> Held<'a> {
    /// With the variables held at these values.
    pub fn new(problem: &'a Collocation, held: &'a [VariableId], at: &'a [f64]) -> Self {
        Held { problem, held, at }
    }
}

impl Named for Held<'_> {
    fn variable_name(&self, i: VariableId) -> String {
        self.problem.variable_name(i)
    }

    fn constraint_name(&self, i: ConstraintId) -> String {
        self.problem.constraint_name(i)
    }

    fn explain(&self, xi: &[f64]) -> Option<String> {
        self.problem.explain(xi)
    }
}

impl Nlp for Held<'_> {
    fn n(&self) -> usize {
        self.problem.n()
    }

    fn m(&self) -> usize {
        self.problem.m()
    }

    fn bounds(&self) -> (Vec<f64>, Vec<f64>) {
        let (mut lower, mut upper) = self.problem.bounds();
        for (&i, &at) in self.held.iter().zip(self.at) {
            (lower[i.0], upper[i.0]) = (at, at);
        }
        (lower, upper)
    }

    fn objective(&self, xi: &[f64]) -> Result<f64, NotFinite> {
        self.problem.objective(xi)
    }

    fn gradient(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.problem.gradient(xi, out)
    }

    fn constraints(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.problem.constraints(xi, out)
    }

    fn jacobian_structure(&self) -> &Structure {
        self.problem.jacobian_structure()
    }

    fn jacobian(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.problem.jacobian(xi, out)
    }

    fn hessian_structure(&self) -> &Structure {
        self.problem.hessian_structure()
    }

    fn hessian(&self, xi: &[f64], factor: f64, lambda: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.problem.hessian(xi, factor, lambda, out)
    }

    fn gauss_newton(&self, xi: &[f64], factor: f64, out: &mut [f64]) -> Result<(), NotFinite> {
        self.problem.gauss_newton(xi, factor, out)
    }

    fn constraints_within(&self, xi: &[f64], rows: &[Range<usize>], out: &mut [f64]) {
        self.problem.constraints_within(xi, rows, out);
    }

    fn jacobian_within(&self, xi: &[f64], rows: &[Range<usize>], out: &mut [f64]) {
        self.problem.jacobian_within(xi, rows, out);
    }

    fn chains(&self) -> Option<&Chains> {
        self.problem.chains()
    }

    fn longest_step(&self, i: VariableId) -> f64 {
        self.problem.longest_step(i)
    }

    fn threads(&self) -> Threads {
        self.problem.threads()
    }

    /// The scales of the noise, unless records share them.
    fn profiled(&self) -> Range<usize> {
        let own = self.problem.profiled();
        if self.held.iter().any(|i| own.contains(&i.0)) { 0..0 } else { own }
    }

    fn profile(&self, xi: &[f64], gradient: &[f64], reach: &Reach<'_>, out: &mut [f64]) -> f64 {
        self.problem.profile(xi, gradient, reach, out)
    }
}
