//! Damping of the parameters by a shift of the reduced Hessian (Levenberg, 1944), in units of its diagonal.

/// What is tried first in a search, and the limits there.
const FIRST: f64 = 1e-2;
const LEAST: f64 = 1e-9;
const MOST: f64 = 1e6;
/// Greatest shift that makes a system regular.
const GREATEST: f64 = 1e8;
/// A shift above this is damping; below, it only makes a singular system regular.
const DAMPED: f64 = 1e-6;
/// Shifts of the exact system that rounding explains.
pub(super) const ROUNDED: [f64; 3] = [1e-12, 1e-10, 1e-8];

/// Whether a shift is one that damps.
pub(super) fn damps(shift: f64) -> bool {
    shift > DAMPED
}

/// The shift in force, and the last that a step needed.
#[derive(Clone, Debug)]
pub(super) struct Damping {
    shift: f64,
    last: f64,
}

impl Damping {
    pub fn new() -> Damping {
        Damping { shift: 0.0, last: FIRST }
    }

    pub fn shift(&self) -> f64 {
        self.shift
    }

    pub fn set(&mut self, shift: f64) {
        self.shift = shift;
    }

    /// Whether rounding explains the shift.
    pub fn is_rounding(&self) -> bool {
        self.shift <= ROUNDED[2]
    }

    /// More of it, and no less than this; whether it is still within limits.
    pub fn raise(&mut self, least: f64) -> bool {
        self.shift = (self.shift * 100.0).max(least);
        self.shift <= GREATEST
    }

    /// Less after a step that went well.
    pub fn relax(&mut self) {
        self.shift *= 0.1;
        if self.shift < FIRST {
            self.shift = 0.0;
        }
    }

    /// The shifts that a search tries one after the other.
    pub fn trials(&self) -> impl Iterator<Item = f64> + use<> {
        let first = (0.1 * self.last).max(self.shift).max(LEAST);
        std::iter::successors(Some(first), |shift| Some(10.0 * shift)).take_while(|shift| *shift < MOST)
    }

    /// Keeps the shift that a step needed.
    pub fn keep(&mut self, shift: f64) {
        (self.shift, self.last) = (shift, shift);
    }
}
