//! The response of the fitted path to a force on its equations: the sensitivities behind every candidate term.

use std::ops::Deref;

use super::SLIGHT;
use crate::collocation::Collocation;
use crate::index::VariableId;
use crate::linalg::{Effort, Entries, KktSolver, kkt_for};
use crate::nlp::{Nlp, NotFinite};
use crate::solver::state_units;

/// The linearisation of a collocation problem about a point, factorised once in the metric of its Gauss-Newton
/// Hessian.
///
/// A term b(t) that is added to f with a small coefficient c moves the optimum's path by c d, where A d = −∂h/∂c
/// keeps the defects zero. Of all such d the solution of the KKT system is the least in that metric, so it stays
/// small for unstable systems too, where a simulation from the initial state would not. Any other differs from it by
/// a *tangent*: a direction in which parameters and initial states move the path. Tangents come from the same
/// factorisation.
pub struct Response<P> {
    problem: P,
    kkt: Box<dyn KktSolver>,
    /// Scratch: right-hand sides and multipliers.
    p: Vec<f64>,
    q: Vec<f64>,
    lambda: Vec<f64>,
}

impl<P: Deref<Target = Collocation>> Response<P> {
    /// Factorises at ξ. Variables `held` (fixed, at a bound, of the noise) do not move.
    ///
    /// # Errors
    /// [`NotFinite`] when a derivative is not finite there, or the constraints depend on each other.
    pub fn new(problem: P, xi: &[f64], held: &[VariableId]) -> Result<Self, NotFinite> {
        let (n, m) = (problem.n(), problem.m());
        let mut hessian = vec![0.0; problem.hessian_structure().len()];
        let mut jacobian = vec![0.0; problem.jacobian_structure().len()];
        problem.gauss_newton(xi, 1.0, &mut hessian)?;
        problem.jacobian(xi, &mut jacobian)?;
        let mut kkt = kkt_for(&*problem, &state_units(&*problem, xi));
        let entries = Entries { hessian: &hessian, jacobian: &jacobian };
        let factor = kkt.factorize(&entries, Effort::FULL).map_err(|_| NotFinite)?;
        let mut holding = vec![false; n];
        held.iter().for_each(|i| holding[i.0] = true);
        if !factor.finish(&holding, 0.0).is_positive() && !factor.finish(&holding, SLIGHT).is_positive() {
            return Err(NotFinite);
        }
        Ok(Response { problem, kkt, p: vec![0.0; n], q: vec![0.0; m], lambda: vec![0.0; m] })
    }

    /// The direction d (n) to a slope b added to f: `slopes` holds n_x values for each point of the mesh, those of
    /// all experiments after each other.
    pub fn forced(&mut self, slopes: &[f64], d: &mut [f64]) {
        self.problem.forced(slopes, &mut self.q);
        self.q.iter_mut().for_each(|q| *q = -*q);
        self.solve(d);
        self.q.fill(0.0);
    }

    /// The tangent along which variable `i` moves most easily.
    pub fn tangent(&mut self, i: VariableId, d: &mut [f64]) {
        self.p[i] = 1.0;
        self.solve(d);
        self.p[i] = 0.0;
    }

    fn solve(&mut self, d: &mut [f64]) {
        let factor = self.kkt.factor().expect("`new` has factorised it");
        factor.solve(&self.p, &self.q, d, &mut self.lambda);
    }
}
