//! Restarts from other parameters: where samples are few, the likelihood has many maxima.

use std::time::Duration;

use super::Estimation;
use super::accuracy::{Accuracy, FINAL, SEARCH};
use super::draws::Draws;
use super::fit::Fit;
use super::injection::Injection;
use super::motion::{FAR, Values};
use super::run::Watch;
use super::search::Search;
use crate::error::Error;
use crate::interrupt::{Cause, current};
use crate::simulate::Method;
use crate::solver::{Settings, Status};

/// Restarts in a row that bring no more than this in log-likelihood, before two for each parameter are added; fewer where so many
/// in a row from parameters of which some are drawn anew end at the same optimum, which then is hardly one of many; and so many
/// times as many where an output is matched worse than by a constant, which hardly is the best that there is.
const RESTARTS: usize = 20;
const RETURNS: usize = 8;
const UNEXPLAINED: usize = 3;
/// Restarts in a row without a gain after which output injection is tried.
const BEFORE_INJECTION: usize = 20;
const GAIN: f64 = 1e-3;
/// Ends of runs that differ by less than this are the same optimum.
const SAME: f64 = 0.1;
/// Most draws for parameters at which the model can be simulated, and its outputs are others.
const DRAWS: usize = 30;
/// Limits how often a run goes on from an end that lacks iterations.
const FURTHER: usize = 2;

impl Estimation<'_> {
    /// Returns the best end of a run from the starting values and of so many restarts from other parameters, on meshes that
    /// follow the motion.
    ///
    /// It is an iterated local search (Lourenço, Martin and Stützle 2003): a restart begins at the best end so far, with some
    /// of the parameters drawn anew. It ends after so many restarts in a row without a gain: by default twenty, and two for
    /// each parameter, or fewer that all return to the best end ([`Self::enough`]). Where the model cannot be
    /// simulated at the starting values, parameters are sought where it can. Where the best end leaves much of a densely
    /// sampled output unexplained, a path of estimates with output injection is tried once, and restarts go on from its end.
    /// None where there are no parameters at which the model can be simulated.
    pub(super) fn search_restarts(&self, watch: &mut Watch<'_>) -> Result<Option<Fit>, Error> {
        let parameters = &self.model.parameters;
        let values: Values = parameters.iter().map(|p| p.name.clone()).zip(self.parameters()?).collect();
        let any = parameters.iter().any(|p| !p.fixed && !p.local);
        let restarts = if any && !self.goes_on() { self.most_restarts() } else { 0 };
        let Some(mut search) = self.search_from(&values, restarts > 0, watch)? else { return Ok(None) };
        let mut injection = if restarts > 0 { self.injection() } else { None };
        loop {
            let (most, returns) = self.enough(restarts, &search.fit);
            let goes_on = search.without < most && search.returns < returns;
            if search.is_stopped() || !goes_on && injection.is_none() {
                break;
            }
            // Not before: a search that still gains has not failed.
            let is_due = injection.is_some() && (!goes_on || search.without >= BEFORE_INJECTION);
            if !is_due {
                self.restart(&mut search, watch)?;
                continue;
            }
            let unexplained = |injection: &Injection| injection.may_improve(&search.fit);
            if let Some(injection) = injection.take().filter(unexplained) {
                self.follow_injection(&injection, &mut search, watch)?;
            }
        }
        let cut = search.is_stopped();
        let Search { mut fit, likelihood, mut iterations, mut time, without, again, .. } = search;
        if cut && restarts > 0 {
            if fit.status == Status::IterationLimit && current().cause() == Some(Cause::TimeLimit) {
                fit.end_as(Status::TimeLimit); // with more time the best end would have been finished
            }
            fit.message = format!(
                "{}; the search for better optima was cut after {without} restarts without a gain: there may be better ones",
                fit.message
            );
        }
        if !self.goes_on() && !fit.status.was_stopped() && !current().stops() {
            let last = self.along_the_motion(&fit.values(), f64::NEG_INFINITY, FINAL, watch)?;
            // On a finer mesh a run may lose its way, too.
            let sound =
                |last: &Fit| last.status != Status::TimeLimit && self.likelihood(last) > likelihood - SAME;
            if let Some(last) = last.filter(sound) {
                iterations += last.iterations;
                time += last.solution.time;
                fit = last;
            }
        }
        if !cut && !self.asks_for_few_iterations() {
            self.finish(&mut fit, (&mut iterations, &mut time), watch)?;
        }
        if restarts > 0 && again == 0 && fit.feasible && !cut {
            fit.warnings.push(format!(
                "none of the last {without} restarts ended at this optimum again: there may be better ones, which \
                 a search from many starts may find (`multistart`)"
            ));
        }
        (fit.iterations, fit.solution.time) = (iterations, time);
        Ok(Some(fit))
    }

    /// Goes on from an end that lacks iterations, with as many as all runs had so far, and once more as many as those: along a
    /// narrow curved ridge a run takes thousands. `effort`: the iterations and the time so far.
    fn finish(
        &self,
        fit: &mut Fit,
        effort: (&mut usize, &mut Duration),
        watch: &mut Watch<'_>,
    ) -> Result<(), Error> {
        let (iterations, time) = effort;
        for _ in 0..FURTHER {
            if fit.status != Status::IterationLimit || !fit.feasible || current().stops() {
                break;
            }
            let max_iterations = self.solver.max_iterations.max(*iterations);
            let solver = Settings { max_iterations, ..self.solver.clone() };
            let further = Estimation { solver, ..self.clone() };
            let Some(found) = further.along_the_motion(&fit.values(), f64::NEG_INFINITY, FINAL, watch)?
            else {
                break;
            };
            *iterations += found.iterations;
            *time += found.solution.time;
            let gain = self.likelihood(&found) - self.likelihood(fit);
            if gain.is_nan() || gain < -SAME {
                break;
            }
            *fit = found;
            if gain < GAIN {
                break;
            }
        }
        Ok(())
    }

    /// Returns how many restarts in a row without a gain end a search.
    pub(super) fn most_restarts(&self) -> usize {
        let free = self.model.parameters.iter().filter(|p| !p.fixed && !p.local).count();
        self.restarts.unwrap_or(RESTARTS + 2 * free)
    }

    /// Returns a search that begins with a run from these values, or `elsewhere` where the model cannot be simulated there;
    /// none where it cannot be simulated.
    pub(super) fn search_from(
        &self,
        values: &Values,
        elsewhere: bool,
        watch: &mut Watch<'_>,
    ) -> Result<Option<Search<'_>>, Error> {
        let parameters = &self.model.parameters;
        let mut draws = Draws::new(parameters, values);
        let mut found = self.along_the_motion(values, f64::NEG_INFINITY, self.accuracy(), watch)?;
        for number in 0..if elsewhere { DRAWS } else { 0 } {
            if found.is_some() || current().stops() {
                break;
            }
            let others = draws.others(number, values, &|_| false);
            found = self.along_the_motion(&others, f64::NEG_INFINITY, self.accuracy(), watch)?;
        }
        Ok(found.map(|fit| Search {
            likelihood: self.likelihood(&fit),
            iterations: fit.iterations,
            time: fit.solution.time,
            without: 0,
            again: 0,
            returns: 0,
            values: values.clone(),
            draws,
            fit,
        }))
    }

    /// Runs a search on from other parameters, once.
    pub(super) fn restart(&self, search: &mut Search<'_>, watch: &mut Watch<'_>) -> Result<(), Error> {
        let accuracy = self.accuracy();
        let fit = &search.fit;
        let at = search.best();
        // Of which the data say nothing at this end, or no more than how large they are.
        let undetermined = |name: &str| {
            fit.parameter(name).is_some_and(|e| e.std_error.is_nan() || e.std_error >= e.value.abs())
        };
        let mut others = at.clone();
        for _ in 0..DRAWS {
            others = search.draws.others(search.without, &at, &undetermined);
            // What changes nothing leads back.
            let runs = self.simulated(&others, accuracy.tolerance);
            if current().stops() || runs.is_some_and(|runs| !fit.suits(&runs)) {
                break;
            }
        }
        // All parameters moved a little lead back from any optimum, and say nothing of others.
        let counts = !Draws::moves(search.without);
        search.without += 1;
        let before = std::mem::take(&mut search.returns);
        let Some(other) = self.along_the_motion(&others, search.likelihood, accuracy, watch)? else {
            return Ok(());
        };
        search.iterations += other.iterations;
        search.time += other.solution.time;
        let reached = self.likelihood(&other);
        if other.status == Status::Interrupted && reached <= search.likelihood {
            (search.fit.status, search.fit.message) = (other.status, other.message);
            return Ok(());
        }
        if reached > search.likelihood + GAIN {
            search.again = usize::from(reached - search.likelihood < SAME);
            (search.fit, search.likelihood, search.without) = (other, reached, 0);
        } else {
            let same = reached > search.likelihood - SAME;
            search.again += usize::from(same);
            search.returns = if same { before + usize::from(counts) } else { 0 };
        }
        Ok(())
    }

    /// Returns how many restarts in a row without a gain finish a search, and how many that return to this end. Where the model
    /// matches an output worse than a constant, it goes on for longer, and no number of returns does: a part of the model that has no
    /// influence there makes the optimum wide, and restarts return for that alone.
    fn enough(&self, restarts: usize, fit: &Fit) -> (usize, usize) {
        if self.restarts.is_some() {
            return (restarts, usize::MAX);
        }
        let unexplained = |c: usize| fit.r_squared(c).is_some_and(|r| r < 0.0);
        let any = (0..self.model.outputs.len()).any(unexplained);
        if any { (UNEXPLAINED * restarts, usize::MAX) } else { (restarts, RETURNS) }
    }

    fn accuracy(&self) -> Accuracy {
        if self.goes_on() { FINAL } else { SEARCH }
    }

    /// Whether it goes on from where a fit ended.
    pub(super) fn goes_on(&self) -> bool {
        self.earlier.as_ref().is_some_and(|e| e.near)
    }

    /// Returns the log-likelihood of an end, of the integrated model where the path is not that of the integration; -∞ where
    /// there is none.
    ///
    /// A path on a mesh that is too coarse may miss a fast motion.
    pub(super) fn likelihood(&self, fit: &Fit) -> f64 {
        if !fit.feasible {
            return f64::NEG_INFINITY;
        }
        let integrated = if current().stops() {
            self.integrated_log_likelihood(fit)
        } else if self
            .simulated(&fit.values(), SEARCH.tolerance)
            .is_some_and(|runs| fit.departure(&runs) <= FAR)
        {
            return fit.log_likelihood;
        } else {
            self.integrated(fit, SEARCH.tolerance, Method::Automatic)
        };
        integrated.ok().filter(|l| l.is_finite()).unwrap_or(f64::NEG_INFINITY)
    }
}
