//! The program as the loop sees it: its functions, counted, with what does not change from point to point.

use std::cell::Cell;
use std::ops::Range;

use super::status::Status;
use super::units::Units;
use crate::interrupt::{Interrupt, current};
use crate::nlp::{Nlp, NotFinite};

/// How often each function was evaluated: a cost that does not depend on the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evaluations {
    /// Objective.
    pub objective: usize,
    /// Gradient.
    pub gradient: usize,
    /// Constraints.
    pub constraints: usize,
    /// Jacobian.
    pub jacobian: usize,
    /// Exact Hessian.
    pub hessian: usize,
    /// Gauss-Newton Hessian.
    pub gauss_newton: usize,
    /// Factorisations of the Newton system.
    pub factorizations: usize,
    /// Solutions of it.
    pub solutions: usize,
}

/// A nonlinear program with bounds, units and the interrupt in force.
pub(crate) struct Program<'a> {
    pub nlp: &'a dyn Nlp,
    pub lower: Vec<f64>,
    pub upper: Vec<f64>,
    pub units: Units,
    pub interrupt: Interrupt,
    evaluations: Cell<Evaluations>,
}

impl<'a> Program<'a> {
    /// With the units of a point.
    pub fn new(nlp: &'a dyn Nlp, xi: &[f64]) -> Program<'a> {
        let (lower, upper) = nlp.bounds();
        let evaluations = Cell::new(Evaluations::default());
        Program { nlp, lower, upper, units: Units::new(nlp, xi), interrupt: current(), evaluations }
    }

    /// Number of variables in the border of chains.
    pub fn border(&self) -> usize {
        self.nlp.chains().map_or(0, |c| c.border)
    }

    /// The nearest value of a variable within its bounds.
    pub fn within(&self, i: usize, x: f64) -> f64 {
        x.clamp(self.lower[i], self.upper[i])
    }

    /// How the run ends where it has been stopped.
    pub fn stopped(&self) -> Option<Status> {
        Status::stopped(&self.interrupt)
    }

    pub fn evaluations(&self) -> Evaluations {
        self.evaluations.get()
    }

    /// Goes on counting from there.
    pub fn count_from(&self, evaluations: Evaluations) {
        self.evaluations.set(evaluations);
    }

    pub fn count(&self, add: impl FnOnce(&mut Evaluations)) {
        let mut evaluations = self.evaluations.get();
        add(&mut evaluations);
        self.evaluations.set(evaluations);
    }

    pub fn objective(&self, xi: &[f64]) -> Result<f64, NotFinite> {
        self.count(|e| e.objective += 1);
        self.nlp.objective(xi)
    }

    pub fn constraints(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.count(|e| e.constraints += 1);
        self.nlp.constraints(xi, out)
    }

    pub fn gradient(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.count(|e| e.gradient += 1);
        self.nlp.gradient(xi, out)
    }

    pub fn jacobian(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.count(|e| e.jacobian += 1);
        self.nlp.jacobian(xi, out)
    }

    /// The constraints in some ranges at least.
    pub fn constraints_within(&self, xi: &[f64], rows: &[Range<usize>], out: &mut [f64]) {
        self.count(|e| e.constraints += 1);
        self.nlp.constraints_within(xi, rows, out);
    }

    /// Their Jacobian.
    pub fn jacobian_within(&self, xi: &[f64], rows: &[Range<usize>], out: &mut [f64]) {
        self.count(|e| e.jacobian += 1);
        self.nlp.jacobian_within(xi, rows, out);
    }

    pub fn hessian(&self, xi: &[f64], lambda: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.count(|e| e.hessian += 1);
        self.nlp.hessian(xi, 1.0, lambda, out)
    }

    pub fn gauss_newton(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.count(|e| e.gauss_newton += 1);
        self.nlp.gauss_newton(xi, 1.0, out)
    }
}
