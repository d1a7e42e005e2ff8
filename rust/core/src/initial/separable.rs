//! The regression of a model that is not linear in its parameters, by variable projection: for each value of the
//! nonlinear ones that is tried, the linear ones are found by least squares (Golub and Pereyra, SIAM J. Numer. Anal.
//! 10(2), 1973). The states are held, so that many values can be tried before one trajectory is computed.

use super::regression::{ENOUGH, LOST, Regression};
use crate::index::VariableId;
use crate::solver::Point;

/// Passes in which the weights settle with the nonlinear parameters held, and most after.
const SETTLING: usize = 3;
const PASSES: usize = 40;
/// Damping of the nonlinear parameters in the first pass, as a part of the diagonal; most trials of a pass.
const DAMPING: f64 = 1e-3;
const TRIALS: usize = 8;
/// How often parameters without influence are put back.
const RETURNS: usize = 3;
/// Other places that are looked at, and of these how many are gone on from: before the first step, and after a run that
/// led nowhere.
const FEW: (u64, usize) = (12, 2);
const MANY: (u64, usize) = (40, 5);
/// Of these, how many a run starts from.
const STARTS: usize = 2;
/// Ends whose log-likelihoods differ by less are the same.
const SAME: f64 = 1.0;
/// Another place is better where it gains this much log-likelihood an equation.
const BETTER: f64 = 0.02;

impl Regression<'_> {
    /// Whether there is a free parameter that the model is not linear in.
    pub fn is_separable(&self) -> bool {
        self.nonlinear.contains(&true)
    }

    /// From the start, and from the best of a few other places, where the equations fit much better there: then
    /// returns where that from the start came to.
    pub fn regress_separably(&mut self) -> Option<Point> {
        let start = self.here.clone();
        let own = self.descend().and_then(|()| self.criterion());
        let mut own = own.map(|criterion| (criterion, self.here.clone()));
        if own.is_none() {
            self.here.copy(&start);
        }
        let by_parameters = self.regress_by_parameters(&start);
        let by_products = self.regress_with_products(&start);
        let mut others = self.other_places(&start.xi, FEW);
        others.extend(by_products);
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        let nearer = by_parameters.filter(|by| own.as_ref().is_none_or(|own| by.0 < own.0));
        let left = if nearer.is_some() { std::mem::replace(&mut own, nearer) } else { None };
        let most = own.as_ref().map_or(f64::INFINITY, |o| o.0 - BETTER * start.c.len() as f64);
        let mut from = own.map_or(start, |o| o.1);
        let better = others.into_iter().next().filter(|o| o.0 < most);
        let alternative = better.map(|(_, best)| std::mem::replace(&mut from, best));
        self.here = from;
        alternative.or(left.map(|o| o.1))
    }

    /// Regresses with steps of the parameters whose logarithms are variables, where the model is linear in some of them: the
    /// place with its criterion. `None` where there are none, or it leads nowhere.
    ///
    /// Reaches the optimum from starts however far away, but noise in the states may make a parameter negative, which no
    /// logarithm is.
    fn regress_by_parameters(&mut self, start: &Point) -> Option<(f64, Point)> {
        if self.nonlinear_by_parameters == self.nonlinear {
            return None;
        }
        self.here.copy(start);
        std::mem::swap(&mut self.nonlinear, &mut self.nonlinear_by_parameters);
        self.by_parameters = true;
        let place = if self.is_separable() {
            self.descend().and_then(|()| self.criterion())
        } else {
            self.regress();
            self.criterion()
        };
        self.by_parameters = false;
        std::mem::swap(&mut self.nonlinear, &mut self.nonlinear_by_parameters);
        place.map(|criterion| (criterion, self.here.clone()))
    }

    /// Places to start from after those of `regress_separably`.
    pub fn further_places(&mut self, start: &[f64]) -> Vec<Point> {
        self.other_places(start, MANY).into_iter().take(STARTS).map(|o| o.1).collect()
    }

    /// Other places to start from with their criteria, the best first: of so many, those where the equations fit
    /// best with the linear parameters found, by the noise and weights of here, gone on from.
    fn other_places(&mut self, start: &[f64], (number, tried): (u64, usize)) -> Vec<(f64, Point)> {
        let nonlinear = self.free.iter().zip(&self.nonlinear).filter(|f| *f.1);
        let nonlinear: Vec<VariableId> = nonlinear.map(|f| VariableId(*f.0)).collect();
        let weights = self.weights_of_defects();
        let mut start = start.to_vec();
        let noise = self.nlp.profiled();
        start[noise.clone()].copy_from_slice(&self.here.xi[noise]);
        let mut places = Vec::new();
        for draw in 0..number {
            if self.begin_at(&start, &nonlinear, draw) && self.project(&weights).is_some() {
                places.push((self.loss(&weights), draw));
            }
        }
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut ends = Vec::new();
        for &(_, draw) in places.iter().take(tried) {
            if self.begin_at(&start, &nonlinear, draw)
                && self.descend().is_some()
                && let Some(criterion) = self.criterion()
            {
                ends.push((criterion, self.here.clone()));
            }
        }
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Some have come to the same place.
        ends.dedup_by(|b, a| b.0 - a.0 < SAME);
        ends
    }

    fn begin_at(&mut self, start: &[f64], variables: &[VariableId], draw: u64) -> bool {
        self.here.xi.copy_from_slice(start);
        self.nlp.move_elsewhere(&mut self.here.xi, variables, draw);
        self.here.evaluate(self.program).is_ok()
    }

    /// The linear parameters and the noise, with the nonlinear ones held.
    fn settle(&mut self) -> Option<()> {
        for _ in 0..SETTLING {
            self.noise_of_outputs();
            let weights = self.weights_of_defects();
            self.project(&weights)?;
        }
        Some(())
    }

    /// The best linear parameters for weights.
    fn project(&mut self, weights: &[f64]) -> Option<()> {
        let equations = self.equations(weights)?;
        let step = equations.step_but(&self.nonlinear)?;
        self.move_by(step.as_slice());
        self.here.evaluate(self.program).ok()
    }

    pub(super) fn move_by(&mut self, step: &[f64]) {
        for (k, d) in step.iter().enumerate() {
            self.here.xi[self.free[k]] = self.moved(k, *d);
        }
    }

    /// Levenberg-Marquardt steps of the nonlinear parameters, the linear ones projected out. Parameters that lose
    /// their influence, such as one in a denominator that has gone to infinity, are put back where they started.
    pub(super) fn descend(&mut self) -> Option<()> {
        let from: Vec<f64> = self.free.iter().map(|&i| self.here.xi[i]).collect();
        let influence = self.influence();
        self.settle()?;
        for attempt in 0..=RETURNS {
            self.steps();
            let after = self.influence();
            let lost = |k: usize| after[k] < LOST * influence[k] || !after[k].is_finite();
            let lost: Vec<usize> = (0..self.free.len()).filter(|&k| self.nonlinear[k] && lost(k)).collect();
            if lost.is_empty() {
                self.noise_of_outputs();
                return self.here.evaluate(self.program).ok();
            }
            if attempt < RETURNS {
                lost.iter().for_each(|&k| self.here.xi[self.free[k]] = from[k]);
                self.here.evaluate(self.program).ok()?;
                self.settle()?;
            }
        }
        None
    }

    fn steps(&mut self) -> Option<()> {
        let mut damping = DAMPING;
        for _ in 0..PASSES {
            self.noise_of_outputs();
            let weights = self.weights_of_defects();
            let equations = self.equations(&weights)?;
            let before = self.loss(&weights);
            let mut gain = 0.0;
            for _ in 0..TRIALS {
                self.trial.copy(&self.here);
                if let Some(step) = equations.step(|k| if self.nonlinear[k] { damping } else { 0.0 }) {
                    self.move_by(step.as_slice());
                    let fine = self.here.evaluate(self.program).is_ok();
                    let fine = fine && self.project(&weights).is_some();
                    gain = if fine { before - self.loss(&weights) } else { 0.0 };
                }
                if gain > 0.0 {
                    damping *= 0.2;
                    break;
                }
                self.here.copy(&self.trial);
                damping = (4.0 * damping).max(1e-6);
            }
            if gain <= ENOUGH * before.abs().max(1.0) {
                break;
            }
        }
        Some(())
    }

    /// φ, and the negative log-likelihood of the defects with variances of their own.
    pub(super) fn criterion(&mut self) -> Option<f64> {
        self.noise_of_outputs();
        self.here.evaluate(self.program).ok()?;
        let weights = self.weights_of_defects();
        let count = (self.program.units.rows / self.n_x) as f64;
        let defects: f64 = weights.iter().map(|w| -0.5 * count * w.ln()).sum();
        Some(self.here.objective + defects).filter(|c| c.is_finite())
    }
}
