//! The options of shooting.

use crate::integrate::steps::Steps;
use crate::integrate::tableau::Integrator;
use crate::mesh::Grid;
use crate::setters::setters;

/// The options of a transcription by shooting.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Shots {
    /// Division into segments, one an experiment, or one for all. A single segment is single shooting.
    pub grid: Vec<Grid>,
    /// The Runge-Kutta method.
    pub integrator: Integrator,
    /// Its steps.
    pub steps: Steps,
    /// Threads; 0 for as many as there are cores.
    pub threads: usize,
    /// Whether each experiment has noise of its own.
    pub noise_per_experiment: bool,
}

impl Shots {
    setters! {
        grid: Vec<Grid>, integrator: Integrator, steps: Steps, threads: usize, noise_per_experiment: bool;
    }
}

impl Default for Shots {
    /// Single shooting with a step of RK4 from sample to sample.
    fn default() -> Self {
        Shots {
            grid: vec![Grid::Uniform(1)],
            integrator: Integrator::Rk4,
            steps: Steps::Samples(1),
            threads: 0,
            noise_per_experiment: false,
        }
    }
}
