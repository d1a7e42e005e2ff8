//! Where an estimation starts.

use numpy::{PyArray1, PyReadonlyArray1};
use phugoid::error::Error;
use phugoid::estimate::{Given, Start, point};
use phugoid::interpolate::{Interpolation, interpolate};
use pyo3::prelude::*;

use crate::errors::raise;
use crate::model::PyModel;
use crate::problem::{PyProblem, Record, experiment};

type Array<'py> = Bound<'py, PyArray1<f64>>;
/// Times and values of a path of an earlier fit.
type Path<'py> = (PyReadonlyArray1<'py, f64>, PyReadonlyArray1<'py, f64>);

/// A start: a number, or for a state one value a sample in each experiment.
#[derive(FromPyObject)]
pub enum StartSpec<'py> {
    Value(f64),
    Paths(Vec<PyReadonlyArray1<'py, f64>>),
}

fn starts(given: Vec<(String, StartSpec<'_>)>) -> Vec<(String, Start)> {
    let one = |spec| match spec {
        StartSpec::Value(v) => Start::Value(v),
        StartSpec::Paths(paths) => Start::Paths(paths.iter().map(|p| p.as_array().to_vec()).collect()),
    };
    given.into_iter().map(|(name, spec)| (name, one(spec))).collect()
}

/// Raises ModelError for a name that is no parameter, sigma or state, nor one of these of the noise.
#[pyfunction]
#[allow(clippy::needless_pass_by_value)]
pub fn check_start(
    model: &PyModel,
    names: Vec<String>,
    experiments: Vec<String>,
    noise: Vec<String>,
) -> PyResult<()> {
    let values: Vec<(String, Start)> = names.into_iter().map(|name| (name, Start::Value(0.0))).collect();
    let given = Given { model: &model.0, values: &values, fit: None };
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
    Given { model: &model.0, values: &values, fit: None }.parameters(experiment).map_err(raise)
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
    let given = Given { model: &model.0, values: &values, fit: None };
    let states = given.states(0, &run, times.as_slice()?, &parameters).map_err(raise)?;
    Ok(states.into_iter().map(|x| PyArray1::from_vec(py, x)).collect())
}

/// The variables of a problem to start from. `paths` are those of an earlier fit, for each experiment one a state, which
/// take the place of the states as they would start.
#[pyfunction]
#[allow(clippy::needless_pass_by_value)]
pub fn start_point<'py>(
    py: Python<'py>,
    problem: &PyProblem,
    model: &PyModel,
    records: Vec<Record<'py>>,
    given: Vec<(String, StartSpec<'py>)>,
    paths: Vec<Vec<Option<Path<'py>>>>,
) -> PyResult<Array<'py>> {
    let runs: Vec<_> = records.into_iter().map(experiment).collect::<PyResult<_>>()?;
    let values = starts(given);
    let given = Given { model: &model.0, values: &values, fit: None };
    let shared = given.parameters(None).map_err(raise)?;
    let own = runs.iter().map(|run| given.parameters(Some(&run.name)));
    let own: Vec<Vec<f64>> = own.collect::<Result<_, Error>>().map_err(raise)?;
    let states = |e: usize, times: &[f64]| {
        let mut states = given.states(e, &runs[e], times, &own[e])?;
        for (state, path) in states.iter_mut().zip(paths.get(e).into_iter().flatten()) {
            if let Some((t, x)) = path {
                let (t, x) = (t.as_array().to_vec(), x.as_array().to_vec());
                *state = interpolate(Interpolation::Cubic, &t, &x, times);
            }
        }
        Ok(states)
    };
    point(problem.inner(), &shared, &own, states).map(|xi| PyArray1::from_vec(py, xi)).map_err(raise)
}

/// The points to start from in place of `xi` where that makes no sense.
#[pyfunction]
#[allow(clippy::needless_pass_by_value)]
pub fn further_starts<'py>(
    py: Python<'py>,
    problem: &PyProblem,
    model: &PyModel,
    xi: PyReadonlyArray1<'py, f64>,
    parameters: Vec<f64>,
    known: Vec<String>,
) -> PyResult<Vec<Array<'py>>> {
    let values: Vec<(String, Start)> = known.into_iter().map(|name| (name, Start::Value(0.0))).collect();
    let given = Given { model: &model.0, values: &values, fit: None };
    let (nlp, xi) = (problem.inner(), xi.as_slice()?);
    let found = py.detach(|| given.elsewhere(nlp, xi, &parameters));
    Ok(found.into_iter().map(|xi| PyArray1::from_vec(py, xi)).collect())
}
