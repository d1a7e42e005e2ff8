//! The way back through the steps: adjoints κ of the slopes at all points, from multipliers at the ends of segments and
//! the gradient at the samples. They give the gradient by x at the start, constants and parameters, and the second
//! derivative, Σ Sᵀ ∇²(κᵀf) S over the points.
//!
//! ∂f is either there already ([`Flow::linearise`]), or its product with κ is a tape of its own ([`Adjoint`]), as is
//! better where f is large and no sensitivities are wanted.

use super::flow::{Flow, Memory, Points, add, fill, lanes, weighted, zeroed};
use super::group::{Lane, Sampled};
use crate::error::Error;
use crate::expr::graph::{Graph, Id};
use crate::interrupt::current;
use crate::tape::{Arguments, Inputs, LANE_MULTIPLE, Tape};

/// The gradient of a weighted sum of slopes by states, constants and parameters, compiled.
#[derive(Clone, Debug)]
pub(crate) struct Adjoint {
    tape: Tape,
    /// The variables of the derivatives: the states, constants, then parameters.
    places: Vec<usize>,
}

impl Adjoint {
    /// Prepares derivatives by the first `n` of states and constants, and all parameters.
    pub(crate) fn new(
        mut graph: Graph,
        arguments: &Arguments,
        slopes: &[Id],
        n: usize,
    ) -> Result<Adjoint, Error> {
        let Arguments { data, states, parameters } = arguments;
        let weights = graph.symbols("weight of slope", slopes.len());
        let sum = graph.weighted_sum(&weights, slopes);
        let gradient = graph.gradient(sum, &[&states[..n], parameters].concat());
        let place = |i: usize| if i < n { i } else { i - n + states.len() };
        let there = gradient.iter().enumerate().filter_map(|(i, d)| d.map(|d| (place(i), d)));
        let (places, nodes): (Vec<usize>, Vec<Id>) = there.unzip();
        let lanes = [&data[..], states, &weights].concat();
        let inputs = Inputs { lanes, uniforms: parameters.clone() };
        Ok(Adjoint { tape: Tape::compile(&graph, &inputs, &nodes)?, places })
    }

    /// Returns the uniform values at given parameters.
    pub(crate) fn uniforms(&self, parameters: &[f64]) -> Vec<f64> {
        let mut out = Vec::new();
        self.tape.uniforms(parameters, &mut out);
        out
    }
}

impl Flow<'_> {
    /// Takes the steps back: adjoints of x where they end, from those that are in `ax`, and of the slopes at all
    /// points, added to those in `kappa`. `pull` adds (∂f/∂x)ᵀκ at a point, and takes about so many operations.
    /// Whether it came to the beginning.
    fn steps_back<const W: usize>(
        &self,
        operations: usize,
        ax: &mut [f64],
        kappa: &mut [f64],
        mut pull: impl FnMut(usize, &[f64], &mut [f64]),
    ) -> bool {
        let (s, steps, size) = (self.stages(), self.group.steps, self.n_x() * W);
        let mut pulled = vec![0.0; size];
        let mut turns = current().turns(s * operations);
        for i in (0..steps).rev() {
            if turns.stop() {
                return false;
            }
            let (first, h) = (i * s, lanes::<W>(&self.group.h, i));
            let (before, after) = ax.split_at_mut((i + 1) * size);
            let ax = &mut before[i * size..];
            add::<W>(ax, [1.0; W], &after[..size]);
            for (b, kappa) in weighted(&self.tableau.b, kappa[first * size..].chunks_exact_mut(size)) {
                add::<W>(kappa, h.map(|h| h * b), &after[..size]);
            }
            for j in (0..s).rev() {
                pulled.fill(0.0);
                let (earlier, kappa) = kappa.split_at_mut((first + j) * size);
                pull(first + j, &kappa[..size], &mut pulled);
                add::<W>(ax, [1.0; W], &pulled);
                let earlier = earlier[first * size..].chunks_exact_mut(size);
                for (a, kappa) in weighted(&self.tableau.a[j], earlier) {
                    add::<W>(kappa, h.map(|h| h * a), &pulled);
                }
            }
        }
        true
    }

    /// Adjoints of a function of x at the samples and the ends: κ at all points, and that of x at the start, the first
    /// of `m.ax`. `gradient(sample, state)` is its derivative at a sample, `end(lane, state)` at an end. Whether it came
    /// to the end.
    pub(crate) fn backward<const W: usize>(
        &self,
        m: &mut Memory,
        gradient: impl Fn(&Sampled, usize) -> f64,
        end: impl Fn(Lane, usize) -> f64,
    ) -> bool {
        let (n_x, s, steps) = (self.n_x(), self.stages(), self.group.steps);
        let size = n_x * W;
        self.seed::<W>(m, end);
        for sample in &self.group.samples {
            for r in 0..n_x {
                let (g, at) = (gradient(sample, r), r * W + sample.lane.0);
                match sample.weights {
                    None => m.ax[sample.step * size + at] += g,
                    Some(w) => {
                        m.ax[sample.step * size + at] += w[0] * g;
                        m.kappa[sample.step * s * size + at] += w[1] * g;
                        m.ax[(sample.step + 1) * size + at] += w[2] * g;
                        m.kappa[(sample.step + 1) * s * size + at] += w[3] * g;
                    }
                }
            }
        }
        let (pattern, Memory { jacobian, ax, kappa, .. }) = (&self.f.jacobian_pattern, m);
        let transposed = |point: usize, kappa: &[f64], to: &mut [f64]| {
            for (e, (r, c)) in pattern.iter().enumerate().filter(|(_, (_, c))| *c < n_x) {
                let v = lanes::<W>(jacobian, point * pattern.len() + e);
                add::<W>(&mut to[c * W..][..W], v, &kappa[r * W..][..W]);
            }
        };
        if self.group.points > steps * s {
            transposed(steps * s, &kappa[steps * s * size..], &mut ax[steps * size..]);
        }
        self.steps_back::<W>(size * (n_x + s), ax, kappa, transposed)
    }

    /// No adjoints but those of the ends, `end(lane, state)`.
    fn seed<const W: usize>(&self, m: &mut Memory, end: impl Fn(Lane, usize) -> f64) {
        let (steps, size) = (self.group.steps, self.n_x() * W);
        zeroed(&mut m.ax, (steps + 1) * size);
        zeroed(&mut m.kappa, (steps * self.stages() + 1) * size);
        for (at, ax) in m.ax[steps * size..].iter_mut().enumerate().filter(|(at, _)| at % W < self.group.n) {
            *ax = end(Lane(at % W), at / W);
        }
    }

    /// The gradient of a function of x at the ends, `end(lane, state)` its derivative there: by x at the start, the
    /// first of `m.ax`; by constants in `m.sums`, `[constant·W + lane]`; by parameters, added to `out`. `points` are
    /// those of an integration. Whether it came to the end.
    pub(crate) fn pull_back<const W: usize>(
        &self,
        (adjoint, uniforms): (&Adjoint, &[f64]),
        points: &Points,
        m: &mut Memory,
        end: impl Fn(Lane, usize) -> f64,
        out: &mut [f64],
    ) -> bool {
        self.seed::<W>(m, end);
        let Memory { workspace, ax, kappa, sums, .. } = m;
        zeroed(sums, points.constants.len());
        let (tape, places) = (&adjoint.tape, &adjoint.places);
        let (columns, n) = (self.f.n_data, W.max(LANE_MULTIPLE));
        let (size, n_states) = (self.n_x() * W, self.f.n_states);
        let constants = points.constants.as_chunks::<W>().0;
        let pull = |point: usize, kappa: &[f64], to: &mut [f64]| {
            let registers = workspace.registers(tape, n);
            let data = self.group.data[point * columns * W..][..columns * W].as_chunks::<W>().0;
            let x = points.x[point * size..][..size].as_chunks::<W>().0;
            let inputs = data.iter().chain(x).chain(constants).chain(kappa.as_chunks::<W>().0);
            fill(registers.chunks_exact_mut(n), inputs);
            tape.run(registers, uniforms, n);
            for (&place, operand) in places.iter().zip(&tape.outputs) {
                let value = tape.read(*operand, registers, uniforms, n);
                let add = |to: &mut [f64]| to.iter_mut().enumerate().for_each(|(l, to)| *to += value.at(l));
                match place {
                    _ if place * W < size => add(&mut to[place * W..][..W]),
                    _ if place < n_states => add(&mut sums[place * W - size..][..W]),
                    _ => out[place - n_states] += (0..self.group.n).map(|l| value.at(l)).sum::<f64>(),
                }
            }
        };
        self.steps_back::<W>(tape.instructions() * n, ax, kappa, pull)
    }

    /// Adds Σ (∂f/∂θ)ᵀ κ over points and lanes.
    pub(crate) fn parameter_gradient<const W: usize>(&self, m: &Memory, out: &mut [f64]) {
        let (pattern, n_x, n_states) = (&self.f.jacobian_pattern, self.n_x(), self.f.n_states);
        for point in 0..self.group.points {
            for (e, (r, c)) in pattern.iter().enumerate().filter(|(_, (_, c))| *c >= n_states) {
                let v = lanes::<W>(&m.jacobian, point * pattern.len() + e);
                let kappa = lanes::<W>(&m.kappa, point * n_x + r);
                out[c - n_states] += (0..W).map(|l| v[l] * kappa[l]).sum::<f64>();
            }
        }
    }

    /// Adds Σ Sᵀ ∇²(κᵀf) S over the points to `m.sums`, `[(a·n_Q + b)·W + lane]` for a ≥ b; n_Q counts the noise's
    /// parameters too. Whether all are finite, and it came to the end.
    pub(crate) fn curvature<const W: usize>(&self, uniforms: &[f64], n_all: usize, m: &mut Memory) -> bool {
        let (n_x, n_q) = (self.n_x(), self.n_q());
        let pattern = &self.f.hessian_pattern;
        let mut second = std::mem::take(&mut m.second);
        let done = self.everywhere::<W>(&self.f.hessian, uniforms, true, m, &mut second);
        let mut finite = done && second.iter().all(|v| v.is_finite());
        if finite && !pattern.is_empty() {
            let mut turns = current().turns(n_x * n_q * (n_q + n_x) * W);
            let (size, sizes) = (n_x * n_q * W, Sizes { x: n_x, q: n_q, all: n_all });
            for point in 0..self.group.points {
                if turns.stop() {
                    finite = false;
                    break;
                }
                let entries = &second[point * pattern.len() * W..][..pattern.len() * W];
                let terms = pattern.iter().zip(entries.as_chunks::<W>().0).map(|(at, v)| (at, *v));
                let s = &m.sx[point * size..][..size];
                congruence::<W>(terms, sizes, s, &mut m.product, &mut m.sums);
            }
        }
        m.second = second;
        finite
    }
}

/// Numbers of states, of variables q, and of all that a second derivative is by: the noise's parameters too.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sizes {
    pub(crate) x: usize,
    pub(crate) q: usize,
    pub(crate) all: usize,
}

/// sums += Zᵀ H Z for a ≥ b, Z = [S; I]: H over (x, θ) is given by its entries in the lower triangle.
pub(crate) fn congruence<const W: usize>(
    terms: impl Iterator<Item = ((usize, usize), [f64; W])>,
    Sizes { x: n_x, q: n_q, all: n_all }: Sizes,
    s: &[f64],
    product: &mut Vec<f64>,
    sums: &mut [f64],
) {
    zeroed(product, n_x * n_q * W);
    let row = |r: usize| r * n_q * W;
    let mut any = 0;
    for ((a, b), v) in terms {
        if a < n_x {
            add::<W>(&mut product[row(a)..][..n_q * W], v, &s[row(b)..][..n_q * W]);
            if a != b {
                add::<W>(&mut product[row(b)..][..n_q * W], v, &s[row(a)..][..n_q * W]);
            }
            any = any.max(a.max(b) + 1);
        } else if b < n_x {
            // Of a parameter of the noise, S has no column.
            if a < n_q {
                add::<W>(&mut product[row(b) + a * W..][..W], v, &[1.0; W]);
                any = any.max(b + 1);
            }
            let length = (a + 1).min(n_q) * W;
            add::<W>(&mut sums[a * n_all * W..][..length], v, &s[row(b)..][..length]);
        } else {
            add::<W>(&mut sums[(a * n_all + b) * W..][..W], v, &[1.0; W]);
        }
    }
    for r in 0..any {
        for q in 0..n_q {
            let v = lanes::<W>(&s[row(r)..], q);
            add::<W>(&mut sums[q * n_all * W..][..(q + 1) * W], v, &product[row(r)..][..(q + 1) * W]);
        }
    }
}
