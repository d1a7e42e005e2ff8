//! Estimation of delays: u(t − τ) in the equations, z(t) = y(t − τ) at a sensor ([`crate::model::Delays`]).
//!
//! A model at fixed delays is solved, the base of its delays moved to the estimate, and so on until nothing is left.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use super::Estimation;
use super::fit::{Bound, Fit, Moved, Record};
use super::start::Start;
use super::transcription::Transcription;
use crate::condition::End;
use crate::error::Error;
use crate::experiment::{Experiment, Signal};
use crate::interpolate::{Interpolation, interpolate};
use crate::mesh::Grid;
use crate::model::{Model, rates};
use crate::solver::{Control, Iteration, Status};

/// A delay moves by no more than this many sample intervals before its base follows.
const REACH: f64 = 2.0;
/// Bases have settled, too, when they move by less than this part of a sample interval.
const NOTHING: f64 = 1e-9;
/// A delay is at a bound when it is this near to it, s, or this part of it beyond 1 s.
const THERE: f64 = 1e-6;
/// Times closer than this part of the shortest interval of a channel are the same.
const SAME: f64 = 1e-8;

impl Estimation<'_> {
    /// The estimate of a model with delays, by passes over models without.
    pub(super) fn solve_with_delays(
        &self,
        watch: &mut dyn FnMut(&Iteration) -> Control,
    ) -> Result<Fit, Error> {
        let model = self.model;
        self.checked_noise()?;
        if self.experiments.is_empty() {
            return Err(Error::data("no experiment was given; at least one is needed".into()));
        }
        let names = model.delays.parameters();
        let local = |p: &&crate::model::Parameter| p.local && names.contains(&p.name.as_str());
        if let Some(p) = model.parameters.iter().find(local).filter(|_| self.experiments.len() > 1) {
            return Err(Error::model(format!(
                "the delay '{}' must be one parameter of all experiments, not one for each",
                p.name
            ))
            .about(&p.name));
        }
        let values = self.parameters()?;
        let mut base: HashMap<&str, f64> =
            model.parameters.iter().zip(&values).map(|(p, v)| (p.name.as_str(), *v)).collect();
        base.retain(|name, _| names.contains(name));
        let interval = self.experiments.iter().map(|e| median_interval(&e.t)).fold(f64::INFINITY, f64::min);

        let (mut iterations, mut time) = (0, Duration::ZERO);
        let mut warning = None;
        let mut before: Option<Fit> = None;
        let mut number = 0;
        let (inner, experiments) = loop {
            let slim = model.at_delays(&base, REACH * interval);
            let moved = self.experiments.iter().map(|e| moved(model, &slim, e, &base));
            let moved: Vec<Experiment> = moved.collect::<Result<_, _>>()?;
            let mut pass = self.at(&slim, &moved, before.as_ref());
            pass.solver.max_iterations -= iterations.min(self.solver.max_iterations);
            let fit = pass.solve_now(watch)?;
            iterations += fit.iterations;
            time += fit.solution.time;
            let settled = names.iter().all(|name| {
                let e = &fit[name];
                let error = if e.std_error.is_finite() { e.std_error } else { 0.0 };
                (e.value - base[name]).abs() <= (self.settled * error).max(NOTHING * interval)
            });
            let unfinished =
                fit.status.lost() || matches!(fit.status, Status::Interrupted | Status::TimeLimit);
            number += 1;
            if settled || unfinished {
                break (fit, moved);
            }
            if number >= self.passes || iterations >= self.solver.max_iterations {
                let left = names.iter().map(|n| (fit[n].value - base[n]).abs()).fold(0.0, f64::max);
                warning = Some(format!(
                    "the delays still move by up to {left:.1e}: where inputs bend sharply between samples, the \
                     likelihood is not smooth in a delay"
                ));
                break (fit, moved); // the base stays that of the fit
            }
            base = names.iter().map(|n| (*n, fit[n].value)).collect();
            before = Some(fit);
        };

        let mut fit = inner.clone();
        let mut on_the_way = Vec::new();
        for p in model.parameters.iter().filter(|p| names.contains(&p.name.as_str())) {
            let Some(e) = fit.parameters.iter_mut().find(|e| e.name == p.name) else { continue };
            // With the bounds of the model: that a pass let it go no further is no bound of these.
            e.bounds = (p.lower.unwrap_or(f64::NEG_INFINITY), p.upper.unwrap_or(f64::INFINITY));
            let there = |bound: f64| (e.value - bound).abs() <= THERE * bound.abs().max(1.0);
            match e.bound {
                Some(Bound::Lower) if !there(e.bounds.0) => on_the_way.push(p.name.as_str()),
                Some(Bound::Upper) if !there(e.bounds.1) => on_the_way.push(p.name.as_str()),
                _ => continue,
            }
            e.bound = None;
        }
        if !on_the_way.is_empty() && fit.status == Status::Converged {
            let (hint, names) = (Status::IterationLimit.hint(), on_the_way.join(", "));
            (fit.status, fit.message) =
                (Status::IterationLimit, format!("{hint} ({names} has not converged)"));
        }
        for (record, experiment) in fit.records.iter_mut().zip(self.experiments) {
            restore(model, record, experiment, &base);
        }
        fit.warnings.extend(warning);
        (fit.iterations, fit.solution.time, fit.model) = (iterations, time, model.clone());
        let base = base.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        fit.moved = Some(Box::new(Moved { fit: inner, experiments, base, reach: REACH * interval }));
        Ok(fit)
    }

    /// The same estimation of the model at its delays, with the records moved.
    fn at<'b>(&'b self, slim: &'b Model, moved: &'b [Experiment], before: Option<&'b Fit>) -> Estimation<'b> {
        let of_delay = |name: &str| self.model.delays.parameters().contains(&name);
        let mut start = Vec::new();
        if before.is_none() {
            for (name, value) in self.start.iter().filter(|s| !of_delay(&s.0)) {
                start.push((name.clone(), self.at_moved(value, moved)));
            }
        }
        let mut transcription = self.transcription.clone();
        if let Transcription::Collocation(settings) = &mut transcription {
            let grids = std::mem::take(&mut settings.grid);
            let of = |e: usize| grids.get(if grids.len() == 1 { 0 } else { e });
            let grid = moved.iter().zip(self.experiments).enumerate();
            settings.grid = match grids.len() == 1 || grids.len() == moved.len() {
                true => grid.filter_map(|(e, (m, own))| Some(grid_of(of(e)?, m, own))).collect(),
                false => grids, // refused as any other is
            };
        }
        let earlier = before.map(|fit| Arc::new(fit.into())).or_else(|| self.earlier.clone());
        Estimation { model: slim, experiments: moved, transcription, start, earlier, ..self.clone() }
    }

    /// Paths of states, one value a sample, at the samples of the moved records.
    fn at_moved(&self, start: &Start, moved: &[Experiment]) -> Start {
        let Start::Paths(paths) = start else { return start.clone() };
        let fits = paths.len() == moved.len()
            && paths.iter().zip(self.experiments).all(|(p, e)| p.len() == e.t.len());
        if !fits {
            return start.clone(); // refused as any other is
        }
        let at = |((path, e), m): ((&Vec<f64>, &Experiment), &Experiment)| {
            interpolate(Interpolation::Linear, &e.t, path, &m.t)
        };
        Start::Paths(paths.iter().zip(self.experiments).zip(moved).map(at).collect())
    }
}

/// Segments of the moved record: between the samples as they were, which is where inputs that are not late bend.
fn grid_of(grid: &Grid, moved: &Experiment, own: &Experiment) -> Grid {
    let (first, last) = (moved.t[0], moved.t[moved.t.len() - 1]);
    let clipped = |times: &[f64]| {
        let inner = times.iter().copied().filter(|t| *t > first && *t < last);
        [first].into_iter().chain(inner).chain([last]).collect::<Vec<f64>>()
    };
    match grid {
        Grid::Samples(parts) if *parts > 0 => {
            let ends = clipped(&own.t);
            let mut edges = Vec::with_capacity((ends.len() - 1) * parts + 1);
            for pair in ends.windows(2) {
                edges.extend((0..*parts).map(|k| pair[0] + (pair[1] - pair[0]) * k as f64 / *parts as f64));
            }
            edges.push(last);
            Grid::Edges(edges)
        }
        Grid::Edges(edges) => Grid::Edges(clipped(edges)),
        other => other.clone(),
    }
}

/// The record with signals moved by the base: outputs earlier, late inputs later.
fn moved(
    model: &Model,
    slim: &Model,
    run: &Experiment,
    base: &HashMap<&str, f64>,
) -> Result<Experiment, Error> {
    let (first, last) = (run.t[0], run.t[run.t.len() - 1]);
    let mut channels = Vec::new();
    for (output, z) in model.outputs.iter().zip(&run.outputs) {
        let by = model.delays.output(&output.name).map_or(0.0, |tau| base[tau]);
        let own = run.t.iter().map(|t| t - by).zip(z.iter().copied());
        let own: Vec<(f64, f64)> = own.filter(|(t, _)| first <= *t && *t <= last).collect();
        if own.iter().all(|(_, z)| z.is_nan()) {
            return Err(Error::data(format!(
                "experiment '{}', output '{}': no sample is left with a delay of {by} in a record of length {}",
                run.name,
                output.name,
                last - first
            ))
            .about(&run.name)
            .about(&output.name));
        }
        channels.push(own);
    }
    // Conditions on an end are those of the record, whether or not an output is measured there.
    let at = |ends: [End; 2]| model.conditions.iter().any(|c| ends.contains(&c.end));
    let (at_first, at_last) = (at([End::Initial, End::Periodic]), at([End::Final, End::Periodic]));
    let ends = at_first.then_some(first).into_iter().chain(at_last.then_some(last));
    let (t, outputs) = together(&channels, ends);
    let measured = model.input_names();
    let mut signals = Vec::new();
    for input in &slim.inputs {
        let is_own = model.inputs.iter().any(|v| v.name == input.name);
        let of_rate = |v: &&crate::model::Variable| rates(&v.name).contains(&input.name);
        let whole = model.inputs.iter().find(|v| is_own && v.name == input.name || !is_own && of_rate(v));
        let whole = whole.expect("inputs are the model's, or rates of these");
        let derivative = if is_own {
            0
        } else if rates(&whole.name)[0] == input.name {
            1
        } else {
            2
        };
        let (of, delay) = match model.delays.input(&whole.name) {
            Some(late) => (late.of.as_str(), base[late.by.as_str()]),
            None => (whole.name.as_str(), 0.0),
        };
        let place = measured.iter().position(|n| *n == of).expect("a late input is one of the model's");
        let own = run.signal(place);
        let (delay, interpolation) = (own.delay + delay, Some(run.kind(place)));
        signals.push(Some(Signal { delay, derivative, interpolation, ..own }));
    }
    let at = |s: &Option<Signal>| s.as_ref().map_or_else(Vec::new, |s| s.at(run.interpolation, &t));
    Ok(Experiment {
        name: run.name.clone(),
        inputs: signals.iter().map(at).collect(),
        outputs,
        interpolation: run.interpolation,
        signals,
        t,
    })
}

/// The times of all channels and some more, and each channel at these, NaN where it has no sample.
fn together(channels: &[Vec<(f64, f64)>], more: impl Iterator<Item = f64>) -> (Vec<f64>, Vec<Vec<f64>>) {
    let gaps = channels.iter().flat_map(|c| c.windows(2).map(|w| w[1].0 - w[0].0));
    let least = gaps.fold(f64::INFINITY, f64::min);
    let same = SAME * if least.is_finite() { least } else { 1.0 };
    let mut all: Vec<f64> = channels.iter().flatten().map(|s| s.0).chain(more).collect();
    all.sort_by(f64::total_cmp);
    // Of times that follow each other closely, the first is kept.
    let kept = (0..all.len()).filter(|&i| i == 0 || all[i] - all[i - 1] > same);
    let t: Vec<f64> = kept.map(|i| all[i]).collect();
    let column = |channel: &Vec<(f64, f64)>| {
        let mut column = vec![f64::NAN; t.len()];
        for (own, value) in channel {
            let after = t.partition_point(|t| *t <= own + 0.5 * same);
            column[after.saturating_sub(1)] = *value;
        }
        column
    };
    let columns = channels.iter().map(column).collect();
    (t, columns)
}

/// Puts a record back to the samples of the experiment: outputs as measured, late; NaN where they reach back too far.
fn restore(model: &Model, record: &mut Record, run: &Experiment, base: &HashMap<&str, f64>) {
    let (t, n) = (&run.t, run.t.len());
    let slack = 1e-6 * median_interval(t);
    for (c, output) in model.outputs.iter().enumerate() {
        let by = model.delays.output(&output.name).map_or(0.0, |tau| base[tau]);
        let at = |t: &f64| {
            let own = t - by;
            let after = record.t.partition_point(|t| *t <= own + slack);
            let inside = run.t[0] <= own && own <= run.t[n - 1];
            if inside { record.outputs[c][after.saturating_sub(1)] } else { f64::NAN }
        };
        record.outputs[c] = t.iter().map(at).collect();
        let pairs = run.outputs[c].iter().zip(&record.outputs[c]);
        record.residuals[c] = pairs.map(|(z, y)| z - y).collect();
    }
    let state = |path: &Vec<f64>| interpolate(Interpolation::Linear, &record.mesh_t, path, t);
    record.states = record.mesh_states.iter().map(state).collect();
    record.t = t.clone();
}

fn median_interval(t: &[f64]) -> f64 {
    let mut gaps: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
    gaps.sort_by(f64::total_cmp);
    let n = gaps.len();
    if n % 2 == 1 { gaps[n / 2] } else { 0.5 * (gaps[n / 2 - 1] + gaps[n / 2]) }
}
