//! What the user may choose.

use std::time::Duration;

use crate::error::Error;
use crate::linalg::KktChoice;
use crate::setters::setters;

/// Options of [`solve`](super::solve).
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// Most iterations.
    pub max_iterations: usize,
    /// How close the optimum must be: the log-likelihood that the next step promises to gain, and that
    /// the defects could pretend, stay below the square of this. It is about the distance in standard
    /// errors.
    pub tolerance: f64,
    /// Most time.
    pub time_limit: Option<Duration>,
    /// Whether to go by Gauss-Newton steps first, with standard deviations profiled; else the exact
    /// Hessian from the start.
    pub gauss_newton: bool,
    /// The factorisation of its Newton systems.
    pub kkt: KktChoice,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            max_iterations: 200,
            tolerance: 1e-4,
            time_limit: None,
            gauss_newton: true,
            kkt: KktChoice::default(),
        }
    }
}

impl Settings {
    setters! {
        max_iterations: usize, tolerance: f64, gauss_newton: bool, kkt: KktChoice; into time_limit: Option<Duration>
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// Names the option at fault.
    pub fn check(&self) -> Result<(), Error> {
        if !(self.tolerance > 0.0 && self.tolerance < 1.0) {
            return Err(Error::option(format!(
                "tolerance {} is not a number between 0 and 1",
                self.tolerance
            )));
        }
        Ok(())
    }
}
