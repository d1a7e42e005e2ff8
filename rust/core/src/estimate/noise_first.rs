//! Estimation with the noise held at the spread of the measurements first.

use super::Estimation;
use super::fit::Fit;
use super::noise::spread;
use super::print::short;
use super::run::Watch;
use crate::error::Error;
use crate::noise::{Joint, NoiseModel, Scale};

/// An end that is less likely than another by more than this is another optimum, not rounding.
const LESS: f64 = 1e-2;

impl Estimation<'_> {
    /// Returns the fit with the noise free from where one with known noise ends, where both converge, else `fit`.
    ///
    /// Where a model misses much, the likelihood has ridges along which the noise of one output falls while that of others
    /// grows. With standard deviations held at the spread of the measurements it has none. Output-error programs keep the
    /// noise as it is for their first iterations for the same reason (Jategaonkar 2015, ch. 4).
    pub(super) fn with_noise_first(&self, fit: Fit, watch: &mut Watch<'_>) -> Result<Fit, Error> {
        let outputs = || self.model.outputs.iter().map(|o| o.name.as_str());
        let known = outputs().any(|name| matches!(self.noise.scale_of(name), Some(Scale::Known(_))));
        if self.shots.is_some() || known || matches!(self.noise.joint, Joint::Known(_)) {
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
