//! The integration of a group of segments, and its exact derivatives: those of the steps as they are taken.
//!
//! Forward, x at the stages, one after the other; ∂f at all of them at once, in lanes; sensitivities S of the
//! stages with respect to q = (x at the start, constants of the segment, θ), by the chain rule, which takes the same
//! steps. The way back is [`adjoint`](super::adjoint).
//!
//! Arrays have the lanes last: `x[(point·n_x + state)·W + lane]`. The dense algebra is in plain loops over arrays of
//! W lanes, or for W = 1 over q: short, and few beside the tapes.

use super::group::{Group, Lane, Sampled};
use super::tableau::Tableau;
use crate::interrupt::current;
use crate::tape::{BLOCK, Function, LANE_MULTIPLE, Tape, Workspace};

/// A group with what its integration needs.
#[derive(Clone, Copy)]
pub(crate) struct Flow<'a> {
    /// Slopes of the states; the states beyond those that have one are constants of a segment.
    pub(crate) f: &'a Function,
    pub(crate) tableau: &'a Tableau,
    pub(crate) group: &'a Group,
    /// Number of parameters in q: the first ones.
    pub(crate) n_p: usize,
}

/// The points at which f is evaluated.
#[derive(Clone, Debug, Default)]
pub(crate) struct Points {
    /// x at the points.
    pub(crate) x: Vec<f64>,
    /// Constants of the segments: `constants[constant·W + lane]`.
    pub(crate) constants: Vec<f64>,
}

/// The memory of an integration on a thread; it grows to the largest group.
#[derive(Default)]
pub(crate) struct Memory {
    pub(super) workspace: Workspace,
    pub(crate) points: Points,
    /// ẋ at the points.
    pub(super) k: Vec<f64>,
    /// Entries of ∂f at the points.
    pub(super) jacobian: Vec<f64>,
    /// Sensitivities of x and ẋ.
    pub(super) sx: Vec<f64>,
    pub(super) sk: Vec<f64>,
    /// Adjoints of x where steps end, and of ẋ at the points.
    pub(crate) ax: Vec<f64>,
    pub(super) kappa: Vec<f64>,
    /// Entries of ∇²(κᵀf) at the points, and a product with S.
    pub(super) second: Vec<f64>,
    pub(crate) product: Vec<f64>,
    /// Sums of second derivatives: of lanes side by side, and of samples lane by lane.
    pub(crate) sums: Vec<f64>,
    pub(crate) own: Vec<f64>,
    pub(crate) sensitivity: Vec<f64>,
}

pub(super) fn zeroed(v: &mut Vec<f64>, n: usize) {
    v.clear();
    v.resize(n, 0.0);
}

/// to += a · from, lane by lane.
#[inline(always)]
pub(super) fn add<const W: usize>(to: &mut [f64], a: [f64; W], from: &[f64]) {
    for (t, f) in to.as_chunks_mut::<W>().0.iter_mut().zip(from.as_chunks::<W>().0) {
        for l in 0..W {
            t[l] += a[l] * f[l];
        }
    }
}

#[inline(always)]
pub(super) fn lanes<const W: usize>(v: &[f64], at: usize) -> [f64; W] {
    *v[at * W..].first_chunk().expect("lanes enough")
}

/// Fills registers with lanes of inputs, which are repeated where registers are longer.
#[inline(always)]
pub(super) fn fill<'a, const W: usize>(
    registers: impl Iterator<Item = &'a mut [f64]>,
    inputs: impl Iterator<Item = &'a [f64; W]>,
) {
    for (register, lanes) in registers.zip(inputs) {
        register.chunks_exact_mut(W).for_each(|to| to.copy_from_slice(lanes));
    }
}

/// Weights that are not zero, each with what it belongs to.
#[inline(always)]
pub(super) fn weighted<T>(weights: &[f64], all: impl Iterator<Item = T>) -> impl Iterator<Item = (f64, T)> {
    weights.iter().copied().zip(all).filter(|(w, _)| *w != 0.0)
}

impl Flow<'_> {
    /// Number of states.
    pub(super) fn n_x(&self) -> usize {
        self.f.roots.len()
    }

    /// Length of q.
    pub(crate) fn n_q(&self) -> usize {
        self.f.n_states + self.n_p
    }

    pub(super) fn stages(&self) -> usize {
        self.tableau.b.len()
    }

    /// Returns the place of x at the end of a number of steps, times W.
    pub(crate) fn at_step(&self, step: usize) -> usize {
        step * self.stages() * self.n_x()
    }

    /// Rows of numbers, one a segment, as columns of lanes.
    fn columns<const W: usize>(&self, rows: &[f64], out: &mut [f64]) {
        let n = out.len() / W;
        for (at, out) in out.iter_mut().enumerate() {
            *out = rows[(at % W).min(self.group.n - 1) * n + at / W];
        }
    }

    /// Integrates from x at the nodes, with constants, both rows of the segments; whether all states are finite.
    pub(crate) fn forward<const W: usize>(
        &self,
        nodes: &[f64],
        constants: &[f64],
        uniforms: &[f64],
        m: &mut Memory,
    ) -> bool {
        let (n_x, points) = (self.n_x(), self.group.steps * self.stages() + 1);
        zeroed(&mut m.points.x, points * n_x * W);
        zeroed(&mut m.k, points * n_x * W);
        zeroed(&mut m.points.constants, (self.f.n_states - n_x) * W);
        self.columns::<W>(nodes, &mut m.points.x[..n_x * W]);
        self.columns::<W>(constants, &mut m.points.constants);
        let (tape, columns, n) = (&self.f.value, self.f.n_data, W.max(LANE_MULTIPLE));
        let Memory { workspace, points: Points { x, constants }, k, .. } = m;
        let constants = constants.as_chunks::<W>().0;
        let slope = |point: usize, x: &[f64], k: &mut [f64]| {
            let registers = workspace.registers(tape, n);
            let data = self.group.data[point * columns * W..][..columns * W].as_chunks::<W>().0;
            let inputs = data.iter().chain(x.as_chunks::<W>().0).chain(constants);
            fill(registers.chunks_exact_mut(n), inputs);
            tape.run(registers, uniforms, n);
            for (operand, k) in tape.outputs.iter().zip(k.as_chunks_mut::<W>().0) {
                let value = tape.read(*operand, registers, uniforms, n);
                *k = std::array::from_fn(|l| value.at(l));
            }
        };
        self.steps::<W>(tape.instructions() * n, x, k, slope) && m.points.x.iter().all(|x| x.is_finite())
    }

    /// Takes the steps of a system, of which x at the first point is given: x at all points, and its slopes k, which
    /// `slope` gives at one and takes about so many operations for. Whether it came to the end.
    fn steps<const W: usize>(
        &self,
        operations: usize,
        x: &mut [f64],
        k: &mut [f64],
        mut slope: impl FnMut(usize, &[f64], &mut [f64]),
    ) -> bool {
        let (s, steps) = (self.stages(), self.group.steps);
        let size = x.len() / (steps * s + 1);
        // A single shot goes over the whole record.
        let mut turns = current().turns(s * operations);
        for i in 0..steps {
            if turns.stop() {
                return false;
            }
            let (first, h) = (i * s, lanes::<W>(&self.group.h, i));
            for j in 0..=s {
                let weights = if j < s { &self.tableau.a[j] } else { &self.tableau.b };
                let (before, rest) = x.split_at_mut((first + j) * size);
                if j > 0 {
                    let x = &mut rest[..size];
                    x.copy_from_slice(&before[first * size..][..size]);
                    for (w, k) in weighted(weights, k[first * size..].chunks_exact(size)) {
                        add::<W>(x, h.map(|h| h * w), k);
                    }
                }
                if j < s {
                    slope(first + j, &rest[..size], &mut k[(first + j) * size..][..size]);
                }
            }
        }
        if self.group.points > steps * s {
            let at = steps * s * size;
            slope(steps * s, &x[at..at + size], &mut k[at..at + size]);
        }
        true
    }

    /// Outputs of a tape at all points, `out[(point·outputs + output)·W + lane]`; `weights` as x, where it has them.
    /// Whether it came to the end.
    pub(super) fn everywhere<const W: usize>(
        &self,
        tape: &Tape,
        uniforms: &[f64],
        weights: bool,
        m: &mut Memory,
        out: &mut Vec<f64>,
    ) -> bool {
        let (n_x, columns, count) = (self.n_x(), self.f.n_data, tape.outputs.len());
        zeroed(out, self.group.points * count * W);
        let block = BLOCK / W;
        let mut turns = current().turns(BLOCK * (tape.instructions() + count));
        for first in (0..self.group.points).step_by(block) {
            if turns.stop() {
                return false;
            }
            let points = block.min(self.group.points - first);
            let n = (points * W).next_multiple_of(LANE_MULTIPLE);
            let registers = m.workspace.registers(tape, n);
            let mut free = registers.chunks_exact_mut(n);
            let mut column = |from: &[f64], c: usize, of: usize| {
                for (l, to) in free.next().expect("as many as inputs").chunks_exact_mut(W).enumerate() {
                    // Spare lanes repeat the last point.
                    let point = first + l.min(points - 1);
                    to.copy_from_slice(&from[(point * of + c) * W..][..W]);
                }
            };
            (0..columns).for_each(|c| column(&self.group.data, c, columns));
            (0..n_x).for_each(|r| column(&m.points.x, r, n_x));
            (0..self.f.n_states - n_x).for_each(|c| column(&m.points.constants, c, 0));
            if weights {
                (0..n_x).for_each(|r| column(&m.kappa, r, n_x));
            }
            tape.run(registers, uniforms, n);
            for (o, operand) in tape.outputs.iter().enumerate() {
                let value = tape.read(*operand, registers, uniforms, n);
                for l in 0..points * W {
                    out[((first + l / W) * count + o) * W + l % W] = value.at(l);
                }
            }
        }
        true
    }

    /// ∂f at all points; whether all are finite.
    pub(crate) fn linearise<const W: usize>(&self, uniforms: &[f64], m: &mut Memory) -> bool {
        let mut out = std::mem::take(&mut m.jacobian);
        let done = self.everywhere::<W>(&self.f.jacobian, uniforms, false, m, &mut out);
        m.jacobian = out;
        done && m.jacobian.iter().all(|v| v.is_finite())
    }

    /// S at all points; whether it came to the end.
    pub(crate) fn sensitivities<const W: usize>(&self, m: &mut Memory) -> bool {
        let (n_x, n_q, points) = (self.n_x(), self.n_q(), self.group.steps * self.stages() + 1);
        let size = n_x * n_q * W;
        zeroed(&mut m.sx, points * size);
        zeroed(&mut m.sk, points * size);
        for r in 0..n_x {
            m.sx[(r * n_q + r) * W..][..W].fill(1.0);
        }
        let (pattern, Memory { jacobian, sx, sk, .. }) = (&self.f.jacobian_pattern, m);
        // ∂f/∂x S + ∂f/∂(constants, θ)
        self.steps::<W>(size * (n_x + self.stages()), sx, sk, |point, sx, sk| {
            for (e, (r, c)) in pattern.iter().enumerate() {
                let v = lanes::<W>(jacobian, point * pattern.len() + e);
                if c < n_x {
                    add::<W>(&mut sk[r * n_q * W..][..n_q * W], v, &sx[c * n_q * W..][..n_q * W]);
                } else if c < n_q {
                    add::<W>(&mut sk[(r * n_q + c) * W..][..W], v, &[1.0; W]);
                }
            }
        })
    }

    /// ∂x/∂q at the end of a lane: `(state, q)`.
    pub(crate) fn end<const W: usize>(&self, lane: Lane, m: &Memory) -> impl Fn(usize, usize) -> f64 {
        let (n_q, at) = (self.n_q(), self.at_step(self.group.steps) * self.n_q() * W);
        move |r, q| m.sx[at + (r * n_q + q) * W + lane.0]
    }

    /// A combination at a sample of an array over the points, of which `size` entries belong to a point, and of that
    /// of its derivatives.
    fn combined<const W: usize>(
        &self,
        sample: &Sampled,
        (x, k): (&[f64], &[f64]),
        size: usize,
        mut put: impl FnMut(usize, f64),
    ) {
        let begin = sample.step * self.stages() * size * W + sample.lane.0;
        match sample.weights {
            None => (0..size).for_each(|i| put(i, x[begin + i * W])),
            Some(w) => {
                let end = begin + self.stages() * size * W;
                for i in (0..size).map(|i| i * W) {
                    let own = w[0] * x[begin + i] + w[1] * k[begin + i];
                    put(i / W, own + w[2] * x[end + i] + w[3] * k[end + i]);
                }
            }
        }
    }

    /// x at a sample.
    pub(crate) fn state<const W: usize>(&self, sample: &Sampled, m: &Memory, put: impl FnMut(usize, f64)) {
        self.combined::<W>(sample, (&m.points.x, &m.k), self.n_x(), put);
    }

    /// S at a sample, into `m.sensitivity`, `[state·n_q + q]`.
    pub(crate) fn sample_sensitivity<const W: usize>(&self, sample: &Sampled, m: &mut Memory) {
        let mut out = std::mem::take(&mut m.sensitivity);
        let size = self.n_x() * self.n_q();
        zeroed(&mut out, size);
        self.combined::<W>(sample, (&m.sx, &m.sk), size, |i, v| out[i] = v);
        m.sensitivity = out;
    }
}
