//! The state equations with numbers put in, along the inputs of a record: slopes and their derivatives at a point.

use super::poles::divisors;
use crate::error::Error;
use crate::experiment::Experiment;
use crate::expr::graph::{Graph, Id};
use crate::interpolate::{Interpolant, Interpolation};
use crate::model::Model;
use crate::tape::{Inputs, LANE_MULTIPLE, Tape, Workspace};

/// An input over time: the signal, and by how much it is late.
pub(crate) struct Input<'a> {
    pub name: &'a str,
    pub signal: Interpolant<'a>,
    pub delay: f64,
    held: bool,
    /// The value of a held input inside the interval; at its ends it may jump.
    inside: Option<f64>,
}

/// A tape with the values of the parameters.
struct Kernel {
    tape: Tape,
    uniforms: Vec<f64>,
}

impl Kernel {
    fn new(graph: &Graph, inputs: &Inputs, roots: &[Id], parameters: &[f64]) -> Result<Kernel, Error> {
        let tape = Tape::compile(graph, inputs, roots)?;
        let mut uniforms = Vec::new();
        tape.uniforms(parameters, &mut uniforms);
        Ok(Kernel { tape, uniforms })
    }

    /// Values at a point.
    fn run(&self, point: &[f64], workspace: &mut Workspace, mut each: impl FnMut(usize, f64)) {
        let registers = workspace.registers(&self.tape, LANE_MULTIPLE);
        for (register, value) in registers.chunks_exact_mut(LANE_MULTIPLE).zip(point) {
            register.fill(*value);
        }
        self.tape.run(registers, &self.uniforms, LANE_MULTIPLE);
        for (i, &operand) in self.tape.outputs.iter().enumerate() {
            each(i, self.tape.read(operand, registers, &self.uniforms, LANE_MULTIPLE).at(0));
        }
    }
}

/// A point at which a slope was not finite: time, the point itself, the slopes.
pub(crate) type Bad = (f64, Vec<f64>, Vec<f64>);

/// f(t, x) along the inputs of a record.
pub(crate) struct Field<'a> {
    inputs: Vec<Input<'a>>,
    parameters: &'a [f64],
    graph: Graph,
    symbols: Inputs,
    states: Vec<Id>,
    roots: Vec<Id>,
    dynamics: Kernel,
    outputs: Kernel,
    /// Divisors of the slopes, where there are any.
    divisors: Option<Kernel>,
    /// Which of the divisors a step has come to a pole of.
    pub poles: Vec<usize>,
    /// Made when it is needed: the derivatives, with their rows and columns.
    jacobian: Option<(Kernel, Vec<usize>, Vec<usize>)>,
    workspace: Workspace,
    point: Vec<f64>,
    /// Origin of times: within an interval they then differ for arbitrarily short steps.
    origin: f64,
    /// The end of the interval, and what is taken for it: to the bit, as a hair below zero may have no square root.
    end: (f64, f64),
    /// The last point at which a slope was not finite.
    pub bad: Option<Bad>,
}

impl<'a> Field<'a> {
    pub fn new(model: &Model, inputs: Vec<Input<'a>>, parameters: &'a [f64]) -> Result<Field<'a>, Error> {
        let mut c = model.compile()?;
        let lanes: Vec<Id> = c.data.iter().chain(&c.states).copied().collect();
        let divisors = divisors(&mut c.graph, &c.dynamics, &lanes);
        let symbols = Inputs { lanes, uniforms: c.parameters };
        let kernel = |roots: &[Id]| Kernel::new(&c.graph, &symbols, roots, parameters);
        Ok(Field {
            parameters,
            dynamics: kernel(&c.dynamics)?,
            outputs: kernel(&c.outputs)?,
            divisors: if divisors.is_empty() { None } else { Some(kernel(&divisors)?) },
            poles: Vec::new(),
            jacobian: None,
            workspace: Workspace::default(),
            point: vec![0.0; 1 + inputs.len() + c.states.len()],
            origin: 0.0,
            end: (f64::INFINITY, f64::INFINITY),
            bad: None,
            inputs,
            graph: c.graph,
            symbols,
            states: c.states,
            roots: c.dynamics,
        })
    }

    /// Inputs of a record with delays of the model.
    pub fn inputs_of(
        model: &'a Model,
        run: &'a Experiment,
        delay_of: impl Fn(&str) -> f64,
    ) -> Vec<Input<'a>> {
        let names = model.input_names();
        let one = |input: &'a crate::model::Variable| {
            let (of, delay) = match model.delays.input(&input.name) {
                Some(l) => (l.of.as_str(), delay_of(&l.by)),
                None => (input.name.as_str(), 0.0),
            };
            let place = names.iter().position(|n| *n == of).expect("a late input is one of the model's");
            let (t, u, already) = match run.signals.get(place) {
                Some(Some(s)) => (&s.t, &s.values, s.delay),
                _ => (&run.t, &run.inputs[place], 0.0),
            };
            let kind = run.kind(place);
            let (signal, held) = (Interpolant::new(kind, t, u), kind == Interpolation::Hold);
            Input { name: &input.name, signal, delay: delay + already, held, inside: None }
        };
        model.inputs.iter().map(one).collect()
    }

    /// Counts times from the beginning of an interval until its end.
    pub fn enter(&mut self, begin: f64, end: f64) {
        (self.origin, self.end) = (begin, (end - begin, end));
        for input in self.inputs.iter_mut().filter(|i| i.held) {
            input.inside = (begin < end).then(|| input.signal.over(begin - input.delay, end - input.delay));
        }
    }

    /// Number of states.
    pub fn n(&self) -> usize {
        self.states.len()
    }

    /// Names of the inputs.
    pub fn input_names(&self) -> impl Iterator<Item = &'a str> + '_ {
        self.inputs.iter().map(|i| i.name)
    }

    /// Time, inputs and states so long after the beginning of the interval.
    pub fn point(&mut self, after: f64, x: &[f64]) -> &[f64] {
        let t = if after >= self.end.0 { self.end.1 } else { self.origin + after };
        self.point[0] = t;
        for (p, input) in self.point[1..].iter_mut().zip(&self.inputs) {
            *p = input.inside.unwrap_or_else(|| input.signal.at(t - input.delay));
        }
        self.point[1 + self.inputs.len()..].copy_from_slice(x);
        &self.point
    }

    /// The slope; whether it is finite.
    pub fn slope(&mut self, after: f64, x: &[f64], out: &mut [f64]) -> bool {
        self.point(after, x);
        self.dynamics.run(&self.point, &mut self.workspace, |i, v| out[i] = v);
        let finite = out.iter().all(|v| v.is_finite());
        if !finite && x.iter().all(|v| v.is_finite()) {
            self.bad = Some((self.point[0], self.point.clone(), out.to_vec()));
        }
        finite
    }

    /// The divisors of the slopes; none where nothing is divided.
    pub fn divisors_at(&mut self, after: f64, x: &[f64]) -> Option<Vec<f64>> {
        self.divisors.as_ref()?;
        self.point(after, x);
        let (kernel, mut found) = (self.divisors.as_ref()?, Vec::new());
        kernel.run(&self.point, &mut self.workspace, |_, v| found.push(v));
        Some(found)
    }

    /// The derivatives of the slope with respect to the states, row-major; whether they are finite.
    pub fn jacobian(&mut self, after: f64, x: &[f64], out: &mut [f64]) -> bool {
        self.point(after, x);
        let n = self.n();
        if self.jacobian.is_none() {
            let entries = self.graph.jacobian(&self.roots, &self.states);
            let kernel = Kernel::new(&self.graph, &self.symbols, &entries.values, self.parameters);
            self.jacobian = kernel.ok().map(|kernel| (kernel, entries.rows, entries.columns));
        }
        let Some((kernel, rows, columns)) = &self.jacobian else { return false };
        out.fill(0.0);
        kernel.run(&self.point, &mut self.workspace, |i, v| out[rows[i] * n + columns[i]] = v);
        out.iter().all(|v| v.is_finite())
    }

    /// Outputs at a time, counted as everywhere else.
    pub fn outputs(&mut self, t: f64, x: &[f64], out: &mut [f64]) {
        self.enter(t, t);
        self.point(0.0, x);
        self.outputs.run(&self.point, &mut self.workspace, |i, v| out[i] = v);
    }
}
