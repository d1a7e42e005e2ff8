//! The noise log-density of a sample, ℓ_e(z − y, θ) (Eq. elle_defn), as an expression.
//!
//! The likelihood is one more function of a point, written with symbols and differentiated like
//! the model. Another density is another way to write [`Noise::log_density`].

use crate::error::Error;
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
        /// Lower bound; 0 for none.
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
    /// Checks that there is one σ an output, each positive, its start within its bounds.
    ///
    /// # Errors
    /// Names the output at fault.
    pub fn check(&self, outputs: &[&str]) -> Result<(), Error> {
        let Noise::Gaussian(sigmas) = self;
        let (n, n_y) = (sigmas.len(), outputs.len());
        if n != n_y {
            return Err(Error::Option(format!("noise: {n} standard deviations for {n_y} outputs")));
        }
        for (name, sigma) in outputs.iter().zip(sigmas) {
            let sound = match *sigma {
                Sigma::Known(value) => value > 0.0 && value.is_finite(),
                Sigma::Unknown { start, lower, upper } => {
                    start > 0.0 && start.is_finite() && 0.0 <= lower && lower <= start && start <= upper
                }
            };
            if !sound {
                return Err(Error::Option(format!(
                    "noise of output '{name}': {sigma:?} is not a positive standard deviation within its bounds"
                )));
            }
        }
        Ok(())
    }

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

    /// The noise parameters that maximise the likelihood for the residuals as they are: σ is their root
    /// mean square. `measured` counts the measurements of each output, `gradient` is that of −ℓ with
    /// respect to the noise parameters `at`.
    pub fn profile(&self, measured: &[usize], at: &[f64], gradient: &[f64], out: &mut [f64]) {
        let Noise::Gaussian(sigmas) = self;
        let unknown = sigmas.iter().zip(measured).filter(|s| matches!(s.0, Sigma::Unknown { .. }));
        for (i, (_, &n)) in unknown.enumerate() {
            // −ℓ = ½ S w² − N ln w, so its derivative S w − N/w gives the sum of squares S.
            let n = n as f64;
            let squares = (gradient[i] + n / at[i]) / at[i];
            out[i] = if squares > 0.0 { (n / squares).sqrt() } else { f64::INFINITY };
        }
    }

    /// ℓ_e of one sample, without the constant n_y/2 ln 2π.
    pub fn log_density(&self, graph: &mut Graph, sample: &Sample<'_>, parameters: &[Id]) -> Density {
        let Noise::Gaussian(sigmas) = self;
        let mut free = parameters.iter();
        let mut density = Density { residuals: Vec::new(), rest: graph.zero() };
        for (c, sigma) in sigmas.iter().enumerate() {
            let precision = match sigma {
                Sigma::Known(value) => graph.constant(1.0 / value),
                Sigma::Unknown { .. } => *free.next().expect("one parameter an unknown"),
            };
            let difference = graph.sub(sample.measured[c], sample.outputs[c]);
            let mut residual = graph.mul(precision, difference);
            let mut log = graph.apply(Op::Log, &[precision]);
            if let Some(present) = sample.present[c] {
                // Switched, not multiplied: an output that is not finite where nothing was measured
                // must not spoil the sum.
                let zero = graph.zero();
                residual = graph.select(present, residual, zero);
                log = graph.select(present, log, zero);
            }
            density.residuals.push(residual);
            density.rest = graph.add(density.rest, log);
        }
        density
    }
}

/// A log-density as ℓ_e = rest − ½ Σ residual². What is left of its Hessian when the curvature of
/// the residuals is dropped (Gauss-Newton) is never indefinite, as long as `rest` is concave.
#[derive(Clone, Debug)]
pub struct Density {
    /// Residuals over their standard deviation.
    pub residuals: Vec<Id>,
    /// The part that depends on noise parameters alone.
    pub rest: Id,
}
