//! The state of a search for better optima, which restarts and output injection carry on.

use std::time::Duration;

use super::draws::Draws;
use super::fit::Fit;
use super::motion::Values;
use crate::interrupt::current;

/// The state of a search.
pub(super) struct Search<'a> {
    /// The best end so far, and its log-likelihood.
    pub fit: Fit,
    pub likelihood: f64,
    /// Sums over all runs.
    pub iterations: usize,
    pub time: Duration,
    /// Restarts in a row without a gain, those of them that returned in a row, and those that ever did.
    pub without: usize,
    pub returns: usize,
    pub again: usize,
    /// The start, and the random draws.
    pub values: Values,
    pub draws: Draws<'a>,
}

impl Search<'_> {
    /// Returns whether the time is over, or the user has stopped it.
    pub(super) fn is_stopped(&self) -> bool {
        self.fit.status.was_stopped() || current().stops()
    }

    /// Returns the parameters of the best end.
    pub(super) fn best(&self) -> Values {
        let of_fit = |v: &(String, f64)| (v.0.clone(), self.fit.parameter(&v.0).map_or(v.1, |e| e.value));
        self.values.iter().map(of_fit).collect()
    }

    /// Adds the effort of other runs.
    pub(super) fn count(&mut self, iterations: usize, time: Duration) {
        self.iterations += iterations;
        self.time += time;
    }

    /// Takes a better end from elsewhere.
    pub(super) fn take(&mut self, fit: Fit, likelihood: f64) {
        (self.fit, self.likelihood) = (fit, likelihood);
        (self.without, self.returns, self.again) = (0, 0, 0);
    }
}
