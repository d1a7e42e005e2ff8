//! Restarts from other parameters: where samples are few, the likelihood has many maxima.

use std::f64::consts::PI;

use fastrand::Rng;

use super::Estimation;
use super::fit::Fit;
use super::motion::{FAR, FINAL, SEARCH, Values};
use super::run::Watch;
use crate::error::Error;
use crate::interrupt::current;
use crate::model::Parameter;
use crate::solver::Status;
use crate::transform::Transform;

/// Restarts in a row that bring no more than this in log-likelihood, before two for each parameter are added; fewer where so many
/// in a row end at the same optimum, which then is hardly one of many.
const RESTARTS: usize = 20;
const RETURNS: usize = 8;
const GAIN: f64 = 1e-3;
/// Ends of runs that differ by less than this are the same optimum.
const SAME: f64 = 0.1;
/// The part of the parameters that is drawn anew, and of those of which the data say nothing.
const SHARE: f64 = 0.3;
const MOST_OF_THEM: f64 = 0.8;
/// In decades: how far parameters without bounds go, and how far all move.
const DECADES: f64 = 3.0;
const MOVE: f64 = 0.5;
/// Most draws for parameters at which the model can be simulated, and its outputs are others.
const DRAWS: usize = 30;

impl Estimation<'_> {
    /// Returns the best end of a run from the starting values and of so many restarts from other parameters, on meshes that
    /// follow the motion.
    ///
    /// It is an iterated local search (Lourenço, Martin and Stützle 2003): a restart begins at the best end so far, with some
    /// of the parameters drawn anew. It ends after so many restarts in a row without a gain: by default twenty, and two for
    /// each parameter, or eight that all return to the best end. Where the model cannot be simulated at the starting values,
    /// parameters are sought where it can. None where there are none.
    pub(super) fn search_restarts(&self, watch: &mut Watch<'_>) -> Result<Option<Fit>, Error> {
        let parameters = &self.model.parameters;
        let values: Values = parameters.iter().map(|p| p.name.clone()).zip(self.parameters()?).collect();
        let free: Vec<usize> =
            (0..parameters.len()).filter(|&i| !parameters[i].fixed && !parameters[i].local).collect();
        let restarts = self.restarts.unwrap_or(RESTARTS + 2 * free.len());
        let restarts = if free.is_empty() || self.goes_on() { 0 } else { restarts };
        let mut draws = Draws { parameters, free, random: seeded(&values) };
        let accuracy = if self.goes_on() { FINAL } else { SEARCH };
        let mut found = self.along_the_motion(&values, f64::NEG_INFINITY, accuracy, watch)?;
        for number in 0..if restarts > 0 { DRAWS } else { 0 } {
            if found.is_some() || current().stops() {
                break;
            }
            let others = draws.others(number, &values, &|_| false);
            found = self.along_the_motion(&others, f64::NEG_INFINITY, accuracy, watch)?;
        }
        let Some(mut fit) = found else { return Ok(None) };

        let mut likelihood = self.likelihood(&fit);
        let (mut iterations, mut time, mut without, mut again) = (fit.iterations, fit.solution.time, 0, 0);
        let mut returns = 0;
        let enough = if self.restarts.is_none() { RETURNS } else { usize::MAX };
        while without < restarts && returns < enough && !fit.status.was_stopped() && !current().stops() {
            let of_fit = |v: &(String, f64)| (v.0.clone(), fit.parameter(&v.0).map_or(v.1, |e| e.value));
            let at: Values = values.iter().map(of_fit).collect();
            // Of which the data say nothing at this end, or no more than how large they are.
            let undetermined = |name: &str| {
                fit.parameter(name).is_some_and(|e| e.std_error.is_nan() || e.std_error >= e.value.abs())
            };
            let mut others = at.clone();
            for _ in 0..DRAWS {
                others = draws.others(without, &at, &undetermined);
                // What changes nothing leads back.
                let runs = self.simulated(&others, accuracy.tolerance);
                if current().stops() || runs.is_some_and(|runs| !fit.suits(&runs)) {
                    break;
                }
            }
            without += 1;
            let before = std::mem::take(&mut returns);
            let Some(other) = self.along_the_motion(&others, likelihood, accuracy, watch)? else { continue };
            iterations += other.iterations;
            time += other.solution.time;
            if other.status == Status::Interrupted {
                (fit.status, fit.message) = (other.status, other.message);
                break;
            }
            let reached = self.likelihood(&other);
            if reached > likelihood + GAIN {
                again = usize::from(reached - likelihood < SAME);
                (fit, likelihood, without) = (other, reached, 0);
            } else {
                let same = reached > likelihood - SAME;
                again += usize::from(same);
                returns = if same { before + 1 } else { 0 };
            }
        }
        if !self.goes_on() && !fit.status.was_stopped() && !current().stops() {
            let last = self.along_the_motion(&fit.values(), f64::NEG_INFINITY, FINAL, watch)?;
            if let Some(last) = last.filter(|last| last.status != Status::TimeLimit) {
                iterations += last.iterations;
                time += last.solution.time;
                fit = last;
            }
        }
        if restarts > 0 && again == 0 && fit.feasible {
            fit.warnings.push(format!(
                "none of the last {without} restarts ended at this optimum again: there may be better ones, which \
                 a search from many starts may find (`multistart`)"
            ));
        }
        (fit.iterations, fit.solution.time) = (iterations, time);
        Ok(Some(fit))
    }

    /// Whether it goes on from where a fit ended.
    pub(super) fn goes_on(&self) -> bool {
        self.earlier.as_ref().is_some_and(|e| e.near)
    }

    /// Returns the log-likelihood of an end whose path is that of the integration with its parameters, else -∞.
    ///
    /// A path on a mesh that is too coarse may cross a pole of the solution, or miss a fast motion.
    fn likelihood(&self, fit: &Fit) -> f64 {
        let runs = if fit.feasible { self.simulated(&fit.values(), SEARCH.tolerance) } else { None };
        let known = runs.is_some_and(|runs| fit.departure(&runs) <= FAR);
        if known { fit.log_likelihood } else { f64::NEG_INFINITY }
    }
}

/// Random numbers that are the same for the same start, and others for another.
fn seeded(values: &Values) -> Rng {
    let mut ordered: Vec<&(String, f64)> = values.iter().collect();
    ordered.sort_by(|a, b| a.0.cmp(&b.0));
    let bytes = ordered.iter().flat_map(|(name, v)| name.bytes().chain(v.to_bits().to_le_bytes()));
    // Fowler, Noll and Vo's hash.
    let seed = bytes.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    Rng::with_seed(seed)
}

/// Draws of other parameters.
struct Draws<'a> {
    parameters: &'a [Parameter],
    /// Numbers of those that are drawn.
    free: Vec<usize>,
    random: Rng,
}

impl Draws<'_> {
    /// Draws other parameters, in one of three ways in turn: some of them anew; most of the undetermined ones anew, which
    /// where they are have no influence, and few others; all of them moved.
    fn others(&mut self, number: usize, at: &Values, undetermined: &dyn Fn(&str) -> bool) -> Values {
        if number % 3 == 2 {
            return self.moved(at);
        }
        let any = self.free.iter().any(|&i| undetermined(&self.parameters[i].name));
        let (others, of_those) =
            if number.is_multiple_of(3) || !any { (SHARE, SHARE) } else { (0.5 * SHARE, MOST_OF_THEM) };
        let share = |i: &usize| if undetermined(&self.parameters[*i].name) { of_those } else { others };
        let shares: Vec<f64> = self.free.iter().map(share).collect();
        self.redrawn(at, &shares)
    }

    /// Draws parameters anew within their bounds, each with its probability; one at least.
    fn redrawn(&mut self, at: &Values, shares: &[f64]) -> Values {
        let mut found = at.clone();
        let one = self.random.usize(..self.free.len());
        for (k, share) in shares.iter().enumerate() {
            let (chosen, x) = (self.random.f64() < *share, self.random.f64());
            if chosen || k == one {
                let i = self.free[k];
                let scale = Scale::of(&self.parameters[i], at[i].1);
                found[i].1 = scale.value(scale.range.0 + (scale.range.1 - scale.range.0) * x);
            }
        }
        found
    }

    /// Moves all parameters, most of them a little and some of them far: by a Cauchy distribution.
    fn moved(&mut self, at: &Values) -> Values {
        let mut found = at.clone();
        for &i in &self.free {
            let scale = Scale::of(&self.parameters[i], at[i].1);
            let cauchy = (PI * (self.random.f64() - 0.5)).tan();
            found[i].1 = scale.value(scale.at + scale.unit * cauchy);
        }
        found
    }
}

/// The scale on which a parameter is drawn, logarithmic where that is declared: value, range, and the unit of its moves.
struct Scale {
    logarithmic: bool,
    at: f64,
    range: (f64, f64),
    unit: f64,
}

impl Scale {
    fn of(parameter: &Parameter, value: f64) -> Scale {
        let (low, high) = (parameter.lower, parameter.upper);
        if parameter.transform == Transform::Log && value > 0.0 {
            let at = value.log10();
            let low = low.filter(|low| *low > 0.0).map_or(at - DECADES, f64::log10);
            let high = high.map_or(at + DECADES, f64::log10);
            return Scale { logarithmic: true, at, range: (low, high), unit: MOVE };
        }
        let size = if value == 0.0 { 1.0 } else { value.abs() };
        let unit = if let (Some(low), Some(high)) = (low, high) { 0.1 * (high - low) } else { size };
        let range = (low.unwrap_or(value - 3.0 * size), high.unwrap_or(value + 3.0 * size));
        Scale { logarithmic: false, at: value, range, unit }
    }

    /// Returns the value of the parameter at x, which is reflected into the range.
    fn value(&self, x: f64) -> f64 {
        let (low, high) = self.range;
        let span = high - low;
        let x = if low < high {
            let x = (x - low).rem_euclid(2.0 * span);
            low + x.min(2.0 * span - x)
        } else {
            self.at
        };
        if self.logarithmic { 10f64.powf(x) } else { x }
    }
}
