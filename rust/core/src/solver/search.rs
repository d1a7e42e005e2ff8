//! The line search on the ℓ₁ merit function, with second-order corrections.

use super::point::Point;
use super::step::Promise;
use super::{NEAR, Run};

/// Part of the promised decrease that must come true (Armijo).
const ARMIJO: f64 = 1e-4;
/// Part of the decrease of defects that the model must promise.
const RHO: f64 = 0.1;
/// Shortest step.
const SHORTEST: f64 = 1e-7;
/// Most second-order corrections of a step.
const CORRECTIONS: usize = 3;

/// Damping of the parameters, in units of the curvature: what is tried first, and the limits.
pub(super) const FIRST_DAMPING: f64 = 1e-2;
const LEAST_DAMPING: f64 = 1e-9;
const MOST_DAMPING: f64 = 1e6;
/// Most full steps in a row without a lower merit function, until such steps have led nowhere.
const PATIENCE: usize = 8;

/// Trust ends where a defect is so many times what it was, or what its state does, or where so many times
/// the likelihood is lost that the step promised.
const ASTRAY: f64 = 10.0;
const LOST: f64 = 100.0;

/// φ + ν Σ|c| in units.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Merit {
    nu: f64,
}

impl Merit {
    /// Raises ν as far as the step needs to be a descent; lowers it slowly where it could be less.
    fn update(&mut self, promise: &Promise, defect: f64) {
        if defect <= 0.0 {
            return;
        }
        let least = (promise.slope + 0.5 * promise.curvature.max(0.0)) / ((1.0 - RHO) * defect);
        self.nu = if self.nu < least { 1.5 * least } else { (0.3 * self.nu).max(1.5 * least).max(0.0) };
    }
}

/// Full steps on trust (Chamberlain, Powell, Lemarechal and Pedersen, 1982): the merit function may rise
/// for some steps, as it does along curved constraints and on the way out of a bad valley, if it is
/// lower in the end than where it began to rise; if not, the search goes back there.
#[derive(Clone, Debug)]
pub(super) struct Watchdog {
    back: Point,
    lambda: Vec<f64>,
    /// ∇φᵀd of the step that began there.
    slope: f64,
    /// Steps since the merit function was lowest; 0 where it is so now.
    age: usize,
    /// Most such steps: half as many each time that they led nowhere.
    patience: usize,
    /// The next step must lower it.
    strict: bool,
}

impl Watchdog {
    pub fn new(here: &Point) -> Watchdog {
        let lambda = vec![0.0; here.c.len()];
        Watchdog { back: here.clone(), lambda, slope: 0.0, age: 0, patience: PATIENCE, strict: false }
    }

    /// Whether the present point is one of trust, and a better one is kept.
    pub fn on_trust(&self) -> bool {
        self.age > 0
    }
}

/// φ + ν Σ|c| where a step begins, and what it must fall by.
#[derive(Clone, Copy)]
struct Goal {
    nu: f64,
    merit: f64,
    slope: f64,
    noise: f64,
}

impl Goal {
    fn met(&self, p: &Point, alpha: f64) -> bool {
        let merit = self.nu.mul_add(p.defect, p.objective);
        merit <= self.merit + ARMIJO * alpha * self.slope.min(0.0) + self.noise
    }
}

impl Run<'_> {
    /// Moves along the step; its length and the number of trials, or nothing where none helped.
    pub(super) fn search(&mut self, promise: &Promise) -> Option<(f64, usize)> {
        let goal = self.goal(promise);
        let mut trials = 1;
        let fine = self.try_step(1.0);
        if fine && goal.met(&self.trial, 1.0) {
            self.relax();
            if self.watchdog.age > 0 {
                self.watchdog.patience = PATIENCE;
            }
            return Some(self.accept(1.0, trials));
        }
        if fine && !self.watchdog.strict {
            if self.watchdog.age == 0 {
                self.watchdog.back.copy(&self.here);
                self.watchdog.lambda.copy_from_slice(&self.lambda);
                self.watchdog.slope = promise.slope;
            }
            let lost = self.trial.objective - self.watchdog.back.objective;
            let sane = self.trial.worst <= ASTRAY * self.watchdog.back.worst.max(1.0)
                && lost <= LOST * promise.gain.max(NEAR);
            if sane && self.watchdog.age < self.watchdog.patience {
                let age = self.watchdog.age + 1;
                let taken = self.accept(1.0, trials);
                self.watchdog.age = age;
                return Some(taken);
            }
        }
        if self.go_back() {
            return Some((0.0, trials));
        }
        if fine && self.corrected(&goal, &mut trials) {
            return Some(self.accept(1.0, trials));
        }
        if let Some(taken) = self.damped(&mut trials) {
            return Some(taken);
        }
        let mut alpha = 0.5;
        while alpha >= SHORTEST {
            trials += 1;
            if self.try_step(alpha) && goal.met(&self.trial, alpha) {
                return Some(self.accept(alpha, trials));
            }
            alpha *= 0.3;
        }
        None
    }

    fn goal(&mut self, promise: &Promise) -> Goal {
        self.merit.update(promise, self.here.defect);
        let nu = self.merit.nu;
        // On trust, less than where it began, by what the first of these steps was to bring.
        let (from, slope) = match self.watchdog.age {
            0 => (&self.here, promise.slope),
            _ => (&self.watchdog.back, self.watchdog.slope),
        };
        let merit = nu.mul_add(from.defect, from.objective);
        let noise = 10.0 * f64::EPSILON * (merit.abs() + from.objective.abs()) + promise.floor;
        Goal { nu, merit, slope: slope - nu * from.defect, noise }
    }

    fn try_step(&mut self, alpha: f64) -> bool {
        self.trial.step(&self.here.xi, alpha, &self.d, &self.bounds);
        self.trial.evaluate(self.nlp, &self.units, &mut self.count).is_ok()
    }

    /// Second-order corrections of the trial point; whether one reaches the goal.
    fn corrected(&mut self, goal: &Goal, trials: &mut usize) -> bool {
        let mut defect = self.trial.defect;
        for _ in 0..CORRECTIONS {
            *trials += 1;
            self.correct();
            if self.trial.evaluate(self.nlp, &self.units, &mut self.count).is_err() {
                return false;
            }
            if goal.met(&self.trial, 1.0) {
                return true;
            }
            if self.trial.defect > 0.5 * defect {
                return false;
            }
            defect = self.trial.defect;
        }
        false
    }

    /// Full steps with more and more damping of the parameters (Levenberg, 1944): in the limit these stay,
    /// and the states go to where the equations want them.
    fn damped(&mut self, trials: &mut usize) -> Option<(f64, usize)> {
        let undamped = self.shift;
        self.correction.0.copy_from_slice(&self.d);
        self.correction.1.copy_from_slice(&self.next_lambda);
        let mut shift = (0.1 * self.damping).max(self.shift).max(LEAST_DAMPING);
        while shift < MOST_DAMPING {
            if !self.kkt.finish(self.active.held(), shift).is_positive() {
                shift *= 10.0;
                continue;
            }
            self.resolve();
            let goal = self.goal(&self.promise());
            *trials += 1;
            if self.try_step(1.0) && goal.met(&self.trial, 1.0) {
                (self.shift, self.damping) = (shift, shift);
                return Some(self.accept(1.0, *trials));
            }
            shift *= 10.0;
        }
        std::mem::swap(&mut self.d, &mut self.correction.0);
        std::mem::swap(&mut self.next_lambda, &mut self.correction.1);
        self.shift = undamped;
        None
    }

    /// Less damping after a step that went well.
    fn relax(&mut self) {
        self.shift *= 0.1;
        if self.shift < FIRST_DAMPING {
            self.shift = 0.0;
        }
    }

    /// Back to where the merit function was lowest; the next step must lower it. Whether there is such a
    /// point.
    pub(super) fn go_back(&mut self) -> bool {
        if self.watchdog.age == 0 {
            return false;
        }
        self.here.copy(&self.watchdog.back);
        self.lambda.copy_from_slice(&self.watchdog.lambda);
        (self.watchdog.age, self.watchdog.strict) = (0, true);
        self.watchdog.patience /= 2;
        true
    }

    /// The same where that point is better than the present one.
    pub(super) fn go_back_if_better(&mut self) {
        let merit = |p: &Point| self.merit.nu.mul_add(p.defect, p.objective);
        if merit(&self.watchdog.back) < merit(&self.here) {
            self.go_back();
        }
    }

    /// From the trial point a step back to the constraints with the same factorisation.
    fn correct(&mut self) {
        self.p.fill(0.0);
        self.q.iter_mut().zip(&self.trial.c).for_each(|(q, c)| *q = -c);
        self.count.solutions += 1;
        let (d, lambda) = (&mut self.correction.0, &mut self.correction.1);
        self.kkt.solve(&self.p, &self.q, d, lambda);
        for (i, x) in self.trial.xi.iter_mut().enumerate() {
            *x = (*x + d[i]).clamp(self.bounds.0[i], self.bounds.1[i]);
        }
    }

    fn accept(&mut self, alpha: f64, trials: usize) -> (f64, usize) {
        std::mem::swap(&mut self.here, &mut self.trial);
        (self.watchdog.age, self.watchdog.strict) = (0, false);
        for (l, next) in self.lambda.iter_mut().zip(&self.next_lambda) {
            *l += alpha * (next - *l);
        }
        (alpha, trials)
    }
}
