//! Information, covariances and sensitivities at a solution.

mod burg;
mod covariance;
mod forward;
mod linearisation;
pub mod memory;
mod passage;
mod random_effects;
mod response;
mod whitening;

pub use burg::{Run, burg};
pub use covariance::{Information, NoInformation, information};
pub use forward::Forward;
pub use linearisation::{Linearisation, Outputs, Place};
pub use passage::Predictors;
pub use random_effects::{Marginal, RandomEffects};
pub use response::Response;
pub use whitening::Whitening;

/// Curvature, relative to that of other directions, given to directions without any.
const SLIGHT: f64 = 1e-8;
