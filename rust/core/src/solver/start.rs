//! A regression before the first step.

use super::Run;

impl Run<'_> {
    /// Regression of the parameters on defects and outputs, the states as they are.
    pub(super) fn regress(&mut self) {}
}
