//! Noise models.

use phugoid::Model;
use phugoid::estimate::{Given, Start, resolved};
use phugoid::noise::{Noise, NoiseModel, Sigma};
use pyo3::prelude::*;

use crate::errors::raise;

/// σ of an output: (known, value or start, lower, upper).
pub type SigmaSpec = (bool, f64, f64, f64);

/// The distribution of the measurement noise, all numbers resolved.
#[pyclass(name = "Noise", module = "phugoid._core", frozen)]
pub struct PyNoise {
    pub noise: Noise,
    /// Whether each experiment has its own.
    pub per_experiment: bool,
}

/// A σ of the core.
pub fn sigma((known, value, lower, upper): SigmaSpec) -> Sigma {
    if known { Sigma::Known(value) } else { Sigma::Unknown { start: value, lower, upper } }
}

#[pymethods]
impl PyNoise {
    /// From noise as it is saved, of a model with these outputs, with the standard deviations of their measurements, and
    /// starts by name.
    #[new]
    #[allow(clippy::needless_pass_by_value)]
    fn new(text: &str, outputs: Vec<String>, spreads: Vec<f64>, start: Vec<(String, f64)>) -> PyResult<Self> {
        let outputs: Vec<&str> = outputs.iter().map(String::as_str).collect();
        let declared = NoiseModel::from_json(text, &outputs).map_err(raise)?;
        let values: Vec<(String, Start)> = start.into_iter().map(|(n, v)| (n, Start::Value(v))).collect();
        let given = Given { model: &Model::new(""), values: &values, earlier: None };
        let noise = resolved(&declared, &outputs, &spreads, &given).map_err(raise)?;
        noise.check(&outputs).map_err(raise)?;
        Ok(PyNoise { noise, per_experiment: declared.per_experiment })
    }

    /// Standard deviations of independent Gaussian noise: known?, value or start, lower and upper bound.
    #[getter]
    fn sigmas(&self) -> Vec<SigmaSpec> {
        let Noise::Gaussian(sigmas) = &self.noise else { return Vec::new() };
        let one = |sigma: &Sigma| match *sigma {
            Sigma::Known(v) => (true, v, v, v),
            Sigma::Unknown { start, lower, upper } => (false, start, lower, upper),
            Sigma::Expression(_) => (true, f64::NAN, f64::NAN, f64::NAN),
        };
        sigmas.iter().map(one).collect()
    }
}
