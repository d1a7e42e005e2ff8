//! What the end of a run is worth.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use phugoid::estimate::{Assessment, Bound as Limit, End, Estimate};
use phugoid::interrupt::Interrupt;
use phugoid::model::Scaling;
use phugoid::solver::Status;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::interrupt::{seconds, watched};
use crate::model::PyModel;
use crate::problem::{PyProblem, Record, experiment};

/// An estimate: name, value, standard error, unit, and "lower", "upper" or "fixed" for what keeps it.
type Estimated = (String, f64, f64, String, Option<&'static str>);

/// A scaling of which a parameter was held: exponents by name, the parameter, its value.
type Held = (Vec<(String, f64)>, String, f64);

type Array<'py> = Bound<'py, PyArray1<f64>>;

/// Estimates with standard errors, time histories and warnings at the end of a run.
#[pyclass(name = "Assessment", module = "phugoid._core", frozen)]
pub struct PyAssessment(Assessment);

fn estimated(e: &Estimate) -> Estimated {
    let kept = e.bound.map(|b| match b {
        Limit::Lower => "lower",
        Limit::Upper => "upper",
        Limit::Fixed => "fixed",
    });
    (e.name.clone(), e.value, e.std_error, e.unit.clone(), kept)
}

fn arrays<'py>(py: Python<'py>, channels: &[Vec<f64>]) -> Vec<Array<'py>> {
    channels.iter().map(|c| PyArray1::from_slice(py, c)).collect()
}

/// Assesses where a solver ended: status and message as it gave them, whether it keeps away from bounds, and the
/// scalings of which it held a parameter (exponents by name, the parameter, its value). Standard errors are computed for
/// `time_limit` seconds at most, until `stop` says so or Ctrl-C is pressed; a warning says where there are none.
#[pyfunction]
#[pyo3(signature = (problem, model, records, xi, multipliers, status, message, interior, scalings, time_limit, stop))]
#[allow(clippy::too_many_arguments, clippy::needless_pass_by_value)] // all by name in Python
pub fn assess(
    py: Python<'_>,
    problem: &PyProblem,
    model: &PyModel,
    records: Vec<Record<'_>>,
    xi: PyReadonlyArray1<'_, f64>,
    multipliers: PyReadonlyArray1<'_, f64>,
    status: &str,
    message: String,
    interior: bool,
    scalings: Vec<Held>,
    time_limit: Option<f64>,
    stop: Option<Py<PyAny>>,
) -> PyResult<PyAssessment> {
    let (nlp, xi, multipliers) = (problem.inner(), xi.as_slice()?, multipliers.as_slice()?);
    let experiments: Vec<_> = records.into_iter().map(experiment).collect::<PyResult<_>>()?;
    if (xi.len(), multipliers.len()) != (nlp.n(), nlp.m()) {
        return Err(PyValueError::new_err(format!(
            "the problem has {} unknowns and {} equations",
            nlp.n(),
            nlp.m()
        )));
    }
    let known = Status::ALL.into_iter().find(|s| s.to_string() == status);
    let status = known.ok_or_else(|| PyValueError::new_err(format!("unknown status '{status}'")))?;
    let scalings: Vec<Scaling> =
        scalings.into_iter().map(|(exponents, held, at)| Scaling { exponents, held, at }).collect();
    let end = End { xi, multipliers, status, message, interior, scalings: &scalings };
    let (limit, model) = (seconds(time_limit), &model.0);
    let work = || Assessment::new(model, &experiments, nlp, &end, &Interrupt::within(limit));
    let (found, error) = watched(py, stop.as_ref(), |_| work());
    let interrupt = |e: &PyErr| e.is_instance_of::<pyo3::exceptions::PyKeyboardInterrupt>(py);
    match error.filter(|e| !interrupt(e)) {
        Some(error) => Err(error),
        None => Ok(PyAssessment(found)),
    }
}

#[pymethods]
impl PyAssessment {
    /// Parameters of the model, then those of the noise.
    #[getter]
    fn parameters(&self) -> Vec<Estimated> {
        self.0.parameters.iter().map(estimated).collect()
    }

    /// For each experiment, the states at the first sample.
    #[getter]
    fn initial(&self) -> Vec<Vec<Estimated>> {
        self.0.records.iter().map(|r| r.initial.iter().map(estimated).collect()).collect()
    }

    /// Covariance of the parameters in their order, (n, n).
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let n = self.0.parameters.len();
        PyArray1::from_slice(py, &self.0.covariance).reshape([n, n])
    }

    #[getter]
    fn log_likelihood(&self) -> f64 {
        self.0.log_likelihood
    }

    #[getter]
    fn feasible(&self) -> bool {
        self.0.feasible
    }

    #[getter]
    fn status(&self) -> String {
        self.0.status.to_string()
    }

    #[getter]
    fn message(&self) -> &str {
        &self.0.message
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.0.warnings.clone()
    }

    /// Number of parameters of the model and initial states that were estimated.
    #[getter]
    fn unknowns(&self) -> usize {
        self.0.unknowns
    }

    /// Of an experiment: states, outputs and residuals at its samples, times of the mesh and states there.
    #[allow(clippy::type_complexity)] // a tuple for Python
    fn record<'py>(
        &self,
        py: Python<'py>,
        index: usize,
    ) -> (Vec<Array<'py>>, Vec<Array<'py>>, Vec<Array<'py>>, Array<'py>, Vec<Array<'py>>) {
        let r = &self.0.records[index];
        let mesh = PyArray1::from_slice(py, &r.mesh_t);
        (
            arrays(py, &r.states),
            arrays(py, &r.outputs),
            arrays(py, &r.residuals),
            mesh,
            arrays(py, &r.mesh_states),
        )
    }
}
