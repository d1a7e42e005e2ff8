//! How an estimation becomes a nonlinear program, and the program.

use std::sync::Arc;

use crate::collocation::{self, Collocation};
use crate::error::Error;
use crate::experiment::Experiment;
use crate::model::Model;
use crate::noise::Noise;
use crate::problem::Transcribed;
use crate::shooting::{Shooting, Shots};

/// A transcription with its options.
#[derive(Clone, Debug, PartialEq)]
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

impl Transcription {
    /// Whether it is collocation.
    pub fn is_collocation(&self) -> bool {
        matches!(self, Transcription::Collocation(_))
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
