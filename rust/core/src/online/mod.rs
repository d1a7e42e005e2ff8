//! Estimation while the data arrive: states, parameters and noise after each sample, by square-root information filtering and
//! estimation on a moving horizon.
//!
//! # What is minimised
//!
//! The window holds the latest L samples. Unknown are the states x_0 … x_{L−1} there and the parameters θ. All samples before are
//! the arrival cost, a square of a triangular matrix R times the distance from where these were eliminated:
//!
//! ```text
//!   minimise  ‖ R (x_0 − x̄; θ − θ̄) − z ‖² + Σ_k Σ_c ((y_c(t_k) − g_c(x_k, u_k, θ)) / σ_c)² + Σ_k ‖ w_k ‖²
//!
//!   subject to  x_{k+1} = Φ(x_k, u, θ) + G w_k
//! ```
//!
//! Φ is the solution of the state equations over an interval by Runge-Kutta steps, with their exact derivatives, and G holds the
//! standard deviations of the process noise, where there is any. A Gauss-Newton iteration goes once through the window by orthogonal
//! transformations, parameters in the border, and back by substitution (G. J. Bierman, *Factorization Methods for Discrete
//! Sequential Estimation*, 1977). A sample is appended; then the oldest one is eliminated into the arrival cost, linearised at its
//! last estimate. With L = 1 that is the iterated extended Kalman filter for states and parameters; with more it is
//! estimation on a moving horizon (C. V. Rao, J. B. Rawlings and D. Q. Mayne, *IEEE Transactions on Automatic Control* 48, 2003).
//!
//! # Time and memory
//!
//! All memory is there after [`Online::new`]; [`Online::push`] takes none, and [`Online::work`] says how many operations
//! it needs at most.
//!
//! ```
//! use phugoid::online::{Online, Settings};
//! use phugoid::{Model, Parameter};
//!
//! let mut m = Model::new("lag");
//! let (x, u) = (m.state("x", "")?, m.input("u", "")?);
//! let a = m.parameter(Parameter::new("a", 0.5))?;
//! m.equation("x", a * (u - &x))?;
//! m.output("y", x, "")?;
//!
//! let mut online = Online::new(&m, Settings::default().sigma("y", 0.01).parameter("a", 1.0).window(5))?;
//! let mut x = 0.0;
//! for k in 0..200 {
//!     let (t, u) = (0.1 * k as f64, f64::from(k % 40 < 20));
//!     let estimate = online.push(t, &[u], &[x])?; // NaN where an output is missing
//!     assert!(estimate.innovations[0].abs() < 1.0);
//!     x += (1.0 - (-0.2f64).exp()) * (u - x); // a = 2, u held
//! }
//! let estimate = online.estimate();
//! println!("a = {:.2} ± {:.2}", estimate.parameters[0], estimate.parameter_errors[0]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bounds;
mod change;
mod detector;
mod error;
mod estimate;
mod evidence;
mod forgetting;
mod gauss_newton;
mod horizon;
mod innovation;
mod map;
mod noise;
mod report;
mod sensors;
mod settings;
mod shift;
mod start;
mod transition;
mod triangle;

use std::time::{Duration, Instant};

use crate::error::Error;
use crate::model::Model;
use detector::Detector;
pub use detector::{Alarm, Cause, Detect};
pub use error::OnlineError;
pub use estimate::{Arrival, Estimate};
use gauss_newton::{Fault, GaussNewton};
use horizon::{Horizon, Place};
use innovation::Innovation;
use noise::NoiseLevel;
pub use settings::{Forgetting, Settings};
use start::{Initial, Names, Prepared, prepare};

/// An estimator that takes one sample after the other. See the [module](self).
pub struct Online {
    names: Names,
    settings: Settings,
    solver: GaussNewton,
    horizon: Horizon,
    /// What the horizon and the noise were before a sample.
    saved: Horizon,
    saved_noise: NoiseLevel,
    noise: NoiseLevel,
    innovation: Innovation,
    detector: Option<Detector>,
    initial: Vec<Initial>,
    held: Vec<bool>,
    /// Whether the first window is not full yet.
    beginning: bool,
    /// Whether there is a sample before the next one.
    started: bool,
    inverse: Vec<f64>,
    estimate: Estimate,
}

impl Online {
    /// Prepares the estimation of all free parameters of a model.
    ///
    /// # Errors
    /// As [`Model::check`]; for options that are out of range or name what the model does not have; for an output without a standard
    /// deviation of its noise; for delays, and noise that is not independent and Gaussian.
    pub fn new(model: &Model, settings: Settings) -> Result<Online, Error> {
        let Prepared { names, solver, horizon, noise, detector, initial, held } = prepare(model, &settings)?;
        let (n, m, n_y) = (names.states.len(), solver.info.m, names.outputs.len());
        let estimate = Estimate {
            t: f64::NAN,
            states: vec![f64::NAN; n],
            state_errors: vec![f64::NAN; n],
            parameters: solver.values.clone(),
            parameter_errors: vec![0.0; solver.values.len()],
            at_bound: vec![false; solver.values.len()],
            covariance: vec![f64::NAN; m * m],
            sigma: noise.sigma.clone(),
            innovations: vec![f64::NAN; n_y],
            innovation_errors: vec![f64::NAN; n_y],
            normalised: vec![f64::NAN; n_y],
            ..Estimate::default()
        };
        Ok(Online {
            innovation: Innovation::new(n_y, m),
            inverse: vec![0.0; m * m],
            saved: horizon.clone(),
            saved_noise: noise.clone(),
            names,
            settings,
            solver,
            horizon,
            noise,
            detector,
            initial,
            held,
            beginning: true,
            started: false,
            estimate,
        })
    }

    /// The estimate after the last sample that was taken; start values before the first.
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    /// Takes a sample: time, s, inputs in the order of the model, and measured outputs, NaN where missing.
    ///
    /// A sample that is older than the latest one and within the window is put in there; inputs that are NaN then are those between
    /// its neighbours. An older one changes nothing and is [`Arrival::TooLate`].
    ///
    /// # Errors
    /// See [`OnlineError`]. The estimator then is as it was before the sample.
    pub fn push(&mut self, t: f64, inputs: &[f64], outputs: &[f64]) -> Result<&Estimate, OnlineError> {
        let began = Instant::now();
        let place = self.check(t, inputs, outputs)?;
        if place == Place::TooLate {
            self.estimate.arrival = Arrival::TooLate;
            return Ok(&self.estimate);
        }
        self.saved.copy_from(&self.horizon);
        self.saved_noise.copy_from(&self.noise);
        match self.take(place, t, inputs, outputs).and_then(|()| self.improve(place == Place::Latest, began))
        {
            Ok(()) => Ok(&self.estimate),
            Err(fault) => {
                std::mem::swap(&mut self.horizon, &mut self.saved);
                std::mem::swap(&mut self.noise, &mut self.saved_noise);
                Err(self.error(fault, t))
            }
        }
    }

    /// Ends the record: samples that follow belong to a new one, with new states and the same parameters, on which all information
    /// is kept.
    pub fn restart(&mut self) {
        while self.horizon.used > 0 {
            let done =
                self.solver.eliminate_first(&mut self.horizon, &self.noise.sigma, self.settings.forgetting);
            if done.is_err() {
                // What the samples of a window that is not finite would add is lost.
                self.horizon.used = 0;
            }
        }
        let (n, w) = (self.initial.len(), self.horizon.arrival.width());
        self.horizon.arrival.r[..n * w].fill(0.0);
        self.started = false;
        if let Some(detector) = &mut self.detector {
            detector.reset();
        }
    }

    /// Forgets the evidence of the detector, and its alarm.
    pub fn acknowledge(&mut self) {
        if let Some(detector) = &mut self.detector {
            detector.reset();
        }
        self.estimate.alarm = None;
    }

    /// Floating-point operations of [`Online::push`], at most: multiplications and additions apart, and a function such as a sine
    /// as one.
    pub fn work(&self) -> u64 {
        let m = self.solver.info.m as u64;
        let Settings { window, first_window, iterations, .. } = self.settings;
        let solver = self.solver.bound(
            window.max(first_window),
            iterations,
            first_window.saturating_sub(window).max(1),
        );
        let detector = self.detector.as_ref().map_or(0, |d| d.changes.bound());
        solver + self.innovation.bound() + detector + 2 * m * m * m / 3 + 2 * m * m
    }

    /// Operations so far, counted where they are done.
    #[doc(hidden)]
    pub fn worked(&self) -> u64 {
        let detector = self.detector.as_ref().map_or(0, |d| d.changes.flops());
        self.solver.flops() + self.innovation.flops() + detector
    }

    fn check(&self, t: f64, inputs: &[f64], outputs: &[f64]) -> Result<Place, OnlineError> {
        let counts = [
            ("inputs", inputs.len(), self.names.inputs.len()),
            ("outputs", outputs.len(), self.names.outputs.len()),
        ];
        for (what, given, wanted) in counts {
            if given != wanted {
                return Err(OnlineError::Length { what, given, wanted });
            }
        }
        if !t.is_finite() {
            return Err(OnlineError::Time(t));
        }
        let place = self.horizon.place(t);
        let late = place != Place::Latest;
        let wrong_input = |v: f64| v.is_infinite() || (v.is_nan() && !late);
        let input = self.names.inputs.iter().zip(inputs).find(|c| wrong_input(*c.1));
        let output = self.names.outputs.iter().zip(outputs).find(|c| c.1.is_infinite());
        if let Some((channel, value)) = input.or(output) {
            return Err(OnlineError::NotFinite { channel: channel.clone(), value: *value, t });
        }
        let Some(last) = self.horizon.last().map(|node| node.t) else { return Ok(place) };
        let limit = self.settings.max_gap;
        if place == Place::Latest && t - last > limit {
            return Err(OnlineError::Gap { t, last, limit });
        }
        if place == Place::TooLate && last - t > limit {
            return Err(OnlineError::JumpsBack { t, last });
        }
        if let Place::At(k) = place {
            let own = &self.horizon.nodes[k].outputs;
            let new = own.iter().zip(outputs).any(|(own, new)| own.is_nan() && !new.is_nan());
            let twice = own.iter().zip(outputs).any(|(own, new)| !own.is_nan() && !new.is_nan());
            if twice || !new {
                return Err(OnlineError::Repeated { t });
            }
        }
        Ok(place)
    }

    fn error(&self, fault: Fault, t: f64) -> OnlineError {
        match fault {
            Fault::State(i) => OnlineError::Diverged { t, name: self.names.states[i].clone() },
            Fault::Output(c) => OnlineError::Diverged { t, name: self.names.outputs[c].clone() },
            Fault::Singular => OnlineError::Singular { t },
        }
    }

    /// Puts a sample into the window, and eliminates the oldest one where it is too long then.
    fn take(&mut self, place: Place, t: f64, inputs: &[f64], outputs: &[f64]) -> Result<(), Fault> {
        match place {
            Place::TooLate => {}
            Place::At(k) => {
                self.horizon.merge(k, outputs);
            }
            Place::Latest if self.horizon.used == 0 => {
                self.horizon.open(0, t, inputs, outputs);
                self.begin();
            }
            Place::Latest | Place::Before(_) => {
                let k = if let Place::Before(k) = place { k } else { self.horizon.used };
                self.horizon.open(k, t, inputs, outputs);
                if let Place::Before(_) = place {
                    self.horizon.complete(k, &self.held);
                }
                self.solver.load(&self.horizon.theta);
                self.solver.predict(&mut self.horizon.nodes[k - 1..=k])?;
            }
        }
        let (window, first) = (self.settings.window, self.settings.first_window);
        let begins = self.beginning && first > window;
        if self.horizon.used > if begins { first } else { window } {
            while self.horizon.used > window {
                self.solver.eliminate_first(
                    &mut self.horizon,
                    &self.noise.sigma,
                    self.settings.forgetting,
                )?;
            }
        }
        Ok(())
    }

    /// The first state, with a standard deviation, in front of all samples.
    fn begin(&mut self) {
        let Horizon { nodes, arrival, reference, .. } = &mut self.horizon;
        let (node, w) = (&mut nodes[0], arrival.width());
        for (i, initial) in self.initial.iter().enumerate() {
            let (value, deviation) = initial.at(&node.outputs, &self.noise.sigma);
            node.x[i] = value;
            reference[i] = value;
            arrival.r[i * w + i] = 1.0 / deviation;
        }
    }

    /// Iterates, and reports.
    fn improve(&mut self, latest: bool, began: Instant) -> Result<(), Fault> {
        let (mut iterations, mut converged, mut in_time) = (0, false, true);
        let mut longest = Duration::ZERO;
        while iterations < self.settings.iterations && !converged {
            let now = began.elapsed();
            let late = self.settings.deadline.is_some_and(|limit| now + longest > limit);
            if late && iterations > 0 {
                in_time = false;
                break;
            }
            self.solver.forward(&self.horizon, &self.noise.sigma)?;
            if iterations == 0 && !self.innovation.update(&mut self.solver) {
                return Err(self.innovation.fault(&self.solver.present));
            }
            if iterations == 0 && latest {
                self.notice();
            }
            let decrement = self.solver.backward(&mut self.horizon);
            if !decrement.is_finite() {
                let last = self.horizon.last().and_then(|node| node.x.iter().position(|x| !x.is_finite()));
                return Err(Fault::State(last.unwrap_or(0)));
            }
            iterations += 1;
            converged = decrement < self.settings.tolerance * self.settings.tolerance;
            longest = longest.max(began.elapsed() - now);
        }
        if let Some(limit) = self.settings.deadline {
            in_time &= began.elapsed() <= limit;
        }
        self.report(latest);
        self.started = true;
        self.beginning &= self.horizon.used < self.settings.first_window;
        let estimate = &mut self.estimate;
        (estimate.iterations, estimate.converged, estimate.in_time) = (iterations, converged, in_time);
        Ok(())
    }
}
