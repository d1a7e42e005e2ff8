//! Other ways to an optimum, where a run from the start ends without one or at a poor one.

use std::time::Duration;

use super::draws::Draws;
use super::fit::{Fit, Record};
use super::motion::Values;
use super::noise::spread;
use super::print::short;
use super::run::Watch;
use super::{Estimation, Start};
use crate::error::{Error, ErrorKind};
use crate::interrupt::current;
use crate::noise::{Joint, NoiseModel, Scale};
use crate::solver::{Settings, Status};

/// An end that is less likely than another by more than this is another optimum, not rounding.
const LESS: f64 = 1e-2;

/// Where the coefficient of determination of every output is below this, the optimum is a poor one.
const POOR: f64 = 0.5;
/// It is one as well where this part of the outputs are explained to less than this, noise apart.
const MANY: f64 = 0.4;
const EXPLAINED: f64 = 0.8;
/// Where residuals are larger than their noise by this factor, in the geometric mean of the outputs, and an output is explained to
/// less than this part, another optimum may match far better. So it is with a model that lacks something, too: only quick ways are
/// tried then.
const LARGE: f64 = 4.0;
const WELL: f64 = 0.95;
/// Fewer residuals do not tell their noise.
const FEW: usize = 20;

/// Another way to an optimum from the same start.
#[derive(Clone, Copy)]
enum Way {
    OutputInjection,
    Regression,
    ConsistentPaths,
    ExactHessian,
    OtherParameters,
}

impl Way {
    const ALL: [Way; 5] = [
        Way::OutputInjection,
        Way::Regression,
        Way::ConsistentPaths,
        Way::ExactHessian,
        Way::OtherParameters,
    ];

    /// Returns whether it takes about as long as a run from the start values.
    fn is_quick(self) -> bool {
        matches!(self, Way::Regression | Way::ConsistentPaths)
    }

    fn description(self) -> &'static str {
        match self {
            Way::Regression => "a regression on the initial paths of the states",
            Way::ConsistentPaths => "steps along paths that satisfy the equations",
            Way::ExactHessian => "steps with the exact Hessian",
            Way::OtherParameters => "runs from other parameters, drawn at random",
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
            if fit.status.was_stopped() || current().stops() {
                break;
            }
            if !(fit.is_poor() || way.is_quick() && fit.residuals_are_large()) {
                continue;
            }
            let Some(mut other) = self.end_of(way, &fit, watch)? else { continue };
            other.iterations += fit.iterations;
            other.solution.time += fit.solution.time;
            let better = !other.log_likelihood.is_nan()
                && (fit.log_likelihood.is_nan() || other.log_likelihood > fit.log_likelihood + LESS);
            if better && (other.status.is_end() || !fit.status.is_end()) {
                let why = if ended.is_end() { "do not match the outputs well" } else { "reach no optimum" };
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
            None if matches!(way, Way::OtherParameters) => self.with_other_parameters(watch),
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

    /// Returns the best of runs from parameters drawn about the start values, of which the first that ends well is the last;
    /// `None` unless restarts were asked for.
    fn with_other_parameters(&self, watch: &mut Watch<'_>) -> Result<Option<Fit>, Error> {
        let parameters = &self.model.parameters;
        let any = parameters.iter().any(|p| !p.fixed && !p.local);
        let Some(restarts) = self.restarts.filter(|_| any) else { return Ok(None) };
        let values: Values = parameters.iter().map(|p| p.name.clone()).zip(self.parameters()?).collect();
        let mut draws = Draws::new(parameters, &values);
        let (mut best, mut iterations, mut time): (Option<Fit>, _, _) = (None, 0, Duration::ZERO);
        for _ in 0..restarts {
            if current().stops() || best.as_ref().is_some_and(|best| !best.is_poor()) {
                break;
            }
            let mut other = self.clone();
            let drawn = draws.multiplied(&values).into_iter();
            other.start.extend(drawn.map(|(name, value)| (name, Start::Value(value))));
            let found = match other.solve_refined(watch) {
                Err(e) if e.kind() == ErrorKind::Evaluation => continue,
                found => found?,
            };
            iterations += found.iterations;
            time += found.solution.time;
            let stopped = found.status.was_stopped().then(|| (found.status, found.message.clone()));
            if best.as_ref().is_none_or(|best| found.rank() > best.rank()) {
                best = Some(found);
            }
            if let (Some(best), Some(stopped)) = (&mut best, stopped) {
                (best.status, best.message) = stopped;
                break;
            }
        }
        Ok(best.map(|fit| fit.after(iterations, time)))
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
    /// Returns whether it is at no optimum, at one whose tolerances were not met, or at one at which no output or few outputs are
    /// matched well.
    pub(super) fn is_poor(&self) -> bool {
        let outputs = || 0..self.model.outputs.len();
        let unexplained = outputs().filter(|c| self.explained(*c).is_some_and(|r| r < EXPLAINED)).count();
        !self.status.is_end()
            || self.status == Status::Acceptable
            || outputs().all(|c| self.r_squared(c).is_none_or(|r| r < POOR))
            || unexplained as f64 >= MANY * outputs().len() as f64
    }

    /// Returns what the better of two ends has more of: an end at an optimum, else the log-likelihood of a path that is a solution.
    pub(super) fn rank(&self) -> (bool, f64) {
        (self.status.is_end(), if self.feasible { self.log_likelihood } else { f64::NEG_INFINITY })
    }

    /// Returns the fit with the iterations and the time of all runs that led to it.
    pub(super) fn after(mut self, iterations: usize, time: Duration) -> Self {
        (self.iterations, self.solution.time) = (iterations, time);
        self
    }

    /// The coefficient of determination of an output, about the mean of each record.
    pub(super) fn r_squared(&self, output: usize) -> Option<f64> {
        let Squares { residuals, about, .. } = self.squares(output);
        (about > 0.0).then(|| 1.0 - residuals / about)
    }

    /// The same without white noise, as the differences of successive residuals tell it; none of few residuals.
    ///
    /// An output that is mostly noise is matched well where its residuals are white.
    fn explained(&self, output: usize) -> Option<f64> {
        let Squares { number, residuals, about, noise } = self.squares(output);
        let of_motion = about - noise;
        (number >= FEW && of_motion > 0.0).then(|| 1.0 - (residuals - noise).max(0.0) / of_motion)
    }

    /// Returns whether residuals are much larger than their white noise, and not small beside the motion.
    fn residuals_are_large(&self) -> bool {
        if !(0..self.model.outputs.len()).any(|c| self.explained(c).is_some_and(|r| r < WELL)) {
            return false;
        }
        let ratio = |c: usize| {
            let Squares { number, residuals, noise, .. } = self.squares(c);
            (number >= FEW && noise > 0.0).then(|| 0.5 * (residuals / noise).max(1.0).ln())
        };
        let ratios: Vec<f64> = (0..self.model.outputs.len()).filter_map(ratio).collect();
        ratios.iter().sum::<f64>() > LARGE.ln() * ratios.len() as f64
    }

    fn squares(&self, output: usize) -> Squares {
        let mut sums = Squares { number: 0, residuals: 0.0, about: 0.0, noise: 0.0 };
        for record in &self.records {
            let measured = |(y, r): (&f64, &f64)| Some((y + r, *r)).filter(|m| m.0.is_finite());
            let Record { outputs, residuals, .. } = record;
            let present: Vec<(f64, f64)> =
                outputs[output].iter().zip(&residuals[output]).filter_map(measured).collect();
            let mean = present.iter().map(|p| p.0).sum::<f64>() / present.len().max(1) as f64;
            sums.number += present.len();
            sums.residuals += present.iter().map(|p| p.1 * p.1).sum::<f64>();
            sums.about += present.iter().map(|p| (p.0 - mean) * (p.0 - mean)).sum::<f64>();
            // The variance of a difference of independent values is twice their variance.
            sums.noise += present.windows(2).map(|w| 0.5 * (w[1].1 - w[0].1).powi(2)).sum::<f64>();
        }
        sums
    }
}

/// Sums of squares of an output over all records.
struct Squares {
    number: usize,
    residuals: f64,
    /// About the mean of each record.
    about: f64,
    /// The sum that white noise has in the residuals.
    noise: f64,
}
