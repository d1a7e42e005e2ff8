//! Tapes on blocks of points, and the data columns of the points.

use crate::error::Error;
use crate::experiment::Experiment;
use crate::expr::graph::{Graph, Id};
use crate::tape::{Inputs, LANE_MULTIPLE, Tape, Workspace};

/// A tape with its uniforms for the parameters at hand.
#[derive(Clone, Debug)]
pub(super) struct Loaded<'a> {
    tape: &'a Tape,
    uniforms: Vec<f64>,
}

/// Compiles the nodes of a function of `lanes` and parameters.
pub(super) fn compile(
    graph: &Graph,
    lanes: &[&[Id]],
    parameters: &[Id],
    outputs: &[Id],
) -> Result<Tape, Error> {
    let inputs = Inputs { lanes: lanes.concat(), uniforms: parameters.to_vec() };
    Tape::compile(graph, &inputs, outputs)
}

impl<'a> Loaded<'a> {
    pub(super) fn new(tape: &'a Tape, parameters: &[f64]) -> Self {
        let mut uniforms = Vec::new();
        tape.uniforms(parameters, &mut uniforms);
        Loaded { tape, uniforms }
    }

    /// Runs on `lanes` points: groups of columns, each of that length, are its inputs; columns of the outputs,
    /// one after the other, come out.
    pub(super) fn run(&self, workspace: &mut Workspace, lanes: usize, inputs: &[&[f64]], out: &mut [f64]) {
        let registers = workspace.registers(self.tape, lanes);
        let mut at = 0;
        for group in inputs {
            registers[at..at + group.len()].copy_from_slice(group);
            at += group.len();
        }
        self.tape.run(registers, &self.uniforms, lanes);
        for (operand, column) in self.tape.outputs.iter().zip(out.chunks_exact_mut(lanes)) {
            match self.tape.read(*operand, registers, &self.uniforms, lanes) {
                crate::tape::Values::Uniform(u) => column.fill(u),
                crate::tape::Values::Lanes(v) => column.copy_from_slice(v),
            }
        }
    }
}

/// Consecutive points of a record in lanes; lanes after the first `count` repeat the last.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    pub(super) first: usize,
    pub(super) count: usize,
    pub(super) lanes: usize,
}

/// Cuts so many points into blocks.
pub(super) fn blocks(points: usize) -> impl Iterator<Item = Block> {
    // A block of full registers for the largest tapes still fits the second-level cache.
    const POINTS: usize = 64;
    (0..points).step_by(POINTS).map(move |first| {
        let count = POINTS.min(points - first);
        Block { first, count, lanes: count.next_multiple_of(LANE_MULTIPLE) }
    })
}

impl Block {
    /// Rows of n numbers, one a point, as columns of lanes.
    pub(super) fn gather(&self, rows: &[f64], n: usize) -> Vec<f64> {
        let mut out = Vec::with_capacity(n * self.lanes);
        for i in 0..n {
            out.extend((0..self.lanes).map(|l| rows[(self.first + l.min(self.count - 1)) * n + i]));
        }
        out
    }

    /// Adds columns of lanes to rows of n numbers.
    pub(super) fn scatter(&self, columns: &[f64], rows: &mut [f64], n: usize) {
        for (i, column) in columns.chunks_exact(self.lanes).enumerate() {
            for (l, v) in column[..self.count].iter().enumerate() {
                rows[(self.first + l) * n + i] += v;
            }
        }
    }

    /// Columns of a whole record, cut to this block.
    pub(super) fn cut(&self, columns: &[Vec<f64>]) -> Vec<f64> {
        let mut out = Vec::with_capacity(columns.len() * self.lanes);
        for column in columns {
            out.extend((0..self.lanes).map(|l| column[self.first + l.min(self.count - 1)]));
        }
        out
    }
}

/// Time and inputs at given times.
pub(super) fn data_columns(experiment: &Experiment, times: Vec<f64>) -> Vec<Vec<f64>> {
    let inputs: Vec<Vec<f64>> = (0..experiment.inputs.len()).map(|c| experiment.input(c, &times)).collect();
    std::iter::once(times).chain(inputs).collect()
}
