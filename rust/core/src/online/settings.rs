//! Assumptions and limits of an estimation while the data arrive.

use std::time::Duration;

use super::detector::Detect;
use crate::integrate::Integrator;
use crate::interpolate::Interpolation;
use crate::setters::setters;

/// The rate at which old samples lose their weight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Forgetting {
    /// None: all samples count alike.
    #[default]
    None,
    /// All information on samples before the window decays with this time constant, s. What the data do not excite is forgotten as
    /// well: its standard error grows.
    Exponential(f64),
    /// Information on parameters decays with this time constant, s, in the directions alone in which a sample brings new information
    /// (L. Cao and H. Schwartz, *Automatica* 36, 2000). What the data do not excite is kept.
    Directional(f64),
}

/// Options of [`Online`](super::Online).
///
/// ```
/// use phugoid::online::{Forgetting, Settings};
///
/// let settings = Settings::default().window(20).sigma("q", 0.002).parameter("Cmq", 10.0).forgetting(Forgetting::Directional(30.0));
/// assert_eq!(settings.window, 20);
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// Samples whose states are estimated together and linearised again in each iteration. 1 is the iterated extended Kalman
    /// filter; more are estimation on a moving horizon.
    pub window: usize,
    /// Samples at the beginning that are kept until there are so many, and estimated together as in a window of this length: the first
    /// ones then are not linearised about start values. None where it is no longer than the window.
    pub first_window: usize,
    /// Gauss-Newton iterations after a sample, at most.
    pub iterations: usize,
    /// A step is the last one when it changes the cost by less than the square of this, in standard deviations.
    pub tolerance: f64,
    /// Standard deviations of the measurement noise by output, in the unit of the output, where the model's noise does not give
    /// them.
    pub sigmas: Vec<(String, f64)>,
    /// Whether the standard deviations of the noise are estimated, from the given ones on.
    pub estimate_noise: bool,
    /// Number of samples that the given standard deviations of the noise count for.
    pub noise_weight: f64,
    /// Standard deviations of the start values of parameters, by name. Others have that of their prior, or else a large one.
    pub parameters: Vec<(String, f64)>,
    /// Initial states with their standard deviations, by name. Others start at the first sample of the output that measures them,
    /// or where the model says, or at 0.
    pub initial: Vec<(String, f64, f64)>,
    /// Process noise by state: the standard deviation that a random walk has after 1 s, in the unit of the state.
    pub process_noise: Vec<(String, f64)>,
    /// How old samples lose their weight.
    pub forgetting: Forgetting,
    /// The behaviour of inputs between samples: linear or held.
    pub interpolation: Interpolation,
    /// The Runge-Kutta method.
    pub integrator: Integrator,
    /// Its steps between two samples.
    pub substeps: usize,
    /// The longest time without a sample, s; longer ones are an error.
    pub max_gap: f64,
    /// The time for a sample: no further iteration begins that would take longer.
    pub deadline: Option<Duration>,
    /// The test whether the model still holds.
    pub detect: Option<Detect>,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            window: 1,
            first_window: 0,
            iterations: 3,
            tolerance: 1e-3,
            sigmas: Vec::new(),
            estimate_noise: false,
            noise_weight: 20.0,
            parameters: Vec::new(),
            initial: Vec::new(),
            process_noise: Vec::new(),
            forgetting: Forgetting::None,
            interpolation: Interpolation::Linear,
            integrator: Integrator::Rk4,
            substeps: 1,
            max_gap: f64::INFINITY,
            deadline: None,
            detect: None,
        }
    }
}

impl Settings {
    setters! {
        window: usize, first_window: usize, iterations: usize, tolerance: f64, estimate_noise: bool, noise_weight: f64,
        forgetting: Forgetting, interpolation: Interpolation, integrator: Integrator, substeps: usize, max_gap: f64;
        into deadline: Option<Duration>, into detect: Option<Detect>
    }

    /// Gives the standard deviation of the noise of an output.
    #[must_use]
    pub fn sigma(mut self, output: &str, value: f64) -> Self {
        self.sigmas.push((output.to_owned(), value));
        self
    }

    /// Gives the standard deviation of the start value of a parameter.
    #[must_use]
    pub fn parameter(mut self, name: &str, deviation: f64) -> Self {
        self.parameters.push((name.to_owned(), deviation));
        self
    }

    /// Gives an initial state with its standard deviation.
    #[must_use]
    pub fn initial(mut self, state: &str, value: f64, deviation: f64) -> Self {
        self.initial.push((state.to_owned(), value, deviation));
        self
    }

    /// Gives the process noise of a state.
    #[must_use]
    pub fn process_noise(mut self, state: &str, deviation: f64) -> Self {
        self.process_noise.push((state.to_owned(), deviation));
        self
    }
}
