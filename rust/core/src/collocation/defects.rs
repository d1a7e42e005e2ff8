//! Defects (Eq. oem_coll_cxdot), their Jacobian, and their part of the Hessian of the Lagrangian.
//!
//! c_k = x_{k+1} − x_k − h Σ_j C[j,k] f(x_j, u_j, θ): f and its derivatives are evaluated once a
//! point and combined within the segments of a chunk.

use std::sync::Arc;

use super::chunk::{Chunk, Tie};
use crate::index::{ParameterId, PointId};
use crate::nlp::Part;
use crate::problem::ParameterMap;
use crate::problem::disjoint::Disjoint;
use crate::problem::layout::Layout;
use crate::simd::kernel;
use crate::tape::lanes::{all_finite, combination, load, scaled};
use crate::tape::{Function, LANE_MULTIPLE, Sinks, Tape, Values, Workspace};

/// Most segments in a chunk (order 2), and so the length of a temporary over segments.
const SEGMENTS: usize = crate::tape::BLOCK;

/// An entry of ∂f/∂x, and its number among those of the Jacobian of f, where it is one.
#[derive(Clone, Copy, Debug)]
struct StateEntry {
    row: usize,
    column: usize,
    entry: Option<usize>,
}

/// An entry of ∂f/∂θ, and its number among those of the Jacobian of f.
#[derive(Clone, Copy, Debug)]
struct ParameterEntry {
    row: usize,
    parameter: ParameterId,
    entry: usize,
}

/// f compiled, with the order of the entries that it gives rise to.
#[derive(Clone, Debug)]
pub(super) struct Dynamics {
    pub(super) f: Arc<Function>,
    /// Entries of ∂f/∂x, the diagonal always among them (it carries x_{k+1} − x_k).
    state_entries: Vec<StateEntry>,
    /// Entries of ∂f/∂θ.
    parameter_entries: Vec<ParameterEntry>,
}

/// A chunk with all that evaluating it needs.
pub(super) struct Job<'a> {
    pub(super) dynamics: &'a Dynamics,
    pub(super) layout: &'a Layout,
    pub(super) chunk: &'a Chunk,
    pub(super) xi: &'a [f64],
    pub(super) uniforms: &'a [f64],
}

impl Dynamics {
    pub(super) fn new(f: Arc<Function>) -> Self {
        let n_x = f.n_states;
        let mut state_entries = Vec::new();
        let mut parameter_entries = Vec::new();
        for row in 0..n_x {
            let mut has_diagonal = false;
            for (k, (r, c)) in f.jacobian_pattern.iter().enumerate().filter(|e| e.1.0 == row) {
                if c < n_x {
                    has_diagonal |= c == r;
                    state_entries.push(StateEntry { row: r, column: c, entry: Some(k) });
                } else {
                    parameter_entries.push(ParameterEntry {
                        row: r,
                        parameter: ParameterId(c - n_x),
                        entry: k,
                    });
                }
            }
            if !has_diagonal {
                state_entries.push(StateEntry { row, column: row, entry: None });
            }
        }
        Dynamics { f, state_entries, parameter_entries }
    }

    /// Places of the Jacobian entries of a chunk, in the order in which [`Job::jacobian`] writes them.
    pub(super) fn jacobian_structure(
        &self,
        chunk: &Chunk,
        layout: &Layout,
        map: &ParameterMap,
        out: &mut Part<'_>,
    ) {
        let (m, n) = (chunk.rule.order(), chunk.segments());
        for k in 0..m - 1 {
            let row = |s: usize, r: usize| (chunk.row + s * (m - 1) + k) * layout.n_x + r;
            for &StateEntry { row: r, column: c, entry } in &self.state_entries {
                for j in nodes_of(entry, k, m) {
                    for s in 0..n {
                        let point = PointId(chunk.points[chunk.lane(j) + s] as usize);
                        out.push(row(s, r), (layout.state(point) + c).0);
                    }
                }
            }
            for &ParameterEntry { row: r, parameter: p, .. } in &self.parameter_entries {
                (0..n).for_each(|s| out.push(row(s, r), map[p].0));
            }
        }
        for tie in &chunk.between {
            let point = |j: usize| PointId(chunk.points[chunk.lane(j) + tie.segment] as usize);
            let row = |r: usize| tie.row * layout.n_x + r;
            (0..layout.n_x).for_each(|r| out.push(row(r), (layout.state(tie.point) + r).0));
            for &StateEntry { row: r, column: c, entry } in &self.state_entries {
                for j in tie.nodes_of(entry, m) {
                    out.push(row(r), (layout.state(point(j)) + c).0);
                }
            }
            for &ParameterEntry { row: r, parameter: p, .. } in &self.parameter_entries {
                out.push(row(r), map[p].0);
            }
        }
    }

    /// Number of entries of the Jacobian of a chunk.
    pub(super) fn jacobian_entries(&self, chunk: &Chunk) -> usize {
        let (m, parameters) = (chunk.rule.order(), self.parameter_entries.len());
        let nodes = |of: &dyn Fn(Option<usize>) -> usize| -> usize {
            self.state_entries.iter().map(|of_state| of(of_state.entry)).sum()
        };
        let defects = (0..m - 1).map(|k| nodes(&|entry| nodes_of(entry, k, m).len()) + parameters);
        let ties = chunk
            .between
            .iter()
            .map(|tie| self.f.n_states + nodes(&|entry| tie.nodes_of(entry, m).len()) + parameters);
        defects.sum::<usize>() * chunk.segments() + ties.sum::<usize>()
    }

    /// Number of entries of the Hessian that a chunk writes at its own points.
    pub(super) fn hessian_entries(&self) -> usize {
        self.f.hessian_pattern.iter().filter(|(_, c)| *c < self.f.n_states).count()
    }

    /// Places of the Hessian entries of a chunk; those between parameters are summed elsewhere.
    pub(super) fn hessian_structure(
        &self,
        chunk: &Chunk,
        layout: &Layout,
        map: &ParameterMap,
        out: &mut Part<'_>,
    ) {
        let n_x = self.f.n_states;
        for (a, b) in self.f.hessian_pattern.iter().filter(|(_, c)| *c < n_x) {
            for lane in chunk.own().flatten() {
                let x = layout.state(PointId(chunk.points[lane] as usize)).0;
                // θ comes before x, so an entry between them has the state for its row.
                if a < n_x { out.push(x + a, x + b) } else { out.push(x + b, map[ParameterId(a - n_x)].0) }
            }
        }
    }

    /// Pairs of parameters between which f has second derivatives, row ≥ column.
    pub(super) fn parameter_pairs(&self) -> impl Iterator<Item = (ParameterId, ParameterId)> + '_ {
        let n_x = self.f.n_states;
        let pairs = self.f.hessian_pattern.iter().filter(move |(_, c)| *c >= n_x);
        pairs.map(move |(r, c)| (ParameterId(r - n_x), ParameterId(c - n_x)))
    }
}

/// Nodes at which ∂f/∂x enters constraint k: all, or for a bare diagonal the two of x_{k+1} − x_k.
fn nodes_of(entry: Option<usize>, k: usize, m: usize) -> std::ops::Range<usize> {
    if entry.is_some() { 0..m } else { k..k + 2 }
}

impl Tie {
    /// Returns the nodes of an entry of a sample's constraint: all, or for a bare diagonal the node on its left.
    fn nodes_of(&self, entry: Option<usize>, m: usize) -> std::ops::Range<usize> {
        if entry.is_some() { 0..m } else { self.node..self.node + 1 }
    }
}

impl Job<'_> {
    /// Gathers data, states and (for the Hessian) weights, and runs a tape.
    fn run<'w>(&self, tape: &Tape, workspace: &'w mut Workspace) -> &'w [f64] {
        self.run_into(tape, workspace, &[], &mut [])
    }

    /// Runs with weights, and with sums of entries between parameters to be added to.
    fn run_into<'w>(
        &self,
        tape: &Tape,
        workspace: &'w mut Workspace,
        weights: &[f64],
        sums: &mut [f64],
    ) -> &'w [f64] {
        let n = self.chunk.lanes();
        let registers = workspace.registers(tape, n);
        let n_data = self.chunk.data.len();
        registers[..n_data].copy_from_slice(&self.chunk.data);
        self.layout.gather(self.xi, &self.chunk.points, &mut registers[n_data..]);
        let start = n_data + n * self.layout.n_x;
        registers[start..start + weights.len()].copy_from_slice(weights);
        // Weights, and so entries, are zero on lanes that are not the chunk's own: sums are over all lanes.
        let mut sinks = Sinks { count: n, factor: 1.0, sums, rows: &mut [] };
        tape.run_into(registers, self.uniforms, n, &mut sinks);
        registers
    }

    /// The defects of the chunk; whether all are finite.
    pub(super) fn defects(&self, workspace: &mut Workspace, out: &Disjoint<'_>) -> bool {
        let registers = self.run(&self.dynamics.f.value, workspace);
        combine_defects(self, registers, out)
    }

    /// Entries of the Jacobian of the chunk; whether all are finite.
    pub(super) fn jacobian(&self, workspace: &mut Workspace, out: &Disjoint<'_>) -> bool {
        let registers = self.run(&self.dynamics.f.jacobian, workspace);
        // SAFETY: the entries of chunks do not overlap.
        let out = unsafe { out.part(self.chunk.jacobian, self.chunk.jacobian_entries) };
        combine_jacobian(self, registers, out)
    }

    /// Entries of the Hessian of Σ λ_i c_i at the chunk's points, and sums between parameters.
    pub(super) fn hessian(
        &self,
        workspace: &mut Workspace,
        lambda: &[f64],
        out: &Disjoint<'_>,
        pairs: &mut [f64],
        weights: &mut Vec<f64>,
    ) -> bool {
        weights.resize(self.chunk.lanes() * self.layout.n_x, 0.0);
        weigh(self, lambda, weights);
        let registers = self.run_into(&self.dynamics.f.hessian, workspace, weights, pairs);
        // SAFETY: the entries of chunks do not overlap.
        let out =
            unsafe { out.part(self.chunk.hessian, self.dynamics.hessian_entries() * self.chunk.n_own()) };
        collect_hessian(self, registers, out) && all_finite(pairs)
    }

    fn tie_jacobian<'v>(
        &self,
        tie: &Tie,
        value: &impl Fn(usize) -> Values<'v>,
        out: &mut std::slice::IterMut<'_, f64>,
    ) {
        let chunk = self.chunk;
        let mut put = |v: f64| *out.next().expect("as many entries as in the structure") = v;
        (0..self.layout.n_x).for_each(|_| put(1.0));
        let lane = |j: usize| chunk.lane(j) + tie.segment;
        for &StateEntry { row: r, column: c, entry } in &self.dynamics.state_entries {
            for j in tie.nodes_of(entry, chunk.rule.order()) {
                let step = f64::from(r == c && j == tie.node);
                put(-step - entry.map_or(0.0, |entry| tie.weights[j] * value(entry).at(lane(j))));
            }
        }
        for &ParameterEntry { entry, .. } in &self.dynamics.parameter_entries {
            put((0..chunk.rule.order()).map(|j| -tie.weights[j] * value(entry).at(lane(j))).sum());
        }
    }
}

kernel! {
    /// c = x_{k+1} − x_k − h Σ_j C[j,k] f_j over the segments of a chunk.
    fn combine_defects(job: &Job<'_>, registers: &[f64], out: &Disjoint<'_>) -> bool {
        let (chunk, n_x) = (job.chunk, job.layout.n_x);
        let (m, n, lanes) = (chunk.rule.order(), chunk.segments(), chunk.lanes());
        // SAFETY: the constraint rows of chunks do not overlap.
        let rows = unsafe { out.part(chunk.row * n_x, n * (m - 1) * n_x) };
        let tape = &job.dynamics.f.value;
        let states = &registers[chunk.data.len()..];
        let mut finite = true;
        for r in 0..n_x {
            let f = tape.read(tape.outputs[r], registers, job.uniforms, lanes);
            let x = &states[r * lanes..(r + 1) * lanes];
            for k in 0..m - 1 {
                let rows = &mut rows[k * n_x + r..];
                let ends = (chunk.lane(k), chunk.lane(k + 1));
                let stride = (m - 1) * n_x;
                let row = DefectRow { chunk, f, x, k, ends, stride };
                let whole = n - n % LANE_MULTIPLE;
                for s in (0..whole).step_by(LANE_MULTIPLE) {
                    finite &= row.write::<LANE_MULTIPLE>(rows, s);
                }
                for s in whole..n {
                    finite &= row.write::<1>(rows, s);
                }
            }
            for tie in &chunk.between {
                // SAFETY: a tie belongs to one chunk.
                let d = unsafe { &mut out.part(tie.row * n_x + r, 1)[0] };
                *d = job.xi[job.layout.state(tie.point) + r] - x[chunk.lane(tie.node) + tie.segment];
                for j in 0..m {
                    *d -= tie.weights[j] * f.at(chunk.lane(j) + tie.segment);
                }
                finite &= d.is_finite();
            }
        }
        finite
    }
}

/// One state's constraint k of the segments of a chunk.
struct DefectRow<'a> {
    chunk: &'a Chunk,
    f: Values<'a>,
    x: &'a [f64],
    k: usize,
    /// First lanes of the two points between which the constraint stands.
    ends: (usize, usize),
    stride: usize,
}

impl DefectRow<'_> {
    /// Writes the defects of W segments from s; whether they are finite.
    #[inline(always)]
    fn write<const W: usize>(&self, rows: &mut [f64], s: usize) -> bool {
        let change: [f64; W] = combination(self.chunk.terms(self.k), self.f, s);
        let (a, b): ([f64; W], [f64; W]) = (load(self.x, self.ends.0 + s), load(self.x, self.ends.1 + s));
        let h: [f64; W] = load(&self.chunk.h, s);
        let d: [f64; W] = std::array::from_fn(|l| h[l].mul_add(-change[l], b[l] - a[l]));
        for (l, d) in d.iter().enumerate() {
            rows[(s + l) * self.stride] = *d;
        }
        all_finite(&d)
    }
}

kernel! {
    /// The entries of ∂c/∂x and ∂c/∂θ over the segments of a chunk.
    fn combine_jacobian(job: &Job<'_>, registers: &[f64], out: &mut [f64]) -> bool {
        let (chunk, tape) = (job.chunk, &job.dynamics.f.jacobian);
        let (m, n, lanes) = (chunk.rule.order(), chunk.segments(), chunk.lanes());
        let value = |k: usize| tape.read(tape.outputs[k], registers, job.uniforms, lanes);
        let mut runs = out.chunks_exact_mut(n);
        let mut count = 0;
        for k in 0..m - 1 {
            for &StateEntry { row: r, column: c, entry } in &job.dynamics.state_entries {
                for j in nodes_of(entry, k, m) {
                    let run = runs.next().expect("as many runs as in the structure");
                    count += 1;
                    let step = if r == c { f64::from(j == k + 1) - f64::from(j == k) } else { 0.0 };
                    match entry {
                        Some(e) => {
                            let terms = std::iter::once((chunk.rule.c(j, k), chunk.lane(j)));
                            write_entries(run, &chunk.h, step, terms, value(e));
                        }
                        None => run.fill(step),
                    }
                }
            }
            for &ParameterEntry { entry, .. } in &job.dynamics.parameter_entries {
                let run = runs.next().expect("as many runs as in the structure");
                count += 1;
                write_entries(run, &chunk.h, 0.0, chunk.terms(k), value(entry));
            }
        }
        let mut rest = out[count * n..].iter_mut();
        for tie in &chunk.between {
            job.tie_jacobian(tie, &value, &mut rest);
        }
        all_finite(out)
    }
}

/// run[s] = step − h[s] Σ_j c_j v[lane_j + s]
#[inline(always)]
fn write_entries(
    run: &mut [f64],
    h: &[f64],
    step: f64,
    terms: impl Iterator<Item = (f64, usize)> + Clone,
    v: Values<'_>,
) {
    #[inline(always)]
    fn write<const W: usize>(
        run: &mut [f64],
        h: &[f64],
        step: f64,
        terms: impl Iterator<Item = (f64, usize)>,
        v: Values<'_>,
        s: usize,
    ) {
        let sum: [f64; W] = combination(terms, v, s);
        let h: [f64; W] = load(h, s);
        let out: [f64; W] = std::array::from_fn(|l| h[l].mul_add(-sum[l], step));
        run[s..s + W].copy_from_slice(&out);
    }
    let (n, whole) = (run.len(), run.len() - run.len() % LANE_MULTIPLE);
    for s in (0..whole).step_by(LANE_MULTIPLE) {
        write::<LANE_MULTIPLE>(run, h, step, terms.clone(), v, s);
    }
    for s in whole..n {
        write::<1>(run, h, step, terms.clone(), v, s);
    }
}

kernel! {
    /// Weight of f at each own point in Σ λ_i c_i: w = −Σ_k h C[j,k] λ_k over the constraints that the
    /// point enters. State by state, zero on lanes that are not the chunk's own.
    fn weigh(job: &Job<'_>, lambda: &[f64], out: &mut [f64]) {
        let (chunk, n_x) = (job.chunk, job.layout.n_x);
        let (m, n, lanes) = (chunk.rule.order(), chunk.segments(), chunk.lanes());
        let k = m - 1;
        out.fill(0.0);
        let multiplier = |row: usize, r: usize| lambda[row * n_x + r];
        for r in 0..n_x {
            let w = &mut out[r * lanes..(r + 1) * lanes];
            for i in 0..k {
                // h λ of constraint i of every segment
                let mut scaled = [0.0; SEGMENTS];
                let from = &lambda[(chunk.row + i) * n_x + r..];
                for ((v, h), l) in scaled.iter_mut().zip(&chunk.h).zip(from.iter().step_by(k * n_x)) {
                    *v = h * l;
                }
                for j in 0..m {
                    // The end point belongs to the next chunk, unless the experiment ends here.
                    let own = if j == k && !chunk.last { n - 1 } else { n };
                    let c = chunk.rule.c(j, i);
                    let to = &mut w[chunk.lane(j)..][..own];
                    to.iter_mut().zip(&scaled).for_each(|(w, v)| *w = c.mul_add(-v, *w));
                }
            }
            if let Some(h) = chunk.h_before {
                let sum: f64 = (0..k).map(|i| chunk.rule.c(k, i) * multiplier(chunk.row - k + i, r)).sum();
                w[0] -= h * sum;
            }
            for tie in &chunk.between_before {
                w[0] -= tie.weights[k] * multiplier(tie.row, r);
            }
            for tie in &chunk.between {
                // Of ties in the last segment, the end point's share is the next chunk's to add.
                let own = if tie.segment + 1 == n && !chunk.last { k } else { m };
                for j in 0..own {
                    w[chunk.lane(j) + tie.segment] -= tie.weights[j] * multiplier(tie.row, r);
                }
            }
        }
    }
}

kernel! {
    /// Copies the entries with a state at a chunk's own points.
    fn collect_hessian(job: &Job<'_>, registers: &[f64], out: &mut [f64]) -> bool {
        let (chunk, f) = (job.chunk, &job.dynamics.f);
        let lanes = chunk.lanes();
        let mut at = 0;
        let entries = f.hessian.outputs.iter().zip(&f.hessian_pattern.columns);
        for (operand, _) in entries.filter(|e| *e.1 < f.n_states) {
            let value = f.hessian.read(*operand, registers, job.uniforms, lanes);
            for run in chunk.own() {
                scaled(&mut out[at..at + run.len()], 1.0, value, run.start);
                at += run.len();
            }
        }
        all_finite(out)
    }
}
