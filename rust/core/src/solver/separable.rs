//! The regression of a model that is not linear in its parameters, by variable projection: for each value of the
//! nonlinear ones that is tried, the linear ones are found by least squares (Golub and Pereyra, SIAM J. Numer. Anal.
//! 10(2), 1973). The states are held, so that many values can be tried before one trajectory is computed.

use super::Run;
use super::point::Point;
use super::start::{ENOUGH, LOST, Regression};

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

impl Run<'_> {
    /// From the start, and from the best of a few other places, where the equations fit much better there: then that
    /// of the start is kept as the rival.
    pub(super) fn regress_separably(&mut self, r: &mut Regression) {
        let start = self.here.clone();
        let own = self.descend(r).and_then(|()| self.criterion(r));
        let own = own.map(|criterion| (criterion, self.here.clone()));
        if own.is_none() {
            self.here.copy(&start);
        }
        let others = self.other_places(r, &start.xi, FEW);
        let most = own.as_ref().map_or(f64::INFINITY, |o| o.0 - BETTER * start.c.len() as f64);
        let mut from = own.map_or(start, |o| o.1);
        if let Some((_, best)) = others.into_iter().next().filter(|o| o.0 < most) {
            self.rival = Some(std::mem::replace(&mut from, best).xi);
        }
        self.here.copy(&from);
    }

    /// Places to start from after those of `regress`.
    pub(super) fn further_places(&mut self, start: &[f64]) -> Vec<Vec<f64>> {
        let Some(mut r) = self.regression().filter(|r| r.nonlinear.contains(&true)) else {
            return Vec::new();
        };
        self.other_places(&mut r, start, MANY).into_iter().take(STARTS).map(|o| o.1.xi).collect()
    }

    /// Other places to start from with their criteria, the best first: of so many, those where the equations fit
    /// best with the linear parameters found, by the noise and weights of here, gone on from.
    fn other_places(
        &mut self,
        r: &mut Regression,
        start: &[f64],
        (number, tried): (u64, usize),
    ) -> Vec<(f64, Point)> {
        let nonlinear: Vec<usize> = r.free.iter().zip(&r.nonlinear).filter(|f| *f.1).map(|f| *f.0).collect();
        let weights = self.weights_of_defects(r.n_x);
        let mut start = start.to_vec();
        let noise = self.nlp.profiled();
        start[noise.clone()].copy_from_slice(&self.here.xi[noise]);
        let mut places = Vec::new();
        for draw in 0..number {
            if self.begin_at(&start, &nonlinear, draw) && self.project(r, &weights).is_some() {
                places.push((self.loss(&weights), draw));
            }
        }
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut ends = Vec::new();
        for &(_, draw) in places.iter().take(tried) {
            if self.begin_at(&start, &nonlinear, draw)
                && self.descend(r).is_some()
                && let Some(criterion) = self.criterion(r)
            {
                ends.push((criterion, self.here.clone()));
            }
        }
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Some have come to the same place.
        ends.dedup_by(|b, a| b.0 - a.0 < SAME);
        ends
    }

    fn begin_at(&mut self, start: &[f64], variables: &[usize], draw: u64) -> bool {
        self.here.xi.copy_from_slice(start);
        self.nlp.move_elsewhere(&mut self.here.xi, variables, draw);
        self.here.evaluate(self.nlp, &self.units, &mut self.count).is_ok()
    }

    /// Whether a parameter in which the model is not linear stands at a bound.
    pub(super) fn cornered(&self) -> bool {
        let at = |i: usize| self.here.xi[i] <= self.bounds.0[i] || self.here.xi[i] >= self.bounds.1[i];
        self.nlp.nonlinear().into_iter().any(|i| self.bounds.0[i] < self.bounds.1[i] && at(i))
    }

    /// The linear parameters and the noise, with the nonlinear ones held.
    fn settle(&mut self, r: &mut Regression) -> Option<()> {
        for _ in 0..SETTLING {
            self.noise_of_outputs(&r.first);
            let weights = self.weights_of_defects(r.n_x);
            self.project(r, &weights)?;
        }
        Some(())
    }

    /// The best linear parameters for weights.
    fn project(&mut self, r: &mut Regression, weights: &[f64]) -> Option<()> {
        let equations = self.equations(r, weights)?;
        let step = equations.step_but(&r.nonlinear)?;
        self.move_by(r, step.as_slice());
        self.here.evaluate(self.nlp, &self.units, &mut self.count).ok()
    }

    fn move_by(&mut self, r: &Regression, step: &[f64]) {
        for (&i, d) in r.free.iter().zip(step) {
            let x = &mut self.here.xi[i];
            *x = (*x + d).clamp(self.bounds.0[i], self.bounds.1[i]);
        }
    }

    /// Levenberg-Marquardt steps of the nonlinear parameters, the linear ones projected out. Parameters that lose
    /// their influence, such as one in a denominator that has gone to infinity, are put back where they started.
    fn descend(&mut self, r: &mut Regression) -> Option<()> {
        let from: Vec<f64> = r.free.iter().map(|&i| self.here.xi[i]).collect();
        let influence = self.influence(r);
        self.settle(r)?;
        for attempt in 0..=RETURNS {
            self.steps(r);
            let after = self.influence(r);
            let lost = |k: usize| after[k] < LOST * influence[k] || !after[k].is_finite();
            let lost: Vec<usize> = (0..r.free.len()).filter(|&k| r.nonlinear[k] && lost(k)).collect();
            if lost.is_empty() {
                self.noise_of_outputs(&r.first);
                return self.here.evaluate(self.nlp, &self.units, &mut self.count).ok();
            }
            if attempt < RETURNS {
                lost.iter().for_each(|&k| self.here.xi[r.free[k]] = from[k]);
                self.here.evaluate(self.nlp, &self.units, &mut self.count).ok()?;
                self.settle(r)?;
            }
        }
        None
    }

    fn steps(&mut self, r: &mut Regression) -> Option<()> {
        let mut damping = DAMPING;
        for _ in 0..PASSES {
            self.noise_of_outputs(&r.first);
            let weights = self.weights_of_defects(r.n_x);
            let equations = self.equations(r, &weights)?;
            let before = self.loss(&weights);
            let mut gain = 0.0;
            for _ in 0..TRIALS {
                self.trial.copy(&self.here);
                if let Some(step) = equations.step(|k| if r.nonlinear[k] { damping } else { 0.0 }) {
                    self.move_by(r, step.as_slice());
                    let fine = self.here.evaluate(self.nlp, &self.units, &mut self.count).is_ok();
                    let fine = fine && self.project(r, &weights).is_some();
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
    fn criterion(&mut self, r: &Regression) -> Option<f64> {
        self.noise_of_outputs(&r.first);
        self.here.evaluate(self.nlp, &self.units, &mut self.count).ok()?;
        let weights = self.weights_of_defects(r.n_x);
        let count = (self.units.rows / r.n_x) as f64;
        let defects: f64 = weights.iter().map(|w| -0.5 * count * w.ln()).sum();
        Some(self.here.objective + defects).filter(|c| c.is_finite())
    }
}
