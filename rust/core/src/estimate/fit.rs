//! What an estimation gives back.

use std::fmt;
use std::ops::Index;

use super::{Refinement, Smoothing, Transcription};
use crate::error::did_you_mean;
use crate::experiment::Experiment;
use crate::model::Model;
use crate::noise::NoiseModel;
use crate::simulate::Simulation;
use crate::solver::{Solution, Status};

/// What keeps a parameter where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// Its lower bound.
    Lower,
    /// Its upper bound.
    Upper,
    /// It is fixed.
    Fixed,
}

impl fmt::Display for Bound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Bound::Lower => "at its lower bound",
            Bound::Upper => "at its upper bound",
            Bound::Fixed => "fixed",
        })
    }
}

/// An estimated quantity: a parameter, a standard deviation or an initial state.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Estimate {
    /// Name.
    pub name: String,
    /// Unit, as text; empty where unknown.
    pub unit: String,
    /// Value.
    pub value: f64,
    /// Standard error (Cramér-Rao); NaN where a bound keeps it or the data do not determine it.
    pub std_error: f64,
    /// Lower and upper bound.
    pub bounds: (f64, f64),
    /// What keeps it where it is, if anything.
    pub bound: Option<Bound>,
}

/// States, outputs and residuals of one experiment at its samples. Channels stand in the order of the
/// model's states and outputs; by name: [`Fit::state`], [`Fit::output`], [`Fit::residual`].
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Record {
    /// Name of the experiment.
    pub name: String,
    /// Sample times, s, N of them.
    pub t: Vec<f64>,
    /// n_x states of N samples.
    pub states: Vec<Vec<f64>>,
    /// n_y outputs of the model of N samples.
    pub outputs: Vec<Vec<f64>>,
    /// Measured less model outputs; NaN where a sample is missing.
    pub residuals: Vec<Vec<f64>>,
    /// The state at the first sample.
    pub initial: Vec<Estimate>,
    /// Times of the mesh on which the equations were solved, s.
    pub mesh_t: Vec<f64>,
    /// n_x states there.
    pub mesh_states: Vec<Vec<f64>>,
}

/// The result of an [`Estimation`](super::Estimation). It prints as a table.
///
/// ```
/// use phugoid::solver::Status;
/// use phugoid::{Estimation, Experiment, Model, Parameter};
///
/// let mut m = Model::new("fall");
/// let (h, v) = (m.state("h", "m")?, m.state("v", "m/s")?);
/// let g = m.parameter(Parameter::new("g", 0.0).unit("m/s²"))?;
/// m.equation("h", v)?;
/// m.equation("v", -g)?;
/// m.output("height", h, "")?;
///
/// let t: Vec<f64> = (0..40).map(|k| 0.05 * k as f64).collect();
/// let height = t.iter().map(|t| 20.0 - 0.5 * 9.81 * t * t + 0.01 * (1e4 * t).sin()).collect();
/// let fit = Estimation::new(&m, &[Experiment::new(&m, "drop", t, [("height", height)])?]).solve()?;
///
/// assert_eq!(fit.status, Status::Converged);
/// let g = &fit["g"];
/// assert!((g.value - 9.81).abs() < 4.0 * g.std_error && g.std_error < 0.02);
/// assert!(fit["sigma_height"].value < 0.01);
/// assert_eq!(fit.state(0, "v").unwrap().len(), 40);
/// println!("{fit}"); // status, parameters with standard errors, match of the outputs
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Fit {
    /// The model.
    pub model: Model,
    /// The noise.
    pub noise: NoiseModel,
    /// How it was transcribed.
    pub transcription: Transcription,
    /// The model's parameters, then the unknown standard deviations `sigma_<output>`; by name: `fit["CLa"]`.
    pub parameters: Vec<Estimate>,
    /// Covariance of the parameters in their order, row-major; NaN where there is no standard error.
    pub covariance: Vec<f64>,
    /// Of the measurements, without the constant −N n_y/2 ln 2π and without priors (Eq. ellz_defn).
    pub log_likelihood: f64,
    /// The same of the model integrated with the estimates, independent of the mesh: of a run by collocation that a limit cut,
    /// and where samples are few and the parameters tell the initial states; not of a model with delays, nor where the caller
    /// stopped it. NaN where the model cannot be integrated.
    pub integrated: Option<f64>,
    /// How it ended.
    pub status: Status,
    /// Whether the states satisfy the equations. Where a run ended elsewhere, log-likelihood and standard errors are NaN.
    pub feasible: bool,
    /// What that means, and what to do.
    pub message: String,
    /// Number of iterations.
    pub iterations: usize,
    /// One an experiment.
    pub records: Vec<Record>,
    /// What to beware of, in words.
    pub warnings: Vec<String>,
    /// Whether residuals are not those of noise that is known, which the first warning says.
    pub unlike_noise: bool,
    /// Number of parameters of the model and initial states that were estimated.
    pub unknowns: usize,
    /// What the solver gave back: all unknowns, multipliers, counts, the iteration table.
    pub solution: Solution,
    /// What mesh refinement did.
    pub refinement: Option<Refinement>,
    /// How kinks of the state equations were smoothed, where they had to be.
    pub smoothing: Option<Smoothing>,
    /// The fit that this one was made of, where delays are estimated or kinks were smoothed.
    pub moved: Option<Box<Moved>>,
}

/// A fit of a model at fixed delays to records that were moved by them, and of a model whose kinks are smooth.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Moved {
    /// The fit.
    pub fit: Fit,
    /// The moved records.
    pub experiments: Vec<Experiment>,
    /// Delays by name, s.
    pub base: Vec<(String, f64)>,
    /// How far they may move until the base follows, s.
    pub reach: f64,
}

impl Index<&str> for Fit {
    type Output = Estimate;

    /// # Panics
    /// When there is no parameter of this name; [`Fit::parameter`] does not.
    fn index(&self, name: &str) -> &Estimate {
        self.parameter(name).unwrap_or_else(|| {
            let hint = did_you_mean(name, self.parameters.iter().map(|p| p.name.as_str()));
            panic!("the fit has no parameter '{name}'.{hint}")
        })
    }
}

impl Fit {
    /// Sets the status, with what it says by default.
    pub(super) fn end_as(&mut self, status: Status) {
        (self.status, self.message) = (status, status.hint().into());
    }

    /// A parameter or standard deviation by name.
    pub fn parameter(&self, name: &str) -> Option<&Estimate> {
        self.parameters.iter().find(|p| p.name == name)
    }

    /// A state at the samples of an experiment.
    pub fn state(&self, experiment: usize, name: &str) -> Option<&[f64]> {
        let i = self.model.states.iter().position(|s| s.name == name)?;
        Some(&self.records.get(experiment)?.states[i])
    }

    /// The path of a state in an experiment: times of the mesh and values there.
    pub fn path(&self, experiment: usize, name: &str) -> Option<(&[f64], &[f64])> {
        let i = self.model.states.iter().position(|s| s.name == name)?;
        let record = self.records.get(experiment)?;
        Some((&record.mesh_t, &record.mesh_states[i]))
    }

    /// What the model says of an output at the samples of an experiment.
    pub fn output(&self, experiment: usize, name: &str) -> Option<&[f64]> {
        let i = self.model.outputs.iter().position(|o| o.name == name)?;
        Some(&self.records.get(experiment)?.outputs[i])
    }

    /// Measured less model output at the samples of an experiment; NaN where a sample is missing.
    pub fn residual(&self, experiment: usize, name: &str) -> Option<&[f64]> {
        let i = self.model.outputs.iter().position(|o| o.name == name)?;
        Some(&self.records.get(experiment)?.residuals[i])
    }
}

impl Simulation<'_> {
    /// Takes parameters and initial states from a fit; single ones given go before.
    pub fn fit(mut self, fit: &Fit) -> Self {
        self.known = fit.parameters.iter().map(|e| (e.name.clone(), e.value)).collect();
        let record = fit.records.iter().find(|r| r.name == self.experiment.name);
        let initial = record.into_iter().flat_map(|r| &r.initial);
        self.known_initial = initial.map(|e| (e.name.clone(), e.value)).collect();
        self
    }
}
