//! The watchdog: full steps on trust (Chamberlain, Powell, Lemarechal and Pedersen, 1982).

use super::iterate::Iterate;
use super::point::Point;
use super::promise::Promise;

/// Most full steps in a row without a lower merit function, until such steps have led nowhere.
const PATIENCE: usize = 8;
/// Trust ends where a defect is so many times what it was, or what its state does, or where so many times
/// the likelihood is lost that the step promised, and no less than `NEAR`.
const ASTRAY: f64 = 10.0;
const LOST: f64 = 100.0;

/// The merit function may rise for some steps, as it does along curved constraints and on the way out of a bad
/// valley, if it is lower in the end than where it began to rise; if not, the search goes back there.
#[derive(Clone, Debug)]
pub(super) struct Watchdog {
    back: Point,
    multipliers: Vec<f64>,
    /// ∇φᵀd of the step that began there.
    slope: f64,
    /// Steps since the merit function was lowest; 0 where it is so now.
    age: usize,
    /// Most such steps: half as many each time that they led nowhere.
    patience: usize,
    /// The next step must lower it.
    strict: bool,
}

impl Watchdog {
    pub fn new(point: &Point) -> Watchdog {
        let multipliers = vec![0.0; point.c.len()];
        Watchdog { back: point.clone(), multipliers, slope: 0.0, age: 0, patience: PATIENCE, strict: false }
    }

    /// Whether the iterate is one of trust, and a better one is kept.
    pub fn on_trust(&self) -> bool {
        self.age > 0
    }

    /// The kept point.
    pub fn back(&self) -> &Point {
        &self.back
    }

    /// The point from which the merit function must fall, with the slope of φ there: on trust, less than where it
    /// began, by what the first of these steps was to bring.
    pub fn reference<'a>(&'a self, here: &'a Point, slope: f64) -> (&'a Point, f64) {
        if self.on_trust() { (&self.back, self.slope) } else { (here, slope) }
    }

    /// Whether a full step is taken on trust; the iterate is kept where the first such step begins.
    pub fn trusts(&mut self, iterate: &Iterate, trial: &Point, promise: &Promise, near: f64) -> bool {
        if self.strict {
            return false;
        }
        if !self.on_trust() {
            self.back.copy(&iterate.point);
            self.multipliers.copy_from_slice(&iterate.multipliers);
            self.slope = promise.slope;
        }
        let lost = trial.objective - self.back.objective;
        let usual = if promise.gain < near { 0.03 } else { 1.0 };
        let sane =
            trial.worst <= ASTRAY * self.back.worst.max(usual) && lost <= LOST * promise.gain.max(near);
        sane && self.age < self.patience
    }

    /// A step was taken on trust.
    pub fn trusted(&mut self) {
        (self.age, self.strict) = (self.age + 1, false);
    }

    /// A step has lowered the merit function; whether a full one, which justifies the trust before.
    pub fn lowered(&mut self, justified: bool) {
        if justified && self.on_trust() {
            self.patience = PATIENCE;
        }
        (self.age, self.strict) = (0, false);
    }

    /// Back to where the merit function was lowest; the next step must lower it. Whether there is such a
    /// point.
    pub fn go_back(&mut self, iterate: &mut Iterate) -> bool {
        if !self.on_trust() {
            return false;
        }
        iterate.set(&self.back, &self.multipliers);
        (self.age, self.strict) = (0, true);
        self.patience /= 2;
        true
    }
}
