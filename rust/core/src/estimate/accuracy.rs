//! The accuracy of meshes along a motion, in the search and at its end.

/// Sets the accuracy of meshes along a motion.
#[derive(Clone, Copy)]
pub(super) struct Accuracy {
    /// Tolerance of the integration.
    pub tolerance: f64,
    /// The local error of collocation that segments may have at first, as a part of each state.
    pub local: f64,
    /// Lets the run go on to its end where progress is slow.
    pub thorough: bool,
}

/// Suffices for the search.
pub(super) const SEARCH: Accuracy = Accuracy { tolerance: 1e-6, local: 1e-3, thorough: false };
/// Holds for the last run.
pub(super) const FINAL: Accuracy = Accuracy { tolerance: 1e-7, local: 1e-4, thorough: true };
/// Serves an end that the integration has found wrong.
pub(super) const FINEST: Accuracy = Accuracy { tolerance: 1e-9, local: 1e-6, thorough: true };
