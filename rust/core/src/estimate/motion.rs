//! Meshes and state paths from a simulation at the starting parameters, moved along with the estimates.

use std::sync::Arc;
use std::time::Duration;

use super::fit::Fit;
use super::refine::{in_parts, order_of};
use super::run::Watch;
use super::{Earlier, Estimation, Path, Start};
use crate::condition::End;
use crate::error::{Error, ErrorKind};
use crate::experiment::{Experiment, Signal};
use crate::mesh::Grid;
use crate::simulate::Simulation;
use crate::solver::Status;

/// Most steps in a record, and most time of an integration.
const MOST: usize = 2_000;
const LONGEST: Duration = Duration::from_secs(5);
/// Steps shorter than this part of a record are none.
const APART: f64 = 1e-12;
/// Iterations on one mesh before it is moved, and how often it is. The last mesh has no limit of its own.
const ITERATIONS: usize = 25;
const MOVES: usize = 8;
/// A step that is a segment of low order is divided into more, and where that does not suit, again.
const FINEST: usize = 64;
/// A mesh suits where outputs differ from those of an integration by less than this part of the residuals.
const SUITS: f64 = 0.01;
/// How often a mesh is divided, at most, where the model cannot be simulated with what it led to.
const DIVISIONS: usize = 3;
/// A run behind the best goes on where a mesh brings this part of what is missing.
const RATE: f64 = 0.1;

/// Values of parameters by name.
pub(super) type Values = Vec<(String, f64)>;

/// A simulation of one experiment: ends of its steps, times and states there and half-way, outputs at the samples.
pub(super) struct Motion {
    steps: Vec<f64>,
    times: Vec<f64>,
    states: Vec<Vec<f64>>,
    outputs: Vec<Vec<f64>>,
}

impl Estimation<'_> {
    /// Whether the mesh is to follow the motion: unless said otherwise, where it has one segment between samples, samples
    /// are few, and the parameters tell where the motion begins.
    pub(super) fn follows_motion(&self) -> bool {
        let one_between = || matches!(&self.transcription.grid[..], [Grid::Samples(1)]);
        if self.shots.is_some() || !self.moving_mesh.unwrap_or_else(one_between) {
            return false;
        }
        let known = |state: &str| {
            let mut conditions = self.model.conditions.iter();
            conditions.any(|c| c.end == End::Initial && c.state == state)
                && !self.start.iter().any(|s| s.0 == state)
        };
        self.few_samples() && self.model.states.iter().all(|s| known(&s.name))
    }

    /// Simulates all experiments with some values of the parameters, from the model's initial conditions. None where one of
    /// them has no solution, or takes too long.
    pub(super) fn simulated(&self, values: &Values, tolerance: f64) -> Option<Vec<Motion>> {
        self.experiments.iter().map(|run| self.motion(run, values, tolerance)).collect()
    }

    fn motion(&self, run: &Experiment, values: &Values, tolerance: f64) -> Option<Motion> {
        let of = |name: &str| values.iter().find(|v| v.0 == name).map(|v| v.1);
        let simulate = |run: &Experiment| {
            let mut simulation = Simulation::new(self.model, run).tolerance(tolerance).time_limit(LONGEST);
            for p in &self.model.parameters {
                let own = of(&format!("{}[{}]", p.name, run.name)).or_else(|| of(&p.name));
                simulation = simulation.parameter(&p.name, own.unwrap_or(p.start));
            }
            simulation.run().ok()
        };
        let path = simulate(run)?;
        if path.steps.len() > MOST {
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
        let states = simulate(&finer)?.states;
        Some(Motion { steps, times, states, outputs: path.outputs })
    }

    /// Estimates on meshes that follow the motion: the steps of an integration with the parameters as they are.
    ///
    /// With few samples these say nothing of where a mesh must be fine, and a path that starts as a solution of the
    /// equations can be kept one. A run that is behind the `best` log-likelihood and does not gain on it from one mesh to
    /// the next ends early. None where the model cannot be simulated at the starting parameters, or has no finite
    /// derivatives there.
    pub(super) fn along_the_motion(
        &self,
        values: &Values,
        best: f64,
        tolerance: f64,
        watch: &mut Watch<'_>,
    ) -> Result<Option<Fit>, Error> {
        let order = self.transcription.order;
        let mut parts = match order {
            2 => 8,
            3 => 2,
            _ => 1,
        };
        let mut at = values.clone();
        let mut fit: Option<Fit> = None;
        let (mut iterations, mut time, mut divisions) = (0, Duration::ZERO, 0);
        for number in 0..=MOVES {
            let last = number == MOVES;
            let (grid, paths): (Vec<Grid>, Vec<Path>) = match (self.simulated(&at, tolerance), &fit) {
                (Some(runs), fit) => {
                    if let Some(fit) = fit.as_ref().filter(|fit| !is_unfinished(fit.status)) {
                        if fit.suits(&runs) || parts > FINEST {
                            break;
                        }
                        parts *= 2;
                    }
                    let one =
                        |r: Motion| (Grid::Edges(in_parts(&r.steps, parts)), self.named(r.times, r.states));
                    runs.into_iter().map(one).unzip()
                }
                // No mesh to move to. A path across a pole of the solution is one of a mesh that is too coarse.
                (None, Some(fit)) if divisions < DIVISIONS && fit.feasible => {
                    divisions += 1;
                    let one = |r: &super::Record| {
                        let ends: Vec<f64> = r.mesh_t.iter().copied().step_by(order_of(fit) - 1).collect();
                        let path = self.named(r.mesh_t.clone(), r.mesh_states.clone());
                        (Grid::Edges(in_parts(&ends, 2)), path)
                    };
                    fit.records.iter().map(one).unzip()
                }
                (None, _) => break,
            };
            let before = fit.as_ref().map(|fit| fit.log_likelihood);
            let mut pass = self.on_grid(order, grid).along_paths(paths, &at);
            if !last {
                pass.solver.max_iterations = pass.solver.max_iterations.min(ITERATIONS);
            }
            let found = match pass.solve_passes(watch) {
                Err(e) if e.kind() == ErrorKind::Evaluation => break,
                found => found?,
            };
            iterations += found.iterations;
            time += found.solution.time;
            let behind = best.is_finite()
                && before.is_some_and(|before| {
                    let gain = found.log_likelihood - before;
                    gain.is_nan() || gain <= RATE * (best - found.log_likelihood)
                });
            let ends = last || found.status.was_stopped() || behind;
            at = found.parameters.iter().map(|e| (e.name.clone(), e.value)).collect();
            fit = Some(found);
            if ends {
                break;
            }
        }
        Ok(fit.map(|mut fit| {
            (fit.iterations, fit.solution.time) = (iterations, time);
            fit
        }))
    }

    fn named(&self, t: Vec<f64>, states: Vec<Vec<f64>>) -> Path {
        Path { t, states: self.model.states.iter().map(|s| s.name.clone()).zip(states).collect() }
    }

    /// The same estimation from other paths of the states and values of the parameters.
    fn along_paths(&self, paths: Vec<Path>, values: &Values) -> Self {
        let known = self.earlier.as_ref().map(|e| e.values.clone()).unwrap_or_default();
        let mut start = self.start.clone();
        let noise_of_one = |name: &str| {
            name.split_once('[')
                .is_some_and(|(stem, _)| !self.model.parameters.iter().any(|p| p.name == stem))
        };
        let given = values.iter().filter(|v| !noise_of_one(&v.0));
        start.extend(given.map(|(name, value)| (name.clone(), Start::Value(*value))));
        let earlier = Some(Arc::new(Earlier { values: known, paths, ..Earlier::default() }));
        Estimation { start, earlier, ..self.clone() }
    }
}

fn is_unfinished(status: Status) -> bool {
    matches!(status, Status::IterationLimit | Status::Infeasible | Status::Diverging)
}

/// The ends of the steps without those that rounding would put into one place.
fn apart(steps: &[f64]) -> Vec<f64> {
    let (first, last) = (steps[0], steps[steps.len() - 1]);
    let least = APART * (last - first);
    let inner = steps.windows(2).filter(|w| w[1] - w[0] > least && last - w[1] > least).map(|w| w[1]);
    [first].into_iter().chain(inner).chain([last]).collect()
}

impl Fit {
    /// Whether its outputs are those of the integration.
    pub(super) fn suits(&self, runs: &[Motion]) -> bool {
        self.feasible
            && (0..self.model.outputs.len()).all(|c| {
                let (mut off, mut residual) = (0.0, 0.0);
                for (record, run) in self.records.iter().zip(runs) {
                    let pairs = record.outputs[c].iter().zip(&run.outputs[c]).zip(&record.residuals[c]);
                    for ((y, other), r) in pairs.filter(|p| p.1.is_finite()) {
                        off += (y - other) * (y - other);
                        residual += r * r;
                    }
                }
                off.sqrt() <= SUITS * residual.sqrt()
            })
    }
}
