//! The collocation problem.

use std::sync::Arc;

use phugoid::collocation::{Collocation, Settings};
use pyo3::prelude::*;

use crate::errors::raise;
use crate::model::PyModel;
use crate::noise::PyNoise;
use crate::problem::{GridSpec, Kept, PyProblem, Record, Transcription, experiment, grids};

/// Collocation; everything but its making is `Problem`'s.
#[pyclass(name = "Collocation", module = "phugoid._core", frozen, extends = PyProblem)]
pub struct PyCollocation;

#[pymethods]
impl PyCollocation {
    #[new]
    fn new(
        py: Python<'_>,
        model: &PyModel,
        experiments: Vec<Record<'_>>,
        noise: &PyNoise,
        order: usize,
        divisions: Vec<GridSpec>,
        threads: usize,
    ) -> PyResult<PyClassInitializer<Self>> {
        let records: Vec<_> = experiments.into_iter().map(experiment).collect::<PyResult<_>>()?;
        let settings = Settings::default().order(order).grid(grids(divisions)?).threads(threads);
        let settings = settings.noise_per_experiment(noise.per_experiment);
        let (model, noise) = (&model.0, noise.noise.clone());
        let problem = py.detach(|| Collocation::new(model, &records, noise, &settings)).map_err(raise)?;
        Ok(PyClassInitializer::from(PyProblem(Transcription::Collocation(
            Arc::new(problem),
            Kept::default(),
        )))
        .add_subclass(PyCollocation))
    }
}
