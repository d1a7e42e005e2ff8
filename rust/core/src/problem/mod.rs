//! The common part of all transcriptions: parameters and functions of a problem, its variables, and the likelihood.

pub(crate) mod boundary;
pub(crate) mod disjoint;
mod estimands;
pub(crate) mod explain;
pub(crate) mod layout;
mod likelihood;
pub(crate) mod objective;
pub(crate) mod posed;
pub(crate) mod samples;
mod separable;
pub(crate) mod transcribed;

pub use estimands::{Estimands, ParameterMap};
pub use layout::{Layout, Place};
pub use posed::Posed;
pub use transcribed::Transcribed;
