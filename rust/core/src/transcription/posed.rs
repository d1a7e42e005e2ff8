//! The problem before it is transcribed: a model, records and a noise model, compiled and named.

use std::cell::{Cell, RefCell};
use std::sync::Arc;

use rayon::prelude::*;

use super::estimands::Estimands;
use super::samples::Samples;
use crate::error::Error;
use crate::experiment::Experiment;
use crate::expr::graph::{Graph, Id};
use crate::model::{Compiled, Model, Parameter};
use crate::nlp::NotFinite;
use crate::noise::{Noise, Sample};
use crate::tape::{Arguments, Function, Tape, Workspace};
use crate::transform::Transform;

/// What every transcription needs: variables that are no states, f, g and ℓ as functions of a point, records.
#[derive(Debug)]
pub struct Posed {
    /// The parameters that are variables: the model's (local ones once an experiment), then the noise's.
    pub parameters: Vec<Parameter>,
    /// Number of variables that are parameters of the model.
    pub n_model_parameters: usize,
    /// Which variable is which parameter of which experiment.
    pub estimands: Estimands,
    /// The noise model.
    pub noise: Noise,
    pub(super) state_names: Vec<String>,
    pub(super) input_names: Vec<String>,
    pub(super) experiments: Vec<Experiment>,
    pub(super) f: Arc<Function>,
    pub(super) likelihood: Function,
    pub(super) outputs: Function,
    /// For each output whether samples of it are missing, so that the likelihood is told which.
    pub(super) gaps: Vec<bool>,
    /// Number of measurements of each output, all experiments together.
    pub(super) measured: Vec<usize>,
    pub(super) pool: Option<rayon::ThreadPool>,
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
pub(super) struct Scratch {
    pub(super) workspace: Workspace,
    pub(super) weights: Vec<f64>,
}

/// What belongs to an experiment.
pub(super) trait OfExperiment {
    fn experiment(&self) -> usize;
}

impl OfExperiment for Samples {
    fn experiment(&self) -> usize {
        self.experiment
    }
}

impl Posed {
    /// Checks and compiles.
    ///
    /// # Errors
    /// When the model is incomplete, the data do not fit it, or an option is out of range.
    pub(super) fn new(
        model: &Model,
        experiments: &[Experiment],
        noise: Noise,
        threads: usize,
    ) -> Result<Self, Error> {
        let compiled = model.compile()?;
        let output_names: Vec<&str> = model.outputs.iter().map(|o| o.name.as_str()).collect();
        let input_names: Vec<&str> = model.inputs.iter().map(|o| o.name.as_str()).collect();
        if experiments.is_empty() {
            return Err(Error::Data("no experiment was given; at least one is needed".into()));
        }
        experiments.iter().try_for_each(|e| e.check(&input_names, &output_names))?;
        noise.check(&output_names)?;

        let noise_parameters = noise.parameters(&output_names);
        let n_model = model.parameters.len();
        let seen: Vec<Parameter> = model.parameters.iter().cloned().chain(noise_parameters).collect();
        let (estimands, parameters) = Estimands::new(&seen, experiments);
        let n_model_parameters = estimands.parameter.iter().filter(|&&p| p < n_model).count();

        // All functions of a point see all parameters, so that θ has one order everywhere.
        let mut graph = compiled.graph.clone();
        let noise_symbols: Vec<Id> =
            seen[n_model..].iter().map(|p| graph.symbol(&format!("1/{}", p.name))).collect();
        let (variables, compiled) = in_variables(&mut graph, &seen[..n_model], compiled);
        let theta: Vec<Id> = variables.iter().chain(&noise_symbols).copied().collect();
        let arguments =
            Arguments { data: compiled.data.clone(), states: compiled.states.clone(), parameters: theta };
        let f = Function::new(graph.clone(), &arguments, compiled.dynamics.clone());
        let outputs = Function::new(graph.clone(), &arguments, compiled.outputs.clone());

        let missing = |c: usize| experiments.iter().any(|e| e.outputs[c].iter().any(|v| v.is_nan()));
        let measured: Vec<Id> = output_names.iter().map(|n| graph.symbol(&format!("measured {n}"))).collect();
        let present: Vec<Option<Id>> = (0..output_names.len())
            .map(|c| missing(c).then(|| graph.symbol(&format!("{} present", output_names[c]))))
            .collect();
        let sample = Sample { outputs: &compiled.outputs, measured: &measured, present: &present };
        let density = noise.log_density(&mut graph, &sample, &noise_symbols);
        let mut with_samples = arguments.clone();
        with_samples.data.extend(measured.iter().chain(present.iter().flatten()));
        let likelihood = Function::of_squares(graph, &with_samples, &density.residuals, density.rest);

        Ok(Posed {
            n_model_parameters,
            parameters,
            estimands,
            noise,
            state_names: model.states.iter().map(|s| s.name.clone()).collect(),
            input_names: model.inputs.iter().map(|s| s.name.clone()).collect(),
            experiments: experiments.to_vec(),
            f: Arc::new(f),
            likelihood,
            outputs,
            gaps: present.iter().map(Option::is_some).collect(),
            measured: (0..output_names.len())
                .map(|c| experiments.iter().flat_map(|e| &e.outputs[c]).filter(|z| !z.is_nan()).count())
                .collect(),
            pool: pool(threads)?,
        })
    }

    /// Data columns of the likelihood at the samples of an experiment: time, inputs, measurements, and where some
    /// are missing which are there.
    pub(super) fn sample_columns(&self, experiment: usize) -> Vec<Vec<f64>> {
        let experiment = &self.experiments[experiment];
        let mut columns = vec![experiment.t.clone()];
        columns.extend(experiment.inputs.iter().cloned());
        let filled = |c: &Vec<f64>| c.iter().map(|v| if v.is_nan() { 0.0 } else { *v }).collect();
        columns.extend(experiment.outputs.iter().map(filled));
        let flags = |c: &Vec<f64>| c.iter().map(|v| f64::from(u8::from(!v.is_nan()))).collect();
        columns.extend(experiment.outputs.iter().zip(&self.gaps).filter(|c| *c.1).map(|c| flags(c.0)));
        columns
    }

    /// Uniform values of a tape for an experiment.
    pub(super) fn uniforms(&self, tape: &Tape, xi: &[f64], experiment: usize) -> Vec<f64> {
        let (mut theta, mut out) = (Vec::new(), Vec::new());
        self.estimands.theta(experiment, xi, &mut theta);
        tape.uniforms(&theta, &mut out);
        out
    }

    /// Number of parameters of the model as functions of a point see them; those of the noise follow.
    pub(super) fn n_seen(&self) -> usize {
        self.estimands.maps[0].len() - (self.parameters.len() - self.n_model_parameters)
    }

    /// Number of maps from parameters to variables that differ.
    pub(super) fn differing(&self) -> usize {
        if self.estimands.any_local() { self.estimands.maps.len() } else { 1 }
    }

    /// Runs `work` on every item, in parallel where it pays, with the uniform values of a tape and `width`
    /// zeros to add to; then `collect` on those, in the order of items. Whether all work was finite.
    pub(super) fn each<T: OfExperiment + Sync>(
        &self,
        items: &[T],
        (tape, xi): (&Tape, &[f64]),
        width: usize,
        work: impl Fn(&T, &[f64], &mut Scratch, &mut [f64]) -> bool + Sync,
        mut collect: impl FnMut(usize, &[f64]),
    ) -> Result<(), NotFinite> {
        // Taken and put back: nothing is allocated after the first call.
        let Buffers { mut theta, mut uniforms, mut one, mut parts } = BUFFERS.take();
        let differ = self.differing();
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
        let finite = if self.n_threads() == 1 || items.len() < PARALLEL_BLOCKS {
            items.iter().zip(parts.chunks_exact_mut(step)).map(run).fold(true, |a, b| a & b)
        } else {
            let pairs = items.par_iter().zip(parts.par_chunks_exact_mut(step));
            self.install(|| pairs.with_min_len(8).map(run).reduce(|| true, |a, b| a & b))
        };
        items.iter().zip(parts.chunks_exact(step)).for_each(|(item, part)| collect(of(item), &part[..width]));
        BUFFERS.set(Buffers { theta, uniforms, one, parts });
        if finite { Ok(()) } else { Err(NotFinite) }
    }

    /// Runs on the problem's own threads, where it has some.
    pub(super) fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }

    /// Number of threads.
    pub(super) fn n_threads(&self) -> usize {
        self.pool.as_ref().map_or_else(rayon::current_num_threads, rayon::ThreadPool::current_num_threads)
    }

    /// For each prior its variable, and the value's distance from the mean in standard deviations with its
    /// first two derivatives.
    pub(super) fn priors<'a>(&'a self, xi: &'a [f64]) -> impl Iterator<Item = (usize, [f64; 3])> + 'a {
        self.parameters.iter().enumerate().filter_map(move |(i, p)| {
            let ((mean, std), transform) = (p.prior?, self.estimands.transforms[i]);
            let value = transform.value(xi[i]) - mean;
            Some((i, [value, transform.slope(xi[i]), transform.bend(xi[i])].map(|v| v / std)))
        })
    }

    /// What priors add to φ.
    pub fn prior_terms(&self, xi: &[f64]) -> f64 {
        self.priors(xi).map(|(_, [e, ..])| 0.5 * e * e).sum()
    }

    /// Bounds of n variables, the parameters first.
    pub(super) fn bounds_of(&self, n: usize) -> (Vec<f64>, Vec<f64>) {
        let (mut lower, mut upper) = (vec![f64::NEG_INFINITY; n], vec![f64::INFINITY; n]);
        for (i, p) in self.parameters.iter().enumerate() {
            let transform = self.estimands.transforms[i];
            let (low, high) = if p.fixed { (Some(p.start), Some(p.start)) } else { (p.lower, p.upper) };
            lower[i] = low.map_or(f64::NEG_INFINITY, |p| transform.inverse(p));
            upper[i] = high.map_or(f64::INFINITY, |p| transform.inverse(p));
        }
        (lower, upper)
    }

    /// The noise parameters that minimise φ, within their bounds.
    pub(super) fn profile_noise(&self, xi: &[f64], gradient: &[f64], out: &mut [f64]) {
        let roots = self.n_model_parameters..self.parameters.len();
        self.noise.profile(&self.measured, &xi[roots.clone()], &gradient[roots.clone()], out);
        for (value, p) in out.iter_mut().zip(&self.parameters[roots]) {
            *value = value.clamp(p.lower.unwrap_or(0.0), p.upper.unwrap_or(f64::INFINITY));
        }
    }

    /// What a variable that is a parameter is called.
    pub(super) fn parameter_name(&self, i: usize) -> String {
        if i < self.n_model_parameters {
            self.estimands.transforms[i].name(&self.parameters[i].name)
        } else {
            format!("1/{}", self.parameters[i].name)
        }
    }

    /// Instructions of the tapes (f, ∂f, ∂²f, ℓ, ∂ℓ, ∂²ℓ): a count that does not depend on the machine.
    pub fn instructions(&self) -> [usize; 6] {
        let (f, l) = (&self.f, &self.likelihood);
        [&f.value, &f.jacobian, &f.hessian, &l.value, &l.jacobian, &l.hessian].map(Tape::instructions)
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
    (variables, Compiled { dynamics, outputs, ..compiled })
}

fn pool(threads: usize) -> Result<Option<rayon::ThreadPool>, Error> {
    if threads == 0 {
        return Ok(None);
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map(Some).map_err(|e| Error::Option(format!("{threads} threads: {e}")))
}
