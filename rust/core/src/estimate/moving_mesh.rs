//! Estimation on meshes that follow the motion of the estimates.

use std::time::Duration;

use super::accuracy::Accuracy;
use super::fit::Fit;
use super::motion::{FAR, SUITS, Simulated, Values, fixed_times};
use super::refine::{halved, order_of};
use super::run::Watch;
use super::{Estimation, Path, Record};
use crate::error::{Error, ErrorKind};
use crate::experiment::Experiment;
use crate::interrupt::current;
use crate::mesh::Grid;
use crate::solver::{Control, Status};

/// Iterations on one mesh before it is moved, and how often it is. The last mesh has no limit of its own.
const ITERATIONS: usize = 25;
const MOVES: usize = 8;
/// Divides the local error of the segments where an end does not suit; its square root does so during a run.
const FINER: f64 = 16.0;
/// Limits the local error from below.
const LEAST: f64 = 1e-9;
/// Limits how often a mesh is divided where the model cannot be simulated with what it led to.
const DIVISIONS: usize = 3;
/// On one mesh after another, a run ends where a mesh brings less than this in log-likelihood; in the last run, the mesh then
/// stays.
const SLOW: f64 = 0.01;
/// A mesh that loses more than this in log-likelihood has led astray, and so often at most.
const LOST: f64 = 1.0;
const ASTRAY: usize = 2;
/// A run behind the best goes on where a mesh brings this part of what is missing.
const RATE: f64 = 0.1;

impl Estimation<'_> {
    /// Estimates on meshes that follow the motion: segments along a simulation with the parameters as they are.
    ///
    /// Few samples say nothing of where a mesh must be fine, and a path that starts as a solution of the equations can be
    /// kept one. Where a mesh leads away from solutions, or to a lower likelihood, the run goes on from the
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
        MovingMesh::new(self, values, best, accuracy).run(watch)
    }
}

/// An estimation on one mesh after another.
struct MovingMesh<'a, 'b> {
    estimation: &'a Estimation<'b>,
    accuracy: Accuracy,
    /// The log-likelihood that is to be reached.
    best: f64,
    /// The local error that segments may have now.
    local: f64,
    /// The parameters as they are, and simulations with them, if there are any.
    at: Values,
    runs: Option<Vec<Simulated>>,
    fit: Option<Fit>,
    /// The best end so far whose likelihood is known, and minus its objective.
    sound: Option<(Fit, f64)>,
    /// An end whose path is none: the next mesh tells its likelihood.
    unknown: Option<Fit>,
    /// Returns whether this mesh is the last one, which has no limit of its own.
    last: bool,
    divisions: usize,
    astray: usize,
    iterations: usize,
    time: Duration,
}

/// The end on one mesh.
struct Pass {
    found: Fit,
    /// Returns whether the mesh begins with a much lower likelihood than the best end so far.
    lost: bool,
    /// Returns whether the time is over, or the user has stopped it.
    stopped: bool,
    /// How far its outputs are from those of the integration.
    off: f64,
}

impl<'a, 'b> MovingMesh<'a, 'b> {
    fn new(estimation: &'a Estimation<'b>, values: &Values, best: f64, accuracy: Accuracy) -> Self {
        MovingMesh {
            estimation,
            accuracy,
            best,
            local: accuracy.local,
            at: values.clone(),
            runs: estimation.simulated(values, accuracy.tolerance),
            fit: None,
            sound: None,
            unknown: None,
            last: false,
            divisions: 0,
            astray: 0,
            iterations: 0,
            time: Duration::ZERO,
        }
    }

    fn run(mut self, watch: &mut Watch<'_>) -> Result<Option<Fit>, Error> {
        for number in 0..=MOVES {
            self.last |= number == MOVES;
            let Some((grid, paths)) = self.next_mesh() else { break };
            let before = self.fit.as_ref().map(|fit| fit.log_likelihood);
            let Some(pass) = self.solve_on(grid, paths, watch)? else { break };
            let goes_on = if self.leads_astray(&pass) { self.go_back(pass) } else { self.take(pass, before) };
            if !goes_on {
                break;
            }
        }
        let (iterations, time) = (self.iterations, self.time);
        Ok(self.fit.map(|mut fit| {
            (fit.iterations, fit.solution.time) = (iterations, time);
            fit
        }))
    }

    /// Returns the next mesh of each experiment, and the paths on it; none where there is no mesh to move to.
    fn next_mesh(&mut self) -> Option<(Vec<Grid>, Vec<Path>)> {
        let order = self.estimation.transcription.collocation().order;
        if let Some(runs) = self.runs.take() {
            let one = |(run, found): (&Experiment, Simulated)| {
                let edges = found.motion.segments(order, self.local, &fixed_times(run));
                let (times, states) = found.motion.on_mesh(order, &edges);
                (Grid::Edges(edges), self.estimation.named(times, states))
            };
            return Some(self.estimation.experiments.iter().zip(runs).map(one).unzip());
        }
        self.unknown = None;
        // A path across a pole of the solution is one of a mesh that is too coarse.
        let fit = self.fit.as_ref().filter(|fit| self.divisions < DIVISIONS && fit.feasible)?;
        self.divisions += 1;
        let one = |r: &Record| {
            let path = self.estimation.named(r.mesh_t.clone(), r.mesh_states.clone());
            (halved(&r.mesh_t, order_of(fit)), path)
        };
        Some(fit.records.iter().map(one).unzip())
    }

    /// Solves on a mesh from the paths on it. None where there are no finite derivatives.
    fn solve_on(
        &mut self,
        grid: Vec<Grid>,
        paths: Vec<Path>,
        watch: &mut Watch<'_>,
    ) -> Result<Option<Pass>, Error> {
        let order = self.estimation.transcription.collocation().order;
        let mut pass = self.estimation.on_grid(order, grid).along_paths(paths, &self.at);
        if !self.last {
            pass.solver.max_iterations = pass.solver.max_iterations.min(ITERATIONS);
        }
        // A run begins with a path of the parameters with which the last one ended, on a mesh that suits them.
        let (mut begins, mut lost) = (None, false);
        let least = self.sound.as_ref().map_or(f64::NEG_INFINITY, |kept| kept.1 - LOST);
        let found = pass.solve_passes(&mut |line| {
            begins.get_or_insert(-line.objective);
            lost = self.unknown.is_some() && begins.is_some_and(|l| l < least);
            if lost { Control::Stop } else { watch(line) }
        });
        let found = match found {
            Err(e) if e.kind() == ErrorKind::Evaluation => return Ok(None),
            found => found?,
        };
        self.iterations += found.iterations;
        self.time += found.solution.time;
        if let (Some(before), Some(l)) = (self.unknown.take(), begins.filter(|_| !lost))
            && self.sound.as_ref().is_none_or(|kept| l > kept.1)
        {
            self.sound = Some((before, l));
        }
        let stopped = found.status.was_stopped() && !lost;
        self.at = self.estimation.values_of(&found);
        self.runs = if lost || stopped && self.sound.is_none() { None } else { self.simulated() };
        let off = self.runs.as_ref().map_or(f64::INFINITY, |runs| found.departure(runs));
        Ok(Some(Pass { found, lost, stopped, off }))
    }

    fn simulated(&self) -> Option<Vec<Simulated>> {
        self.estimation.simulated(&self.at, self.accuracy.tolerance)
    }

    /// Returns whether a mesh has led away from solutions, or to a lower likelihood than the best end so far has.
    fn leads_astray(&self, pass: &Pass) -> bool {
        let Some((_, kept)) = &self.sound else { return false };
        let Pass { found, lost, stopped, off } = pass;
        // Where the time is over, no other mesh follows that could confirm this one.
        let behind_when_cut = || {
            let integrated = self.estimation.integrated_log_likelihood(found).unwrap_or(f64::NEG_INFINITY);
            *off > FAR && (integrated.is_nan() || integrated < *kept)
        };
        *lost
            || !found.feasible
            || *off <= FAR && -found.solution.objective < kept - LOST
            || *stopped && behind_when_cut()
    }

    /// Goes back to the best end so far, for a finer mesh; whether the run goes on.
    fn go_back(&mut self, pass: Pass) -> bool {
        let Some((kept, _)) = &self.sound else { return false };
        let mut back = kept.clone();
        self.at = self.estimation.values_of(&back);
        self.astray += 1;
        if pass.stopped {
            (back.status, back.message) = (pass.found.status, pass.found.message);
        }
        self.fit = Some(back);
        if self.last || pass.stopped || current().stops() || self.astray > ASTRAY {
            return false;
        }
        self.runs = self.simulated();
        self.local = (self.local / FINER).max(LEAST);
        true
    }

    /// Takes an end, and sets the local error of the next mesh; whether the run goes on. `before`: the log-likelihood of the
    /// mesh before.
    fn take(&mut self, pass: Pass, before: Option<f64>) -> bool {
        let Pass { found, stopped, off, .. } = pass;
        let (reached, value) = (found.log_likelihood, -found.solution.objective);
        let is_unfinished =
            matches!(found.status, Status::IterationLimit | Status::Infeasible | Status::Diverging);
        let slow = before.is_some_and(|before| off <= FAR && reached - before < SLOW);
        let behind = self.best.is_finite()
            && before.is_some_and(|before| {
                let gain = reached - before;
                gain.is_nan() || gain <= RATE * (self.best - reached)
            });
        if off > FAR {
            self.unknown = Some(found.clone());
        } else if self.sound.as_ref().is_none_or(|kept| value > kept.1) {
            self.sound = Some((found.clone(), value));
        }
        self.fit = Some(found);
        if self.last || stopped || behind || is_unfinished && slow && !self.accuracy.thorough {
            return false;
        }
        self.last = is_unfinished && slow;
        if !is_unfinished {
            if off <= SUITS || self.local < LEAST {
                return false;
            }
            self.local /= FINER;
        } else if off > FAR {
            self.local = (self.local / FINER.sqrt()).max(LEAST);
        } else if off < SUITS {
            self.local = self.accuracy.local.min(2.0 * self.local);
        }
        true
    }
}
