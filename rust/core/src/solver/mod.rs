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
mod normal;
mod point;
mod search;
mod settings;
mod start;
mod status;
mod units;

use std::time::{Duration, Instant};

pub use point::Evaluations;
pub use settings::Settings;
pub use status::Status;
pub use units::state_units;

use crate::linalg::{Curvature, KktSolver, kkt_for};
use crate::nlp::{Nlp, NotFinite, Reach};
use bounds::Active;
use point::Point;
use search::{FIRST_DAMPING, Merit, Watchdog};
use units::Units;

/// Most by which a standard deviation changes in a step.
const TENFOLD: f64 = 10.0;
/// The exact Hessian takes over once a step promises less than this in log-likelihood.
const NEAR: f64 = 10.0;
/// Standard deviations have settled when the residuals ask for changes below this part of them.
const SETTLED: f64 = 0.1;
/// Size at which an unknown has grown without limit.
const ENDLESS: f64 = 1e15;
/// An end that meets this instead of the tolerance is acceptable, again a distance in standard errors.
const CLOSE: f64 = 1e-3;
/// Steps that need damping, among so many, and together gain less than this in log-likelihood: a valley without
/// an end in sight.
const VALLEY: (usize, usize, f64) = (10, 40, 0.1);
/// A shift above this is damping; below, it only makes a singular system regular.
const DAMPED: f64 = 1e-6;
/// Greatest shift of the reduced Hessian, in units of its diagonal, that is tried.
const GREATEST_SHIFT: f64 = 1e8;
/// Shifts of the exact system that rounding explains.
const ROUNDED: [f64; 3] = [1e-12, 1e-10, 1e-8];

/// One line of the iteration table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// From 0, the start.
    pub number: usize,
    /// φ: minus the log-likelihood, priors included.
    pub objective: f64,
    /// Largest defect in units of its state.
    pub defect: f64,
    /// What the next step promises to gain in log-likelihood, and defects to pretend: half the square of
    /// the distance from the optimum in standard errors. Infinite where there is no next step.
    pub promise: f64,
    /// Length of the step taken, 1 for a full one.
    pub step: f64,
    /// Points tried on the way.
    pub trials: usize,
    /// Shift of the reduced Hessian.
    pub shift: f64,
    /// Whether the Hessian was exact.
    pub exact: bool,
}

/// Whether to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// On.
    Continue,
    /// The best point so far is the result.
    Stop,
}

/// Where a run ended.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Variables.
    pub xi: Vec<f64>,
    /// Multipliers of the constraints.
    pub multipliers: Vec<f64>,
    /// How it ended.
    pub status: Status,
    /// The status's hint, with names.
    pub message: String,
    /// φ there.
    pub objective: f64,
    /// Largest defect in units of its state.
    pub defect: f64,
    /// Number of iterations.
    pub iterations: usize,
    /// How often what was evaluated.
    pub evaluations: Evaluations,
    /// Counted floating-point operations of one factorisation.
    pub flops: u64,
    /// Time spent.
    pub time: Duration,
    /// Units of the states.
    pub units: Vec<f64>,
    /// The table.
    pub history: Vec<Iteration>,
}

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
    let mut run = Run::new(nlp, start, multipliers, settings)?;
    let mut status = run.go(watch)?;
    let lost = matches!(status, Status::Failed | Status::Diverging | Status::Infeasible);
    if settings.regression && lost {
        // A regression may lead astray, as where parameters are in exponents. Once more without.
        let settings = Settings { regression: false, ..settings.clone() };
        let mut again = Run::new(nlp, start, multipliers, &settings)?;
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
    kkt: Box<dyn KktSolver>,
    bounds: (Vec<f64>, Vec<f64>),
    units: Units,
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
}

/// What a step promises.
#[derive(Clone, Copy, Debug)]
struct Promise {
    /// ∇φᵀd
    slope: f64,
    /// dᵀHd
    curvature: f64,
    /// Gain in φ if all goes as the model says, and what defects may pretend: distance from the end.
    gain: f64,
    /// What rounding leaves of that.
    floor: f64,
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
            kkt: kkt_for(nlp, &units.states),
            active: Active::new(&bounds),
            bounds,
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
        };
        run.here.evaluate(nlp, &run.units, &mut run.count)?;
        Ok(run)
    }

    /// Goes on counting where another run ended.
    fn take_over(&mut self, other: &mut Run<'_>) {
        self.began = other.began;
        self.count = other.count;
        self.history = std::mem::take(&mut other.history);
    }

    fn go(&mut self, watch: &mut dyn FnMut(&Iteration) -> Control) -> Result<Status, NotFinite> {
        if self.settings.regression {
            self.regress();
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
            if self.settings.time_limit.is_some_and(|limit| self.began.elapsed() >= limit) {
                return Ok(Status::TimeLimit);
            }
            if promise.gain < NEAR && self.crawls() {
                self.detail = self.farthest_names();
                self.go_back_if_better();
                return Ok(Status::Acceptable);
            }
            let searched = self.search(&promise);
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

    /// Derivatives at the present point, the Newton system, and its solution.
    fn newton_step(&mut self) -> Result<Promise, Status> {
        let nlp = self.nlp;
        self.count.gradient += 1;
        self.count.jacobian += 1;
        let mut fine = nlp.gradient(&self.here.xi, &mut self.gradient).is_ok();
        fine &= nlp.jacobian(&self.here.xi, &mut self.jacobian).is_ok();
        if !fine {
            return Err(self.not_finite());
        }
        let exact = self.near;
        self.bent = exact;
        self.kkt.set_refinement(exact);
        self.kkt.set_hurry(self.watchdog.on_trust());
        if exact {
            self.count.hessian += 1;
            fine = nlp.hessian(&self.here.xi, 1.0, &self.lambda, &mut self.hessian).is_ok();
            if !fine || !(self.factorize()?.is_positive() || self.nearly_positive()) {
                // Far from the end after all, or on a ridge.
                self.gauss_newton()?;
            }
        } else {
            self.gauss_newton()?;
        }
        self.solve_with_bounds();
        Ok(self.promise())
    }

    /// The step of the system at hand with no more shift than it needs to be positive.
    fn undamped(&mut self) -> Result<Promise, Status> {
        let found = self.kkt.finish(self.active.held(), 0.0);
        if self.bent && !found.is_positive() {
            return self.newton_step();
        }
        self.regular(found)?;
        self.solve_with_bounds();
        Ok(self.promise())
    }

    /// Whether the exact system lacks no more than what rounding takes where the data hardly tell: then it is shifted
    /// by that. Gauss-Newton steps could circle about such an optimum for long.
    fn nearly_positive(&mut self) -> bool {
        let before = self.shift;
        for shift in ROUNDED {
            self.shift = shift.max(before);
            if self.kkt.finish(self.active.held(), self.shift).is_positive() {
                return true;
            }
        }
        self.shift = before;
        false
    }

    /// The Gauss-Newton system, shifted until it is positive.
    fn gauss_newton(&mut self) -> Result<(), Status> {
        self.count.gauss_newton += 1;
        self.bent = false;
        if self.nlp.gauss_newton(&self.here.xi, 1.0, &mut self.hessian).is_err() {
            return Err(self.not_finite());
        }
        let found = self.factorize()?;
        self.regular(found)
    }

    fn regular(&mut self, mut found: Curvature) -> Result<(), Status> {
        while !found.is_positive() {
            self.shift = (self.shift * 100.0).max(1e-10);
            if self.shift > GREATEST_SHIFT {
                return Err(Status::Failed);
            }
            found = self.kkt.finish(self.active.held(), self.shift);
        }
        Ok(())
    }

    /// A derivative is not finite at a point where the functions are. At the start that is an error.
    fn not_finite(&mut self) -> Status {
        if !self.history.is_empty() {
            self.detail =
                self.nlp.explain(&self.here.xi).unwrap_or_else(|| "a derivative is not finite".into());
        }
        Status::Failed
    }

    fn factorize(&mut self) -> Result<Curvature, Status> {
        self.count.factorizations += 1;
        if let Err(singular) = self.kkt.factorize(&self.hessian, &self.jacobian) {
            self.detail = format!("the {} depends on others", self.nlp.constraint_name(singular.row));
            return Err(Status::Infeasible);
        }
        let profiled = if self.near { 0..0 } else { self.nlp.profiled() };
        self.active.begin(&self.here.xi, &self.bounds, &self.gradient, profiled);
        Ok(self.kkt.finish(self.active.held(), self.shift))
    }

    /// What the step promises.
    fn promise(&self) -> Promise {
        let slope: f64 = self.gradient.iter().zip(&self.d).map(|(g, d)| g * d).sum();
        let pull: f64 = self.next_lambda.iter().zip(&self.here.c).map(|(l, c)| l * c).sum();
        let pretended: f64 = self.next_lambda.iter().zip(&self.here.c).map(|(l, c)| (l * c).abs()).sum();
        // H d = −∇φ − Aᵀλ − z, and A d = −c.
        let curvature = -slope + pull - self.active.pull(&self.d);
        let border = self.nlp.chains().map_or(0, |c| c.border);
        let own = self.here.xi[border..].iter();
        let sizes: f64 = self.next_lambda.iter().zip(own).map(|(l, x)| (l * x).abs()).sum();
        Promise { slope, curvature, gain: 0.5 * slope.abs() + pretended, floor: 8.0 * f64::EPSILON * sizes }
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
        if self.nlp.gradient(&self.here.xi, &mut self.gradient).is_err() {
            return false;
        }
        let reach = Reach::Step { up: TENFOLD, down: if step == 1.0 { TENFOLD } else { 1.0 } };
        let change = self.nlp.profile(&self.here.xi, &self.gradient, &reach, &mut self.profile);
        self.here.xi[roots].copy_from_slice(&self.profile);
        // It was finite, and can only come down.
        let _ = self.here.evaluate_objective(self.nlp, &mut self.count);
        change < SETTLED
    }

    /// Whether a parameter has grown without limit.
    fn grown(&mut self) -> bool {
        let border = self.nlp.chains().map_or(self.here.xi.len(), |c| c.border);
        let own = self.nlp.profiled();
        let far = (0..border).find(|i| !own.contains(i) && self.here.xi[*i].abs() > ENDLESS);
        if let Some(i) = far {
            self.detail = format!("{} = {:.1e}", self.nlp.variable_name(i), self.here.xi[i]);
        }
        far.is_some()
    }

    fn take_last_step(&mut self) {
        self.trial.step(&self.here.xi, 1.0, &self.d, &self.bounds);
        if self.trial.evaluate(self.nlp, &self.units, &mut self.count).is_ok()
            && self.trial.objective <= self.here.objective + 1e-6
        {
            self.here.copy(&self.trial);
            self.lambda.copy_from_slice(&self.next_lambda);
        }
    }

    /// Nothing is left to gain: is it an optimum?
    fn verdict(&mut self) -> Status {
        if self.shift > 0.0 {
            let found = self.kkt.finish(self.active.held(), 0.0);
            if !found.is_positive() {
                self.detail = self.weak_names();
                return if found.negative > 0 { Status::Failed } else { Status::Unidentifiable };
            }
        }
        Status::Converged
    }

    /// Whether steps have become short because the likelihood hardly tells where to go.
    fn crawls(&self) -> bool {
        // Steps on trust may come between.
        let (count, among, least) = VALLEY;
        let damped = |line: &Iteration| line.shift > DAMPED && line.step > 0.0;
        let mut recent = self.history.iter().enumerate().rev().take(among).filter(|(_, line)| damped(line));
        let before = recent.nth(count - 1).and_then(|(first, _)| first.checked_sub(1));
        before.is_some_and(|k| (self.history[k].objective - self.here.objective).abs() < least)
    }

    /// Names of the parameters that the step changes most.
    fn farthest_names(&self) -> String {
        let border = self.nlp.chains().map_or(0, |c| c.border);
        let part = |i: &usize| self.d[*i].abs() / self.here.xi[*i].abs().max(1e-3);
        let mut order: Vec<usize> = (0..border).collect();
        order.sort_by(|a, b| part(b).total_cmp(&part(a)));
        let names: Vec<String> = order.iter().take(6).map(|&i| self.nlp.variable_name(i)).collect();
        format!("the data hardly determine {}", names.join(", "))
    }

    /// Names of the variables in directions without curvature.
    fn weak_names(&self) -> String {
        let name = |direction: &Vec<(usize, f64)>| {
            let most = direction.first().map_or(0.0, |x| x.1.abs());
            let mut part: Vec<usize> =
                direction.iter().filter(|x| x.1.abs() > 0.1 * most).map(|x| x.0).collect();
            part.sort_unstable();
            part.iter().take(6).map(|&i| self.nlp.variable_name(i)).collect::<Vec<_>>().join(", ")
        };
        self.kkt.weak_directions().iter().map(name).collect::<Vec<_>>().join("; ")
    }

    /// No step helped: try a shorter, safer direction; give up when these are spent.
    fn stuck(&mut self, promise: &Promise) -> Option<Status> {
        if promise.gain <= CLOSE.powi(2) + promise.floor {
            return Some(if self.shift == 0.0 { Status::Acceptable } else { self.verdict() });
        }
        if self.near && self.settings.gauss_newton {
            self.near = false;
            return None;
        }
        self.shift = (self.shift * 100.0).max(1e-4);
        if self.shift > GREATEST_SHIFT {
            let infeasible = self.here.worst > 1e-6;
            return Some(if infeasible { Status::Infeasible } else { Status::Failed });
        }
        None
    }

    fn finish(mut self, status: Status) -> Solution {
        if matches!(status, Status::IterationLimit | Status::TimeLimit | Status::Interrupted) {
            // The best point so far, not the last that was tried on trust.
            self.go_back_if_better();
        }
        let mut message = status.hint().to_owned();
        if matches!(status, Status::Infeasible | Status::Failed) && self.detail.is_empty() {
            self.detail = self.worst_defect();
        }
        if !self.detail.is_empty() {
            message = format!("{message} ({})", self.detail);
        }
        Solution {
            iterations: self.history.last().map_or(0, |l| l.number),
            flops: self.kkt.flops(),
            xi: self.here.xi,
            multipliers: self.lambda,
            status,
            message,
            objective: self.here.objective,
            defect: self.here.worst,
            evaluations: self.count,
            time: self.began.elapsed(),
            units: self.units.states,
            history: self.history,
        }
    }

    fn worst_defect(&self) -> String {
        let worst = self.here.c.iter().zip(self.units.each()).map(|(c, u)| c.abs() / u).enumerate();
        let Some((i, _)) = worst.max_by(|a, b| a.1.total_cmp(&b.1)) else { return String::new() };
        format!("the largest is the {}: {:.2e}", self.nlp.constraint_name(i), self.here.c[i])
    }
}
