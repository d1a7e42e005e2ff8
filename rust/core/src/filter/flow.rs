//! Φ, the solution of the state equations from a sample to the next, with its exact first and second derivatives.
//!
//! A Runge-Kutta step of the variational equations is the derivative of the Runge-Kutta step; second derivatives
//! weighted by multipliers are collected in a reverse sweep over the stages.

use super::block::{Loaded, blocks, compile};
use super::jet::{symbols, weighted};
use super::steps::{Intervals, REACH, WEIGHTS, add_scaled, forward};
use crate::model::Compiled;
use crate::tape::{Tape, Workspace};

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

        Flow {
            n,
            p,
            value,
            jacobian,
            jacobian_entries: first.rows.into_iter().zip(first.columns).collect(),
            hessian,
            hessian_entries: second.rows.into_iter().zip(second.columns).collect(),
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
}

fn add_product(to: &mut [f64], a: &[f64], b: &[f64]) {
    to.iter_mut().zip(a).zip(b).for_each(|((t, a), b)| *t += a * b);
}
