//! Simulations with some values of the parameters: motions that meshes follow, and how far a fit is from them.

use std::sync::Arc;
use std::time::Duration;

use super::fit::Fit;
use super::refine::in_parts;
use super::segments::Motion;
use super::{Earlier, Estimation, Path, Start, Transcription};
use crate::condition::End;
use crate::dense::largest;
use crate::experiment::{Experiment, Signal};
use crate::mesh::Grid;
use crate::simulate::Simulation;

/// Most steps in a record, more where nothing is iterated on them, and most time of an integration.
const MOST: usize = 2_000;
const MOST_AT_REST: usize = 20_000;
const LONGEST: Duration = Duration::from_secs(5);
/// Steps shorter than this part of a record are none.
const APART: f64 = 1e-12;
/// A mesh suits where outputs differ from those of an integration by less than this part of the residuals.
pub(super) const SUITS: f64 = 0.01;
/// Bounds that difference beyond which a mesh says nothing of the likelihood.
pub(super) const FAR: f64 = 0.1;
/// Values of parameters by name.
pub(super) type Values = Vec<(String, f64)>;

/// A simulation of one experiment: its motion, and outputs at the samples.
pub(super) struct Simulated {
    pub motion: Motion,
    outputs: Vec<Vec<f64>>,
}

impl Estimation<'_> {
    /// Whether the mesh is to follow the motion: unless said otherwise, where it has one segment between samples, samples
    /// are few, and the parameters tell where the motion begins.
    pub(super) fn follows_motion(&self) -> bool {
        let Transcription::Collocation(settings) = &self.transcription else { return false };
        let one_between = || matches!(&settings.grid[..], [Grid::Samples(1)]);
        if !self.moving_mesh.unwrap_or_else(one_between) {
            return false;
        }
        self.parameters_tell_motion()
    }

    /// Whether samples are few, and the parameters tell where the motion begins: then the likelihood is one of the parameters.
    pub(super) fn parameters_tell_motion(&self) -> bool {
        let known = |state: &str| self.is_told(state) && !self.start.iter().any(|s| s.0 == state);
        self.few_samples() && self.model.states.iter().all(|s| known(&s.name))
    }

    /// Returns whether a condition of the model tells the initial value of a state.
    fn is_told(&self, state: &str) -> bool {
        self.model.conditions.iter().any(|c| c.end == End::Initial && c.state == state)
    }

    /// Returns the parameters of a fit, and the initial states that no condition tells.
    pub(super) fn values_of(&self, fit: &Fit) -> Values {
        let mut values = fit.values();
        for record in &fit.records {
            let paths = self.model.states.iter().zip(&record.mesh_states);
            let free = paths.filter(|(state, _)| !self.is_told(&state.name));
            values.extend(free.map(|(state, x)| (format!("{}[{}]", state.name, record.name), x[0])));
        }
        values
    }

    /// Simulates all experiments with some values of the parameters, from the model's initial conditions. None where one of
    /// them has no solution, or takes too long.
    pub(super) fn simulated(&self, values: &Values, tolerance: f64) -> Option<Vec<Simulated>> {
        self.experiments.iter().map(|run| self.motion(run, values, tolerance)).collect()
    }

    fn motion(&self, run: &Experiment, values: &Values, tolerance: f64) -> Option<Simulated> {
        let of = |name: &str| values.iter().find(|v| v.0 == name).map(|v| v.1);
        let simulation = |run| {
            let mut simulation = Simulation::new(self.model, run).tolerance(tolerance).time_limit(LONGEST);
            for p in &self.model.parameters {
                let own = of(&format!("{}[{}]", p.name, run.name)).or_else(|| of(&p.name));
                simulation = simulation.parameter(&p.name, own.unwrap_or(p.start));
            }
            for state in &self.model.states {
                if let Some(x) = of(&format!("{}[{}]", state.name, run.name)) {
                    simulation = simulation.initial(&state.name, x);
                }
            }
            simulation
        };
        let path = simulation(run).run().ok()?;
        let most = if self.solver.max_iterations == 0 { MOST_AT_REST } else { MOST };
        if path.steps.len() > most {
            return None;
        }
        let steps = apart(&path.steps);
        let times = in_parts(&steps, 2);
        let finer = Experiment {
            inputs: vec![vec![0.0; times.len()]; run.inputs.len()],
            outputs: vec![vec![f64::NAN; times.len()]; run.outputs.len()],
            signals: (0..run.inputs.len())
                .map(|c| Some(Signal { interpolation: Some(run.kind(c)), ..run.signal(c) }))
                .collect(),
            t: times.clone(),
            ..run.clone()
        };
        let finer = simulation(&finer).with_slopes().run().ok()?;
        let motion = Motion { ends: steps, times, states: finer.states, slopes: finer.slopes };
        Some(Simulated { motion, outputs: path.outputs })
    }

    pub(super) fn named(&self, t: Vec<f64>, states: Vec<Vec<f64>>) -> Path {
        Path { t, states: self.model.states.iter().map(|s| s.name.clone()).zip(states).collect() }
    }

    /// The same estimation from other paths of the states, which satisfy the equations with these values of the parameters.
    ///
    /// A regression on them would only return the values, also where every state is measured.
    pub(super) fn along_paths(&self, paths: Vec<Path>, values: &Values) -> Self {
        let known = self.earlier.as_ref().map(|e| e.values.clone()).unwrap_or_default();
        let mut start = self.start.clone();
        let noise_of_one = |name: &str| {
            name.split_once('[')
                .is_some_and(|(stem, _)| !self.model.parameters.iter().any(|p| p.name == stem))
        };
        let given = values.iter().filter(|v| !noise_of_one(&v.0));
        start.extend(given.map(|(name, value)| (name.clone(), Start::Value(*value))));
        let earlier = Some(Arc::new(Earlier { values: known, paths, ..Earlier::default() }));
        let (regression, paths) = (self.regression.or(Some(false)), self.paths.or(Some(true)));
        Estimation { start, earlier, regression, paths, ..self.clone() }
    }
}

/// Returns the times at which a segment ends in any case: samples, and where inputs that are held jump.
pub(super) fn fixed_times(run: &Experiment) -> Vec<f64> {
    let mut times = run.t.clone();
    times.extend(run.jumps());
    times.sort_by(f64::total_cmp);
    times
}

/// The ends of the steps without those that rounding would put into one place.
fn apart(steps: &[f64]) -> Vec<f64> {
    let (first, last) = (steps[0], steps[steps.len() - 1]);
    let least = APART * (last - first);
    let inner = steps.windows(2).filter(|w| w[1] - w[0] > least && last - w[1] > least).map(|w| w[1]);
    [first].into_iter().chain(inner).chain([last]).collect()
}

impl Fit {
    /// The values of its parameters.
    pub(super) fn values(&self) -> Values {
        self.parameters.iter().map(|e| (e.name.clone(), e.value)).collect()
    }

    /// Whether its outputs are those of the integration.
    pub(super) fn suits(&self, runs: &[Simulated]) -> bool {
        self.departure(runs) <= SUITS
    }

    /// Returns how far its outputs are from those of the integration, as a part of the residuals, of the output of which that
    /// is largest; infinite for an end that is not feasible.
    pub(super) fn departure(&self, runs: &[Simulated]) -> f64 {
        let of_output = |c: usize| {
            let (mut off, mut residual) = (0.0, 0.0);
            for (record, run) in self.records.iter().zip(runs) {
                let pairs = record.outputs[c].iter().zip(&run.outputs[c]).zip(&record.residuals[c]);
                for ((y, other), r) in pairs.filter(|p| p.1.is_finite()) {
                    off += (y - other) * (y - other);
                    residual += r * r;
                }
            }
            if off > 0.0 { (off / residual).sqrt() } else { off }
        };
        let outputs = 0..self.model.outputs.len();
        if self.feasible { largest(outputs.map(of_output)) } else { f64::INFINITY }
    }
}
