//! The most probable path of one record at given parameters: Newton's method on states, noises and multipliers.

use std::cell::RefCell;

use super::chain::{Chain, Factor, Fault};
use super::flow::{Beside, Flow, Linear};
use super::sample::{Costs, Samples};
use crate::dense::{add_transposed_product, dot};
use crate::integrate::flow::Memory;
use crate::integrate::group::Group;
use crate::interrupt::{Interrupt, current};

/// A record with what its path is found by.
#[derive(Clone, Debug)]
pub(super) struct Run {
    pub(super) intervals: Vec<Group>,
    /// Data columns at the samples.
    pub(super) data: Vec<Vec<f64>>,
}

/// States at the samples, noises and multipliers of the intervals.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Path {
    /// N of n.
    pub(super) x: Vec<f64>,
    /// N−1 of m, in standard deviations.
    pub(super) e: Vec<f64>,
    /// N−1 of n.
    pub(super) lambda: Vec<f64>,
}

/// All that one record's functions need: the parameters of model and noise, and the intensities q.
pub(super) struct At<'a> {
    pub(super) flow: &'a Flow,
    pub(super) samples: &'a Samples,
    /// Parameters of the model, then of the noise.
    pub(super) theta: &'a [f64],
    /// Parameters of the model, then the intensities q.
    pub(super) driving: Vec<f64>,
    /// Number of noises of an interval.
    pub(super) m: usize,
    /// Mean and standard deviation of the initial states that have a prior.
    pub(super) initial: &'a [Option<(f64, f64)>],
    pub(super) run: &'a Run,
    /// Memory of the integrations; it is not given back between them.
    pub(super) memory: RefCell<Memory>,
}

/// The path found, and the system there.
pub(super) struct Found {
    pub(super) path: Path,
    /// Minus the log-density of data and path.
    pub(super) cost: f64,
    pub(super) chain: Chain,
    pub(super) factor: Factor,
    pub(super) iterations: usize,
}

/// The reason why no path was found.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Lost {
    /// A function is not finite on the way.
    #[error("a function is not finite in the search")]
    NotFinite,
    /// This first state is not determined by the data.
    #[error("the data do not determine the initial state number {0}")]
    First(usize),
    /// The most probable path is no proper maximum.
    #[error("the most probable path is not a strict maximum of its density")]
    Curvature,
    /// No further progress, or too many iterations.
    #[error("the search for the most probable path made no further progress")]
    Stuck,
    /// The interrupt in force ended the search.
    #[error("the search for the most probable path was stopped")]
    Stopped,
}

/// gᵀ H⁻¹ g at which the path is where it should be: 1e-8 of a standard deviation.
const CLOSE: f64 = 1e-16;
/// Below this it is close too, where rounding permits no better.
const NEAR: f64 = 1e-8;
/// Full steps are trusted from here on.
const TRUSTED: f64 = 1e-4;
const ITERATIONS: usize = 60;

impl Lost {
    /// Returns the reason of a failure: the interrupt stopped it, or it is not finite.
    pub(super) fn without(interrupt: &Interrupt) -> Lost {
        if interrupt.stops() { Lost::Stopped } else { Lost::NotFinite }
    }
}

impl From<Fault> for Lost {
    fn from(fault: Fault) -> Lost {
        match fault {
            Fault::Noise => Lost::Curvature,
            Fault::First(state) => Lost::First(state),
            Fault::Stopped => Lost::Stopped,
        }
    }
}

impl Run {
    pub(super) fn samples(&self) -> usize {
        self.data[0].len()
    }
}

impl At<'_> {
    fn n(&self) -> usize {
        self.initial.len()
    }

    /// Φ with its derivatives along a path.
    pub(super) fn linearise(&self, path: &Path, beside: &Beside<'_>) -> Result<Linear, Lost> {
        let memory = &mut self.memory.borrow_mut();
        let found = self.flow.linearise(&self.driving, &self.run.intervals, &path.x, &path.e, beside, memory);
        found.ok_or_else(|| Lost::without(&current()))
    }

    /// The noise part of the cost, and that of the priors of initial states, without constants.
    fn rest(&self, path: &Path) -> f64 {
        let first = self.initial.iter().zip(&path.x);
        let prior = first.filter_map(|(p, x)| p.map(|(mean, std)| ((x - mean) / std).powi(2)));
        0.5 * (dot(&path.e, &path.e) + prior.sum::<f64>())
    }

    /// Φ(x_k, ε_k) − x_{k+1}.
    fn gaps(&self, ends: &[f64], path: &Path) -> Vec<f64> {
        ends.iter().zip(&path.x[self.n()..]).map(|(end, x)| end - x).collect()
    }

    /// The system of Newton's method, with the exact Hessian or without the curvature of the residuals and of Φ.
    fn chain(&self, linear: &Linear, costs: &Costs, path: &Path, exact: bool) -> Chain {
        let n = self.n();
        let mut chain = Chain {
            samples: self.run.samples(),
            n,
            m: self.m,
            b: linear.b.clone(),
            c: Vec::new(),
            q: Vec::new(),
            prior: self.initial.iter().map(|p| p.map(|p| p.1)).collect(),
        };
        if exact {
            chain.q = costs.curvature.clone();
            chain.c = linear.curvature.clone();
        } else {
            let slopes = self.samples.residual_slopes(self.theta, &self.run.data, &path.x, 0);
            chain.q = vec![0.0; chain.samples * n * n];
            chain.c = vec![0.0; linear.curvature.len()];
            let each = slopes.len() / chain.samples;
            for (q, j) in chain.q.chunks_exact_mut(n * n).zip(slopes.chunks_exact(each)) {
                add_transposed_product(q, j, j, [n, each / n, n]);
            }
        }
        for (i, prior) in chain.prior.iter().enumerate() {
            chain.q[i * n + i] += prior.map_or(0.0, |std| 1.0 / (std * std));
        }
        chain
    }

    /// The most probable path from a starting one.
    pub(super) fn path(&self, mut path: Path) -> Result<Found, Lost> {
        let n = self.n();
        let mut before = f64::INFINITY;
        let interrupt = current();
        for iterations in 0..ITERATIONS {
            if interrupt.stops() {
                return Err(Lost::Stopped);
            }
            let beside = Beside::Curvature(&path.lambda);
            let linear = self.linearise(&path, &beside)?;
            let mut costs = self.samples.costs(self.theta, &self.run.data, &path.x);
            for (i, prior) in self.initial.iter().enumerate() {
                costs.slope[i] += prior.map_or(0.0, |(mean, std)| (path.x[i] - mean) / (std * std));
            }
            let gaps = self.gaps(&linear.end, &path);
            let finite = [&linear.b, &linear.curvature, &costs.slope, &costs.curvature];
            if !costs.cost.is_finite() || !finite.iter().all(|v| v.iter().all(|v| v.is_finite())) {
                return Err(Lost::NotFinite);
            }
            // Far from the path the exact Hessian need not be positive; the approximation always is.
            let exact = self.chain(&linear, &costs, &path, true);
            let (chain, factor, is_exact) = match exact.factor() {
                Ok(factor) => (exact, factor, true),
                Err(Fault::Stopped) => return Err(Lost::Stopped),
                Err(_) => {
                    let chain = self.chain(&linear, &costs, &path, false);
                    let factor = chain.factor()?;
                    (chain, factor, false)
                }
            };
            let step = chain.solve(&factor, &costs.slope, &path.e, &gaps)?;
            let decrement = step.decrement;
            if !decrement.is_finite() {
                return Err(Lost::NotFinite);
            }
            let stalled = decrement < NEAR && decrement > 0.25 * before;
            if iterations > 0 && (decrement < CLOSE || stalled) {
                if !is_exact {
                    return Err(Lost::Curvature);
                }
                path.lambda = step.lambda;
                let cost = costs.cost + self.rest(&path);
                return Ok(Found { path, cost, chain, factor, iterations });
            }
            before = decrement;
            let size = if decrement < TRUSTED && is_exact {
                1.0
            } else {
                let size = self.search(&path, &step, &costs, &gaps, &interrupt);
                size.ok_or_else(|| if interrupt.stops() { Lost::Stopped } else { Lost::Stuck })?
            };
            advance(&mut path.x, &step.x, size);
            advance(&mut path.e, &step.e, size);
            path.lambda.iter_mut().zip(&step.lambda).for_each(|(l, new)| *l += size * (new - *l));
            debug_assert_eq!(path.x.len(), self.run.samples() * n);
        }
        Err(Lost::Stuck)
    }

    /// A step length that lessens cost plus weighted gaps (an exact penalty; Nocedal and Wright, *Numerical
    /// Optimization*, 2006, section 18.3).
    fn search(
        &self,
        path: &Path,
        step: &super::chain::Step,
        costs: &Costs,
        gaps: &[f64],
        interrupt: &Interrupt,
    ) -> Option<f64> {
        let n = self.n();
        let mut weights = vec![0.0f64; n];
        for lambda in [&path.lambda, &step.lambda] {
            for row in lambda.chunks_exact(n) {
                weights.iter_mut().zip(row).for_each(|(w, l)| *w = w.max(2.0 * l.abs()));
            }
        }
        let weigh = |gaps: &[f64]| -> f64 {
            gaps.chunks_exact(n).flat_map(|row| row.iter().zip(&weights).map(|(g, w)| w * g.abs())).sum()
        };
        let now = weigh(gaps);
        let merit = costs.cost + self.rest(path) + now;
        let slope = dot(&costs.slope, &step.x) + dot(&path.e, &step.e) - now;
        let mut size = 1.0;
        for _ in 0..25 {
            if interrupt.stops() {
                break;
            }
            let mut trial = path.clone();
            advance(&mut trial.x, &step.x, size);
            advance(&mut trial.e, &step.e, size);
            let memory = &mut self.memory.borrow_mut();
            let ends = self.flow.ends(&self.driving, &self.run.intervals, &trial.x, &trial.e, memory);
            let there = ends.map_or(f64::NAN, |ends| {
                let cost = self.samples.costs(self.theta, &self.run.data, &trial.x).cost;
                cost + self.rest(&trial) + weigh(&self.gaps(&ends, &trial))
            });
            if there <= merit + 1e-4 * size * slope.min(0.0) + 1e-12 * merit.abs() {
                return Some(size);
            }
            size *= 0.5;
        }
        None
    }
}

fn advance(x: &mut [f64], step: &[f64], size: f64) {
    x.iter_mut().zip(step).for_each(|(x, s)| *x += size * s);
}
