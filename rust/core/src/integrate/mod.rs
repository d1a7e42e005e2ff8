//! Runge-Kutta methods, explicit and implicit.
//!
//! A transcription takes steps of fixed length, over segments side by side in lanes, with the exact derivatives of the
//! steps ([`flow`], [`adjoint`]). A simulation takes steps of the length that its tolerance allows ([`interval`]), explicit ones
//! ([`dop853`]) until the system is stiff, and implicit ones ([`radau`]) from then on, and none that crosses a pole ([`poles`]).

pub(crate) mod adjoint;
mod dop853;
pub(crate) mod field;
pub(crate) mod flow;
pub(crate) mod group;
pub(crate) mod interval;
mod poles;
mod radau;
pub(crate) mod steps;
pub(crate) mod tableau;

pub use interval::Method;
pub use steps::Steps;
pub use tableau::Integrator;
