//! What a sample leaves in the estimate, the noise and the detector.

use super::detector::Sampled;
use super::settings::Forgetting;
use super::{Arrival, Online};

impl Online {
    /// Shows the innovations of the latest sample to the detector. It keeps what they say, even if the iterations fail afterwards.
    pub(super) fn notice(&mut self) {
        let Some(detector) = &mut self.detector else { return };
        let Some(node) = self.horizon.last() else { return };
        // In a window of one sample the segment is the one that was eliminated.
        let segment = self.started.then(|| self.horizon.used.saturating_sub(2));
        let sample = Sampled { t: node.t, before: self.estimate.t, theta: &self.horizon.theta, segment };
        detector.update(&mut self.solver, &self.innovation, sample);
    }

    /// Fills the estimate, after the iterations.
    pub(super) fn report(&mut self, latest: bool) {
        let Online { solver, horizon, noise, innovation, estimate, inverse, .. } = self;
        let Some(node) = horizon.last() else { return };
        let (n, m) = (solver.n(), solver.info.m);
        solver.info.covariance(inverse, &mut estimate.covariance);
        estimate.states.copy_from_slice(&node.x);
        for (i, error) in estimate.state_errors.iter_mut().enumerate() {
            *error = estimate.covariance[i * m + i].sqrt();
        }
        for (k, &i) in solver.free.iter().enumerate() {
            estimate.parameters[i] = horizon.theta[k];
            estimate.parameter_errors[i] = estimate.covariance[(n + k) * (m + 1)].sqrt();
            estimate.at_bound[i] = solver.bounds.at(k, horizon.theta[k]);
        }
        for values in [&mut estimate.innovations, &mut estimate.innovation_errors, &mut estimate.normalised] {
            values.fill(f64::NAN);
        }
        estimate.arrival = if latest { Arrival::Latest } else { Arrival::Late };
        if latest {
            let keep = match self.settings.forgetting {
                Forgetting::Exponential(time) | Forgetting::Directional(time) if estimate.t.is_finite() => {
                    (-(node.t - estimate.t).max(0.0) / time).exp()
                }
                _ => 1.0,
            };
            for (k, &output) in solver.present.iter().enumerate() {
                let sigma = noise.sigma[output];
                let value = innovation.values[k];
                estimate.innovations[output] = sigma * value;
                estimate.innovation_errors[output] = sigma * innovation.variances[k].sqrt();
                estimate.normalised[output] = innovation.normalised[k];
                noise.update(output, sigma * value, sigma * solver.residuals[k], keep);
            }
        }
        if let Some(detector) = &self.detector {
            estimate.alarm.clone_from(&detector.alarm);
        }
        estimate.t = node.t;
        estimate.sigma.copy_from_slice(&noise.sigma);
    }
}
