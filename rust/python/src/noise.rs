//! Noise models.

use phugoid::model::Parameter;
use phugoid::noise::{Channel, Covariance, Custom, Density, Dof, Noise, Sigma};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::raise;
use crate::expr::Operand;

/// σ of an output: (known, value or start, lower, upper).
pub type SigmaSpec = (bool, f64, f64, f64);

/// A density: its kind, its numbers, and for one of the user's the expression and its parameters (name, start,
/// lower, upper).
type DensitySpec = (String, Vec<f64>, Option<Operand>, Vec<(String, f64, f64, f64)>);

/// The distribution of the measurement noise, all numbers resolved.
#[pyclass(name = "Noise", module = "phugoid._core", frozen)]
pub struct PyNoise {
    pub noise: Noise,
    /// Whether each experiment has its own.
    pub per_experiment: bool,
}

impl From<Noise> for PyNoise {
    fn from(noise: Noise) -> Self {
        PyNoise { noise, per_experiment: false }
    }
}

/// A σ of the core.
pub fn sigma((known, value, lower, upper): SigmaSpec) -> Sigma {
    if known { Sigma::Known(value) } else { Sigma::Unknown { start: value, lower, upper } }
}

fn density((kind, numbers, expression, parameters): DensitySpec) -> PyResult<Density> {
    match (kind.as_str(), &numbers[..], expression) {
        ("gaussian", [], None) => Ok(Density::Gaussian),
        ("student t", &[dof], None) => Ok(Density::StudentT(Dof::Known(dof))),
        ("student t", &[start, lower, upper], None) => {
            Ok(Density::StudentT(Dof::Unknown { start, lower, upper }))
        }
        ("huber", &[k], None) => Ok(Density::Huber(k)),
        ("laplace", &[smoothing], None) => Ok(Density::Laplace(smoothing)),
        ("custom", [], Some(expression)) => {
            let bound = |b: f64| (!b.is_infinite()).then_some(b);
            let one = |(name, start, lower, upper): (String, f64, f64, f64)| Parameter {
                lower: bound(lower),
                upper: bound(upper),
                ..Parameter::new(&name, start)
            };
            let parameters = parameters.into_iter().map(one).collect();
            Ok(Density::Custom(Custom { log_density: expression.0, parameters }))
        }
        _ => Err(PyValueError::new_err(format!("unknown density '{kind}' of {numbers:?}"))),
    }
}

#[pymethods]
impl PyNoise {
    /// Independent: a scale and a density an output; an expression takes the place of the scale.
    #[staticmethod]
    #[pyo3(signature = (sigmas, densities, expressions = Vec::new()))]
    fn independent(
        sigmas: Vec<SigmaSpec>,
        densities: Vec<DensitySpec>,
        expressions: Vec<Option<Operand>>,
    ) -> PyResult<Self> {
        let densities = densities.into_iter().map(density).collect::<PyResult<Vec<_>>>()?;
        let sigmas = sigmas
            .into_iter()
            .zip(expressions.into_iter().chain(std::iter::repeat_with(|| None)))
            .map(|(spec, expr)| expr.map_or_else(|| sigma(spec), |e| Sigma::Expression(e.0)));
        if densities.iter().all(|d| *d == Density::Gaussian) {
            return Ok(Noise::Gaussian(sigmas.collect()).into());
        }
        let channels = sigmas.zip(densities).map(|(sigma, density)| Channel { sigma, density });
        Ok(Noise::Independent(channels.collect()).into())
    }

    /// Jointly Gaussian with an unknown covariance: standard deviations and the correlation, row by row, to
    /// start from.
    #[staticmethod]
    fn correlated(sigmas: Vec<SigmaSpec>, correlation: Vec<f64>) -> PyResult<Self> {
        let n = sigmas.len();
        if correlation.len() != n * n {
            return Err(PyValueError::new_err(format!(
                "a correlation matrix of {n} outputs has {n}² entries"
            )));
        }
        let sigmas = sigmas.into_iter().map(sigma).collect();
        Ok(Noise::Correlated(Covariance::unknown(sigmas).starting_at(&correlation)).into())
    }

    /// The same, for each experiment its own.
    fn per_experiment(&self) -> PyNoise {
        PyNoise { noise: self.noise.clone(), per_experiment: true }
    }

    /// Jointly Gaussian with a known covariance of n outputs, row by row.
    #[staticmethod]
    fn covariance(n: usize, matrix: Vec<f64>) -> PyResult<Self> {
        Covariance::known(n, &matrix).map(|c| Noise::Correlated(c).into()).map_err(raise)
    }

    /// Raises OptionError where it is no noise of these outputs.
    fn check(&self, outputs: Vec<String>) -> PyResult<()> {
        let outputs: Vec<&str> = outputs.iter().map(String::as_str).collect();
        self.noise.check(&outputs).map_err(raise)
    }
}
