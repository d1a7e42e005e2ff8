//! The collocation problem (Eq. oem_coll) as a nonlinear program.

mod chunk;
mod defects;
mod explain;
mod program;

use std::collections::BTreeMap;
use std::sync::OnceLock;

use crate::condition::End;
use crate::error::Error;
use crate::experiment::Experiment;
use crate::index::{ConstraintId, ExperimentId, IndexVec, VariableId};
use crate::mesh::{Grid, Mesh};
use crate::model::Model;
use crate::nlp::{Chains, NotFinite, Structure};
use crate::noise::Noise;
use crate::problem::boundary::{Boundary, Places};
use crate::problem::layout::Layout;
use crate::problem::objective::{Objective, place_pair};
use crate::problem::posed::{OfExperiment, Posed};
use crate::setters::setters;
use crate::tape::Pairs;
use crate::threads::prelude::*;
use chunk::Chunk;
pub use chunk::segments_in_chunk;
use defects::Dynamics;

/// The options of a transcription by collocation.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// Points of a segment, m: 2 is the trapezoid.
    pub order: usize,
    /// Division into segments, one an experiment, or one for all.
    pub grid: Vec<Grid>,
    /// Threads; 0 for as many as there are cores.
    pub threads: usize,
    /// Whether each experiment has noise of its own.
    pub noise_per_experiment: bool,
}

impl Default for Settings {
    /// Order 4, one segment between samples.
    fn default() -> Self {
        Settings { order: 4, grid: vec![Grid::Samples(1)], threads: 0, noise_per_experiment: false }
    }
}

impl Settings {
    setters! { order: usize, grid: Vec<Grid>, threads: usize, noise_per_experiment: bool; }
}

/// The collocation problem: −ℓ(θ, x) to be minimised under the defects. It is an [`Nlp`](crate::nlp::Nlp): any
/// optimiser that takes sparse derivatives can solve it. [`Estimation`](crate::Estimation) makes one with a point
/// to start from, [`Estimation::transcribe`](crate::Estimation::transcribe).
///
/// ```
/// use phugoid::nlp::{ConstraintId, Named, Nlp, VariableId};
/// use phugoid::noise::Noise;
/// use phugoid::collocation::{Collocation, Settings};
/// use phugoid::{Experiment, Grid, Model, Parameter, Sigma};
///
/// let mut m = Model::new("ramp");
/// let (x, slope) = (m.state("x", "m")?, m.parameter(Parameter::new("slope", 0.0))?);
/// m.equation("x", slope)?;
/// m.output("x", x, "")?;
/// let run = Experiment::new(&m, "run", vec![0.0, 1.0, 2.0], [("x", vec![1.0, 3.1, 5.0])])?;
///
/// let noise = Noise::Gaussian(vec![Sigma::Known(0.1)]);
/// let settings = Settings::default().order(2).grid(vec![Grid::Samples(1)]).threads(1);
/// let problem = Collocation::new(&m, &[run], noise, &settings)?;
/// assert_eq!((problem.n(), problem.m()), (4, 2)); // the slope and x at three points; two defects
/// assert_eq!(problem.variable_name(VariableId(2)), "x at t = 1 of 'run'");
/// assert_eq!(problem.constraint_name(ConstraintId(0)), "defect of x ending at t = 1 of 'run'");
///
/// let xi = [2.0, 1.0, 3.0, 5.0]; // slope 2 from 1 on: the equation holds, one residual is 0.1
/// let mut defects = [f64::NAN; 2];
/// problem.constraints(&xi, &mut defects).unwrap();
/// assert_eq!(defects, [0.0, 0.0]);
/// let minus_log_likelihood = 0.5 + 3.0 * 0.1f64.ln(); // ½ Σ (r/σ)² + N ln σ
/// assert!((problem.objective(&xi).unwrap() - minus_log_likelihood).abs() < 1e-12);
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Debug)]
pub struct Collocation {
    /// Parameters, functions, records.
    pub posed: Posed,
    /// The places of variables and constraints.
    pub layout: Layout,
    /// One mesh an experiment.
    pub meshes: IndexVec<ExperimentId, Mesh>,
    /// Inputs at all points of each experiment: `inputs[experiment][channel][point]`. Where an input jumps between
    /// two segments, it is the mean of both sides.
    pub inputs: IndexVec<ExperimentId, Vec<Vec<f64>>>,
    dynamics: Dynamics,
    chunks: Vec<Chunk>,
    objective: Objective,
    /// Laid out when it is first asked for: in long records it takes longer than all else here.
    jacobian_structure: OnceLock<Structure>,
    hessian_structure: Structure,
    /// Places of the Hessian entries between parameters for each pair of f: one list an experiment; a single one
    /// where they do not differ. They are the last entries, from the first.
    pairs: IndexVec<ExperimentId, Vec<usize>>,
    first_pair: usize,
    chains: Chains,
    pub(super) boundary: Option<Boundary>,
}

impl OfExperiment for Chunk {
    fn experiment(&self) -> ExperimentId {
        self.experiment
    }
}

impl Collocation {
    /// Transcribes a problem.
    ///
    /// # Errors
    /// When the model is incomplete, the data do not fit it, or an option is out of range.
    pub fn new(
        model: &Model,
        experiments: &[Experiment],
        noise: Noise,
        settings: &Settings,
    ) -> Result<Self, Error> {
        let (posed, written) = Posed::new(
            model,
            experiments,
            noise,
            settings.threads,
            settings.noise_per_experiment,
            Pairs::Summed,
        )?;
        let problem = Self::laid_out(posed, settings)?;
        let ends = |mesh: &Mesh| (mesh.n_mesh - 1, [mesh.times[0], mesh.times[mesh.n_mesh - 1]]);
        let ends: Vec<_> = problem.meshes.iter().map(ends).collect();
        let boundary = Boundary::new(model, written, experiments, &ends, ConstraintId(problem.layout.m()))?;
        Ok(problem.with_derivatives(boundary))
    }

    /// Transcribes the problem of another experiment with the functions that are compiled for this one's; `None` where they
    /// do not serve ([`Posed::of_another`]), or where there are conditions on the ends of records.
    ///
    /// # Errors
    /// When the data do not fit the model.
    pub(crate) fn of_another(
        &self,
        experiment: &Experiment,
        settings: &Settings,
    ) -> Result<Option<Self>, Error> {
        if self.boundary.is_some() {
            return Ok(None);
        }
        let Some(posed) = self.posed.of_another(experiment)? else { return Ok(None) };
        Ok(Some(Self::laid_out(posed, settings)?.with_derivatives(None)))
    }

    /// The meshes of a problem, its variables and its data.
    fn laid_out(posed: Posed, settings: &Settings) -> Result<Self, Error> {
        let meshes = meshes(posed.experiments.as_slice(), settings)?;
        let layout = Layout::new(posed.parameters.len(), posed.state_names.len(), &meshes);
        let mut problem = Collocation {
            layout,
            meshes,
            inputs: IndexVec::default(),
            dynamics: Dynamics::new(posed.f.clone()),
            posed,
            chunks: Vec::new(),
            objective: Objective::default(),
            jacobian_structure: OnceLock::new(),
            hessian_structure: Structure::default(),
            pairs: IndexVec::default(),
            first_pair: 0,
            chains: Chains::default(),
            boundary: None,
        };
        problem.place_data();
        Ok(problem)
    }

    /// The same with the places of derivatives, and conditions on the ends of records.
    fn with_derivatives(mut self, boundary: Option<Boundary>) -> Self {
        self.boundary = boundary;
        self.place_derivatives();
        self.chains = self.layout.chains(&self.meshes);
        if let Some(boundary) = &self.boundary {
            for (e, chain) in self.chains.chains.iter_mut().enumerate() {
                chain.boundary = boundary.of_chain(ExperimentId(e));
            }
        }
        self
    }

    /// Fills chunks and blocks of samples with data in the order of their lanes.
    fn place_data(&mut self) {
        for ((e, experiment), mesh) in self.posed.experiments.numbered().zip(&self.meshes) {
            let channels = || 0..experiment.inputs.len();
            let mut inputs: Vec<Vec<f64>> = channels().map(|c| experiment.input(c, &mesh.times)).collect();
            let held: Vec<Option<Vec<f64>>> = channels().map(|c| held_values(experiment, c, mesh)).collect();
            let first = self.layout.first_point[e];
            let mut chunks = Chunk::cut(e, mesh, &self.layout);
            let firsts = chunks.iter().scan(0, |next, chunk| {
                *next += chunk.segments();
                Some(*next - chunk.segments())
            });
            let firsts: Vec<usize> = firsts.collect();
            let fill = |(chunk, &segment): (&mut Chunk, &usize)| {
                let at_points = |column: &[f64]| {
                    chunk.points.iter().map(|&p| column[p as usize - first.0]).collect::<Vec<_>>()
                };
                let mut data = at_points(&mesh.times);
                for (column, held) in inputs.iter().zip(&held) {
                    match held {
                        Some(of) => data.extend(chunk.segment_of_lanes().map(|s| of[segment + s])),
                        None => data.extend(at_points(column)),
                    }
                }
                chunk.data = data;
            };
            self.posed.install(|| chunks.par_iter_mut().zip(&firsts).for_each(fill));
            self.chunks.extend(chunks);
            for (column, of) in inputs.iter_mut().zip(&held).filter_map(|(c, h)| Some((c, h.as_ref()?))) {
                for (s, segment) in mesh.segments.iter().enumerate() {
                    column[segment.point..segment.point + mesh.rule.order()].fill(of[s]);
                    column[segment.point] = 0.5 * (of[s.saturating_sub(1)] + of[s]);
                }
            }
            self.objective.add(&self.posed, &self.layout, e, &mesh.sample_points);
            self.inputs.push(inputs);
        }
    }

    /// Finds the places of the sparse entries of the Jacobian and the Hessian.
    fn place_derivatives(&mut self) {
        let (dynamics, layout, maps) = (&self.dynamics, &self.layout, &self.posed.estimands.maps);
        let (chunks, map) = (&self.chunks, |chunk: &Chunk| &maps[chunk.experiment]);
        let threads = &self.posed.threads;
        let entries: Vec<usize> = chunks.iter().map(|c| dynamics.jacobian_entries(c)).collect();
        let each = dynamics.hessian_entries();
        let own: Vec<usize> = chunks.iter().map(|c| each * c.n_own()).collect();
        let room = self.objective.hessian_entries(&self.posed) + dynamics.parameter_pairs().count() + 64;
        let hessian = self.hessian_structure.add_parts(threads, (&own, room), |i, part| {
            dynamics.hessian_structure(&chunks[i], layout, map(&chunks[i]), part);
        });
        let mut first = 0;
        for (i, chunk) in self.chunks.iter_mut().enumerate() {
            (chunk.jacobian, chunk.jacobian_entries, chunk.hessian) = (first, entries[i], hessian[i]);
            first += entries[i];
        }
        self.objective.place(&self.posed, &self.layout, &mut self.hessian_structure);
        let mut places: BTreeMap<[VariableId; 2], usize> = BTreeMap::new();
        self.first_pair = self.hessian_structure.len();
        let structure = &mut self.hessian_structure;
        let mut place = |r: VariableId, c: VariableId| {
            *places.entry([r, c]).or_insert_with(|| {
                structure.push(r.0, c.0);
                structure.len() - 1
            })
        };
        for map in self.posed.maps() {
            let mut place = |(r, c)| place_pair(map, r, c, &mut place);
            self.pairs.push(self.dynamics.parameter_pairs().map(&mut place).collect());
        }
        self.objective.place_pairs(&self.posed, place);
        let mut jacobian = self.boundary.is_some().then(|| self.jacobian_of_defects());
        if let (Some(boundary), Some(jacobian)) = (&mut self.boundary, &mut jacobian) {
            let structures = (jacobian, &mut self.hessian_structure);
            boundary.place(&self.layout, &self.posed.estimands, structures);
        }
        self.jacobian_structure = jacobian.map_or_else(OnceLock::new, OnceLock::from);
    }

    /// Lays out the entries of the Jacobian of the defects.
    fn jacobian_of_defects(&self) -> Structure {
        let mut structure = Structure::default();
        let entries: Vec<usize> = self.chunks.iter().map(|c| c.jacobian_entries).collect();
        structure.add_parts(&self.posed.threads, (&entries, 0), |i, part| {
            let chunk = &self.chunks[i];
            let map = &self.posed.estimands.maps[chunk.experiment];
            self.dynamics.jacobian_structure(chunk, &self.layout, map, part);
        });
        structure
    }

    fn dynamics_job<'a>(&'a self, chunk: &'a Chunk, xi: &'a [f64], uniforms: &'a [f64]) -> defects::Job<'a> {
        defects::Job { dynamics: &self.dynamics, layout: &self.layout, chunk, xi, uniforms }
    }

    /// The chunks of an experiment.
    fn chunks_of(&self, experiment: ExperimentId) -> impl Iterator<Item = &Chunk> {
        self.chunks.iter().filter(move |c| c.experiment == experiment)
    }

    /// Whether anything is said of states at the last samples.
    pub fn has_conditions_at_ends(&self) -> bool {
        self.boundary.as_ref().is_some_and(|b| b.conditions.iter().any(|c| c.end != End::Initial))
    }

    /// Evaluates what there is of boundary conditions.
    fn at_ends(&self, work: impl FnOnce(&Boundary, Places<'_>) -> bool) -> Result<(), NotFinite> {
        Boundary::evaluate(self.boundary.as_ref(), (&self.layout, &self.posed.estimands), work)
    }

    /// The change of all constraints when slopes b are added to f: `−h Σ_j C[j,k] b_j` (Eq. oem_coll_cxdot).
    /// `slopes` holds n_x values for each mesh point, those of all experiments after each other; conditions on the
    /// ends of records do not change.
    pub fn forced(&self, slopes: &[f64], out: &mut [f64]) {
        let n_x = self.layout.n_x;
        out.fill(0.0);
        let mut first = 0; // mesh point of the experiment
        for (e, mesh) in self.meshes.numbered() {
            let (k, row) = (mesh.rule.order() - 1, self.layout.first_row(e));
            let b = |point: usize, r: usize| slopes[(first + point) * n_x + r];
            for segment in &mesh.segments {
                for i in 0..k {
                    for (r, c) in out[(row + segment.point + i) * n_x..][..n_x].iter_mut().enumerate() {
                        let integral: f64 =
                            (0..=k).map(|j| mesh.rule.c(j, i) * b(segment.point + j, r)).sum();
                        *c = -segment.h * integral;
                    }
                }
            }
            for tie in &mesh.between {
                let point = mesh.segments[tie.segment].point;
                for (r, c) in out[(row + tie.point - 1) * n_x..][..n_x].iter_mut().enumerate() {
                    *c = -tie.weights.iter().enumerate().map(|(j, w)| w * b(point + j, r)).sum::<f64>();
                }
            }
            first += mesh.n_mesh;
        }
    }

    /// Model outputs at the samples of an experiment: `[output][sample]`.
    pub fn outputs_at_samples(&self, xi: &[f64], experiment: ExperimentId) -> Vec<Vec<f64>> {
        self.objective.outputs(&self.posed, &self.layout, xi, experiment)
    }
}

/// The value of an input in each segment of a mesh; `None` for one that is not held between its samples.
fn held_values(experiment: &Experiment, channel: usize, mesh: &Mesh) -> Option<Vec<f64>> {
    if !experiment.is_held(channel) {
        return None;
    }
    let begins: Vec<f64> = mesh.segments.iter().map(|s| s.t).collect();
    let ends = begins[1..].iter().copied().chain([mesh.times[mesh.n_mesh - 1]]);
    let spans: Vec<[f64; 2]> = begins.iter().copied().zip(ends).map(|(a, b)| [a, b]).collect();
    Some(experiment.input_over(channel, &begins, &spans))
}

fn meshes(experiments: &[Experiment], settings: &Settings) -> Result<IndexVec<ExperimentId, Mesh>, Error> {
    let grids = Grid::for_each(&settings.grid, experiments.len())?;
    experiments.iter().zip(grids).map(|(x, grid)| Mesh::of(settings.order, grid, x)).collect()
}
