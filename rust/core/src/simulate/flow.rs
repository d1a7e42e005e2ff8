//! The integration of a record, interval by interval between the times at which its inputs bend.

use std::collections::HashMap;

use super::path::Path;
use crate::error::Error;
use crate::experiment::Experiment;
use crate::integrate::field::Field;
use crate::integrate::interval::{Adaptive, Lost, Method};
use crate::model::Model;

/// Times closer than this part of the shortest sampling interval are the same.
const SAME: f64 = 1e-9;
/// States below this part of their size count as this large when errors are weighed.
const SMALL: f64 = 1e-3;
/// Number of points of a record, at most, from which the sizes of states are taken.
const LOOKED_AT: usize = 64;
/// A state so many times as large as it ever was at an end of an interval has grown without limit.
const GROWN: f64 = 1e6;

/// Holds the result of an integration.
struct Steps {
    /// States at the knots.
    states: Vec<Vec<f64>>,
    /// The ends of all steps, the first knot before them.
    ends: Vec<f64>,
    /// Slopes at both ends of each interval between knots, from within, where they were asked for.
    slopes: Vec<[Vec<f64>; 2]>,
}

/// A model with numbers put in, over the inputs of a record.
pub(super) struct Flow<'a> {
    model: &'a Model,
    run: &'a Experiment,
    field: Field<'a>,
    /// The delay of each output, s.
    late: Vec<f64>,
    /// The times at which inputs bend or jump or an output is taken.
    knots: Vec<f64>,
    same: f64,
}

impl<'a> Flow<'a> {
    pub(super) fn new(
        model: &'a Model,
        run: &'a Experiment,
        parameters: &'a [f64],
        values: &HashMap<&str, f64>,
    ) -> Result<Self, Error> {
        let late: Vec<f64> = model
            .outputs
            .iter()
            .map(|o| model.delays.output(&o.name).map_or(0.0, |tau| values[tau]))
            .collect();
        let inputs = Field::inputs_of(model, run, |by| values[by]);
        let (first, last) = (run.t[0], run.t[run.t.len() - 1]);
        let same = SAME * run.t.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        let mut knots: Vec<f64> = run.t.clone();
        knots.extend(inputs.iter().flat_map(|i| i.signal.times().iter().map(|t| t + i.delay)));
        for by in late.iter().filter(|by| **by != 0.0) {
            knots.extend(run.t.iter().map(|t| t - by));
        }
        knots.retain(|t| first <= *t && *t <= last);
        knots.sort_by(f64::total_cmp);
        // Of times that are the same, a sample is kept: outputs are taken there.
        let mut kept: Vec<f64> = Vec::with_capacity(knots.len());
        let is_sample = |t: f64| run.t.binary_search_by(|s| s.total_cmp(&t)).is_ok();
        for t in knots {
            match kept.last().copied() {
                Some(before) if t - before <= same => {
                    if is_sample(t) {
                        *kept.last_mut().expect("there is one") = t;
                    }
                }
                _ => kept.push(t),
            }
        }
        Ok(Flow { model, run, field: Field::new(model, inputs, parameters)?, late, knots: kept, same })
    }

    /// States and outputs at the samples.
    pub(super) fn path(
        &mut self,
        first: &[f64],
        tolerance: f64,
        method: Method,
        with_slopes: bool,
    ) -> Result<Path, Error> {
        let Steps { states, ends: steps, slopes } = self.states(first, tolerance, method, with_slopes)?;
        let at = |t: f64| {
            let after = self.knots.partition_point(|k| *k < t);
            let close = |k: usize| self.knots.get(k).is_some_and(|knot| (knot - t).abs() <= 2.0 * self.same);
            if close(after) { after } else { after.saturating_sub(1) }
        };
        let (t, n) = (&self.run.t, self.run.t.len());
        let samples: Vec<usize> = t.iter().map(|t| at(*t)).collect();
        let n_y = self.model.outputs.len();
        let mut outputs = vec![vec![f64::NAN; n]; n_y];
        let (mut now, mut before) = (vec![0.0; n_y], vec![0.0; n_y]);
        // Where others are measured and this one is not, its value says nothing: the logarithm of a concentration before
        // the first dose.
        let measured = |c: usize| self.run.outputs.get(c).is_some_and(|z| z.iter().any(|v| !v.is_nan()));
        let some: Vec<bool> = (0..n_y).map(measured).collect();
        for k in 0..n {
            self.field.outputs(t[k], &states[samples[k]], &mut now);
            for c in 0..n_y {
                let own = t[k] - self.late[c];
                if self.late[c] == 0.0 {
                    outputs[c][k] = now[c];
                } else if t[0] <= own && own <= t[n - 1] {
                    self.field.outputs(own, &states[at(own)], &mut before);
                    outputs[c][k] = before[c];
                } else {
                    continue;
                }
                // With slopes it is the states that are asked for.
                let asked = !with_slopes && (!some[c] || !self.run.outputs[c][k].is_nan());
                if asked && !outputs[c][k].is_finite() {
                    return Err(Error::evaluation(format!(
                        "experiment '{}': the output '{}' of '{}' is {} at t = {}",
                        self.run.name, self.model.outputs[c].name, self.model.name, outputs[c][k], t[k]
                    ))
                    .about(&self.run.name)
                    .about(&self.model.outputs[c].name)
                    .about(&self.model.name));
                }
            }
        }
        let residual = |(z, y): (&Vec<f64>, &Vec<f64>)| z.iter().zip(y).map(|(z, y)| z - y).collect();
        Ok(Path {
            name: self.run.name.clone(),
            t: t.clone(),
            states: (0..first.len()).map(|i| samples.iter().map(|&k| states[k][i]).collect()).collect(),
            residuals: self.run.outputs.iter().zip(&outputs).map(residual).collect(),
            outputs,
            steps,
            slopes,
            state_names: self.model.states.iter().map(|s| s.name.clone()).collect(),
            output_names: self.model.outputs.iter().map(|o| o.name.clone()).collect(),
        })
    }

    fn states(
        &mut self,
        first: &[f64],
        tolerance: f64,
        method: Method,
        with_slopes: bool,
    ) -> Result<Steps, Error> {
        // Over a long record a fast state would be taken for a large one; it is as large as it has been so far.
        let shortest = self.knots.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        let mut seen = self.sizes(first, shortest);
        self.field.bad = None;
        let weigh = |seen: &[f64]| -> Vec<f64> { seen.iter().map(|size| tolerance * SMALL * size).collect() };
        let mut integrator = Adaptive::new(first, tolerance, weigh(&seen), method);
        let mut states = vec![first.to_vec()];
        let mut steps = vec![self.knots[0]];
        let mut slopes = Vec::new();
        for k in 1..self.knots.len() {
            let (begin, end) = (self.knots[k - 1], self.knots[k]);
            self.field.enter(begin, end);
            let slope = |field: &mut Field<'_>, after, x: &[f64]| {
                let mut slope = vec![0.0; x.len()];
                field.slope(after, x, &mut slope);
                slope
            };
            let at_begin = with_slopes.then(|| slope(&mut self.field, 0.0, &integrator.x));
            if let Err(lost) = integrator.interval(&mut self.field, end - begin) {
                let bad = self.field.bad.take();
                let mut largest = self.sizes(first, self.knots[self.knots.len() - 1] - self.knots[0]);
                for x in &states {
                    largest.iter_mut().zip(x).for_each(|(a, x)| *a = a.max(x.abs()));
                }
                self.field.bad = bad;
                return Err(self.failure(begin, &integrator, lost, &largest));
            }
            if let Some(at_begin) = at_begin {
                slopes.push([at_begin, slope(&mut self.field, end - begin, &integrator.x)]);
            }
            states.push(integrator.x.clone());
            let inner = &integrator.taken[..integrator.taken.len() - 1];
            steps.extend(inner.iter().map(|t| begin + t).chain([end]));
            if integrator.x.iter().zip(&seen).any(|(x, seen)| x.abs() > *seen) {
                seen.iter_mut().zip(&integrator.x).for_each(|(seen, x)| *seen = seen.max(x.abs()));
                integrator.absolute = weigh(&seen);
            }
        }
        Ok(Steps { states, ends: steps, slopes })
    }

    /// Returns the size of each state, in its own unit: its initial value, or its change over this time by its
    /// equation with the given inputs and the other states each moved by its own size. 1 for a state that does not
    /// move.
    fn sizes(&mut self, first: &[f64], duration: f64) -> Vec<f64> {
        let n = first.len();
        let stride = self.knots.len().div_ceil(LOOKED_AT);
        let times: Vec<f64> = self.knots.iter().copied().step_by(stride).collect();
        let mut sizes: Vec<f64> = first.iter().map(|x| x.abs()).collect();
        let mut slope = vec![0.0; n];
        // Those that are known may tell of others in turn.
        for _ in 0..n {
            if !sizes.contains(&0.0) {
                break;
            }
            let known = sizes.clone();
            let away: Vec<f64> = first.iter().zip(&known).map(|(x, size)| x + size).collect();
            for (&t, x) in times.iter().flat_map(|t| [(t, first), (t, &away[..])]) {
                self.field.enter(t, t);
                self.field.slope(0.0, x, &mut slope);
                for (i, f) in slope.iter().enumerate().filter(|(i, f)| known[*i] == 0.0 && f.is_finite()) {
                    sizes[i] = sizes[i].max(f.abs() * duration);
                }
            }
        }
        sizes.into_iter().map(|size| if size > 0.0 && size.is_finite() { size } else { 1.0 }).collect()
    }

    /// Returns the error for a solution that ceases to exist, of states that were so large before.
    fn failure(&mut self, begin: f64, at: &Adaptive, lost: Lost, largest: &[f64]) -> Error {
        let x = &at.x;
        let text = format!(
            "experiment '{}': the simulation of '{}' ends at t = {} of {}: ",
            self.run.name,
            self.model.name,
            short(begin + at.t),
            short(self.run.t[self.run.t.len() - 1])
        );
        let grown = x.iter().zip(largest).any(|(x, largest)| x.abs() > GROWN * largest);
        let why = match (lost, self.field.bad.take()) {
            (Lost::Stopped, _) => "it was stopped".to_owned(),
            (Lost::TimeLimit, _) => "the time limit was reached; allow more, or ask for less accuracy".to_owned(),
            (Lost::Step, _) if grown => {
                "the solution grows without limit; the model may be unstable with these parameters".to_owned()
            }
            (Lost::Step, Some((t, point, slope))) => self.not_finite(t, &point, &slope),
            (Lost::Step | Lost::Steps, _) => match self.jump(at, largest) {
                Some(state) => format!(
                    "the equation of {state}' jumps back and forth there, as that of an ideal relay does: the solution \
                     slides along the jump; give it a smooth transition, such as smooth_sign or smooth_step"
                ),
                None if lost == Lost::Step => {
                    "no step is short enough to be exact there; an equation may jump or have a pole, or rtol be too \
                     small"
                        .to_owned()
                }
                None => {
                    "it takes too many steps between two samples; the motion is far too fast for these samples, \
                     or an equation jumps all the time"
                        .to_owned()
                }
            },
        };
        Error::evaluation(format!("{text}{why}"))
    }

    fn not_finite(&self, t: f64, point: &[f64], slope: &[f64]) -> String {
        let (inputs, states) = point[1..].split_at(point.len() - 1 - slope.len());
        let names = self.model.states.iter().map(|s| s.name.as_str());
        let all = names.zip(states).chain(self.field.input_names().zip(inputs));
        let place: Vec<String> = all.map(|(name, v)| format!("{name} = {}", short(*v))).collect();
        let place = if place.len() > 12 { place[..12].join(", ") + ", ..." } else { place.join(", ") };
        let wrong = slope.iter().position(|v| !v.is_finite()).unwrap_or(0);
        let name = &self.model.states[wrong].name;
        format!("the equation of {name}' is not finite at t = {}, {place}", short(t))
    }

    /// A state whose slope changes its sign across a change of the states, however small that is.
    fn jump(&mut self, at: &Adaptive, sizes: &[f64]) -> Option<&str> {
        let n = at.x.len();
        for (i, size) in sizes.iter().enumerate() {
            let [far, near] =
                [1e-2, 1e-4].map(|part| self.sides(at, i, part * at.x[i].abs().max(SMALL * size)));
            let ((far_below, far_above), (below, above)) = (far?, near?);
            let jumps = |j: &usize| {
                let change = (above[*j] - below[*j]).abs() / (far_above[*j] - far_below[*j]).abs();
                // At a pole it grows.
                below[*j] * above[*j] < 0.0 && (0.5..2.0).contains(&change)
            };
            if let Some(j) = (0..n).find(jumps) {
                return Some(&self.model.states[j].name);
            }
        }
        None
    }

    /// Slopes with a state so much less, and more.
    fn sides(&mut self, at: &Adaptive, i: usize, by: f64) -> Option<(Vec<f64>, Vec<f64>)> {
        let mut side = |by: f64| {
            let (mut x, mut slope) = (at.x.clone(), vec![0.0; at.x.len()]);
            x[i] += by;
            self.field.slope(at.t, &x, &mut slope).then_some(slope)
        };
        Some((side(-by)?, side(by)?))
    }
}

/// A number to six digits.
fn short(v: f64) -> String {
    let rounded: f64 = format!("{v:.5e}").parse().unwrap_or(v);
    if rounded != 0.0 && !(1e-4..1e6).contains(&rounded.abs()) {
        format!("{rounded:e}")
    } else {
        format!("{rounded}")
    }
}
