//! Why a sample was not taken, in the user's names.

use std::fmt;
use std::sync::Arc;

/// The reason why [`Online::push`](super::Online::push) did not take a sample. The estimator is as it was before.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum OnlineError {
    /// The sample has another number of inputs or outputs than the model.
    Length {
        /// "inputs" or "outputs".
        what: &'static str,
        /// How many were given.
        given: usize,
        /// How many the model has.
        wanted: usize,
    },
    /// The time is not a finite number.
    Time(f64),
    /// An input is not finite, or an output infinite.
    NotFinite {
        /// Name of the channel.
        channel: Arc<str>,
        /// Its value.
        value: f64,
        /// Time of the sample, s.
        t: f64,
    },
    /// There is a sample of this time already, with the same outputs.
    Repeated {
        /// Time of the sample, s.
        t: f64,
    },
    /// Time jumps back by more than late samples do.
    JumpsBack {
        /// Time of the sample, s.
        t: f64,
        /// Time of the last sample, s.
        last: f64,
    },
    /// The stream stopped for longer than [`Settings::max_gap`](super::Settings::max_gap).
    Gap {
        /// Time of the sample, s.
        t: f64,
        /// Time of the last sample, s.
        last: f64,
        /// The longest gap that is taken, s.
        limit: f64,
    },
    /// State equations or outputs are not finite at the estimates.
    Diverged {
        /// Time of the sample, s.
        t: f64,
        /// A state or an output that is not finite.
        name: Arc<str>,
    },
    /// The states at a sample do not determine those before it: the integration is too coarse for a fast state.
    Singular {
        /// Time of the sample, s.
        t: f64,
    },
}

impl fmt::Display for OnlineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            OnlineError::Length { what, given, wanted } => {
                write!(f, "the sample has {given} {what}, the model {wanted}")
            }
            OnlineError::Time(t) => write!(f, "the time of the sample is {t}; it must be a finite number"),
            OnlineError::NotFinite { channel, value, t } => write!(
                f,
                "channel '{channel}' is {value} at t = {t} s; an input must be finite, an output finite or NaN \
                 where it is missing"
            ),
            OnlineError::Repeated { t } => {
                write!(f, "there is a sample of t = {t} s already; time must increase")
            }
            OnlineError::JumpsBack { t, last } => write!(
                f,
                "time jumps back from {last} s to {t} s, before all that the window holds; call restart() where a \
                 new record begins"
            ),
            OnlineError::Gap { t, last, limit } => write!(
                f,
                "there is no sample between {last} s and {t} s, which is longer than max_gap = {limit} s; call \
                 restart() to go on with new states and the same parameters"
            ),
            OnlineError::Diverged { t, name } => write!(
                f,
                "'{name}' is not finite at t = {t} s with the present estimates; give smaller standard deviations of \
                 the start values or bounds, or call restart()"
            ),
            OnlineError::Singular { t } => write!(
                f,
                "the transition of the states to t = {t} s is singular: a state is too fast for the steps; raise \
                 substeps"
            ),
        }
    }
}

impl std::error::Error for OnlineError {}
