//! The line search on the ℓ₁ merit function, with second-order corrections.

use super::NEAR;
use super::iterate::Iterate;
use super::merit::{Goal, Merit};
use super::newton_system::Factored;
use super::point::Point;
use super::program::Program;
use super::promise::Promise;
use super::step::Step;
use super::watchdog::Watchdog;

/// Shortest step.
const SHORTEST: f64 = 1e-7;
/// Most second-order corrections of a step.
const CORRECTIONS: usize = 3;

/// What the search keeps from step to step, and its trial point.
pub(super) struct LineSearch {
    merit: Merit,
    watchdog: Watchdog,
    trial: Point,
    /// The step without damping, and a correction.
    scratch: Step,
}

impl LineSearch {
    pub fn new(program: &Program<'_>, point: &Point) -> LineSearch {
        LineSearch {
            merit: Merit::default(),
            watchdog: Watchdog::new(point),
            trial: point.clone(),
            scratch: Step::new(program),
        }
    }

    /// Moves the iterate along the step; its length and the number of trials, or nothing where none helped.
    pub fn search(
        &mut self,
        program: &Program<'_>,
        system: &mut Factored<'_>,
        iterate: &mut Iterate,
        step: &mut Step,
        promise: &Promise,
    ) -> Option<(f64, usize)> {
        let goal = self.goal(iterate, promise);
        let mut trials = 1;
        let fine = self.trial.step(program, &iterate.point.xi, 1.0, &step.d);
        if fine && goal.is_met(&self.trial, 1.0) {
            system.damping.relax();
            self.watchdog.lowered(true);
            iterate.accept(&mut self.trial, 1.0, step);
            return Some((1.0, trials));
        }
        if fine && self.watchdog.trusts(iterate, &self.trial, promise, NEAR) {
            self.watchdog.trusted();
            iterate.accept(&mut self.trial, 1.0, step);
            return Some((1.0, trials));
        }
        if self.go_back(iterate) {
            return Some((0.0, trials));
        }
        let full = fine && self.correct(program, system, &goal, &mut trials)
            || self.damp(program, system, iterate, step, &mut trials);
        let alpha = if full { 1.0 } else { self.shorten(program, iterate, step, &goal, &mut trials)? };
        self.watchdog.lowered(false);
        iterate.accept(&mut self.trial, alpha, step);
        Some((alpha, trials))
    }

    fn goal(&mut self, iterate: &Iterate, promise: &Promise) -> Goal {
        self.merit.update(promise, iterate.point.defect);
        let (from, slope) = self.watchdog.reference(&iterate.point, promise.slope);
        self.merit.goal(from, slope, promise.floor)
    }

    /// Second-order corrections of the trial point: steps back to the constraints with the same factors. Whether one
    /// reaches the goal.
    fn correct(
        &mut self,
        program: &Program<'_>,
        system: &mut Factored<'_>,
        goal: &Goal,
        trials: &mut usize,
    ) -> bool {
        let mut defect = self.trial.defect;
        for _ in 0..CORRECTIONS {
            *trials += 1;
            system.correction(program, &self.trial.c, &mut self.scratch);
            if !self.trial.correct(program, &self.scratch.d) {
                return false;
            }
            if goal.is_met(&self.trial, 1.0) {
                return true;
            }
            if self.trial.defect > 0.5 * defect {
                return false;
            }
            defect = self.trial.defect;
        }
        false
    }

    /// Full steps with more and more damping of the parameters: in the limit these stay, and the states go to where
    /// the equations want them. Whether one reaches its goal; else the step is what it was.
    fn damp(
        &mut self,
        program: &Program<'_>,
        system: &mut Factored<'_>,
        iterate: &Iterate,
        step: &mut Step,
        trials: &mut usize,
    ) -> bool {
        self.scratch.copy(step);
        for shift in system.damping.trials() {
            let Some(promise) = system.damped(shift, program, iterate, step) else { continue };
            let goal = self.goal(iterate, &promise);
            *trials += 1;
            if self.trial.step(program, &iterate.point.xi, 1.0, &step.d) && goal.is_met(&self.trial, 1.0) {
                system.damping.keep(shift);
                return true;
            }
        }
        std::mem::swap(step, &mut self.scratch);
        false
    }

    /// Shorter and shorter steps.
    fn shorten(
        &mut self,
        program: &Program<'_>,
        iterate: &Iterate,
        step: &Step,
        goal: &Goal,
        trials: &mut usize,
    ) -> Option<f64> {
        let lengths = std::iter::successors(Some(0.5), |alpha| Some(0.3 * alpha));
        for alpha in lengths.take_while(|alpha| *alpha >= SHORTEST) {
            *trials += 1;
            if self.trial.step(program, &iterate.point.xi, alpha, &step.d) && goal.is_met(&self.trial, alpha)
            {
                return Some(alpha);
            }
        }
        None
    }

    /// Takes the last step, which costs nothing more than to see that it does no harm.
    pub fn take_last(&mut self, program: &Program<'_>, iterate: &mut Iterate, step: &Step) {
        let fine = self.trial.step(program, &iterate.point.xi, 1.0, &step.d);
        if fine && self.trial.objective <= iterate.point.objective + 1e-6 {
            iterate.set(&self.trial, &step.multipliers);
        }
    }

    /// Takes a full step, whatever the objective there: from a path that does not satisfy the equations it may rise. Whether
    /// all is finite there.
    pub fn take_full(&mut self, program: &Program<'_>, iterate: &mut Iterate, step: &Step) -> bool {
        let finite = self.trial.step(program, &iterate.point.xi, 1.0, &step.d);
        if finite {
            iterate.set(&self.trial, &step.multipliers);
        }
        finite
    }

    /// Whether the iterate is one of trust.
    pub fn on_trust(&self) -> bool {
        self.watchdog.on_trust()
    }

    /// Back to where the merit function was lowest; the next step must lower it. Whether there is such a point.
    pub fn go_back(&mut self, iterate: &mut Iterate) -> bool {
        self.watchdog.go_back(iterate)
    }

    /// The same where that point is better than the present one.
    pub fn go_back_if_better(&mut self, iterate: &mut Iterate) {
        if self.merit.at(self.watchdog.back()) < self.merit.at(&iterate.point) {
            self.go_back(iterate);
        }
    }
}
