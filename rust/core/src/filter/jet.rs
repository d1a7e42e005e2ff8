//! Third derivatives of Φ, which the gradient of ln det needs. With z = (x, ε) at the start of an interval, X = ∂x/∂z and a
//! symmetric matrix W, the system
//!
//! ```text
//!   ẋ = f,    Ẋ = f_x X + (0, f_ε),    ṡ = f_x s + Σ_ab f_ab (X W Xᵀ)_ab,        X = (I, 0) and s = 0 at the start
//! ```
//!
//! ends in Φ, Φ_z and s = Σ_ab W_ab ∂²Φ/∂z_a∂z_b, and one reverse sweep through its Runge-Kutta steps gives the
//! gradient of any weighted sum of the three.

use super::block::{Block, Loaded, blocks, compile};
use super::noises::Driven;
use super::steps::{Intervals, REACH, WEIGHTS, add_scaled, forward};
use crate::error::Error;
use crate::expr::derive::Sparse;
use crate::expr::graph::{Graph, Id};
use crate::tape::{Tape, Workspace};

/// The system, compiled.
#[derive(Clone, Debug)]
pub(super) struct Jets {
    n: usize,
    /// Noises of an interval.
    m: usize,
    /// Slopes of x, X and, where f is curved, s.
    slope: Tape,
    /// Gradient of their weighted sum.
    back: Tape,
    /// What it is by: x, X, s, then ε, then θ.
    back_places: Vec<usize>,
    /// n + n (n + m) + n, without the last n where f is linear in x.
    dimensions: usize,
}

/// The points of the stages of a forward run of the jet, kept for reverse sweeps.
#[derive(Clone, Debug)]
pub(super) struct Jet {
    block: Block,
    points: Vec<[Vec<f64>; 4]>,
    /// Noises and covariances.
    constants: Vec<f64>,
}

/// Weights of Φ, Φ_z and s, all intervals.
pub(super) struct Weights<'a> {
    pub(super) end: &'a [f64],
    pub(super) b: &'a [f64],
    pub(super) s: &'a [f64],
}

impl Jets {
    pub(super) fn new(driven: &Driven) -> Result<Jets, Error> {
        let mut graph = driven.graph.clone();
        let (x, theta, f) = (driven.x(), &driven.theta, &driven.f);
        let (n, width) = (driven.n, driven.z.len());
        let first = graph.jacobian(f, &driven.z);
        let curved = f.iter().any(|&f| !graph.hessian(f, x).values.is_empty());
        let jet = JetSystem {
            width,
            sensitivity: symbols(&mut graph, "sensitivity", n * width),
            curvature: symbols(&mut graph, "curvature", if curved { n } else { 0 }),
            w: symbols(&mut graph, "covariance", width * (width + 1) / 2),
        };
        let slopes = jet.slopes(&mut graph, f, x, &first);
        let state = [x, &jet.sensitivity, &jet.curvature].concat();
        let constants = [driven.noises(), &jet.w].concat();
        let slope = compile(&graph, &[&driven.data, &state, &constants], theta, &slopes)?;
        let weights = symbols(&mut graph, "weight of jet", slopes.len());
        let sum = weighted(&mut graph, &weights, &slopes);
        let gradient = graph.gradient(sum, &[&state, driven.noises(), theta].concat());
        let (places, nodes): (Vec<usize>, Vec<Id>) =
            gradient.iter().enumerate().filter_map(|(i, d)| d.map(|d| (i, d))).unzip();
        let back = compile(&graph, &[&driven.data, &state, &constants, &weights], theta, &nodes)?;
        Ok(Jets { n, m: width - n, slope, back, back_places: places, dimensions: slopes.len() })
    }

    /// Runs the jet forward with covariances `w` ((n + m, n + m) an interval): the points of its stages, and
    /// s = Σ W_ab ∂²Φ/∂z_a∂z_b, rows of n.
    pub(super) fn run(
        &self,
        theta: &[f64],
        intervals: &Intervals,
        x: &[f64],
        e: &[f64],
        w: &[f64],
    ) -> (Vec<Jet>, Vec<f64>) {
        let (n, width, count) = (self.n, self.n + self.m, intervals.h.len());
        let (mut s, mut workspace) = (vec![0.0; count * n], Workspace::default());
        let tape = Loaded::new(&self.slope, theta);
        let lower: Vec<f64> = w.chunks_exact(width * width).flat_map(|w| lower(w, width)).collect();
        let mut jets = Vec::new();
        for block in blocks(count) {
            let mut start = block.gather(x, n);
            start.resize(self.dimensions * block.lanes, 0.0);
            (0..n).for_each(|i| start[(n + i * width + i) * block.lanes..][..block.lanes].fill(1.0));
            let mut constants = block.gather(e, self.m);
            constants.extend(block.gather(&lower, width * (width + 1) / 2));
            let mut points = Vec::new();
            let end =
                forward(&tape, intervals, &block, start, &constants, &mut workspace, |p| points.push(p));
            if self.dimensions > n + n * width {
                block.scatter(&end[(n + n * width) * block.lanes..], &mut s, n);
            }
            jets.push(Jet { block, points, constants });
        }
        (jets, s)
    }

    /// Gradient of the weighted sum of Φ, Φ_z and s: by x_k, added to rows of n, by ε_k, added to rows of m, and by the
    /// parameters, added to `by_theta`.
    pub(super) fn pull_back(
        &self,
        theta: &[f64],
        intervals: &Intervals,
        jets: &[Jet],
        weights: &Weights<'_>,
        [by_x, by_e, by_theta]: [&mut [f64]; 3],
    ) {
        let (n, m, all) = (self.n, self.m, self.dimensions);
        let tape = Loaded::new(&self.back, theta);
        let mut workspace = Workspace::default();
        for Jet { block, points, constants } in jets {
            let lanes = block.lanes;
            let steps = intervals.steps(block);
            let mut adjoint = block.gather(weights.end, n);
            adjoint.extend(block.gather(weights.b, n * (n + m)));
            adjoint.extend(block.gather(weights.s, n));
            adjoint.truncate(all * lanes);
            let mut out = vec![0.0; self.back_places.len() * lanes];
            let mut of_noise = vec![0.0; m * lanes];
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
                    let inputs = [&data[stage][..], &points[stage], constants, &weight];
                    tape.run(&mut workspace, lanes, &inputs, &mut out);
                    later.fill(0.0);
                    for (&place, column) in self.back_places.iter().zip(out.chunks_exact(lanes)) {
                        if place < all {
                            later[place * lanes..][..lanes].copy_from_slice(column);
                        } else if place < all + m {
                            let to = &mut of_noise[(place - all) * lanes..][..lanes];
                            to.iter_mut().zip(column).for_each(|(t, v)| *t += v);
                        } else {
                            by_theta[place - all - m] += column[..block.count].iter().sum::<f64>();
                        }
                    }
                    sum.iter_mut().zip(&later).for_each(|(s, v)| *s += v);
                }
                adjoint = sum;
            }
            block.scatter(&adjoint[..n * lanes], by_x, n);
            block.scatter(&of_noise, by_e, m);
        }
    }
}

/// Symbols and slopes of the jet.
struct JetSystem {
    /// Columns of X.
    width: usize,
    sensitivity: Vec<Id>,
    curvature: Vec<Id>,
    w: Vec<Id>,
}

impl JetSystem {
    fn slopes(&self, graph: &mut Graph, f: &[Id], x: &[Id], first: &Sparse) -> Vec<Id> {
        let (n, width) = (x.len(), self.width);
        let mut slopes = f.to_vec();
        for r in 0..n {
            for j in 0..width {
                let along: Vec<Id> = (0..n).map(|c| self.sensitivity[c * width + j]).collect();
                let mut sum = directional(graph, first, r, &along);
                if let Some(entry) = first.find(r, j).filter(|_| j >= n) {
                    sum = graph.add(sum, entry);
                }
                slopes.push(sum);
            }
        }
        if self.curvature.is_empty() {
            return slopes;
        }
        for (r, &f) in f.iter().enumerate() {
            let mut sum = directional(graph, first, r, &self.curvature);
            let second = graph.hessian(f, x);
            for (i, &entry) in second.values.iter().enumerate() {
                let (a, b) = (second.rows[i], second.columns[i]);
                let spread = self.spread(graph, a, b);
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
    fn spread(&self, graph: &mut Graph, a: usize, b: usize) -> Id {
        let n = self.width;
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
fn directional(graph: &mut Graph, first: &Sparse, r: usize, v: &[Id]) -> Id {
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
