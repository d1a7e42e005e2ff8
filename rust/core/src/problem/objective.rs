//! φ = −ℓ with priors, as a function of the parameters and of the states at the samples.

use super::disjoint::Disjoint;
use super::estimands::ParameterMap;
use super::layout::Layout;
use super::likelihood::{self, Job};
use super::posed::Posed;
use super::samples::Samples;
use crate::index::{ExperimentId, IndexVec, ParameterId, VariableId};
use crate::nlp::{NotFinite, Structure};
use crate::tape::Workspace;

/// The samples of all experiments. They find their states in a vector with a [`Layout`]: the variables of a
/// collocation problem, or parameters and what an integration has given.
#[derive(Clone, Debug, Default)]
pub(crate) struct Objective {
    pub(crate) samples: Vec<Samples>,
    /// First of the Hessian entries between parameters; they are the last.
    first: usize,
    /// Places of the entries of ℓ: one list an experiment, a single one where they do not differ.
    pairs: IndexVec<ExperimentId, Vec<usize>>,
    /// Place of each prior.
    priors: Vec<usize>,
}

impl Objective {
    /// Adds the samples of an experiment, at these points of it.
    pub(crate) fn add(&mut self, posed: &Posed, layout: &Layout, experiment: ExperimentId, points: &[usize]) {
        let columns = posed.sample_columns(experiment);
        self.samples.extend(Samples::cut(experiment, points, layout, &columns));
    }

    /// Number of Hessian entries of the samples.
    pub(crate) fn hessian_entries(&self, posed: &Posed) -> usize {
        likelihood::hessian_entries(&posed.likelihood) * self.samples.iter().map(|s| s.n).sum::<usize>()
    }

    /// Lays out the Hessian entries of the samples.
    pub(crate) fn place(&mut self, posed: &Posed, layout: &Layout, structure: &mut Structure) {
        let each = likelihood::hessian_entries(&posed.likelihood);
        let lengths: Vec<usize> = self.samples.iter().map(|samples| each * samples.n).collect();
        let places = structure.add_parts(&posed.threads, (&lengths, 0), |i, part| {
            let samples = &self.samples[i];
            let map = &posed.estimands.maps[samples.experiment];
            likelihood::hessian_structure(&posed.likelihood, samples, layout, map, part);
        });
        self.samples.iter_mut().zip(places).for_each(|(samples, place)| samples.hessian = place);
        self.first = structure.len();
    }

    /// Lays out those between parameters: `place` gives each pair of variables (row ≥ column) its place.
    pub(crate) fn place_pairs(
        &mut self,
        posed: &Posed,
        mut place: impl FnMut(VariableId, VariableId) -> usize,
    ) {
        let n_x = posed.likelihood.n_states;
        for map in posed.maps() {
            let mut place = |r, c| place_pair(map, ParameterId(r), ParameterId(c), &mut place);
            let entries = posed.likelihood.hessian_pattern.iter().filter(|(_, c)| *c >= n_x);
            self.pairs.push(entries.map(|(r, c)| place(r - n_x, c - n_x)).collect());
        }
        let with_prior = posed.parameters.numbered().filter(|(_, p)| p.prior.is_some());
        self.priors = with_prior.map(|(i, _)| place(i, i)).collect();
    }

    /// φ.
    pub(crate) fn value(&self, posed: &Posed, layout: &Layout, xi: &[f64]) -> Result<f64, NotFinite> {
        let mut sum = 0.0;
        posed.each(
            &self.samples,
            (&posed.likelihood.value, xi),
            1,
            |samples, uniforms, scratch, part| {
                let job = Job { likelihood: &posed.likelihood, layout, samples, xi, uniforms };
                part[0] = job.objective(&mut scratch.workspace);
                true
            },
            |_, part| sum += part[0],
        )?;
        sum += posed.prior_terms(xi);
        if sum.is_finite() { Ok(sum) } else { Err(NotFinite) }
    }

    /// ∇φ.
    pub(crate) fn gradient(
        &self,
        posed: &Posed,
        layout: &Layout,
        xi: &[f64],
        out: &mut [f64],
    ) -> Result<(), NotFinite> {
        out.fill(0.0);
        let maps = &posed.estimands.maps;
        let (theta, states) = out.split_at_mut(layout.n_theta);
        let shared = Disjoint::new(states);
        let finite = posed.each(
            &self.samples,
            (&posed.likelihood.jacobian, xi),
            maps[ExperimentId(0)].len(),
            |samples, uniforms, scratch, part| {
                let job = Job { likelihood: &posed.likelihood, layout, samples, xi, uniforms };
                job.gradient(&mut scratch.workspace, &shared, part)
            },
            |e, part| maps[e].iter().zip(part).for_each(|(&i, t)| theta[i] += t),
        );
        for (i, [e, slope, _]) in posed.priors(xi) {
            out[i] += e * slope;
        }
        finite
    }

    /// Writes factor · ∇²φ at the samples, and adds it between parameters; without `exact` Gauss-Newton's.
    pub(crate) fn hessian(
        &self,
        posed: &Posed,
        layout: &Layout,
        exact: bool,
        xi: &[f64],
        factor: f64,
        out: &mut [f64],
    ) -> Result<(), NotFinite> {
        let likelihood = &posed.likelihood;
        let approximate = likelihood.gauss_newton.as_ref().filter(|_| !exact);
        let tape = approximate.unwrap_or(&likelihood.hessian);
        // Entries of samples are written, those between parameters summed, at other places.
        let (stored, between) = out.split_at_mut(self.first);
        let shared = Disjoint::new(stored);
        let finite = posed.each(
            &self.samples,
            (tape, xi),
            self.pairs[ExperimentId(0)].len(),
            |samples, uniforms, scratch, part| {
                let job = Job { likelihood, layout, samples, xi, uniforms };
                job.hessian(tape, &mut scratch.workspace, factor, &shared, part)
            },
            |e, part| add(between, self.first, &self.pairs[e], part),
        );
        for ((_, [e, slope, bend]), &at) in posed.priors(xi).zip(&self.priors) {
            // Gauss-Newton leaves the curvature of the residual out.
            let bend = if exact { e * bend } else { 0.0 };
            out[at] += factor * (slope * slope + bend);
        }
        finite
    }

    /// Model outputs at the samples of an experiment: `[output][sample]`.
    pub(crate) fn outputs(
        &self,
        posed: &Posed,
        layout: &Layout,
        xi: &[f64],
        experiment: ExperimentId,
    ) -> Vec<Vec<f64>> {
        let tape = &posed.outputs.value;
        let uniforms = posed.uniforms(tape, xi, experiment);
        let mut out = vec![Vec::new(); tape.outputs.len()];
        let mut workspace = Workspace::default();
        for block in self.samples.iter().filter(|s| s.experiment == experiment) {
            let n = block.points.len();
            let registers = workspace.registers(tape, n);
            let n_data = posed.outputs.n_data * n;
            registers[..n_data].copy_from_slice(&block.data[..n_data]);
            layout.gather(xi, &block.points, &mut registers[n_data..]);
            tape.run(registers, &uniforms, n);
            for (channel, operand) in out.iter_mut().zip(&tape.outputs) {
                let value = tape.read(*operand, registers, &uniforms, n);
                channel.extend((0..block.n).map(|l| value.at(l)));
            }
        }
        out
    }
}

/// The place of a pair of parameters: `place` is that of a pair of variables, the greater first. Variables of different
/// experiments stand in another order than the parameters they are.
pub(crate) fn place_pair(
    map: &ParameterMap,
    a: ParameterId,
    b: ParameterId,
    place: &mut impl FnMut(VariableId, VariableId) -> usize,
) -> usize {
    place(map[a].max(map[b]), map[a].min(map[b]))
}

/// Adds values at places, counted from `first`.
pub(crate) fn add(to: &mut [f64], first: usize, places: &[usize], values: &[f64]) {
    places.iter().zip(values).for_each(|(&at, v)| to[at - first] += v);
}
