//! Estimation from many records that no one machine holds: what one worker computes of its share.
//!
//! The parameters that all records share, those of the noise among them, are held at trial values θ. Each record is then a
//! problem of its own: V_e(θ) = min −ℓ_e over its states, its initial states and the parameters that each record has of its
//! own, subject to the equations. The estimate minimises Σ V_e(θ), which is the same program as that of all records together
//! with the other variables eliminated (variable elimination: Nocedal and Wright, section 15.3). A worker returns sums over
//! its records of V_e, its gradient and its Hessian, which is the Schur complement of the record's KKT matrix: p + p² numbers
//! for p shared parameters, whatever the number of records. Newton's method in θ is left to whoever adds these sums up.
//!
//! ```
//! use phugoid::fleet::Share;
//! use phugoid::{Experiment, Model, NoiseModel, Parameter, Sigma};
//!
//! let mut m = Model::new("fall");
//! let (h, v) = (m.state("h", "m")?, m.state("v", "m/s")?);
//! let g = m.parameter(Parameter::new("g", 9.0))?;
//! m.equation("h", v)?;
//! m.equation("v", -g)?;
//! m.output("height", h, "m")?;
//! let drop = |name: &str, from: f64| {
//!     let t: Vec<f64> = (0..40).map(|k| 0.05 * k as f64).collect();
//!     let height = t.iter().map(|t| from - 0.5 * 9.81 * t * t).collect();
//!     Experiment::new(&m, name, t, [("height", height)])
//! };
//!
//! let noise = NoiseModel::new().scale("height", Sigma::Known(0.01));
//! let mut share = Share::new(&m, &noise)?;
//! let records = [drop("one", 20.0)?, drop("two", 30.0)?];
//! let start = share.variables(&records[0], &[])?;
//! let found = share.evaluate(&records, &[start[0].start]);
//! let step = -found.gradient[0] / found.hessian[0]; // Newton's, exact where V is quadratic
//! assert!((start[0].start + step - 9.81).abs() < 1e-6);
//! # Ok::<(), phugoid::Error>(())
//! ```

mod held;
mod record;
mod report;
mod share;
mod workshop;

pub use record::{Detail, Failure, RecordResult};
pub use share::{Share, SharedVariable, Sums};
