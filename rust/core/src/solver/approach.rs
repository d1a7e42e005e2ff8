//! The approach along paths that satisfy the equations.
//!
//! With few samples and states that are not measured, the equations are all that keeps a path in place, and a full step of the
//! parameters tears it: defects of a torn path say nothing of the likelihood, and what lowers them leads anywhere. Here the
//! states are dependent variables. A step is that of a trust region in the parameters and free initial states, in units of steps
//! that make sense ([`crate::nlp::Nlp::longest_step`]); the path is integrated anew after each, and the likelihood there
//! decides (the projection onto the constraints of a generalised reduced-gradient method: Nocedal and Wright,
//! sections 4.1 and 15.3). It is single shooting with the equations of collocation.

use super::iterate::Iterate;
use super::iteration::{Control, Iteration};
use super::newton::Newton;
use super::program::Program;
use super::reduced::Reduced;
use super::restoration::Restoration;
use super::status::Status;
use super::termination::Ending;

/// The exact Hessian is in use where a step promises less than the first in log-likelihood; below the second, nothing is left.
const NEAR: f64 = 10.0;
const CLOSE: f64 = 1e-5;
/// It ends, too, where so many steps together bring less than this.
const SLOW: (usize, f64) = (25, 5e-3);
/// Standard deviations that start at the spread of the measurements are profiled once a step promises less than this.
const SETTLED: f64 = 0.1;
/// Radius of the first step, in units of sizes of variables; its limits.
const FIRST: f64 = 1.0;
const LEAST: f64 = 1e-7;
const MOST: f64 = 4.0;
/// Parts of its promise that a step must keep: to be taken, not to shrink the radius, and to let it grow.
const TAKEN: f64 = 1e-3;
const POOR: f64 = 0.25;
const GOOD: f64 = 0.75;

/// How an approach went.
pub(crate) enum Approach {
    /// There is no path that satisfies the equations from this start, or the program has none.
    None,
    /// The iterate satisfies the equations; whether it is next to an optimum.
    Taken(bool),
    /// The run was stopped.
    Ended(Ending),
}

impl Newton<'_> {
    /// Goes towards an optimum along paths that satisfy the equations.
    pub fn approach(&mut self, watch: &mut dyn FnMut(&Iteration) -> Control) -> Approach {
        let Newton { program, settings, iterate, step, history, .. } = self;
        let Some(mut restoration) = Restoration::new(program) else { return Approach::None };
        let mut trial = iterate.point.clone();
        if !restoration.restore(program, &mut trial.xi) || trial.evaluate(program).is_err() {
            return program.stopped().map_or(Approach::None, |status| Approach::Ended(status.into()));
        }
        let Some(mut reduced) = Reduced::new(program, &restoration, &trial.xi) else { return Approach::None };
        std::mem::swap(&mut iterate.point, &mut trial);
        // With standard deviations as they start, the spreads of the measurements, one output does not outweigh the others.
        let mut released = program.nlp.profiled().is_empty();
        let mut line = Iteration::at(history.last().map_or(0, |l| l.number + 1), &iterate.point, false);
        let (mut radius, mut exact, mut values) = (FIRST, false, Vec::new());
        loop {
            values.push(iterate.point.objective);
            let defined = reduced.evaluate(program, &mut restoration, iterate, exact);
            if let Some(status) = program.stopped() {
                return Approach::Ended(status.into());
            }
            if !defined {
                return Approach::Taken(false);
            }
            let base = iterate.point.xi.clone();
            let promise = reduced.step(program, &base, MOST).promise;
            line.promise = promise;
            history.push(line);
            if watch(&line) == Control::Stop {
                return Approach::Ended(Status::Interrupted.into());
            }
            let before = values.len().checked_sub(SLOW.0 + 1).map(|k| values[k]);
            let slow = before.is_some_and(|before| before - iterate.point.objective < SLOW.1);
            if !released && (promise < SETTLED || slow) {
                released = true;
                settle_noise(program, iterate);
                (radius, exact) = (FIRST, false);
                values.clear();
                line = Iteration::at(line.number + 1, &iterate.point, exact);
                continue;
            }
            if promise < CLOSE {
                return Approach::Taken(true);
            }
            if line.number >= settings.max_iterations {
                return Approach::Ended(Status::IterationLimit.into());
            }
            if slow {
                return Approach::Taken(false);
            }
            let mut trials = 0;
            let kept = loop {
                trials += 1;
                let found = reduced.step(program, &base, radius);
                // The tangent predicts the path.
                trial.xi.copy_from_slice(&base);
                reduced.move_along(&found.d, &mut trial.xi);
                let kept = if restoration.restore(program, &mut trial.xi) && trial.evaluate(program).is_ok() {
                    (iterate.point.objective - trial.objective) / found.promise.max(f64::MIN_POSITIVE)
                } else {
                    f64::NEG_INFINITY
                };
                if kept < POOR {
                    radius = 0.3 * found.length.min(radius);
                } else if kept > GOOD && found.length > 0.9 * radius {
                    radius = (2.0 * radius).min(MOST);
                }
                if kept > TAKEN || radius < LEAST || program.stopped().is_some() {
                    break kept;
                }
            };
            if kept > TAKEN {
                iterate.accept(&mut trial, 0.0, step);
                if released {
                    iterate.update_noise(program, 1.0);
                }
                exact = promise < NEAR && (exact || kept > POOR) || kept < POOR && !exact;
            } else if exact {
                // The other Hessian may know a way.
                (exact, radius) = (false, FIRST);
            } else if !released && program.stopped().is_none() {
                released = true;
                settle_noise(program, iterate);
                radius = FIRST;
            } else {
                return program.stopped().map_or(Approach::Taken(false), |s| Approach::Ended(s.into()));
            }
            let next = Iteration::at(line.number + 1, &iterate.point, exact);
            line = Iteration { step: f64::from(u8::from(kept > TAKEN)), trials, ..next };
        }
    }
}

/// Sets standard deviations from the residuals of the first path, however far they are.
fn settle_noise(program: &Program<'_>, iterate: &mut Iterate) {
    for _ in 0..8 {
        if iterate.evaluate(program).is_err() || iterate.update_noise(program, 1.0) {
            break;
        }
    }
}
