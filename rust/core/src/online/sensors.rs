//! The outputs at a node of the window, with their derivatives by states and parameters.

use super::map::Moment;
use crate::error::Error;
use crate::model::Compiled;
use crate::tape::{Arguments, Function, LANE_MULTIPLE, Pairs, Tape, Workspace};

/// The output equations with their derivatives, compiled.
pub(super) struct Sensors {
    g: Function,
    workspace: Workspace,
    uniforms: Vec<f64>,
    slopes: Vec<f64>,
}

impl Sensors {
    pub(super) fn new(c: &Compiled) -> Result<Sensors, Error> {
        let arguments =
            Arguments { data: c.data.clone(), states: c.states.clone(), parameters: c.parameters.clone() };
        let g = Function::new(c.graph.clone(), &arguments, c.outputs.clone(), Pairs::Absent)?;
        let mut sensors =
            Sensors { g, workspace: Workspace::default(), uniforms: Vec::new(), slopes: Vec::new() };
        // All memory is there from here on.
        sensors.load(&vec![0.0; c.parameters.len()]);
        sensors.workspace.registers(&sensors.g.value, LANE_MULTIPLE);
        sensors.workspace.registers(&sensors.g.jacobian, LANE_MULTIPLE);
        Ok(sensors)
    }

    /// Takes values of all parameters.
    pub(super) fn load(&mut self, parameters: &[f64]) {
        self.g.value.uniforms(parameters, &mut self.uniforms);
        self.g.jacobian.uniforms(parameters, &mut self.slopes);
    }

    /// Outputs at a node.
    pub(super) fn values(&mut self, at: Moment<'_>, x: &[f64], out: &mut [f64]) {
        run(&self.g.value, &self.uniforms, &mut self.workspace, (at, x), |i, v| out[i] = v);
    }

    /// Derivatives of outputs at a node: each that may not vanish by output, column (a state, or behind these a parameter of the
    /// model) and value.
    pub(super) fn slopes(&mut self, at: Moment<'_>, x: &[f64], mut put: impl FnMut(usize, usize, f64)) {
        let pattern = &self.g.jacobian_pattern;
        run(&self.g.jacobian, &self.slopes, &mut self.workspace, (at, x), |i, v| {
            put(pattern.rows[i], pattern.columns[i], v);
        });
    }

    /// Operations of values and derivatives.
    pub(super) fn flops(&self) -> u64 {
        ((self.g.value.instructions() + self.g.jacobian.instructions()) * LANE_MULTIPLE) as u64
    }
}

/// Runs a tape at one point.
fn run(
    tape: &Tape,
    uniforms: &[f64],
    workspace: &mut Workspace,
    (at, x): (Moment<'_>, &[f64]),
    mut put: impl FnMut(usize, f64),
) {
    let registers = workspace.registers(tape, LANE_MULTIPLE);
    let point = std::iter::once(&at.t).chain(at.inputs).chain(x);
    for (register, value) in registers.chunks_exact_mut(LANE_MULTIPLE).zip(point) {
        register.fill(*value);
    }
    tape.run(registers, uniforms, LANE_MULTIPLE);
    for (i, operand) in tape.outputs.iter().enumerate() {
        put(i, tape.read(*operand, registers, uniforms, LANE_MULTIPLE).at(0));
    }
}
