//! Parameter estimation of ODE models by the output-error method,
//! transcribed by Lobatto collocation.
#![warn(missing_docs)]

pub mod diagnosis;
pub mod error;
pub mod estimate;
pub mod evaluator;
pub mod experiment;
pub mod expr;
pub mod interpolate;
pub mod lgl;
pub mod linalg;
pub mod math;
pub mod mesh;
pub mod model;
pub mod nlp;
pub mod noise;
mod simd;
pub mod solver;
pub mod table;
pub mod tape;
pub mod transcription;

pub use error::Error;
pub use estimate::{Estimate, Estimation, Fit};
pub use experiment::Experiment;
pub use expr::Expr;
pub use interpolate::Interpolation;
pub use mesh::Grid;
pub use model::{Model, Parameter};
pub use noise::Sigma;
