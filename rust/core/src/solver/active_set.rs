//! The active set: which variables are held at a bound, fixed or profiled.

use std::ops::Range;

use super::iterate::Iterate;
use super::program::Program;
use super::step::Step;

/// A state leaves its bounds where it does so by more than this, in its unit: the next point is within them.
const STATE_TOLERANCE: f64 = 1e-9;

/// Variables held in a step, each with the step it makes and the multiplier that holds it.
#[derive(Clone, Debug, Default)]
pub(super) struct ActiveSet {
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
    /// Degrees of freedom: the number of variables less that of equations.
    freedom: usize,
}

impl ActiveSet {
    pub fn new(program: &Program<'_>) -> ActiveSet {
        let n = program.nlp.n();
        let (lower, upper) = (&program.lower, &program.upper);
        let fixed: Vec<bool> = (0..n).map(|i| lower[i] == upper[i]).collect();
        ActiveSet {
            held: fixed.clone(),
            bounded: (0..n).filter(|&i| lower[i].is_finite() || upper[i].is_finite()).collect(),
            fixed,
            to: vec![0.0; n],
            multiplier: vec![0.0; n],
            was: vec![false; n],
            profiled: 0..0,
            border: program.nlp.n_parameters().min(n),
            last: None,
            freedom: n.saturating_sub(program.nlp.m()),
        }
    }

    pub fn held(&self) -> &[bool] {
        &self.held
    }

    /// Begins with what was held in the last step and stands at its bound, and what is fixed or profiled.
    pub fn begin(&mut self, program: &Program<'_>, iterate: &Iterate, profiled: Range<usize>) {
        self.held.copy_from_slice(&self.fixed);
        for &i in &self.bounded {
            (self.to[i], self.multiplier[i]) = (0.0, 0.0);
            let (x, slope) = (iterate.point.xi[i], iterate.gradient[i]);
            let at = x == program.lower[i] && slope >= 0.0 || x == program.upper[i] && slope <= 0.0;
            // States are held anew in each step: what holds one may leave another no choice.
            self.held[i] |= self.was[i] && at && i < self.border;
        }
        for i in profiled.clone() {
            self.held[i] = true;
        }
        self.profiled = profiled;
    }

    /// Most rounds of changes. The equations leave no more variables to be held than there are degrees of freedom: with
    /// bounds on thousands of states more rounds would only hold some of these in turn.
    pub fn rounds(&self) -> usize {
        if self.bounded.is_empty() { 0 } else { 3 * self.bounded.len().min(self.freedom) + 10 }
    }

    /// Whether a variable is held at a bound.
    fn binds(&self, i: usize) -> bool {
        self.held[i] && !self.fixed[i] && !self.profiled.contains(&i)
    }

    /// Σ z d over variables held at a bound.
    pub fn pull(&self, d: &[f64]) -> f64 {
        self.bounded.iter().map(|&i| self.multiplier[i] * d[i]).sum()
    }

    /// Sets the steps of held variables, which go to their bounds.
    pub fn put(&self, d: &mut [f64]) {
        self.bounded.iter().filter(|&&i| self.held[i]).for_each(|&i| d[i] = self.to[i]);
    }

    /// Remembers what is held, for the next step.
    pub fn end(&mut self) {
        for k in 0..self.bounded.len() {
            let i = self.bounded[k];
            self.was[i] = self.binds(i);
        }
    }

    /// Releases the state that was held last; whether there is one.
    pub fn release_last(&mut self) -> bool {
        self.last.take().is_some_and(|last| std::mem::take(&mut self.held[last]))
    }

    /// Holds what left its bounds, else releases what is held back from a gain; whether anything changed. `z` (n) is
    /// scratch.
    pub fn change(
        &mut self,
        program: &Program<'_>,
        iterate: &Iterate,
        step: &Step,
        z: &mut [f64],
        release: bool,
    ) -> bool {
        let any = self.hold(program, iterate, &step.d);
        self.update_multipliers(program, iterate, step, z);
        any || release && self.release(program, iterate)
    }

    /// The same, of the first variables alone, where they are all that may be held: `d` is their step, `z` what holds them.
    pub fn change_first(
        &mut self,
        program: &Program<'_>,
        iterate: &Iterate,
        (d, z): (&[f64], &[f64]),
        release: bool,
    ) -> bool {
        let any = self.hold(program, iterate, d);
        for k in 0..self.bounded.len() {
            let i = self.bounded[k];
            self.multiplier[i] = if self.binds(i) { z[i] } else { 0.0 };
        }
        any || release && self.release(program, iterate)
    }

    /// Whether variables that may be held are all among the first.
    pub fn are_first(&self, count: usize) -> bool {
        self.bounded.last().is_none_or(|&i| i < count)
    }

    /// The steps of held variables.
    pub fn to(&self) -> &[f64] {
        &self.to
    }

    /// Holds what left its bounds: all parameters that did, else the state that did so farthest. Whether there are any.
    fn hold(&mut self, program: &Program<'_>, iterate: &Iterate, d: &[f64]) -> bool {
        self.last = None;
        let mut any = false;
        let mut farthest: Option<(usize, f64)> = None; // a state, and how far it left its bounds
        for &i in &self.bounded {
            if self.held[i] {
                continue;
            }
            let (x, low, high) = (iterate.point.xi[i], program.lower[i], program.upper[i]);
            let to = x + d[i];
            if to < low || to > high {
                self.to[i] = if to < low { low - x } else { high - x };
                if i < self.border {
                    self.held[i] = true;
                    any = true;
                    continue;
                }
                let units = &program.units.states;
                let unit = units[(i - self.border) % units.len()];
                let far = (low - to).max(to - high) / unit;
                if farthest.is_none_or(|(_, most)| far > most) && far > STATE_TOLERANCE {
                    farthest = Some((i, far));
                }
            }
        }
        if let Some((i, _)) = farthest.filter(|_| !any) {
            self.held[i] = true;
            self.last = Some(i);
            any = true;
        }
        any
    }

    /// Releases what its multiplier holds back from a gain; whether there is any.
    fn release(&mut self, program: &Program<'_>, iterate: &Iterate) -> bool {
        let mut any = false;
        for k in 0..self.bounded.len() {
            let i = self.bounded[k];
            if !self.binds(i) {
                continue;
            }
            let to = iterate.point.xi[i] + self.to[i];
            // z = −(∇φ + H d + Aᵀλ) pushes up at an upper bound and down at a lower one.
            let z = self.multiplier[i];
            let wrong = if to == program.upper[i] { z < 0.0 } else { z > 0.0 };
            if wrong {
                self.held[i] = false;
                (self.to[i], self.multiplier[i]) = (0.0, 0.0);
                any = true;
            }
        }
        any
    }

    /// z = −(∇φ + H d + Aᵀλ) of held variables.
    fn update_multipliers(&mut self, program: &Program<'_>, iterate: &Iterate, step: &Step, z: &mut [f64]) {
        if !self.bounded.iter().any(|&i| self.binds(i)) {
            return;
        }
        z.copy_from_slice(&iterate.gradient);
        let s = program.nlp.hessian_structure();
        for ((&r, &c), h) in s.rows.iter().zip(&s.columns).zip(&iterate.hessian) {
            z[r as usize] += h * step.d[c as usize];
            if r != c {
                z[c as usize] += h * step.d[r as usize];
            }
        }
        let s = program.nlp.jacobian_structure();
        for ((&r, &c), a) in s.rows.iter().zip(&s.columns).zip(&iterate.jacobian) {
            z[c as usize] += a * step.multipliers[r as usize];
        }
        for k in 0..self.bounded.len() {
            let i = self.bounded[k];
            self.multiplier[i] = if self.binds(i) { -z[i] } else { 0.0 };
        }
    }

    /// Moves the steps of held variables over to a right-hand side.
    pub fn move_over(&self, program: &Program<'_>, iterate: &Iterate, (p, q): (&mut [f64], &mut [f64])) {
        let to = &self.to;
        if !self.bounded.iter().any(|&i| self.held[i] && to[i] != 0.0) {
            return;
        }
        let s = program.nlp.hessian_structure();
        for ((&r, &c), h) in s.rows.iter().zip(&s.columns).zip(&iterate.hessian) {
            let (r, c) = (r as usize, c as usize);
            p[r] -= h * to[c];
            if r != c {
                p[c] -= h * to[r];
            }
        }
        let s = program.nlp.jacobian_structure();
        for ((&r, &c), a) in s.rows.iter().zip(&s.columns).zip(&iterate.jacobian) {
            q[r as usize] -= a * to[c as usize];
        }
    }
}
