//! Where an estimation starts.

use numpy::{PyArray1, PyReadonlyArray1};
use phugoid::estimate::{Given, Start};
use pyo3::prelude::*;

use crate::errors::raise;
use crate::model::PyModel;
use crate::problem::{Record, experiment};

type Array<'py> = Bound<'py, PyArray1<f64>>;

/// A start: a number, or for a state one value a sample in each experiment.
#[derive(FromPyObject)]
pub enum StartSpec<'py> {
    Value(f64),
    Paths(Vec<PyReadonlyArray1<'py, f64>>),
}

pub fn starts(given: Vec<(String, StartSpec<'_>)>) -> Vec<(String, Start)> {
    let one = |spec| match spec {
        StartSpec::Value(v) => Start::Value(v),
        StartSpec::Paths(paths) => Start::Paths(paths.iter().map(|p| p.as_array().to_vec()).collect()),
    };
    given.into_iter().map(|(name, spec)| (name, one(spec))).collect()
}

/// Raises ModelError for a name that is not a parameter, sigma or state, nor one of these of the noise.
#[pyfunction]
#[allow(clippy::needless_pass_by_value)]
pub fn check_start(
    model: &PyModel,
    names: Vec<String>,
    experiments: Vec<String>,
    noise: Vec<String>,
) -> PyResult<()> {
    let values: Vec<(String, Start)> = names.into_iter().map(|name| (name, Start::Value(0.0))).collect();
    let given = Given { model: &model.0, values: &values, earlier: None };
    given.check(experiments.iter().map(String::as_str), &noise).map_err(raise)
}

/// Starting values of the parameters of a model, those that each experiment has of its own as they are in this one.
#[pyfunction]
#[pyo3(signature = (model, given, experiment = None))]
pub fn parameter_start(
    model: &PyModel,
    given: Vec<(String, f64)>,
    experiment: Option<&str>,
) -> PyResult<Vec<f64>> {
    let values: Vec<(String, Start)> = given.into_iter().map(|(n, v)| (n, Start::Value(v))).collect();
    Given { model: &model.0, values: &values, earlier: None }.parameters(experiment).map_err(raise)
}

/// Starting states of an experiment at some times, one array a state.
#[pyfunction]
#[allow(clippy::needless_pass_by_value)]
pub fn state_start<'py>(
    py: Python<'py>,
    model: &PyModel,
    record: Record<'py>,
    times: PyReadonlyArray1<'py, f64>,
    parameters: Vec<f64>,
    given: Vec<(String, StartSpec<'py>)>,
) -> PyResult<Vec<Array<'py>>> {
    let (values, run) = (starts(given), experiment(record)?);
    let given = Given { model: &model.0, values: &values, earlier: None };
    let states = given.states(0, &run, times.as_slice()?, &parameters).map_err(raise)?;
    Ok(states.into_iter().map(|x| PyArray1::from_vec(py, x)).collect())
}
