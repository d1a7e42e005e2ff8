//! Records without the samples at which nothing was measured: a mesh that follows the motion has no use for them.
//!
//! A long rest before a manoeuvre, as for a steady state, comes with many times at which nothing is measured.

use std::borrow::Cow;

use super::Estimation;
use super::fit::{Fit, Record};
use super::refine::order_of;
use super::run::Watch;
use crate::error::Error;
use crate::evaluator::Evaluator;
use crate::experiment::{Experiment, Signal};

impl Estimation<'_> {
    /// Searches as [`Estimation::search_restarts`] on records without such samples. The fit has all of them.
    pub(super) fn search_at_measurements(&self, watch: &mut Watch<'_>) -> Result<Option<Fit>, Error> {
        let reduced =
            |run| if self.model.delays.is_empty() { at_measurements(run) } else { Cow::Borrowed(run) };
        let runs: Vec<Cow<'_, Experiment>> = self.experiments.iter().map(reduced).collect();
        if runs.iter().all(|run| matches!(run, Cow::Borrowed(_))) {
            return self.search_restarts(watch);
        }
        let experiments: Vec<Experiment> = runs.into_iter().map(Cow::into_owned).collect();
        let within = Estimation { experiments: &experiments, ..self.clone() };
        let Some(mut fit) = within.search_restarts(watch)? else { return Ok(None) };
        let (evaluator, order) = (Evaluator::new(&fit.model)?, order_of(&fit));
        for (k, run) in self.experiments.iter().enumerate() {
            let parameters = fit.numbers_of(&run.name).0;
            let record = &fit.records[k];
            if record.t.len() < run.t.len() {
                fit.records[k] = at_all_samples(record, order, run, &evaluator, &parameters)?;
            }
        }
        Ok(Some(fit))
    }
}

/// Returns the record at its ends, where an output was measured, and where an input that is not held bends.
fn at_measurements(run: &Experiment) -> Cow<'_, Experiment> {
    let (n, last) = (run.t.len(), run.t.len() - 1);
    let own = |c: &usize| run.signals.get(*c).is_none_or(Option::is_none);
    let sampled: Vec<usize> = (0..run.inputs.len()).filter(|c| own(c) && !run.is_held(*c)).collect();
    let bends = |k: usize| {
        let moves = |u: &Vec<f64>| u[k - 1] != u[k] || u[k] != u[k + 1];
        sampled.iter().any(|&c| moves(&run.inputs[c]))
    };
    let is_kept = |k: usize| k == 0 || k == last || run.outputs.iter().any(|z| z[k].is_finite()) || bends(k);
    let kept: Vec<usize> = (0..n).filter(|k| is_kept(*k)).collect();
    if kept.len() == n {
        return Cow::Borrowed(run);
    }
    let at = |values: &Vec<f64>| kept.iter().map(|k| values[*k]).collect::<Vec<f64>>();
    let signal = |c| Some(Signal { interpolation: Some(run.kind(c)), ..run.signal(c) });
    Cow::Owned(Experiment {
        t: at(&run.t),
        inputs: run.inputs.iter().map(at).collect(),
        outputs: run.outputs.iter().map(at).collect(),
        signals: (0..run.inputs.len()).map(signal).collect(),
        ..run.clone()
    })
}

/// Returns the record of a fit at all samples: where it has none, states are those of the polynomial through the points of
/// their segment.
fn at_all_samples(
    record: &Record,
    order: usize,
    run: &Experiment,
    evaluator: &Evaluator,
    parameters: &[f64],
) -> Result<Record, Error> {
    let own = |t: f64| record.t.binary_search_by(|s| s.total_cmp(&t)).ok();
    let points = order - 1;
    let all = |mesh: &Vec<f64>, at_samples: &Vec<f64>| -> Vec<f64> {
        let between = |t: f64| {
            // The segment that the time lies in, of which both ends are points.
            let after = record.mesh_t.partition_point(|s| *s < t).clamp(1, mesh.len() - 1);
            let first = (after - 1) / points * points;
            polynomial(&record.mesh_t[first..=first + points], &mesh[first..=first + points], t)
        };
        run.t.iter().map(|t| own(*t).map_or_else(|| between(*t), |k| at_samples[k])).collect()
    };
    let states: Vec<Vec<f64>> =
        record.mesh_states.iter().zip(&record.states).map(|(m, s)| all(m, s)).collect();
    let inputs: Vec<Vec<f64>> = (0..run.inputs.len()).map(|c| run.input(c, &run.t)).collect();
    let columns: Vec<&[f64]> =
        std::iter::once(&run.t).chain(&inputs).chain(&states).map(Vec::as_slice).collect();
    let mut outputs = evaluator.outputs(parameters, &columns)?;
    for (y, exact) in outputs.iter_mut().zip(&record.outputs) {
        y.iter_mut().zip(&run.t).for_each(|(y, t)| *y = own(*t).map_or(*y, |k| exact[k]));
    }
    let residual = |(z, y): (&Vec<f64>, &Vec<f64>)| z.iter().zip(y).map(|(z, y)| z - y).collect();
    let residuals = run.outputs.iter().zip(&outputs).map(residual).collect();
    Ok(Record { t: run.t.clone(), states, outputs, residuals, ..record.clone() })
}

/// Returns the value at t of the polynomial through these points, by Neville's scheme.
fn polynomial(times: &[f64], values: &[f64], t: f64) -> f64 {
    let mut found = values.to_vec();
    for width in 1..times.len() {
        for i in 0..times.len() - width {
            let (a, b) = (times[i], times[i + width]);
            found[i] = ((b - t) * found[i] + (t - a) * found[i + 1]) / (b - a);
        }
    }
    found[0]
}
