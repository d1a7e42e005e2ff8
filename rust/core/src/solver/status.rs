//! How a run ended, and what to do about it.

use std::fmt;

use crate::interrupt::{Cause, Interrupt};

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Status {
    /// A local optimum.
    Converged,
    /// Near an optimum, but rounding or a stalled search left the tolerance unmet.
    Acceptable,
    /// Stopped from outside.
    Interrupted,
    /// Too many iterations.
    IterationLimit,
    /// Too much time.
    TimeLimit,
    /// The equations cannot be met near here.
    Infeasible,
    /// At an optimum, some parameters have no influence or trade off against each other.
    Unidentifiable,
    /// The unknowns grow without limit.
    Diverging,
    /// No step helps.
    Failed,
}

impl Status {
    /// All of them.
    pub const ALL: [Status; 9] = [
        Status::Converged,
        Status::Acceptable,
        Status::Interrupted,
        Status::IterationLimit,
        Status::TimeLimit,
        Status::Infeasible,
        Status::Unidentifiable,
        Status::Diverging,
        Status::Failed,
    ];

    /// Whether it is an end that leads nowhere.
    pub(crate) fn lost(self) -> bool {
        matches!(self, Status::Failed | Status::Diverging | Status::Infeasible)
    }

    /// Whether a run was stopped, by its caller or the time limit.
    pub(crate) fn was_stopped(self) -> bool {
        matches!(self, Status::Interrupted | Status::TimeLimit)
    }

    /// How a run ends where it has been stopped.
    pub(crate) fn stopped(interrupt: &Interrupt) -> Option<Status> {
        interrupt.cause().map(|cause| match cause {
            Cause::Stopped => Status::Interrupted,
            Cause::TimeLimit => Status::TimeLimit,
        })
    }

    /// Whether it is at an optimum, told apart from others or not.
    pub fn is_end(self) -> bool {
        matches!(self, Status::Converged | Status::Acceptable | Status::Unidentifiable)
    }

    /// Whether something stopped the run before its end.
    pub(crate) fn unfinished(self) -> bool {
        matches!(self, Status::IterationLimit | Status::TimeLimit | Status::Interrupted)
    }

    /// What it means and what to do.
    pub fn hint(self) -> &'static str {
        match self {
            Status::Converged => {
                "a local optimum was found; estimate from other start values to see whether it is the global one"
            }
            Status::Acceptable => {
                "stopped at an acceptable point: tolerances were not all met, often for want of precision; \
                 check the standard errors"
            }
            Status::Interrupted => {
                "stopped by the user; this is the best point so far, from which an estimation can continue"
            }
            Status::IterationLimit => "not converged; allow more iterations, or continue from this point",
            Status::TimeLimit => "not converged; allow more time, or continue from this point",
            Status::Infeasible => {
                "no state path near this point satisfies the equations; check start values, bounds and units"
            }
            Status::Unidentifiable => {
                "the data do not determine all parameters: fix some of those named, or give them priors"
            }
            Status::Diverging => {
                "the unknowns grow without limit; a parameter may have no influence: bound or fix it"
            }
            Status::Failed => {
                "the solver made no further progress; try other start values, bounds that keep functions finite, or another order"
            }
        }
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Status::Converged => "converged",
            Status::Acceptable => "acceptable",
            Status::Interrupted => "interrupted",
            Status::IterationLimit => "iteration limit",
            Status::TimeLimit => "time limit",
            Status::Infeasible => "infeasible",
            Status::Unidentifiable => "unidentifiable",
            Status::Diverging => "diverging",
            Status::Failed => "failed",
        })
    }
}
