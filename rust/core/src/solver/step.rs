//! The Newton step, and what it promises.

use super::Run;
use super::status::Status;
use crate::linalg::{Curvature, KktError};

/// Greatest shift of the reduced Hessian, in units of its diagonal, that is tried.
pub(super) const GREATEST_SHIFT: f64 = 1e8;
/// Shifts of the exact system that rounding explains.
const ROUNDED: [f64; 3] = [1e-12, 1e-10, 1e-8];

/// Whether rounding explains a shift of the exact system.
pub(super) fn rounded(shift: f64) -> bool {
    shift <= ROUNDED[2]
}

/// What a step promises.
#[derive(Clone, Copy, Debug)]
pub(super) struct Promise {
    /// ∇φᵀd
    pub slope: f64,
    /// dᵀHd
    pub curvature: f64,
    /// Gain in φ if all goes as the model says, and what defects may pretend: distance from the end.
    pub gain: f64,
    /// What rounding leaves of that.
    pub floor: f64,
}

impl Run<'_> {
    /// Derivatives at the present point, the Newton system, and its solution.
    pub(super) fn newton_step(&mut self) -> Result<Promise, Status> {
        let nlp = self.nlp;
        self.count.gradient += 1;
        self.count.jacobian += 1;
        let mut fine = nlp.gradient(&self.here.xi, &mut self.gradient).is_ok();
        fine &= nlp.jacobian(&self.here.xi, &mut self.jacobian).is_ok();
        if !fine {
            return Err(self.not_finite());
        }
        let exact = self.near;
        self.bent = exact;
        self.kkt.set_refinement(exact);
        self.kkt.set_hurry(self.watchdog.on_trust());
        if exact {
            self.count.hessian += 1;
            fine = nlp.hessian(&self.here.xi, 1.0, &self.lambda, &mut self.hessian).is_ok();
            if !fine || !(self.factorize()?.is_positive() || self.nearly_positive()) {
                // Far from the end after all, or on a ridge.
                self.gauss_newton()?;
            }
        } else {
            self.gauss_newton()?;
        }
        let derivatives = (&*self.jacobian, &*self.hessian);
        self.units.size_border(nlp, &self.here.xi, derivatives, &mut self.sizes);
        self.solve_with_bounds();
        Ok(self.promise())
    }

    /// The step of the system at hand with no more shift than it needs to be positive.
    pub(super) fn undamped(&mut self) -> Result<Promise, Status> {
        let found = self.kkt.finish(self.active.held(), 0.0);
        if self.bent && !found.is_positive() {
            return self.newton_step();
        }
        self.regular(found)?;
        self.solve_with_bounds();
        Ok(self.promise())
    }

    /// Whether the exact system lacks no more than what rounding takes where the data hardly tell: then it is shifted
    /// by that. Gauss-Newton steps could circle about such an optimum for long.
    fn nearly_positive(&mut self) -> bool {
        let before = self.shift;
        for shift in ROUNDED {
            self.shift = shift.max(before);
            if self.kkt.finish(self.active.held(), self.shift).is_positive() {
                return true;
            }
        }
        self.shift = before;
        false
    }

    /// The Gauss-Newton system, shifted until it is positive.
    fn gauss_newton(&mut self) -> Result<(), Status> {
        self.count.gauss_newton += 1;
        self.bent = false;
        if self.nlp.gauss_newton(&self.here.xi, 1.0, &mut self.hessian).is_err() {
            return Err(self.not_finite());
        }
        let found = self.factorize()?;
        self.regular(found)
    }

    fn regular(&mut self, mut found: Curvature) -> Result<(), Status> {
        while !found.is_positive() {
            self.shift = (self.shift * 100.0).max(1e-10);
            if self.shift > GREATEST_SHIFT {
                return Err(Status::Failed);
            }
            found = self.kkt.finish(self.active.held(), self.shift);
        }
        Ok(())
    }

    /// A derivative is not finite at a point where the functions are. At the start that is an error. An evaluation that
    /// was stopped says the same; to search for a cause then would take many times the limit.
    fn not_finite(&mut self) -> Status {
        if !self.history.is_empty() && !self.interrupt.stops() {
            self.detail =
                self.nlp.explain(&self.here.xi).unwrap_or_else(|| "a derivative is not finite".into());
        }
        Status::Failed
    }

    fn factorize(&mut self) -> Result<Curvature, Status> {
        self.count.factorizations += 1;
        if let Err(error) = self.kkt.factorize(&self.hessian, &self.jacobian) {
            self.detail = match error {
                KktError::Dependent { row } => {
                    format!("the {} depends on others", self.nlp.constraint_name(row))
                }
                other => other.to_string(),
            };
            let depends = matches!(error, KktError::Dependent { .. } | KktError::Boundary);
            return Err(if depends { Status::Infeasible } else { Status::Failed });
        }
        let profiled = if self.near { 0..0 } else { self.nlp.profiled() };
        self.active.begin(&self.here.xi, &self.bounds, &self.gradient, profiled);
        Ok(self.kkt.finish(self.active.held(), self.shift))
    }

    /// What the step promises.
    pub(super) fn promise(&self) -> Promise {
        let slope: f64 = self.gradient.iter().zip(&self.d).map(|(g, d)| g * d).sum();
        let pull: f64 = self.next_lambda.iter().zip(&self.here.c).map(|(l, c)| l * c).sum();
        let pretended: f64 = self.next_lambda.iter().zip(&self.here.c).map(|(l, c)| (l * c).abs()).sum();
        // H d = −∇φ − Aᵀλ − z, and A d = −c.
        let curvature = -slope + pull - self.active.pull(&self.d);
        let border = self.nlp.chains().map_or(0, |c| c.border);
        let own = self.here.xi[border..].iter();
        let sizes: f64 = self.next_lambda.iter().zip(own).map(|(l, x)| (l * x).abs()).sum();
        Promise { slope, curvature, gain: 0.5 * slope.abs() + pretended, floor: 8.0 * f64::EPSILON * sizes }
    }
}
