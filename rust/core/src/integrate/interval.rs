//! The integration over an interval in which inputs are smooth: steps of the length that the error allows, explicit ones
//! until their length is a matter of stability rather than of exactness, and implicit ones from then on.

use super::dop853::Dop853;
use super::field::Field;
use super::radau::Radau;
use crate::interrupt::{Cause, Interrupt, current};

/// Most steps of an interval.
const STEPS: usize = 100_000;
/// Steps after which the interrupt is asked.
const ASK: usize = 16;
/// A system is stiff when so many steps were as long as stability allows, and no more than so many others in between.
const STIFF: (u32, u32) = (15, 6);
/// After so many explicit steps in an interval implicit ones are tried: near a steady state, where slopes are rounding errors,
/// stiffness does not always show.
const MANY: usize = STEPS / 5;
/// A step is this part of what the error allows; it changes by no more than these factors.
const SAFETY: f64 = 0.9;
const SHORTER: f64 = 0.2;
const LONGER: f64 = 10.0;

/// The reason why an interval was not finished.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lost {
    /// No step is short enough.
    Step,
    /// Too many steps.
    Steps,
    /// Stopped from outside.
    Stopped,
    /// Out of time.
    TimeLimit,
}

/// The integration method.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Explicit ones, and implicit ones from where the system is stiff.
    #[default]
    Automatic,
    /// Dormand and Prince's method of order 8.
    Explicit,
    /// Radau IIA of order 5.
    Implicit,
}

/// The state of an integration.
pub(crate) struct Adaptive {
    /// The state.
    pub x: Vec<f64>,
    /// Time since the interval began.
    pub t: f64,
    /// Ends of the steps taken in the interval, as times since it began.
    pub taken: Vec<f64>,
    relative: f64,
    /// Errors of the states that are allowed however small these are.
    pub absolute: Vec<f64>,
    /// The length of the next step.
    step: f64,
    explicit: Dop853,
    implicit: Radau,
    /// Whether implicit steps are taken.
    stiff: bool,
    /// Steps at the limit of stability, and since.
    limited: (u32, u32),
    method: Method,
    interrupt: Interrupt,
}

impl Adaptive {
    pub fn new(x: &[f64], relative: f64, absolute: Vec<f64>, method: Method) -> Adaptive {
        let n = x.len();
        Adaptive {
            x: x.to_vec(),
            t: 0.0,
            taken: Vec::new(),
            relative,
            absolute,
            step: f64::INFINITY,
            explicit: Dop853::new(n),
            implicit: Radau::new(n),
            stiff: method == Method::Implicit,
            limited: (0, 0),
            method,
            interrupt: current(),
        }
    }

    /// Goes to the end of an interval that the field has entered.
    pub fn interval(&mut self, field: &mut Field<'_>, length: f64) -> Result<(), Lost> {
        self.t = 0.0;
        self.taken.clear();
        field.bad = None;
        let mut slope = std::mem::take(&mut self.explicit.slope);
        let finite = field.slope(0.0, &self.x, &mut slope);
        self.explicit.slope = slope;
        if !finite {
            return Err(Lost::Step);
        }
        if self.step.is_infinite() {
            self.step = self.first_step(length);
        }
        for number in 0..STEPS {
            if number % ASK == 0 {
                match self.interrupt.cause() {
                    Some(Cause::Stopped) => return Err(Lost::Stopped),
                    Some(Cause::TimeLimit) => return Err(Lost::TimeLimit),
                    None => {}
                }
            }
            self.stiff |= number == MANY && self.method == Method::Automatic;
            let left = length - self.t;
            let last = self.step >= left * (1.0 - 1e-12);
            let h = if last { left } else { self.step };
            let to = if last { length } else { self.t + h };
            let mut error = self.try_step(field, h);
            if error.is_some_and(|e| e <= 1.0) {
                let next = if self.stiff { &self.implicit.next } else { &self.explicit.next };
                error = error.filter(|_| !field.has_pole_between((self.t, h), &self.x, next));
            }
            // The implicit method's error is that of a method of order 3.
            let order = if self.stiff { 4.0 } else { 8.0 };
            let Some(error) = error.filter(|e| *e <= 1.0) else {
                let factor = error.map_or(SHORTER, |e| (SAFETY * e.powf(-1.0 / order)).max(SHORTER));
                self.step = factor * h;
                if self.t + self.step <= self.t || self.step < 1e-30 * length {
                    return Err(Lost::Step);
                }
                continue;
            };
            self.accept(field, to)?;
            self.taken.push(to);
            self.stiff |= self.limited.0 >= STIFF.0 && self.method == Method::Automatic;
            let grown = h * (SAFETY * error.max(1e-16).powf(-1.0 / order)).min(LONGER);
            // A short last step says nothing of the next.
            self.step = if last { grown.max(self.step.min(length)) } else { grown };
            if last {
                return Ok(());
            }
        }
        Err(Lost::Steps)
    }

    fn try_step(&mut self, field: &mut Field<'_>, h: f64) -> Option<f64> {
        let tolerance = (self.relative, &*self.absolute);
        if self.stiff {
            return self.implicit.step(field, (self.t, h), (&self.x, &self.explicit.slope), tolerance);
        }
        let (error, limited) = self.explicit.step(field, (self.t, h), &self.x, tolerance)?;
        if error <= 1.0 {
            self.count(limited);
        }
        Some(error)
    }

    /// Whether the length of steps is a matter of stability.
    fn count(&mut self, limited: bool) {
        self.limited = match self.limited {
            (at, _) if limited => (at + 1, 0),
            (at, since) if at > 0 && since + 1 < STIFF.1 => (at, since + 1),
            _ => (0, 0),
        };
    }

    fn accept(&mut self, field: &mut Field<'_>, to: f64) -> Result<(), Lost> {
        self.t = to;
        let Dop853 { slope, next, next_slope, .. } = &mut self.explicit;
        if !self.stiff {
            self.x.copy_from_slice(next);
            std::mem::swap(slope, next_slope);
            return Ok(());
        }
        self.x.copy_from_slice(&self.implicit.next);
        if field.slope(to, &self.x, slope) { Ok(()) } else { Err(Lost::Step) }
    }

    /// A length in which the state moves by a hundredth of its size.
    fn first_step(&self, length: f64) -> f64 {
        let size = |v: &[f64]| {
            let parts = v.iter().zip(&self.x).zip(&self.absolute);
            parts.map(|((v, x), a)| (v / (a + self.relative * x.abs())).powi(2)).sum::<f64>().sqrt()
        };
        let (state, slope) = (size(&self.x), size(&self.explicit.slope));
        let first = 0.01 * state / slope;
        if first > 0.0 && first.is_finite() { first.min(length) } else { 1e-3 * length }
    }
}
