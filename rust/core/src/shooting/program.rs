//! φ, the continuity of segments, and their derivatives.

use std::ops::Range;
use std::sync::{Arc, PoisonError};

use super::Shooting;
use super::pieces::{
    Second, Uniforms, by_width, defects_of, gradient_of, hessian_of, jacobian_of, states_at, triangle,
};
use crate::index::ExperimentId;
use crate::nlp::{Chains, Nlp, NotFinite, Reach, Structure};
use crate::problem::boundary::{Boundary, Places};
use crate::problem::disjoint::Disjoint;
use crate::threads::Threads;

impl Shooting {
    /// θ and the states at the samples. An objective, its derivatives, and the states and outputs of each experiment
    /// share one integration.
    pub(super) fn integrate(&self, xi: &[f64]) -> Result<Arc<Vec<f64>>, NotFinite> {
        let latest = || self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((at, zeta)) = &*latest()
            && at == xi
        {
            return Ok(Arc::clone(zeta));
        }
        let mut zeta = vec![0.0; self.sampled.n()];
        zeta[..self.layout.n_theta].copy_from_slice(&xi[..self.layout.n_theta]);
        let out = Disjoint::new(&mut zeta);
        let uniforms = self.uniforms_of(&self.posed.f.value, xi);
        self.each(
            0,
            |group, m, _| by_width!(group, states_at(self, group, xi, &uniforms, m, &out)),
            |_, _| (),
        )?;
        let zeta = Arc::new(zeta);
        *latest() = Some((xi.to_vec(), Arc::clone(&zeta)));
        Ok(zeta)
    }

    /// Uniform values of f and of ∂f.
    fn both(&self, xi: &[f64]) -> [Uniforms; 2] {
        [self.uniforms_of(&self.posed.f.value, xi), self.uniforms_of(&self.posed.f.jacobian, xi)]
    }

    /// Writes factor · ∇²φ, and with multipliers adds the constraints'.
    fn second(
        &self,
        xi: &[f64],
        factor: f64,
        lambda: Option<&[f64]>,
        out: &mut [f64],
    ) -> Result<(), NotFinite> {
        let zeta = self.integrate(xi)?;
        let mut sampled = vec![0.0; self.sampled_hessian.len()];
        self.objective.hessian(&self.posed, &self.sampled, lambda.is_some(), &zeta, factor, &mut sampled)?;
        let mut gradient = vec![0.0; zeta.len()];
        self.objective.gradient(&self.posed, &self.sampled, &zeta, &mut gradient)?;
        gradient.iter_mut().for_each(|g| *g *= factor);
        let between = sampled.len() - triangle(self.layout.n_theta);
        let (own, conditions) = out.split_at_mut(out.len() - self.boundary_entries());
        conditions.fill(0.0);
        let (stored, pairs) = own.split_at_mut(own.len() - triangle(self.layout.n_theta));
        // Nothing but constraints depends on a node at the end.
        stored.fill(0.0);
        pairs.copy_from_slice(&sampled[between..]);
        let job = Second {
            problem: self,
            xi,
            uniforms: self.both(xi),
            curvature: self.uniforms_of(&self.posed.f.hessian, xi),
            sampled: &sampled,
            gradient: &gradient,
            lambda,
            out: Disjoint::new(stored),
        };
        let n_seen = self.posed.estimands.maps[ExperimentId(0)].len();
        self.each(
            triangle(n_seen),
            |group, m, part| by_width!(group, hessian_of(&job, group, m, part)),
            |group, part| {
                let map = &self.posed.estimands.maps[group.experiment];
                for (r, i) in map.iter().enumerate() {
                    for (q, j) in map.iter().take(r + 1).enumerate() {
                        pairs[triangle(i.max(j).0) + i.min(j).0] += part[triangle(r) + q];
                    }
                }
            },
        )
    }

    /// Entries of the Hessian that are those of conditions on the ends, the last.
    fn boundary_entries(&self) -> usize {
        self.boundary.as_ref().map_or(0, Boundary::hessian_entries)
    }

    /// Evaluates what there is of conditions on the ends.
    fn at_ends(&self, work: impl FnOnce(&Boundary, Places<'_>) -> bool) -> Result<(), NotFinite> {
        Boundary::evaluate(self.boundary.as_ref(), (&self.layout, &self.posed.estimands), work)
    }
}

impl Nlp for Shooting {
    fn n(&self) -> usize {
        self.layout.n()
    }

    fn m(&self) -> usize {
        self.layout.m() + self.boundary.as_ref().map_or(0, Boundary::rows)
    }

    fn bounds(&self) -> (Vec<f64>, Vec<f64>) {
        self.posed.bounds_of(self.n())
    }

    fn objective(&self, xi: &[f64]) -> Result<f64, NotFinite> {
        self.objective.value(&self.posed, &self.sampled, &self.integrate(xi)?)
    }

    fn gradient(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        let zeta = self.integrate(xi)?;
        let mut at_samples = vec![0.0; zeta.len()];
        self.objective.gradient(&self.posed, &self.sampled, &zeta, &mut at_samples)?;
        let (theta, states) = out.split_at_mut(self.layout.n_theta);
        theta.copy_from_slice(&at_samples[..self.layout.n_theta]);
        states.fill(0.0); // nothing depends on a node at the end
        let (shared, uniforms) = (Disjoint::new(states), self.both(xi));
        self.each(
            self.posed.estimands.maps[ExperimentId(0)].len(),
            |group, m, part| {
                by_width!(group, gradient_of(self, group, (xi, &at_samples), &uniforms, m, &shared, part))
            },
            |group, part| {
                let map = &self.posed.estimands.maps[group.experiment];
                map.iter().zip(part).for_each(|(&i, g)| theta[i] += g);
            },
        )
    }

    fn constraints(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.at_ends(|b, places| b.values(places, xi, out))?;
        if self.layout.m() == 0 {
            return Ok(());
        }
        let (out, uniforms) = (Disjoint::new(out), self.uniforms_of(&self.posed.f.value, xi));
        self.each(
            0,
            |group, m, _| by_width!(group, defects_of(self, group, xi, &uniforms, m, &out)),
            |_, _| (),
        )
    }

    fn jacobian_structure(&self) -> &Structure {
        &self.jacobian_structure
    }

    fn jacobian(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.at_ends(|b, places| b.jacobian(places, xi, out))?;
        if self.layout.m() == 0 {
            return Ok(());
        }
        let (out, uniforms) = (Disjoint::new(out), self.both(xi));
        self.each(
            0,
            |group, m, _| by_width!(group, jacobian_of(self, group, xi, &uniforms, m, &out)),
            |_, _| (),
        )
    }

    fn hessian_structure(&self) -> &Structure {
        &self.hessian_structure
    }

    fn hessian(&self, xi: &[f64], factor: f64, lambda: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.second(xi, factor, Some(lambda), out)?;
        self.at_ends(|b, places| b.hessian(places, xi, lambda, out))
    }

    fn gauss_newton(&self, xi: &[f64], factor: f64, out: &mut [f64]) -> Result<(), NotFinite> {
        self.second(xi, factor, None, out)
    }

    fn chains(&self) -> Option<&Chains> {
        self.chains.as_ref()
    }

    fn threads(&self) -> Threads {
        self.posed.threads.clone()
    }

    fn n_parameters(&self) -> usize {
        self.posed.parameters.len()
    }

    fn profiled(&self) -> Range<usize> {
        self.posed.profiled_noise()
    }

    fn profile(&self, xi: &[f64], gradient: &[f64], reach: &Reach<'_>, out: &mut [f64]) -> f64 {
        self.posed.profile_noise(xi, gradient, reach, out)
    }
}
