//! Newton's method for output-error problems: the loop.
//!
//! Two phases. *Gauss-Newton*: the Hessian from first derivatives of the residuals, standard deviations
//! profiled (set to what the residuals say after each step, changed by at most [`TENFOLD`]). It is never
//! indefinite and needs no multipliers, so it comes from anywhere, but its tail is linear. *Newton*: the
//! exact Hessian of the Lagrangian in all unknowns as soon as a step promises less than [`NEAR`] in
//! log-likelihood, quadratic to the end; where it is not positive along the constraints, the step is
//! Gauss-Newton's again.
//!
//! Steps are globalised by the ℓ₁ merit function φ + ν Σ|c|, ν from the reduction that the quadratic
//! model must promise (Byrd, Gilbert and Nocedal, 2000), with a second-order correction where a full
//! step is refused (Nocedal and Wright, section 18.3). Bounds are met by an active set: the Newton
//! system is factorised once, and variables are held and released in its small dense border.

mod bounds;
mod end;
mod iteration;
mod normal;
mod point;
mod search;
mod separable;
mod settings;
mod solution;
mod start;
mod status;
mod step;
mod units;

use std::time::Instant;

pub use iteration::{Control, Iteration};
pub use point::Evaluations;
pub use settings::Settings;
pub use solution::Solution;
pub use status::Status;
pub(crate) use units::Units;
pub use units::state_units;

use crate::interrupt::{Cause, Interrupt, current};
use crate::linalg::{KktSolver, kkt_for};
use crate::nlp::{Nlp, NotFinite, Reach};
use bounds::Active;
use point::Point;
use search::{FIRST_DAMPING, Merit, Watchdog};

/// Most by which a standard deviation changes in a step.
const TENFOLD: f64 = 10.0;
/// The exact Hessian takes over once a step promises less than this in log-likelihood.
const NEAR: f64 = 10.0;
/// Standard deviations have settled when the residuals ask for changes below this part of them.
const SETTLED: f64 = 0.1;
/// A shift above this is damping; below, it only makes a singular system regular.
const DAMPED: f64 = 1e-6;

/// Minimises from `start`. `watch` sees each iteration and may end the run.
///
/// ```
/// use phugoid::solver::{Control, Settings, Status, solve};
/// use phugoid::{Estimation, Experiment, Model, Parameter, Sigma};
///
/// let mut m = Model::new("ramp");
/// let (x, slope) = (m.state("x", "m")?, m.parameter(Parameter::new("slope", 0.0))?);
/// m.equation("x", slope, None)?;
/// m.output("x", x, "", None)?;
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
/// [`NotFinite`] when a function is not finite at the start ([`Nlp::explain`] says what); everything
/// else is a [`Status`].
pub fn solve(
    nlp: &dyn Nlp,
    start: &[f64],
    multipliers: Option<&[f64]>,
    settings: &Settings,
    watch: &mut dyn FnMut(&Iteration) -> Control,
) -> Result<Solution, NotFinite> {
    let limit = Interrupt::within(settings.time_limit);
    limit.run(|| solve_within(nlp, start, multipliers, settings, watch))
}

/// The same under the interrupt in force.
fn solve_within(
    nlp: &dyn Nlp,
    start: &[f64],
    multipliers: Option<&[f64]>,
    settings: &Settings,
    watch: &mut dyn FnMut(&Iteration) -> Control,
) -> Result<Solution, NotFinite> {
    let plain = Settings { regression: false, ..settings.clone() };
    let mut run = Run::new(nlp, start, multipliers, settings)?;
    let mut status = run.go(watch)?;
    // Not long, where it leads nowhere.
    let iterations = run.history.last().map_or(0, |l| l.number);
    let capped =
        Settings { max_iterations: settings.max_iterations.min(3 * iterations + 10), ..plain.clone() };
    if let Some(rival) = run.rival.take() {
        status = run.challenge(status, &rival, &capped, watch)?;
    }
    if settings.regression && settings.wide && run.doubtful(status) {
        let places = if run.interrupt.stops() {
            Vec::new()
        } else {
            Run::new(nlp, start, None, &plain)?.further_places(start)
        };
        for place in places {
            status = run.challenge(status, &place, &plain, watch)?;
            if !run.doubtful(status) {
                break;
            }
        }
    }
    if settings.regression && status.lost() && !run.interrupt.stops() {
        // A regression may lead astray, as where parameters are in exponents. Once more without.
        let mut again = Run::new(nlp, start, multipliers, &plain)?;
        again.take_over(&mut run);
        status = again.go(watch)?;
        return Ok(again.finish(status));
    }
    Ok(run.finish(status))
}

/// Everything that the loop keeps: allocated once.
struct Run<'a> {
    nlp: &'a dyn Nlp,
    settings: &'a Settings,
    began: Instant,
    interrupt: Interrupt,
    kkt: Box<dyn KktSolver>,
    bounds: (Vec<f64>, Vec<f64>),
    units: Units,
    /// Sizes of the border variables at the first point at which each has influence; before, 0. Of a program without
    /// chains those of all variables.
    sizes: Vec<f64>,
    here: Point,
    trial: Point,
    gradient: Vec<f64>,
    jacobian: Vec<f64>,
    hessian: Vec<f64>,
    lambda: Vec<f64>,
    /// Newton step and new multipliers.
    d: Vec<f64>,
    next_lambda: Vec<f64>,
    p: Vec<f64>,
    q: Vec<f64>,
    correction: (Vec<f64>, Vec<f64>),
    active: Active,
    merit: Merit,
    watchdog: Watchdog,
    profile: Vec<f64>,
    /// Whether the exact Hessian is in use.
    near: bool,
    /// Whether it is that of the system at hand.
    bent: bool,
    shift: f64,
    /// The last that a step needed.
    damping: f64,
    count: Evaluations,
    history: Vec<Iteration>,
    detail: String,
    /// Where the regression from the start itself ended, where another place was chosen.
    rival: Option<Vec<f64>>,
}

impl<'a> Run<'a> {
    fn new(
        nlp: &'a dyn Nlp,
        start: &[f64],
        multipliers: Option<&[f64]>,
        settings: &'a Settings,
    ) -> Result<Self, NotFinite> {
        let (n, m) = (nlp.n(), nlp.m());
        let bounds = nlp.bounds();
        let units = Units::new(nlp, start);
        let mut here = Point::new(start, m);
        here.step(start, 0.0, &vec![0.0; n], &bounds);
        let mut run = Run {
            nlp,
            settings,
            began: Instant::now(),
            interrupt: current(),
            kkt: kkt_for(nlp, &units.states),
            active: Active::new(&bounds, nlp.n_parameters().min(n)),
            bounds,
            sizes: units.first_sizes(nlp, start),
            units,
            watchdog: Watchdog::new(&here),
            trial: here.clone(),
            gradient: vec![0.0; n],
            jacobian: vec![0.0; nlp.jacobian_structure().len()],
            hessian: vec![0.0; nlp.hessian_structure().len()],
            here,
            lambda: multipliers.map_or_else(|| vec![0.0; m], <[f64]>::to_vec),
            d: vec![0.0; n],
            next_lambda: vec![0.0; m],
            p: vec![0.0; n],
            q: vec![0.0; m],
            correction: (vec![0.0; n], vec![0.0; m]),
            merit: Merit::default(),
            profile: vec![0.0; nlp.profiled().len()],
            near: !settings.gauss_newton || multipliers.is_some(),
            bent: false,
            shift: 0.0,
            damping: FIRST_DAMPING,
            count: Evaluations::default(),
            history: Vec::with_capacity(settings.max_iterations.min(1000) + 1),
            detail: String::new(),
            rival: None,
        };
        // The start is always known: it may be all that is left.
        Interrupt::shielded(|| run.here.evaluate(nlp, &run.units, &mut run.count))?;
        Ok(run)
    }

    /// Goes on counting where another run ended.
    fn take_over(&mut self, other: &mut Run<'_>) {
        self.began = other.began;
        self.count = other.count;
        self.history = std::mem::take(&mut other.history);
    }

    /// Whether another place should be tried.
    fn doubtful(&self, status: Status) -> bool {
        status.lost() || status == Status::Unidentifiable || (!status.unfinished() && self.cornered())
    }

    /// Runs from another place, and becomes that run where it ends better: with a greater likelihood, and at an end.
    fn challenge(
        &mut self,
        status: Status,
        place: &[f64],
        settings: &'a Settings,
        watch: &mut dyn FnMut(&Iteration) -> Control,
    ) -> Result<Status, NotFinite> {
        if status.unfinished() || self.interrupt.stops() {
            return Ok(self.stopped().unwrap_or(status));
        }
        let mut other = Run::new(self.nlp, place, None, settings)?;
        other.take_over(self);
        let end = other.go(watch)?;
        let rank = |s: Status, run: &Run<'_>| (s.lost() || s.unfinished(), run.here.objective);
        if rank(end, &other) < rank(status, self) {
            *self = other;
            return Ok(end);
        }
        self.take_over(&mut other);
        Ok(if end == Status::Interrupted { end } else { status })
    }

    /// How the run ends where it has been stopped.
    fn stopped(&self) -> Option<Status> {
        self.interrupt.cause().map(|cause| match cause {
            Cause::Stopped => Status::Interrupted,
            Cause::TimeLimit => Status::TimeLimit,
        })
    }

    fn go(&mut self, watch: &mut dyn FnMut(&Iteration) -> Control) -> Result<Status, NotFinite> {
        if self.settings.regression {
            self.regress();
        }
        if let Some(status) = self.stopped() {
            return Ok(status);
        }
        let mut line = Iteration {
            number: self.history.last().map_or(0, |l| l.number + 1),
            objective: self.here.objective,
            defect: self.here.worst,
            promise: f64::INFINITY,
            step: 0.0,
            trials: 0,
            shift: 0.0,
            exact: self.near,
        };
        let mut last_gain = f64::INFINITY;
        loop {
            let mut promise = self.newton_step();
            // Steps on trust may lead where nothing is finite any more.
            if promise.is_err() && self.go_back() {
                self.detail.clear();
                promise = self.newton_step();
            }
            if self.shift > DAMPED && promise.is_ok_and(|p| p.gain < NEAR) {
                // Small for the damping alone?
                self.shift = 0.0;
                promise = self.undamped();
            }
            line.promise = promise.map_or(f64::INFINITY, |p| p.gain);
            if let Some(status) = self.stopped() {
                self.detail.clear();
                line.promise = f64::INFINITY;
                self.history.push(line);
                return Ok(status);
            }
            if promise.is_err() && self.history.is_empty() && self.detail.is_empty() {
                return Err(NotFinite);
            }
            self.history.push(line);
            if watch(&line) == Control::Stop {
                return Ok(Status::Interrupted);
            }
            let promise = match promise {
                Ok(promise) => promise,
                Err(status) => return Ok(status),
            };
            let exact = self.near;
            // Below the floor only rounding keeps the promise up: it no longer falls from step to step.
            let spent = promise.gain <= promise.floor && promise.gain > 0.1 * last_gain;
            let done = promise.gain <= self.settings.tolerance.powi(2) || spent;
            last_gain = if exact { promise.gain } else { f64::INFINITY };
            if done && exact {
                // The last step costs nothing more than to see that it does no harm.
                self.take_last_step();
                return Ok(self.verdict());
            }
            if line.number >= self.settings.max_iterations {
                return Ok(Status::IterationLimit);
            }
            if promise.gain < NEAR && self.crawls() {
                self.detail = self.farthest_names();
                return Ok(Status::Acceptable);
            }
            let searched = self.search(&promise);
            if let Some(status) = self.stopped().filter(|_| searched.is_none()) {
                return Ok(status);
            }
            if searched.is_none()
                && let Some(status) = self.stuck(&promise)
            {
                return Ok(status);
            }
            let (step, trials) = searched.unwrap_or((0.0, 0));
            if !exact && step > 0.0 {
                let settled = self.update_noise(step);
                self.near = promise.gain < NEAR && step == 1.0 && settled;
            }
            if self.grown() {
                // On trust only? Then back, to smaller steps.
                if !self.go_back() {
                    return Ok(Status::Diverging);
                }
                self.detail.clear();
            }
            line = Iteration {
                number: line.number + 1,
                objective: self.here.objective,
                defect: self.here.worst,
                promise: f64::INFINITY,
                step,
                trials,
                shift: self.shift,
                exact,
            };
        }
    }

    /// Standard deviations from the residuals, after a step; whether they had settled before. They only come
    /// down after a full step: at the end of a part of one, states do not follow their equations, and small
    /// residuals mean nothing.
    fn update_noise(&mut self, step: f64) -> bool {
        let roots = self.nlp.profiled();
        if roots.is_empty() {
            return true;
        }
        self.count.gradient += 1;
        if self.nlp.gradient(&self.here.xi, &mut self.gradient).is_err() || self.interrupt.stops() {
            return false;
        }
        let reach = Reach::Step { up: TENFOLD, down: if step == 1.0 { TENFOLD } else { 1.0 } };
        let change = self.nlp.profile(&self.here.xi, &self.gradient, &reach, &mut self.profile);
        self.here.xi[roots].copy_from_slice(&self.profile);
        // It was finite, and can only come down. Stopped between, the point would not go with its objective.
        let _ = Interrupt::shielded(|| self.here.evaluate_objective(self.nlp, &mut self.count));
        change < SETTLED
    }
}
