//! Φ, the solution of the state equations from a sample to the next, by steps of the classical Runge-Kutta method
//! of order 4, with its exact derivatives.
//!
//! A Runge-Kutta step of the variational equations is the derivative of the Runge-Kutta step. Third derivatives,
//! which the gradient of ln det needs, come the same way: with X = ∂x/∂x_k and a symmetric matrix W,
//!
//! ```text
//!   ẋ = f,     Ẋ = f_x X,     ṡ = f_x s + Σ_ab f_ab (X W Xᵀ)_ab,         X = I and s = 0 at the start
//! ```
//!
//! end in Φ, Φ_x and s = Σ_ab W_ab ∂²Φ/∂x_a∂x_b, and one reverse sweep through the steps of this system gives the
//! gradient of any weighted sum of the three.

use super::block::{Block, Loaded, blocks, compile, data_columns};
use crate::experiment::Experiment;
use crate::expr::graph::{Graph, Id};
use crate::model::Compiled;
use crate::tape::{Tape, Workspace};

/// Weight of each stage in the step, and how far the point of a stage lies along the slope of the one before.
const WEIGHTS: [f64; 4] = [1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0];
const REACH: [f64; 4] = [0.0, 0.5, 0.5, 1.0];

/// The state equations with their derivatives, compiled.
#[derive(Clone, Debug)]
pub(super) struct Flow {
    n: usize,
    p: usize,
    value: Tape,
    /// Entries of ∂f/∂(x, θ).
    jacobian: Tape,
    jacobian_entries: Vec<(usize, usize)>,
    /// Entries, row ≥ column, of the weighted ∂²f/∂x².
    hessian: Tape,
    hessian_entries: Vec<(usize, usize)>,
    /// Slopes of x, X and, where f is curved, s.
    jet: Tape,
    /// Gradient of their weighted sum: by x, X, s, θ; `None` where it is zero.
    back: Tape,
    back_places: Vec<usize>,
    /// n + n² + n, or n + n² where f is linear in x.
    dimensions: usize,
}

/// Intervals of a record: step lengths and data at the nodes of the steps.
#[derive(Clone, Debug)]
pub(super) struct Intervals {
    /// Lengths, s.
    pub(super) h: Vec<f64>,
    /// Time and inputs: [node][column][interval], 2 substeps + 1 nodes.
    nodes: Vec<Vec<Vec<f64>>>,
    substeps: usize,
}

impl Intervals {
    pub(super) fn new(experiment: &Experiment, substeps: usize) -> Self {
        let t = &experiment.t;
        let pairs = || t.windows(2);
        let share = |node: usize| node as f64 / (2 * substeps) as f64;
        let at = |node: usize| {
            let time =
                |w: &[f64]| if node == 2 * substeps { w[1] } else { w[0] + share(node) * (w[1] - w[0]) };
            data_columns(experiment, pairs().map(time).collect())
        };
        Intervals {
            h: pairs().map(|w| w[1] - w[0]).collect(),
            nodes: (0..=2 * substeps).map(at).collect(),
            substeps,
        }
    }

    /// Data of the four stages of a substep.
    fn stages(&self, block: &Block, substep: usize) -> [Vec<f64>; 4] {
        [0, 1, 1, 2].map(|node| block.cut(&self.nodes[2 * substep + node]))
    }

    /// Length of a substep on each lane.
    fn steps(&self, block: &Block) -> Vec<f64> {
        let h = block.gather(&self.h, 1);
        h.into_iter().map(|h| h / self.substeps as f64).collect()
    }
}

/// What linearisation gives, for all intervals of a record.
#[derive(Clone, Debug, Default)]
pub(super) struct Linear {
    /// Φ, of n.
    pub(super) end: Vec<f64>,
    /// Φ_x, of (n, n).
    pub(super) a: Vec<f64>,
    /// Φ_θ, of (n, p), where asked for.
    pub(super) b: Vec<f64>,
    /// Σ_i λ_i ∂²Φ_i/∂x², of (n, n).
    pub(super) curvature: Vec<f64>,
}

/// The points of the stages of a forward run of the jet, kept for reverse sweeps.
#[derive(Clone, Debug)]
pub(super) struct Jet {
    block: Block,
    points: Vec<[Vec<f64>; 4]>,
    w: Vec<f64>,
}

/// Weights of Φ, Φ_x and s, all intervals.
pub(super) struct Weights<'a> {
    pub(super) end: &'a [f64],
    pub(super) a: &'a [f64],
    pub(super) s: &'a [f64],
}

impl Flow {
    pub(super) fn new(model: &Compiled) -> Flow {
        let mut graph = model.graph.clone();
        let (x, theta, f) = (&model.states, &model.parameters, &model.dynamics);
        let (n, p) = (x.len(), theta.len());
        let value = compile(&graph, &[&model.data, x], theta, f);

        let variables = [x.clone(), theta.clone()].concat();
        let first = graph.jacobian(f, &variables);
        let jacobian = compile(&graph, &[&model.data, x], theta, &first.values);

        let weights = symbols(&mut graph, "weight of slope", n);
        let sum = weighted(&mut graph, &weights, f);
        let second = graph.hessian(sum, x);
        let hessian = compile(&graph, &[&model.data, x, &weights], theta, &second.values);

        let mut jet =
            JetSystem { sensitivity: symbols(&mut graph, "sensitivity", n * n), ..Default::default() };
        jet.curvature = symbols(&mut graph, "curvature", if second.values.is_empty() { 0 } else { n });
        jet.w = symbols(&mut graph, "covariance", n * (n + 1) / 2);
        let slopes = jet.slopes(&mut graph, f, x, &first);
        let state = [x.clone(), jet.sensitivity.clone(), jet.curvature.clone()].concat();
        let tape = compile(&graph, &[&model.data, &state, &jet.w], theta, &slopes);
        let weights = symbols(&mut graph, "weight of jet", slopes.len());
        let sum = weighted(&mut graph, &weights, &slopes);
        let gradient = graph.gradient(sum, &[state.clone(), theta.clone()].concat());
        let (places, nodes): (Vec<usize>, Vec<Id>) =
            gradient.iter().enumerate().filter_map(|(i, d)| d.map(|d| (i, d))).unzip();
        let back = compile(&graph, &[&model.data, &state, &jet.w, &weights], theta, &nodes);
        Flow {
            n,
            p,
            value,
            jacobian,
            jacobian_entries: first.rows.into_iter().zip(first.columns).collect(),
            hessian,
            hessian_entries: second.rows.into_iter().zip(second.columns).collect(),
            jet: tape,
            back,
            back_places: places,
            dimensions: slopes.len(),
        }
    }

    /// Φ from the states at all samples but the last: rows of n.
    pub(super) fn ends(&self, theta: &[f64], intervals: &Intervals, x: &[f64]) -> Vec<f64> {
        let (mut out, mut workspace) = (vec![0.0; intervals.h.len() * self.n], Workspace::default());
        let value = Loaded::new(&self.value, theta);
        for block in blocks(intervals.h.len()) {
            let start = block.gather(x, self.n);
            let end = forward(&value, intervals, &block, start, &[], &mut workspace, |_| ());
            block.scatter(&end, &mut out, self.n);
        }
        out
    }

    /// Φ with its first derivatives, those by parameters if asked for, and the second weighted by `lambda`.
    pub(super) fn linearise(
        &self,
        theta: &[f64],
        intervals: &Intervals,
        x: &[f64],
        lambda: Option<&[f64]>,
        by_parameters: bool,
    ) -> Linear {
        let (n, count) = (self.n, intervals.h.len());
        let columns = n + if by_parameters { self.p } else { 0 };
        let mut out = Linear {
            end: vec![0.0; count * n],
            a: vec![0.0; count * n * n],
            b: vec![0.0; if by_parameters { count * n * self.p } else { 0 }],
            curvature: vec![0.0; count * n * n],
        };
        let tapes = [&self.value, &self.jacobian, &self.hessian].map(|t| Loaded::new(t, theta));
        let mut workspace = Workspace::default();
        for block in blocks(count) {
            let lanes = block.lanes;
            let steps = intervals.steps(&block);
            // Points, entries of the Jacobian, and sensitivities to (x_k, θ) of every stage.
            let mut points: Vec<[Vec<f64>; 4]> = Vec::new();
            let start = block.gather(x, n);
            let end = forward(&tapes[0], intervals, &block, start, &[], &mut workspace, |p| points.push(p));
            block.scatter(&end, &mut out.end, n);

            let mut sensitivity = vec![0.0; n * columns * lanes];
            (0..n).for_each(|i| sensitivity[(i * columns + i) * lanes..][..lanes].fill(1.0));
            let mut entries: Vec<[Vec<f64>; 4]> = Vec::new();
            let mut at_stage: Vec<[Vec<f64>; 4]> = Vec::new();
            for (substep, points) in points.iter().enumerate() {
                let data = intervals.stages(&block, substep);
                let mut total = sensitivity.clone();
                let mut slope = vec![0.0; sensitivity.len()];
                let (mut of_step, mut kept) = (<[Vec<f64>; 4]>::default(), <[Vec<f64>; 4]>::default());
                for stage in 0..4 {
                    let mut here = sensitivity.clone();
                    add_scaled(&mut here, &slope, &steps, REACH[stage]);
                    let mut e = vec![0.0; self.jacobian_entries.len() * lanes];
                    tapes[1].run(&mut workspace, lanes, &[&data[stage], &points[stage]], &mut e);
                    self.vary(&e, &here, columns, lanes, &mut slope);
                    add_scaled(&mut total, &slope, &steps, WEIGHTS[stage]);
                    (of_step[stage], kept[stage]) = (e, here);
                }
                sensitivity = total;
                entries.push(of_step);
                at_stage.push(kept);
            }
            for r in 0..n {
                for c in 0..columns {
                    let column = &sensitivity[(r * columns + c) * lanes..][..block.count];
                    for (l, &v) in column.iter().enumerate() {
                        let k = block.first + l;
                        if c < n {
                            out.a[(k * n + r) * n + c] = v;
                        } else {
                            out.b[(k * n + r) * self.p + c - n] = v;
                        }
                    }
                }
            }
            let Some(lambda) = lambda.filter(|_| !self.hessian_entries.is_empty()) else { continue };
            let mut adjoint = block.gather(lambda, n);
            let mut curvature = vec![0.0; n * n * lanes];
            for substep in (0..points.len()).rev() {
                let data = intervals.stages(&block, substep);
                let mut sum = adjoint.clone();
                let mut later = vec![0.0; n * lanes];
                for stage in (0..4).rev() {
                    let mut weight = vec![0.0; n * lanes];
                    add_scaled(&mut weight, &adjoint, &steps, WEIGHTS[stage]);
                    if stage < 3 {
                        add_scaled(&mut weight, &later, &steps, REACH[stage + 1]);
                    }
                    let mut second = vec![0.0; self.hessian_entries.len() * lanes];
                    let inputs = [&data[stage][..], &points[substep][stage], &weight];
                    tapes[2].run(&mut workspace, lanes, &inputs, &mut second);
                    self.bend(&second, &at_stage[substep][stage], columns, lanes, &mut curvature);
                    later.fill(0.0);
                    for (&(r, c), e) in
                        self.jacobian_entries.iter().zip(entries[substep][stage].chunks_exact(lanes))
                    {
                        if c < n {
                            add_product(&mut later[c * lanes..][..lanes], e, &weight[r * lanes..][..lanes]);
                        }
                    }
                    sum.iter_mut().zip(&later).for_each(|(s, v)| *s += v);
                }
                adjoint = sum;
            }
            block.scatter(&curvature, &mut out.curvature, n * n);
        }
        out
    }

    /// slope = f_x · here + f_θ, entry by entry over lanes.
    fn vary(&self, entries: &[f64], here: &[f64], columns: usize, lanes: usize, slope: &mut [f64]) {
        slope.fill(0.0);
        for (&(r, c), e) in self.jacobian_entries.iter().zip(entries.chunks_exact(lanes)) {
            if c < self.n {
                for j in 0..columns {
                    let (from, to) = ((c * columns + j) * lanes, (r * columns + j) * lanes);
                    add_product(&mut slope[to..to + lanes], e, &here[from..from + lanes]);
                }
            } else if c < columns {
                let to = &mut slope[(r * columns + c) * lanes..][..lanes];
                to.iter_mut().zip(e).for_each(|(s, e)| *s += e);
            }
        }
    }

    /// curvature += Xᵀ f_xx X with the sensitivities X to x_k.
    fn bend(&self, second: &[f64], at: &[f64], columns: usize, lanes: usize, curvature: &mut [f64]) {
        let n = self.n;
        let row = |a: usize, j: usize| &at[(a * columns + j) * lanes..][..lanes];
        let mut scaled = vec![0.0; lanes];
        for (&(a, b), h) in self.hessian_entries.iter().zip(second.chunks_exact(lanes)) {
            for (a, b) in if a == b { vec![(a, b)] } else { vec![(a, b), (b, a)] } {
                for i in 0..n {
                    scaled.iter_mut().zip(h).zip(row(a, i)).for_each(|((s, h), x)| *s = h * x);
                    for j in 0..n {
                        add_product(&mut curvature[(i * n + j) * lanes..][..lanes], &scaled, row(b, j));
                    }
                }
            }
        }
    }

    /// Runs the jet forward with covariances `w` ((n, n) an interval): the points of its stages, and
    /// s = Σ W_ab ∂²Φ/∂x_a∂x_b, rows of n.
    pub(super) fn jets(
        &self,
        theta: &[f64],
        intervals: &Intervals,
        x: &[f64],
        w: &[f64],
    ) -> (Vec<Jet>, Vec<f64>) {
        let (n, count) = (self.n, intervals.h.len());
        let (mut s, mut workspace) = (vec![0.0; count * n], Workspace::default());
        let tape = Loaded::new(&self.jet, theta);
        let lower: Vec<f64> = w.chunks_exact(n * n).flat_map(|w| lower(w, n)).collect();
        let mut jets = Vec::new();
        for block in blocks(count) {
            let mut start = block.gather(x, n);
            start.resize(self.dimensions * block.lanes, 0.0);
            (0..n).for_each(|i| start[(n + i * n + i) * block.lanes..][..block.lanes].fill(1.0));
            let w = block.gather(&lower, n * (n + 1) / 2);
            let mut points = Vec::new();
            let end = forward(&tape, intervals, &block, start, &w, &mut workspace, |p| points.push(p));
            if self.dimensions > n + n * n {
                block.scatter(&end[(n + n * n) * block.lanes..], &mut s, n);
            }
            jets.push(Jet { block, points, w });
        }
        (jets, s)
    }

    /// Gradient of the weighted sum of Φ, Φ_x and s: by x_k, added to rows of n, and by the parameters, added to
    /// `by_theta`.
    pub(super) fn pull_back(
        &self,
        theta: &[f64],
        intervals: &Intervals,
        jets: &[Jet],
        weights: &Weights<'_>,
        by_x: &mut [f64],
        by_theta: &mut [f64],
    ) {
        let (n, all) = (self.n, self.dimensions);
        let tape = Loaded::new(&self.back, theta);
        let mut workspace = Workspace::default();
        for Jet { block, points, w } in jets {
            let lanes = block.lanes;
            let steps = intervals.steps(block);
            let mut adjoint = block.gather(weights.end, n);
            adjoint.extend(block.gather(weights.a, n * n));
            adjoint.extend(block.gather(weights.s, n));
            adjoint.truncate(all * lanes);
            let mut out = vec![0.0; self.back_places.len() * lanes];
            for (substep, points) in points.iter().enumerate().rev() {
                let data = intervals.stages(block, substep);
                let mut sum = adjoint.clone();
                let mut later = vec![0.0; all * lanes];
                for stage in (0..4).rev() {
                    let mut weight = vec![0.0; all * lanes];
                    add_scaled(&mut weight, &adjoint, &steps, WEIGHTS[stage]);
                    if stage < 3 {
                        add_scaled(&mut weight, &later, &steps, REACH[stage + 1]);
                    }
                    tape.run(&mut workspace, lanes, &[&data[stage], &points[stage], w, &weight], &mut out);
                    later.fill(0.0);
                    for (&place, column) in self.back_places.iter().zip(out.chunks_exact(lanes)) {
                        if place < all {
                            later[place * lanes..][..lanes].copy_from_slice(column);
                        } else {
                            by_theta[place - all] += column[..block.count].iter().sum::<f64>();
                        }
                    }
                    sum.iter_mut().zip(&later).for_each(|(s, v)| *s += v);
                }
                adjoint = sum;
            }
            block.scatter(&adjoint[..n * lanes], by_x, n);
        }
    }
}

/// Runge-Kutta steps of a system over an interval, from columns of lanes; `keep` is given the points of the four
/// stages of every step.
fn forward(
    slope_of: &Loaded<'_>,
    intervals: &Intervals,
    block: &Block,
    mut x: Vec<f64>,
    constants: &[f64],
    workspace: &mut Workspace,
    mut keep: impl FnMut([Vec<f64>; 4]),
) -> Vec<f64> {
    let steps = intervals.steps(block);
    let mut slope = vec![0.0; x.len()];
    for substep in 0..intervals.substeps {
        let data = intervals.stages(block, substep);
        let mut total = x.clone();
        let mut points = <[Vec<f64>; 4]>::default();
        for stage in 0..4 {
            let mut point = x.clone();
            if stage > 0 {
                add_scaled(&mut point, &slope, &steps, REACH[stage]);
            }
            slope_of.run(workspace, block.lanes, &[&data[stage], &point, constants], &mut slope);
            add_scaled(&mut total, &slope, &steps, WEIGHTS[stage]);
            points[stage] = point;
        }
        keep(points);
        x = total;
    }
    x
}

/// Symbols and slopes of the jet.
#[derive(Default)]
struct JetSystem {
    sensitivity: Vec<Id>,
    curvature: Vec<Id>,
    w: Vec<Id>,
}

impl JetSystem {
    fn slopes(&self, graph: &mut Graph, f: &[Id], x: &[Id], first: &crate::expr::derive::Sparse) -> Vec<Id> {
        let n = x.len();
        let mut slopes = f.to_vec();
        for r in 0..n {
            for j in 0..n {
                let along: Vec<Id> = (0..n).map(|c| self.sensitivity[c * n + j]).collect();
                slopes.push(directional(graph, first, r, &along));
            }
        }
        if self.curvature.is_empty() {
            return slopes;
        }
        for r in 0..n {
            let mut sum = directional(graph, first, r, &self.curvature);
            let second = graph.hessian(f[r], x);
            for (i, &entry) in second.values.iter().enumerate() {
                let (a, b) = (second.rows[i], second.columns[i]);
                let spread = self.spread(graph, a, b, n);
                let twice = graph.constant(if a == b { 1.0 } else { 2.0 });
                let term = graph.product(entry, spread);
                let term = graph.mul(twice, term);
                sum = graph.add(sum, term);
            }
            slopes.push(sum);
        }
        slopes
    }

    /// (X W Xᵀ)_ab.
    fn spread(&self, graph: &mut Graph, a: usize, b: usize, n: usize) -> Id {
        let mut sum = graph.zero();
        for i in 0..n {
            let mut inner = graph.zero();
            for j in 0..n {
                let term = graph.product(self.w[place(i, j)], self.sensitivity[b * n + j]);
                inner = graph.add(inner, term);
            }
            let term = graph.product(self.sensitivity[a * n + i], inner);
            sum = graph.add(sum, term);
        }
        sum
    }
}

/// Σ_c ∂f_r/∂x_c v_c.
fn directional(graph: &mut Graph, first: &crate::expr::derive::Sparse, r: usize, v: &[Id]) -> Id {
    let mut sum = graph.zero();
    for (c, &v) in v.iter().enumerate() {
        if let Some(entry) = first.find(r, c) {
            let term = graph.product(entry, v);
            sum = graph.add(sum, term);
        }
    }
    sum
}

/// Σ weights · nodes.
pub(super) fn weighted(graph: &mut Graph, weights: &[Id], nodes: &[Id]) -> Id {
    let mut sum = graph.zero();
    for (&weight, &node) in weights.iter().zip(nodes) {
        let term = graph.product(weight, node);
        sum = graph.add(sum, term);
    }
    sum
}

/// New symbols; no name of a model holds a space.
pub(super) fn symbols(graph: &mut Graph, name: &str, n: usize) -> Vec<Id> {
    (0..n).map(|i| graph.symbol(&format!("{name} {i}"))).collect()
}

/// Place of an entry of a symmetric matrix among those of its lower triangle.
pub(super) fn place(i: usize, j: usize) -> usize {
    let (row, column) = (i.max(j), i.min(j));
    row * (row + 1) / 2 + column
}

/// The lower triangle of a matrix, row by row.
pub(super) fn lower(w: &[f64], n: usize) -> impl Iterator<Item = f64> + '_ {
    (0..n).flat_map(move |i| w[i * n..=i * n + i].iter().copied())
}

/// to += factor · scale · from, with one scale a lane, for columns of lanes.
fn add_scaled(to: &mut [f64], from: &[f64], scale: &[f64], factor: f64) {
    for (to, from) in to.chunks_exact_mut(scale.len()).zip(from.chunks_exact(scale.len())) {
        for ((t, f), s) in to.iter_mut().zip(from).zip(scale) {
            *t += factor * s * f;
        }
    }
}

fn add_product(to: &mut [f64], a: &[f64], b: &[f64]) {
    to.iter_mut().zip(a).zip(b).for_each(|((t, a), b)| *t += a * b);
}
