//! The integration, interval by interval.

use std::collections::HashMap;

use super::path::Path;
use crate::error::Error;
use crate::evaluator::Evaluator;
use crate::experiment::Experiment;
use crate::interpolate::{Interpolant, Interpolation};
use crate::model::Model;

/// Times closer than this part of the shortest sampling interval are the same.
const SAME: f64 = 1e-9;
/// States below this count as this large when errors are weighed.
const SMALL: f64 = 1e-3;
/// Steps of an interval, after which the solution is said to grow without limit.
const STEPS: usize = 100_000;

/// Dormand and Prince's method (J. Comput. Appl. Math. 6, 1980): nodes, coefficients, and the difference of the
/// weights of orders 5 and 4.
const C: [f64; 7] = [0.0, 0.2, 0.3, 0.8, 8.0 / 9.0, 1.0, 1.0];
const A: [&[f64]; 7] = [
    &[],
    &[0.2],
    &[3.0 / 40.0, 9.0 / 40.0],
    &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0],
    &[19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0],
    &[9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0],
    &[35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0],
];
const ERROR: [f64; 7] =
    [71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339200.0, 22.0 / 525.0, -1.0 / 40.0];

/// An input over time: the signal, and by how much it is late.
struct Input<'a> {
    name: &'a str,
    signal: Interpolant<'a>,
    held: bool,
    delay: f64,
}

/// A model with numbers put in, over the inputs of a record.
pub(super) struct Flow<'a> {
    model: &'a Model,
    run: &'a Experiment,
    parameters: &'a [f64],
    evaluator: Evaluator,
    inputs: Vec<Input<'a>>,
    /// By how much each output is late, s.
    late: Vec<f64>,
    /// Where inputs bend or jump or an output is taken.
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
        let names = model.input_names();
        let late: Vec<f64> = model
            .outputs
            .iter()
            .map(|o| model.delays.output(&o.name).map_or(0.0, |tau| values[tau]))
            .collect();
        let (first, last) = (run.t[0], run.t[run.t.len() - 1]);
        let same = SAME * run.t.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        let mut knots: Vec<f64> = run.t.clone();
        let mut inputs = Vec::new();
        for input in &model.inputs {
            let (of, delay) = match model.delays.input(&input.name) {
                Some(l) => (l.of.as_str(), values[l.by.as_str()]),
                None => (input.name.as_str(), 0.0),
            };
            let place = names.iter().position(|n| *n == of).expect("a late input is one of the model's");
            let (t, u, already) = match run.signals.get(place) {
                Some(Some(s)) => (&s.t, &s.values, s.delay),
                _ => (&run.t, &run.inputs[place], 0.0),
            };
            let delay = delay + already;
            knots.extend(t.iter().map(|t| t + delay));
            let kind = run.kind(place);
            let held = kind == Interpolation::Hold;
            inputs.push(Input { name: &input.name, signal: Interpolant::new(kind, t, u), held, delay });
        }
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
        let evaluator = Evaluator::new(model)?;
        Ok(Flow { model, run, parameters, evaluator, inputs, late, knots: kept, same })
    }

    /// Time, inputs and states at a point, of an interval between knots where one is given: an input that is held is
    /// there what it is inside.
    fn point(&self, t: f64, interval: Option<(f64, f64)>, x: &[f64]) -> Vec<f64> {
        let value = |input: &Input<'_>| match interval {
            Some((begin, end)) if input.held => input.signal.over(begin - input.delay, end - input.delay),
            _ => input.signal.at(t - input.delay),
        };
        [t].into_iter().chain(self.inputs.iter().map(value)).chain(x.iter().copied()).collect()
    }

    fn slope(&self, t: f64, interval: (f64, f64), x: &[f64]) -> Vec<f64> {
        let point = self.point(t, Some(interval), x);
        let columns: Vec<&[f64]> = point.iter().map(std::slice::from_ref).collect();
        let slopes = self.evaluator.dynamics(self.parameters, &columns);
        slopes.expect("a point has all columns").into_iter().flatten().collect()
    }

    fn outputs(&self, t: f64, x: &[f64]) -> Vec<f64> {
        let point = self.point(t, None, x);
        let columns: Vec<&[f64]> = point.iter().map(std::slice::from_ref).collect();
        let outputs = self.evaluator.outputs(self.parameters, &columns);
        outputs.expect("a point has all columns").into_iter().flatten().collect()
    }

    /// States and outputs at the samples.
    pub(super) fn path(&self, first: &[f64], tolerance: f64) -> Result<Path, Error> {
        let absolute: Vec<f64> = first.iter().map(|x| tolerance * x.abs().max(SMALL)).collect();
        let mut states = vec![first.to_vec()];
        let mut step = f64::INFINITY;
        for pair in self.knots.windows(2) {
            let x = states.last().expect("there is the first");
            states.push(self.interval((pair[0], pair[1]), x, &mut step, tolerance, &absolute)?);
        }
        let at = |t: f64| {
            let after = self.knots.partition_point(|k| *k < t);
            let close = |k: usize| self.knots.get(k).is_some_and(|knot| (knot - t).abs() <= 2.0 * self.same);
            if close(after) { after } else { after.saturating_sub(1) }
        };
        let (t, n) = (&self.run.t, self.run.t.len());
        let samples: Vec<usize> = t.iter().map(|t| at(*t)).collect();
        let n_y = self.model.outputs.len();
        let mut outputs = vec![vec![f64::NAN; n]; n_y];
        for k in 0..n {
            let now = self.outputs(t[k], &states[samples[k]]);
            for c in 0..n_y {
                let own = t[k] - self.late[c];
                if self.late[c] == 0.0 {
                    outputs[c][k] = now[c];
                } else if t[0] <= own && own <= t[n - 1] {
                    outputs[c][k] = self.outputs(own, &states[at(own)])[c];
                } else {
                    continue;
                }
                if !outputs[c][k].is_finite() {
                    return Err(Error::Evaluation(format!(
                        "experiment '{}': the output '{}' of '{}' is {} at t = {} s",
                        self.run.name, self.model.outputs[c].name, self.model.name, outputs[c][k], t[k]
                    )));
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
            state_names: self.model.states.iter().map(|s| s.name.clone()).collect(),
            output_names: self.model.outputs.iter().map(|o| o.name.clone()).collect(),
        })
    }

    /// x at the end of an interval; `step` is the length of a step to begin with, and the last one after.
    fn interval(
        &self,
        (begin, end): (f64, f64),
        x: &[f64],
        step: &mut f64,
        relative: f64,
        absolute: &[f64],
    ) -> Result<Vec<f64>, Error> {
        let (mut t, mut x) = (begin, x.to_vec());
        let within = (begin, end);
        let mut slope = self.slope(t, within, &x);
        if slope.iter().any(|v| !v.is_finite()) {
            return Err(self.failure(t, within, &x, &slope));
        }
        for _ in 0..STEPS {
            let left = end - t;
            let last = *step >= left * (1.0 - 1e-12);
            let h = if last { left } else { *step };
            let mut k = vec![slope.clone()];
            let mut next = x.clone();
            for stage in 1..7 {
                for i in 0..x.len() {
                    let sum: f64 = A[stage].iter().zip(&k).map(|(a, k)| a * k[i]).sum();
                    next[i] = x[i] + h * sum;
                }
                // At its end an interval has the input of the next knot, to the bit.
                let at = if last && C[stage] == 1.0 { end } else { t + C[stage] * h };
                k.push(self.slope(at, within, &next));
            }
            let error = (0..x.len()).map(|i| {
                let error: f64 = h * ERROR.iter().zip(&k).map(|(e, k)| e * k[i]).sum::<f64>();
                error / (absolute[i] + relative * x[i].abs().max(next[i].abs()))
            });
            let error = (error.map(|e| e * e).sum::<f64>() / x.len() as f64).sqrt();
            let sound = error.is_finite() && next.iter().chain(&k[6]).all(|v| v.is_finite());
            if sound && error <= 1.0 {
                t = if last { end } else { t + h };
                (x, slope) = (next, k.swap_remove(6));
                let grown = h * (0.9 * error.max(1e-10).powf(-0.2)).min(5.0);
                // A short last step says nothing of the next.
                *step = if last { grown.max(step.min(end - begin)) } else { grown };
                if last {
                    return Ok(x);
                }
                continue;
            }
            *step = if sound { h * (0.9 * error.powf(-0.2)).max(0.1) } else { 0.1 * h };
            if t + *step <= t || *step < 1e-14 * (end - begin) {
                return Err(self.failure(t, within, &x, &self.slope(t + h, within, &next)));
            }
        }
        Err(self.failure(t, within, &x, &slope))
    }

    /// Why there is no solution from a time on.
    fn failure(&self, t: f64, interval: (f64, f64), x: &[f64], slope: &[f64]) -> Error {
        let text = format!(
            "experiment '{}': the simulation of '{}' ends at t = {t} s of {} s: ",
            self.run.name,
            self.model.name,
            self.run.t[self.run.t.len() - 1]
        );
        let Some(state) = slope.iter().position(|v| !v.is_finite()) else {
            return Error::Evaluation(format!(
                "{text}the solution grows without limit; the model may be unstable with these parameters"
            ));
        };
        let point = self.point(t, Some(interval), x);
        let inputs = self.inputs.iter().map(|input| input.name).zip(&point[1..]);
        let states = self.model.states.iter().map(|s| s.name.as_str()).zip(x);
        let place: Vec<String> = states.chain(inputs).map(|(name, v)| format!("{name} = {v}")).collect();
        let name = &self.model.states[state].name;
        Error::Evaluation(format!("{text}the equation of {name}' is not finite there, {}", place.join(", ")))
    }
}
