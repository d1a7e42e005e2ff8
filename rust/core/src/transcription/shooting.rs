//! Single and multiple shooting (Eqs. oem_ivp, oem_ms) as nonlinear programs.

use std::cell::RefCell;
use std::ops::{Deref, Range};

use rayon::prelude::*;

use super::boundary::Boundary;
use super::disjoint::Disjoint;
use super::estimands::Estimands;
use super::flow::{Flow, Memory};
use super::group::Group;
use super::layout::{Layout, Place};
use super::objective::Objective;
use super::pieces::{
    Second, Uniforms, by_width, defects_of, gradient_of, hessian_of, integrate_group, jacobian_of, states_at,
    triangle,
};
use super::posed::Posed;
use super::steps::{Steps, Track};
use super::tableau::{Integrator, Tableau};
use super::transcribed::Transcribed;
use crate::condition::End;
use crate::error::Error;
use crate::experiment::Experiment;
use crate::mesh::Grid;
use crate::model::Model;
use crate::nlp::{Chain, Chains, Nlp, NotFinite, Reach, Structure};
use crate::noise::Noise;
use crate::tape::Tape;

/// How a problem is transcribed by shooting.
#[derive(Clone, Debug, PartialEq)]
pub struct Shots {
    /// Division into segments, one an experiment, or one for all. A single segment is single shooting.
    pub grid: Vec<Grid>,
    /// The Runge-Kutta method.
    pub integrator: Integrator,
    /// Its steps.
    pub steps: Steps,
    /// Threads; 0 for as many as there are cores.
    pub threads: usize,
    /// Whether each experiment has noise of its own.
    pub noise_per_experiment: bool,
}

impl Default for Shots {
    /// Single shooting with a step of RK4 from sample to sample.
    fn default() -> Self {
        Shots {
            grid: vec![Grid::Uniform(1)],
            integrator: Integrator::Rk4,
            steps: Steps::Samples(1),
            threads: 0,
            noise_per_experiment: false,
        }
    }
}

/// Shooting: −ℓ of an integrated path, to be minimised over θ and the states at the *nodes*, where segments start
/// (Eq. multiple_shooting_decision; the first states are unknowns too), such that each segment ends where the next
/// starts. The integration takes explicit steps of fixed length, so that the likelihood is smooth, and its derivatives
/// are those of the steps.
///
/// Nodes form [`Chains`], which the arrow factorisation serves; a single segment leaves no constraint at all.
///
/// ```
/// use phugoid::transcription::{Shots, Steps};
/// use phugoid::{Estimation, Experiment, Grid, Model, Parameter};
///
/// let mut m = Model::new("decay");
/// let (x, rate) = (m.state("x", "m")?, m.parameter(Parameter::new("rate", 0.1))?);
/// m.equation("x", -rate * &x, None)?;
/// m.output("x", x, "", None)?;
/// let t: Vec<f64> = (0..50).map(|k| 0.1 * k as f64).collect();
/// let x = t.iter().map(|t| (-0.7 * t).exp() + 1e-3 * (1e4 * t).sin()).collect();
/// let runs = [Experiment::new(&m, "run", t, [("x", x)])?];
///
/// // Five segments, steps of 0.07 s at most: samples lie within them.
/// let shots = Shots { grid: vec![Grid::Uniform(5)], steps: Steps::Length(0.07), ..Shots::default() };
/// let fit = Estimation::new(&m, &runs).shooting(shots).solve()?;
/// assert!((fit["rate"].value - 0.7).abs() < 4.0 * fit["rate"].std_error);
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Debug)]
pub struct Shooting {
    /// Parameters, functions, records: its fields are also found as the problem's own.
    pub posed: Posed,
    /// Where variables and constraints stand; its points are the nodes.
    pub layout: Layout,
    tableau: Tableau,
    tracks: Vec<Track>,
    /// Times of the nodes of each experiment.
    nodes: Vec<Vec<f64>>,
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
}

impl Deref for Shooting {
    type Target = Posed;

    fn deref(&self) -> &Posed {
        &self.posed
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
        let (posed, written) =
            Posed::new(model, experiments, noise, (settings.threads, settings.noise_per_experiment))?;
        let count = settings.grid.len();
        if count != 1 && count != experiments.len() {
            return Err(Error::Option(format!(
                "{count} grids for {} experiments; give one, or one each",
                experiments.len()
            )));
        }
        let grid = |e: usize| &settings.grid[e.min(count - 1)];
        let tracks = experiments.iter().enumerate();
        let tracks: Vec<Track> =
            tracks.map(|(e, x)| Track::new(x, grid(e), &settings.steps)).collect::<Result<_, _>>()?;
        let (n_theta, n_x) = (posed.parameters.len(), model.states.len());
        let layout =
            Layout::of_counts(n_theta, n_x, tracks.iter().map(|t| t.segments.len() + usize::from(ends)));
        let sampled = Layout::of_counts(n_theta, n_x, experiments.iter().map(|e| e.t.len()));
        let tableau = settings.integrator.tableau();
        let mut objective = Objective::default();
        let mut groups = Vec::new();
        for (e, (experiment, track)) in experiments.iter().zip(&tracks).enumerate() {
            let firsts = (layout.first_point[e], sampled.first_point[e]);
            groups.extend(Group::cut(e, experiment, track, &tableau, firsts, !ends));
            let all: Vec<usize> = (0..experiment.t.len()).collect();
            objective.add(&posed, &sampled, e, &all);
        }
        let of_ends = |(x, track): (&Experiment, &Track)| {
            let (first, last) = (x.t[0], x.t[x.t.len() - 1]);
            if ends { (track.segments.len(), [first, last]) } else { (0, [first; 2]) }
        };
        let places: Vec<_> = experiments.iter().zip(&tracks).map(of_ends).collect();
        let boundary = Boundary::new(model, written, experiments, &places, layout.m());
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
        };
        problem.place_derivatives();
        problem.chains = problem.find_chains();
        Ok(problem)
    }

    /// Lays out the sparse entries of the Jacobian and the Hessian: node by node, then between parameters.
    fn place_derivatives(&mut self) {
        let (n_x, n_theta) = (self.layout.n_x, self.layout.n_theta);
        for (e, nodes) in self.nodes.iter().enumerate() {
            let map = &self.posed.estimands.maps[e];
            for s in 0..nodes.len() {
                let x = self.layout.state(self.layout.first_point[e] + s);
                for r in 0..n_x {
                    (0..=r).for_each(|q| self.hessian_structure.push(x + r, x + q));
                    map.iter().for_each(|&p| self.hessian_structure.push(x + r, p));
                }
                if s + 1 < nodes.len() {
                    let row = (self.layout.first_row(e) + s) * n_x;
                    for r in 0..n_x {
                        self.jacobian_structure.push(row + r, x + n_x + r);
                        (0..n_x).for_each(|q| self.jacobian_structure.push(row + r, x + q));
                        let model = &map[..self.posed.n_seen()];
                        model.iter().for_each(|&p| self.jacobian_structure.push(row + r, p));
                    }
                }
            }
        }
        for r in 0..n_theta {
            (0..=r).for_each(|q| self.hessian_structure.push(r, q));
        }
        if let Some(boundary) = &mut self.boundary {
            let structures = (&mut self.jacobian_structure, &mut self.hessian_structure);
            boundary.place(&self.layout, &self.posed.estimands, structures);
        }
        // The objective's own: of samples, then dense between parameters.
        self.objective.place(&self.posed, &self.sampled, &mut self.sampled_hessian);
        let first = self.sampled_hessian.len();
        for r in 0..n_theta {
            (0..=r).for_each(|q| self.sampled_hessian.push(r, q));
        }
        self.objective.place_pairs(&self.posed, |(r, c)| first + triangle(r) + c);
    }

    fn find_chains(&self) -> Option<Chains> {
        let layout = &self.layout;
        let chain = |(e, nodes): (usize, &Vec<f64>)| Chain {
            variable: layout.state(layout.first_point[e]),
            row: layout.first_row(e) * layout.n_x,
            segments: nodes.len() - 1,
            points: 1,
            ties: Vec::new(),
            boundary: self.boundary.as_ref().map_or_else(Default::default, |b| b.of_chain(e)),
        };
        let chains: Vec<Chain> = self.nodes.iter().enumerate().map(chain).collect();
        // A chain of a single node is none; such programs are small.
        let all = chains.iter().all(|c| c.segments > 0);
        all.then_some(Chains { border: layout.n_theta, n_x: layout.n_x, chains })
    }

    pub(super) fn flow<'a>(&'a self, group: &'a Group) -> Flow<'a> {
        Flow { f: &self.posed.f, tableau: &self.tableau, group, n_p: self.posed.n_seen() }
    }

    fn uniforms_of(&self, tape: &Tape, xi: &[f64]) -> Uniforms {
        (0..self.posed.differing()).map(|e| self.posed.uniforms(tape, xi, e)).collect()
    }

    /// States of the nodes of a group.
    pub(super) fn start<'a>(&self, group: &Group, xi: &'a [f64]) -> &'a [f64] {
        &xi[self.layout.state(group.node)..][..group.n * self.layout.n_x]
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
        let run = |(group, part): (&Group, &mut [f64])| {
            MEMORY.with(|m| work(group, &mut m.borrow_mut(), &mut part[..width]))
        };
        let finite = if self.posed.n_threads() == 1 || self.groups.len() == 1 {
            self.groups.iter().zip(parts.chunks_exact_mut(step)).map(run).fold(true, |a, b| a & b)
        } else {
            let pairs = self.groups.par_iter().zip(parts.par_chunks_exact_mut(step));
            self.posed.install(|| pairs.map(run).reduce(|| true, |a, b| a & b))
        };
        self.groups.iter().zip(parts.chunks_exact(step)).for_each(|(g, part)| collect(g, &part[..width]));
        if finite { Ok(()) } else { Err(NotFinite) }
    }

    /// θ and the states at the samples.
    fn integrate(&self, xi: &[f64]) -> Result<Vec<f64>, NotFinite> {
        let mut zeta = vec![0.0; self.sampled.n()];
        zeta[..self.layout.n_theta].copy_from_slice(&xi[..self.layout.n_theta]);
        let out = Disjoint::new(&mut zeta);
        let uniforms = self.uniforms_of(&self.posed.f.value, xi);
        self.each(
            0,
            |group, m, _| by_width!(group, states_at(self, group, xi, &uniforms, m, &out)),
            |_, _| (),
        )?;
        Ok(zeta)
    }

    /// Uniform values of f and of ∂f.
    fn both(&self, xi: &[f64]) -> [Uniforms; 2] {
        [self.uniforms_of(&self.posed.f.value, xi), self.uniforms_of(&self.posed.f.jacobian, xi)]
    }

    /// Writes factor · ∇²φ, and with multipliers adds the constraints'.
    fn second(
        &self,
        xi: &[f64],
        factor: f64,
        lambda: Option<&[f64]>,
        out: &mut [f64],
    ) -> Result<(), NotFinite> {
        let zeta = self.integrate(xi)?;
        let mut sampled = vec![0.0; self.sampled_hessian.len()];
        self.objective.hessian(&self.posed, &self.sampled, lambda.is_some(), &zeta, factor, &mut sampled)?;
        let mut gradient = vec![0.0; zeta.len()];
        self.objective.gradient(&self.posed, &self.sampled, &zeta, &mut gradient)?;
        gradient.iter_mut().for_each(|g| *g *= factor);
        let between = sampled.len() - triangle(self.layout.n_theta);
        let (own, conditions) = out.split_at_mut(out.len() - self.boundary_entries());
        conditions.fill(0.0);
        let (stored, pairs) = own.split_at_mut(own.len() - triangle(self.layout.n_theta));
        // Nothing but constraints depends on a node at the end.
        stored.fill(0.0);
        pairs.copy_from_slice(&sampled[between..]);
        let job = Second {
            problem: self,
            xi,
            uniforms: self.both(xi),
            curvature: self.uniforms_of(&self.posed.f.hessian, xi),
            sampled: &sampled,
            gradient: &gradient,
            lambda,
            out: Disjoint::new(stored),
        };
        let n_seen = self.posed.estimands.maps[0].len();
        self.each(
            triangle(n_seen),
            |group, m, part| by_width!(group, hessian_of(&job, group, m, part)),
            |group, part| {
                let map = &self.posed.estimands.maps[group.experiment];
                for (r, i) in map.iter().enumerate() {
                    for (q, j) in map[..=r].iter().enumerate() {
                        pairs[triangle(*i.max(j)) + i.min(j)] += part[triangle(r) + q];
                    }
                }
            },
        )
    }

    /// Entries of the Hessian that are those of conditions on the ends, the last.
    fn boundary_entries(&self) -> usize {
        self.boundary.as_ref().map_or(0, Boundary::hessian_entries)
    }

    /// Evaluates what there is of conditions on the ends.
    fn at_ends(&self, work: impl FnOnce(&Boundary, (&Layout, &Estimands)) -> bool) -> Result<(), NotFinite> {
        let Some(boundary) = &self.boundary else { return Ok(()) };
        if work(boundary, (&self.layout, &self.posed.estimands)) { Ok(()) } else { Err(NotFinite) }
    }

    pub(super) fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// Integrates the segments of an experiment and hands each lane's states over: segment, states at the points
    /// (`[point·n_x + state]`), times of the points and inputs there (`[point][column]`).
    pub(super) fn shoot(&self, xi: &[f64], experiment: usize, mut see: impl FnMut(usize, Shot)) {
        let uniforms = self.uniforms_of(&self.posed.f.value, xi);
        let mut m = Memory::default();
        let mut segment = 0;
        for group in self.groups.iter().filter(|g| g.experiment == experiment) {
            by_width!(group, integrate_group(self, group, xi, &uniforms, &mut m));
            let (w, n_x, columns) = (group.width, self.layout.n_x, self.posed.f.n_data);
            for lane in 0..group.n {
                let own = |v: &[f64]| v.iter().skip(lane).step_by(w).copied().collect::<Vec<f64>>();
                let (x, data) = (own(&m.x), own(&group.data));
                see(segment, Shot { x, data, n_x, columns, stages: self.tableau.b.len() });
                segment += 1;
            }
        }
    }
}

/// One segment as integrated.
pub(super) struct Shot {
    pub(super) x: Vec<f64>,
    pub(super) data: Vec<f64>,
    pub(super) n_x: usize,
    pub(super) columns: usize,
    pub(super) stages: usize,
}

impl Shot {
    /// States at a point.
    pub(super) fn state(&self, point: usize) -> &[f64] {
        &self.x[point * self.n_x..][..self.n_x]
    }

    /// Time and inputs at a point.
    pub(super) fn data(&self, point: usize) -> &[f64] {
        &self.data[point * self.columns..][..self.columns]
    }
}

impl Nlp for Shooting {
    fn n(&self) -> usize {
        self.layout.n()
    }

    fn m(&self) -> usize {
        self.layout.m() + self.boundary.as_ref().map_or(0, Boundary::rows)
    }

    fn bounds(&self) -> (Vec<f64>, Vec<f64>) {
        self.bounds_of(self.n())
    }

    fn objective(&self, xi: &[f64]) -> Result<f64, NotFinite> {
        self.objective.value(&self.posed, &self.sampled, &self.integrate(xi)?)
    }

    fn gradient(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        let zeta = self.integrate(xi)?;
        let mut at_samples = vec![0.0; zeta.len()];
        self.objective.gradient(&self.posed, &self.sampled, &zeta, &mut at_samples)?;
        let (theta, states) = out.split_at_mut(self.layout.n_theta);
        theta.copy_from_slice(&at_samples[..self.layout.n_theta]);
        states.fill(0.0); // nothing depends on a node at the end
        let (shared, uniforms) = (Disjoint::new(states), self.both(xi));
        self.each(
            self.posed.estimands.maps[0].len(),
            |group, m, part| {
                by_width!(group, gradient_of(self, group, (xi, &at_samples), &uniforms, m, &shared, part))
            },
            |group, part| {
                let map = &self.posed.estimands.maps[group.experiment];
                map.iter().zip(part).for_each(|(&i, g)| theta[i] += g);
            },
        )
    }

    fn constraints(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.at_ends(|b, places| b.values(places, xi, out))?;
        if self.layout.m() == 0 {
            return Ok(());
        }
        let (out, uniforms) = (Disjoint::new(out), self.uniforms_of(&self.posed.f.value, xi));
        self.each(
            0,
            |group, m, _| by_width!(group, defects_of(self, group, xi, &uniforms, m, &out)),
            |_, _| (),
        )
    }

    fn jacobian_structure(&self) -> &Structure {
        &self.jacobian_structure
    }

    fn jacobian(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.at_ends(|b, places| b.jacobian(places, xi, out))?;
        if self.layout.m() == 0 {
            return Ok(());
        }
        let (out, uniforms) = (Disjoint::new(out), self.both(xi));
        self.each(
            0,
            |group, m, _| by_width!(group, jacobian_of(self, group, xi, &uniforms, m, &out)),
            |_, _| (),
        )
    }

    fn hessian_structure(&self) -> &Structure {
        &self.hessian_structure
    }

    fn hessian(&self, xi: &[f64], factor: f64, lambda: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.second(xi, factor, Some(lambda), out)?;
        self.at_ends(|b, places| b.hessian(places, xi, lambda, out))
    }

    fn gauss_newton(&self, xi: &[f64], factor: f64, out: &mut [f64]) -> Result<(), NotFinite> {
        self.second(xi, factor, None, out)
    }

    fn chains(&self) -> Option<&Chains> {
        self.chains.as_ref()
    }

    fn threads(&self) -> usize {
        self.pool.as_ref().map_or(0, rayon::ThreadPool::current_num_threads)
    }

    fn profiled(&self) -> Range<usize> {
        self.profiled_noise()
    }

    fn profile(&self, xi: &[f64], gradient: &[f64], reach: &Reach<'_>, out: &mut [f64]) -> f64 {
        self.profile_noise(xi, gradient, reach, out)
    }

    fn variable_name(&self, i: usize) -> String {
        match self.layout.place(i) {
            Place::Parameter(p) => self.parameter_name(p),
            Place::State { experiment, point, state } => {
                self.state_name(state, self.nodes[experiment][point], experiment)
            }
        }
    }

    fn constraint_name(&self, i: usize) -> String {
        if let Some(boundary) = self.boundary.as_ref().filter(|_| i >= self.layout.m()) {
            return boundary.name(i, &self.experiments);
        }
        let (e, row, state) = self.layout.constraint(i);
        let (t, name) = (self.nodes[e][row + 1], &self.state_names[state]);
        format!("continuity of {name} at t = {t} s of '{}'", self.experiments[e].name)
    }

    fn explain(&self, xi: &[f64]) -> Option<String> {
        self.why_not_finite(xi)
    }
}

impl Transcribed for Shooting {
    fn posed(&self) -> &Posed {
        &self.posed
    }

    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn boundary_states(&self) -> Vec<usize> {
        self.boundary.as_ref().map_or_else(Vec::new, Boundary::all_states)
    }

    fn point_times(&self, experiment: usize) -> &[f64] {
        &self.nodes[experiment]
    }

    fn states_at_samples(&self, xi: &[f64], experiment: usize) -> Vec<Vec<f64>> {
        let points = self.sampled.first_point[experiment]..self.sampled.first_point[experiment + 1];
        let zeta = self.integrate(xi);
        let path = |r: usize| {
            let at = |point: usize| zeta.as_ref().map_or(f64::NAN, |z| z[self.sampled.state(point) + r]);
            points.clone().map(at).collect()
        };
        (0..self.layout.n_x).map(path).collect()
    }

    fn outputs_at_samples(&self, xi: &[f64], experiment: usize) -> Vec<Vec<f64>> {
        match self.integrate(xi) {
            Ok(zeta) => self.objective.outputs(&self.posed, &self.sampled, &zeta, experiment),
            Err(NotFinite) => {
                let record = &self.experiments[experiment];
                vec![vec![f64::NAN; record.t.len()]; record.outputs.len()]
            }
        }
    }

    fn path(&self, xi: &[f64], experiment: usize) -> (Vec<f64>, Vec<Vec<f64>>) {
        let track = &self.tracks[experiment];
        let (mut times, mut path) = (Vec::new(), vec![Vec::new(); self.layout.n_x]);
        self.shoot(xi, experiment, |s, shot| {
            let ends = &track.segments[s];
            // Where segments meet, the later one's start.
            let n = ends.len() - usize::from(s + 1 < track.segments.len());
            times.extend(&ends[..n]);
            for i in 0..n {
                let x = shot.state(i * shot.stages);
                path.iter_mut().zip(x).for_each(|(path, x)| path.push(*x));
            }
        });
        (times, path)
    }
}
