//! Mesh refinement: segments are divided, or the order raised, until the integration error is small.

use std::sync::Arc;

use super::fit::{Estimate, Fit};
use super::integration::{COARSE_MESH, IntegrationError};
use super::print::short;
use super::run::Watch;
use super::{Estimation, Transcription};
use crate::collocation::Settings;
use crate::error::Error;
use crate::experiment::Experiment;
use crate::interpolate::Interpolation;
use crate::interrupt::{Cause, current};
use crate::mesh::Grid;
use crate::solver::{Control, Settings as Solving, Status};

const PASSES: usize = 10;
/// The order is raised, one by one, while more than this part of the segments is too coarse, and while that helps.
const MANY: f64 = 0.5;
const HIGHEST: usize = 6;
const HELP: f64 = 4.0;
/// A division aims at this part of the tolerance, in no more pieces than these.
const AIM: f64 = 0.5;
const PIECES: usize = 8;
const POINTS: usize = 2_000_000;
/// A mesh without a solution is divided so often, each segment in so many parts, and the first in so many times less.
const DIVISIONS: usize = 3;
const PARTS: usize = 4;
const GRADES: i32 = 3;
/// From the path on a coarser mesh, which is near, the fit to that of half its segments takes few iterations; and
/// log-likelihoods that differ by more are reported.
const ITERATIONS: usize = 20;
const DIFFERENT: f64 = 1.0;
const UNKNOWNS: usize = 100_000;
/// Times closer than this part of a segment are the same.
const SAME: f64 = 1e-6;
const UNKNOWN: &str = "converged on this mesh, but there was no time left to see whether it is fine enough; allow more \
                       time, or go on from here";

/// One pass of a refinement: the transcription, and how exact it was.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RefinementStep {
    /// Points of a segment.
    pub order: usize,
    /// Number of segments in all experiments.
    pub segments: usize,
    /// Largest integration error of a segment, in units of [`IntegrationError::scales`].
    pub largest: f64,
    /// Number of segments above the tolerance.
    pub coarse: usize,
    /// Iterations of the solver.
    pub iterations: usize,
    /// At the end.
    pub log_likelihood: f64,
}

/// The passes of a refined estimation, the first as asked for, the last the one that the fit holds.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Refinement {
    /// Of the integration error of a segment, in units of the noise.
    pub tolerance: f64,
    /// The passes.
    pub steps: Vec<RefinementStep>,
    /// Estimates of the first pass.
    pub first: Vec<Estimate>,
}

impl Refinement {
    /// Whether the tolerance was met in the end.
    pub fn met(&self) -> bool {
        self.steps.last().is_some_and(|step| step.coarse == 0)
    }
}

impl Estimation<'_> {
    /// Estimates on a mesh that is fine enough.
    ///
    /// A first mesh on which the equations have no solution is divided, three times at most. Ends where the tolerance is
    /// met, after 10 passes, or with a pass that does not converge. Without a pass that was finished there is no
    /// [`Fit::refinement`].
    pub(super) fn solve_by_refinement(&self, tolerance: f64, watch: &mut Watch<'_>) -> Result<Fit, Error> {
        let plain = Estimation { refine: None, ..self.clone() };
        let mut fit = plain.solve_on_mesh(watch)?;
        let first = fit.parameters.clone();
        for _ in 0..DIVISIONS {
            // A mesh on which a fit nearby lies is not too coarse for the equations, and kinks are smoothed instead.
            if fit.feasible || fit.status.was_stopped() || self.goes_on() || self.smooths() {
                break;
            }
            // On too coarse a mesh the equations may have no solution.
            let order = order_of(&fit);
            let grid = fit.records.iter().map(|r| Grid::Edges(graded(&r.mesh_t, order))).collect();
            fit = plain.on_grid(order, grid).solve_on_mesh(watch)?;
        }
        let mut steps: Vec<RefinementStep> = Vec::new();
        let mut raised: Option<f64> = None; // largest error before the order was raised last
        let mut raising = true;
        loop {
            if !fit.status.was_stopped() && current().cause() == Some(Cause::TimeLimit) {
                (fit.status, fit.message) = (Status::TimeLimit, UNKNOWN.into());
            }
            if fit.status.was_stopped() {
                break; // no time to see how exact it is
            }
            let found = fit.integration_error(self.experiments)?;
            let worst: Vec<f64> = found.iter().flat_map(IntegrationError::worst).collect();
            let order = order_of(&fit);
            let step = RefinementStep {
                order,
                segments: worst.len(),
                largest: worst.iter().copied().fold(0.0, f64::max),
                coarse: worst.iter().filter(|w| **w > tolerance).count(),
                iterations: fit.iterations,
                log_likelihood: fit.log_likelihood,
            };
            steps.push(step);
            let points = step.segments * (order - 1);
            if step.coarse == 0 || steps.len() > PASSES || points > POINTS || fit.status != Status::Converged
            {
                break;
            }
            if self.smooths() && fit.kinks_matter(self.experiments) {
                break;
            }
            let own = fit.moved.as_ref().map_or(self.experiments, |moved| &moved.experiments);
            raising &= raised.is_none_or(|before| step.largest < before / HELP) && !bent(own, &found);
            let more = raising && step.coarse as f64 > MANY * step.segments as f64 && order < HIGHEST;
            let edges = |(e, run): (&IntegrationError, &Experiment)| {
                let edges = if more { e.edges.clone() } else { divided(e, run, order, tolerance) };
                Grid::Edges(edges)
            };
            let grid = found.iter().zip(own).map(edges).collect();
            raised = more.then_some(step.largest);
            fit = plain.on_grid(order + usize::from(more), grid).going_on_from(&fit).solve_on_mesh(watch)?;
        }
        if !steps.is_empty() {
            fit.refinement = Some(Refinement { tolerance, steps, first });
        }
        Ok(fit)
    }

    /// Warns where the fit on a mesh of segments half as long has another log-likelihood: errors that are small beside the
    /// noise in each segment add up in states that are integrals, such as a position.
    ///
    /// Compared are fits that converged on a mesh of the usual order as it was given, and whose path shows that it may be so.
    pub(super) fn compare_with_halves(&self, fit: &mut Fit) -> Result<(), Error> {
        let plain =
            self.transcription.is_collocation() && self.model.delays.is_empty() && self.own_solver.is_none();
        let done = fit.refinement.is_some() || fit.smoothing.is_some() || !fit.warnings.is_empty();
        let order = order_of(fit);
        if self.asks_for_few_iterations()
            || !plain
            || done
            || order == 2
            || fit.status != Status::Converged
            || current().stops()
        {
            return Ok(());
        }
        // Who fits so much has no memory for twice as much.
        let unknowns: usize =
            fit.records.iter().map(|r| r.mesh_t.len()).sum::<usize>() * self.model.states.len();
        if unknowns > UNKNOWNS
            || !fit.may_accumulate_error(self.experiments)
            || self.smooths() && fit.kinks_matter(self.experiments)
        {
            return Ok(());
        }
        let grid = fit.records.iter().map(|r| halved(&r.mesh_t, order)).collect();
        let solver = Solving { max_iterations: ITERATIONS, ..self.solver.clone() };
        let finer = Estimation { solver, ..self.on_grid(order, grid).going_on_from(fit) };
        let finer = finer.solve_on_mesh(&mut |_| Control::Continue)?;
        if finer.status == Status::Converged && (finer.log_likelihood - fit.log_likelihood).abs() > DIFFERENT
        {
            fit.warnings.push(format!(
                "{COARSE_MESH}: with segments half as long the log-likelihood is {}, and not {}, for errors of the integration \
                 add up along the records: the option refine of the collocation divides the mesh as needed",
                short(finer.log_likelihood, 6),
                short(fit.log_likelihood, 6)
            ));
        }
        Ok(())
    }

    /// The same estimation on another mesh.
    pub(super) fn on_grid(&self, order: usize, grid: Vec<Grid>) -> Self {
        let settings = Settings { order, grid, ..self.transcription.collocation() };
        Estimation { transcription: settings.into(), moving_mesh: Some(false), ..self.clone() }
    }

    /// The same estimation from the end of a fit of this problem on another mesh: no regression is needed, as the path is
    /// there.
    pub(super) fn going_on_from(&self, fit: &Fit) -> Self {
        let earlier = Some(Arc::new(fit.into()));
        Estimation { start: Vec::new(), earlier, regression: Some(false), ..self.clone() }
    }
}

/// Points of a segment of a fit by collocation.
pub(super) fn order_of(fit: &Fit) -> usize {
    match &fit.transcription {
        Transcription::Collocation(settings) => settings.order,
        Transcription::Shooting(_) => 2,
    }
}

/// Returns the segment ends of the points of a mesh.
fn ends_of(mesh: &[f64], order: usize) -> Vec<f64> {
    mesh.iter().copied().step_by(order - 1).collect()
}

/// Returns the grid with every segment of a mesh cut into two.
pub(super) fn halved(mesh: &[f64], order: usize) -> Grid {
    Grid::Edges(in_parts(&ends_of(mesh, order), 2))
}

/// Returns segment ends with every segment divided into equal parts.
pub(super) fn in_parts(ends: &[f64], parts: usize) -> Vec<f64> {
    let inner = |w: &[f64]| {
        let (a, b) = (w[0], w[1]);
        (0..parts).map(move |k| a + (b - a) * (k as f64 / parts as f64)).collect::<Vec<f64>>()
    };
    ends.windows(2).flat_map(inner).chain(ends.last().copied()).collect()
}

/// Returns segment ends with every segment of a mesh cut into four, those at the beginning, where there may be transients,
/// into more.
fn graded(mesh: &[f64], order: usize) -> Vec<f64> {
    let finer = in_parts(&ends_of(mesh, order), PARTS);
    let first = |k: i32| finer[0] + (finer[1] - finer[0]) * (PARTS as f64).powi(-k);
    let graded = (1..=GRADES).rev().map(first);
    finer[..1].iter().copied().chain(graded).chain(finer[1..].iter().copied()).collect()
}

/// Returns segment ends, with every segment that is too coarse divided as the order of the method asks for.
fn divided(found: &IntegrationError, run: &Experiment, order: usize, tolerance: f64) -> Vec<f64> {
    let bends = run.input_times();
    let mut ends = vec![found.edges[0]];
    for (w, error) in found.edges.windows(2).zip(found.worst()) {
        if error > tolerance {
            let pieces = (error / (AIM * tolerance)).powf(1.0 / (order + 1) as f64).ceil();
            ends.extend(between(w[0], w[1], (pieces.min(PIECES as f64) as usize).max(2), &bends));
        }
        ends.push(w[1]);
    }
    ends
}

/// Whether inputs bend inside a segment, so that a higher order would be lost there.
fn bent(experiments: &[Experiment], found: &[IntegrationError]) -> bool {
    experiments.iter().zip(found).any(|(run, error)| {
        let linear = (0..run.inputs.len()).filter(|&c| run.kind(c) == Interpolation::Linear);
        let times = linear.flat_map(|c| {
            let signal = run.signal(c);
            signal.t.iter().map(|t| t + signal.delay).collect::<Vec<f64>>()
        });
        let shortest = error.edges.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        let (first, last) = (run.t[0], run.t[run.t.len() - 1]);
        times.filter(|t| (first..=last).contains(t)).any(|t| {
            let after = error.edges.partition_point(|e| *e < t);
            let near = |k: usize| error.edges.get(k).map_or(f64::INFINITY, |e| (e - t).abs());
            near(after).min(near(after.wrapping_sub(1))) > SAME * shortest
        })
    })
}

/// Where to cut: at samples, where inputs bend, as long as there are any inside.
fn between(a: f64, b: f64, pieces: usize, bends: &[f64]) -> Vec<f64> {
    let mut cuts: Vec<f64> = (1..pieces).map(|k| a + (b - a) * k as f64 / pieces as f64).collect();
    let slack = SAME * (b - a);
    let inside: Vec<f64> = bends.iter().copied().filter(|t| a + slack < *t && *t < b - slack).collect();
    if !inside.is_empty() {
        let nearest = |cut: &f64| {
            let off = |t: &f64| (t - cut).abs();
            inside.iter().copied().min_by(|s, t| off(s).total_cmp(&off(t))).expect("there is one")
        };
        cuts = cuts.iter().map(nearest).collect();
        cuts.dedup();
    }
    cuts
}
