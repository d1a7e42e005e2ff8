//! The ℓ₁ merit function.

use super::point::Point;
use super::promise::Promise;

/// Part of the promised decrease that must come true (Armijo).
const ARMIJO: f64 = 1e-4;
/// Part of the decrease of defects that the model must promise.
const RHO: f64 = 0.1;

/// How often ν may have to rise again after it was lowered. With a ν that goes up and down for ever two points may
/// each be better than the other (Nocedal and Wright 2006, section 18.3).
const RISES: u32 = 16;

/// φ + ν Σ|c| in units.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Merit {
    nu: f64,
    lowered: bool,
    /// How often it rose again.
    rises: u32,
}

impl Merit {
    pub fn at(&self, point: &Point) -> f64 {
        self.nu.mul_add(point.defect, point.objective)
    }

    /// Raises ν as far as the step needs to be a descent; lowers it slowly where it could be less.
    pub fn update(&mut self, promise: &Promise, defect: f64) {
        if defect <= 0.0 {
            return;
        }
        let least = (promise.slope + 0.5 * promise.curvature.max(0.0)) / ((1.0 - RHO) * defect);
        if self.nu < least {
            self.nu = 1.5 * least;
            self.rises += u32::from(self.lowered);
            self.lowered = false;
        } else if self.rises < RISES {
            let nu = (0.3 * self.nu).max(1.5 * least).max(0.0);
            self.lowered |= nu < self.nu;
            self.nu = nu;
        }
    }

    /// What a step must come to that begins at a point with this slope of φ; rounding may leave `floor` of it.
    pub fn goal(self, from: &Point, slope: f64, floor: f64) -> Goal {
        let value = self.at(from);
        let noise = 10.0 * f64::EPSILON * (value.abs() + from.objective.abs()) + floor;
        Goal { merit: self, value, slope: slope - self.nu * from.defect, noise }
    }
}

/// The merit function where a step begins, and what it must fall by.
#[derive(Clone, Copy)]
pub(super) struct Goal {
    merit: Merit,
    value: f64,
    slope: f64,
    noise: f64,
}

impl Goal {
    /// Whether a point at α of the step falls enough.
    pub fn is_met(&self, point: &Point, alpha: f64) -> bool {
        self.merit.at(point) <= self.value + ARMIJO * alpha * self.slope.min(0.0) + self.noise
    }
}
