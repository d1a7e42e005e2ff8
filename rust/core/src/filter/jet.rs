//! Third derivatives of Φ, which the gradient of ln det needs. With z = (x, ε) at the start of an interval, X = ∂x/∂z and a
//! symmetric matrix W, the system
//!
//! ```text
//!   ẋ = f,    Ẋ = f_x X + (0, f_ε),    ṡ = f_x s + Σ_ab f_ab (X W Xᵀ)_ab,        X = (I, 0) and s = 0 at the start
//! ```
//!
//! ends in Φ, Φ_z and s = Σ_ab W_ab ∂²Φ/∂z_a∂z_b, and one reverse sweep through its Runge-Kutta steps gives the
//! gradient of any weighted sum of the three.

use super::noises::{Driven, LANES};
use crate::dense::{lower, place};
use crate::error::Error;
use crate::expr::derive::Sparse;
use crate::expr::graph::{Graph, Id};
use crate::integrate::adjoint::Adjoint;
use crate::integrate::flow::{Flow, Memory, Points};
use crate::integrate::group::{Group, Lane};
use crate::integrate::tableau::Tableau;
use crate::interrupt::current;
use crate::tape::{Arguments, Function};

/// The system, compiled.
#[derive(Clone, Debug)]
pub(super) struct Jets {
    n: usize,
    /// Noises of an interval.
    m: usize,
    tableau: Tableau,
    /// Slopes of x, X and, where f is curved, s; noises and covariances are constants.
    slope: Function,
    /// The gradient of their weighted sum by x, X, s, then ε, then θ.
    back: Adjoint,
}

/// Weights of Φ, Φ_z and s, all intervals.
pub(super) struct Weights<'a> {
    pub(super) end: &'a [f64],
    pub(super) b: &'a [f64],
    pub(super) s: &'a [f64],
}

/// The places to which gradients are added: those by x_k, rows of n, by ε_k, rows of m, and by the parameters.
pub(super) struct Gradients<'a> {
    pub(super) x: &'a mut [f64],
    pub(super) e: &'a mut [f64],
    pub(super) theta: &'a mut [f64],
}

impl Jets {
    pub(super) fn new(driven: &Driven, tableau: Tableau) -> Result<Jets, Error> {
        let mut graph = driven.graph.clone();
        let (x, f) = (driven.x(), &driven.f);
        let (n, width) = (f.len(), driven.arguments.states.len());
        let first = graph.jacobian(f, &driven.arguments.states);
        let curved = f.iter().any(|&f| !graph.hessian(f, x).values.is_empty());
        let jet = JetSystem {
            width,
            sensitivity: graph.symbols("sensitivity", n * width),
            curvature: graph.symbols("curvature", if curved { n } else { 0 }),
            w: graph.symbols("covariance", width * (width + 1) / 2),
        };
        let slopes = jet.slopes(&mut graph, f, x, &first);
        let varied = [x, &jet.sensitivity, &jet.curvature, driven.noises()].concat();
        let arguments = Arguments {
            data: driven.arguments.data.clone(),
            states: [&varied[..], &jet.w].concat(),
            parameters: driven.arguments.parameters.clone(),
        };
        let back = Adjoint::new(graph.clone(), &arguments, &slopes, varied.len())?;
        let slope = Function::of_values(graph, &arguments, slopes)?;
        Ok(Jets { n, m: width - n, tableau, slope, back })
    }

    fn flow<'a>(&'a self, group: &'a Group) -> Flow<'a> {
        Flow { f: &self.slope, tableau: &self.tableau, group, n_p: 0 }
    }

    /// Runs the jet forward with covariances `w` ((n + m, n + m) an interval): the points of its stages, and
    /// s = Σ W_ab ∂²Φ/∂z_a∂z_b, rows of n. None where something is not finite, or the interrupt in force stops it.
    pub(super) fn run(
        &self,
        theta: &[f64],
        groups: &[Group],
        x: &[f64],
        e: &[f64],
        w: &[f64],
    ) -> Option<(Vec<Points>, Vec<f64>)> {
        let (n, m, width) = (self.n, self.m, self.n + self.m);
        let (all, flat) = (self.slope.roots.len(), n + n * width);
        let (mut s, mut points, mut memory) = (Vec::new(), Vec::new(), Memory::default());
        let mut uniforms = Vec::new();
        self.slope.value.uniforms(theta, &mut uniforms);
        let interrupt = current();
        for group in groups {
            if interrupt.stops() {
                return None;
            }
            let (mut start, mut constants) = (Vec::new(), Vec::new());
            for k in group.node.0..group.node.0 + group.n {
                start.extend(&x[k * n..(k + 1) * n]);
                start.extend((0..n * width).map(|at| f64::from(u8::from(at / width == at % width))));
                start.resize(start.len() + all - flat, 0.0);
                constants.extend(&e[k * m..(k + 1) * m]);
                constants.extend(lower(&w[k * width * width..(k + 1) * width * width], width));
            }
            let flow = self.flow(group);
            if !flow.forward::<LANES>(&start, &constants, &uniforms, &mut memory) {
                return None;
            }
            let end = &memory.points.x[flow.at_step(group.steps) * LANES..];
            let curved = |l: usize, r: usize| if all > flat { end[(flat + r) * LANES + l] } else { 0.0 };
            s.extend((0..group.n * n).map(|at| curved(at / n, at % n)));
            points.push(std::mem::take(&mut memory.points));
        }
        Some((points, s))
    }

    /// Adds the gradient of the weighted sum of Φ, Φ_z and s, where the jet went through these points. None where the
    /// interrupt in force stops it.
    pub(super) fn pull_back(
        &self,
        theta: &[f64],
        groups: &[Group],
        points: &[Points],
        weights: &Weights<'_>,
        to: &mut Gradients<'_>,
    ) -> Option<()> {
        let (n, m, width) = (self.n, self.m, self.n + self.m);
        let mut memory = Memory::default();
        let uniforms = self.back.uniforms(theta);
        let interrupt = current();
        for (group, points) in groups.iter().zip(points) {
            let end = |lane: Lane, r: usize| {
                let k = group.node_of(lane).0;
                match r.checked_sub(n) {
                    None => weights.end[k * n + r],
                    Some(r) if r < n * width => weights.b[k * n * width + r],
                    Some(r) => weights.s[k * n + r - n * width],
                }
            };
            let back = (&self.back, &uniforms[..]);
            let done = self.flow(group).pull_back::<LANES>(back, points, &mut memory, end, to.theta);
            if !done || interrupt.stops() {
                return None;
            }
            let add = |all: &mut [f64], from: &[f64], size: usize| {
                let rows = &mut all[group.node.0 * size..][..group.n * size];
                rows.iter_mut().enumerate().for_each(|(at, v)| *v += from[at % size * LANES + at / size]);
            };
            add(to.x, &memory.ax, n);
            add(to.e, &memory.sums, m);
        }
        Some(())
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
