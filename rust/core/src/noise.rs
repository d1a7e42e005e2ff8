//! The noise log-density of a sample, ℓ_e(z − y, θ) (Eq. elle_defn), as an expression.
//!
//! The likelihood is one more function of a point, written with symbols and differentiated like
//! the model. Another density is another way to write [`Noise::log_density`].

use crate::expr::Op;
use crate::expr::graph::{Graph, Id};
use crate::model::Parameter;

/// Standard deviation of one output.
#[derive(Clone, Debug, PartialEq)]
pub enum Sigma {
    /// To be estimated.
    Unknown {
        /// Starting value.
        start: f64,
        /// Lower bound, positive.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// Given.
    Known(f64),
}

/// The distribution of the measurement noise.
#[derive(Clone, Debug, PartialEq)]
pub enum Noise {
    /// Independent Gaussian, one standard deviation an output (Eqs. pe_gaussian, r_diag).
    Gaussian(Vec<Sigma>),
}

/// The symbols that a log-density is written in, one each an output.
#[derive(Clone, Debug)]
pub struct Sample<'a> {
    /// Model outputs y.
    pub outputs: &'a [Id],
    /// Measurements z.
    pub measured: &'a [Id],
    /// 1 where a sample is there, 0 where it is missing; `None` where none is missing.
    pub present: &'a [Option<Id>],
}

/// Prefix of the names of standard deviations.
pub const SIGMA: &str = "sigma_";

impl Noise {
    /// The parameters of the noise, which the problem estimates beside the model's: for an unknown
    /// σ, the *precision root* 1/σ. −½(r/σ)² − ln σ is concave in 1/σ for every residual r, while
    /// in σ it turns its curvature at σ² = 3r²: from a start far too large, Newton's method in σ
    /// walks off, in 1/σ it doubles and then converges.
    pub fn parameters(&self, outputs: &[&str]) -> Vec<Parameter> {
        let Noise::Gaussian(sigmas) = self;
        let mut parameters = Vec::new();
        for (name, sigma) in outputs.iter().zip(sigmas) {
            if let Sigma::Unknown { start, lower, upper } = sigma {
                parameters.push(Parameter {
                    lower: Some(1.0 / upper),
                    upper: (*lower > 0.0).then_some(1.0 / lower),
                    ..Parameter::new(&format!("{SIGMA}{name}"), 1.0 / start)
                });
            }
        }
        parameters
    }

    /// Standard deviations of all outputs, from the noise parameters.
    pub fn sigmas(&self, parameters: &[f64]) -> Vec<f64> {
        let Noise::Gaussian(sigmas) = self;
        let mut free = parameters.iter();
        sigmas
            .iter()
            .map(|sigma| match sigma {
                Sigma::Known(value) => *value,
                Sigma::Unknown { .. } => 1.0 / free.next().expect("one parameter an unknown"),
            })
            .collect()
    }

    /// ℓ_e of one sample, without the constant n_y/2 ln 2π.
    pub fn log_density(&self, graph: &mut Graph, sample: &Sample<'_>, parameters: &[Id]) -> Id {
        let Noise::Gaussian(sigmas) = self;
        let mut free = parameters.iter();
        let mut sum = graph.zero();
        for (c, sigma) in sigmas.iter().enumerate() {
            let precision = match sigma {
                Sigma::Known(value) => graph.constant(1.0 / value),
                Sigma::Unknown { .. } => *free.next().expect("one parameter an unknown"),
            };
            let residual = graph.sub(sample.measured[c], sample.outputs[c]);
            let scaled = graph.mul(precision, residual);
            let square = graph.mul(scaled, scaled);
            let half = graph.constant(0.5);
            let loss = graph.mul(half, square);
            let log = graph.apply(Op::Log, &[precision]);
            let mut term = graph.sub(log, loss);
            if let Some(present) = sample.present[c] {
                term = graph.mul(present, term);
            }
            sum = graph.add(sum, term);
        }
        sum
    }
}
