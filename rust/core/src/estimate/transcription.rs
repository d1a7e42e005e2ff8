//! How an estimation becomes a nonlinear program, and the program.

use std::sync::Arc;

use crate::collocation::{self, Collocation};
use crate::error::Error;
use crate::experiment::Experiment;
use crate::mesh::Grid;
use crate::model::Model;
use crate::noise::Noise;
use crate::problem::Transcribed;
use crate::shooting::{Shooting, Shots};

/// A transcription with its options.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Transcription {
    /// By collocation.
    Collocation(collocation::Settings),
    /// By single or multiple shooting.
    Shooting(Shots),
}

impl Default for Transcription {
    fn default() -> Self {
        Transcription::Collocation(collocation::Settings::default())
    }
}

impl From<collocation::Settings> for Transcription {
    fn from(settings: collocation::Settings) -> Self {
        Transcription::Collocation(settings)
    }
}

impl From<Shots> for Transcription {
    fn from(shots: Shots) -> Self {
        Transcription::Shooting(shots)
    }
}

impl Transcription {
    /// Whether it is collocation.
    pub fn is_collocation(&self) -> bool {
        matches!(self, Transcription::Collocation(_))
    }

    /// Returns the options of collocation; where it is shooting, the usual ones on its threads.
    pub(super) fn collocation(&self) -> collocation::Settings {
        match self {
            Transcription::Collocation(settings) => settings.clone(),
            Transcription::Shooting(shots) => collocation::Settings::default().threads(shots.threads),
        }
    }

    /// Returns the number of threads; 0 for as many as there are cores.
    pub(super) fn threads(&self) -> usize {
        match self {
            Transcription::Collocation(settings) => settings.threads,
            Transcription::Shooting(shots) => shots.threads,
        }
    }

    pub(super) fn threads_mut(&mut self) -> &mut usize {
        match self {
            Transcription::Collocation(settings) => &mut settings.threads,
            Transcription::Shooting(shots) => &mut shots.threads,
        }
    }

    pub(super) fn grids_mut(&mut self) -> &mut Vec<Grid> {
        match self {
            Transcription::Collocation(settings) => &mut settings.grid,
            Transcription::Shooting(shots) => &mut shots.grid,
        }
    }

    /// The nonlinear program.
    pub(super) fn pose(
        &self,
        model: &Model,
        experiments: &[Experiment],
        noise: Noise,
        noise_per_experiment: bool,
    ) -> Result<Problem, Error> {
        Ok(match self {
            Transcription::Collocation(settings) => {
                let settings = collocation::Settings { noise_per_experiment, ..settings.clone() };
                Problem::Collocation(Arc::new(Collocation::new(model, experiments, noise, &settings)?))
            }
            Transcription::Shooting(shots) => {
                let noise_per_experiment = shots.noise_per_experiment || noise_per_experiment;
                let settings = Shots { noise_per_experiment, ..shots.clone() };
                Problem::Shooting(Arc::new(Shooting::new(model, experiments, noise, &settings)?))
            }
        })
    }
}

/// A transcribed problem, which a solver of one's own may keep.
#[derive(Clone, Debug)]
pub enum Problem {
    /// By collocation.
    Collocation(Arc<Collocation>),
    /// By shooting.
    Shooting(Arc<Shooting>),
}

impl Problem {
    /// The problem as what is made of its solutions sees it.
    pub fn transcribed(&self) -> &dyn Transcribed {
        match self {
            Problem::Collocation(problem) => &**problem,
            Problem::Shooting(problem) => &**problem,
        }
    }
}
