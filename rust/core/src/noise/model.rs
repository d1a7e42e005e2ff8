//! The declared noise, before there are data.

use super::{Density, Sigma};
use crate::error::Error;
use crate::expr::Expr;

/// The scale of the noise of one output, as far as it is said: the standard deviation, where it is Gaussian.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Scale {
    /// Given.
    Known(f64),
    /// A scale to be estimated. Start and bounds that are not given follow from the spread of the measurements: the
    /// start is no larger, bounds are 1e-9 and 1e6 times that.
    Unknown {
        /// Starting value.
        start: Option<f64>,
        /// Lower and upper bound.
        bounds: Option<(f64, f64)>,
    },
    /// Given by an expression in the model's states, inputs, parameters and quantities, positive at all samples.
    Expression(Expr),
}

impl From<Sigma> for Scale {
    fn from(sigma: Sigma) -> Self {
        match sigma {
            Sigma::Known(value) => Scale::Known(value),
            Sigma::Unknown { start, lower, upper } => {
                Scale::Unknown { start: Some(start), bounds: Some((lower, upper)) }
            }
            Sigma::Expression(expr) => Scale::Expression(expr),
        }
    }
}

/// Whether the noise of different outputs is correlated.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Joint {
    /// Independent noise.
    #[default]
    Independent,
    /// Jointly Gaussian with an unknown covariance matrix.
    Unknown,
    /// Jointly Gaussian with this covariance matrix, n_y × n_y in the order of the outputs, row by row.
    Known(Vec<f64>),
}

/// The noise of a model's outputs as it is declared; what is not said of an output is Gaussian noise of an unknown
/// standard deviation. With data it becomes a [`Noise`](super::Noise).
///
/// ```
/// use phugoid::noise::{Density, Dof, NoiseModel, Sigma};
/// use phugoid::Model;
///
/// let mut m = Model::new("short period");
/// m.noise = NoiseModel::new().scale("q", Sigma::Known(0.002)).density("az", Density::StudentT(Dof::Known(4.0)));
/// # #[cfg(feature = "serde")]
/// assert_eq!(Model::from_json(&m.to_json())?.noise, m.noise);
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NoiseModel {
    /// Scales by output; of two for the same output the later one holds.
    pub scales: Vec<(String, Scale)>,
    /// Densities by output, alike.
    pub densities: Vec<(String, Density)>,
    /// Correlation between outputs.
    pub joint: Joint,
    /// Whether each experiment has scales, correlations and other parameters of its own.
    pub per_experiment: bool,
}

impl NoiseModel {
    /// Independent Gaussian noise of unknown standard deviations.
    pub fn new() -> Self {
        NoiseModel::default()
    }

    /// The scale of an output's noise: a [`Sigma`], or a [`Scale`] of which a part is left open.
    pub fn scale(mut self, output: &str, scale: impl Into<Scale>) -> Self {
        self.scales.push((output.to_owned(), scale.into()));
        self
    }

    /// The density of an output's noise.
    pub fn density(mut self, output: &str, density: Density) -> Self {
        self.densities.push((output.to_owned(), density));
        self
    }

    /// Gaussian noise that is correlated between outputs, with an unknown covariance.
    pub fn correlated(mut self) -> Self {
        self.joint = Joint::Unknown;
        self
    }

    /// Gaussian noise of this covariance matrix, n_y × n_y in the order of the outputs, row by row.
    pub fn covariance(mut self, matrix: Vec<f64>) -> Self {
        self.joint = Joint::Known(matrix);
        self
    }

    /// Returns the same kind of noise with parameters of its own for each experiment.
    pub fn per_experiment(mut self) -> Self {
        self.per_experiment = true;
        self
    }

    /// Checks the numbers of scales and densities.
    ///
    /// # Errors
    /// Names the output at fault.
    pub fn check(&self) -> Result<(), Error> {
        for (output, scale) in &self.scales {
            let fail = |text: String| {
                Err(Error::option(format!("noise of output '{output}': {text}")).about(output))
            };
            let positive = |v: f64| v > 0.0 && v.is_finite();
            match *scale {
                Scale::Known(value) if !positive(value) => {
                    return fail(format!("its standard deviation {value} is not a positive number"));
                }
                Scale::Unknown { start: Some(start), .. } if !positive(start) => {
                    return fail(format!(
                        "its standard deviation starts at {start}, not at a positive number"
                    ));
                }
                Scale::Unknown { start, bounds: Some((lower, upper)) } => {
                    if !(lower >= 0.0 && lower.is_finite() && upper > 0.0 && lower <= upper) {
                        return fail(format!(
                            "({lower}, {upper}) are not a lower and an upper bound of a standard deviation"
                        ));
                    }
                    if let Some(start) = start.filter(|s| *s < lower || *s > upper) {
                        return fail(format!(
                            "its standard deviation starts at {start}, outside its bounds ({lower}, {upper}); move one \
                             of them"
                        ));
                    }
                }
                _ => {}
            }
        }
        self.densities.iter().try_for_each(|(output, density)| density.check(output))
    }

    /// Returns the declared scale of an output.
    pub fn scale_of(&self, output: &str) -> Option<&Scale> {
        self.scales.iter().rev().find(|s| s.0 == output).map(|s| &s.1)
    }

    /// The density of an output.
    pub fn density_of(&self, output: &str) -> Density {
        let said = self.densities.iter().rev().find(|d| d.0 == output);
        said.map_or(Density::Gaussian, |d| d.1.clone())
    }
}
