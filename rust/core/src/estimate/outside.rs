//! A solver of one's own in place of Newton's method.

use std::fmt;

use super::earlier::Multipliers;
use super::transcription::Problem;
use crate::nlp::NotFinite;
use crate::solver::{Control, Iteration, Solution};

/// A solver of nonlinear programs.
pub trait Solver: fmt::Debug + Sync {
    /// Minimises from a point. Most iterations and the time that is left are in `from`; where
    /// [`current`](crate::interrupt::current) stops, the best point so far is the result.
    ///
    /// # Errors
    /// [`NotFinite`] when a function is not finite at the start; everything else is a
    /// [`Status`](crate::solver::Status).
    fn solve(
        &self,
        problem: &Problem,
        from: &Beginning<'_>,
        watch: &mut dyn FnMut(&Iteration) -> Control,
    ) -> Result<Solution, NotFinite>;
}

/// Where a solver begins.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Beginning<'a> {
    /// Variables.
    pub xi: &'a [f64],
    /// Multipliers of an earlier solution.
    pub multipliers: Option<&'a Multipliers>,
    /// Whether the states are measured or given, so that a regression on them makes sense.
    pub known: bool,
    /// Whether they are those of a fit, so that there is no need to look elsewhere.
    pub near: bool,
    /// Whether they are not measured and samples are few, so that steps along consistent paths make sense.
    pub sparse: bool,
    /// Most iterations.
    pub max_iterations: usize,
}
