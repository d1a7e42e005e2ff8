//! The transform of a parameter: the solver's variable, of which the parameter is a function.

use crate::expr::Op;
use crate::expr::graph::{Graph, Id};

/// A parameter p as a function of the variable η that the solver moves. All increase with η.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "lowercase"))]
pub enum Transform {
    /// p = η.
    #[default]
    None,
    /// p = exp η: for positive parameters that may be wrong by orders of magnitude.
    Log,
    /// p = s η: the parameter in units of s.
    Scale(f64),
}

impl Transform {
    /// p(η).
    pub fn value(self, eta: f64) -> f64 {
        match self {
            Transform::None => eta,
            Transform::Log => eta.exp(),
            Transform::Scale(s) => s * eta,
        }
    }

    /// η(p); −∞ for the logarithm of what is not positive.
    pub fn inverse(self, p: f64) -> f64 {
        match self {
            Transform::None => p,
            Transform::Log if p <= 0.0 => f64::NEG_INFINITY,
            Transform::Log => p.ln(),
            Transform::Scale(s) => p / s,
        }
    }

    /// dp/dη.
    pub fn slope(self, eta: f64) -> f64 {
        match self {
            Transform::None => 1.0,
            Transform::Log => eta.exp(),
            Transform::Scale(s) => s,
        }
    }

    /// d²p/dη².
    pub fn bend(self, eta: f64) -> f64 {
        if self == Transform::Log { eta.exp() } else { 0.0 }
    }

    /// The longest step of η that makes sense far from an optimum: half a decade of what has a logarithm.
    pub fn longest_step(self) -> f64 {
        if self == Transform::Log { 0.5 * std::f64::consts::LN_10 } else { f64::INFINITY }
    }

    /// η after a step dη by which the parameter is to change linearly: p + (dp/dη) dη, but no less than a tenth of what has a
    /// logarithm.
    pub fn moved(self, eta: f64, step: f64) -> f64 {
        if self == Transform::Log { eta + (1.0 + step).max(0.1).ln() } else { eta + step }
    }

    /// Returns the name of the variable of a parameter.
    pub fn name(self, parameter: &str) -> String {
        match self {
            Transform::None => parameter.to_owned(),
            Transform::Log => format!("ln {parameter}"),
            Transform::Scale(s) => format!("{parameter}/{s}"),
        }
    }

    /// p(η) as an expression.
    pub fn express(self, graph: &mut Graph, eta: Id) -> Id {
        match self {
            Transform::None => eta,
            Transform::Log => graph.apply(Op::Exp, &[eta]),
            Transform::Scale(s) => {
                let scale = graph.constant(s);
                graph.mul(scale, eta)
            }
        }
    }
}
