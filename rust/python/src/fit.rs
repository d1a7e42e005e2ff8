//! What an estimation gives back.

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use phugoid::estimate::{Bound as Limit, Estimate, Fit};
use pyo3::prelude::*;

use crate::newton::PySolution;

/// An estimate: name, value, standard error, unit, bounds, and "lower", "upper" or "fixed" for what keeps it.
type Estimated = (String, f64, f64, String, (f64, f64), Option<&'static str>);

type Array<'py> = Bound<'py, PyArray1<f64>>;

/// Estimates with standard errors, time histories and warnings at the end of an estimation.
#[pyclass(name = "Fit", module = "phugoid._core", frozen)]
pub struct PyFit(pub Fit);

fn estimated(e: &Estimate) -> Estimated {
    let kept = e.bound.map(|b| match b {
        Limit::Lower => "lower",
        Limit::Upper => "upper",
        Limit::Fixed => "fixed",
    });
    (e.name.clone(), e.value, e.std_error, e.unit.clone(), e.bounds, kept)
}

fn arrays<'py>(py: Python<'py>, channels: &[Vec<f64>]) -> Vec<Array<'py>> {
    channels.iter().map(|c| PyArray1::from_slice(py, c)).collect()
}

#[pymethods]
impl PyFit {
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

    /// Number of iterations, of all passes.
    #[getter]
    fn iterations(&self) -> usize {
        self.0.iterations
    }

    /// Where the solver ended.
    #[getter]
    fn solution(&self) -> PySolution {
        PySolution(self.0.solution.clone())
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
