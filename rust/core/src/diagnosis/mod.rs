//! What a solution tells about itself.

mod covariance;

pub use covariance::{Information, information};
