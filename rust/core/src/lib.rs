//! Parameter estimation of ODE models by the output-error method,
//! transcribed by Lobatto collocation.
#![warn(missing_docs)]

pub mod math;
