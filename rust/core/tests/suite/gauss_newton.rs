//! The Gauss-Newton Hessian of the objective: first derivatives of residuals alone.
#![allow(clippy::needless_range_loop)] // one index into several columns

use std::collections::HashMap;

use crate::common::models::{self, guess, known_noise, mixed_noise, record};
use nalgebra::DMatrix;
use phugoid::Grid;
use phugoid::collocation::{Collocation, Settings};
use phugoid::model::Model;
use phugoid::nlp::Nlp;
use phugoid::noise::Noise;

fn problem(model: &Model, noise: Noise, grid: Grid) -> Collocation {
    let records = [record(model, "one", 13, true, 1), record(model, "two", 6, false, 2)];
    Collocation::new(model, &records, noise, &Settings::default().order(3).grid(vec![grid]).threads(1))
        .unwrap()
}

/// A full symmetric matrix from the entries of its lower triangle.
fn full(problem: &Collocation, entries: &[f64]) -> DMatrix<f64> {
    let s = problem.hessian_structure();
    let mut matrix = DMatrix::zeros(problem.n(), problem.n());
    for (k, value) in entries.iter().enumerate() {
        let (row, column) = (s.rows[k] as usize, s.columns[k] as usize);
        matrix[(row, column)] += value;
        if row != column {
            matrix[(column, row)] += value;
        }
    }
    matrix
}

fn gauss_newton(problem: &Collocation, xi: &[f64], factor: f64) -> DMatrix<f64> {
    let mut entries = vec![f64::NAN; problem.hessian_structure().len()];
    problem.gauss_newton(xi, factor, &mut entries).unwrap();
    full(problem, &entries)
}

/// Residuals over σ of all samples, from the outputs at ξ.
fn residuals(problem: &Collocation, xi: &[f64], measured: &[Vec<Vec<f64>>]) -> Vec<f64> {
    let sigma = problem.posed.noise.sigmas(&xi[problem.posed.n_model_parameters..]);
    let mut all = Vec::new();
    for (e, z) in measured.iter().enumerate() {
        for ((y, z), sigma) in
            problem.outputs_at_samples(xi, phugoid::nlp::ExperimentId(e)).iter().zip(z).zip(&sigma)
        {
            all.extend(y.iter().zip(z).filter(|(_, z)| !z.is_nan()).map(|(y, z)| (z - y) / sigma));
        }
    }
    all
}

#[test]
fn it_is_the_square_of_the_jacobian_of_residuals() {
    for (model, noise) in [
        (models::nonlinear(), known_noise(&models::nonlinear())),
        (models::nonlinear(), mixed_noise(&models::nonlinear())),
        (models::scalar(), mixed_noise(&models::scalar())),
    ] {
        for grid in [Grid::Samples(1), Grid::Uniform(5)] {
            let problem = problem(&model, noise.clone(), grid);
            let xi = guess(&problem, 3);
            let measured: Vec<Vec<Vec<f64>>> =
                [record(&model, "", 13, true, 1), record(&model, "", 6, false, 2)].map(|r| r.outputs).into();
            let rows = residuals(&problem, &xi, &measured).len();
            let mut jacobian = DMatrix::zeros(rows, problem.n());
            for j in 0..problem.n() {
                let moved = |d: f64| {
                    let mut x = xi.clone();
                    x[j] += d;
                    residuals(&problem, &x, &measured)
                };
                let (high, low) = (moved(1e-5), moved(-1e-5));
                for i in 0..rows {
                    jacobian[(i, j)] = (high[i] - low[i]) / 2e-5;
                }
            }
            let mut expected = jacobian.transpose() * &jacobian;
            // −ln(1/σ) of every sample, and priors.
            let mut counts: HashMap<usize, f64> = HashMap::new();
            let unknown: Vec<usize> = (0..model.outputs.len())
                .filter(|&c| {
                    problem
                        .posed
                        .parameters
                        .iter()
                        .any(|p| p.name == format!("sigma_{}", model.outputs[c].name))
                })
                .collect();
            for (i, &c) in unknown.iter().enumerate() {
                let present = measured.iter().flat_map(|z| &z[c]).filter(|z| !z.is_nan()).count();
                counts.insert(problem.posed.n_model_parameters + i, present as f64);
            }
            for (&i, count) in &counts {
                expected[(i, i)] += count / (xi[i] * xi[i]);
            }
            for (i, p) in problem.posed.parameters.iter().enumerate() {
                expected[(i, i)] += p.prior.map_or(0.0, |(_, std)| 1.0 / (std * std));
            }
            for factor in [1.0, 0.3] {
                let found = gauss_newton(&problem, &xi, factor);
                let scale = expected.amax();
                let error = (found - factor * &expected).amax();
                assert!(error < 1e-8 * scale, "{}: off by {error:e} of {scale:e}", model.name);
            }
        }
    }
}

#[test]
fn it_is_never_indefinite() {
    let model = models::nonlinear();
    let problem = problem(&model, mixed_noise(&model), Grid::Samples(1));
    for seed in 0..5 {
        let matrix = gauss_newton(&problem, &guess(&problem, seed), 1.0);
        let scale = matrix.amax();
        let lowest = matrix.symmetric_eigenvalues().min();
        assert!(lowest > -1e-12 * scale, "{lowest:e} of {scale:e}");
    }
}

/// Outputs linear in the states, σ known: nothing is left out.
#[test]
fn it_is_exact_for_linear_outputs() {
    let mut model = models::linear();
    model.outputs.truncate(2); // w and q themselves
    let problem = problem(&model, known_noise(&model), Grid::Uniform(5));
    let xi = guess(&problem, 4);
    let mut entries = vec![f64::NAN; problem.hessian_structure().len()];
    problem.hessian(&xi, 0.8, &vec![0.0; problem.m()], &mut entries).unwrap();
    assert_eq!(gauss_newton(&problem, &xi, 0.8), full(&problem, &entries));
}
