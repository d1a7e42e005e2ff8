//! The ℓ₁ merit function.

use super::point::Point;
use super::step::Promise;

/// Part of the promised decrease that must come true (Armijo).
const ARMIJO: f64 = 1e-4;
/// Part of the decrease of defects that the model must promise.
const RHO: f64 = 0.1;

/// φ + ν Σ|c| in units.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Merit {
    nu: f64,
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
        self.nu = if self.nu < least { 1.5 * least } else { (0.3 * self.nu).max(1.5 * least).max(0.0) };
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
