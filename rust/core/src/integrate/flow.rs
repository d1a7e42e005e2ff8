//! The integration of a group of segments, and its exact derivatives: those of the steps as they are taken.
//!
//! Forward, x at the stages, one after the other; ∂f at all of them at once, in lanes; sensitivities S of the
//! stages with respect to q = (x at the start, θ), by the chain rule. Backward, the adjoints κ of the stage
//! derivatives, from multipliers at the end and the gradient at the samples. The second derivative is then
//! Σ Sᵀ ∇²(κᵀf) S over the stages.
//!
//! Arrays have the lanes last: `x[(point·n_x + state)·W + lane]`. The dense algebra is in plain loops over arrays of
//! W lanes, or for W = 1 over q: short, and few beside the tapes.

use super::group::{Group, Sampled};
use super::tableau::Tableau;
use crate::interrupt::current;
use crate::tape::{BLOCK, Function, LANE_MULTIPLE, Tape, Workspace};

/// A group with what its integration needs.
#[derive(Clone, Copy)]
pub(crate) struct Flow<'a> {
    pub(crate) f: &'a Function,
    pub(crate) tableau: &'a Tableau,
    pub(crate) group: &'a Group,
    /// Number of parameters that f may depend on: those of the model.
    pub(crate) n_p: usize,
}

/// What a thread keeps of an integration; it grows to the largest group.
#[derive(Default)]
pub(crate) struct Memory {
    workspace: Workspace,
    /// x and ẋ at the points.
    pub(crate) x: Vec<f64>,
    k: Vec<f64>,
    /// Entries of ∂f at the points.
    jacobian: Vec<f64>,
    /// Sensitivities of x and ẋ.
    sx: Vec<f64>,
    sk: Vec<f64>,
    /// Adjoints of x where steps end, and of ẋ at the points.
    pub(crate) ax: Vec<f64>,
    kappa: Vec<f64>,
    /// Entries of ∇²(κᵀf) at the points, and a product with S.
    second: Vec<f64>,
    pub(crate) product: Vec<f64>,
    /// Sums of second derivatives: of lanes side by side, and of samples lane by lane.
    pub(crate) sums: Vec<f64>,
    pub(crate) own: Vec<f64>,
    pub(crate) sensitivity: Vec<f64>,
}

fn zeroed(v: &mut Vec<f64>, n: usize) {
    v.clear();
    v.resize(n, 0.0);
}

/// to += a · from, lane by lane.
#[inline(always)]
fn add<const W: usize>(to: &mut [f64], a: [f64; W], from: &[f64]) {
    for (t, f) in to.as_chunks_mut::<W>().0.iter_mut().zip(from.as_chunks::<W>().0) {
        for l in 0..W {
            t[l] += a[l] * f[l];
        }
    }
}

#[inline(always)]
fn lanes<const W: usize>(v: &[f64], at: usize) -> [f64; W] {
    *v[at * W..].first_chunk().expect("lanes enough")
}

impl Flow<'_> {
    fn n_x(&self) -> usize {
        self.f.n_states
    }

    /// Length of q.
    pub(crate) fn n_q(&self) -> usize {
        self.n_x() + self.n_p
    }

    fn stages(&self) -> usize {
        self.tableau.b.len()
    }

    /// Where x at the end of a number of steps stands, times W.
    pub(crate) fn at_step(&self, step: usize) -> usize {
        step * self.stages() * self.n_x()
    }

    /// Integrates from x at the nodes; whether all states are finite.
    pub(crate) fn forward<const W: usize>(&self, nodes: &[f64], uniforms: &[f64], m: &mut Memory) -> bool {
        let (n_x, s, steps) = (self.n_x(), self.stages(), self.group.steps);
        zeroed(&mut m.x, (steps * s + 1) * n_x * W);
        zeroed(&mut m.k, (steps * s + 1) * n_x * W);
        for r in 0..n_x {
            for l in 0..W {
                m.x[r * W + l] = nodes[l.min(self.group.n - 1) * n_x + r];
            }
        }
        let size = n_x * W;
        // A single shot goes over the whole record.
        let mut turns = current().turns(s * self.f.value.instructions() * LANE_MULTIPLE);
        for i in 0..steps {
            if turns.stop() {
                return false;
            }
            let (first, h) = (i * s, lanes::<W>(&self.group.h, i));
            for j in 0..=s {
                let weights = if j < s { &self.tableau.a[j] } else { &self.tableau.b };
                let (before, rest) = m.x.split_at_mut((first + j) * size);
                if j > 0 {
                    let x = &mut rest[..size];
                    x.copy_from_slice(&before[first * size..][..size]);
                    for (w, k) in weights.iter().zip(m.k[first * size..].chunks_exact(size)) {
                        add::<W>(x, h.map(|h| h * w), k);
                    }
                }
                if j < s {
                    self.slope::<W>(first + j, uniforms, m);
                }
            }
        }
        if self.group.points > steps * s {
            self.slope::<W>(steps * s, uniforms, m);
        }
        m.x.iter().all(|x| x.is_finite())
    }

    /// f at one point.
    fn slope<const W: usize>(&self, point: usize, uniforms: &[f64], m: &mut Memory) {
        let (tape, n_x, columns) = (&self.f.value, self.n_x(), self.f.n_data);
        let registers = m.workspace.registers(tape, LANE_MULTIPLE);
        let data = self.group.data[point * columns * W..][..columns * W].as_chunks::<W>().0;
        let x = m.x[point * n_x * W..][..n_x * W].as_chunks::<W>().0;
        for (to, from) in registers.as_chunks_mut::<LANE_MULTIPLE>().0.iter_mut().zip(data.iter().chain(x)) {
            *to = std::array::from_fn(|l| from[l % W]);
        }
        tape.run(registers, uniforms, LANE_MULTIPLE);
        for (r, operand) in tape.outputs.iter().enumerate() {
            let value = tape.read(*operand, registers, uniforms, LANE_MULTIPLE);
            (0..W).for_each(|l| m.k[(point * n_x + r) * W + l] = value.at(l));
        }
    }

    /// Outputs of a tape at all points, `out[(point·outputs + output)·W + lane]`; `weights` as x, where it has them.
    /// Whether it came to the end.
    fn everywhere<const W: usize>(
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
            let mut column = |at: usize, from: &[f64], c: usize, of: usize| {
                for l in 0..n / W {
                    // Spare lanes repeat the last point.
                    let point = first + l.min(points - 1);
                    registers[at * n + l * W..][..W].copy_from_slice(&from[(point * of + c) * W..][..W]);
                }
            };
            (0..columns).for_each(|c| column(c, &self.group.data, c, columns));
            (0..n_x).for_each(|r| column(columns + r, &m.x, r, n_x));
            if weights {
                (0..n_x).for_each(|r| column(columns + n_x + r, &m.kappa, r, n_x));
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
        let (n_x, n_q, s, steps) = (self.n_x(), self.n_q(), self.stages(), self.group.steps);
        let size = n_x * n_q * W;
        zeroed(&mut m.sx, (steps * s + 1) * size);
        zeroed(&mut m.sk, (steps * s + 1) * size);
        for r in 0..n_x {
            m.sx[(r * n_q + r) * W..][..W].fill(1.0);
        }
        let mut turns = current().turns(s * size * (n_x + s));
        for i in 0..steps {
            if turns.stop() {
                return false;
            }
            let (first, h) = (i * s, lanes::<W>(&self.group.h, i));
            for j in 0..=s {
                let weights = if j < s { &self.tableau.a[j] } else { &self.tableau.b };
                let (before, rest) = m.sx.split_at_mut((first + j) * size);
                if j > 0 {
                    let sx = &mut rest[..size];
                    sx.copy_from_slice(&before[first * size..][..size]);
                    for (w, sk) in weights.iter().zip(m.sk[first * size..].chunks_exact(size)) {
                        add::<W>(sx, h.map(|h| h * w), sk);
                    }
                }
                if j < s {
                    self.slope_sensitivity::<W>(first + j, m);
                }
            }
        }
        if self.group.points > steps * s {
            self.slope_sensitivity::<W>(steps * s, m);
        }
        true
    }

    /// ∂f/∂x S + ∂f/∂θ at one point.
    fn slope_sensitivity<const W: usize>(&self, point: usize, m: &mut Memory) {
        let (n_x, n_q) = (self.n_x(), self.n_q());
        let size = n_x * n_q * W;
        let pattern = &self.f.jacobian_pattern;
        let (sx, sk) = (&m.sx[point * size..][..size], &mut m.sk[point * size..][..size]);
        for (e, (r, c)) in pattern.iter().enumerate() {
            let v = lanes::<W>(&m.jacobian, point * pattern.len() + e);
            if c < n_x {
                add::<W>(&mut sk[r * n_q * W..][..n_q * W], v, &sx[c * n_q * W..][..n_q * W]);
            } else {
                add::<W>(&mut sk[(r * n_q + c) * W..][..W], v, &[1.0; W]);
            }
        }
    }

    /// ∂x/∂q at the end of a lane: `(state, q)`.
    pub(crate) fn end<const W: usize>(&self, lane: usize, m: &Memory) -> impl Fn(usize, usize) -> f64 {
        let (n_q, at) = (self.n_q(), self.at_step(self.group.steps) * self.n_q() * W);
        move |r, q| m.sx[at + (r * n_q + q) * W + lane]
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
        let begin = sample.step * self.stages() * size * W + sample.lane;
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
        self.combined::<W>(sample, (&m.x, &m.k), self.n_x(), put);
    }

    /// S at a sample, into `m.sensitivity`, `[state·n_q + q]`.
    pub(crate) fn sample_sensitivity<const W: usize>(&self, sample: &Sampled, m: &mut Memory) {
        let mut out = std::mem::take(&mut m.sensitivity);
        let size = self.n_x() * self.n_q();
        zeroed(&mut out, size);
        self.combined::<W>(sample, (&m.sx, &m.sk), size, |i, v| out[i] = v);
        m.sensitivity = out;
    }

    /// Adjoints of a function of x at the samples and the ends: κ at all points, and that of x at the start, the first
    /// of `m.ax`. `gradient(sample, state)` is its derivative at a sample, `end(lane, state)` at an end. Whether it came
    /// to the end.
    pub(crate) fn backward<const W: usize>(
        &self,
        m: &mut Memory,
        gradient: impl Fn(&Sampled, usize) -> f64,
        end: impl Fn(usize, usize) -> f64,
    ) -> bool {
        let (n_x, s, steps) = (self.n_x(), self.stages(), self.group.steps);
        let size = n_x * W;
        zeroed(&mut m.ax, (steps + 1) * size);
        zeroed(&mut m.kappa, (steps * s + 1) * size);
        for sample in &self.group.samples {
            for r in 0..n_x {
                let (g, at) = (gradient(sample, r), r * W + sample.lane);
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
        for r in 0..n_x {
            (0..self.group.n).for_each(|l| m.ax[steps * size + r * W + l] += end(l, r));
        }
        if self.group.points > steps * s {
            let (ax, kappa) = (&mut m.ax[steps * size..], &m.kappa[steps * s * size..]);
            self.transposed::<W>(steps * s, &m.jacobian, kappa, ax);
        }
        let mut pull = vec![0.0; size];
        let mut turns = current().turns(s * size * (n_x + s));
        for i in (0..steps).rev() {
            if turns.stop() {
                return false;
            }
            let (first, h) = (i * s, lanes::<W>(&self.group.h, i));
            let (before, after) = m.ax.split_at_mut((i + 1) * size);
            let ax = &mut before[i * size..];
            add::<W>(ax, [1.0; W], &after[..size]);
            for (j, b) in self.tableau.b.iter().enumerate() {
                add::<W>(&mut m.kappa[(first + j) * size..][..size], h.map(|h| h * b), &after[..size]);
            }
            for j in (0..s).rev() {
                pull.fill(0.0);
                let (earlier, kappa) = m.kappa.split_at_mut((first + j) * size);
                self.transposed::<W>(first + j, &m.jacobian, kappa, &mut pull);
                add::<W>(ax, [1.0; W], &pull);
                for (a, kappa) in self.tableau.a[j].iter().zip(earlier[first * size..].chunks_exact_mut(size))
                {
                    add::<W>(kappa, h.map(|h| h * a), &pull);
                }
            }
        }
        true
    }

    /// to += (∂f/∂x)ᵀ κ at one point.
    fn transposed<const W: usize>(&self, point: usize, jacobian: &[f64], kappa: &[f64], to: &mut [f64]) {
        let pattern = &self.f.jacobian_pattern;
        for (e, (r, c)) in pattern.iter().enumerate().filter(|(_, (_, c))| *c < self.n_x()) {
            let v = lanes::<W>(jacobian, point * pattern.len() + e);
            add::<W>(&mut to[c * W..][..W], v, &kappa[r * W..][..W]);
        }
    }

    /// Adds Σ (∂f/∂θ)ᵀ κ over points and lanes.
    pub(crate) fn parameter_gradient<const W: usize>(&self, m: &Memory, out: &mut [f64]) {
        let (pattern, n_x) = (&self.f.jacobian_pattern, self.n_x());
        for point in 0..self.group.points {
            for (e, (r, c)) in pattern.iter().enumerate().filter(|(_, (_, c))| *c >= n_x) {
                let v = lanes::<W>(&m.jacobian, point * pattern.len() + e);
                let kappa = lanes::<W>(&m.kappa, point * n_x + r);
                out[c - n_x] += (0..W).map(|l| v[l] * kappa[l]).sum::<f64>();
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
            let size = n_x * n_q * W;
            for point in 0..self.group.points {
                if turns.stop() {
                    finite = false;
                    break;
                }
                let entries = &second[point * pattern.len() * W..][..pattern.len() * W];
                let terms = pattern.iter().zip(entries.as_chunks::<W>().0).map(|(at, v)| (at, *v));
                let s = &m.sx[point * size..][..size];
                congruence::<W>(terms, (n_x, n_q, n_all), s, &mut m.product, &mut m.sums);
            }
        }
        m.second = second;
        finite
    }
}

/// sums += Zᵀ H Z for a ≥ b, Z = [S; I]: H over (x, θ) is given by its entries in the lower triangle.
pub(crate) fn congruence<const W: usize>(
    terms: impl Iterator<Item = ((usize, usize), [f64; W])>,
    (n_x, n_q, n_all): (usize, usize, usize),
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
