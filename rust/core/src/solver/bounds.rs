//! Bounds by an active set: which variables are held where.

use std::ops::Range;

use super::Run;

/// Variables held in a step, each with the step it makes and the multiplier that holds it.
#[derive(Clone, Debug, Default)]
pub(super) struct Active {
    held: Vec<bool>,
    /// Variables that may be held: fixed, bounded or profiled.
    bounded: Vec<usize>,
    fixed: Vec<bool>,
    /// Step to the bound, where held there.
    to: Vec<f64>,
    multiplier: Vec<f64>,
    /// Held at a bound in the last step.
    was: Vec<bool>,
    profiled: Range<usize>,
    /// Variables from here on are states, of which one at a time is held.
    border: usize,
    /// The state that was held last.
    last: Option<usize>,
}

/// A state leaves its bounds where it does so by more than this, in its unit: the next point is within them.
const STATE_TOLERANCE: f64 = 1e-9;

impl Active {
    pub fn new(bounds: &(Vec<f64>, Vec<f64>), border: usize) -> Active {
        let n = bounds.0.len();
        let fixed: Vec<bool> = (0..n).map(|i| bounds.0[i] == bounds.1[i]).collect();
        let bounded = (0..n).filter(|&i| bounds.0[i].is_finite() || bounds.1[i].is_finite()).collect();
        Active {
            held: fixed.clone(),
            bounded,
            fixed,
            to: vec![0.0; n],
            multiplier: vec![0.0; n],
            was: vec![false; n],
            profiled: 0..0,
            border,
            last: None,
        }
    }

    pub fn held(&self) -> &[bool] {
        &self.held
    }

    /// The first guess: what was held in the last step and stands at its bound, and what is fixed or
    /// profiled.
    pub fn begin(
        &mut self,
        xi: &[f64],
        bounds: &(Vec<f64>, Vec<f64>),
        gradient: &[f64],
        profiled: Range<usize>,
    ) {
        self.held.copy_from_slice(&self.fixed);
        for &i in &self.bounded {
            (self.to[i], self.multiplier[i]) = (0.0, 0.0);
            let at = xi[i] == bounds.0[i] && gradient[i] >= 0.0 || xi[i] == bounds.1[i] && gradient[i] <= 0.0;
            // States are held anew in each step: what holds one may leave another no choice.
            self.held[i] |= self.was[i] && at && i < self.border;
        }
        for i in profiled.clone() {
            self.held[i] = true;
        }
        self.profiled = profiled;
    }

    /// Whether a variable is held at a bound.
    fn binds(&self, i: usize) -> bool {
        self.held[i] && !self.fixed[i] && !self.profiled.contains(&i)
    }

    /// Σ z d over variables held at a bound.
    pub fn pull(&self, d: &[f64]) -> f64 {
        self.bounded.iter().map(|&i| self.multiplier[i] * d[i]).sum()
    }
}

impl Run<'_> {
    /// Solves the Newton system within bounds: a quadratic program in which only the few bounded
    /// variables change sides.
    pub(super) fn solve_with_bounds(&mut self) {
        self.p.iter_mut().zip(&self.gradient).for_each(|(p, g)| *p = -g);
        self.q.iter_mut().zip(&self.here.c).for_each(|(q, c)| *q = -c);
        self.count.solutions += 1;
        self.kkt.solve(&self.p, &self.q, &mut self.d, &mut self.next_lambda);
        if self.active.bounded.is_empty() {
            return;
        }
        let most = 3 * self.active.bounded.len() + 10;
        for round in 0..most {
            // Releasing is given up at last, so that this ends.
            if !self.change_sides(round < most / 2) {
                break;
            }
            let found = self.kkt.finish(self.active.held(), self.shift);
            if let Some(last) = self.active.last.take().filter(|_| !found.is_positive()) {
                // The equations leave this state no choice, given the others that are held.
                self.active.held[last] = false;
                self.kkt.finish(self.active.held(), self.shift);
                self.resolve();
                break;
            }
            self.resolve();
        }
        for &i in &self.active.bounded {
            self.active.was[i] = self.active.binds(i);
        }
    }

    /// Solves again for the variables held as they are.
    pub(super) fn resolve(&mut self) {
        self.right_side();
        self.count.solutions += 1;
        self.kkt.solve(&self.p, &self.q, &mut self.d, &mut self.next_lambda);
        for &i in &self.active.bounded {
            if self.active.held[i] {
                self.d[i] = self.active.to[i];
            }
        }
    }

    /// Holds what left its bounds, else releases what is held back from a gain; whether anything changed.
    fn change_sides(&mut self, release: bool) -> bool {
        let mut any = false;
        let mut farthest: Option<(usize, f64)> = None; // a state, and how far it left its bounds
        for k in 0..self.active.bounded.len() {
            let i = self.active.bounded[k];
            if self.active.held[i] {
                continue;
            }
            let (x, low, high) = (self.here.xi[i], self.bounds.0[i], self.bounds.1[i]);
            let to = x + self.d[i];
            if to < low || to > high {
                self.active.to[i] = if to < low { low - x } else { high - x };
                if i < self.active.border {
                    self.active.held[i] = true;
                    any = true;
                    continue;
                }
                let units = &self.units.states;
                let unit = units[(i - self.active.border) % units.len()];
                let far = (low - to).max(to - high) / unit;
                if farthest.is_none_or(|(_, most)| far > most) && far > STATE_TOLERANCE {
                    farthest = Some((i, far));
                }
            }
        }
        if let Some((i, _)) = farthest.filter(|_| !any) {
            self.active.held[i] = true;
            self.active.last = Some(i);
            any = true;
        }
        self.multipliers_of_bounds();
        if any || !release {
            return any;
        }
        for k in 0..self.active.bounded.len() {
            let i = self.active.bounded[k];
            if !self.active.binds(i) {
                continue;
            }
            let to = self.here.xi[i] + self.active.to[i];
            // z = −(∇φ + H d + Aᵀλ) pushes up at an upper bound and down at a lower one.
            let z = self.active.multiplier[i];
            let wrong = if to == self.bounds.1[i] { z < 0.0 } else { z > 0.0 };
            if wrong {
                self.active.held[i] = false;
                (self.active.to[i], self.active.multiplier[i]) = (0.0, 0.0);
                any = true;
            }
        }
        any
    }

    /// z = −(∇φ + H d + Aᵀλ) of held variables.
    fn multipliers_of_bounds(&mut self) {
        if !self.active.bounded.iter().any(|&i| self.active.binds(i)) {
            return;
        }
        let z = &mut self.p;
        z.copy_from_slice(&self.gradient);
        let s = self.nlp.hessian_structure();
        for ((&r, &c), h) in s.rows.iter().zip(&s.columns).zip(&self.hessian) {
            z[r as usize] += h * self.d[c as usize];
            if r != c {
                z[c as usize] += h * self.d[r as usize];
            }
        }
        let s = self.nlp.jacobian_structure();
        for ((&r, &c), a) in s.rows.iter().zip(&s.columns).zip(&self.jacobian) {
            z[c as usize] += a * self.next_lambda[r as usize];
        }
        for &i in &self.active.bounded {
            let counts = self.active.binds(i);
            self.active.multiplier[i] = if counts { -z[i] } else { 0.0 };
        }
    }

    /// Right-hand side with the steps of held variables moved over.
    fn right_side(&mut self) {
        self.p.iter_mut().zip(&self.gradient).for_each(|(p, g)| *p = -g);
        self.q.iter_mut().zip(&self.here.c).for_each(|(q, c)| *q = -c);
        if !self.active.bounded.iter().any(|&i| self.active.held[i] && self.active.to[i] != 0.0) {
            return;
        }
        let to = &self.active.to;
        let s = self.nlp.hessian_structure();
        for ((&r, &c), h) in s.rows.iter().zip(&s.columns).zip(&self.hessian) {
            let (r, c) = (r as usize, c as usize);
            self.p[r] -= h * to[c];
            if r != c {
                self.p[c] -= h * to[r];
            }
        }
        let s = self.nlp.jacobian_structure();
        for ((&r, &c), a) in s.rows.iter().zip(&s.columns).zip(&self.jacobian) {
            self.q[r as usize] -= a * to[c as usize];
        }
    }
}
