//! The noise log-density of a sample, ℓ_e(z − y, θ) (Eq. elle_defn), as an expression.
//!
//! The likelihood is one more function of a point, written with symbols and differentiated like
//! the model. Three forms: independent Gaussian, jointly Gaussian with a full covariance ([`Covariance`]),
//! and independent with any density an output ([`Density`]: what Eq. metric_est_obj calls a metric).
//!
//! All leave out the constant −½ ln 2π a measurement, so that log-likelihoods of different noise compare.

mod channel;
mod covariance;
mod density;
mod missing;
mod model;
mod report;
#[cfg(feature = "serde")]
mod saved;

pub use channel::{Channel, Sigma};
pub use covariance::Covariance;
pub use density::{Custom, Density, Dof, RESIDUAL, SCALE};
pub use missing::{Counts, Missing};
pub use model::{Joint, NoiseModel, Scale};
pub use report::Reported;
#[cfg(feature = "serde")]
pub(crate) use saved::SavedNoise;

use crate::error::Error;
use crate::expr::Expr;
use crate::expr::graph::{Graph, Id};
use crate::nlp::Reach;
use crate::parameter::Parameter;
use crate::tape::Terms;

/// The distribution of the measurement noise.
#[derive(Clone, Debug, PartialEq)]
pub enum Noise {
    /// Independent Gaussian, one standard deviation an output (Eqs. pe_gaussian, r_diag).
    Gaussian(Vec<Sigma>),
    /// Independent, a scale and a density an output.
    Independent(Vec<Channel>),
    /// Jointly Gaussian with a full covariance matrix (Eq. pe_gaussian).
    Correlated(Covariance),
}

/// The symbols that a log-density is written in.
#[derive(Clone, Debug)]
pub struct Sample<'a> {
    /// Model outputs y.
    pub outputs: &'a [Id],
    /// Measurements z.
    pub measured: &'a [Id],
    /// Standard deviations that are expressions of the model, by output; empty where there are none.
    pub scales: &'a [Option<Id>],
    /// 1 where a sample of the output is there, 0 where it is missing; `None` where none is missing.
    pub present: &'a [Option<Id>],
    /// Sets of outputs that are present together, not all of them, each with its flag: 1 at the samples
    /// where it is these. For correlated noise only.
    pub patterns: &'a [(Vec<bool>, Id)],
}

/// Prefix of the names of standard deviations, and of scales.
pub const SIGMA: &str = "sigma_";

impl Noise {
    /// Checks that there is one scale an output, each positive, its start within its bounds; that a
    /// covariance is one; that densities are.
    ///
    /// # Errors
    /// Names the output at fault.
    pub fn check(&self, outputs: &[&str]) -> Result<(), Error> {
        if let Noise::Correlated(covariance) = self {
            return covariance.check(outputs);
        }
        let channels = self.channels();
        let (n, n_y) = (channels.len(), outputs.len());
        if n != n_y {
            return Err(Error::option(format!("noise: {n} standard deviations for {n_y} outputs")));
        }
        outputs.iter().zip(&channels).try_for_each(|(name, channel)| channel.check(name))
    }

    /// Returns the noise adapted to the data: correlated noise puts the outputs with the fewest measurements first,
    /// so that most patterns of missing samples cost nothing.
    ///
    /// # Errors
    /// When outputs are missing in too many different combinations.
    pub(crate) fn for_data(self, counts: &Counts, missing: &Missing) -> Result<Noise, Error> {
        let Noise::Correlated(covariance) = self else { return Ok(self) };
        let covariance = covariance.ordered(&counts.outputs);
        covariance.check_missing(missing)?;
        Ok(Noise::Correlated(covariance))
    }

    /// The scales that are expressions of the model, by output; empty for correlated noise.
    pub(crate) fn expressions(&self) -> Vec<Option<Expr>> {
        let of = |channel: &Channel| match &channel.sigma {
            Sigma::Expression(expr) => Some(expr.clone()),
            _ => None,
        };
        self.channels().iter().map(of).collect()
    }

    /// Scales and densities of independent noise.
    fn channels(&self) -> Vec<Channel> {
        match self {
            Noise::Gaussian(sigmas) => {
                let gaussian = |sigma: &Sigma| Channel { sigma: sigma.clone(), density: Density::Gaussian };
                sigmas.iter().map(gaussian).collect()
            }
            Noise::Independent(channels) => channels.clone(),
            Noise::Correlated(_) => Vec::new(),
        }
    }

    /// The parameters of the noise, which the problem estimates beside the model's: first those of the
    /// scales, [`Noise::n_scales`] of them, then those of the densities.
    ///
    /// For an unknown σ it is the *precision root* 1/σ. −½(r/σ)² − ln σ is concave in 1/σ for every
    /// residual r, while in σ it turns its curvature at σ² = 3r²: from a start far too large, Newton's
    /// method in σ walks off, in 1/σ it doubles and then converges. For an unknown covariance it is the
    /// upper triangular root W of its inverse, for the same reason. Names are those of [`Noise::report`].
    pub fn parameters(&self, outputs: &[&str]) -> Vec<Parameter> {
        match self {
            Noise::Correlated(covariance) => covariance.parameters(outputs),
            _ => channel::parameters(&self.channels(), outputs),
        }
    }

    /// Returns the names of the parameters as unknowns of the solver: `1/sigma_q`.
    pub fn variable_names(&self, outputs: &[&str]) -> Vec<String> {
        match self {
            Noise::Correlated(covariance) => covariance.variable_names(outputs),
            _ => channel::variable_names(&self.channels(), outputs),
        }
    }

    /// Number of parameters that stand for scales: those that [`Noise::profile`] gives.
    pub fn n_scales(&self) -> usize {
        match self {
            Noise::Gaussian(sigmas) => sigmas.iter().filter(|s| s.is_unknown()).count(),
            Noise::Independent(channels) => channels.iter().filter(|c| c.sigma.is_unknown()).count(),
            Noise::Correlated(covariance) => covariance.n_parameters(),
        }
    }

    /// Returns which parameters are precision roots: positive, and 1/σ of an output (given other outputs, where noise
    /// is correlated).
    pub fn precision_roots(&self) -> Vec<usize> {
        match self {
            Noise::Correlated(covariance) => covariance.precision_roots(),
            _ => (0..self.n_scales()).collect(),
        }
    }

    /// Scales of all outputs, from the noise parameters: standard deviations where noise is Gaussian, NaN where it is an
    /// expression.
    pub fn sigmas(&self, parameters: &[f64]) -> Vec<f64> {
        if let Noise::Correlated(covariance) = self {
            return covariance.sigmas(parameters);
        }
        let mut free = parameters.iter();
        let mut sigma = |channel: &Channel| match channel.sigma {
            Sigma::Known(value) => value,
            Sigma::Expression(_) => f64::NAN,
            Sigma::Unknown { .. } => 1.0 / free.next().expect("one parameter an unknown"),
        };
        self.channels().iter().map(&mut sigma).collect()
    }

    /// Returns the noise in the user's terms, with gradients for the delta method: σ, correlations and parameters of
    /// densities, as many as there are parameters and in an order of their own.
    pub fn report(&self, outputs: &[&str], values: &[f64]) -> Vec<Reported> {
        match self {
            Noise::Correlated(covariance) => covariance.report(outputs, values),
            _ => channel::report(&self.channels(), outputs, values),
        }
    }

    /// The parameters of the scales that maximise the likelihood for the residuals as they are, within
    /// their bounds and within reach; the largest relative change. For the Gaussian, σ is the residuals'
    /// root mean square, R their mean square. For other densities it is the next step of the fixed point of
    /// iteratively reweighted least squares, and for samples of which a part is missing and whose
    /// noise is correlated that of the EM algorithm.
    ///
    /// `gradient` is that of −ℓ with respect to the parameters of the scales, `at`: it is all that is
    /// needed to know of the residuals.
    pub fn profile(
        &self,
        counts: &Counts,
        at: &[f64],
        gradient: &[f64],
        reach: &Reach<'_>,
        out: &mut [f64],
    ) -> f64 {
        match self {
            Noise::Gaussian(sigmas) => {
                let sigmas = sigmas.iter().zip(&counts.outputs);
                channel::profile(sigmas, at, gradient, reach, out)
            }
            Noise::Independent(channels) => {
                let sigmas = channels.iter().map(|c| &c.sigma).zip(&counts.outputs);
                channel::profile(sigmas, at, gradient, reach, out)
            }
            Noise::Correlated(covariance) => covariance.profile(counts, at, gradient, reach, out),
        }
    }

    /// Whether flags of patterns of missing outputs are needed, beside one an output.
    pub fn needs_patterns(&self) -> bool {
        matches!(self, Noise::Correlated(_))
    }

    /// ℓ_e of one sample, without the constant.
    pub fn log_density(&self, graph: &mut Graph, sample: &Sample<'_>, parameters: &[Id]) -> Terms {
        match self {
            Noise::Correlated(covariance) => covariance.log_density(graph, sample, parameters),
            _ => channel::log_density(&self.channels(), graph, sample, parameters),
        }
    }
}

impl Sample<'_> {
    /// z − y of an output; 0 where it is missing. Switched, not multiplied: an output that is not finite
    /// where nothing was measured must not spoil the sum.
    fn residual(&self, graph: &mut Graph, output: usize) -> Id {
        let difference = graph.sub(self.measured[output], self.outputs[output]);
        self.switched(graph, output, difference)
    }

    /// A term where an output is present, else 0.
    fn switched(&self, graph: &mut Graph, output: usize, term: Id) -> Id {
        let zero = graph.zero();
        self.present[output].map_or(term, |present| graph.select(present, term, zero))
    }
}
