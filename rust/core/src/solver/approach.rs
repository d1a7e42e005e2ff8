//! The approach along paths that satisfy the equations.
//!
//! With few samples and states that are not measured, the equations are all that keeps a path in place, and a full step of the
//! parameters tears it: defects of a torn path say nothing of the likelihood, and what lowers them leads anywhere. Here the
//! states are dependent variables. Steps are those of Levenberg and Marquardt in the parameters and free first states, no longer
//! than makes sense ([`crate::nlp::Nlp::longest_step`]) and cut off at bounds; the path is integrated anew after each, and the
//! likelihood there decides (the projection onto the constraints of a generalised reduced-gradient method: Nocedal and
//! Wright, section 15.3). It is single shooting with the linear algebra of collocation.

use super::iterate::Iterate;
use super::iteration::{Control, Iteration};
use super::newton::{Newton, newton_step};
use super::restoration::Restoration;
use super::status::Status;
use super::termination::Ending;
use crate::nlp::NotFinite;

/// Most steps, and most trials of one.
const STEPS: usize = 150;
const TRIALS: usize = 14;
/// The exact Hessian is in use where a step promises less than the first in log-likelihood; below the second, nothing is left.
const NEAR: f64 = 10.0;
const CLOSE: f64 = 1e-4;
/// It ends, too, where so many steps together bring less than this.
const SLOW: (usize, f64) = (20, 1e-3);
/// The shift of the first step, by what it grows and falls, and its limits.
const FIRST: f64 = 1e-2;
const GROWS: f64 = 4.0;
const LEAST: f64 = 1e-9;
const MOST: f64 = 1e10;

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
    ///
    /// # Errors
    /// [`NotFinite`] when there is no step from the first of these.
    pub fn approach(&mut self, watch: &mut dyn FnMut(&Iteration) -> Control) -> Result<Approach, NotFinite> {
        let Newton { program, settings, iterate, step, system, sizes, history, .. } = self;
        let Some(mut restoration) = Restoration::new(program) else { return Ok(Approach::None) };
        let mut trial = iterate.point.clone();
        if !restoration.restore(program, &mut trial.xi) || trial.evaluate(program).is_err() {
            return Ok(match program.stopped() {
                Some(status) => Approach::Ended(status.into()),
                None => Approach::None,
            });
        }
        std::mem::swap(&mut iterate.point, &mut trial);
        settle_noise(program, iterate);
        let longest: Vec<f64> = (0..program.border()).map(|i| program.nlp.longest_step(i)).collect();
        let mut held = vec![false; program.nlp.n()];
        let mut line = Iteration::at(history.last().map_or(0, |l| l.number + 1), &iterate.point, false);
        let (mut shift, mut exact, mut failures) = (FIRST, false, 0);
        let mut values = Vec::with_capacity(STEPS + 1);
        for _ in 0..STEPS {
            values.push(iterate.point.objective);
            if let Some(status) = program.stopped() {
                return Ok(Approach::Ended(status.into()));
            }
            let found = newton_step(program, iterate, system, step, sizes, (exact, false));
            let Ok((mut factored, promise)) = found else { break };
            line.promise = promise.gain;
            history.push(line);
            if watch(&line) == Control::Stop {
                return Ok(Approach::Ended(Status::Interrupted.into()));
            }
            let before = values.len().checked_sub(SLOW.0).map(|k| values[k]);
            let slow = before.is_some_and(|before| before - iterate.point.objective < SLOW.1);
            if promise.gain < CLOSE {
                return Ok(Approach::Taken(true));
            }
            if line.number >= settings.max_iterations {
                return Ok(Approach::Ended(Status::IterationLimit.into()));
            }
            if slow {
                break;
            }
            let near = promise.gain < NEAR;
            let mut taken = false;
            let mut trials = 0;
            while trials < TRIALS && shift < MOST {
                trials += 1;
                let Some(promise) = factored.projected(shift, program, iterate, step, &mut held) else {
                    shift = (GROWS * shift).max(LEAST);
                    continue;
                };
                for (d, most) in step.d.iter_mut().zip(&longest) {
                    *d = d.clamp(-most, *most);
                }
                for (i, x) in trial.xi.iter_mut().enumerate() {
                    *x = program.within(i, iterate.point.xi[i] + step.d[i]);
                }
                let gain = if restoration.restore(program, &mut trial.xi) && trial.evaluate(program).is_ok() {
                    iterate.point.objective - trial.objective
                } else {
                    f64::NEG_INFINITY
                };
                let kept = gain / promise.gain.max(f64::MIN_POSITIVE);
                if gain > 0.0 && (kept > 1e-3 || gain > 1.0) {
                    if kept > 0.5 {
                        shift = (shift / GROWS).max(LEAST);
                    } else if kept < 0.1 {
                        shift = GROWS * shift;
                    }
                    taken = true;
                    break;
                }
                shift = (GROWS * shift).max(LEAST);
            }
            if !taken {
                // The other Hessian may know a way; without one, this is as far as it goes.
                failures += 1;
                if failures > 1 {
                    break;
                }
                exact = !exact;
                shift = FIRST;
                line = Iteration { step: 0.0, trials, shift, ..Iteration::at(line.number + 1, &iterate.point, exact) };
                continue;
            }
            failures = 0;
            exact = near && trials == 1;
            iterate.accept(&mut trial, 1.0, step);
            iterate.update_noise(program, 1.0);
            line = Iteration { step: 1.0, trials, shift, ..Iteration::at(line.number + 1, &iterate.point, exact) };
        }
        Ok(Approach::Taken(false))
    }
}

/// Sets standard deviations from the residuals of the first path, however far they are.
fn settle_noise(program: &super::program::Program<'_>, iterate: &mut Iterate) {
    for _ in 0..8 {
        if iterate.update_noise(program, 1.0) {
            break;
        }
    }
}
