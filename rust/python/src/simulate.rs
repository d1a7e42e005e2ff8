//! Simulations.

use numpy::PyArray1;
use phugoid::Simulation;
use phugoid::simulate::Method;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::raise;
use crate::interrupt::{interruptible, seconds};
use crate::model::{DelaySpec, PyModel};
use crate::problem::{Record, experiment};

type Channels<'py> = Vec<Bound<'py, PyArray1<f64>>>;

/// States and outputs at the samples of a record, from values of all parameters and states by name, of a model with these
/// delays. `time_limit` in s. Ctrl-C raises KeyboardInterrupt.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // as Python gives them
pub fn simulate<'py>(
    py: Python<'py>,
    model: &PyModel,
    delays: DelaySpec,
    record: Record<'py>,
    parameters: Vec<(String, f64)>,
    initial: Vec<(String, f64)>,
    method: &str,
    tolerance: f64,
    time_limit: Option<f64>,
) -> PyResult<(Channels<'py>, Channels<'py>)> {
    let run = experiment(record)?;
    let method = match method {
        "auto" => Method::Automatic,
        "DOP853" => Method::Explicit,
        "Radau" => Method::Implicit,
        _ => return Err(PyValueError::new_err(format!("unknown method '{method}'"))),
    };
    let model = model.late(delays);
    let mut simulation = Simulation::new(&model, &run).tolerance(tolerance).method(method);
    for (name, value) in &parameters {
        simulation = simulation.parameter(name, *value);
    }
    for (name, value) in &initial {
        simulation = simulation.initial(name, *value);
    }
    if let Some(limit) = seconds(time_limit) {
        simulation = simulation.time_limit(limit);
    }
    let path = interruptible(py, None, || simulation.run())?.map_err(raise)?;
    let arrays = |channels: Vec<Vec<f64>>| channels.into_iter().map(|c| PyArray1::from_vec(py, c)).collect();
    Ok((arrays(path.states), arrays(path.outputs)))
}
