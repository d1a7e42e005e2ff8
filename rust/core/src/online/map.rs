//! The solution of the state equations from one node of the window to the next, with its exact derivatives: those of the
//! Runge-Kutta steps of [`integrate`](crate::integrate).

use crate::error::Error;
use crate::index::{ExperimentId, PointId};
use crate::integrate::Integrator;
use crate::integrate::flow::{Flow, Memory};
use crate::integrate::group::{Group, Lane};
use crate::integrate::tableau::Tableau;
use crate::model::Compiled;
use crate::tape::{Arguments, Function, LANE_MULTIPLE, Pairs};

/// Time and inputs at a node.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment<'a> {
    pub(super) t: f64,
    pub(super) inputs: &'a [f64],
}

/// The state equations with their derivatives, compiled, and the memory of an integration.
pub(super) struct Map {
    f: Function,
    tableau: Tableau,
    group: Group,
    memory: Memory,
    /// Values that depend on parameters alone, of the tapes of f and ∂f.
    uniforms: Vec<f64>,
    slopes: Vec<f64>,
    /// Whether each input is held.
    held: Vec<bool>,
    /// Number of the model's parameters.
    n_p: usize,
}

impl Map {
    pub(super) fn new(
        c: &Compiled,
        integrator: Integrator,
        substeps: usize,
        held: Vec<bool>,
    ) -> Result<Map, Error> {
        let arguments =
            Arguments { data: c.data.clone(), states: c.states.clone(), parameters: c.parameters.clone() };
        let f = Function::new(c.graph.clone(), &arguments, c.dynamics.clone(), Pairs::Absent)?;
        let tableau = integrator.tableau();
        let points = substeps * tableau.b.len();
        let group = Group {
            experiment: ExperimentId(0),
            width: 1,
            n: 1,
            node: PointId(0),
            last: true,
            steps: substeps,
            h: vec![0.0; substeps],
            data: vec![0.0; (points + 1) * f.n_data],
            samples: Vec::new(),
            points,
        };
        let n_p = c.parameters.len();
        let mut map = Map {
            f,
            tableau,
            group,
            memory: Memory::default(),
            uniforms: Vec::new(),
            slopes: Vec::new(),
            held,
            n_p,
        };
        // All memory is there after a first run, whatever comes of it.
        map.load(&vec![0.0; n_p]);
        let (from, to) = (vec![0.0; map.held.len()], vec![0.0; map.held.len()]);
        let moment = |t, inputs| Moment { t, inputs };
        let n = map.f.n_states;
        map.end(moment(0.0, &from), moment(1.0, &to), &vec![0.0; n]);
        map.linearise();
        Ok(map)
    }

    /// Takes values of all parameters.
    pub(super) fn load(&mut self, parameters: &[f64]) {
        self.f.value.uniforms(parameters, &mut self.uniforms);
        self.f.jacobian.uniforms(parameters, &mut self.slopes);
    }

    /// Inputs between two nodes: straight lines, or held.
    fn fill(&mut self, from: Moment<'_>, to: Moment<'_>) {
        let (steps, columns, stages) = (self.group.steps, self.f.n_data, self.tableau.c.len());
        let length = to.t - from.t;
        self.group.h.fill(length / steps as f64);
        for (point, data) in self.group.data.chunks_exact_mut(columns).enumerate() {
            let (step, stage) = (point / stages, point % stages);
            let share =
                if step == steps { 1.0 } else { (step as f64 + self.tableau.c[stage]) / steps as f64 };
            data[0] = from.t + share * length;
            let ends = from.inputs.iter().zip(to.inputs).zip(&self.held);
            for (value, ((a, b), held)) in data[1..].iter_mut().zip(ends) {
                *value = if *held { *a } else { a + share * (b - a) };
            }
        }
    }

    fn flow(&self) -> Flow<'_> {
        Flow { f: &self.f, tableau: &self.tableau, group: &self.group, n_p: self.n_p }
    }

    /// Integrates from a state at a node to the next; whether it stays finite.
    pub(super) fn end(&mut self, from: Moment<'_>, to: Moment<'_>, x: &[f64]) -> bool {
        self.fill(from, to);
        let mut memory = std::mem::take(&mut self.memory);
        let done = self.flow().forward::<1>(x, &[], &self.uniforms, &mut memory);
        self.memory = memory;
        done
    }

    /// The state at the end of the last integration.
    pub(super) fn state(&self) -> &[f64] {
        &self.memory.points.x[self.flow().at_step(self.group.steps)..][..self.f.n_states]
    }

    /// Derivatives of the last integration; whether they are finite.
    pub(super) fn linearise(&mut self) -> bool {
        let mut memory = std::mem::take(&mut self.memory);
        let flow = self.flow();
        let done = flow.linearise::<1>(&self.slopes, &mut memory) && flow.sensitivities::<1>(&mut memory);
        self.memory = memory;
        done
    }

    /// Hands out the derivatives of the states at the end: `(state, q)`, q a state, or behind these a parameter of the model.
    pub(super) fn with_slopes(&self, mut put: impl FnMut(&dyn Fn(usize, usize) -> f64)) {
        put(&self.flow().end::<1>(Lane(0), &self.memory));
    }

    /// Operations of an integration with its derivatives.
    pub(super) fn flops(&self) -> u64 {
        let (n, q) = (self.f.n_states, self.f.n_states + self.n_p);
        let (stages, steps) = (self.tableau.b.len(), self.group.steps);
        let values = steps * stages * self.f.value.instructions() * LANE_MULTIPLE;
        let slopes = (steps * stages).next_multiple_of(LANE_MULTIPLE) * self.f.jacobian.instructions();
        let chain = steps * stages * 2 * (self.f.jacobian_pattern.len() * q + n * q * stages);
        (values + slopes + chain) as u64
    }
}
