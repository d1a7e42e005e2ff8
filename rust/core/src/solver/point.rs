//! A point with everything that was evaluated there.

use super::units::Units;
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

/// φ and c at ξ; derivatives are kept beside, for the current point alone.
#[derive(Clone, Debug)]
pub(super) struct Point {
    pub xi: Vec<f64>,
    pub objective: f64,
    pub c: Vec<f64>,
    /// Σ |c| in units.
    pub defect: f64,
    /// max |c| in units.
    pub worst: f64,
}

impl Point {
    pub fn new(xi: &[f64], m: usize) -> Point {
        Point { xi: xi.to_vec(), objective: f64::NAN, c: vec![0.0; m], defect: f64::NAN, worst: f64::NAN }
    }

    /// Evaluates φ and c at ξ.
    pub fn evaluate(
        &mut self,
        nlp: &dyn Nlp,
        units: &Units,
        count: &mut Evaluations,
    ) -> Result<(), NotFinite> {
        count.constraints += 1;
        nlp.constraints(&self.xi, &mut self.c)?;
        (self.defect, self.worst) = (0.0, 0.0);
        for (c, unit) in self.c.iter().zip(units.each()) {
            let size = c.abs() / unit;
            self.defect += size;
            self.worst = size.max(self.worst);
        }
        self.evaluate_objective(nlp, count)?;
        if self.defect.is_finite() { Ok(()) } else { Err(NotFinite) }
    }

    /// Evaluates φ alone.
    pub fn evaluate_objective(&mut self, nlp: &dyn Nlp, count: &mut Evaluations) -> Result<(), NotFinite> {
        count.objective += 1;
        self.objective = nlp.objective(&self.xi)?;
        Ok(())
    }

    /// Takes over another point.
    pub fn copy(&mut self, other: &Point) {
        self.xi.copy_from_slice(&other.xi);
        self.c.copy_from_slice(&other.c);
        (self.objective, self.defect, self.worst) = (other.objective, other.defect, other.worst);
    }

    /// ξ = base + α d, within bounds.
    pub fn step(&mut self, base: &[f64], alpha: f64, d: &[f64], bounds: &(Vec<f64>, Vec<f64>)) {
        for (i, x) in self.xi.iter_mut().enumerate() {
            *x = alpha.mul_add(d[i], base[i]).clamp(bounds.0[i], bounds.1[i]);
        }
    }
}
