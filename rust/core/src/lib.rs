//! Parameter estimation of ODE models by the output-error method, transcribed by Lobatto collocation.
//!
//! # The problem
//!
//! A system ẋ = f(x, u, θ) is excited by known inputs u(t), and its outputs y = g(x, u, θ) are measured with
//! noise at the times t̃_1 … t̃_N: z_k = y(t̃_k) + e_k. Wanted are the parameters θ under which the measurements
//! are likeliest; those of the noise and the initial states are among the unknowns (Eq. ml_loglike of
//! D. A. A. Dutra, *Collocation-Based Output-Error Method for Aircraft System Identification*, AIAA Aviation
//! 2019, whose names for equations are cited throughout):
//!
//! ```text
//!   maximise     Σ_{k=1}^{N}  ℓ_e(z_k − ŷ(t̃_k, θ), θ)                       over θ
//!
//!   subject to   x̂(0, θ) = x_0(θ)
//!                dx̂/dt (t, θ) = f(x̂(t, θ), u(t), θ)
//!                ŷ(t, θ) = g(x̂(t, θ), u(t), θ)
//! ```
//!
//! where ℓ_e is the log-density of the noise, ℓ_e(ε, θ) = −½ Σ_c (ε_c/σ_c)² − Σ_c ln σ_c (Eqs. pe_gaussian,
//! r_diag) unless another [`noise`] is chosen. To solve the differential equation for every trial θ fails where the
//! system is unstable or θ far off. Instead, time is divided into n_s segments with m Legendre-Gauss-Lobatto points τ_k each, and the states
//! there are unknowns too (Eq. oem_coll):
//!
//! ```text
//!   maximise     Σ_{k : τ_i^(j) = t̃_k}  ℓ_e(z_k − ŷ_i^(j), θ)      over θ, x̂_1^(1), …, x̂_m^(1), …, x̂_m^(n_s)
//!
//!   subject to   0 = x̂_{k+1}^(i) − x̂_k^(i) − Σ_{j=1}^{m} f(x̂_j^(i), u(τ_j^(i)), θ) C_{j,k}^(i)
//!                ŷ_k^(i) = g(x̂_k^(i), u(τ_k^(i)), θ)                       k = 1 … m−1,  i = 1 … n_s
//!
//!   with         C_{j,k}^(i) = ∫_{τ_k}^{τ_{k+1}} λ_j^(i)(τ) dτ,   λ_j the Lagrange polynomials of the points
//! ```
//!
//! This program is large and sparse, and starts from states as they were measured: it converges from useless
//! parameters, such as zeros, and for unstable systems.
//!
//! # A first example
//!
//! A mass on a spring is let go and its position is measured; its speed is not.
//!
//! ```
//! use phugoid::{Estimation, Experiment, Model, Parameter};
//!
//! let mut m = Model::new("mass on a spring");
//! let (x, v) = (m.state("x", "m")?, m.state("v", "m/s")?);
//! let k = m.parameter(Parameter::new("k", 0.0))?; // stiffness over mass, from 0
//! let c = m.parameter(Parameter::new("c", 0.0).lower(0.0))?; // damping
//! m.equation("x", v.clone())?;
//! m.equation("v", -k * &x - c * &v)?;
//! m.output("x", x, "m")?;
//!
//! // The record: k = 4.01, c = 0.2, and 5 mm of what serves as noise here.
//! let t: Vec<f64> = (0..200).map(|i| 0.05 * i as f64).collect();
//! let x = t.iter().map(|t| (-0.1 * t).exp() * (2.0 * t).cos() + 0.005 * (1e5 * t).sin()).collect();
//! let run = Experiment::new(&m, "release", t, [("x", x)])?;
//!
//! let fit = Estimation::new(&m, &[run]).solve()?;
//! println!("{fit}");
//! assert!((fit["k"].value - 4.01).abs() < 3.0 * fit["k"].std_error);
//! assert!((fit["c"].value - 0.2).abs() < 3.0 * fit["c"].std_error);
//! assert!(fit["sigma_x"].value < 0.005);
//! assert!((fit.state(0, "v").unwrap()[20] + 1.608).abs() < 0.01); // the speed at 1 s, m/s
//! # Ok::<(), phugoid::Error>(())
//! ```
//!
//! `examples/hfb320.rs` and `examples/unstable_aircraft.rs` estimate aircraft from real records, and `examples/own_solver.rs` puts
//! a solver and a factorisation of its own into an estimation.
//!
//! # Modules
//!
//! They are a straight line from a model to a fit; each uses only those before it. Names of private modules are those of files.
//!
//! | | |
//! |---|---|
//! | `math`, `lgl`, `interpolate`, `table`, `dense` | elementary functions with the same bits everywhere, Lobatto nodes and integration matrix, inputs between samples, smooth interpolation tables, dense matrices |
//! | `index` | types of the numberings: parameters, variables, constraints, states, points, experiments |
//! | `error`, [`interrupt`], `threads` | what can be wrong, in the user's names; early ends of work; the threads that it is done on |
//! | [`expr`] | symbolic expressions: operators, exact derivatives, printing, saving |
//! | `tape` | expressions compiled to run over blocks of points |
//! | [`nlp`] | the seam to solvers: a nonlinear program with names |
//! | `parameter`, [`noise`] | unknowns; the density of the noise |
//! | [`model`], `evaluator` | states, inputs, parameters, equations, delays; f and g at points |
//! | `experiment`, `gaps`, `measured`, `mesh` | records, gaps in their sampling, states that outputs measure, segments and their points |
//! | `integrate` | Runge-Kutta steps with their exact derivatives |
//! | `problem` | what transcriptions share: variables, functions, likelihood |
//! | [`collocation`], [`shooting`] | from all these to the nonlinear program of collocation, or of single or multiple shooting |
//! | [`filter`] | process noise: the marginal likelihood of the filter-error method |
//! | [`linalg`] | the seam to linear algebra: Newton systems; the factorisation of an arrow, and a sparse one |
//! | [`solver`] | Gauss-Newton, then Newton |
//! | `initial` | what goes before: a regression, other places to start from |
//! | `diagnosis` | covariance, and what the data leave open |
//! | [`simulate`] | what a model says for given parameters |
//! | [`estimate`] | all of it in one call |
//! | [`fleet`] | estimation from many records, on many machines: what a worker computes of its share |
//! | [`online`] | estimation while the data arrive: states, parameters and noise after each sample |
//!
//! # Features
//!
//! `parallel` (default): work on several threads; results are the same without. `serde` (default): models, noise and tables are saved
//! as JSON and read.
#![warn(missing_docs)]
// Documentation names private items too, for those who read on in the source.
#![allow(rustdoc::private_intra_doc_links)]

pub mod collocation;
mod condition;
mod constant;
mod dense;
mod diagnosis;
mod error;
pub mod estimate;
mod evaluator;
mod experiment;
pub mod expr;
pub mod filter;
pub mod fleet;
mod gaps;
mod index;
mod initial;
mod integrate;
mod interpolate;
pub mod interrupt;
mod lgl;
pub mod linalg;
mod math;
mod measured;
mod mesh;
pub mod model;
pub mod nlp;
pub mod noise;
pub mod online;
#[cfg(feature = "serde")]
mod pairs;
mod parameter;
mod problem;
mod setters;
pub mod shooting;
mod simd;
pub mod simulate;
pub mod solver;
mod table;
mod tape;
mod threads;
mod transform;

pub use error::{Error, ErrorKind};
pub use estimate::{Estimate, Estimation, Fit};
pub use experiment::{Experiment, Signal};
pub use expr::Expr;
pub use interpolate::Interpolation;
pub use mesh::Grid;
pub use model::{Constant, Model, Parameter};
pub use noise::{Density, Dof, Noise, NoiseModel, Sigma};
pub use simulate::Simulation;
pub use table::{Table, TableError};

/// What the Python package and the tests of this crate need beside what is public: it may change in any version.
#[doc(hidden)]
pub mod internals {
    macro_rules! open {
        ($($name:ident: $($path:ident)::+,)*) => {
            $(pub mod $name { pub use crate::$($path)::+::*; })*
        };
    }
    #[cfg(feature = "serde")]
    open! { pool: expr::pool, }
    open! {
        dense: dense, diagnosis: diagnosis, display: expr::display, error: error, evaluator: evaluator,
        gaps: gaps, graph: expr::graph, initial: initial, integrate: integrate, interpolate: interpolate, lgl: lgl,
        math: math, mesh: mesh, operations: expr::ops, problem: problem, tape: tape,
    }
}

/// The code in the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
