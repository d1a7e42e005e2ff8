//! The collocation problem (Eq. oem_coll) as a nonlinear program.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;

use super::chunk::Chunk;
use super::defects::{self, Dynamics};
use super::disjoint::Disjoint;
use super::layout::{Layout, Place};
use super::likelihood;
use super::samples::Samples;
use crate::error::Error;
use crate::experiment::Experiment;
use crate::expr::graph::Id;
use crate::interpolate::interpolate;
use crate::mesh::{Grid, Mesh};
use crate::model::{Model, Parameter};
use crate::nlp::{Chains, Nlp, NotFinite, Reach, Structure};
use crate::noise::{Counts, Missing, Noise, Reported, Sample};
use crate::tape::{Arguments, Function, Tape, Workspace};

/// How a problem is transcribed.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Points of a segment, m: 2 is the trapezoid.
    pub order: usize,
    /// Division into segments, one an experiment, or one for all.
    pub grid: Vec<Grid>,
    /// Threads; 0 for as many as there are cores.
    pub threads: usize,
}

impl Default for Settings {
    /// Order 4, one segment between samples.
    fn default() -> Self {
        Settings { order: 4, grid: vec![Grid::Samples(1)], threads: 0 }
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
/// let settings = Settings { order: 2, grid: vec![Grid::Samples(1)], threads: 1 };
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
    /// Model parameters, then noise parameters.
    pub parameters: Vec<Parameter>,
    /// Number of model parameters.
    pub n_model_parameters: usize,
    /// The noise model.
    pub noise: Noise,
    /// What its parameters are called as unknowns.
    pub(super) noise_names: Vec<String>,
    /// One mesh an experiment.
    pub meshes: Vec<Mesh>,
    /// Inputs at all points of each experiment: `inputs[experiment][channel][point]`.
    pub inputs: Vec<Vec<Vec<f64>>>,
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
    /// How many measurements there are.
    counts: Counts,
    pool: Option<rayon::ThreadPool>,
}

#[derive(Clone, Debug, Default)]
struct PairPlaces {
    /// The first of them; they are the last entries.
    first: usize,
    dynamics: Vec<usize>,
    likelihood: Vec<usize>,
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
    /// Uniform values of a tape.
    uniforms: Vec<f64>,
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
        let noise_names = noise.variable_names(&output_names);
        let n_theta = model.parameters.len() + noise_parameters.len();
        let layout = Layout::new(n_theta, model.states.len(), &meshes);
        let parameters: Vec<Parameter> = model.parameters.iter().cloned().chain(noise_parameters).collect();

        // All functions of a point see all parameters, so that θ has one order everywhere.
        let mut graph = compiled.graph.clone();
        let noise_symbols: Vec<Id> = noise_names.iter().map(|name| graph.symbol(name)).collect();
        let theta: Vec<Id> = compiled.parameters.iter().chain(&noise_symbols).copied().collect();
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
        let likelihood = Function::of_terms(graph, &with_samples, &terms);

        let mut problem = Collocation {
            layout,
            n_model_parameters: model.parameters.len(),
            parameters,
            noise,
            noise_names,
            meshes,
            inputs: Vec::new(),
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
            counts,
            pool: pool(settings.threads)?,
        };
        problem.place_data(&missing, patterns.len());
        problem.place_derivatives();
        problem.chains = problem.layout.chains(&problem.meshes);
        Ok(problem)
    }

    /// Fills chunks and blocks of samples with data in the order of their lanes.
    fn place_data(&mut self, missing: &Missing, patterns: usize) {
        for (e, (experiment, mesh)) in self.experiments.iter().zip(&self.meshes).enumerate() {
            let at_points = |channel: &Vec<f64>| {
                interpolate(experiment.interpolation, &experiment.t, channel, &mesh.times)
            };
            let inputs: Vec<Vec<f64>> = experiment.inputs.iter().map(at_points).collect();
            let first = self.layout.first_point[e] as u32;
            for mut chunk in Chunk::cut(e, mesh, &self.layout) {
                for column in std::iter::once(&mesh.times).chain(&inputs) {
                    chunk.data.extend(chunk.points.iter().map(|&p| column[(p - first) as usize]));
                }
                self.chunks.push(chunk);
            }
            let mut columns = vec![experiment.t.clone()];
            columns.extend(experiment.inputs.iter().cloned());
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
            self.dynamics.jacobian_structure(chunk, &self.layout, &mut self.jacobian_structure);
            chunk.jacobian_entries = self.jacobian_structure.len() - chunk.jacobian;
            chunk.hessian = self.hessian_structure.len();
            self.dynamics.hessian_structure(chunk, &self.layout, &mut self.hessian_structure);
        }
        for samples in &mut self.samples {
            samples.hessian = self.hessian_structure.len();
            likelihood::hessian_structure(
                &self.likelihood,
                samples,
                &self.layout,
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
        self.pair_places.dynamics = self.dynamics.parameter_pairs().map(&mut place).collect();
        let likelihood = self.likelihood.hessian_pattern.iter().filter(|(_, c)| *c >= n_x);
        self.pair_places.likelihood = likelihood.map(|(r, c)| place((r - n_x, c - n_x))).collect();
        let with_prior = (0..self.parameters.len()).filter(|&i| self.parameters[i].prior.is_some());
        self.pair_places.priors = with_prior.map(|i| (i, place((i, i)))).collect();
    }

    fn theta<'a>(&self, xi: &'a [f64]) -> &'a [f64] {
        &xi[..self.layout.n_theta]
    }

    fn uniforms(&self, tape: &Tape, xi: &[f64]) -> Vec<f64> {
        let mut out = Vec::new();
        tape.uniforms(self.theta(xi), &mut out);
        out
    }

    /// Runs `work` on every item, in parallel where it pays, with the uniform values of a tape and `width`
    /// zeros to add to; then `collect` on those, in the order of items. Whether all work was finite.
    fn each<T: Sync>(
        &self,
        items: &[T],
        (tape, xi): (&Tape, &[f64]),
        width: usize,
        work: impl Fn(&T, &[f64], &mut Scratch, &mut [f64]) -> bool + Sync,
        mut collect: impl FnMut(&[f64]),
    ) -> Result<(), NotFinite> {
        // Taken and put back: nothing is allocated after the first call.
        let Buffers { mut uniforms, mut parts } = BUFFERS.take();
        tape.uniforms(self.theta(xi), &mut uniforms);
        // Each item has a part, an empty one too.
        let step = width.max(1);
        parts.clear();
        parts.resize(items.len() * step, 0.0);
        let one = |(item, part): (&T, &mut [f64])| {
            SCRATCH.with(|s| work(item, &uniforms, &mut s.borrow_mut(), &mut part[..width]))
        };
        let threads = self
            .pool
            .as_ref()
            .map_or_else(rayon::current_num_threads, rayon::ThreadPool::current_num_threads);
        let finite = if threads == 1 || items.len() < PARALLEL_BLOCKS {
            items.iter().zip(parts.chunks_exact_mut(step)).map(one).fold(true, |a, b| a & b)
        } else {
            let pairs = items.par_iter().zip(parts.par_chunks_exact_mut(step));
            let all = || pairs.with_min_len(8).map(one).reduce(|| true, |a, b| a & b);
            match &self.pool {
                Some(pool) => pool.install(all),
                None => all(),
            }
        };
        parts.chunks_exact(step).for_each(|part| collect(&part[..width]));
        BUFFERS.set(Buffers { uniforms, parts });
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

    fn priors(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        self.parameters.iter().enumerate().filter_map(|(i, p)| p.prior.map(|(mean, std)| (i, mean, std)))
    }

    /// What the noise is at ξ, in the user's terms.
    pub fn noise_report(&self, xi: &[f64]) -> Vec<Reported> {
        let outputs: Vec<&str> = self.output_names.iter().map(String::as_str).collect();
        self.noise.report(&outputs, &xi[self.n_model_parameters..self.layout.n_theta])
    }

    /// Model outputs at the samples of an experiment: `[output][sample]`.
    pub fn outputs_at_samples(&self, xi: &[f64], experiment: usize) -> Vec<Vec<f64>> {
        let tape = &self.outputs.value;
        let uniforms = self.uniforms(tape, xi);
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
            pairs.len(),
            |s, uniforms, scratch, part| {
                let job = self.sample_job(s, xi, uniforms);
                job.hessian(tape, &mut scratch.workspace, factor, &shared, part)
            },
            |part| add(between, self.pair_places.first, pairs, part),
        );
        for &(i, at) in &self.pair_places.priors {
            let (_, std) = self.parameters[i].prior.expect("listed for its prior");
            out[at] += factor / (std * std);
        }
        finite
    }
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
        self.layout.m()
    }

    fn bounds(&self) -> (Vec<f64>, Vec<f64>) {
        let (mut lower, mut upper) = (vec![f64::NEG_INFINITY; self.n()], vec![f64::INFINITY; self.n()]);
        for (i, p) in self.parameters.iter().enumerate() {
            lower[i] = if p.fixed { p.start } else { p.lower.unwrap_or(f64::NEG_INFINITY) };
            upper[i] = if p.fixed { p.start } else { p.upper.unwrap_or(f64::INFINITY) };
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
            |part| sum += part[0],
        )?;
        sum += self.priors().map(|(i, mean, std)| 0.5 * ((xi[i] - mean) / std).powi(2)).sum::<f64>();
        if sum.is_finite() { Ok(sum) } else { Err(NotFinite) }
    }

    fn gradient(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        out.fill(0.0);
        let (theta, states) = out.split_at_mut(self.layout.n_theta);
        let shared = Disjoint::new(states);
        let finite = self.each(
            &self.samples,
            (&self.likelihood.jacobian, xi),
            theta.len(),
            |s, uniforms, scratch, part| {
                self.sample_job(s, xi, uniforms).gradient(&mut scratch.workspace, &shared, part)
            },
            |part| theta.iter_mut().zip(part).for_each(|(o, t)| *o += t),
        );
        for (i, mean, std) in self.priors() {
            out[i] += (xi[i] - mean) / (std * std);
        }
        finite
    }

    fn constraints(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        let out = Disjoint::new(out);
        self.each(
            &self.chunks,
            (&self.dynamics.f.value, xi),
            0,
            |chunk, uniforms, scratch, _| {
                self.dynamics_job(chunk, xi, uniforms).defects(&mut scratch.workspace, &out)
            },
            |_| (),
        )
    }

    fn jacobian_structure(&self) -> &Structure {
        &self.jacobian_structure
    }

    fn jacobian(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        let out = Disjoint::new(out);
        self.each(
            &self.chunks,
            (&self.dynamics.f.jacobian, xi),
            0,
            |chunk, uniforms, scratch, _| {
                self.dynamics_job(chunk, xi, uniforms).jacobian(&mut scratch.workspace, &out)
            },
            |_| (),
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
            pairs.len(),
            |chunk, uniforms, scratch, part| {
                let job = self.dynamics_job(chunk, xi, uniforms);
                job.hessian(&mut scratch.workspace, lambda, &shared, part, &mut scratch.weights)
            },
            |part| add(between, first, pairs, part),
        );
        finite.and(self.objective_hessian(&self.likelihood.hessian, xi, factor, out))
    }

    fn gauss_newton(&self, xi: &[f64], factor: f64, out: &mut [f64]) -> Result<(), NotFinite> {
        out.fill(0.0);
        let tape = self.likelihood.gauss_newton.as_ref().unwrap_or(&self.likelihood.hessian);
        self.objective_hessian(tape, xi, factor, out)
    }

    fn chains(&self) -> Option<&Chains> {
        Some(&self.chains)
    }

    fn threads(&self) -> usize {
        self.pool.as_ref().map_or(0, rayon::ThreadPool::current_num_threads)
    }

    fn profiled(&self) -> Range<usize> {
        self.n_model_parameters..self.n_model_parameters + self.noise.n_scales()
    }

    fn profile(&self, xi: &[f64], gradient: &[f64], reach: &Reach<'_>, out: &mut [f64]) -> f64 {
        let scales = self.profiled();
        self.noise.profile(&self.counts, &xi[scales.clone()], &gradient[scales], reach, out)
    }

    fn variable_name(&self, i: usize) -> String {
        match self.layout.place(i) {
            Place::Parameter(p) if p < self.n_model_parameters => self.parameters[p].name.clone(),
            Place::Parameter(p) => self.noise_names[p - self.n_model_parameters].clone(),
            Place::State { experiment, point, state } => {
                let t = self.meshes[experiment].times[point];
                format!("{} at t = {t} s of '{}'", self.state_names[state], self.experiments[experiment].name)
            }
        }
    }

    fn constraint_name(&self, i: usize) -> String {
        let (e, row, state) = self.layout.constraint(i);
        let t = &self.meshes[e].times;
        let name = &self.state_names[state];
        format!("defect of {name} ending at t = {} s of '{}'", t[row + 1], self.experiments[e].name)
    }

    fn explain(&self, xi: &[f64]) -> Option<String> {
        self.why_not_finite(xi)
    }
}
