//! Messages on what is not finite in an integration, and when. They need not be fast.

use super::Shooting;
use crate::index::{ExperimentId, VariableId};
use crate::nlp::{Named, Nlp};
use crate::problem::explain::UNDERFLOW;
use crate::problem::transcribed::Transcribed;

impl Shooting {
    /// Explains where and why the solution of the equations ceases to exist at ξ; `None` when everything is finite.
    pub(super) fn explained(&self, xi: &[f64]) -> Option<String> {
        if let Some(i) = xi.iter().position(|v| !v.is_finite()) {
            return Some(format!("{} is {}", self.variable_name(VariableId(i)), xi[i]));
        }
        let experiments = || self.tracks.numbered().map(|(e, _)| e);
        self.posed
            .explain_noise(xi)
            .or_else(|| experiments().find_map(|e| self.lost(xi, e)))
            .or_else(|| experiments().find_map(|e| self.bad_output(xi, e)))
            .or_else(|| self.objective(xi).is_err().then(|| UNDERFLOW.into()))
    }

    /// The time at which the integration of an experiment meets something that is not finite.
    fn lost(&self, xi: &[f64], e: ExperimentId) -> Option<String> {
        let mut found = None;
        self.shoot(xi, e, |s, shot| {
            if found.is_some() {
                return;
            }
            let points = shot.x.len() / shot.n_x;
            let bad = |point: usize| !shot.state(point).iter().all(|x| x.is_finite());
            let Some(point) = (0..points).find(|p| bad(*p)) else { return };
            let (start, name) = (self.tracks[e].segments[s][0], &self.posed.experiments[e].name);
            let t = shot.data(point)[0];
            // Of the stages of the step before, one had a slope that is not finite, unless the states grew too large.
            let step = point.saturating_sub(1) / shot.stages * shot.stages;
            let slope = (step..point).find_map(|at| {
                let (data, f) = (shot.data(at), &self.posed.f);
                let names = self.posed.symbols(xi, e, data[0], data[1..].iter().copied(), shot.state(at));
                f.roots.iter().zip(&self.posed.state_names).find_map(|(root, state)| {
                    let what = format!("the equation of {state}' is");
                    self.posed.describe(&what, f, &names, &[*root], e, data[0])
                })
            });
            let why = slope.unwrap_or_else(|| "the solution grows without limit".into());
            found = Some(format!(
                "the solution of '{name}' that starts at t = {start} ceases to exist at t = {t}: {why}"
            ));
        });
        found
    }

    /// An output that is not finite where it was measured.
    fn bad_output(&self, xi: &[f64], e: ExperimentId) -> Option<String> {
        let record = &self.posed.experiments[e];
        let states = self.states_at_samples(xi, e);
        for (k, &t) in record.t.iter().enumerate() {
            let x: Vec<f64> = states.iter().map(|path| path[k]).collect();
            let names =
                self.posed.symbols(xi, e, t, (0..record.inputs.len()).map(|c| record.input(c, &[t])[0]), &x);
            let measured = (0..self.posed.outputs.roots.len()).filter(|&c| !record.outputs[c][k].is_nan());
            let roots: Vec<_> = measured.map(|c| self.posed.outputs.roots[c]).collect();
            if let Some(text) = self.posed.describe("an output is", &self.posed.outputs, &names, &roots, e, t)
            {
                return Some(text);
            }
        }
        None
    }
}
