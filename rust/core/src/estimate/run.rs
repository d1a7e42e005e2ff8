//! From the start of an estimation to its fit.

use std::time::Duration;

use super::outside::Beginning;
use super::{Estimation, Fit, Problem};
use crate::error::Error;
use crate::initial::{Initial, solve};
use crate::interrupt::{Cause, Interrupt, current};
use crate::model::Scaling;
use crate::solver::{Control, Iteration, Settings, Solution, Status};

pub(super) type Watch<'w> = dyn FnMut(&Iteration) -> Control + 'w;

/// Standard errors may take so long beyond the time limit, and this part of it.
const GRACE: Duration = Duration::from_millis(15);
const GRACE_PART: f64 = 0.03;
/// They take about as long as this part of an iteration.
const OF_AN_ITERATION: f64 = 0.5;
/// With fewer measured values for each parameter, data do not keep the path of states that are not measured in place.
const FEW: usize = 20;
/// Iterations over kinks that may be smoothed instead.
const ROUGH: usize = 60;

impl Estimation<'_> {
    /// Solves the problem. Not to converge is a status of the fit, no error.
    ///
    /// # Errors
    /// For what cannot be right in the model, the data or an option, and for a model that is not finite
    /// at the start.
    pub fn solve(&self) -> Result<Fit, Error> {
        self.solve_with(|_| Control::Continue)
    }

    /// As [`Estimation::solve`]; `watch` sees each iteration and may end the run.
    ///
    /// # Errors
    /// As [`Estimation::solve`].
    pub fn solve_with(&self, mut watch: impl FnMut(&Iteration) -> Control) -> Result<Fit, Error> {
        self.solver.check()?;
        let within = Estimation { outside: current(), ..self.clone() };
        // All passes share the time.
        Interrupt::within(self.solver.time_limit).run(|| {
            let mut fit = within.solve_all(&mut watch)?;
            within.solve_to_a_solution(&mut fit, &mut watch)?;
            within.compare_with_integration(&mut fit);
            within.refine_along_the_motion(&mut fit, &mut watch)?;
            within.warn_of_coarse_mesh(&mut fit);
            within.compare_with_halves(&mut fit)?;
            Self::believe_no_end_without_solution(&mut fit);
            Self::deny_no_solution(&mut fit);
            Ok(fit)
        })
    }

    /// The fit, made again where it ended for a reason that another way to it may mend.
    pub(super) fn solve_all(&self, watch: &mut Watch<'_>) -> Result<Fit, Error> {
        if let Some(fit) = self.smoothed_as_before(watch)? {
            return Ok(fit);
        }
        let few = self.asks_for_few_iterations();
        let known = self.earlier.as_ref().is_some_and(|e| e.smoothed.is_some());
        let again = !(few && known); // smoothing from the first width on takes many
        let mut fit = self.roughly().solve_refined(watch)?;
        if self.other_ways {
            fit = self.or_otherwise(fit, watch)?;
        }
        if self.smooth_kinks && again && !current().stops() && fit.kinks_matter(self.experiments) {
            fit = self.smoothed(fit, watch)?;
            if fit.status == Status::IterationLimit && fit.iterations < self.solver.max_iterations {
                fit = self.clone().going_on_from(&fit).solve_refined(watch)?;
            }
        }
        let few = fit.status == Status::IterationLimit && fit.iterations < self.solver.max_iterations;
        if few && current().cause() == Some(Cause::TimeLimit) {
            // The limit on the iterations was that of the rough fit: what kept it from going on was the time.
            fit.end_as(Status::TimeLimit);
        }
        if self.outside.cause() == Some(Cause::Stopped) && fit.status != Status::Interrupted {
            // Whoever called is to know.
            fit.end_as(Status::Interrupted);
        }
        Ok(fit)
    }

    /// Returns the estimation with few iterations where kinks can be smoothed: a fit that has not converged by then goes back and
    /// forth over them.
    fn roughly(&self) -> Self {
        let mut rough = self.clone();
        if self.smooths() {
            rough.solver.max_iterations = rough.solver.max_iterations.min(ROUGH);
        }
        rough
    }

    /// Returns whether fewer iterations are asked for than usual: then nothing else is tried that takes more.
    pub(super) fn asks_for_few_iterations(&self) -> bool {
        self.solver.max_iterations < Settings::default().max_iterations
    }

    /// Returns whether the model has kinks that are smoothed where they matter.
    pub(super) fn smooths(&self) -> bool {
        self.smooth_kinks && self.transcription.is_collocation() && !self.model.kinks().is_empty()
    }

    /// The fit with the kinks of the model as they are, on a mesh that is refined where that was asked for.
    pub(super) fn solve_refined(&self, watch: &mut Watch<'_>) -> Result<Fit, Error> {
        match self.refine {
            Some(tolerance) if self.transcription.is_collocation() => {
                self.solve_by_refinement(tolerance, watch)
            }
            _ => self.solve_on_mesh(watch),
        }
    }

    /// The fit on the mesh that was asked for, or on one that follows the motion.
    pub(super) fn solve_on_mesh(&self, watch: &mut Watch<'_>) -> Result<Fit, Error> {
        if self.follows_motion() {
            self.checked_noise()?;
            if let Some(fit) = self.search_at_measurements(watch)? {
                return Ok(fit);
            }
        }
        self.solve_passes(watch)
    }

    /// The fit on a given mesh.
    pub(super) fn solve_passes(&self, watch: &mut Watch<'_>) -> Result<Fit, Error> {
        if self.model.delays.is_empty() { self.solve_now(watch) } else { self.solve_with_delays(watch) }
    }

    /// The estimate of a model in which nothing is late.
    pub(super) fn solve_now(&self, watch: &mut Watch<'_>) -> Result<Fit, Error> {
        self.model.check()?;
        let parameters = self.parameters()?;
        let scalings = if current().stops() { Vec::new() } else { self.model.scalings(&parameters)? };
        if scalings.is_empty() {
            return self.solve_scaled(&[], watch);
        }
        // A scale that no output can tell would let the solver drift without end.
        let mut model = self.model.clone();
        for p in &mut model.parameters {
            if let Some(scaling) = scalings.iter().find(|s| s.held == p.name) {
                (p.start, p.fixed) = (scaling.at, true);
            }
        }
        let is_held = |name: &str| scalings.iter().any(|s| s.holds(name));
        let start = self.start.iter().filter(|s| !is_held(&s.0)).cloned().collect();
        let fit = Estimation { model: &model, start, ..self.clone() }.solve_scaled(&scalings, watch)?;
        Ok(Fit { model: self.model.clone(), ..fit })
    }

    /// The same with these scalings held.
    fn solve_scaled(&self, scalings: &[Scaling], watch: &mut Watch<'_>) -> Result<Fit, Error> {
        let noise = self.checked_noise()?;
        let problem =
            self.transcription.pose(self.model, self.experiments, noise, self.noise.per_experiment)?;
        let posed = problem.transcribed();
        let xi = self.starting_point(posed)?;
        let further = match self.earlier {
            Some(_) => Vec::new(),
            None => self.given().elsewhere(posed, &xi, &self.parameters()?),
        };
        if !further.is_empty() && !self.transcription.is_collocation() {
            // A path that follows the measurements is found by collocation; an integration from poor values is none.
            let solver = Settings { time_limit: self.solver.time_limit, ..Settings::default() };
            let first = Estimation {
                transcription: self.transcription.collocation().into(),
                solver,
                own_solver: None,
                regression: None,
                paths: None,
                ..self.clone()
            };
            let first = first.solve_scaled(scalings, watch)?;
            if first.status.is_end() {
                let from = Estimation { start: Vec::new(), ..self.clone() }.start_from(&first);
                let mut fit = from.solve_scaled(scalings, watch)?;
                fit.iterations += first.iterations;
                fit.solution.time += first.solution.time;
                return Ok(fit);
            }
        }
        let solution = if further.is_empty() {
            self.solve_from(&problem, &xi, self.transcription.is_collocation() && self.states_known(), watch)?
        } else {
            self.best_of(&problem, &further, watch)?
        };
        let limit = self.time_for_errors(&solution);
        let transcription = self.transcription.clone();
        let fit = Fit::new(self.model, self.experiments, posed, solution, scalings, (transcription, &limit));
        Ok(Fit { noise: self.noise.clone(), ..fit })
    }

    /// The limit of the standard errors, which would not come to an end where little time is left.
    fn time_for_errors(&self, solution: &Solution) -> Interrupt {
        let limit = self.solver.time_limit.unwrap_or_default();
        let left = current().left().map(|left| left + GRACE.max(limit.mul_f64(GRACE_PART)));
        let needed = solution.time.mul_f64(OF_AN_ITERATION / solution.iterations.max(1) as f64);
        let left =
            left.map(|left| if solution.iterations > 0 && left < needed { Duration::ZERO } else { left });
        let interrupted = solution.status == Status::Interrupted && self.outside.stops();
        let outside = if interrupted { &self.afterwards } else { &self.outside };
        outside.run(|| Interrupt::within(left))
    }

    fn solve_from(
        &self,
        problem: &Problem,
        xi: &[f64],
        known: bool,
        watch: &mut Watch<'_>,
    ) -> Result<Solution, Error> {
        let posed = problem.transcribed();
        let multipliers = self.multipliers(posed);
        let near = self.earlier.as_ref().is_some_and(|e| e.near);
        let sparse =
            !known && self.transcription.is_collocation() && self.few_samples() && !self.states_known();
        let found = match self.own_solver {
            Some(solver) => {
                let stopped = || Solution::without_a_run(posed, xi, multipliers.map(|m| &m.constraints[..]));
                if let Some(solution) = stopped() {
                    return Ok(solution);
                }
                let max_iterations = self.solver.max_iterations;
                let known = known && self.regression != Some(false);
                let from = Beginning { xi, multipliers, known, near, sparse, max_iterations };
                solver.solve(problem, &from, watch).or_else(|e| stopped().ok_or(e))
            }
            None => {
                let regression = self.regression.unwrap_or(known);
                let paths = self.paths.unwrap_or(sparse) && !regression;
                let initial = match (regression, near) {
                    _ if multipliers.is_some() => Initial::Start,
                    (false, _) if paths => Initial::Paths,
                    (regression, true) => Initial::Nearby { regression },
                    (false, _) => Initial::Start,
                    (true, false) => Initial::Places,
                };
                let multipliers = multipliers.map(|m| &m.constraints[..]);
                solve(posed, xi, multipliers, initial, &self.solver, watch)
            }
        };
        found.map_err(|_| {
            let what = posed.explain(xi);
            let what = what.unwrap_or_else(|| "a function of the model is not finite".into());
            Error::evaluation(format!("at the starting point, {what}; give other start values, or bounds"))
        })
    }

    /// Whether there are few measured values for the parameters of the model.
    pub(super) fn few_samples(&self) -> bool {
        let free = self.model.parameters.iter().filter(|p| !p.fixed).count();
        let values = self.experiments.iter().flat_map(|e| e.outputs.iter().flatten());
        values.filter(|z| z.is_finite()).count() <= FEW * free
    }

    /// The best of the solutions from several points: at an end if possible, and of the greatest likelihood. Where none of
    /// them is at an end, a regression on the initial paths of the states goes before each.
    fn best_of(
        &self,
        problem: &Problem,
        starts: &[Vec<f64>],
        watch: &mut Watch<'_>,
    ) -> Result<Solution, Error> {
        let (mut best, mut iterations, mut time): (Option<Solution>, _, _) = (None, 0, Duration::ZERO);
        let mut error = None;
        for regression in [false, true] {
            for xi in starts {
                let found = match self.solve_from(problem, xi, regression, watch) {
                    Ok(found) => found,
                    Err(e) => {
                        error = Some(e);
                        continue;
                    }
                };
                iterations += found.iterations;
                time += found.time;
                let (status, message) = (found.status, found.message.clone());
                let rank = |s: &Solution| (!s.status.is_end(), s.objective);
                if best.as_ref().is_none_or(|b| rank(&found) < rank(b)) {
                    best = Some(found);
                }
                if let Some(best) = best.as_mut().filter(|_| status == Status::Interrupted) {
                    (best.status, best.message) = (status, message);
                    break;
                }
            }
            if best.as_ref().is_some_and(|b| b.status.is_end() || b.status == Status::Interrupted) {
                break;
            }
        }
        let Some(best) = best else { return Err(error.expect("without a solution there was an error")) };
        Ok(Solution { iterations, time, ..best })
    }
}
