//! From a model, experiments and a noise model to a nonlinear program.

mod boundary;
mod chunk;
mod collocation;
mod defects;
mod disjoint;
mod estimands;
mod explain;
mod flow;
mod group;
mod layout;
mod likelihood;
mod objective;
mod pieces;
mod posed;
mod samples;
mod separable;
mod shooting;
mod steps;
mod tableau;
mod transcribed;
mod unfinished;

pub use chunk::segments_in_chunk;
pub use collocation::{Collocation, Settings};
pub use estimands::Estimands;
pub use layout::{Layout, Place};
pub use posed::Posed;
pub use shooting::{Shooting, Shots};
pub use steps::Steps;
pub use tableau::Integrator;
pub use transcribed::Transcribed;
