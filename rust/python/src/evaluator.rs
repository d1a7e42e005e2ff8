//! f and g of a model at points.

use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use phugoid::Error;
use phugoid::internals::evaluator::Evaluator;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::raise;
use crate::model::PyModel;

/// The state equations and outputs of a model, compiled.
#[pyclass(name = "Evaluator", module = "phugoid._core", frozen)]
pub struct PyEvaluator(Evaluator);

impl PyEvaluator {
    fn run<'py>(
        &self,
        py: Python<'py>,
        columns: &PyReadonlyArray2<'py, f64>,
        f: impl Fn(&[&[f64]]) -> Result<Vec<Vec<f64>>, Error>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let array = columns.as_array();
        if array.nrows() != self.0.columns() {
            let text = format!("{} columns were given, the model has {}", array.nrows(), self.0.columns());
            return Err(PyValueError::new_err(text));
        }
        let owned: Vec<Vec<f64>> = array.rows().into_iter().map(|r| r.to_vec()).collect();
        let rows: Vec<&[f64]> = owned.iter().map(Vec::as_slice).collect();
        PyArray2::from_vec2(py, &f(&rows).map_err(raise)?).map_err(|e| PyValueError::new_err(e.to_string()))
    }
}

#[pymethods]
impl PyEvaluator {
    #[new]
    fn new(model: &PyModel) -> PyResult<Self> {
        Evaluator::new(&model.0).map(PyEvaluator).map_err(raise)
    }

    /// x' at points, shape (n_x, n), from the rows time, inputs, states, each of n points.
    fn dynamics<'py>(
        &self,
        py: Python<'py>,
        parameters: PyReadonlyArray1<'py, f64>,
        columns: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let p = parameters.as_array().to_vec();
        self.run(py, &columns, |c| self.0.dynamics(&p, c))
    }

    /// y at points, shape (n_y, n).
    fn outputs<'py>(
        &self,
        py: Python<'py>,
        parameters: PyReadonlyArray1<'py, f64>,
        columns: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let p = parameters.as_array().to_vec();
        self.run(py, &columns, |c| self.0.outputs(&p, c))
    }
}
