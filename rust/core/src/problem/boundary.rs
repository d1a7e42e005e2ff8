//! Conditions on the ends of records as constraints of the program.

use super::estimands::{Estimands, ParameterMap};
use super::layout::Layout;
use super::posed::Written;
use crate::condition::{Condition, End};
use crate::error::Error;
use crate::experiment::Experiment;
use crate::expr::graph::Id;
use crate::index::{ConstraintId, ExperimentId, IndexVec, ParameterId, StateId, VariableId};
use crate::model::Model;
use crate::nlp::{self, NotFinite, Structure};
use crate::tape::{Arguments, Function, LANE_MULTIPLE, Pairs, Tape, Workspace};

/// The k conditions of each experiment, c(x(t₀), x(t_f), θ) = 0.
#[derive(Debug)]
pub(crate) struct Boundary {
    /// Their names, and the state of each.
    pub conditions: Vec<Condition>,
    pub states: Vec<StateId>,
    f: Function,
    /// Time and inputs at both ends of each experiment, and its last point.
    data: IndexVec<ExperimentId, Vec<f64>>,
    last: IndexVec<ExperimentId, usize>,
    /// First constraint, and first entries of Jacobian and Hessian.
    first_row: ConstraintId,
    jacobian: usize,
    hessian: usize,
}

/// The places of points, and the assignment of variables to parameters.
pub(crate) type Places<'a> = (&'a Layout, &'a Estimands);

impl Boundary {
    /// Evaluates what there is of conditions.
    pub fn evaluate<'a>(
        of: Option<&Boundary>,
        places: Places<'a>,
        work: impl FnOnce(&Boundary, Places<'a>) -> bool,
    ) -> Result<(), NotFinite> {
        if of.is_none_or(|boundary| work(boundary, places)) { Ok(()) } else { Err(NotFinite) }
    }

    /// The conditions of a model, if there are any. `ends` holds for each experiment its last point, counted from
    /// its first, and the times of both.
    ///
    /// # Errors
    /// As [`Function::new`].
    pub fn new(
        model: &Model,
        written: Written,
        experiments: &[Experiment],
        ends: &[(usize, [f64; 2])],
        first_row: ConstraintId,
    ) -> Result<Option<Boundary>, Error> {
        if model.conditions.is_empty() {
            return Ok(None);
        }
        let Written { mut graph, compiled, theta } = written;
        let (conditions, roots) = (&model.conditions, &compiled.conditions);
        let place = |c: &Condition| model.states.iter().position(|s| s.name == c.state).map(StateId);
        let states: Vec<StateId> = conditions.iter().filter_map(place).collect();
        let mut at = |ids: &[Id], end: &str| -> Vec<Id> {
            (0..ids.len()).map(|i| graph.symbol(&format!("{i} {end}"))).collect()
        };
        let x = [at(&compiled.states, "state at the start"), at(&compiled.states, "state at the end")];
        let u = [at(&compiled.data, "datum at the start"), at(&compiled.data, "datum at the end")];
        let own: Vec<Id> = compiled.states.iter().chain(&compiled.data).copied().collect();
        let functions = conditions.iter().zip(roots).zip(&states).map(|((c, &root), &s)| {
            let end = usize::from(c.end != End::Initial);
            let there: Vec<Id> = x[end].iter().chain(&u[end]).copied().collect();
            let right = graph.replace(&[root], &own, &there)[0];
            let left = if c.end == End::Periodic { graph.sub(x[1][s.0], x[0][s.0]) } else { x[end][s.0] };
            graph.sub(left, right)
        });
        let functions: Vec<Id> = functions.collect();
        let arguments = Arguments { data: u.concat(), states: x.concat(), parameters: theta };
        let data = |(e, (_, times)): (&Experiment, &(usize, [f64; 2]))| {
            let channels: Vec<Vec<f64>> = (0..e.inputs.len()).map(|c| e.input(c, times)).collect();
            (0..2).flat_map(|i| std::iter::once(times[i]).chain(channels.iter().map(move |c| c[i]))).collect()
        };
        Ok(Some(Boundary {
            f: Function::new(graph, &arguments, functions, Pairs::Kept)?,
            conditions: conditions.clone(),
            states,
            data: experiments.iter().zip(ends).map(data).collect(),
            last: ends.iter().map(|e| e.0).collect(),
            first_row,
            jacobian: 0,
            hessian: 0,
        }))
    }

    fn experiments(&self) -> impl Iterator<Item = ExperimentId> + use<> {
        (0..self.data.len()).map(ExperimentId)
    }

    /// Number of entries of the Hessian.
    pub fn hessian_entries(&self) -> usize {
        self.f.hessian_pattern.len() * self.data.len()
    }

    /// Number of conditions of an experiment.
    pub fn count(&self) -> usize {
        self.states.len()
    }

    /// Number of all.
    pub fn rows(&self) -> usize {
        self.count() * self.data.len()
    }

    /// First constraint of an experiment.
    pub fn row(&self, experiment: ExperimentId) -> ConstraintId {
        self.first_row + experiment.0 * self.count()
    }

    /// Returns for each of all conditions the state in whose unit it is.
    pub fn all_states(&self) -> Vec<StateId> {
        self.states.repeat(self.data.len())
    }

    /// Returns what the linear algebra must know of the conditions of an experiment.
    pub fn of_chain(&self, experiment: ExperimentId) -> nlp::Boundary {
        nlp::Boundary { row: self.row(experiment), states: self.states.clone() }
    }

    /// Returns the name of a constraint.
    pub fn name(&self, row: ConstraintId, experiments: &IndexVec<ExperimentId, Experiment>) -> String {
        let row = row.0 - self.first_row.0;
        let (e, i) = (ExperimentId(row / self.count()), row % self.count());
        let end = match self.conditions[i].end {
            End::Initial => "initial",
            End::Final => "final",
            End::Periodic => "periodic",
        };
        format!("{end} condition of {} of '{}'", self.conditions[i].state, experiments[e].name)
    }

    /// The variable that a local variable of the function is.
    fn variable(&self, layout: &Layout, map: &ParameterMap, e: ExperimentId, local: usize) -> VariableId {
        let (n, first) = (layout.n_x, layout.first_point[e]);
        match local {
            i if i < n => layout.state(first) + i,
            i if i < 2 * n => layout.state(first + self.last[e]) + (i - n),
            i => map[ParameterId(i - 2 * n)],
        }
    }

    /// Lays out the entries, after all others.
    pub fn place(
        &mut self,
        layout: &Layout,
        estimands: &Estimands,
        (jacobian, hessian): (&mut Structure, &mut Structure),
    ) {
        (self.jacobian, self.hessian) = (jacobian.len(), hessian.len());
        for (e, map) in estimands.maps.numbered() {
            let variable = |local: usize| self.variable(layout, map, e, local).0;
            for (r, c) in self.f.jacobian_pattern.iter() {
                jacobian.push(self.row(e).0 + r, variable(c));
            }
            for (a, b) in self.f.hessian_pattern.iter() {
                let (a, b) = (variable(a), variable(b));
                hessian.push(a.max(b), a.min(b));
            }
        }
    }

    /// Runs a tape for an experiment and hands its results over one by one.
    fn run(
        &self,
        tape: &Tape,
        (layout, estimands): Places<'_>,
        xi: &[f64],
        (e, weights): (ExperimentId, &[f64]),
        mut each: impl FnMut(usize, f64),
    ) {
        let (mut theta, mut uniforms) = (Vec::new(), Vec::new());
        estimands.theta(e, xi, &mut theta);
        tape.uniforms(&theta, &mut uniforms);
        let map = &estimands.maps[e];
        let state = |i: usize| xi[self.variable(layout, map, e, i)];
        let columns = self.data[e].iter().copied().chain((0..2 * layout.n_x).map(state));
        let mut workspace = Workspace::default();
        let registers = workspace.registers(tape, LANE_MULTIPLE);
        let columns = columns.chain(weights.iter().copied());
        for (register, value) in registers.chunks_exact_mut(LANE_MULTIPLE).zip(columns) {
            register.fill(value);
        }
        tape.run(registers, &uniforms, LANE_MULTIPLE);
        for (i, &operand) in tape.outputs.iter().enumerate() {
            each(i, tape.read(operand, registers, &uniforms, LANE_MULTIPLE).at(0));
        }
    }

    /// Writes the constraints; whether all are finite.
    pub fn values(&self, problem: Places<'_>, xi: &[f64], out: &mut [f64]) -> bool {
        let out = &mut out[self.first_row.0..];
        for e in self.experiments() {
            let first = e.0 * self.count();
            self.run(&self.f.value, problem, xi, (e, &[]), |i, v| out[first + i] = v);
        }
        out.iter().all(|v| v.is_finite())
    }

    /// Writes the entries of the Jacobian.
    pub fn jacobian(&self, problem: Places<'_>, xi: &[f64], out: &mut [f64]) -> bool {
        let (count, out) = (self.f.jacobian_pattern.len(), &mut out[self.jacobian..]);
        for e in self.experiments() {
            self.run(&self.f.jacobian, problem, xi, (e, &[]), |i, v| out[e.0 * count + i] = v);
        }
        out.iter().all(|v| v.is_finite())
    }

    /// Writes the entries of Σ λ ∇²c.
    pub fn hessian(&self, problem: Places<'_>, xi: &[f64], lambda: &[f64], out: &mut [f64]) -> bool {
        let (count, out) = (self.f.hessian_pattern.len(), &mut out[self.hessian..]);
        for e in self.experiments() {
            let weights = &lambda[self.row(e).0..][..self.count()];
            self.run(&self.f.hessian, problem, xi, (e, weights), |i, v| out[e.0 * count + i] = v);
        }
        out.iter().all(|v| v.is_finite())
    }
}
