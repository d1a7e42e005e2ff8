//! The iterate: a point, its multipliers, and the derivatives there.

use super::point::Point;
use super::program::Program;
use super::step::Step;
use crate::interrupt::Interrupt;
use crate::linalg::Entries;
use crate::nlp::{NotFinite, Reach};

/// Most by which a standard deviation changes in a step.
const TENFOLD: f64 = 10.0;
/// Standard deviations have settled when the residuals ask for changes below this part of them.
const SETTLED: f64 = 0.1;

/// Where the loop stands. The phases of an iteration read it; it changes by its methods alone.
pub(super) struct Iterate {
    pub point: Point,
    pub multipliers: Vec<f64>,
    pub gradient: Vec<f64>,
    pub jacobian: Vec<f64>,
    pub hessian: Vec<f64>,
    /// How often it has moved.
    moves: u64,
    /// Scratch: standard deviations.
    profile: Vec<f64>,
}

impl Iterate {
    pub fn new(program: &Program<'_>, point: Point, multipliers: Option<&[f64]>) -> Iterate {
        let nlp = program.nlp;
        Iterate {
            multipliers: multipliers.map_or_else(|| vec![0.0; nlp.m()], <[f64]>::to_vec),
            gradient: vec![0.0; nlp.n()],
            jacobian: vec![0.0; nlp.jacobian_structure().len()],
            hessian: vec![0.0; nlp.hessian_structure().len()],
            moves: 0,
            profile: vec![0.0; nlp.profiled().len()],
            point,
        }
    }

    /// Evaluates the gradient and the Jacobian.
    pub fn evaluate(&mut self, program: &Program<'_>) -> Result<(), NotFinite> {
        let gradient = program.gradient(&self.point.xi, &mut self.gradient);
        program.jacobian(&self.point.xi, &mut self.jacobian).and(gradient)
    }

    /// Evaluates the exact Hessian of the Lagrangian.
    pub fn exact_hessian(&mut self, program: &Program<'_>) -> Result<(), NotFinite> {
        program.hessian(&self.point.xi, &self.multipliers, &mut self.hessian)
    }

    /// Evaluates the Gauss-Newton Hessian in its place.
    pub fn gauss_newton(&mut self, program: &Program<'_>) -> Result<(), NotFinite> {
        program.gauss_newton(&self.point.xi, &mut self.hessian)
    }

    /// How often it has moved: what was computed at the same number is still right.
    pub fn moves(&self) -> u64 {
        self.moves
    }

    pub fn entries(&self) -> Entries<'_> {
        Entries { hessian: &self.hessian, jacobian: &self.jacobian }
    }

    /// Goes to a trial point, which is so much of a step away; what it was becomes the trial point.
    pub fn accept(&mut self, trial: &mut Point, alpha: f64, step: &Step) {
        self.moves += 1;
        std::mem::swap(&mut self.point, trial);
        for (l, next) in self.multipliers.iter_mut().zip(&step.multipliers) {
            *l += alpha * (next - *l);
        }
    }

    /// Takes over a point and its multipliers.
    pub fn set(&mut self, point: &Point, multipliers: &[f64]) {
        self.moves += 1;
        self.point.copy(point);
        self.multipliers.copy_from_slice(multipliers);
    }

    /// Sets standard deviations from the residuals after a step; whether they had settled before. They only come
    /// down after a full step: at the end of a part of one, states do not follow their equations, and small
    /// residuals mean nothing.
    pub fn update_noise(&mut self, program: &Program<'_>, alpha: f64) -> bool {
        let roots = program.nlp.profiled();
        if roots.is_empty() {
            return true;
        }
        self.moves += 1;
        let xi = &mut self.point.xi;
        if program.gradient(xi, &mut self.gradient).is_err() || program.interrupt.stops() {
            return false;
        }
        let reach = Reach::Step { up: TENFOLD, down: if alpha == 1.0 { TENFOLD } else { 1.0 } };
        let change = program.nlp.profile(xi, &self.gradient, &reach, &mut self.profile);
        xi[roots].copy_from_slice(&self.profile);
        // It was finite, and can only come down. Stopped between, the point would not go with its objective.
        let _ = Interrupt::shielded(|| self.point.evaluate_objective(program));
        change < SETTLED
    }
}
