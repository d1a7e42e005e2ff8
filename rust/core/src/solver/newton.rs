//! The loop.

use std::time::Instant;

use super::NEAR;
use super::iterate::Iterate;
use super::iteration::{Control, Iteration};
use super::line_search::LineSearch;
use super::newton_system::{Factored, NewtonSystem, NoStep};
use super::point::Point;
use super::program::Program;
use super::promise::Promise;
use super::settings::Settings;
use super::solution::Solution;
use super::status::Status;
use super::step::Step;
use super::termination::{Ending, Sizes};
use crate::nlp::NotFinite;

/// A run of Newton's method. Everything that the loop keeps is allocated once.
pub(crate) struct Newton<'a> {
    pub(super) program: Program<'a>,
    pub(super) settings: Settings,
    pub(super) iterate: Iterate,
    pub(super) step: Step,
    pub(super) system: NewtonSystem,
    search: LineSearch,
    sizes: Sizes,
    /// Whether the exact Hessian is in use.
    exact: bool,
    began: Instant,
    pub(super) history: Vec<Iteration>,
}

impl<'a> Newton<'a> {
    /// From a point of the program that is evaluated.
    pub fn new(
        program: Program<'a>,
        point: Point,
        multipliers: Option<&[f64]>,
        settings: &Settings,
    ) -> Newton<'a> {
        Newton {
            step: Step::new(&program),
            system: NewtonSystem::new(&program, &settings.kkt),
            search: LineSearch::new(&program, &point),
            sizes: Sizes::new(&program, &point.xi),
            exact: !settings.gauss_newton || multipliers.is_some(),
            began: Instant::now(),
            history: Vec::with_capacity(settings.max_iterations.min(1000) + 1),
            iterate: Iterate::new(&program, point, multipliers),
            settings: settings.clone(),
            program,
        }
    }

    /// Goes on counting where another run ended.
    pub fn take_over(&mut self, other: &mut Newton<'_>) {
        self.began = other.began;
        self.program.count_from(other.program.evaluations());
        self.history = std::mem::take(&mut other.history);
    }

    pub fn program(&self) -> &Program<'a> {
        &self.program
    }

    pub fn point(&self) -> &Point {
        &self.iterate.point
    }

    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Sets the most iterations, counted from the first of all runs.
    pub fn limit_iterations(&mut self, most: usize) {
        self.settings.max_iterations = most;
    }

    /// Whether the last step that was computed promises little.
    pub fn is_near(&self) -> bool {
        self.history.last().is_some_and(|line| line.promise < NEAR)
    }

    /// Number of the last iteration.
    pub fn iterations(&self) -> usize {
        self.history.last().map_or(0, |line| line.number)
    }

    /// Iterates until there is an end.
    ///
    /// # Errors
    /// [`NotFinite`] when there is no step from the start.
    pub fn minimise(&mut self, watch: &mut dyn FnMut(&Iteration) -> Control) -> Result<Ending, NotFinite> {
        let Newton { program, settings, iterate, step, system, search, sizes, exact, history, .. } = self;
        if let Some(status) = program.stopped() {
            return Ok(status.into());
        }
        let first = history.last().map_or(0, |line| line.number + 1);
        let mut line = Iteration::at(first, &iterate.point, *exact);
        let mut last_gain = f64::INFINITY;
        loop {
            // Evaluate, factorise, step.
            let mut found = newton_step(program, iterate, system, step, sizes, (*exact, search.on_trust()));
            // Steps on trust may lead where nothing is finite any more.
            if found.is_err() && search.go_back(iterate) {
                found = newton_step(program, iterate, system, step, sizes, (*exact, false));
            }
            if let Ok((factored, promise)) = &mut found
                && factored.is_damped()
                && promise.gain < NEAR
            {
                // Small for the damping alone?
                found = match factored.relieve() {
                    Ok(true) => {
                        *promise = factored.step(program, iterate, step);
                        found
                    }
                    Ok(false) => {
                        let effort = (*exact, search.on_trust());
                        newton_step(program, iterate, system, step, sizes, effort)
                    }
                    Err(reason) => Err(reason),
                };
            }
            line.promise = found.as_ref().map_or(f64::INFINITY, |(_, promise)| promise.gain);
            if let Some(status) = program.stopped() {
                line.promise = f64::INFINITY;
                history.push(line);
                return Ok(status.into());
            }
            // At the start that is an error.
            if history.is_empty() && matches!(found, Err(NoStep::NotFinite | NoStep::NotPositive)) {
                return Err(NotFinite);
            }
            history.push(line);
            if watch(&line) == Control::Stop {
                return Ok(Status::Interrupted.into());
            }
            let (mut factored, promise) = match found {
                Ok(found) => found,
                Err(reason) => return Ok(Ending::without_step(reason, program, &iterate.point.xi)),
            };
            // Below the floor only rounding keeps the promise up: it no longer falls from step to step.
            let was_exact = *exact;
            let spent = promise.gain <= promise.floor && promise.gain > 0.1 * last_gain;
            let done = promise.gain <= settings.tolerance.powi(2) || spent;
            last_gain = if was_exact { promise.gain } else { f64::INFINITY };
            if done && was_exact {
                search.take_last(program, iterate, step);
                return Ok(Ending::at_optimum(program, &mut factored));
            }
            if line.number >= settings.max_iterations {
                return Ok(Status::IterationLimit.into());
            }
            if let Some(ending) = Ending::stalled(history, &iterate.point) {
                return Ok(ending);
            }
            if promise.gain < NEAR
                && let Some(ending) = sizes.crawling(history, program, &iterate.point, step)
            {
                return Ok(ending);
            }
            // Search.
            let taken = search.search(program, &mut factored, iterate, step, &promise);
            if taken.is_none() {
                if let Some(status) = program.stopped() {
                    return Ok(status.into());
                }
                let phase = settings.gauss_newton.then_some(&mut *exact);
                // With standard deviations that are too large all that a step promises is small.
                let settling = !was_exact && promise.is_small() && !iterate.update_noise(program, 1.0);
                if !settling && let Some(ending) = stuck(program, iterate, &mut factored, &promise, phase) {
                    return Ok(ending);
                }
            }
            let (alpha, trials) = taken.unwrap_or((0.0, 0));
            let shift = factored.damping.shift();
            // Update the noise.
            if !was_exact && alpha > 0.0 {
                let settled = iterate.update_noise(program, alpha);
                *exact = promise.gain < NEAR && alpha == 1.0 && settled;
            }
            // Check. Grown on trust only? Then back, to smaller steps.
            if let Some(ending) = sizes.diverging(program, &iterate.point)
                && !search.go_back(iterate)
            {
                return Ok(ending);
            }
            let next = Iteration::at(line.number + 1, &iterate.point, was_exact);
            line = Iteration { step: alpha, trials, shift, ..next };
        }
    }

    /// Takes the full step of the exact Hessian and returns true, where the iterate is so near the solution that the step is not
    /// longer than this, dᵀHd: a distance in standard errors, squared. Else the step is left to [`Newton::minimise`], which
    /// finds the system factorised.
    pub fn step_if_near(&mut self, most: f64) -> bool {
        let Newton { program, iterate, step, system, search, sizes, .. } = self;
        let found = newton_step(program, iterate, system, step, sizes, (true, false));
        let near = found.is_ok_and(|(factored, p)| !factored.is_damped() && p.curvature.abs() <= most);
        near && search.take_full(program, iterate, step)
    }

    /// The point to end at, and what is to be told of it.
    pub fn finish(mut self, ending: Ending) -> Solution {
        let status = ending.status;
        if status.unfinished() || status == Status::Acceptable {
            // The best point so far, not the last that was tried on trust.
            self.search.go_back_if_better(&mut self.iterate);
        }
        let Iterate { point, multipliers, .. } = self.iterate;
        Solution {
            iterations: self.history.last().map_or(0, |l| l.number),
            flops: self.system.flops(),
            message: ending.message(&self.program, &point),
            kkt: self.settings.kkt.with_made(self.system.into_kkt()),
            xi: point.xi,
            multipliers,
            bound_multipliers: None,
            status,
            objective: point.objective,
            defect: point.worst,
            evaluations: self.program.evaluations(),
            time: self.began.elapsed(),
            units: self.program.units.states,
            history: self.history,
        }
    }
}

/// Derivatives at the iterate, the Newton system there, and its solution. `effort` says whether the Hessian is to be
/// exact, and whether a costly system need not be factorised.
fn newton_step<'s>(
    program: &Program<'_>,
    iterate: &mut Iterate,
    system: &'s mut NewtonSystem,
    step: &mut Step,
    sizes: &mut Sizes,
    (exact, hurry): (bool, bool),
) -> Result<(Factored<'s>, Promise), NoStep> {
    let mut factored = system.factorise(program, iterate, exact, hurry)?;
    sizes.measure(program, iterate);
    let promise = factored.step(program, iterate, step);
    Ok((factored, promise))
}

/// No step helped: try a shorter, safer direction; the end when these are spent. `phase` says whether the exact Hessian
/// is in use, where that may change.
fn stuck(
    program: &Program<'_>,
    iterate: &Iterate,
    system: &mut Factored<'_>,
    promise: &Promise,
    phase: Option<&mut bool>,
) -> Option<Ending> {
    if promise.is_small() {
        let regular = system.damping.shift() == 0.0;
        return Some(if regular { Status::Acceptable.into() } else { Ending::at_optimum(program, system) });
    }
    if let Some(exact) = phase
        && *exact
    {
        *exact = false;
        return None;
    }
    if system.damping.raise(1e-4) {
        return None;
    }
    Some(Ending::without_progress(&iterate.point))
}
