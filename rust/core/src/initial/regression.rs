//! A regression of the parameters: where the states are measured, those that make defects and output residuals small
//! at the states as they are (the equation-error method, with both the equations and the outputs). Noise in the states
//! biases it, but it takes no iteration over trajectories and lands near enough for Newton's method to take over. A model
//! that is not linear in its parameters has one of its own: [`super::separable`].

use nalgebra::{DMatrix, DVector};

use super::normal::Normal;
use crate::dense::{backward, cholesky, forward};
use crate::index::VariableId;
use crate::nlp::{Reach, Separable};
use crate::solver::{Point, Program};

/// Most passes: a model linear in its parameters needs three or so for the weights to settle.
const PASSES: usize = 12;
/// A pass that gains less than this part ends it.
pub(super) const ENOUGH: f64 = 1e-3;
/// Weights of defects and outputs stay within this factor of what they start from: residuals that are
/// zero because a measurement is the state say nothing.
const RANGE: f64 = 1e6;
/// A parameter whose influence on the equations falls to this part of what it was (squared) is lost.
pub(super) const LOST: f64 = 1e-6;
/// Part of the diagonal that is added to it, so that parameters without influence stay where they are.
const RIDGE: f64 = 1e-10;

/// A regression of the border variables on defects and outputs, the states held; the standard deviations follow the
/// residuals.
pub(super) struct Regression<'a> {
    pub program: &'a Program<'a>,
    pub nlp: &'a dyn Separable,
    /// Where it has come to.
    pub here: Point,
    pub trial: Point,
    /// The variables.
    pub free: Vec<usize>,
    /// Of these, which the model is not linear in, the others given.
    pub nonlinear: Vec<bool>,
    /// The same where logarithms take steps of their parameters, and whether they do now.
    pub(super) nonlinear_by_parameters: Vec<bool>,
    pub(super) by_parameters: bool,
    /// Number of states.
    pub n_x: usize,
    /// The profiled variables at the start.
    first: Vec<f64>,
    /// For each border variable its place among the free ones.
    pub(super) place: Vec<usize>,
    normal: Normal,
    gradient: Vec<f64>,
    pub(super) jacobian: Vec<f64>,
    hessian: Vec<f64>,
    profile: Vec<f64>,
}

/// The equations of a Gauss-Newton step, scaled so that their diagonal is 1.
pub(super) struct Equations {
    a: DMatrix<f64>,
    b: DVector<f64>,
    scale: DVector<f64>,
}

impl Equations {
    /// Makes the equations from a symmetric matrix, of which the lower triangle is used, and a right-hand side.
    pub fn new(mut a: DMatrix<f64>, b: DVector<f64>) -> Equations {
        let k = b.len();
        let scale = DVector::from_fn(k, |i, _| if a[(i, i)] > 0.0 { a[(i, i)].sqrt().recip() } else { 1.0 });
        for i in 0..k {
            for j in 0..=i {
                a[(i, j)] *= scale[i] * scale[j];
            }
        }
        Equations { a, b, scale }
    }

    /// The step with these parts added to the diagonal.
    pub fn step(&self, damping: impl Fn(usize) -> f64) -> Option<DVector<f64>> {
        let n = self.b.len();
        // Row-major, the lower triangle.
        let mut l = vec![0.0; n * n];
        for i in 0..n {
            (0..=i).for_each(|j| l[i * n + j] = self.a[(i, j)]);
            l[i * n + i] += RIDGE + damping(i);
        }
        cholesky(&mut l, n, |_| 0.0).ok()?;
        let mut step = self.b.component_mul(&self.scale);
        forward(&l, n, step.as_mut_slice());
        backward(&l, n, step.as_mut_slice());
        let step = step.component_mul(&self.scale);
        step.iter().all(|x| x.is_finite()).then_some(step)
    }

    /// The step of some, the others held.
    pub fn step_but(&self, held: &[bool]) -> Option<DVector<f64>> {
        let keep = |i: usize, j: usize| if i == j { 1.0 } else { 0.0 };
        let n = self.a.nrows();
        let a = DMatrix::from_fn(n, n, |i, j| if held[i] || held[j] { keep(i, j) } else { self.a[(i, j)] });
        let b = DVector::from_fn(n, |i, _| if held[i] { 0.0 } else { self.b[i] });
        Equations { a, b, scale: self.scale.clone() }.step(|_| 0.0)
    }
}

impl<'a> Regression<'a> {
    /// From a point of a program. `None` where there are no chains, or nothing is free.
    pub fn new(nlp: &'a dyn Separable, program: &'a Program<'a>, point: Point) -> Option<Regression<'a>> {
        let chains = nlp.chains()?;
        let (profiled, of_noise) = (nlp.profiled(), nlp.of_noise());
        // Residuals are zero where a measurement is the state, and then say nothing of the noise.
        let is_held = |i: usize| profiled.contains(&i) || of_noise.contains(&VariableId(i));
        let free: Vec<usize> =
            (0..chains.border).filter(|&i| !is_held(i) && program.lower[i] < program.upper[i]).collect();
        if free.is_empty() {
            return None;
        }
        let mut place = vec![usize::MAX; chains.border];
        free.iter().enumerate().for_each(|(k, &i)| place[i] = k);
        let among = |found: Vec<VariableId>| free.iter().map(|&i| found.contains(&VariableId(i))).collect();
        Some(Regression {
            program,
            nlp,
            trial: point.clone(),
            nonlinear: among(nlp.nonlinear()),
            nonlinear_by_parameters: among(nlp.nonlinear_by_parameters()),
            by_parameters: false,
            first: point.xi[profiled.clone()].to_vec(),
            normal: Normal::new(nlp.jacobian_structure(), &place, free.len(), program.units.rows),
            n_x: chains.n_x,
            gradient: vec![0.0; nlp.n()],
            jacobian: vec![0.0; nlp.jacobian_structure().len()],
            hessian: vec![0.0; nlp.hessian_structure().len()],
            profile: vec![0.0; profiled.len()],
            here: point,
            free,
            place,
        })
    }

    /// Goes on until little is gained. Does nothing where it cannot improve.
    pub fn regress(&mut self) {
        let start = self.here.clone();
        let influence = self.influence();
        let mut done = false;
        for _ in 0..PASSES {
            self.noise_of_outputs();
            let weights = self.weights_of_defects();
            let Some(step) = self.equations(&weights).and_then(|e| e.step(|_| 0.0)) else { break };
            let before = self.loss(&weights);
            let mut alpha = 1.0_f64;
            let mut gained = None;
            while alpha > 0.05 {
                self.trial.xi.copy_from_slice(&self.here.xi);
                for (k, d) in step.iter().enumerate() {
                    self.trial.xi[self.free[k]] = self.moved(k, alpha * d);
                }
                if self.trial.evaluate(self.program).is_ok() {
                    std::mem::swap(&mut self.here, &mut self.trial);
                    let after = self.loss(&weights);
                    if after < before {
                        gained = Some((before - after) / before.abs().max(1.0));
                        break;
                    }
                    std::mem::swap(&mut self.here, &mut self.trial);
                }
                alpha *= 0.4;
            }
            match gained {
                Some(part) => done |= part > 0.0,
                None => break,
            }
            if gained.is_some_and(|part| part < ENOUGH) {
                break;
            }
        }
        if done {
            self.noise_of_outputs();
        }
        // Where a parameter has lost its influence on the equations, noise has led it astray.
        let after = self.influence();
        let astray = influence.iter().zip(&after).any(|(before, after)| *after < LOST * before);
        if !done || astray || self.here.evaluate(self.program).is_err() {
            self.here.copy(&start);
        }
    }

    /// Returns the free variable of this number after a step.
    pub(super) fn moved(&self, k: usize, step: f64) -> f64 {
        let (i, x) = (self.free[k], self.here.xi[self.free[k]]);
        let of_parameter = self.by_parameters && !self.nonlinear[k];
        let to = if of_parameter { self.nlp.moved(VariableId(i), x, step) } else { x + step };
        self.program.within(i, to)
    }

    /// Squared norm of the column of each free parameter in the scaled Jacobian of the constraints.
    pub(super) fn influence(&mut self) -> Vec<f64> {
        let mut squares = vec![0.0; self.free.len()];
        if self.program.jacobian(&self.here.xi, &mut self.jacobian).is_err() {
            return squares;
        }
        let s = self.program.nlp.jacobian_structure();
        for ((&row, &c), v) in s.rows.iter().zip(&s.columns).zip(&self.jacobian) {
            if let Some(&column) = self.place.get(c as usize).filter(|p| **p != usize::MAX) {
                squares[column] += (v / self.program.units.of(row as usize)).powi(2);
            }
        }
        squares
    }

    /// Standard deviations as the residuals say; those whose residuals are nothing keep their start.
    pub(super) fn noise_of_outputs(&mut self) {
        let roots = self.program.nlp.profiled();
        if self.program.gradient(&self.here.xi, &mut self.gradient).is_err() {
            return;
        }
        let reach = Reach::Free { start: &self.first, most: RANGE };
        self.program.nlp.profile(&self.here.xi, &self.gradient, &reach, &mut self.profile);
        self.here.xi[roots].copy_from_slice(&self.profile);
    }

    /// 1/σ² of the defects of each state.
    pub(super) fn weights_of_defects(&self) -> Vec<f64> {
        // Boundary conditions are none.
        let (n_x, units) = (self.n_x, &self.program.units);
        let defects = &self.here.c[..units.rows];
        let count = (defects.len() / n_x) as f64;
        let weight = |i: usize| {
            let squares: f64 = defects.iter().skip(i).step_by(n_x).map(|c| c * c).sum();
            1.0 / (squares / count).max((units.states[i] / RANGE).powi(2))
        };
        (0..n_x).map(weight).collect()
    }

    /// φ + ½ Σ c²/σ²
    pub(super) fn loss(&mut self, weights: &[f64]) -> f64 {
        if self.here.evaluate_objective(self.program).is_err() {
            return f64::INFINITY;
        }
        let defects = self.here.c[..self.program.units.rows].iter();
        let defects: f64 = defects.zip(weights.iter().cycle()).map(|(c, w)| w * c * c).sum();
        self.here.objective + 0.5 * defects
    }

    /// Those of the Gauss-Newton step of the free border variables, the states held.
    pub(super) fn equations(&mut self, weights: &[f64]) -> Option<Equations> {
        let (program, nlp) = (self.program, self.program.nlp);
        let k = self.free.len();
        program.jacobian(&self.here.xi, &mut self.jacobian).ok()?;
        program.gauss_newton(&self.here.xi, &mut self.hessian).ok()?;
        program.gradient(&self.here.xi, &mut self.gradient).ok()?;
        self.normal.sum(nlp.jacobian_structure(), &self.jacobian, &self.place, &self.here.c, weights)?;
        let mut a = DMatrix::from_fn(k, k, |i, j| if j <= i { self.normal.square(i, j) } else { 0.0 });
        let mut b = DVector::from_fn(k, |i, _| -self.normal.right(i));
        let s = nlp.hessian_structure();
        for ((&row, &c), v) in s.rows.iter().zip(&s.columns).zip(&self.hessian) {
            let (Some(&i), Some(&j)) = (self.place.get(row as usize), self.place.get(c as usize)) else {
                continue;
            };
            if i != usize::MAX && j != usize::MAX {
                a[(i.max(j), i.min(j))] += v;
            }
        }
        self.free.iter().enumerate().for_each(|(i, &x)| b[i] -= self.gradient[x]);
        Some(Equations::new(a, b))
    }
}
