//! The marginal likelihood of the filter-error method.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1};
use phugoid::filter::{Filter, Lost, Settings, Smoothed};
use phugoid::interrupt::Interrupt;
use phugoid::noise::Noise;
use pyo3::exceptions::{PyTimeoutError, PyValueError};
use pyo3::prelude::*;

use crate::errors::raise;
use crate::interrupt::{interruptible, seconds};
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

/// States, outputs, innovations and predicted states, each with its deviations; covariance of the initial state, how it
/// follows the parameters.
type Smooth<'py> = ([Pair<'py>; 4], Array<'py>, Array<'py>);

/// Values and deviations, or states and outputs.
type Pair<'py> = (Matrix<'py>, Matrix<'py>);

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

fn matrix<'py>(py: Python<'py>, rows: &[Vec<f64>]) -> PyResult<Matrix<'py>> {
    PyArray2::from_vec2(py, rows).map_err(|e| PyValueError::new_err(e.to_string()))
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
        terms: usize,
        initial: Vec<Option<(f64, f64)>>,
    ) -> PyResult<Self> {
        let records: Vec<_> = experiments.into_iter().map(experiment).collect::<PyResult<_>>()?;
        let noise = Noise::Gaussian(sigmas.into_iter().map(sigma).collect());
        let settings = Settings { states, substeps, terms, initial };
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

    /// The states of a path, as `start` takes them.
    fn states<'py>(&self, py: Python<'py>, path: PyReadonlyArray1<'_, f64>) -> PyResult<Array<'py>> {
        let path = path.as_slice()?;
        if path.len() != self.0.path_length() {
            return Err(PyValueError::new_err("path has the wrong length"));
        }
        Ok(PyArray1::from_vec(py, self.0.states(path)))
    }

    /// The marginal log-likelihood; a text that says why where there is none. Ctrl-C raises KeyboardInterrupt; more than
    /// `time_limit` seconds raise TimeoutError.
    #[pyo3(signature = (theta, path, gradient, time_limit = None))]
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        theta: PyReadonlyArray1<'_, f64>,
        path: PyReadonlyArray1<'_, f64>,
        gradient: bool,
        time_limit: Option<f64>,
    ) -> PyResult<Outcome<'py>> {
        let (theta, path) = self.slices(&theta, &path)?;
        Ok(match limited(py, time_limit, || self.0.evaluate(theta, path, gradient))? {
            Ok(m) => Outcome::Found((
                m.log_likelihood,
                PyArray1::from_vec(py, m.gradient),
                PyArray1::from_vec(py, m.path),
                m.iterations,
            )),
            Err(lost) => Outcome::Lost(self.0.explain(lost)),
        })
    }

    /// Expected information of the model's parameters, one row after the other; None where there is none. Ends early as
    /// `evaluate` does.
    #[pyo3(signature = (theta, path, time_limit = None))]
    fn information<'py>(
        &self,
        py: Python<'py>,
        theta: PyReadonlyArray1<'_, f64>,
        path: PyReadonlyArray1<'_, f64>,
        time_limit: Option<f64>,
    ) -> PyResult<Option<Array<'py>>> {
        let (theta, path) = self.slices(&theta, &path)?;
        let found = limited(py, time_limit, || self.0.information(theta, path))?;
        Ok(found.ok().map(|v| PyArray1::from_vec(py, v)))
    }

    /// Number of noises of an interval.
    #[getter]
    fn noises(&self) -> usize {
        self.0.noises()
    }

    /// States and outputs of each record from initial states, with noises in standard deviations.
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        theta: PyReadonlyArray1<'_, f64>,
        first: PyReadonlyArray1<'_, f64>,
        noises: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Vec<Pair<'py>>> {
        let (theta, first, noises) = (theta.as_slice()?, first.as_slice()?, noises.as_slice()?);
        let (records, lengths) = (self.0.lengths().len(), self.0.lengths());
        let intervals: usize = lengths.iter().map(|n| n - 1).sum();
        let states = self.0.path_length() - intervals * self.0.noises();
        let n = states / (lengths.iter().sum::<usize>() + intervals);
        if theta.len() != self.0.n_theta()
            || first.len() != n * records
            || noises.len() != intervals * self.0.noises()
        {
            return Err(PyValueError::new_err("theta, first or noises has the wrong length"));
        }
        let found = py.detach(|| self.0.simulate(theta, first, noises));
        found.iter().map(|[x, y]| Ok((matrix(py, x)?, matrix(py, y)?))).collect()
    }

    /// Each record smoothed; None where there is no path. Ends early as `evaluate` does.
    #[pyo3(signature = (theta, path, time_limit = None))]
    fn smooth<'py>(
        &self,
        py: Python<'py>,
        theta: PyReadonlyArray1<'_, f64>,
        path: PyReadonlyArray1<'_, f64>,
        time_limit: Option<f64>,
    ) -> PyResult<Option<Vec<Smooth<'py>>>> {
        let (theta, path) = self.slices(&theta, &path)?;
        let found = limited(py, time_limit, || self.0.smooth(theta, path))?;
        found.ok().map(|records| histories(py, &records)).transpose()
    }

    /// The states of a path as they are, and outputs there, as `smooth` gives them; NaN for what was not computed.
    fn unsmoothed<'py>(
        &self,
        py: Python<'py>,
        theta: PyReadonlyArray1<'_, f64>,
        path: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Vec<Smooth<'py>>> {
        let (theta, path) = self.slices(&theta, &path)?;
        histories(py, &py.detach(|| self.0.unsmoothed(theta, path)))
    }
}

/// Does work that Ctrl-C and a limit in seconds end: KeyboardInterrupt, TimeoutError.
fn limited<T: Send>(
    py: Python<'_>,
    time_limit: Option<f64>,
    work: impl FnOnce() -> Result<T, Lost> + Send,
) -> PyResult<Result<T, Lost>> {
    match interruptible(py, None, || Interrupt::within(seconds(time_limit)).run(work))? {
        Err(Lost::Stopped) => Err(PyTimeoutError::new_err("time limit")),
        found => Ok(found),
    }
}

fn histories<'py>(py: Python<'py>, records: &[Smoothed]) -> PyResult<Vec<Smooth<'py>>> {
    let pair = |a: &[Vec<f64>], b: &[Vec<f64>]| Ok::<_, PyErr>((matrix(py, a)?, matrix(py, b)?));
    let one = |s: &Smoothed| {
        Ok((
            [
                pair(&s.states, &s.deviations)?,
                pair(&s.outputs, &s.output_deviations)?,
                pair(&s.innovations.values, &s.innovations.deviations)?,
                pair(&s.innovations.states, &s.innovations.state_deviations)?,
            ],
            PyArray1::from_slice(py, &s.first_covariance),
            PyArray1::from_slice(py, &s.first_follows),
        ))
    };
    records.iter().map(one).collect()
}
