//! f and g of a model at given points: for simulation and for looking at a model.

use crate::error::Error;
use crate::model::Model;
use crate::tape::{Inputs, LANE_MULTIPLE, Tape, Workspace};

/// The state equations and outputs of a model, compiled.
#[derive(Clone, Debug)]
pub struct Evaluator {
    dynamics: Tape,
    outputs: Tape,
    n_data: usize,
    n_states: usize,
}

impl Evaluator {
    /// Compiles a model.
    ///
    /// # Errors
    /// As [`Model::check`].
    pub fn new(model: &Model) -> Result<Self, Error> {
        let c = model.compile()?;
        let lanes = c.data.iter().chain(&c.states).copied().collect();
        let inputs = Inputs { lanes, uniforms: c.parameters };
        let dynamics = Tape::compile(&c.graph, &inputs, &c.dynamics)?;
        let outputs = Tape::compile(&c.graph, &inputs, &c.outputs)?;
        Ok(Evaluator { dynamics, outputs, n_data: c.data.len(), n_states: c.states.len() })
    }

    /// Number of columns that a point has: time, inputs, states.
    pub fn columns(&self) -> usize {
        self.n_data + self.n_states
    }

    /// ẋ at points: `columns` holds time, inputs and states, each of n points; n_x columns come back.
    ///
    /// # Errors
    /// When a column has another length than others, their number is not [`Evaluator::columns`], or that of the
    /// parameters not the model's.
    pub fn dynamics(&self, parameters: &[f64], columns: &[&[f64]]) -> Result<Vec<Vec<f64>>, Error> {
        self.check(parameters, columns)?;
        Ok(at_points(&self.dynamics, parameters, columns))
    }

    /// y at points, as [`Evaluator::dynamics`].
    ///
    /// # Errors
    /// As [`Evaluator::dynamics`].
    pub fn outputs(&self, parameters: &[f64], columns: &[&[f64]]) -> Result<Vec<Vec<f64>>, Error> {
        self.check(parameters, columns)?;
        Ok(at_points(&self.outputs, parameters, columns))
    }

    fn check(&self, parameters: &[f64], columns: &[&[f64]]) -> Result<(), Error> {
        let fail = |text: String| Err(Error::data(format!("points: {text}")));
        if columns.len() != self.columns() {
            return fail(format!(
                "{} columns were given, the model takes {}: time, inputs, states",
                columns.len(),
                self.columns()
            ));
        }
        if let Some(k) = columns.iter().position(|c| c.len() != columns[0].len()) {
            return fail(format!(
                "column {k} has {} points, column 0 has {}",
                columns[k].len(),
                columns[0].len()
            ));
        }
        let n = self.dynamics.n_uniform_inputs;
        if parameters.len() != n {
            return fail(format!("{} parameters were given, the model has {n}", parameters.len()));
        }
        Ok(())
    }
}

/// Values of a tape at points, one column for each of its outputs.
pub(crate) fn at_points(tape: &Tape, parameters: &[f64], columns: &[&[f64]]) -> Vec<Vec<f64>> {
    let n = columns[0].len();
    let lanes = n.next_multiple_of(LANE_MULTIPLE);
    let mut uniforms = Vec::new();
    tape.uniforms(parameters, &mut uniforms);
    let mut workspace = Workspace::default();
    let registers = workspace.registers(tape, lanes);
    for (column, register) in columns.iter().zip(registers.chunks_exact_mut(lanes.max(1))) {
        register[..n].copy_from_slice(column);
        register[n..].fill(column.last().copied().unwrap_or(0.0));
    }
    tape.run(registers, &uniforms, lanes);
    let read = |&operand| {
        let value = tape.read(operand, registers, &uniforms, lanes);
        (0..n).map(|l| value.at(l)).collect()
    };
    tape.outputs.iter().map(read).collect()
}
