//! Output injection: estimates of a model whose states are driven towards the measurements, with a gain that falls to zero.
//!
//! A model that oscillates with another period than the data explains them no better than one at rest: the likelihood of the
//! output error has an optimum for each number of periods by which the two differ, and the optimum at rest attracts most
//! starts. With a term proportional to the output error in the state equations, ẋ = f(x, u, θ) + K (z - g(x, u, θ)), outputs
//! are predicted over the short time 1/K only, and the prediction error has few optima (Ljung, *System Identification*, section
//! 7.3, where K is that of an observer). From an optimum for a large gain the way leads through falling gains to that of the
//! model as it is (Abarbanel, Creveling, Farsian and Kostuk 2009; Vyasarayani, Uchida, Carvalho and McPhee 2011).
//!
//! Where a measured position is the integral of a speed that no output shows, the error of the position alone would leave that of
//! the speed as it is. Both are injected then, as in an observer of second order.

use std::time::Duration;

use super::Estimation;
use super::accuracy::SEARCH;
use super::fit::Fit;
use super::motion::Values;
use super::run::Watch;
use super::search::Search;
use crate::error::Error;
use crate::experiment::{Experiment, Signal};
use crate::expr::Expr;
use crate::interpolate::Interpolation;
use crate::interrupt::current;
use crate::model::{Model, Variable};
use crate::solver::Settings;

/// An output is densely sampled where it has so many samples in each record that measures it.
const DENSE: usize = 20;
/// Where the coefficient of determination of such an output is below this, much of it is unexplained.
const EXPLAINED: f64 = 0.8;
/// The first gain, in units of one over the sampling interval; smaller ones than the last are none.
const FIRST: f64 = 1.0;
/// First gains in turn, where a speed is injected: over one interval noise of a position hides what a speed does.
const OF_SPEEDS: [f64; 2] = [0.3, 0.1];
/// Damping ratio with which the errors of a position and its speed decay.
const DAMPING: f64 = 0.7;
const LAST: f64 = 0.02;
/// Factors from a gain to the next: the first one, the least, and the one beyond which steps are too short.
const FACTOR: f64 = 0.7;
const LEAST: f64 = 0.5;
const SHORT: f64 = 0.95;
/// A step to a smaller gain that loses more than this in log-likelihood for each measured value leads astray.
const LOSS: f64 = 0.15;
/// On the way to smaller gains, the log-likelihood for each measured value may fall so far below the highest one in all: residuals then
/// are half as large again. That of a model with process noise falls all the way, and that of a right one falls where the
/// motion is chaotic, but less.
const FALL: f64 = 0.4;
/// Searches at the first gain from other parameters; rounds of each, after which the way to smaller gains is tried; and restarts in a
/// row without an increase that end a round, or a search at another gain that is left with difficulty.
const SEARCHES: usize = 2;
const ROUNDS: usize = 6;
const RESTARTS: usize = 10;
const FEW: usize = 4;
/// A round that raises the log-likelihood by less than this is the last one.
const RAISED: f64 = 0.1;
/// Most iterations on the last mesh of a run: the optimum at one gain need not be known exactly.
const ITERATIONS: usize = 25;
/// Most estimates with output injection on a mesh that is given.
const ESTIMATES: usize = 40;

/// What a model and its records need for output injection.
pub(super) struct Injection {
    /// Numbers of the outputs that are injected, and their sampling intervals.
    outputs: Vec<(usize, f64)>,
    /// Measured values of all outputs.
    values: usize,
    /// The states that an output measures alone, and that are the integral of one unmeasured state times a constant: the output,
    /// that state and the constant.
    speeds: Vec<(usize, String, f64)>,
}

/// A model with injected outputs, and records with these as inputs.
struct Injected {
    model: Model,
    experiments: Vec<Experiment>,
}

impl Estimation<'_> {
    /// Returns what output injection needs; none where no output is densely sampled, or inputs or outputs are delayed.
    pub(super) fn injection(&self) -> Option<Injection> {
        if !self.model.delays.is_empty() {
            return None;
        }
        let measured = |c: usize| self.experiments.iter().map(move |run| sampling(run, c));
        let interval = |c: usize| {
            let found: Vec<(usize, f64)> = measured(c).filter(|s| s.0 > 0).collect();
            let dense = !found.is_empty() && found.iter().all(|s| s.0 >= DENSE);
            dense.then(|| (c, found.iter().map(|s| s.1).fold(0.0, f64::max)))
        };
        let outputs: Vec<(usize, f64)> = (0..self.model.outputs.len()).filter_map(interval).collect();
        let values = (0..self.model.outputs.len()).flat_map(measured).map(|s| s.0).sum();
        let speeds = self.unmeasured_speeds(&outputs);
        (!outputs.is_empty()).then_some(Injection { outputs, values, speeds })
    }

    /// Returns the outputs, of those that are injected, that measure alone a state whose equation has one state that no output
    /// depends on: the number of the output, that state, and its factor there, where that is a constant.
    fn unmeasured_speeds(&self, injected: &[(usize, f64)]) -> Vec<(usize, String, f64)> {
        let (dynamics, outputs) = self.model.expanded();
        let states = &self.model.states;
        let is_shown = |name: &str| outputs.iter().any(|y| y.symbols().iter().any(|s| &**s == name));
        let mut found: Vec<(usize, String, f64)> = Vec::new();
        for &(c, _) in injected {
            let Some((i, slope)) = measured_alone(&slopes_of(&outputs[c], states)) else { continue };
            let mut acting = slopes_of(&dynamics[i], states);
            acting.retain(|(v, _)| !is_shown(&states[*v].name));
            if let Some((v, k)) = measured_alone(&acting)
                && found.iter().all(|(_, name, _)| *name != states[v].name)
            {
                found.push((c, states[v].name.clone(), k * slope));
            }
        }
        found
    }

    /// Follows estimates with falling gains from several starts, and takes the end into the search where it is better.
    pub(super) fn follow_injection(
        &self,
        injection: &Injection,
        search: &mut Search<'_>,
        watch: &mut Watch<'_>,
    ) -> Result<(), Error> {
        let Some(injected) = self.injected(injection, FIRST) else { return Ok(()) };
        let within = self.within(&injected);
        let loss = LOSS * injection.values as f64;
        let mut start = search.values.clone();
        for _ in 0..SEARCHES {
            let mut found = within.search_from(&start, true, watch)?;
            if found.is_none() {
                // Where outputs have a wrong offset, states that are positive are driven below zero; the best end has a better one.
                found = within.search_from(&search.best(), true, watch)?;
            }
            let Some(mut first) = found else { break };
            let mut before = f64::NEG_INFINITY;
            for _ in 0..ROUNDS {
                first.without = 0;
                while first.without < RESTARTS && !first.is_stopped() {
                    within.restart(&mut first, watch)?;
                }
                if first.is_stopped() || first.likelihood < before + RAISED {
                    break;
                }
                before = first.likelihood;
                if before < search.likelihood + loss {
                    continue; // even over so short a time it predicts no better than the model without injection
                }
                let from = (first.best(), before);
                if let Some(end) = self.through_gains(injection, from, search, watch)? {
                    let likelihood = self.likelihood(&end);
                    if likelihood > search.likelihood {
                        search.take(end, likelihood);
                    }
                    if !injection.may_improve(&search.fit) {
                        break;
                    }
                }
            }
            search.count(first.iterations, first.time);
            if search.is_stopped() || !injection.may_improve(&search.fit) {
                break;
            }
            start = search.draws.all(&start);
        }
        Ok(())
    }

    /// Returns the fit of the model as it is from the end of a path of estimates with falling gains, each of which begins with
    /// the parameters and the path of states of the one before. None where the path does not lead to a higher log-likelihood than that
    /// of a poor fit.
    ///
    /// The first estimate begins as the estimation does, or at the poor fit where that leads nowhere. On a densely sampled record a
    /// mesh with a point at each sample suits all gains, and measurements keep the path of the states in place, so that one
    /// estimate at each gain suffices.
    pub(super) fn led_by_injection(&self, poor: &Fit, watch: &mut Watch<'_>) -> Result<Option<Fit>, Error> {
        let Some(injection) = self.injection() else { return Ok(None) };
        let firsts: &[f64] = if injection.speeds.is_empty() { &[FIRST] } else { &OF_SPEEDS };
        let (mut best, mut iterations, mut time): (Option<Fit>, _, _) = (None, 0, Duration::ZERO);
        for &gain in firsts {
            if current().stops() {
                break;
            }
            let Some(end) = self.led_from(gain, &injection, poor, watch)? else { continue };
            iterations += end.iterations;
            time += end.solution.time;
            if best.as_ref().is_none_or(|best| end.rank() > best.rank()) {
                best = Some(end);
            }
            if best.as_ref().is_some_and(|best| !best.is_poor()) {
                break;
            }
        }
        Ok(best.map(|fit| fit.after(iterations, time)))
    }

    /// Returns the same from this first gain on.
    fn led_from(
        &self,
        first_gain: f64,
        injection: &Injection,
        poor: &Fit,
        watch: &mut Watch<'_>,
    ) -> Result<Option<Fit>, Error> {
        let Some(injected) = self.injected(injection, first_gain) else { return Ok(None) };
        let Injected { model, experiments } = &injected;
        let mut begun = Estimation { model, experiments, ..self.clone() };
        if !injection.speeds.is_empty() && self.paths.is_none() {
            // Driven so, the model can be simulated with any parameters, and from there few starts lead astray.
            (begun.paths, begun.regression) = (Some(true), Some(false));
        }
        let loss = LOSS * injection.values as f64;
        let least = if poor.feasible { poor.log_likelihood } else { f64::NEG_INFINITY };
        // Else it predicts no better over so short a time than the model without injection does at all.
        let is_better = |fit: &Fit| fit.feasible && fit.log_likelihood >= least + loss;
        let mut first = begun.solve_on_mesh(watch);
        if !first.as_ref().is_ok_and(&is_better) && !current().stops() {
            first = begun.going_on_from(poor).solve_on_mesh(watch);
        }
        let first = first?;
        if !is_better(&first) {
            return Ok(None);
        }
        let (mut highest, fall) = (first.log_likelihood, FALL * injection.values as f64);
        let (mut fit, mut gain, mut factor) = (first, first_gain, FACTOR);
        for _ in 0..ESTIMATES {
            if fit.status.was_stopped() || current().stops() {
                return Ok(None);
            }
            let next = factor * gain;
            if next <= LAST {
                let mut end = self.going_on_from(&fit).solve_refined(watch)?;
                end.iterations += fit.iterations;
                end.solution.time += fit.solution.time;
                return Ok(Some(end));
            }
            let Some(injected) = self.injected(injection, next) else { return Ok(None) };
            let mut found = self.within(&injected).going_on_from(&fit).solve_on_mesh(watch)?;
            found.iterations += fit.iterations;
            found.solution.time += fit.solution.time;
            let close = found.feasible && found.log_likelihood >= fit.log_likelihood - loss;
            if close || found.feasible && factor > SHORT {
                if found.log_likelihood < least.max(highest - fall) {
                    return Ok(None);
                }
                highest = highest.max(found.log_likelihood);
                (fit, gain) = (found, next);
                factor = (factor * factor.sqrt()).clamp(LEAST, FACTOR);
            } else if factor > SHORT {
                return Ok(None);
            } else {
                (fit.iterations, fit.solution.time) = (found.iterations, found.solution.time);
                factor = factor.sqrt();
            }
        }
        Ok(None)
    }

    /// The estimation of a model with injected outputs.
    fn within<'b>(&'b self, injected: &'b Injected) -> Estimation<'b> {
        let max_iterations = self.solver.max_iterations.min(ITERATIONS);
        let solver = Settings { max_iterations, ..self.solver.clone() };
        let Injected { model, experiments } = injected;
        Estimation { model, experiments, solver, ..self.clone() }
    }

    /// Returns the end of a path of estimates from those at the first gain to none; none where there is no such path.
    fn through_gains(
        &self,
        injection: &Injection,
        (mut at, mut likelihood): (Values, f64),
        search: &mut Search<'_>,
        watch: &mut Watch<'_>,
    ) -> Result<Option<Fit>, Error> {
        let loss = LOSS * injection.values as f64;
        let mut gain = FIRST;
        let mut factor = FACTOR;
        let mut climbed = false;
        while gain > 0.0 {
            if current().stops() {
                return Ok(None);
            }
            let next = if factor * gain > LAST { factor * gain } else { 0.0 };
            let Some(injected) = self.injected(injection, next) else { return Ok(None) };
            let reached = self.climb(&injected, &at, 0, search, watch)?;
            let close = reached.as_ref().is_some_and(|r| r.1 >= likelihood - loss);
            match reached {
                Some((values, reached)) if close || factor > SHORT => {
                    (at, likelihood, gain, climbed) = (values, reached, next, false);
                    factor = (factor * factor.sqrt()).clamp(LEAST, FACTOR);
                }
                None if factor > SHORT => return Ok(None),
                _ => {
                    if !climbed && let Some(injected) = self.injected(injection, gain) {
                        // A better optimum at this gain may lead on.
                        let higher = self.climb(&injected, &at, FEW, search, watch)?;
                        if let Some((values, reached)) = higher.filter(|h| h.1 > likelihood) {
                            (at, likelihood) = (values, reached);
                        }
                    }
                    climbed = true;
                    factor = factor.sqrt();
                }
            }
        }
        let end = self.along_the_motion(&at, f64::NEG_INFINITY, SEARCH, watch)?;
        Ok(end.inspect(|end| search.count(end.iterations, end.solution.time)))
    }

    /// Returns the parameters of the best end of a search with injected outputs, and its log-likelihood.
    fn climb(
        &self,
        injected: &Injected,
        from: &Values,
        restarts: usize,
        outer: &mut Search<'_>,
        watch: &mut Watch<'_>,
    ) -> Result<Option<(Values, f64)>, Error> {
        let within = self.within(injected);
        let Some(mut search) = within.search_from(from, false, watch)? else { return Ok(None) };
        while search.without < restarts && !search.is_stopped() {
            within.restart(&mut search, watch)?;
        }
        outer.count(search.iterations, search.time);
        Ok(Some((search.best(), search.likelihood)))
    }

    /// Returns the model in which the states that an output depends on follow its measurements with a rate of `gain` over the
    /// sampling interval, and the records with these measurements as held inputs. None where a name is taken.
    ///
    /// The output error e of an output g enters each state in proportion to ∂g/∂x: by K e ∂g/∂x / |∂g/∂x|², so that it
    /// decays by itself as K. A state that an output measures by itself follows that output alone. Where it has a speed that is
    /// injected, too, both decay with the natural frequency K.
    fn injected(&self, injection: &Injection, gain: f64) -> Option<Injected> {
        let (mut model, mut experiments) = (self.model.clone(), self.experiments.to_vec());
        if gain == 0.0 {
            return Some(Injected { model, experiments });
        }
        let (_, outputs) = self.model.expanded();
        let states = &self.model.states;
        let of_outputs = injection.outputs.iter().map(|o| slopes_of(&outputs[o.0], states));
        let of_outputs: Vec<Vec<(usize, Expr)>> = of_outputs.collect();
        let followed: Vec<usize> = of_outputs.iter().filter_map(|s| measured_alone(s)).map(|m| m.0).collect();
        for (&(c, interval), mut slopes) in injection.outputs.iter().zip(of_outputs) {
            if measured_alone(&slopes).is_none() {
                slopes.retain(|(state, _)| !followed.contains(state));
            }
            if slopes.is_empty() {
                continue;
            }
            let name = &self.model.outputs[c].name;
            let (measured, present) = (format!("measured_{name}"), format!("present_{name}"));
            let z = model.input(&measured, "").ok()?;
            let present = model.input(&present, "").ok()?;
            let square = slopes.iter().map(|(_, d)| d * d).reduce(|sum, d| sum + d)?;
            let rate = gain / interval;
            let speed = injection.speeds.iter().find(|s| s.0 == c);
            let error = present * (z - &outputs[c]);
            if let Some((_, name, factor)) = speed {
                let equation = model.dynamics.iter_mut().find(|e| e.name == *name)?;
                equation.expr = (&equation.expr + rate * rate / factor * &error).simplified();
            }
            let rate = if speed.is_some() { 2.0 * DAMPING * rate } else { rate };
            let error = rate * error / square;
            for (state, slope) in slopes {
                let equation = model.dynamics.iter_mut().find(|e| e.name == states[state].name)?;
                equation.expr = (&equation.expr + slope * &error).simplified();
            }
            experiments.iter_mut().for_each(|run| add_measured(run, c));
        }
        Some(Injected { model, experiments })
    }
}

impl Injection {
    /// Whether much of a densely sampled output is unexplained.
    pub fn may_improve(&self, fit: &Fit) -> bool {
        self.outputs.iter().any(|(c, _)| !fit.feasible || fit.r_squared(*c).is_some_and(|r| r < EXPLAINED))
    }
}

/// Returns the derivatives of an output or an equation by the states that it depends on, each with the number of the state.
fn slopes_of(e: &Expr, states: &[Variable]) -> Vec<(usize, Expr)> {
    let slopes = states.iter().enumerate().map(|(i, s)| (i, e.derivative(&s.name)));
    slopes.filter(|(_, d)| d.as_constant() != Some(0.0)).collect()
}

/// Returns the state of the only slope there is, and that slope, where it is a constant.
///
/// Others with an influence on such a state tell no more of it, and may lose their slope, as lift does in a stall.
fn measured_alone(slopes: &[(usize, Expr)]) -> Option<(usize, f64)> {
    match slopes {
        [(i, slope)] => slope.as_constant().map(|slope| (*i, slope)),
        _ => None,
    }
}

/// Returns the number of measured values of an output in a record, and the median interval between them.
fn sampling(run: &Experiment, output: usize) -> (usize, f64) {
    let samples = run.t.iter().zip(&run.outputs[output]).filter(|s| s.1.is_finite());
    let times: Vec<f64> = samples.map(|s| *s.0).collect();
    let mut intervals: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    intervals.sort_by(f64::total_cmp);
    (times.len(), intervals.get(intervals.len() / 2).copied().unwrap_or(0.0))
}

/// Adds the samples of an output to the inputs of a record, each held until the next sample, and whether there is one.
fn add_measured(run: &mut Experiment, output: usize) {
    let measured = &run.outputs[output];
    let value = |z: &f64| if z.is_finite() { *z } else { 0.0 };
    let present = measured.iter().map(|z| f64::from(u8::from(z.is_finite()))).collect();
    let channels: [Vec<f64>; 2] = [measured.iter().map(value).collect(), present];
    run.signals.resize(run.inputs.len(), None);
    for values in channels {
        run.signals.push(Some(Signal {
            t: run.t.clone(),
            values: values.clone(),
            delay: 0.0,
            derivative: 0,
            interpolation: Some(Interpolation::Hold),
        }));
        run.inputs.push(values);
    }
}
