//! What one worker computes of an estimation from many records.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use phugoid::collocation::Settings;
use phugoid::fleet::{Detail, RecordResult, Share, Sums};
use phugoid::noise::NoiseModel;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::errors::raise;
use crate::fit::{Estimated, estimated};
use crate::interrupt::interruptible;
use crate::model::PyModel;
use crate::problem::{GridSpec, Record, experiment, grids};
use crate::start::{StartSpec, starts};

/// A worker's part of a fleet. `phugoid.fleet` wraps it.
#[pyclass(name = "Share", module = "phugoid._core")]
pub struct PyShare(Share);

#[pymethods]
impl PyShare {
    /// `mesh` is the order of a segment and the division into segments; `spreads` are standard deviations of the measurements of each output; `priors` tells whether those of shared
    /// parameters are to be counted here.
    #[new]
    #[allow(clippy::needless_pass_by_value)] // as Python gives them
    fn new(
        model: &PyModel,
        noise: &str,
        mesh: (usize, GridSpec),
        threads: usize,
        spreads: Vec<f64>,
        priors: bool,
    ) -> PyResult<Self> {
        let outputs: Vec<&str> = model.0.outputs.iter().map(|o| o.name.as_str()).collect();
        let noise = NoiseModel::from_json(noise, &outputs).map_err(raise)?;
        let settings = Settings::default().order(mesh.0).grid(grids(vec![mesh.1])?).threads(threads);
        let share = Share::new(&model.0, &noise).and_then(|s| s.transcription(settings)).map_err(raise)?;
        Ok(PyShare(share.spreads(spreads).priors(priors)))
    }

    /// Name, start and bounds of each shared variable.
    #[allow(clippy::type_complexity)] // tuples for Python
    fn variables(
        &mut self,
        record: Record<'_>,
        start: Vec<(String, StartSpec<'_>)>,
    ) -> PyResult<Vec<(String, f64, (f64, f64))>> {
        let found = self.0.variables(&experiment(record)?, &starts(start)).map_err(raise)?;
        Ok(found.into_iter().map(|v| (v.name, v.start, v.bounds)).collect())
    }

    /// Sums over records at values of the shared variables; `described` asks for a description of
    /// each record, `gauss_newton` for the Hessian of Gauss and Newton.
    fn evaluate<'py>(
        &mut self,
        py: Python<'py>,
        records: Vec<Record<'_>>,
        at: PyReadonlyArray1<'_, f64>,
        described: bool,
        gauss_newton: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let records: Vec<_> = records.into_iter().map(experiment).collect::<PyResult<_>>()?;
        let (share, at) = (&mut self.0, at.as_array().to_vec());
        let found = interruptible(py, None, || {
            let detail = Detail::default().described(described).gauss_newton(gauss_newton);
            share.evaluate_with(&records, &at, detail)
        })?;
        sums(py, found)
    }

    /// Sets the prior of a parameter of each record's own.
    fn population(&mut self, name: &str, mean: f64, std: f64) -> PyResult<()> {
        self.0.population(name, mean, std).map_err(raise)
    }

    /// Estimates and their covariance (n, n) in the user's terms, from values and covariance of the variables.
    fn report<'py>(
        &self,
        py: Python<'py>,
        record: Record<'_>,
        at: PyReadonlyArray1<'_, f64>,
        covariance: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<(Vec<Estimated>, Bound<'py, PyArray2<f64>>)> {
        let (at, covariance) = (at.as_array().to_vec(), covariance.as_array().to_vec());
        let (found, covariance) = self.0.report(&experiment(record)?, &at, &covariance).map_err(raise)?;
        let n = found.len();
        Ok((found.iter().map(estimated).collect(), PyArray1::from_vec(py, covariance).reshape([n, n])?))
    }

    /// Bytes that the paths of the records take.
    #[getter]
    fn bytes(&self) -> usize {
        self.0.bytes()
    }
}

fn sums(py: Python<'_>, sums: Sums) -> PyResult<Bound<'_, PyDict>> {
    let n = sums.gradient.len();
    let found = PyDict::new(py);
    found.set_item("value", sums.value)?;
    found.set_item("gradient", PyArray1::from_vec(py, sums.gradient))?;
    found.set_item("hessian", PyArray1::from_vec(py, sums.hessian).reshape([n, n])?)?;
    found.set_item("records", sums.records)?;
    found.set_item("samples", sums.samples)?;
    found.set_item("factorizations", sums.factorizations)?;
    let failures = sums.failures.into_iter().map(|f| (f.record, f.message, f.of_data));
    found.set_item("failures", failures.collect::<Vec<_>>())?;
    let results: Vec<_> = sums.results.iter().map(|r| result(py, r)).collect::<PyResult<_>>()?;
    found.set_item("results", PyList::new(py, results)?)?;
    Ok(found)
}

fn result<'py>(py: Python<'py>, of: &RecordResult) -> PyResult<Bound<'py, PyDict>> {
    let found = PyDict::new(py);
    found.set_item("name", &of.name)?;
    found.set_item("log_likelihood", of.log_likelihood)?;
    found.set_item("samples", of.samples)?;
    for (name, values) in [
        ("own", &of.own),
        ("own_errors", &of.own_errors),
        ("initial", &of.initial),
        ("gradient", &of.gradient),
        ("rms", &of.rms),
        ("correlation", &of.correlation),
    ] {
        found.set_item(name, values.clone())?;
    }
    Ok(found)
}
