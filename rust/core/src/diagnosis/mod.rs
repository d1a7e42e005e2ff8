//! What a solution tells about itself.

mod covariance;
mod forward;
mod response;

pub use covariance::{Information, information};
pub use forward::Forward;
pub use response::Response;

/// Curvature, relative to that of other directions, given to directions without any.
const SLIGHT: f64 = 1e-8;
