//! The marginal likelihood of the filter-error method.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1};
use phugoid::filter::{Filter, Settings};
use phugoid::noise::Noise;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::raise;
use crate::model::PyModel;
use crate::noise::{SigmaSpec, sigma};
use crate::problem::{Record, experiment};

type Array<'py> = Bound<'py, PyArray1<f64>>;
type Matrix<'py> = Bound<'py, PyArray2<f64>>;

/// Log-likelihood, gradient, path, Newton iterations.
type Value<'py> = (f64, Array<'py>, Array<'py>, usize);

/// A value, or why there is none.
#[derive(IntoPyObject)]
pub enum Outcome<'py> {
    Found(Value<'py>),
    Lost(String),
}

/// States, their deviations, outputs, innovations, their deviations, covariance of the first state, how it
/// follows the parameters.
type Smooth<'py> = (Matrix<'py>, Matrix<'py>, Matrix<'py>, Matrix<'py>, Matrix<'py>, Array<'py>, Array<'py>);

/// The marginal likelihood, evaluated without the interpreter lock.
#[pyclass(name = "Filter", module = "phugoid._core", frozen)]
pub struct PyFilter(Filter);

impl PyFilter {
    fn slices<'a>(
        &self,
        theta: &'a PyReadonlyArray1<'_, f64>,
        path: &'a PyReadonlyArray1<'_, f64>,
    ) -> PyResult<(&'a [f64], &'a [f64])> {
        let (theta, path) = (theta.as_slice()?, path.as_slice()?);
        if theta.len() != self.0.n_theta() || path.len() != self.0.path_length() {
            return Err(PyValueError::new_err("theta or path has the wrong length"));
        }
        Ok((theta, path))
    }
}

#[pymethods]
impl PyFilter {
    #[new]
    #[allow(clippy::too_many_arguments)] // options, all by name in the core
    fn new(
        py: Python<'_>,
        model: &PyModel,
        experiments: Vec<Record<'_>>,
        sigmas: Vec<SigmaSpec>,
        states: Vec<String>,
        substeps: usize,
        halves: bool,
        initial: Vec<Option<(f64, f64)>>,
    ) -> PyResult<Self> {
        let records: Vec<_> = experiments.into_iter().map(experiment).collect();
        let noise = Noise::Gaussian(sigmas.into_iter().map(sigma).collect());
        let settings = Settings { states, substeps, halves, initial };
        let model = &model.0;
        py.detach(|| Filter::new(model, &records, &noise, &settings)).map(PyFilter).map_err(raise)
    }

    /// Names of the parameters: the model's, then 1/σ of outputs, then q of states.
    #[getter]
    fn parameters(&self) -> Vec<String> {
        self.0.parameters.clone()
    }

    /// A path to start from, from the states at all samples, one row of n_x after the other.
    fn start<'py>(&self, py: Python<'py>, states: PyReadonlyArray1<'_, f64>) -> PyResult<Array<'py>> {
        let samples: usize = self.0.lengths().iter().sum();
        let states = states.as_slice()?;
        if samples == 0 || states.len() % samples != 0 {
            return Err(PyValueError::new_err("states has the wrong length"));
        }
        Ok(PyArray1::from_vec(py, self.0.start(states)))
    }

    /// The marginal log-likelihood; a text that says why where there is none.
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        theta: PyReadonlyArray1<'_, f64>,
        path: PyReadonlyArray1<'_, f64>,
        gradient: bool,
    ) -> PyResult<Outcome<'py>> {
        let (theta, path) = self.slices(&theta, &path)?;
        Ok(match py.detach(|| self.0.evaluate(theta, path, gradient)) {
            Ok(m) => Outcome::Found((
                m.log_likelihood,
                PyArray1::from_vec(py, m.gradient),
                PyArray1::from_vec(py, m.path),
                m.iterations,
            )),
            Err(lost) => Outcome::Lost(self.0.explain(lost)),
        })
    }

    /// Expected information of the model's parameters, one row after the other; None where there is none.
    fn information<'py>(
        &self,
        py: Python<'py>,
        theta: PyReadonlyArray1<'_, f64>,
        path: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Option<Array<'py>>> {
        let (theta, path) = self.slices(&theta, &path)?;
        Ok(py.detach(|| self.0.information(theta, path)).ok().map(|v| PyArray1::from_vec(py, v)))
    }

    /// Each record smoothed; None where there is no path.
    fn smooth<'py>(
        &self,
        py: Python<'py>,
        theta: PyReadonlyArray1<'_, f64>,
        path: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Option<Vec<Smooth<'py>>>> {
        let (theta, path) = self.slices(&theta, &path)?;
        let Ok(records) = py.detach(|| self.0.smooth(theta, path)) else { return Ok(None) };
        let matrix = |rows: &Vec<Vec<f64>>| {
            PyArray2::from_vec2(py, rows).map_err(|e| PyValueError::new_err(e.to_string()))
        };
        let one = |s: &phugoid::filter::Smoothed| {
            Ok((
                matrix(&s.states)?,
                matrix(&s.deviations)?,
                matrix(&s.outputs)?,
                matrix(&s.innovations.values)?,
                matrix(&s.innovations.deviations)?,
                PyArray1::from_slice(py, &s.first_covariance),
                PyArray1::from_slice(py, &s.first_follows),
            ))
        };
        records.iter().map(one).collect::<PyResult<Vec<_>>>().map(Some)
    }
}
