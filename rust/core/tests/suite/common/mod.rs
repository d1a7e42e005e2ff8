//! What several tests need: random numbers, tapes run on lanes, difference quotients.
#![allow(dead_code)] // each test uses a part of it

pub mod flights;
pub mod models;
pub mod newton;
pub mod parse;
pub mod trees;

use std::collections::HashMap;
use std::sync::Arc;

use phugoid::expr::Graph;
use phugoid::internals::graph::Id;
use phugoid::internals::tape::{Inputs, LANE_MULTIPLE, Tape, Workspace};

/// SplitMix64 (Steele, Lea and Flood, 2014): the same numbers on every machine.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A tape's inputs: symbols with one value a lane, and symbols with one value for all.
pub struct Run<'a> {
    pub lanes: Vec<(Id, &'a [f64])>,
    pub uniforms: Vec<(Id, f64)>,
}

impl Run<'_> {
    /// Compiles nodes and evaluates them on `n` lanes: `[output][lane]`.
    pub fn evaluate(&self, graph: &Graph, outputs: &[Id], n: usize) -> Vec<Vec<f64>> {
        let inputs = Inputs {
            lanes: self.lanes.iter().map(|l| l.0).collect(),
            uniforms: self.uniforms.iter().map(|u| u.0).collect(),
        };
        let tape = Tape::compile(graph, &inputs, outputs).unwrap();
        let padded = n.next_multiple_of(LANE_MULTIPLE);
        let mut uniforms = Vec::new();
        tape.uniforms(&self.uniforms.iter().map(|u| u.1).collect::<Vec<f64>>(), &mut uniforms);
        let mut workspace = Workspace::default();
        let registers = workspace.registers(&tape, padded);
        // What is no input must not matter.
        registers.fill(f64::NAN);
        for ((_, values), register) in self.lanes.iter().zip(registers.chunks_exact_mut(padded)) {
            for (l, r) in register.iter_mut().enumerate() {
                *r = values[l.min(n - 1)];
            }
        }
        tape.run(registers, &uniforms, padded);
        let read = |&o| {
            let value = tape.read(o, registers, &uniforms, padded);
            (0..n).map(|l| value.at(l)).collect()
        };
        tape.outputs.iter().map(read).collect()
    }
}

/// Values of symbols, for [`phugoid::expr::Expr::evaluate`].
pub fn values<S: AsRef<str>>(pairs: &[(S, f64)]) -> HashMap<Arc<str>, f64> {
    pairs.iter().map(|(name, value)| (name.as_ref().into(), *value)).collect()
}

/// df/dx by central differences with widths h, h/2, ..., extrapolated to 0 (Richardson).
pub fn slope(f: impl Fn(f64) -> f64, x: f64, h: f64) -> f64 {
    const LEVELS: usize = 5;
    let mut row: Vec<f64> = Vec::new();
    for level in 0..LEVELS {
        let h = h / (1 << level) as f64;
        let (high, low) = (x + h, x - h);
        let mut next = vec![(f(high) - f(low)) / (high - low)];
        for (k, coarse) in row.iter().enumerate() {
            let factor = 4f64.powi(k as i32 + 1);
            next.push((factor * next[k] - coarse) / (factor - 1.0));
        }
        row = next;
    }
    row[LEVELS - 1]
}

/// Whether two numbers agree to a part of the larger, or are both NaN.
pub fn close(a: f64, b: f64, relative: f64) -> bool {
    a == b || (a.is_nan() && b.is_nan()) || (a - b).abs() <= relative * a.abs().max(b.abs())
}

/// Distance between two numbers in units in the last place.
pub fn ulps(a: f64, b: f64) -> u64 {
    if a == b || (a.is_nan() && b.is_nan()) {
        return 0;
    }
    let order = |x: f64| {
        let bits = x.to_bits() as i64;
        if bits < 0 { i64::MIN - bits } else { bits }
    };
    if a.is_nan() || b.is_nan() { u64::MAX } else { order(a).abs_diff(order(b)) }
}
