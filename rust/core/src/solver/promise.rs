//! The change of the objective that a step promises.

use super::active_set::ActiveSet;
use super::iterate::Iterate;
use super::program::Program;
use super::step::Step;

/// What a step promises.
#[derive(Clone, Copy, Debug)]
pub(super) struct Promise {
    /// ∇φᵀd
    pub slope: f64,
    /// dᵀHd
    pub curvature: f64,
    /// Gain in φ if all goes as the model says, and what defects may pretend: distance from the end.
    pub gain: f64,
    /// What rounding leaves of that.
    pub floor: f64,
}

/// An end that meets this instead of the tolerance is acceptable, again a distance in standard errors.
const CLOSE: f64 = 1e-3;

impl Promise {
    /// Whether no more than an acceptable end leaves is promised.
    pub fn is_small(&self) -> bool {
        self.gain <= CLOSE.powi(2) + self.floor
    }

    pub fn of(program: &Program<'_>, iterate: &Iterate, step: &Step, active: &ActiveSet) -> Promise {
        let (c, xi) = (&iterate.point.c, &iterate.point.xi);
        let slope: f64 = iterate.gradient.iter().zip(&step.d).map(|(g, d)| g * d).sum();
        let pull: f64 = step.multipliers.iter().zip(c).map(|(l, c)| l * c).sum();
        let pretended: f64 = step.multipliers.iter().zip(c).map(|(l, c)| (l * c).abs()).sum();
        // H d = −∇φ − Aᵀλ − z, and A d = −c.
        let curvature = -slope + pull - active.pull(&step.d);
        let own = xi[program.border()..].iter();
        let sizes: f64 = step.multipliers.iter().zip(own).map(|(l, x)| (l * x).abs()).sum();
        Promise { slope, curvature, gain: 0.5 * slope.abs() + pretended, floor: 8.0 * f64::EPSILON * sizes }
    }
}
