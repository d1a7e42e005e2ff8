//! What a solution tells about itself.

mod covariance;
mod response;

pub use covariance::{Information, information};
pub use response::Response;
