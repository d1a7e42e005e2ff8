//! Other ways to an optimum, where a run from the start ends without one or at a poor one.

use super::Estimation;
use super::fit::{Fit, Record};
use super::noise::spread;
use super::print::short;
use super::run::Watch;
use crate::error::{Error, ErrorKind};
use crate::interrupt::current;
use crate::noise::{Joint, NoiseModel, Scale};
use crate::solver::{Settings, Status};

/// An end that is less likely than another by more than this is another optimum, not rounding.
const LESS: f64 = 1e-2;

/// Where the coefficient of determination of every output is below this, the optimum is a poor one.
const POOR: f64 = 0.5;

/// Another way to an optimum from the same start.
#[derive(Clone, Copy)]
enum Way {
    OutputInjection,
    Regression,
    ConsistentPaths,
    ExactHessian,
}

impl Way {
    const ALL: [Way; 4] = [Way::OutputInjection, Way::Regression, Way::ConsistentPaths, Way::ExactHessian];

    fn description(self) -> &'static str {
        match self {
            Way::Regression => "a regression on the initial paths of the states",
            Way::ConsistentPaths => "steps along paths that satisfy the equations",
            Way::ExactHessian => "steps with the exact Hessian",
            Way::OutputInjection => "estimates with output injection, whose gain falls to zero",
        }
    }
}

impl Estimation<'_> {
    /// Returns the fit, or a better one that was reached otherwise, where the run from the start itself ended without an
    /// optimum, or at one at which no output is matched well.
    pub(super) fn or_otherwise(&self, fit: Fit, watch: &mut Watch<'_>) -> Result<Fit, Error> {
        let plain = !self.solver_given && self.start.is_empty() && self.earlier.is_none();
        let mut fit = fit;
        if fit.status == Status::IterationLimit && plain {
            fit = self.with_noise_first(fit, watch)?;
        }
        if !self.may_go_otherwise() {
            return Ok(fit);
        }
        let ended = fit.status;
        for way in Way::ALL {
            if !fit.is_poor() || fit.status.was_stopped() || current().stops() {
                break;
            }
            let Some(mut other) = self.end_of(way, &fit, watch)? else { continue };
            other.iterations += fit.iterations;
            other.solution.time += fit.solution.time;
            let better = !other.log_likelihood.is_nan()
                && (fit.log_likelihood.is_nan() || other.log_likelihood > fit.log_likelihood + LESS);
            if better && (other.status.is_end() || !fit.status.is_end()) {
                let why = if ended.is_end() { "match no output well" } else { "reach no optimum" };
                other.message = format!(
                    "{}; reached after {}, since the iterations from the start values {why}",
                    other.message,
                    way.description()
                );
                fit = other;
            } else {
                (fit.iterations, fit.solution.time) = (other.iterations, other.solution.time);
                if other.status.was_stopped() {
                    (fit.status, fit.message) = (other.status, other.message);
                }
            }
        }
        Ok(fit)
    }

    /// Returns the end of another way than that of a fit; `None` where there is no such way, or it leads nowhere.
    fn end_of(&self, way: Way, fit: &Fit, watch: &mut Watch<'_>) -> Result<Option<Fit>, Error> {
        let found = match self.by(way) {
            Some(other) => other.solve_refined(watch).map(Some),
            None if self.output_injection && matches!(way, Way::OutputInjection) => {
                self.led_by_injection(fit, watch)
            }
            None => Ok(None),
        };
        match found {
            Err(e) if e.kind() == ErrorKind::Evaluation => Ok(None),
            found => found,
        }
    }

    /// Whether another way may lead elsewhere: not from where a fit ended, where kinks are the reason, where a search from many
    /// parameters has been made, or where few iterations were asked for.
    fn may_go_otherwise(&self) -> bool {
        let near = self.earlier.as_ref().is_some_and(|e| e.near);
        !self.asks_for_few_iterations()
            && !near
            && !self.smooths()
            && self.transcription.is_collocation()
            && self.own_solver.is_none()
            && !self.follows_motion()
    }

    /// The same estimation in another way; `None` where its options forbid it, or where it is what was done.
    fn by(&self, way: Way) -> Option<Self> {
        let regression = self.regression.unwrap_or_else(|| self.states_known());
        Some(match way {
            Way::Regression if !regression && self.regression.is_none() => {
                Estimation { regression: Some(true), ..self.clone() }
            }
            Way::ConsistentPaths if self.paths.is_none() => {
                Estimation { regression: Some(false), paths: Some(true), ..self.clone() }
            }
            Way::ExactHessian if self.solver.gauss_newton => {
                let solver = Settings { gauss_newton: false, ..self.solver.clone() };
                Estimation { solver, ..self.clone() }
            }
            _ => return None,
        })
    }

    /// Returns the fit with the noise free from where one with known noise ends, where both converge, else `fit`.
    ///
    /// Where a model misses much, the likelihood has ridges along which the noise of one output falls while that of others
    /// grows. With standard deviations held at the spread of the measurements it has none. Output-error programs keep the
    /// noise as it is for their first iterations for the same reason (Jategaonkar 2015, ch. 4).
    pub(super) fn with_noise_first(&self, fit: Fit, watch: &mut Watch<'_>) -> Result<Fit, Error> {
        let outputs = || self.model.outputs.iter().map(|o| o.name.as_str());
        let known = outputs().any(|name| matches!(self.noise.scale_of(name), Some(Scale::Known(_))));
        if !self.transcription.is_collocation() || known || matches!(self.noise.joint, Joint::Known(_)) {
            return Ok(fit);
        }
        let mut held = NoiseModel::new();
        for (c, name) in outputs().enumerate() {
            let samples: Vec<&[f64]> = self.experiments.iter().map(|e| &e.outputs[c][..]).collect();
            let spread = spread(&samples);
            if !spread.is_finite() {
                return Ok(fit);
            }
            held = held.scale(name, Scale::Known(spread));
        }
        let first = Estimation { noise: held, ..self.clone() }.solve_refined(watch)?;
        if !first.status.is_end() {
            return Ok(fit);
        }
        let mut found = self.clone().start_from(&first).solve_refined(watch)?;
        if !found.status.is_end() {
            return Ok(fit);
        }
        let lost = fit.log_likelihood - found.log_likelihood;
        if fit.feasible && lost > LESS {
            found.warnings.push(format!(
                "a run that did not converge has a log-likelihood higher by {}: `multistart` seeks other optima",
                short(lost, 4)
            ));
        }
        found.iterations += fit.iterations + first.iterations;
        found.solution.time += fit.solution.time + first.solution.time;
        Ok(found)
    }
}

impl Fit {
    /// Whether it is at no optimum, or at one at which no output is matched well.
    fn is_poor(&self) -> bool {
        !self.status.is_end()
            || (0..self.model.outputs.len()).all(|c| self.r_squared(c).is_none_or(|r| r < POOR))
    }

    /// The coefficient of determination of an output, about the mean of each record.
    pub(super) fn r_squared(&self, output: usize) -> Option<f64> {
        let (mut squares, mut about) = (0.0, 0.0);
        for record in &self.records {
            let measured = |(y, r): (&f64, &f64)| Some((y + r, *r)).filter(|m| m.0.is_finite());
            let Record { outputs, residuals, .. } = record;
            let present: Vec<(f64, f64)> =
                outputs[output].iter().zip(&residuals[output]).filter_map(measured).collect();
            let mean = present.iter().map(|p| p.0).sum::<f64>() / present.len().max(1) as f64;
            squares += present.iter().map(|p| p.1 * p.1).sum::<f64>();
            about += present.iter().map(|p| (p.0 - mean) * (p.0 - mean)).sum::<f64>();
        }
        (about > 0.0).then(|| 1.0 - squares / about)
    }
}
