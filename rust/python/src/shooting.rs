//! The shooting problem.

use std::sync::Arc;

use phugoid::shooting::{Integrator, Steps};
use phugoid::shooting::{Shooting, Shots};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::raise;
use crate::model::PyModel;
use crate::noise::PyNoise;
use crate::problem::{GridSpec, PyProblem, Record, Transcription, experiment, grids};

/// Steps: ("samples", n), ("number", n) or ("length", h).
pub type StepSpec = (String, f64);

/// Steps of the core.
pub fn core_steps((kind, n): &StepSpec) -> PyResult<Steps> {
    match kind.as_str() {
        "samples" => Ok(Steps::Samples(*n as usize)),
        "number" => Ok(Steps::Number(*n as usize)),
        "length" => Ok(Steps::Length(*n)),
        _ => Err(PyValueError::new_err("unknown kind of steps")),
    }
}

/// Single or multiple shooting; everything but its making is `Problem`'s.
#[pyclass(name = "Shooting", module = "phugoid._core", frozen, extends = PyProblem)]
pub struct PyShooting;

#[pymethods]
impl PyShooting {
    #[new]
    #[allow(clippy::too_many_arguments)] // options, from one call in Python
    fn new(
        py: Python<'_>,
        model: &PyModel,
        experiments: Vec<Record<'_>>,
        noise: &PyNoise,
        divisions: Vec<GridSpec>,
        integrator: &str,
        steps: StepSpec,
        threads: usize,
    ) -> PyResult<PyClassInitializer<Self>> {
        let records: Vec<_> = experiments.into_iter().map(experiment).collect::<PyResult<_>>()?;
        let unknown = || PyValueError::new_err("unknown integrator");
        let integrator = Integrator::from_name(integrator).ok_or_else(unknown)?;
        let settings =
            Shots::default().grid(grids(divisions)?).integrator(integrator).steps(core_steps(&steps)?);
        let settings = settings.threads(threads).noise_per_experiment(noise.per_experiment);
        let (model, noise) = (&model.0, noise.noise.clone());
        let problem = py.detach(|| Shooting::new(model, &records, noise, &settings)).map_err(raise)?;
        Ok(PyClassInitializer::from(PyProblem(Transcription::Shooting(Arc::new(problem))))
            .add_subclass(PyShooting))
    }
}
