//! Gradient, Jacobian and Hessian of the shooting problem against differences, entry by entry.

use std::collections::HashSet;

use crate::common::Random;
use crate::common::models::{linear, mixed_noise, nonlinear, record, scalar};
use phugoid::Grid;
use phugoid::model::Model;
use phugoid::nlp::check::check_derivatives;
use phugoid::nlp::{ExperimentId, Nlp, VariableId};
use phugoid::shooting::{Integrator, Steps};
use phugoid::shooting::{Shooting, Shots};

/// Differences of step 6e-6 are good to 1e-8 or so of the terms that they are taken of.
const TOLERANCE: f64 = 1e-6;

fn problem(model: &Model, lengths: &[usize], settings: &Shots) -> Shooting {
    let records: Vec<_> = lengths
        .iter()
        .enumerate()
        .map(|(i, &n)| record(model, &format!("run {i}"), n, i == 0, 10 + i as u64))
        .collect();
    Shooting::new(model, &records, mixed_noise(model), settings).unwrap()
}

/// Parameters at their starts, states random about 0.8 or so.
fn guess(problem: &Shooting, seed: u64) -> Vec<f64> {
    let mut random = Random(seed);
    let start = |i| problem.posed.estimands.transforms[i].inverse(problem.posed.parameters[i].start);
    let mut xi: Vec<f64> = (0..problem.posed.n_model_parameters).map(VariableId).map(start).collect();
    xi.extend(problem.posed.parameters.iter().skip(problem.posed.n_model_parameters).map(|p| p.start));
    xi.resize_with(problem.n(), || random.between(0.5, 1.1));
    xi
}

/// All derivatives, and what must hold of the structures.
fn check(problem: &Shooting, what: &str) {
    let mut random = Random(3);
    let lambda: Vec<f64> = (0..problem.m()).map(|_| random.between(-1.0, 1.0)).collect();
    let all: Vec<VariableId> = (0..problem.n()).map(VariableId).collect();
    let wrong = check_derivatives(problem, &guess(problem, 4), &lambda, &all, TOLERANCE).unwrap();
    assert!(wrong.is_empty(), "{what}: {} wrong, first {:#?}", wrong.len(), &wrong[..wrong.len().min(4)]);

    let s = problem.jacobian_structure();
    let places: HashSet<(u32, u32)> = s.rows.iter().copied().zip(s.columns.iter().copied()).collect();
    assert_eq!(places.len(), s.len(), "{what}: an entry of the Jacobian stands twice");
    let s = problem.hessian_structure();
    assert!(s.rows.iter().zip(&s.columns).all(|(r, c)| r >= c && (*r as usize) < problem.n()), "{what}");
}

fn settings(integrator: Integrator, segments: usize, steps: Steps) -> Shots {
    Shots::default().grid(vec![Grid::Uniform(segments)]).integrator(integrator).steps(steps).threads(1)
}

/// Steps from sample to sample, and such that samples lie within them.
#[test]
fn every_integrator_with_and_without_dense_output() {
    for model in [linear(), nonlinear(), scalar()] {
        for integrator in Integrator::ALL {
            for segments in [1, 2, 5, 11] {
                for steps in [Steps::Samples(1), Steps::Number(3), Steps::Length(0.05)] {
                    let what = format!("{}, {integrator:?}, {segments} segments, {steps:?}", model.name);
                    check(&problem(&model, &[9, 7], &settings(integrator, segments, steps)), &what);
                }
            }
        }
    }
}

#[test]
fn edges_and_a_grid_for_each_experiment() {
    let model = nonlinear();
    let (one, two) = (record(&model, "one", 11, true, 20), record(&model, "two", 8, false, 21));
    let (a, b) = (one.t[0], one.t[10]);
    let edges = vec![a, one.t[3], a + 0.45 * (b - a), a + 0.5 * (b - a), b];
    for steps in [Steps::Samples(2), Steps::Number(4)] {
        for second in [Grid::Samples(1), Grid::Uniform(1)] {
            let grid = vec![Grid::Edges(edges.clone()), second];
            let settings = Shots::default().grid(grid).steps(steps.clone()).threads(1);
            let records = [one.clone(), two.clone()];
            let problem = Shooting::new(&model, &records, mixed_noise(&model), &settings).unwrap();
            check(&problem, &format!("{steps:?}"));
        }
    }
}

#[test]
fn parameters_of_each_experiment_and_transformed_ones() {
    use phugoid::model::Transform;
    let mut model = nonlinear();
    model.parameters[1].transform = Transform::Log;
    model.parameters[3].local = true;
    model.parameters[3].transform = Transform::Scale(0.1);
    model.parameters[5].local = true;
    for segments in [1, 2, 6] {
        let settings = settings(Integrator::Rk4, segments, Steps::Number(3));
        let problem = problem(&model, &[9, 7, 8], &settings);
        assert!(problem.posed.estimands.any_local());
        check(&problem, &format!("{segments} segments"));
    }
}

/// Gauss-Newton's Hessian is the sum over samples of JᵀJ, and so what is left of the exact one where residuals are 0.
#[test]
fn gauss_newton_is_exact_without_residuals() {
    let model = nonlinear();
    for segments in [1, 5] {
        let build = |records: &[phugoid::Experiment]| {
            let settings = settings(Integrator::Rk4, segments, Steps::Number(4));
            let noise = crate::common::models::known_noise(&model);
            Shooting::new(&model, records, noise, &settings).unwrap()
        };
        let mut records = [record(&model, "run", 9, false, 10)];
        let problem = build(&records);
        let xi = guess(&problem, 4);
        records[0].outputs =
            phugoid::internals::problem::Transcribed::outputs_at_samples(&problem, &xi, ExperimentId(0));
        let problem = build(&records);
        let size = problem.hessian_structure().len();
        let (mut exact, mut approximate) = (vec![0.0; size], vec![f64::NAN; size]);
        problem.hessian(&xi, 0.7, &vec![0.0; problem.m()], &mut exact).unwrap();
        problem.gauss_newton(&xi, 0.7, &mut approximate).unwrap();
        // Priors are not at their means, but linear in the variables.
        for (a, b) in exact.iter().zip(&approximate) {
            assert!((a - b).abs() < 1e-9 * (1.0 + a.abs()), "{a}, {b}");
        }
    }
}

/// A problem with many groups has the same bits for any number of threads.
#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let model = nonlinear();
    let records = [record(&model, "one", 400, true, 1), record(&model, "two", 150, false, 2)];
    let evaluate = |threads: usize| -> Vec<u64> {
        let settings = settings(Integrator::Rk4, 60, Steps::Number(5)).threads(threads);
        let p = Shooting::new(&model, &records, mixed_noise(&model), &settings).unwrap();
        let xi = guess(&p, 3);
        let lambda: Vec<f64> = (0..p.m()).map(|i| (0.37 * i as f64).sin()).collect();
        let (mut gradient, mut c) = (vec![0.0; p.n()], vec![0.0; p.m()]);
        let mut jacobian = vec![0.0; p.jacobian_structure().len()];
        let mut hessian = vec![0.0; p.hessian_structure().len()];
        p.gradient(&xi, &mut gradient).unwrap();
        p.constraints(&xi, &mut c).unwrap();
        p.jacobian(&xi, &mut jacobian).unwrap();
        p.hessian(&xi, 0.7, &lambda, &mut hessian).unwrap();
        let objective = p.objective(&xi).unwrap();
        let all = gradient.iter().chain(&c).chain(&jacobian).chain(&hessian).chain([&objective]);
        all.map(|v| v.to_bits()).collect()
    };
    let one = evaluate(1);
    for threads in [2, 5, 0] {
        assert!(evaluate(threads) == one, "{threads} threads");
    }
}
