//! Newton's method for output-error problems.
//!
//! Two phases. *Gauss-Newton*: the Hessian from first derivatives of the residuals, standard deviations
//! profiled (set to what the residuals say after each step, changed by a limited factor). It is never
//! indefinite and needs no multipliers, so it comes from anywhere, but its tail is linear. *Newton*: the
//! exact Hessian of the Lagrangian in all unknowns as soon as a step promises less than [`NEAR`] in
//! log-likelihood, quadratic to the end; where it is not positive along the constraints, the step is
//! Gauss-Newton's again.
//!
//! Steps are globalised by the ℓ₁ merit function φ + ν Σ|c|, ν from the reduction that the quadratic
//! model must promise (Byrd, Gilbert and Nocedal, 2000), with a second-order correction where a full
//! step is refused (Nocedal and Wright, section 18.3). Bounds are met by an active set: the Newton
//! system is factorised once, and variables are held and released in its small dense border.

mod active_set;
mod approach;
mod damping;
mod iterate;
mod iteration;
mod line_search;
mod merit;
mod newton;
mod newton_system;
mod point;
mod program;
mod promise;
mod reduced;
mod restoration;
mod schur;
mod settings;
mod solution;
mod status;
mod step;
mod termination;
mod units;
mod watchdog;

pub(crate) use approach::Approach;
pub use iteration::{Control, Iteration};
pub(crate) use newton::Newton;
pub(crate) use point::Point;
pub use program::Evaluations;
pub(crate) use program::Program;
pub(crate) use schur::Schur;
pub use settings::Settings;
pub use solution::Solution;
pub use status::Status;
pub(crate) use termination::Ending;
pub(crate) use units::Units;
pub use units::state_units;

use crate::interrupt::Interrupt;
use crate::nlp::{Nlp, NotFinite};

/// The exact Hessian takes over once a step promises less than this in log-likelihood.
const NEAR: f64 = 10.0;

/// Minimises from `start`. `watch` sees each iteration and may end the run.
///
/// ```
/// use phugoid::solver::{Control, Settings, Status, solve};
/// use phugoid::{Estimation, Experiment, Model, Parameter, Sigma};
///
/// let mut m = Model::new("ramp");
/// let (x, slope) = (m.state("x", "m")?, m.parameter(Parameter::new("slope", 0.0))?);
/// m.equation("x", slope)?;
/// m.output("x", x, "")?;
/// let runs = [Experiment::new(&m, "run", vec![0.0, 1.0, 2.0], [("x", vec![1.0, 3.1, 5.0])])?];
///
/// let (problem, start) = Estimation::new(&m, &runs).noise("x", Sigma::Known(0.1)).order(2).transcribe()?;
/// let mut watch = |line: &phugoid::solver::Iteration| {
///     println!("{:3} {:12.6} {:8.1e}", line.number, line.objective, line.promise);
///     Control::Continue
/// };
/// let solution = solve(&problem, &start, None, &Settings::default(), &mut watch).expect("finite at the start");
/// assert_eq!(solution.status, Status::Converged);
/// assert!((solution.xi[0] - 2.0).abs() < 1e-9);
/// # Ok::<(), phugoid::Error>(())
/// ```
///
/// # Errors
/// [`NotFinite`] when a function is not finite at the start ([`Named::explain`](crate::nlp::Named::explain) says what); everything
/// else is a [`Status`].
pub fn solve(
    nlp: &dyn Nlp,
    start: &[f64],
    multipliers: Option<&[f64]>,
    settings: &Settings,
    watch: &mut dyn FnMut(&Iteration) -> Control,
) -> Result<Solution, NotFinite> {
    Interrupt::within(settings.time_limit).run(|| {
        if let Some(solution) = Solution::without_a_run(nlp, start, multipliers) {
            return Ok(solution);
        }
        let program = Program::new(nlp, start);
        let point = Point::first(&program, start)?;
        let mut newton = Newton::new(program, point, multipliers, settings);
        let ending = newton.minimise(watch)?;
        Ok(newton.finish(ending))
    })
}
