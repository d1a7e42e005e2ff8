//! The shooting problem.

use phugoid::integrate::{Integrator, Steps};
use phugoid::shooting::{Shooting, Shots};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::raise;
use crate::model::PyModel;
use crate::noise::PyNoise;
use crate::problem::{GridSpec, PyProblem, Record, Transcription, experiment, grids};

/// Steps: ("samples", n), ("number", n) or ("length", h).
type StepSpec = (String, f64);

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
        let unknown = |what: &str| PyValueError::new_err(format!("unknown {what}"));
        let integrator = Integrator::from_name(integrator).ok_or_else(|| unknown("integrator"))?;
        let steps = match steps.0.as_str() {
            "samples" => Steps::Samples(steps.1 as usize),
            "number" => Steps::Number(steps.1 as usize),
            "length" => Steps::Length(steps.1),
            _ => return Err(unknown("kind of steps")),
        };
        let settings = Shots {
            grid: grids(divisions)?,
            integrator,
            steps,
            threads,
            noise_per_experiment: noise.per_experiment,
        };
        let (model, noise) = (&model.0, noise.noise.clone());
        let problem = py.detach(|| Shooting::new(model, &records, noise, &settings)).map_err(raise)?;
        Ok(PyClassInitializer::from(PyProblem(Transcription::Shooting(Box::new(problem))))
            .add_subclass(PyShooting))
    }
}
