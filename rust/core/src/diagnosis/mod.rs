//! What a solution tells about itself.

mod covariance;
mod forward;
mod response;

pub use covariance::{Information, information};
pub use forward::Forward;
pub use response::Response;
