//! The cost of the measurements of a sample, −ℓ_e(z_k − g(x_k, u_k, θ)) (Eq. elle_defn), with derivatives up to the
//! third that the gradient of ln det needs.

use super::block::{Loaded, blocks, compile, data_columns};
use crate::dense::{lower, place};
use crate::error::Error;
use crate::experiment::Experiment;
use crate::expr::graph::Id;
use crate::model::Compiled;
use crate::noise::{Noise, Sample, Sigma};
use crate::tape::{Tape, Workspace};

/// The cost of a sample, compiled. Parameters are those of the model, then those of the noise.
#[derive(Clone, Debug)]
pub(super) struct Samples {
    n: usize,
    n_y: usize,
    /// Cost, then its slopes by x, then entries of its Hessian in x.
    cost: Tape,
    hessian_entries: Vec<(usize, usize)>,
    /// (z − g)/σ, then 1/σ, of each output; both 0 where it is missing.
    scaled: Tape,
    /// ∂(z − g)/σ by x and the model's parameters.
    residual: Tape,
    residual_entries: Vec<(usize, usize)>,
    /// Gradient by x, then by parameters, of what [`Weights`] weigh.
    back: Tape,
    back_places: Vec<usize>,
    /// Outputs, then entries of their slopes by x.
    outputs: Tape,
    output_entries: Vec<(usize, usize)>,
    /// Outputs that are missing somewhere.
    gaps: Vec<usize>,
}

/// Weights of the cost, of its slopes by x, and of its second derivatives.
pub(super) struct Weights<'a> {
    pub(super) cost: f64,
    /// N of n.
    pub(super) slope: &'a [f64],
    /// N of (n, n), symmetric.
    pub(super) curvature: &'a [f64],
}

/// The cost of all samples of a record with derivatives by their states.
#[derive(Clone, Debug, Default)]
pub(super) struct Costs {
    pub(super) cost: f64,
    /// N of n.
    pub(super) slope: Vec<f64>,
    /// N of (n, n).
    pub(super) curvature: Vec<f64>,
}

impl Samples {
    pub(super) fn new(
        model: &Compiled,
        names: &[&str],
        noise: &Noise,
        experiments: &[Experiment],
    ) -> Result<Samples, Error> {
        let mut graph = model.graph.clone();
        let (n, n_y, n_p) = (model.states.len(), names.len(), model.parameters.len());
        let x = &model.states;
        let roots: Vec<Id> =
            noise.parameters(names).iter().map(|p| graph.symbol(&format!("1/{}", p.name))).collect();
        let theta = [model.parameters.clone(), roots.clone()].concat();
        let measured = graph.symbols("measured", n_y);
        let missing = |c: usize| experiments.iter().any(|e| e.outputs[c].iter().any(|v| v.is_nan()));
        let gaps: Vec<usize> = (0..n_y).filter(|&c| missing(c)).collect();
        let flags = graph.symbols("present", gaps.len());
        let present: Vec<Option<Id>> =
            (0..n_y).map(|c| gaps.iter().position(|&g| g == c).map(|i| flags[i])).collect();
        let sample = Sample {
            outputs: &model.outputs,
            measured: &measured,
            scales: &[],
            present: &present,
            patterns: &[],
        };
        let density = noise.log_density(&mut graph, &sample, &roots);

        let half = graph.constant(0.5);
        let mut cost = graph.neg(density.rest);
        for &residual in &density.squares {
            let square = graph.mul(residual, residual);
            let loss = graph.mul(half, square);
            cost = graph.add(cost, loss);
        }
        let data = [model.data.clone(), measured, flags].concat();
        let slopes = graph.jacobian(&[cost], x);
        let zero = graph.zero();
        let slope: Vec<Id> = (0..n).map(|i| slopes.find(0, i).unwrap_or(zero)).collect();
        let second = graph.hessian(cost, x);
        let outputs = [vec![cost], slope.clone(), second.values.clone()].concat();
        let cost_tape = compile(&graph, &[&data, x], &theta, &outputs)?;

        let variables = [x.clone(), model.parameters.clone()].concat();
        let first = graph.jacobian(&density.squares, &variables);
        let residual = compile(&graph, &[&data, x], &theta, &first.values)?;

        let mut inverses = roots.iter();
        let Noise::Gaussian(sigmas) = noise else { unreachable!("checked before") };
        let mut scaled = density.squares.clone();
        for (c, sigma) in sigmas.iter().enumerate() {
            let root = match sigma {
                Sigma::Known(value) => graph.constant(1.0 / value),
                Sigma::Unknown { .. } => *inverses.next().expect("one parameter an unknown"),
                Sigma::Expression(_) => unreachable!("checked before"),
            };
            scaled.push(present[c].map_or(root, |there| graph.select(there, root, zero)));
        }
        let scaled = compile(&graph, &[&data, x], &theta, &scaled)?;

        let weight = graph.symbols("weight of cost", 1);
        let along = graph.symbols("weight of slope", n);
        let w = graph.symbols("covariance", n * (n + 1) / 2);
        let mut sum = graph.weighted_sum(&[&weight[..], &along].concat(), &[&[cost][..], &slope].concat());
        for (i, &entry) in second.values.iter().enumerate() {
            let (a, b) = (second.rows[i], second.columns[i]);
            let twice = graph.constant(if a == b { 1.0 } else { 2.0 });
            let factor = graph.mul(twice, w[place(a, b)]);
            let term = graph.product(factor, entry);
            sum = graph.add(sum, term);
        }
        let gradient = graph.gradient(sum, &[x.clone(), theta.clone()].concat());
        let (back_places, nodes): (Vec<usize>, Vec<Id>) =
            gradient.iter().enumerate().filter_map(|(i, d)| d.map(|d| (i, d))).unzip();
        let back = compile(&graph, &[&data, x, &weight, &along, &w], &theta, &nodes)?;
        let by_x = graph.jacobian(&model.outputs, x);
        let outputs = [&model.outputs[..], &by_x.values].concat();
        let outputs = compile(&graph, &[&model.data, x], &model.parameters, &outputs)?;
        debug_assert!(variables.len() == n + n_p);
        Ok(Samples {
            n,
            n_y,
            cost: cost_tape,
            hessian_entries: second.rows.into_iter().zip(second.columns).collect(),
            scaled,
            residual,
            residual_entries: first.rows.into_iter().zip(first.columns).collect(),
            back,
            back_places,
            outputs,
            output_entries: by_x.rows.into_iter().zip(by_x.columns).collect(),
            gaps,
        })
    }

    /// Data columns of a record: time, inputs, measurements, whether they are there.
    pub(super) fn data(&self, experiment: &Experiment) -> Vec<Vec<f64>> {
        let mut columns = data_columns(experiment, experiment.t.clone());
        let filled = |c: &Vec<f64>| c.iter().map(|v| if v.is_nan() { 0.0 } else { *v }).collect();
        columns.extend(experiment.outputs.iter().map(filled));
        let there =
            |c: &usize| experiment.outputs[*c].iter().map(|v| f64::from(u8::from(!v.is_nan()))).collect();
        columns.extend(self.gaps.iter().map(there));
        columns
    }

    /// Cost with slopes and curvature.
    pub(super) fn costs(&self, theta: &[f64], data: &[Vec<f64>], x: &[f64]) -> Costs {
        let n = self.n;
        let samples = data[0].len();
        let mut out =
            Costs { cost: 0.0, slope: vec![0.0; samples * n], curvature: vec![0.0; samples * n * n] };
        let tape = Loaded::new(&self.cost, theta);
        let mut workspace = Workspace::default();
        for block in blocks(samples) {
            let lanes = block.lanes;
            let mut values = vec![0.0; (1 + n + self.hessian_entries.len()) * lanes];
            tape.run(&mut workspace, lanes, &[&block.cut(data), &block.gather(x, n)], &mut values);
            out.cost += values[..block.count].iter().sum::<f64>();
            block.scatter(&values[lanes..(1 + n) * lanes], &mut out.slope, n);
            let entries = values[(1 + n) * lanes..].chunks_exact(lanes);
            for (&(a, b), column) in self.hessian_entries.iter().zip(entries) {
                for (l, &v) in column[..block.count].iter().enumerate() {
                    let matrix = &mut out.curvature[(block.first + l) * n * n..][..n * n];
                    matrix[a * n + b] = v;
                    matrix[b * n + a] = v;
                }
            }
        }
        out
    }

    /// (z − g)/σ of the outputs, then 1/σ, both 0 where missing: N of 2 n_y.
    pub(super) fn residuals(&self, theta: &[f64], data: &[Vec<f64>], x: &[f64]) -> Vec<f64> {
        let (samples, rows) = (data[0].len(), 2 * self.n_y);
        let mut out = vec![0.0; samples * rows];
        let tape = Loaded::new(&self.scaled, theta);
        let mut workspace = Workspace::default();
        for block in blocks(samples) {
            let mut values = vec![0.0; rows * block.lanes];
            tape.run(&mut workspace, block.lanes, &[&block.cut(data), &block.gather(x, self.n)], &mut values);
            block.scatter(&values, &mut out, rows);
        }
        out
    }

    /// Slopes of the residuals (z − g)/σ, N of (n_y, columns), by the states and `p` parameters.
    pub(super) fn residual_slopes(&self, theta: &[f64], data: &[Vec<f64>], x: &[f64], p: usize) -> Vec<f64> {
        let (samples, columns) = (data[0].len(), self.n + p);
        let mut out = vec![0.0; samples * self.n_y * columns];
        let tape = Loaded::new(&self.residual, theta);
        let mut workspace = Workspace::default();
        for block in blocks(samples) {
            let mut values = vec![0.0; self.residual_entries.len() * block.lanes];
            tape.run(&mut workspace, block.lanes, &[&block.cut(data), &block.gather(x, self.n)], &mut values);
            let entries = values.chunks_exact(block.lanes);
            for (&(r, c), column) in self.residual_entries.iter().zip(entries).filter(|e| e.0.1 < columns) {
                for (l, &v) in column[..block.count].iter().enumerate() {
                    out[((block.first + l) * self.n_y + r) * columns + c] = v;
                }
            }
        }
        out
    }

    /// Gradient of a weighted sum: by x added to rows of n, by parameters to `by_theta`.
    pub(super) fn pull_back(
        &self,
        theta: &[f64],
        data: &[Vec<f64>],
        x: &[f64],
        weights: &Weights<'_>,
        by_x: &mut [f64],
        by_theta: &mut [f64],
    ) {
        let n = self.n;
        let tape = Loaded::new(&self.back, theta);
        let mut workspace = Workspace::default();
        let w: Vec<f64> = weights.curvature.chunks_exact(n * n).flat_map(|w| lower(w, n)).collect();
        for block in blocks(data[0].len()) {
            let lanes = block.lanes;
            let mut out = vec![0.0; self.back_places.len() * lanes];
            let inputs = [
                &block.cut(data)[..],
                &block.gather(x, n),
                &vec![weights.cost; lanes],
                &block.gather(weights.slope, n),
                &block.gather(&w, n * (n + 1) / 2),
            ];
            tape.run(&mut workspace, lanes, &inputs, &mut out);
            for (&place, column) in self.back_places.iter().zip(out.chunks_exact(lanes)) {
                if place < n {
                    for (l, v) in column[..block.count].iter().enumerate() {
                        by_x[(block.first + l) * n + place] += v;
                    }
                } else {
                    by_theta[place - n] += column[..block.count].iter().sum::<f64>();
                }
            }
        }
    }

    /// Outputs at all samples, n_y columns of N, and their slopes by x, N of (n_y, n).
    pub(super) fn outputs(
        &self,
        theta: &[f64],
        data: &[Vec<f64>],
        n_data: usize,
        x: &[f64],
    ) -> (Vec<Vec<f64>>, Vec<f64>) {
        let (n, n_y, samples) = (self.n, self.n_y, data[0].len());
        let tape = Loaded::new(&self.outputs, theta);
        let mut workspace = Workspace::default();
        let (mut out, mut slopes) = (vec![Vec::new(); n_y], vec![0.0; samples * n_y * n]);
        for block in blocks(samples) {
            let mut values = vec![0.0; (n_y + self.output_entries.len()) * block.lanes];
            let inputs = [&block.cut(&data[..n_data])[..], &block.gather(x, n)];
            tape.run(&mut workspace, block.lanes, &inputs, &mut values);
            let (outputs, entries) = values.split_at(n_y * block.lanes);
            for (column, all) in outputs.chunks_exact(block.lanes).zip(&mut out) {
                all.extend(&column[..block.count]);
            }
            for (&(r, c), column) in self.output_entries.iter().zip(entries.chunks_exact(block.lanes)) {
                for (l, v) in column[..block.count].iter().enumerate() {
                    slopes[((block.first + l) * n_y + r) * n + c] = *v;
                }
            }
        }
        (out, slopes)
    }
}
