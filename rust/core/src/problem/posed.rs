//! The problem before it is transcribed: a model, records and a noise model, compiled and named.

use std::cell::{Cell, RefCell};
use std::ops::Range;
use std::sync::Arc;

use super::estimands::{Estimands, ParameterMap};
use super::samples::Samples;
use super::separable::{Role, multiplied, roles};
use crate::error::{Error, ErrorKind};
use crate::experiment::Experiment;
use crate::expr::graph::{Graph, Id};
use crate::index::{ExperimentId, IndexVec, StateId, VariableId};
use crate::interrupt::current;
use crate::model::{Compiled, Model, Parameter, Variable};
use crate::nlp::{NotFinite, Reach};
use crate::noise::{Counts, Missing, Noise, Reported, Sample};
use crate::tape::{Arguments, Function, Pairs, Tape, Workspace};
use crate::threads::Threads;
use crate::threads::prelude::*;
use crate::transform::Transform;

/// The common data of all transcriptions: variables that are no states, f, g and ℓ as functions of a point, records.
#[derive(Debug)]
pub struct Posed {
    /// The parameters that are variables: the model's (local ones once an experiment), then the noise's.
    pub parameters: IndexVec<VariableId, Parameter>,
    /// Number of variables that are parameters of the model.
    pub n_model_parameters: usize,
    /// Tell how f, g and the noise depend on each parameter of the model.
    pub(crate) roles: Vec<Role>,
    /// Pairs of parameters, of which a second derivative of an output is other than 0.
    pub(crate) multiplied: Vec<(usize, usize)>,
    /// The parameter and the experiment of each variable.
    pub estimands: Estimands,
    /// The noise model.
    pub noise: Noise,
    /// The names of its parameters as unknowns.
    pub(crate) noise_names: Vec<String>,
    pub(crate) model_names: Vec<String>,
    output_names: Vec<String>,
    pub(crate) state_names: IndexVec<StateId, String>,
    /// Lower and upper bounds of the states.
    state_bounds: Vec<(f64, f64)>,
    pub(crate) input_names: Vec<String>,
    pub(crate) experiments: IndexVec<ExperimentId, Experiment>,
    pub(crate) f: Arc<Function>,
    pub(crate) likelihood: Arc<Function>,
    pub(crate) outputs: Arc<Function>,
    missing: Missing,
    /// Number of patterns of missing samples that the likelihood distinguishes.
    patterns: usize,
    /// Numbers of measurements, of all experiments or of each where each has noise of its own.
    counts: Vec<Counts>,
    pub(crate) threads: Threads,
}

/// The model as written in the variables, for what else is a function of them.
pub(crate) struct Written {
    pub(crate) graph: Graph,
    pub(crate) compiled: Compiled,
    pub(crate) theta: Vec<Id>,
}

/// Work smaller than this many blocks is done by the calling thread: waking others costs more.
const PARALLEL_BLOCKS: usize = 24;

/// Most numbers that the parts of a batch of items hold together (32 MB), but for batches of this many items.
const PARTS: usize = 1 << 22;
const BATCH: usize = 2 * PARALLEL_BLOCKS;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
    static BUFFERS: Cell<Buffers> = Cell::default();
}

/// Other buffers of a call.
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

/// The memory of a thread that evaluates a block.
#[derive(Default)]
pub(crate) struct Scratch {
    pub(crate) workspace: Workspace,
    pub(crate) weights: Vec<f64>,
}

/// An object that belongs to an experiment.
pub(crate) trait OfExperiment {
    fn experiment(&self) -> ExperimentId;
}

impl OfExperiment for Samples {
    fn experiment(&self) -> ExperimentId {
        self.experiment
    }
}

impl Posed {
    /// Checks and compiles.
    ///
    /// # Errors
    /// When the model is incomplete, the data do not fit it, or an option is out of range.
    pub(crate) fn new(
        model: &Model,
        experiments: &[Experiment],
        noise: Noise,
        threads: usize,
        noise_per_experiment: bool,
        pairs: Pairs,
    ) -> Result<(Self, Written), Error> {
        if let Some(late) = model.delays.parameters().first() {
            return Err(Error::model(format!(
                "the model '{}' has delays ({late}), which move the records: an estimation estimates them; a \
                 transcription by itself cannot",
                model.name
            ))
            .about(&model.name));
        }
        let threads = Threads::new(threads)?;
        let mut compiled = model.compile()?;
        compiled.scales = model.scales(&noise, &mut compiled.graph)?;
        let output_names: Vec<&str> = model.outputs.iter().map(|o| o.name.as_str()).collect();
        let input_names: Vec<&str> = model.inputs.iter().map(|o| o.name.as_str()).collect();
        if experiments.is_empty() {
            return Err(Error::data("no experiment was given; at least one is needed".into()));
        }
        Experiment::check_all(experiments, &input_names, &output_names)?;
        noise.check(&output_names)?;

        let counts = Counts::new(experiments.iter().map(|e| &e.outputs));
        let missing = Missing::new(experiments.iter().map(|e| &e.outputs));
        let noise = noise.for_data(&counts, &missing)?;
        let noise_parameters = noise.parameters(&output_names);
        let n_model = model.parameters.len();
        let local = noise_per_experiment && experiments.len() > 1;
        let noise_parameters = noise_parameters.into_iter().map(|p| Parameter { local, ..p });
        let seen: Vec<Parameter> = model.parameters.iter().cloned().chain(noise_parameters).collect();
        let (estimands, parameters) = Estimands::new(&seen, experiments);
        let n_model_parameters = estimands.parameter.iter().filter(|p| p.0 < n_model).count();
        let noise_names = noise.variable_names(&output_names);

        let of_model = |error: Error| match error.kind() {
            ErrorKind::Model => Error::model(format!("model '{}': {error}", model.name)).about(&model.name),
            _ => error,
        };
        // All functions of a point see all parameters, so that θ has one order everywhere.
        let mut graph = compiled.graph.clone();
        let noise_symbols: Vec<Id> = noise_names.iter().map(|name| graph.symbol(name)).collect();
        let roles = roles(&mut graph.clone(), &seen[..n_model], &compiled);
        let (variables, compiled) = in_variables(&mut graph, &seen[..n_model], compiled);
        let theta: Vec<Id> = variables.iter().chain(&noise_symbols).copied().collect();
        let multiplied = multiplied(&mut graph.clone(), &compiled.outputs, &theta);
        let arguments =
            Arguments { data: compiled.data.clone(), states: compiled.states.clone(), parameters: theta };
        let f =
            Function::new(graph.clone(), &arguments, compiled.dynamics.clone(), pairs).map_err(of_model)?;
        let outputs =
            Function::of_values(graph.clone(), &arguments, compiled.outputs.clone()).map_err(of_model)?;

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
            scales: &compiled.scales,
            present: &present,
            patterns: &patterns,
        };
        let terms = noise.log_density(&mut graph, &sample, &noise_symbols);
        let mut with_samples = arguments.clone();
        let flags = present.iter().flatten().chain(patterns.iter().map(|p| &p.1));
        with_samples.data.extend(measured.iter().chain(flags));
        let written = Written { graph: graph.clone(), compiled, theta: arguments.parameters.clone() };
        let likelihood = Function::of_terms(graph, &with_samples, &terms).map_err(of_model)?;

        let posed = Posed {
            n_model_parameters,
            roles,
            multiplied,
            parameters: parameters.into_iter().collect(),
            estimands,
            noise,
            noise_names,
            model_names: model.parameters.iter().map(|p| p.name.clone()).collect(),
            output_names: model.outputs.iter().map(|o| o.name.clone()).collect(),
            state_names: model.states.iter().map(|s| s.name.clone()).collect(),
            state_bounds: model.states.iter().map(Variable::bounds).collect(),
            input_names: model.inputs.iter().map(|s| s.name.clone()).collect(),
            experiments: experiments.iter().cloned().collect(),
            f: Arc::new(f),
            likelihood: Arc::new(likelihood),
            outputs: Arc::new(outputs),
            patterns: patterns.len(),
            missing,
            counts: if local {
                experiments.iter().map(|e| Counts::new([&e.outputs].into_iter())).collect()
            } else {
                vec![counts]
            },
            threads,
        };
        Ok((posed, written))
    }

    /// Poses the problem of another experiment of the same model with the functions that are compiled; `None` where they do not
    /// serve: other samples are missing, or this problem is one of several experiments.
    ///
    /// # Errors
    /// When the data do not fit the model.
    pub(crate) fn of_another(&self, experiment: &Experiment) -> Result<Option<Self>, Error> {
        let inputs: Vec<&str> = self.input_names.iter().map(String::as_str).collect();
        let outputs: Vec<&str> = self.output_names.iter().map(String::as_str).collect();
        Experiment::check_all(std::slice::from_ref(experiment), &inputs, &outputs)?;
        let missing = Missing::new([&experiment.outputs].into_iter());
        if self.experiments.len() != 1 || missing != self.missing {
            return Ok(None);
        }
        let counts = Counts::new([&experiment.outputs].into_iter());
        let noise = self.noise.clone().for_data(&counts, &missing)?;
        if noise.variable_names(&outputs) != self.noise_names {
            return Ok(None);
        }
        Ok(Some(Posed {
            parameters: self.parameters.clone(),
            n_model_parameters: self.n_model_parameters,
            roles: self.roles.clone(),
            multiplied: self.multiplied.clone(),
            estimands: self.estimands.clone(),
            noise,
            noise_names: self.noise_names.clone(),
            model_names: self.model_names.clone(),
            output_names: self.output_names.clone(),
            state_names: self.state_names.clone(),
            state_bounds: self.state_bounds.clone(),
            input_names: self.input_names.clone(),
            experiments: [experiment.clone()].into_iter().collect(),
            f: Arc::clone(&self.f),
            likelihood: Arc::clone(&self.likelihood),
            outputs: Arc::clone(&self.outputs),
            missing,
            patterns: self.patterns,
            counts: vec![counts],
            threads: self.threads.clone(),
        }))
    }

    /// Data columns of the likelihood at the samples of an experiment: time, inputs, measurements, and where some
    /// are missing which are there.
    pub(crate) fn sample_columns(&self, experiment: ExperimentId) -> Vec<Vec<f64>> {
        let experiment = &self.experiments[experiment];
        let mut columns = vec![experiment.t.clone()];
        columns.extend((0..experiment.inputs.len()).map(|c| experiment.input(c, &experiment.t)));
        let filled = |c: &Vec<f64>| c.iter().map(|v| if v.is_nan() { 0.0 } else { *v }).collect();
        columns.extend(experiment.outputs.iter().map(filled));
        columns.extend(self.missing.flags(&experiment.outputs, self.patterns));
        columns
    }

    /// Uniform values of a tape for an experiment.
    pub(crate) fn uniforms(&self, tape: &Tape, xi: &[f64], experiment: ExperimentId) -> Vec<f64> {
        let (mut theta, mut out) = (Vec::new(), Vec::new());
        self.estimands.theta(experiment, xi, &mut theta);
        tape.uniforms(&theta, &mut out);
        out
    }

    /// Number of parameters of the model as functions of a point see them; those of the noise follow.
    pub(crate) fn n_seen(&self) -> usize {
        self.model_names.len()
    }

    /// Number of maps from parameters to variables that differ.
    pub(crate) fn differing(&self) -> usize {
        if self.estimands.any_local() { self.estimands.maps.len() } else { 1 }
    }

    /// The maps from parameters to variables that differ.
    pub(crate) fn maps(&self) -> impl Iterator<Item = &ParameterMap> {
        self.estimands.maps.iter().take(self.differing())
    }

    /// Runs `work` on every item, in parallel where it pays, with the uniform values of a tape and `width`
    /// zeros to add to; then `collect` on those, in the order of items. Whether all work was finite.
    pub(crate) fn each<T: OfExperiment + Sync>(
        &self,
        items: &[T],
        (tape, xi): (&Tape, &[f64]),
        width: usize,
        work: impl Fn(&T, &[f64], &mut Scratch, &mut [f64]) -> bool + Sync,
        mut collect: impl FnMut(ExperimentId, &[f64]),
    ) -> Result<(), NotFinite> {
        // Taken and put back: nothing is allocated after the first call.
        let Buffers { mut theta, mut uniforms, mut one, mut parts } = BUFFERS.take();
        let differ = self.differing();
        uniforms.clear();
        for e in (0..differ).map(ExperimentId) {
            self.estimands.theta(e, xi, &mut theta);
            tape.uniforms(&theta, &mut one);
            uniforms.extend_from_slice(&one);
        }
        let (length, of) =
            (one.len(), |item: &T| if differ > 1 { item.experiment() } else { ExperimentId(0) });
        // Each item has a part, an empty one too. Items are taken in batches, so that thousands of wide parts
        // need not be held at once; the order of the sums is the same.
        let step = width.max(1);
        let batch = (PARTS / step).max(BATCH).min(items.len().max(1));
        parts.clear();
        parts.resize(batch * step, 0.0);
        let interrupt = current();
        let run = |(item, part): (&T, &mut [f64])| {
            // What was not finished is taken for not finite; whoever set the interrupt knows.
            if interrupt.stops() {
                return false;
            }
            let uniforms = &uniforms[of(item).0 * length..][..length];
            SCRATCH.with(|s| work(item, uniforms, &mut s.borrow_mut(), &mut part[..width]))
        };
        let mut finite = true;
        for (k, items) in items.chunks(batch).enumerate() {
            if k > 0 {
                parts.fill(0.0);
            }
            finite &= if self.n_threads() == 1 || items.len() < PARALLEL_BLOCKS {
                items.iter().zip(parts.chunks_exact_mut(step)).map(run).fold(true, |a, b| a & b)
            } else {
                let pairs = items.par_iter().zip(parts.par_chunks_exact_mut(step));
                self.install(|| pairs.with_min_len(8).map(run).min().unwrap_or(true))
            };
            let done = items.iter().zip(parts.chunks_exact(step));
            done.for_each(|(item, part)| collect(of(item), &part[..width]));
        }
        BUFFERS.set(Buffers { theta, uniforms, one, parts });
        if finite { Ok(()) } else { Err(NotFinite) }
    }

    /// Runs on the problem's own threads where it has some, else on the common ones.
    pub(crate) fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        self.threads.install(work)
    }

    /// Number of threads.
    pub(crate) fn n_threads(&self) -> usize {
        self.threads.number()
    }

    /// Returns for each prior its variable, and the value's distance from the mean in standard deviations with its
    /// first two derivatives.
    pub(crate) fn priors<'a>(&'a self, xi: &'a [f64]) -> impl Iterator<Item = (VariableId, [f64; 3])> + 'a {
        self.parameters.numbered().filter_map(move |(i, p)| {
            let ((mean, std), transform) = (p.prior?, self.estimands.transforms[i]);
            let value = transform.value(xi[i]) - mean;
            Some((i, [value, transform.slope(xi[i]), transform.bend(xi[i])].map(|v| v / std)))
        })
    }

    /// Returns the contribution of priors to φ.
    pub fn prior_terms(&self, xi: &[f64]) -> f64 {
        self.priors(xi).map(|(_, [e, ..])| 0.5 * e * e).sum()
    }

    /// Bounds of n variables: the parameters, then states, those of a point together.
    pub(crate) fn bounds_of(&self, n: usize) -> (Vec<f64>, Vec<f64>) {
        let (mut lower, mut upper) = (vec![f64::NEG_INFINITY; n], vec![f64::INFINITY; n]);
        for (i, p) in self.parameters.numbered() {
            let transform = self.estimands.transforms[i];
            let (low, high) = if p.fixed { (Some(p.start), Some(p.start)) } else { (p.lower, p.upper) };
            lower[i] = low.map_or(f64::NEG_INFINITY, |p| transform.inverse(p));
            upper[i] = high.map_or(f64::INFINITY, |p| transform.inverse(p));
        }
        if self.state_bounds.iter().all(|(low, high)| low.is_infinite() && high.is_infinite()) {
            return (lower, upper);
        }
        let states = lower.iter_mut().zip(&mut upper).skip(self.parameters.len());
        for ((low, high), bounds) in states.zip(self.state_bounds.iter().cycle()) {
            (*low, *high) = *bounds;
        }
        (lower, upper)
    }

    /// Variables that are scales of the noise.
    pub(crate) fn profiled_noise(&self) -> Range<usize> {
        self.n_model_parameters..self.n_model_parameters + self.noise.n_scales() * self.counts.len()
    }

    /// Finds the noise parameters that minimise φ within their bounds and reach; returns the largest relative change.
    pub(crate) fn profile_noise(
        &self,
        xi: &[f64],
        gradient: &[f64],
        reach: &Reach<'_>,
        out: &mut [f64],
    ) -> f64 {
        let (scales, n) = (self.profiled_noise(), self.noise.n_scales());
        if let [counts] = &self.counts[..] {
            return self.noise.profile(counts, &xi[scales.clone()], &gradient[scales], reach, out);
        }
        let mut change: f64 = 0.0;
        for ((_, map), counts) in self.noise_maps().zip(&self.counts) {
            let of = |all: &[f64]| map[..n].iter().map(|&i| all[i]).collect::<Vec<f64>>();
            let mut own = vec![0.0; n];
            change = change.max(self.noise.profile(counts, &of(xi), &of(gradient), reach, &mut own));
            map.iter().zip(&own).for_each(|(&i, v)| out[i.0 - scales.start] = *v);
        }
        change
    }

    /// Returns the noise at ξ in the user's terms.
    pub fn noise_report(&self, xi: &[f64]) -> Vec<Reported> {
        let outputs: Vec<&str> = self.output_names.iter().map(String::as_str).collect();
        let k = self.parameters.len() - self.n_model_parameters;
        let mut found = Vec::new();
        for (e, map) in self.noise_maps() {
            let own: Vec<f64> = map.iter().map(|&i| xi[i]).collect();
            for mut r in self.noise.report(&outputs, &own) {
                // Gradients with respect to the noise of all experiments.
                let mut gradient = vec![0.0; k];
                map.iter().zip(&r.gradient).for_each(|(&i, g)| gradient[i.0 - self.n_model_parameters] = *g);
                r.gradient = gradient;
                r.bounded_by = r.bounded_by.map(|b| map[b].0 - self.n_model_parameters);
                if let Some(e) = e {
                    r.name = format!("{}[{}]", r.name, self.experiments[e].name);
                }
                found.push(r);
            }
        }
        found
    }

    /// The variables of the noise, once or for each experiment that has noise of its own.
    fn noise_maps(&self) -> impl Iterator<Item = (Option<ExperimentId>, &[VariableId])> {
        let local = self.counts.len() > 1;
        let n_model = self.model_names.len();
        let maps = self.estimands.maps.numbered().take(self.counts.len());
        maps.map(move |(e, map)| (local.then_some(e), &map.as_slice()[n_model..]))
    }

    /// Scales of the outputs, the least of all experiments.
    pub fn sigmas(&self, xi: &[f64]) -> Vec<f64> {
        let of = |map: &[VariableId]| {
            let own: Vec<f64> = map.iter().map(|&i| xi[i]).collect();
            self.noise.sigmas(&own)
        };
        let least = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(&b).map(|(a, b)| a.min(*b)).collect();
        self.noise_maps().map(|(_, map)| of(map)).reduce(least).unwrap_or_default()
    }

    /// Variables that are 1/σ of an output, given others where noise is correlated.
    pub fn precision_roots(&self) -> Vec<VariableId> {
        let roots = self.noise.precision_roots();
        self.noise_maps().flat_map(|(_, map)| roots.iter().map(|&k| map[k])).collect()
    }

    /// The user's name for a state at a time.
    pub(crate) fn state_name(&self, state: StateId, t: f64, experiment: ExperimentId) -> String {
        format!("{} at t = {t} of '{}'", self.state_names[state], self.experiments[experiment].name)
    }

    /// Returns the name of a variable that is a parameter.
    pub(crate) fn parameter_name(&self, i: VariableId) -> String {
        if i.0 < self.n_model_parameters {
            return self.estimands.transforms[i].name(&self.parameters[i].name);
        }
        let name = &self.noise_names[self.estimands.parameter[i].0 - self.model_names.len()];
        match self.estimands.experiment[i] {
            Some(e) => format!("{name}[{}]", self.experiments[e].name),
            None => name.clone(),
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
    let conditions = graph.replace(&compiled.conditions, &from, &to);
    let scales = compiled.scales.iter().map(|s| s.map(|s| graph.replace(&[s], &from, &to)[0])).collect();
    (variables, Compiled { dynamics, outputs, conditions, scales, ..compiled })
}
