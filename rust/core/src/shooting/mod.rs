//! Single and multiple shooting (Eqs. oem_ivp, oem_ms) as nonlinear programs.

mod entries;
mod explain;
mod pieces;
mod program;
mod shot;
mod shots;

use std::cell::RefCell;
use std::sync::{Arc, Mutex};

pub use crate::integrate::{Integrator, Steps};
pub use shots::Shots;

use crate::condition::End;
use crate::error::Error;
use crate::experiment::Experiment;
use crate::index::{ConstraintId, ExperimentId, IndexVec};
use crate::integrate::flow::{Flow, Memory};
use crate::integrate::group::{Group, Lane, Origin};
use crate::integrate::steps::Track;
use crate::integrate::tableau::Tableau;
use crate::interrupt::current;
use crate::mesh::Grid;
use crate::model::Model;
use crate::nlp::{Chain, Chains, NotFinite, Structure};
use crate::noise::Noise;
use crate::problem::boundary::Boundary;
use crate::problem::layout::Layout;
use crate::problem::objective::Objective;
use crate::problem::posed::{OfExperiment, Posed};
use crate::tape::{Pairs, Tape};
use crate::threads::prelude::*;
use pieces::Uniforms;

/// Shooting: −ℓ of an integrated path, to be minimised over θ and the states at the *nodes*, where segments start
/// (Eq. multiple_shooting_decision; the initial states are unknowns too), such that each segment ends where the next
/// starts. The integration takes explicit steps of fixed length, so that the likelihood is smooth, and its derivatives
/// are those of the steps.
///
/// Nodes form [`Chains`], which the arrow factorisation serves; a single segment leaves no constraint at all.
///
/// ```
/// use phugoid::shooting::{Shots, Steps};
/// use phugoid::{Estimation, Experiment, Grid, Model, Parameter};
///
/// let mut m = Model::new("decay");
/// let (x, rate) = (m.state("x", "m")?, m.parameter(Parameter::new("rate", 0.1))?);
/// m.equation("x", -rate * &x)?;
/// m.output("x", x, "")?;
/// let t: Vec<f64> = (0..50).map(|k| 0.1 * k as f64).collect();
/// let x = t.iter().map(|t| (-0.7 * t).exp() + 1e-3 * (1e4 * t).sin()).collect();
/// let runs = [Experiment::new(&m, "run", t, [("x", x)])?];
///
/// // Five segments, steps of 0.07 s at most: samples lie within them.
/// let shots = Shots::default().grid(vec![Grid::Uniform(5)]).steps(Steps::Length(0.07));
/// let fit = Estimation::new(&m, &runs).shooting(shots).solve()?;
/// assert!((fit["rate"].value - 0.7).abs() < 4.0 * fit["rate"].std_error);
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Debug)]
pub struct Shooting {
    /// Parameters, functions, records.
    pub posed: Posed,
    /// The places of variables and constraints; its points are the nodes.
    pub layout: Layout,
    tableau: Tableau,
    tracks: IndexVec<ExperimentId, Track>,
    /// Times of the nodes of each experiment.
    nodes: IndexVec<ExperimentId, Vec<f64>>,
    groups: Vec<Group>,
    /// φ as a function of θ and x at the samples, with their places in a vector of these.
    pub(super) objective: Objective,
    pub(super) sampled: Layout,
    sampled_hessian: Structure,
    jacobian_structure: Structure,
    hessian_structure: Structure,
    chains: Option<Chains>,
    /// Conditions on the ends of records.
    boundary: Option<Boundary>,
    /// The variables that were integrated last, and what `integrate` gave for them.
    latest: Mutex<Option<Latest>>,
}

/// Variables, and θ with the states at the samples.
type Latest = (Vec<f64>, Arc<Vec<f64>>);

impl OfExperiment for Group {
    fn experiment(&self) -> ExperimentId {
        self.experiment
    }
}

thread_local! {
    static MEMORY: RefCell<Memory> = RefCell::default();
}

impl Shooting {
    /// Transcribes a problem.
    ///
    /// # Errors
    /// When the model is incomplete, the data do not fit it, or an option is out of range.
    pub fn new(
        model: &Model,
        experiments: &[Experiment],
        noise: Noise,
        settings: &Shots,
    ) -> Result<Self, Error> {
        // Conditions on the end of a record need a node there.
        let ends = model.conditions.iter().any(|c| c.end != End::Initial);
        let (posed, written) = Posed::new(
            model,
            experiments,
            noise,
            settings.threads,
            settings.noise_per_experiment,
            Pairs::Kept,
        )?;
        let grids = Grid::for_each(&settings.grid, experiments.len())?;
        let tracks = experiments.iter().zip(grids).map(|(x, grid)| Track::new(x, grid, &settings.steps));
        let tracks: IndexVec<ExperimentId, Track> = tracks.collect::<Result<_, _>>()?;
        let (n_theta, n_x) = (posed.parameters.len(), model.states.len());
        let layout =
            Layout::of_counts(n_theta, n_x, tracks.iter().map(|t| t.segments.len() + usize::from(ends)));
        let sampled = Layout::of_counts(n_theta, n_x, experiments.iter().map(|e| e.t.len()));
        let tableau = settings.integrator.tableau();
        let mut objective = Objective::default();
        let mut groups = Vec::new();
        for (experiment, (e, track)) in experiments.iter().zip(tracks.numbered()) {
            let (node, sample) = (layout.first_point[e], sampled.first_point[e]);
            let origin = Origin { experiment: e, node, sample, last: !ends };
            let width = Group::width(track.segments.len());
            groups.extend(Group::cut(origin, experiment, track, &tableau, width));
            let all: Vec<usize> = (0..experiment.t.len()).collect();
            objective.add(&posed, &sampled, e, &all);
        }
        let of_ends = |(x, track): (&Experiment, &Track)| {
            let (first, last) = (x.t[0], x.t[x.t.len() - 1]);
            if ends { (track.segments.len(), [first, last]) } else { (0, [first; 2]) }
        };
        let places: Vec<_> = experiments.iter().zip(&tracks).map(of_ends).collect();
        let boundary = Boundary::new(model, written, experiments, &places, ConstraintId(layout.m()))?;
        let nodes = |(x, track): (&Experiment, &Track)| {
            let mut nodes = track.starts();
            nodes.extend(ends.then_some(x.t[x.t.len() - 1]));
            nodes
        };
        let mut problem = Shooting {
            boundary,
            posed,
            layout,
            tableau,
            nodes: experiments.iter().zip(&tracks).map(nodes).collect(),
            tracks,
            groups,
            objective,
            sampled,
            sampled_hessian: Structure::default(),
            jacobian_structure: Structure::default(),
            hessian_structure: Structure::default(),
            chains: None,
            latest: Mutex::default(),
        };
        problem.place_derivatives();
        problem.chains = problem.find_chains();
        Ok(problem)
    }

    fn find_chains(&self) -> Option<Chains> {
        let layout = &self.layout;
        let chain = |(e, nodes): (ExperimentId, &Vec<f64>)| Chain {
            variable: layout.state(layout.first_point[e]),
            row: layout.constraint_of(layout.first_row(e)),
            segments: nodes.len() - 1,
            points: 1,
            ties: Vec::new(),
            boundary: self.boundary.as_ref().map_or_else(Default::default, |b| b.of_chain(e)),
        };
        let chains: Vec<Chain> = self.nodes.numbered().map(chain).collect();
        // A chain of a single node is none; such programs are small.
        let all = chains.iter().all(|c| c.segments > 0);
        all.then_some(Chains { border: layout.n_theta, n_x: layout.n_x, chains })
    }

    pub(super) fn flow<'a>(&'a self, group: &'a Group) -> Flow<'a> {
        Flow { f: &self.posed.f, tableau: &self.tableau, group, n_p: self.posed.n_seen() }
    }

    fn uniforms_of(&self, tape: &Tape, xi: &[f64]) -> Uniforms {
        let experiments = (0..self.posed.differing()).map(ExperimentId);
        experiments.map(|e| self.posed.uniforms(tape, xi, e)).collect()
    }

    /// States of the nodes of a group.
    pub(super) fn start<'a>(&self, group: &Group, xi: &'a [f64]) -> &'a [f64] {
        &xi[self.layout.state(group.node).0..][..group.n * self.layout.n_x]
    }

    /// The vector constraint at the end of a segment.
    fn row(&self, group: &Group, lane: Lane) -> usize {
        group.node_of(lane).0 - group.experiment.0
    }

    /// Runs `work` on every group with `width` zeros to add to, in parallel; then `collect` on those, in their order.
    /// Whether all work was finite.
    fn each(
        &self,
        width: usize,
        work: impl Fn(&Group, &mut Memory, &mut [f64]) -> bool + Sync,
        mut collect: impl FnMut(&Group, &[f64]),
    ) -> Result<(), NotFinite> {
        let step = width.max(1);
        let mut parts = vec![0.0; self.groups.len() * step];
        let interrupt = current();
        let run = |(group, part): (&Group, &mut [f64])| {
            let own = || MEMORY.with(|m| work(group, &mut m.borrow_mut(), &mut part[..width]));
            // What was not finished is taken for not finite; whoever set the interrupt knows.
            !interrupt.stops() && interrupt.run(own)
        };
        let finite = if self.posed.n_threads() == 1 || self.groups.len() == 1 {
            self.groups.iter().zip(parts.chunks_exact_mut(step)).map(run).fold(true, |a, b| a & b)
        } else {
            let pairs = self.groups.par_iter().zip(parts.par_chunks_exact_mut(step));
            self.posed.install(|| pairs.map(run).all(|fine| fine))
        };
        self.groups.iter().zip(parts.chunks_exact(step)).for_each(|(g, part)| collect(g, &part[..width]));
        if finite { Ok(()) } else { Err(NotFinite) }
    }
}
