//! Φ(z), the solution of the state equations from a sample to the next by states and noises z = (x, ε), with its exact
//! first and second derivatives.
//!
//! A Runge-Kutta step of the variational equations is the derivative of the Runge-Kutta step; second derivatives
//! weighted by multipliers are collected in a reverse sweep over the stages.

use super::block::{Block, Loaded, blocks, compile};
use super::jet::{symbols, weighted};
use super::noises::Driven;
use super::steps::{Intervals, REACH, WEIGHTS, add_scaled, forward};
use crate::error::Error;
use crate::tape::{LANE_MULTIPLE, Tape, Workspace};

/// The state equations with their derivatives, compiled.
#[derive(Clone, Debug)]
pub(super) struct Flow {
    n: usize,
    /// Noises of an interval.
    m: usize,
    /// Parameters of the model.
    p: usize,
    value: Tape,
    /// Entries of ∂f/∂(x, ε, θ).
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
    /// Φ_z, of (n, n + m).
    pub(super) b: Vec<f64>,
    /// Φ_θ by the model's parameters, of (n, p), where asked for.
    pub(super) by_p: Vec<f64>,
    /// Σ_i λ_i ∂²Φ_i/∂z², of (n + m, n + m).
    pub(super) curvature: Vec<f64>,
}

impl Flow {
    /// `p` is the number of the model's own parameters among those of `driven`.
    pub(super) fn new(driven: &Driven, p: usize) -> Result<Flow, Error> {
        let mut graph = driven.graph.clone();
        let (z, theta, f) = (&driven.z, &driven.theta, &driven.f);
        let value = compile(&graph, &[&driven.data, z], theta, f)?;

        let variables = [z, &theta[..p]].concat();
        let first = graph.jacobian(f, &variables);
        let jacobian = compile(&graph, &[&driven.data, z], theta, &first.values)?;

        // f is linear in the noises, which do not meet the states there.
        let weights = symbols(&mut graph, "weight of slope", driven.n);
        let sum = weighted(&mut graph, &weights, f);
        let second = graph.hessian(sum, driven.x());
        let hessian = compile(&graph, &[&driven.data, z, &weights], theta, &second.values)?;

        Ok(Flow {
            n: driven.n,
            m: driven.noises().len(),
            p,
            value,
            jacobian,
            jacobian_entries: first.rows.into_iter().zip(first.columns).collect(),
            hessian,
            hessian_entries: second.rows.into_iter().zip(second.columns).collect(),
        })
    }

    /// Φ from the states at all samples but the last, rows of n, and the noises, rows of m.
    pub(super) fn ends(&self, theta: &[f64], intervals: &Intervals, x: &[f64], e: &[f64]) -> Vec<f64> {
        let (mut out, mut workspace) = (vec![0.0; intervals.h.len() * self.n], Workspace::default());
        let value = Loaded::new(&self.value, theta);
        for block in blocks(intervals.h.len()) {
            let (start, e) = (block.gather(x, self.n), block.gather(e, self.m));
            let end = forward(&value, intervals, &block, start, &e, &mut workspace, |_| ());
            block.scatter(&end, &mut out, self.n);
        }
        out
    }

    /// The states of a whole record from the first, with noises: N of n.
    pub(super) fn along(&self, theta: &[f64], intervals: &Intervals, first: &[f64], e: &[f64]) -> Vec<f64> {
        let (mut out, mut workspace) = (first.to_vec(), Workspace::default());
        let value = Loaded::new(&self.value, theta);
        for k in 0..intervals.h.len() {
            let block = Block { first: k, count: 1, lanes: LANE_MULTIPLE };
            let (start, e) = (block.gather(&out, self.n), block.gather(e, self.m));
            let end = forward(&value, intervals, &block, start, &e, &mut workspace, |_| ());
            out.extend(end.iter().step_by(LANE_MULTIPLE));
        }
        out
    }

    /// Φ with its first derivatives, those by parameters if asked for, and the second weighted by `lambda`.
    pub(super) fn linearise(
        &self,
        theta: &[f64],
        intervals: &Intervals,
        x: &[f64],
        e: &[f64],
        lambda: Option<&[f64]>,
        by_parameters: bool,
    ) -> Linear {
        let (n, count) = (self.n, intervals.h.len());
        let width = n + self.m;
        let columns = width + if by_parameters { self.p } else { 0 };
        let mut out = Linear {
            end: vec![0.0; count * n],
            b: vec![0.0; count * n * width],
            by_p: vec![0.0; if by_parameters { count * n * self.p } else { 0 }],
            curvature: vec![0.0; count * width * width],
        };
        let tapes = [&self.value, &self.jacobian, &self.hessian].map(|t| Loaded::new(t, theta));
        let mut workspace = Workspace::default();
        for block in blocks(count) {
            let lanes = block.lanes;
            let steps = intervals.steps(&block);
            // Points, entries of the Jacobian, and sensitivities to (x_k, ε_k, θ) of every stage.
            let mut points: Vec<[Vec<f64>; 4]> = Vec::new();
            let (start, noise) = (block.gather(x, n), block.gather(e, self.m));
            let end =
                forward(&tapes[0], intervals, &block, start, &noise, &mut workspace, |p| points.push(p));
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
                    let inputs = [&data[stage][..], &points[stage], &noise];
                    tapes[1].run(&mut workspace, lanes, &inputs, &mut e);
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
                        if c < width {
                            out.b[(k * n + r) * width + c] = v;
                        } else {
                            out.by_p[(k * n + r) * self.p + c - width] = v;
                        }
                    }
                }
            }
            let Some(lambda) = lambda.filter(|_| !self.hessian_entries.is_empty()) else { continue };
            let mut adjoint = block.gather(lambda, n);
            let mut curvature = vec![0.0; width * width * lanes];
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
                    let inputs = [&data[stage][..], &points[substep][stage], &noise, &weight];
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
            for i in 0..width {
                for j in 0..i {
                    let from = (i * width + j) * lanes;
                    curvature.copy_within(from..from + lanes, (j * width + i) * lanes);
                }
            }
            block.scatter(&curvature, &mut out.curvature, width * width);
        }
        out
    }

    /// slope = f_x · here + (0, f_ε, f_θ), entry by entry over lanes.
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

    /// curvature += Xᵀ f_xx X with the sensitivities X to z_k, in the lower triangle.
    fn bend(&self, second: &[f64], at: &[f64], columns: usize, lanes: usize, curvature: &mut [f64]) {
        let width = self.n + self.m;
        let row = |a: usize, j: usize| &at[(a * columns + j) * lanes..][..lanes];
        // f_xx X first: its rows that are not zero are few.
        let mut product = vec![Vec::new(); self.n];
        for (&(a, b), h) in self.hessian_entries.iter().zip(second.chunks_exact(lanes)) {
            for (a, b) in if a == b { vec![(a, b)] } else { vec![(a, b), (b, a)] } {
                product[a].resize(width * lanes, 0.0);
                for (j, to) in product[a].chunks_exact_mut(lanes).enumerate() {
                    add_product(to, h, row(b, j));
                }
            }
        }
        for (a, product) in product.iter().enumerate().filter(|(_, p)| !p.is_empty()) {
            for i in 0..width {
                for (j, along) in product.chunks_exact(lanes).enumerate().take(i + 1) {
                    add_product(&mut curvature[(i * width + j) * lanes..][..lanes], row(a, i), along);
                }
            }
        }
    }
}

fn add_product(to: &mut [f64], a: &[f64], b: &[f64]) {
    to.iter_mut().zip(a).zip(b).for_each(|((t, a), b)| *t += a * b);
}
