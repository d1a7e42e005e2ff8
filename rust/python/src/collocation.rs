//! The collocation problem.

use phugoid::transcription::{Collocation, Settings};
use pyo3::prelude::*;

use crate::errors::raise;
use crate::model::PyModel;
use crate::problem::{GridSpec, PyProblem, Record, SigmaSpec, grids, noise, records};

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
        sigmas: Vec<SigmaSpec>,
        order: usize,
        divisions: Vec<GridSpec>,
        threads: usize,
    ) -> PyResult<PyClassInitializer<Self>> {
        let (records, noise) = (records(experiments), noise(sigmas));
        let settings = Settings { order, grid: grids(divisions)?, threads };
        let model = &model.0;
        let problem = py.detach(|| Collocation::new(model, &records, noise, &settings)).map_err(raise)?;
        Ok(PyClassInitializer::from(PyProblem(Box::new(problem))).add_subclass(PyCollocation))
    }
}
