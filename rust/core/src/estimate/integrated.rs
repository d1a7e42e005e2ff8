//! The log-likelihood of the model integrated with the estimates, which a path on a coarse mesh need not have.

use std::time::{Duration, Instant};

use super::accuracy::FINEST;
use super::fit::Fit;
use super::print::short;
use super::run::Watch;
use super::{Estimation, Transcription};
use crate::collocation::{self, Collocation};
use crate::condition::End;
use crate::error::{Error, ErrorKind};
use crate::experiment::Experiment;
use crate::interrupt::{Interrupt, current};
use crate::mesh::Grid;
use crate::nlp::Nlp;
use crate::problem::Transcribed;
use crate::simulate::{Method, Simulation};
use crate::solver::{Settings, Status};

/// Tolerances of the integration, and of that by an implicit method where the first is not that of the path.
const TOLERANCE: f64 = 1e-8;
const TOLERANCE_AGAIN: f64 = 1e-9;
/// Tolerance of a run that is to end at a solution of the equations, where one to the usual tolerance did not.
const TIGHT: f64 = 1e-8;
/// The integration of all records may take so long, or this part of the time limit where that is less, but always a little.
const LONGEST: Duration = Duration::from_secs(5);
const LEAST: Duration = Duration::from_millis(100);
const OF_LIMIT: f64 = 0.05;
/// Log-likelihoods that differ by more than this are reported.
const DIFFERENT: f64 = 0.1;
/// Beyond this difference a run on a mesh that follows the motion has not converged to a solution, whatever it ended with.
const WRONG: f64 = 1.0;

impl Estimation<'_> {
    /// Sets the log-likelihood of the integrated model, and says where it is not that of the path: for a run that was cut, and
    /// where samples are few and the parameters tell where the motion begins.
    ///
    /// The integration is independent of any mesh. Long records of unstable motion have no such likelihood, and of a run that
    /// ends the mesh is examined ([`Fit::integration_error`]).
    pub(super) fn compare_with_integration(&self, fit: &mut Fit) {
        let cut = !fit.status.is_end() && fit.iterations > 0;
        // Of an input that is late the derivative is an input, too, which no integration follows through its jumps.
        let simple = fit.transcription.is_collocation() && self.model.delays.is_empty();
        // Who presses Ctrl-C waits for no integration.
        if !simple || fit.status == Status::Interrupted || !(cut || self.parameters_tell_motion()) {
            return;
        }
        let began = Instant::now();
        let found = self.integrated_log_likelihood(fit);
        // An integration that took too long says nothing.
        let known = found.is_ok() || began.elapsed() < self.time_for_integration();
        fit.integrated = known.then(|| found.as_ref().copied().unwrap_or(f64::NAN));
        let path = fit.log_likelihood;
        match found {
            Err(e) if !fit.feasible || e.kind() == ErrorKind::Data => {}
            Err(e) => {
                if fit.status.is_end() && self.follows_motion() && known {
                    fit.end_as(Status::IterationLimit);
                }
                fit.warnings.push(format!(
                    "the log-likelihood is that of the path on the mesh; whether the path is a solution is not known, since the \
                     model could not be integrated with these estimates ({e})"
                ));
            }
            Ok(found) if !fit.feasible => {
                let text = "the model integrated with these estimates has the log-likelihood";
                fit.message = format!("{}; {text} {}", fit.message, short(found, 6));
            }
            Ok(found) if (found - path).abs() <= DIFFERENT => {}
            Ok(found) => {
                if fit.status.is_end() && self.follows_motion() && (found - path).abs() > WRONG {
                    fit.end_as(Status::IterationLimit);
                }
                fit.warnings.push(format!(
                    "the model integrated with these estimates has the log-likelihood {}, and not {} as the path on the mesh: the \
                     mesh is too coarse for this path, the motion too unstable to be integrated over the record, or an estimate has run \
                     away, which other start values or bounds may prevent",
                    short(found, 6),
                    short(path, 6)
                ));
            }
        }
    }

    /// Warns where the mesh is coarse, and was not to be refined.
    pub(super) fn warn_of_coarse_mesh(&self, fit: &mut Fit) {
        let refined = self.refine.is_some() && self.transcription.is_collocation();
        if refined || !fit.feasible || fit.status.was_stopped() || current().stops() {
            return;
        }
        // Of a motion at rest, say, no error of a segment reaches a sample. A mesh that was given is the user's.
        let agrees = fit.integrated.is_some_and(|l| (l - fit.log_likelihood).abs() <= DIFFERENT);
        if !(agrees && self.follows_motion()) {
            fit.warnings.extend(fit.coarse_mesh_warning(self.experiments));
        }
    }

    /// Estimates again on a finer mesh along the motion where the model integrated with the estimates has another
    /// log-likelihood than the path, or a log-likelihood where the path is no solution, and the mesh is one that may be
    /// refined.
    pub(super) fn refine_along_the_motion(&self, fit: &mut Fit, watch: &mut Watch<'_>) -> Result<(), Error> {
        let Some(integrated) = fit.integrated else { return Ok(()) };
        // A path that is no solution has no log-likelihood.
        let no_solution = !fit.feasible && integrated.is_finite();
        let differs = no_solution || (integrated - fit.log_likelihood).abs() > DIFFERENT;
        let may_refine = self.refine.is_some() || self.follows_motion();
        // On a given mesh, too, "infeasible" would be wrong where the model can be integrated.
        let is_wrong = no_solution && fit.status == Status::Infeasible && self.integration_is_a_solution();
        if !differs || !(may_refine || is_wrong) || fit.status.was_stopped() || current().stops() {
            return Ok(());
        }
        let is_as_likely =
            |finer: &Fit| finer.feasible && finer.integrated.is_some_and(|l| l > integrated - DIFFERENT);
        let finer = match may_refine {
            true => self.along_the_motion(&self.values_of(fit), f64::NEG_INFINITY, FINEST, watch)?,
            false => None,
        };
        if let Some(mut finer) = finer {
            self.compare_with_integration(&mut finer);
            if is_as_likely(&finer) {
                finer.iterations += fit.iterations;
                finer.solution.time += fit.solution.time;
                finer.refinement = fit.refinement.take();
                *fit = finer;
                return Ok(());
            }
        }
        if no_solution && let Some(mut still) = self.at_the_motion(fit, watch)? {
            self.compare_with_integration(&mut still);
            if is_as_likely(&still) {
                *fit = still;
            }
        }
        Ok(())
    }

    /// Returns whether a path that is integrated from initial states is a solution of all equations: not where conditions are
    /// given for the end of a record, which it need not meet.
    fn integration_is_a_solution(&self) -> bool {
        self.own_solver.is_none() && !self.model.conditions.iter().any(|c| c.end != End::Initial)
    }

    /// Returns the fit along the model integrated with the parameters where a run ended at a path that is no solution.
    fn at_the_motion(&self, fit: &Fit, watch: &mut Watch<'_>) -> Result<Option<Fit>, Error> {
        let solver = Settings { max_iterations: 0, ..self.solver.clone() };
        let held = Estimation { solver, ..self.clone() };
        let still = held.along_the_motion(&self.values_of(fit), f64::NEG_INFINITY, FINEST, watch)?;
        Ok(still.map(|mut still| {
            let is_wrong = fit.status == Status::Infeasible || fit.status.is_end();
            still.status = if is_wrong { Status::IterationLimit } else { fit.status };
            still.message = format!(
                "{}; the path is that of the model integrated with the parameters where the iterations ended, since theirs was \
                 no solution of the equations",
                still.status.hint()
            );
            still.iterations += fit.iterations;
            still.solution.time += fit.solution.time;
            still
        }))
    }

    /// Solves to a smaller tolerance where a run ended at an optimum by its own one, but at a path that is no solution of the
    /// equations: where a measured state does not vary, its defects are small beside all else.
    pub(super) fn solve_to_a_solution(&self, fit: &mut Fit, watch: &mut Watch<'_>) -> Result<(), Error> {
        if fit.feasible || !fit.status.is_end() || self.solver.tolerance <= TIGHT || current().stops() {
            return Ok(());
        }
        let solver = Settings { tolerance: TIGHT, ..self.solver.clone() };
        let mut found = Estimation { solver, ..self.clone() }.solve_all(watch)?;
        if found.feasible {
            found.iterations += fit.iterations;
            found.solution.time += fit.solution.time;
            *fit = found;
        }
        Ok(())
    }

    /// Sets the status of a fit that ended at an optimum of the mesh, but at a path that is no solution of the equations.
    pub(super) fn believe_no_end_without_solution(fit: &mut Fit) {
        if !fit.feasible && fit.status.is_end() {
            fit.status = Status::Infeasible;
            fit.message = fit.status.hint().into();
        }
    }

    /// Sets the status of a fit that ended for want of a step where its path is a solution all the same: that of the model
    /// integrated with the estimates. To say "infeasible" of it would be wrong.
    pub(super) fn deny_no_solution(fit: &mut Fit) {
        let is_solution = fit.integrated.is_some_and(|l| (l - fit.log_likelihood).abs() <= DIFFERENT);
        if fit.feasible && fit.status == Status::Infeasible && is_solution {
            fit.end_as(Status::Failed);
        }
    }

    /// Returns the log-likelihood of the model integrated with the estimates of a fit, also where the time of the estimation is
    /// over.
    pub(super) fn integrated_log_likelihood(&self, fit: &Fit) -> Result<f64, Error> {
        let limit = Some(self.time_for_integration());
        let by = |tolerance, method| self.integrated(fit, tolerance, method);
        Interrupt::shielded(|| {
            Interrupt::within(limit).run(|| {
                let found = by(TOLERANCE, Method::Automatic);
                if found.as_ref().is_ok_and(|l| (l - fit.log_likelihood).abs() <= DIFFERENT) {
                    return found;
                }
                // An explicit step may cross a pole next to the solution unnoticed, as that of saturated kinetics.
                by(TOLERANCE_AGAIN, Method::Implicit).or(found)
            })
        })
    }

    fn time_for_integration(&self) -> Duration {
        let part = self.solver.time_limit.map_or(LONGEST, |t| t.mul_f64(OF_LIMIT));
        if self.outside.stops() { LEAST } else { part.clamp(LEAST, LONGEST) }
    }

    /// Returns the log-likelihood of the model integrated with the estimates of a fit by one method.
    pub(super) fn integrated(&self, fit: &Fit, tolerance: f64, method: Method) -> Result<f64, Error> {
        // Kinks are integrated as they are.
        let (model, experiments) = (self.model, self.experiments);
        let path =
            |run: &Experiment| Simulation::new(model, run).fit(fit).tolerance(tolerance).method(method).run();
        let paths = experiments.iter().map(path).collect::<Result<Vec<_>, _>>()?;
        // The trapezoid between samples has no points but these.
        let settings = collocation::Settings {
            order: 2,
            grid: vec![Grid::Samples(1)],
            noise_per_experiment: self.noise.per_experiment,
            ..match &self.transcription {
                Transcription::Collocation(settings) => settings.clone(),
                Transcription::Shooting(_) => collocation::Settings::default(),
            }
        };
        let problem = Collocation::new(model, experiments, self.checked_noise()?, &settings)?;
        let n_theta = problem.layout().n_theta;
        let mut xi = fit.solution.xi[..n_theta].to_vec();
        for path in &paths {
            xi.extend((0..path.t.len()).flat_map(|k| path.states.iter().map(move |x| x[k])));
        }
        if xi.len() != problem.n() {
            return Err(Error::data("the motion is not known at the points of the records".into()));
        }
        let objective = problem.objective(&xi);
        objective
            .map(|value| problem.posed().prior_terms(&xi) - value)
            .map_err(|_| Error::evaluation("an output or its noise is not finite along the solution".into()))
    }
}
