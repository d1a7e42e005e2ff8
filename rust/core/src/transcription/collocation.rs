//! The collocation problem (Eq. oem_coll) as a nonlinear program.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;

use super::boundary::{Boundary, Symbols};
use super::chunk::Chunk;
use super::defects::{self, Dynamics};
use super::disjoint::Disjoint;
use super::estimands::Estimands;
use super::layout::{Layout, Place};
use super::likelihood;
use super::samples::Samples;
use crate::condition::Condition;
use crate::error::Error;
use crate::experiment::Experiment;
use crate::expr::graph::{Graph, Id};
use crate::mesh::{Grid, Mesh};
use crate::model::{Compiled, Model, Parameter};
use crate::nlp::{self, Chains, Nlp, NotFinite, Reach, Structure};
use crate::noise::{Counts, Missing, Noise, Reported, Sample};
use crate::tape::{Arguments, Function, Tape, Workspace};
use crate::transform::Transform;

/// How a problem is transcribed.
#[derive(Clone, Debug, PartialEq)]
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

/// The collocation problem: −ℓ(θ, x) to be minimised under the defects. It is an [`Nlp`]: any optimiser that
/// takes sparse derivatives can solve it. [`Estimation`](crate::Estimation) makes one with a point to start
/// from, [`Estimation::transcribe`](crate::Estimation::transcribe).
///
/// ```
/// use phugoid::nlp::Nlp;
/// use phugoid::noise::Noise;
/// use phugoid::transcription::{Collocation, Settings};
/// use phugoid::{Experiment, Grid, Model, Parameter, Sigma};
///
/// let mut m = Model::new("ramp");
/// let (x, slope) = (m.state("x", "m")?, m.parameter(Parameter::new("slope", 0.0))?);
/// m.equation("x", slope, None)?;
/// m.output("x", x, "", None)?;
/// let run = Experiment::new(&m, "run", vec![0.0, 1.0, 2.0], [("x", vec![1.0, 3.1, 5.0])])?;
///
/// let noise = Noise::Gaussian(vec![Sigma::Known(0.1)]);
/// let settings = Settings { order: 2, grid: vec![Grid::Samples(1)], threads: 1, ..Settings::default() };
/// let problem = Collocation::new(&m, &[run], noise, &settings)?;
/// assert_eq!((problem.n(), problem.m()), (4, 2)); // the slope and x at three points; two defects
/// assert_eq!(problem.variable_name(2), "x at t = 1 s of 'run'");
/// assert_eq!(problem.constraint_name(0), "defect of x ending at t = 1 s of 'run'");
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
    /// Where variables and constraints stand.
    pub layout: Layout,
    /// The parameters that are variables: the model's (local ones once an experiment), then the noise's.
    pub parameters: Vec<Parameter>,
    /// Number of variables that are parameters of the model.
    pub n_model_parameters: usize,
    /// Which variable is which parameter of which experiment.
    pub estimands: Estimands,
    /// The noise model.
    pub noise: Noise,
    /// What its parameters are called as unknowns.
    pub(super) noise_names: Vec<String>,
    /// One mesh an experiment.
    pub meshes: Vec<Mesh>,
    /// Inputs at all points of each experiment: `inputs[experiment][channel][point]`.
    pub inputs: Vec<Vec<Vec<f64>>>,
    pub(super) model_names: Vec<String>,
    pub(super) state_names: Vec<String>,
    pub(super) input_names: Vec<String>,
    output_names: Vec<String>,
    pub(super) experiments: Vec<Experiment>,
    pub(super) dynamics: Dynamics,
    likelihood: Function,
    pub(super) outputs: Function,
    chunks: Vec<Chunk>,
    samples: Vec<Samples>,
    jacobian_structure: Structure,
    hessian_structure: Structure,
    /// Where the Hessian entries between parameters stand, for each pair of f, of ℓ and each prior.
    pair_places: PairPlaces,
    chains: Chains,
    boundary: Option<Boundary>,
    /// How many measurements there are, of all experiments or of each where each has noise of its own.
    counts: Vec<Counts>,
    pool: Option<rayon::ThreadPool>,
}

#[derive(Clone, Debug, Default)]
struct PairPlaces {
    /// The first of them; they are the last entries.
    first: usize,
    /// One list an experiment; a single one where they do not differ.
    dynamics: Vec<Vec<usize>>,
    likelihood: Vec<Vec<usize>>,
    priors: Vec<(usize, usize)>,
}

/// Work smaller than this many blocks is done by the calling thread: waking others costs more.
const PARALLEL_BLOCKS: usize = 24;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
    static BUFFERS: Cell<Buffers> = Cell::default();
}

/// What a call needs beside.
#[derive(Default)]
struct Buffers {
    /// Parameters of an experiment.
    theta: Vec<f64>,
    /// Uniform values of a tape, one experiment after the other, and those of one.
    uniforms: Vec<f64>,
    one: Vec<f64>,
    /// Sums of each item.
    parts: Vec<f64>,
}

/// What a thread needs to evaluate a block.
#[derive(Default)]
struct Scratch {
    workspace: Workspace,
    weights: Vec<f64>,
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
        let compiled = model.compile()?;
        let output_names: Vec<&str> = model.outputs.iter().map(|o| o.name.as_str()).collect();
        let input_names: Vec<&str> = model.inputs.iter().map(|o| o.name.as_str()).collect();
        if experiments.is_empty() {
            return Err(Error::Data("no experiment was given; at least one is needed".into()));
        }
        experiments.iter().try_for_each(|e| e.check(&input_names, &output_names))?;
        noise.check(&output_names)?;
        let meshes = meshes(experiments, settings)?;

        let counts = Counts::new(experiments.iter().map(|e| &e.outputs));
        let missing = Missing::new(experiments.iter().map(|e| &e.outputs));
        let noise = noise.for_data(&counts, &missing)?;
        let noise_parameters = noise.parameters(&output_names);
        let n_model = model.parameters.len();
        let local = settings.noise_per_experiment && experiments.len() > 1;
        let noise_parameters = noise_parameters.into_iter().map(|p| Parameter { local, ..p });
        let seen: Vec<Parameter> = model.parameters.iter().cloned().chain(noise_parameters).collect();
        let (estimands, parameters) = Estimands::new(&seen, experiments);
        let n_model_parameters = estimands.parameter.iter().filter(|&&p| p < n_model).count();
        let layout = Layout::new(parameters.len(), model.states.len(), &meshes);
        let noise_names = noise.variable_names(&output_names);

        // All functions of a point see all parameters, so that θ has one order everywhere.
        let mut graph = compiled.graph.clone();
        let noise_symbols: Vec<Id> = noise_names.iter().map(|name| graph.symbol(name)).collect();
        let (variables, compiled) = in_variables(&mut graph, &seen[..n_model], compiled);
        let theta: Vec<Id> = variables.iter().chain(&noise_symbols).copied().collect();
        let arguments =
            Arguments { data: compiled.data.clone(), states: compiled.states.clone(), parameters: theta };
        let dynamics = Dynamics::new(Function::new(graph.clone(), &arguments, compiled.dynamics.clone()));
        let outputs = Function::new(graph.clone(), &arguments, compiled.outputs.clone());

        let measured: Vec<Id> = output_names.iter().map(|n| graph.symbol(&format!("measured {n}"))).collect();
        let present: Vec<Option<Id>> = (output_names.iter().zip(&missing.outputs))
            .map(|(name, &any)| any.then(|| graph.symbol(&format!("{name} present"))))
            .collect();
        let patterns: Vec<(Vec<bool>, Id)> = (missing.patterns.iter().enumerate())
            .filter(|_| noise.needs_patterns())
            .map(|(k, set)| (set.clone(), graph.symbol(&format!("pattern {k} of missing samples"))))
            .collect();
        let sample = Sample {
            outputs: &compiled.outputs,
            measured: &measured,
            present: &present,
            patterns: &patterns,
        };
        let terms = noise.log_density(&mut graph, &sample, &noise_symbols);
        let mut with_samples = arguments.clone();
        let flags = present.iter().flatten().chain(patterns.iter().map(|p| &p.1));
        with_samples.data.extend(measured.iter().chain(flags));

        let boundary = (!model.conditions.is_empty()).then(|| {
            let place = |c: &Condition| model.states.iter().position(|s| s.name == c.state);
            let states = model.conditions.iter().filter_map(place).collect();
            let symbols =
                Symbols { data: &compiled.data, states: &compiled.states, theta: &arguments.parameters };
            let conditions = (&model.conditions[..], &compiled.conditions[..], states);
            Boundary::new(graph.clone(), &symbols, conditions, experiments, &meshes, layout.m())
        });
        let likelihood = Function::of_terms(graph, &with_samples, &terms);

        let mut problem = Collocation {
            layout,
            n_model_parameters,
            parameters,
            estimands,
            noise,
            noise_names,
            meshes,
            inputs: Vec::new(),
            model_names: model.parameters.iter().map(|p| p.name.clone()).collect(),
            state_names: model.states.iter().map(|s| s.name.clone()).collect(),
            input_names: model.inputs.iter().map(|s| s.name.clone()).collect(),
            output_names: model.outputs.iter().map(|o| o.name.clone()).collect(),
            experiments: experiments.to_vec(),
            dynamics,
            likelihood,
            outputs,
            chunks: Vec::new(),
            samples: Vec::new(),
            jacobian_structure: Structure::default(),
            hessian_structure: Structure::default(),
            pair_places: PairPlaces::default(),
            chains: Chains::default(),
            boundary,
            counts: if local {
                experiments.iter().map(|e| Counts::new([&e.outputs].into_iter())).collect()
            } else {
                vec![counts]
            },
            pool: pool(settings.threads)?,
        };
        problem.place_data(&missing, patterns.len());
        problem.place_derivatives();
        problem.chains = problem.layout.chains(&problem.meshes);
        if let Some(boundary) = &problem.boundary {
            for (e, chain) in problem.chains.chains.iter_mut().enumerate() {
                chain.boundary = nlp::Boundary { row: boundary.row(e), states: boundary.states.clone() };
            }
        }
        Ok(problem)
    }

    /// Fills chunks and blocks of samples with data in the order of their lanes.
    fn place_data(&mut self, missing: &Missing, patterns: usize) {
        for (e, (experiment, mesh)) in self.experiments.iter().zip(&self.meshes).enumerate() {
            let channels = 0..experiment.inputs.len();
            let inputs: Vec<Vec<f64>> = channels.clone().map(|c| experiment.input(c, &mesh.times)).collect();
            let first = self.layout.first_point[e] as u32;
            for mut chunk in Chunk::cut(e, mesh, &self.layout) {
                for column in std::iter::once(&mesh.times).chain(&inputs) {
                    chunk.data.extend(chunk.points.iter().map(|&p| column[(p - first) as usize]));
                }
                self.chunks.push(chunk);
            }
            let mut columns = vec![experiment.t.clone()];
            columns.extend(channels.map(|c| experiment.input(c, &experiment.t)));
            let filled = |c: &Vec<f64>| c.iter().map(|v| if v.is_nan() { 0.0 } else { *v }).collect();
            columns.extend(experiment.outputs.iter().map(filled));
            columns.extend(missing.flags(&experiment.outputs, patterns));
            self.samples.extend(Samples::cut(e, mesh, &self.layout, &columns));
            self.inputs.push(inputs);
        }
    }

    /// Lays out the sparse entries of the Jacobian and the Hessian.
    fn place_derivatives(&mut self) {
        for chunk in &mut self.chunks {
            chunk.jacobian = self.jacobian_structure.len();
            let map = &self.estimands.maps[chunk.experiment];
            self.dynamics.jacobian_structure(chunk, &self.layout, map, &mut self.jacobian_structure);
            chunk.jacobian_entries = self.jacobian_structure.len() - chunk.jacobian;
            chunk.hessian = self.hessian_structure.len();
            self.dynamics.hessian_structure(chunk, &self.layout, map, &mut self.hessian_structure);
        }
        for samples in &mut self.samples {
            samples.hessian = self.hessian_structure.len();
            likelihood::hessian_structure(
                &self.likelihood,
                samples,
                &self.layout,
                &self.estimands.maps[samples.experiment],
                &mut self.hessian_structure,
            );
        }
        let n_x = self.layout.n_x;
        let mut places: BTreeMap<(usize, usize), usize> = BTreeMap::new();
        self.pair_places.first = self.hessian_structure.len();
        let structure = &mut self.hessian_structure;
        let mut place = |pair: (usize, usize)| {
            *places.entry(pair).or_insert_with(|| {
                structure.push(pair.0, pair.1);
                structure.len() - 1
            })
        };
        let differ = if self.estimands.any_local() { self.estimands.maps.len() } else { 1 };
        for map in &self.estimands.maps[..differ] {
            // Variables of different experiments stand in another order than the parameters they are.
            let mut place = |r: usize, c: usize| place((map[r].max(map[c]), map[r].min(map[c])));
            let pairs = self.dynamics.parameter_pairs().map(|(r, c)| place(r, c));
            self.pair_places.dynamics.push(pairs.collect());
            let likelihood = self.likelihood.hessian_pattern.iter().filter(|(_, c)| *c >= n_x);
            self.pair_places.likelihood.push(likelihood.map(|(r, c)| place(r - n_x, c - n_x)).collect());
        }
        let with_prior = (0..self.parameters.len()).filter(|&i| self.parameters[i].prior.is_some());
        self.pair_places.priors = with_prior.map(|i| (i, place((i, i)))).collect();
        if let Some(boundary) = &mut self.boundary {
            let structures = (&mut self.jacobian_structure, &mut self.hessian_structure);
            boundary.place(&self.layout, &self.meshes, &self.estimands, structures);
        }
    }

    fn uniforms(&self, tape: &Tape, xi: &[f64], experiment: usize) -> Vec<f64> {
        let (mut theta, mut out) = (Vec::new(), Vec::new());
        self.estimands.theta(experiment, xi, &mut theta);
        tape.uniforms(&theta, &mut out);
        out
    }

    /// Runs `work` on every item, in parallel where it pays, with the uniform values of a tape and `width`
    /// zeros to add to; then `collect` on those, in the order of items. Whether all work was finite.
    fn each<T: OfExperiment + Sync>(
        &self,
        items: &[T],
        (tape, xi): (&Tape, &[f64]),
        width: usize,
        work: impl Fn(&T, &[f64], &mut Scratch, &mut [f64]) -> bool + Sync,
        mut collect: impl FnMut(usize, &[f64]),
    ) -> Result<(), NotFinite> {
        // Taken and put back: nothing is allocated after the first call.
        let Buffers { mut theta, mut uniforms, mut one, mut parts } = BUFFERS.take();
        let differ = if self.estimands.any_local() { self.estimands.maps.len() } else { 1 };
        uniforms.clear();
        for e in 0..differ {
            self.estimands.theta(e, xi, &mut theta);
            tape.uniforms(&theta, &mut one);
            uniforms.extend_from_slice(&one);
        }
        let (length, of) = (one.len(), |item: &T| if differ > 1 { item.experiment() } else { 0 });
        // Each item has a part, an empty one too.
        let step = width.max(1);
        parts.clear();
        parts.resize(items.len() * step, 0.0);
        let run = |(item, part): (&T, &mut [f64])| {
            let uniforms = &uniforms[of(item) * length..][..length];
            SCRATCH.with(|s| work(item, uniforms, &mut s.borrow_mut(), &mut part[..width]))
        };
        let threads = self
            .pool
            .as_ref()
            .map_or_else(rayon::current_num_threads, rayon::ThreadPool::current_num_threads);
        let finite = if threads == 1 || items.len() < PARALLEL_BLOCKS {
            items.iter().zip(parts.chunks_exact_mut(step)).map(run).fold(true, |a, b| a & b)
        } else {
            let pairs = items.par_iter().zip(parts.par_chunks_exact_mut(step));
            let all = || pairs.with_min_len(8).map(run).reduce(|| true, |a, b| a & b);
            match &self.pool {
                Some(pool) => pool.install(all),
                None => all(),
            }
        };
        items.iter().zip(parts.chunks_exact(step)).for_each(|(item, part)| collect(of(item), &part[..width]));
        BUFFERS.set(Buffers { theta, uniforms, one, parts });
        if finite { Ok(()) } else { Err(NotFinite) }
    }

    fn dynamics_job<'a>(&'a self, chunk: &'a Chunk, xi: &'a [f64], uniforms: &'a [f64]) -> defects::Job<'a> {
        defects::Job { dynamics: &self.dynamics, layout: &self.layout, chunk, xi, uniforms }
    }

    fn sample_job<'a>(
        &'a self,
        samples: &'a Samples,
        xi: &'a [f64],
        uniforms: &'a [f64],
    ) -> likelihood::Job<'a> {
        likelihood::Job { likelihood: &self.likelihood, layout: &self.layout, samples, xi, uniforms }
    }

    /// For each prior its variable, and the value's distance from the mean in standard deviations with its
    /// first two derivatives.
    fn priors<'a>(&'a self, xi: &'a [f64]) -> impl Iterator<Item = (usize, [f64; 3])> + 'a {
        self.parameters.iter().enumerate().filter_map(move |(i, p)| {
            let ((mean, std), transform) = (p.prior?, self.estimands.transforms[i]);
            let value = transform.value(xi[i]) - mean;
            Some((i, [value, transform.slope(xi[i]), transform.bend(xi[i])].map(|v| v / std)))
        })
    }

    /// Evaluates what there is of boundary conditions.
    fn at_ends(
        &self,
        work: impl FnOnce(&Boundary, (&Layout, &[Mesh], &Estimands)) -> bool,
    ) -> Result<(), NotFinite> {
        let Some(boundary) = &self.boundary else { return Ok(()) };
        if work(boundary, (&self.layout, &self.meshes, &self.estimands)) { Ok(()) } else { Err(NotFinite) }
    }

    /// What priors add to φ.
    pub fn prior_terms(&self, xi: &[f64]) -> f64 {
        self.priors(xi).map(|(_, [e, ..])| 0.5 * e * e).sum()
    }

    /// What the noise is at ξ, in the user's terms.
    pub fn noise_report(&self, xi: &[f64]) -> Vec<Reported> {
        let outputs: Vec<&str> = self.output_names.iter().map(String::as_str).collect();
        let k = self.layout.n_theta - self.n_model_parameters;
        let mut found = Vec::new();
        for (e, map) in self.noise_maps() {
            let own: Vec<f64> = map.iter().map(|&i| xi[i]).collect();
            for mut r in self.noise.report(&outputs, &own) {
                // Gradients with respect to the noise of all experiments.
                let mut gradient = vec![0.0; k];
                map.iter().zip(&r.gradient).for_each(|(&i, g)| gradient[i - self.n_model_parameters] = *g);
                r.gradient = gradient;
                r.bounded_by = r.bounded_by.map(|b| map[b] - self.n_model_parameters);
                if let Some(e) = e {
                    r.name = format!("{}[{}]", r.name, self.experiments[e].name);
                }
                found.push(r);
            }
        }
        found
    }

    /// The variables of the noise, once or for each experiment that has noise of its own.
    fn noise_maps(&self) -> impl Iterator<Item = (Option<usize>, &[usize])> {
        let local = self.counts.len() > 1;
        let n_model = self.model_names.len();
        (0..self.counts.len()).map(move |e| (local.then_some(e), &self.estimands.maps[e][n_model..]))
    }

    /// Scales of the outputs, the least of all experiments.
    pub fn sigmas(&self, xi: &[f64]) -> Vec<f64> {
        let of = |map: &[usize]| {
            let own: Vec<f64> = map.iter().map(|&i| xi[i]).collect();
            self.noise.sigmas(&own)
        };
        let least = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(&b).map(|(a, b)| a.min(*b)).collect();
        self.noise_maps().map(|(_, map)| of(map)).reduce(least).unwrap_or_default()
    }

    /// Variables that are 1/σ of an output, given others where noise is correlated.
    pub fn precision_roots(&self) -> Vec<usize> {
        let roots = self.noise.precision_roots();
        self.noise_maps().flat_map(|(_, map)| roots.iter().map(|&k| map[k])).collect()
    }

    /// Model outputs at the samples of an experiment: `[output][sample]`.
    pub fn outputs_at_samples(&self, xi: &[f64], experiment: usize) -> Vec<Vec<f64>> {
        let tape = &self.outputs.value;
        let uniforms = self.uniforms(tape, xi, experiment);
        let mut out = vec![Vec::new(); tape.outputs.len()];
        let mut workspace = Workspace::default();
        for block in self.samples.iter().filter(|s| s.experiment == experiment) {
            let n = block.points.len();
            let registers = workspace.registers(tape, n);
            let n_data = self.outputs.n_data * n;
            registers[..n_data].copy_from_slice(&block.data[..n_data]);
            defects::gather(xi, &self.layout, &block.points, &mut registers[n_data..]);
            tape.run(registers, &uniforms, n);
            for (channel, operand) in out.iter_mut().zip(&tape.outputs) {
                let value = tape.read(*operand, registers, &uniforms, n);
                channel.extend((0..block.n).map(|l| value.at(l)));
            }
        }
        out
    }

    /// Instructions of the tapes (f, ∂f, ∂²f, ℓ, ∂ℓ, ∂²ℓ): a count that does not depend on the machine.
    pub fn instructions(&self) -> [usize; 6] {
        let (f, l) = (&self.dynamics.f, &self.likelihood);
        [&f.value, &f.jacobian, &f.hessian, &l.value, &l.jacobian, &l.hessian].map(Tape::instructions)
    }

    /// Adds factor · ∇²φ, or what a tape takes for it, to the entries of samples, parameters and priors.
    fn objective_hessian(
        &self,
        tape: &Tape,
        exact: bool,
        xi: &[f64],
        factor: f64,
        out: &mut [f64],
    ) -> Result<(), NotFinite> {
        // Entries of samples are written, those between parameters summed, at other places.
        let (stored, between) = out.split_at_mut(self.pair_places.first);
        let shared = Disjoint::new(stored);
        let pairs = &self.pair_places.likelihood;
        let finite = self.each(
            &self.samples,
            (tape, xi),
            pairs[0].len(),
            |s, uniforms, scratch, part| {
                let job = self.sample_job(s, xi, uniforms);
                job.hessian(tape, &mut scratch.workspace, factor, &shared, part)
            },
            |e, part| add(between, self.pair_places.first, &pairs[e], part),
        );
        for ((_, [e, slope, bend]), &(_, at)) in self.priors(xi).zip(&self.pair_places.priors) {
            // Gauss-Newton leaves the curvature of the residual out.
            let bend = if exact { e * bend } else { 0.0 };
            out[at] += factor * (slope * slope + bend);
        }
        finite
    }
}

/// What belongs to an experiment.
trait OfExperiment {
    fn experiment(&self) -> usize;
}

impl OfExperiment for Chunk {
    fn experiment(&self) -> usize {
        self.experiment
    }
}

impl OfExperiment for Samples {
    fn experiment(&self) -> usize {
        self.experiment
    }
}

/// The symbols of the variables in place of transformed parameters, and the model written in them.
fn in_variables(graph: &mut Graph, parameters: &[Parameter], compiled: Compiled) -> (Vec<Id>, Compiled) {
    let mut variables = compiled.parameters.clone();
    let (mut from, mut to) = (Vec::new(), Vec::new());
    for (variable, p) in variables.iter_mut().zip(parameters).filter(|(_, p)| p.transform != Transform::None)
    {
        from.push(*variable);
        *variable = graph.symbol(&p.transform.name(&p.name));
        to.push(p.transform.express(graph, *variable));
    }
    let dynamics = graph.replace(&compiled.dynamics, &from, &to);
    let outputs = graph.replace(&compiled.outputs, &from, &to);
    let conditions = graph.replace(&compiled.conditions, &from, &to);
    (variables, Compiled { dynamics, outputs, conditions, ..compiled })
}

/// Adds values at places, counted from `first`.
fn add(to: &mut [f64], first: usize, places: &[usize], values: &[f64]) {
    places.iter().zip(values).for_each(|(&at, v)| to[at - first] += v);
}

fn meshes(experiments: &[Experiment], settings: &Settings) -> Result<Vec<Mesh>, Error> {
    let count = settings.grid.len();
    if count != 1 && count != experiments.len() {
        return Err(Error::Option(format!(
            "{count} grids for {} experiments; give one, or one each",
            experiments.len()
        )));
    }
    let grid = |e: usize| &settings.grid[e.min(count - 1)];
    experiments.iter().enumerate().map(|(e, x)| Mesh::new(settings.order, grid(e), &x.t)).collect()
}

fn pool(threads: usize) -> Result<Option<rayon::ThreadPool>, Error> {
    if threads == 0 {
        return Ok(None);
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map(Some).map_err(|e| Error::Option(format!("{threads} threads: {e}")))
}

impl Nlp for Collocation {
    fn n(&self) -> usize {
        self.layout.n()
    }

    fn m(&self) -> usize {
        self.layout.m() + self.boundary.as_ref().map_or(0, Boundary::rows)
    }

    fn bounds(&self) -> (Vec<f64>, Vec<f64>) {
        let (mut lower, mut upper) = (vec![f64::NEG_INFINITY; self.n()], vec![f64::INFINITY; self.n()]);
        for (i, p) in self.parameters.iter().enumerate() {
            let transform = self.estimands.transforms[i];
            let (low, high) = if p.fixed { (Some(p.start), Some(p.start)) } else { (p.lower, p.upper) };
            lower[i] = low.map_or(f64::NEG_INFINITY, |p| transform.inverse(p));
            upper[i] = high.map_or(f64::INFINITY, |p| transform.inverse(p));
        }
        (lower, upper)
    }

    fn objective(&self, xi: &[f64]) -> Result<f64, NotFinite> {
        let mut sum = 0.0;
        self.each(
            &self.samples,
            (&self.likelihood.value, xi),
            1,
            |s, uniforms, scratch, part| {
                part[0] = self.sample_job(s, xi, uniforms).objective(&mut scratch.workspace);
                true
            },
            |_, part| sum += part[0],
        )?;
        sum += self.prior_terms(xi);
        if sum.is_finite() { Ok(sum) } else { Err(NotFinite) }
    }

    fn gradient(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        out.fill(0.0);
        let maps = &self.estimands.maps;
        let (theta, states) = out.split_at_mut(self.layout.n_theta);
        let shared = Disjoint::new(states);
        let finite = self.each(
            &self.samples,
            (&self.likelihood.jacobian, xi),
            maps[0].len(),
            |s, uniforms, scratch, part| {
                self.sample_job(s, xi, uniforms).gradient(&mut scratch.workspace, &shared, part)
            },
            |e, part| maps[e].iter().zip(part).for_each(|(&i, t)| theta[i] += t),
        );
        for (i, [e, slope, _]) in self.priors(xi) {
            out[i] += e * slope;
        }
        finite
    }

    fn constraints(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.at_ends(|b, problem| b.values(problem, xi, out))?;
        let out = Disjoint::new(out);
        self.each(
            &self.chunks,
            (&self.dynamics.f.value, xi),
            0,
            |chunk, uniforms, scratch, _| {
                self.dynamics_job(chunk, xi, uniforms).defects(&mut scratch.workspace, &out)
            },
            |_, _| (),
        )
    }

    fn jacobian_structure(&self) -> &Structure {
        &self.jacobian_structure
    }

    fn jacobian(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.at_ends(|b, problem| b.jacobian(problem, xi, out))?;
        let out = Disjoint::new(out);
        self.each(
            &self.chunks,
            (&self.dynamics.f.jacobian, xi),
            0,
            |chunk, uniforms, scratch, _| {
                self.dynamics_job(chunk, xi, uniforms).jacobian(&mut scratch.workspace, &out)
            },
            |_, _| (),
        )
    }

    fn hessian_structure(&self) -> &Structure {
        &self.hessian_structure
    }

    fn hessian(&self, xi: &[f64], factor: f64, lambda: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        // The others are written; those between parameters are added up.
        let first = self.pair_places.first;
        let (stored, between) = out.split_at_mut(first);
        between.fill(0.0);
        let shared = Disjoint::new(stored);
        let pairs = &self.pair_places.dynamics;
        let finite = self.each(
            &self.chunks,
            (&self.dynamics.f.hessian, xi),
            pairs[0].len(),
            |chunk, uniforms, scratch, part| {
                let job = self.dynamics_job(chunk, xi, uniforms);
                job.hessian(&mut scratch.workspace, lambda, &shared, part, &mut scratch.weights)
            },
            |e, part| add(between, first, &pairs[e], part),
        );
        let finite = finite.and(self.objective_hessian(&self.likelihood.hessian, true, xi, factor, out));
        finite.and(self.at_ends(|b, problem| b.hessian(problem, xi, lambda, out)))
    }

    fn gauss_newton(&self, xi: &[f64], factor: f64, out: &mut [f64]) -> Result<(), NotFinite> {
        out.fill(0.0);
        let tape = self.likelihood.gauss_newton.as_ref().unwrap_or(&self.likelihood.hessian);
        self.objective_hessian(tape, false, xi, factor, out)
    }

    fn chains(&self) -> Option<&Chains> {
        Some(&self.chains)
    }

    fn threads(&self) -> usize {
        self.pool.as_ref().map_or(0, rayon::ThreadPool::current_num_threads)
    }

    fn profiled(&self) -> Range<usize> {
        self.n_model_parameters..self.n_model_parameters + self.noise.n_scales() * self.counts.len()
    }

    fn profile(&self, xi: &[f64], gradient: &[f64], reach: &Reach<'_>, out: &mut [f64]) -> f64 {
        let (scales, n) = (self.profiled(), self.noise.n_scales());
        if let [counts] = &self.counts[..] {
            return self.noise.profile(counts, &xi[scales.clone()], &gradient[scales], reach, out);
        }
        let mut change: f64 = 0.0;
        for ((_, map), counts) in self.noise_maps().zip(&self.counts) {
            let of = |all: &[f64]| map[..n].iter().map(|&i| all[i]).collect::<Vec<f64>>();
            let mut own = vec![0.0; n];
            change = change.max(self.noise.profile(counts, &of(xi), &of(gradient), reach, &mut own));
            map.iter().zip(&own).for_each(|(&i, v)| out[i - scales.start] = *v);
        }
        change
    }

    fn variable_name(&self, i: usize) -> String {
        match self.layout.place(i) {
            Place::Parameter(p) if p < self.n_model_parameters => {
                self.estimands.transforms[p].name(&self.parameters[p].name)
            }
            Place::Parameter(p) => {
                let name = &self.noise_names[self.estimands.parameter[p] - self.model_names.len()];
                match self.estimands.experiment[p] {
                    Some(e) => format!("{name}[{}]", self.experiments[e].name),
                    None => name.clone(),
                }
            }
            Place::State { experiment, point, state } => {
                let t = self.meshes[experiment].times[point];
                format!("{} at t = {t} s of '{}'", self.state_names[state], self.experiments[experiment].name)
            }
        }
    }

    fn constraint_name(&self, i: usize) -> String {
        if let Some(boundary) = self.boundary.as_ref().filter(|_| i >= self.layout.m()) {
            let (e, name) = boundary.name(i);
            return format!("{name} of '{}'", self.experiments[e].name);
        }
        let (e, row, state) = self.layout.constraint(i);
        let t = &self.meshes[e].times;
        let name = &self.state_names[state];
        format!("defect of {name} ending at t = {} s of '{}'", t[row + 1], self.experiments[e].name)
    }

    fn explain(&self, xi: &[f64]) -> Option<String> {
        self.why_not_finite(xi)
    }
}
