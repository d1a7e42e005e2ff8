//! An unknown parameter.

use crate::setters::setters;
use crate::transform::Transform;

/// An unknown parameter.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Parameter {
    /// Name.
    pub name: String,
    /// Unit, as text.
    pub unit: String,
    /// Starting value.
    pub start: f64,
    /// Lower bound; `None` for none.
    pub lower: Option<f64>,
    /// Upper bound; `None` for none.
    pub upper: Option<f64>,
    /// Mean and standard deviation of a Gaussian prior.
    pub prior: Option<(f64, f64)>,
    /// Whether it is held at its start.
    pub fixed: bool,
    /// Whether each experiment has its own value: biases, wind.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "std::ops::Not::not"))]
    pub local: bool,
    /// The transform between the parameter and the solver's variable.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "is_none"))]
    pub transform: Transform,
}

#[cfg(feature = "serde")]
fn is_none(transform: &Transform) -> bool {
    *transform == Transform::None
}

impl Parameter {
    setters! {
        fixed: bool, local: bool, transform: Transform;
        into unit: String, into lower: Option<f64>, into upper: Option<f64>, into prior: Option<(f64, f64)>
    }

    /// A free parameter that starts at a value.
    pub fn new(name: &str, start: f64) -> Self {
        let name = name.to_owned();
        Parameter {
            name,
            unit: String::new(),
            start,
            lower: None,
            upper: None,
            prior: None,
            fixed: false,
            local: false,
            transform: Transform::None,
        }
    }

    /// Returns an error in its numbers, if there is one.
    pub(crate) fn wrong(&self) -> Option<String> {
        let Parameter { start, lower, upper, prior, .. } = self;
        let (low, high) = (lower.unwrap_or(f64::NEG_INFINITY), upper.unwrap_or(f64::INFINITY));
        if !start.is_finite() {
            Some(format!("its start {start} is not a finite number"))
        } else if low.is_nan() || high.is_nan() || low > high {
            Some(format!("its bounds ({low}, {high}) are not a lower and an upper bound"))
        } else if *start < low || *start > high {
            Some(format!("its start {start} lies outside its bounds ({low}, {high}); move one of them"))
        } else if self.transform == Transform::Log && *start <= 0.0 {
            Some(format!(
                "its start {start} has no logarithm; a parameter that is estimated by its logarithm is positive"
            ))
        } else if let Transform::Scale(scale) = self.transform
            && !(scale > 0.0 && scale.is_finite())
        {
            Some(format!("its scale {scale} is not a positive number"))
        } else {
            prior.filter(|(mean, std)| !mean.is_finite() || !std.is_finite() || *std <= 0.0).map(
                |(mean, std)| {
                    format!("its prior ({mean}, {std}) is not a mean and a positive standard deviation")
                },
            )
        }
    }
}
