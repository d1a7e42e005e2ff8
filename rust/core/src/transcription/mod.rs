//! From a model, experiments and a noise model to a nonlinear program.

mod boundary;
mod chunk;
mod collocation;
mod defects;
mod disjoint;
mod estimands;
mod explain;
mod layout;
mod likelihood;
mod samples;

pub use chunk::segments_in_chunk;
pub use collocation::{Collocation, Settings};
pub use estimands::Estimands;
pub use layout::{Layout, Place};
