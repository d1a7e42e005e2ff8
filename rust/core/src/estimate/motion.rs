//! Meshes and state paths from a simulation at the starting parameters, moved along with the estimates.

use std::sync::Arc;
use std::time::Duration;

use super::fit::Fit;
use super::refine::{in_parts, order_of};
use super::run::Watch;
use super::segments::Motion;
use super::{Earlier, Estimation, Path, Start, Transcription};
use crate::condition::End;
use crate::dense::largest;
use crate::error::{Error, ErrorKind};
use crate::experiment::{Experiment, Signal};
use crate::interrupt::current;
use crate::mesh::Grid;
use crate::simulate::Simulation;
use crate::solver::{Control, Status};

/// Most steps in a record, and most time of an integration.
const MOST: usize = 2_000;
const LONGEST: Duration = Duration::from_secs(5);
/// Steps shorter than this part of a record are none.
const APART: f64 = 1e-12;
/// Iterations on one mesh before it is moved, and how often it is. The last mesh has no limit of its own.
const ITERATIONS: usize = 25;
const MOVES: usize = 8;
/// Divides the local error of the segments where an end does not suit; its square root does so during a run.
const FINER: f64 = 16.0;
/// Limits the local error from below.
const LEAST: f64 = 1e-9;
/// A mesh suits where outputs differ from those of an integration by less than this part of the residuals.
const SUITS: f64 = 0.01;
/// Bounds that difference beyond which a mesh says nothing of the likelihood.
pub(super) const FAR: f64 = 0.1;
/// How often a mesh is divided, at most, where the model cannot be simulated with what it led to.
const DIVISIONS: usize = 3;
/// On one mesh after another, a run ends where a mesh brings less than this in log-likelihood; in the last run, the mesh then
/// stays.
const SLOW: f64 = 0.01;
/// A mesh that loses more than this in log-likelihood has led astray, and so often at most.
const LOST: f64 = 1.0;
const ASTRAY: usize = 2;
/// A run behind the best goes on where a mesh brings this part of what is missing.
const RATE: f64 = 0.1;

/// Values of parameters by name.
pub(super) type Values = Vec<(String, f64)>;

/// Sets the accuracy of meshes along a motion.
#[derive(Clone, Copy)]
pub(super) struct Accuracy {
    /// Tolerance of the integration.
    pub tolerance: f64,
    /// The local error of collocation that segments may have at first, as a part of each state.
    pub local: f64,
    /// Lets the run go on to its end where progress is slow.
    pub thorough: bool,
}

/// Suffices for the search.
pub(super) const SEARCH: Accuracy = Accuracy { tolerance: 1e-6, local: 1e-3, thorough: false };
/// Holds for the last run.
pub(super) const FINAL: Accuracy = Accuracy { tolerance: 1e-7, local: 1e-4, thorough: true };
/// Serves an end that the integration has found wrong.
pub(super) const FINEST: Accuracy = Accuracy { tolerance: 1e-9, local: 1e-6, thorough: true };

/// A simulation of one experiment: its motion, and outputs at the samples.
pub(super) struct Simulated {
    motion: Motion,
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
        let known = |state: &str| {
            let mut conditions = self.model.conditions.iter();
            conditions.any(|c| c.end == End::Initial && c.state == state)
                && !self.start.iter().any(|s| s.0 == state)
        };
        self.few_samples() && self.model.states.iter().all(|s| known(&s.name))
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
            simulation
        };
        let path = simulation(run).run().ok()?;
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
        let finer = simulation(&finer).with_slopes().run().ok()?;
        let motion = Motion { ends: steps, times, states: finer.states, slopes: finer.slopes };
        Some(Simulated { motion, outputs: path.outputs })
    }

    /// Estimates on meshes that follow the motion: segments along a simulation with the parameters as they are.
    ///
    /// With few samples these say nothing of where a mesh must be fine, and a path that starts as a solution of the
    /// equations can be kept one. Where a mesh leads away from solutions, or to a lower likelihood, the run goes on from the
    /// best end so far on a finer one. A run that is behind the `best` log-likelihood and does not gain on it from one mesh to
    /// the next ends early. None where the model cannot be simulated at the starting parameters, or has no finite
    /// derivatives there.
    pub(super) fn along_the_motion(
        &self,
        values: &Values,
        best: f64,
        accuracy: Accuracy,
        watch: &mut Watch<'_>,
    ) -> Result<Option<Fit>, Error> {
        let order = self.transcription.collocation().order;
        let mut local = accuracy.local;
        let mut at = values.clone();
        let mut fit: Option<Fit> = None;
        // The best end so far whose likelihood is known, and minus its objective; and an end whose path is none, which the next run tells.
        let (mut sound, mut unknown): (Option<(Fit, f64)>, Option<Fit>) = (None, None);
        let (mut iterations, mut time, mut divisions, mut astray) = (0, Duration::ZERO, 0, 0);
        let mut runs = self.simulated(&at, accuracy.tolerance);
        let mut last = false;
        for number in 0..=MOVES {
            last |= number == MOVES;
            if runs.is_none() {
                unknown = None;
            }
            let (grid, paths): (Vec<Grid>, Vec<Path>) = match (runs.take(), &fit) {
                (Some(runs), _) => {
                    let one = |(run, found): (&Experiment, Simulated)| {
                        let edges = found.motion.segments(order, local, &fixed_times(run));
                        let (times, states) = found.motion.on_mesh(order, &edges);
                        (Grid::Edges(edges), self.named(times, states))
                    };
                    self.experiments.iter().zip(runs).map(one).unzip()
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
            // A run begins with a path of the parameters with which the last one ended, on a mesh that suits them.
            let (mut begins, mut lost) = (None, false);
            let least = sound.as_ref().map_or(f64::NEG_INFINITY, |kept| kept.1 - LOST);
            let found = pass.solve_passes(&mut |line| {
                begins.get_or_insert(-line.objective);
                lost = unknown.is_some() && begins.is_some_and(|l| l < least);
                if lost { Control::Stop } else { watch(line) }
            });
            let found = match found {
                Err(e) if e.kind() == ErrorKind::Evaluation => break,
                found => found?,
            };
            iterations += found.iterations;
            time += found.solution.time;
            if let (Some(before), Some(l)) = (unknown.take(), begins.filter(|_| !lost))
                && sound.as_ref().is_none_or(|kept| l > kept.1)
            {
                sound = Some((before, l));
            }
            let stopped = found.status.was_stopped() && !lost;
            at = found.values();
            runs = if lost || stopped && sound.is_none() {
                None
            } else {
                self.simulated(&at, accuracy.tolerance)
            };
            let off = runs.as_ref().map_or(f64::INFINITY, |runs| found.departure(runs));
            let (reached, value) = (found.log_likelihood, -found.solution.objective);
            // Where the time is over, no other mesh follows that could confirm this one.
            let behind_when_cut = |kept: f64| {
                let integrated = self.integrated_log_likelihood(&found).unwrap_or(f64::NEG_INFINITY);
                off > FAR && (integrated.is_nan() || integrated < kept)
            };
            let is_lost = |kept: &&(Fit, f64)| {
                lost || !found.feasible
                    || off <= FAR && value < kept.1 - LOST
                    || stopped && behind_when_cut(kept.1)
            };
            if let Some((kept, _)) = sound.as_ref().filter(is_lost) {
                astray += 1;
                let mut back = kept.clone();
                if stopped {
                    (back.status, back.message) = (found.status, found.message);
                }
                fit = Some(back);
                if last || stopped || current().stops() || astray > ASTRAY {
                    break;
                }
                at = kept.values();
                runs = self.simulated(&at, accuracy.tolerance);
                local = (local / FINER).max(LEAST);
                continue;
            }
            let unfinished = is_unfinished(found.status);
            let slow = before.is_some_and(|before| off <= FAR && reached - before < SLOW);
            let behind = best.is_finite()
                && before.is_some_and(|before| {
                    let gain = reached - before;
                    gain.is_nan() || gain <= RATE * (best - reached)
                });
            if off > FAR {
                unknown = Some(found.clone());
            } else if sound.as_ref().is_none_or(|kept| value > kept.1) {
                sound = Some((found.clone(), value));
            }
            fit = Some(found);
            if last || stopped || behind || unfinished && slow && !accuracy.thorough {
                break;
            }
            last = unfinished && slow;
            if !unfinished {
                if off <= SUITS || local < LEAST {
                    break;
                }
                local /= FINER;
            } else if off > FAR {
                local = (local / FINER.sqrt()).max(LEAST);
            } else if off < SUITS {
                local = accuracy.local.min(2.0 * local);
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

    /// The same estimation from other paths of the states, which satisfy the equations with these values of the parameters.
    ///
    /// A regression on them would only return the values, also where every state is measured.
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
        let (regression, paths) = (self.regression.or(Some(false)), self.paths.or(Some(true)));
        Estimation { start, earlier, regression, paths, ..self.clone() }
    }
}

/// Returns the times at which a segment ends in any case: samples, and where inputs that are held jump.
fn fixed_times(run: &Experiment) -> Vec<f64> {
    let mut times = run.t.clone();
    times.extend(run.jumps());
    times.sort_by(f64::total_cmp);
    times
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
