//! Gradient, Jacobian and Hessian of the collocation problem against differences, entry by entry.

use std::collections::HashSet;

use crate::common::Random;
use crate::common::models::{self, guess, known_noise, mixed_noise, record};
use phugoid::Grid;
use phugoid::collocation::segments_in_chunk;
use phugoid::collocation::{Collocation, Settings};
use phugoid::model::Model;
use phugoid::nlp::check::check_derivatives;
use phugoid::nlp::{ConstraintId, ExperimentId, Named, Nlp, VariableId};
use phugoid::noise::Noise;

const ORDERS: [usize; 5] = [2, 3, 4, 5, 8];

/// Differences of step 6e-6 are good to 1e-8 or so of the terms that they are taken of.
const TOLERANCE: f64 = 1e-6;

fn problem(model: &Model, lengths: &[usize], noise: Noise, order: usize, grid: Vec<Grid>) -> Collocation {
    let records: Vec<_> = lengths
        .iter()
        .enumerate()
        .map(|(i, &n)| record(model, &format!("run {i}"), n, i == 0, 10 + i as u64))
        .collect();
    Collocation::new(model, &records, noise, &Settings::default().order(order).grid(grid).threads(1)).unwrap()
}

/// All derivatives, and what must hold of the structures.
fn check(problem: &Collocation, what: &str) {
    let all: Vec<VariableId> = (0..problem.n()).map(VariableId).collect();
    check_columns(problem, &all, what);
}

fn check_columns(problem: &Collocation, columns: &[VariableId], what: &str) {
    let mut random = Random(3);
    let lambda: Vec<f64> = (0..problem.m()).map(|_| random.between(-1.0, 1.0)).collect();
    let xi = guess(problem, 4);
    let wrong = check_derivatives(problem, &xi, &lambda, columns, TOLERANCE).unwrap();
    assert!(wrong.is_empty(), "{what}: {} wrong, first {:#?}", wrong.len(), &wrong[..wrong.len().min(4)]);

    let (n, m) = (problem.n(), problem.m());
    let s = problem.jacobian_structure();
    let places: HashSet<(u32, u32)> = s.rows.iter().copied().zip(s.columns.iter().copied()).collect();
    assert_eq!(places.len(), s.len(), "{what}: an entry of the Jacobian stands twice");
    assert!(places.iter().all(|&(r, c)| (r as usize) < m && (c as usize) < n), "{what}");
    let s = problem.hessian_structure();
    assert!(s.rows.iter().zip(&s.columns).all(|(r, c)| r >= c && (*r as usize) < n), "{what}");
}

fn grids() -> Vec<Grid> {
    // Two records of different lengths: both end where their grids say.
    vec![Grid::Samples(1), Grid::Samples(2), Grid::Uniform(5), Grid::Uniform(23)]
}

#[test]
fn a_linear_model() {
    let model = models::linear();
    for order in ORDERS {
        for grid in grids() {
            let what = format!("order {order}, {grid:?}");
            let problem = problem(&model, &[14, 9], mixed_noise(&model), order, vec![grid]);
            check(&problem, &what);
        }
    }
}

#[test]
fn a_nonlinear_model() {
    let model = models::nonlinear();
    for order in ORDERS {
        for grid in grids() {
            let what = format!("order {order}, {grid:?}");
            let problem = problem(&model, &[12, 9], mixed_noise(&model), order, vec![grid]);
            check(&problem, &what);
        }
    }
}

/// One function has its weight applied outside its tape.
#[test]
fn a_model_of_one_state() {
    let model = models::scalar();
    for order in ORDERS {
        for grid in grids() {
            let what = format!("order {order}, {grid:?}");
            let problem = problem(&model, &[15, 7, 2], mixed_noise(&model), order, vec![grid]);
            check(&problem, &what);
        }
    }
}

#[test]
fn edges_and_a_grid_for_each_experiment() {
    let model = models::nonlinear();
    for order in ORDERS {
        let one = record(&model, "one", 11, true, 20);
        let two = record(&model, "two", 8, false, 21);
        let (a, b) = (one.t[0], one.t[10]);
        let edges = vec![a, one.t[3], a + 0.45 * (b - a), a + 0.5 * (b - a), b];
        let grid = vec![Grid::Edges(edges), Grid::Samples(3)];
        let settings = Settings::default().order(order).grid(grid).threads(1);
        let problem = Collocation::new(&model, &[one, two], mixed_noise(&model), &settings).unwrap();
        check(&problem, &format!("order {order}"));
    }
}

#[test]
fn known_standard_deviations() {
    let model = models::nonlinear();
    for order in [2, 4] {
        let problem = problem(&model, &[12], known_noise(&model), order, vec![Grid::Samples(1)]);
        assert_eq!(problem.posed.parameters.len(), model.parameters.len());
        check(&problem, &format!("order {order}"));
    }
}

/// Records long enough for several chunks of segments and blocks of samples.
#[test]
fn boundaries_of_chunks() {
    let model = models::nonlinear();
    for (order, samples, coinciding) in [
        (2, 60, false),
        (2, 0, true),
        (3, 0, true),
        (4, 0, true),
        (4, 70, false),
        (5, 30, false),
        (8, 30, false),
        (8, 0, true),
        (64, 10, false),
    ] {
        // Between two and three chunks in the first record.
        let segments = 2 * segments_in_chunk(order) + 3;
        let (grid, samples) =
            if coinciding { (Grid::Samples(1), segments + 1) } else { (Grid::Uniform(segments), samples) };
        let problem = problem(&model, &[samples, 7], mixed_noise(&model), order, vec![grid.clone()]);
        // Parameters, and points about the ends of chunks and of experiments.
        let layout = &problem.layout;
        let per_chunk = segments_in_chunk(order) * (order - 1);
        let mut points = HashSet::new();
        for (e, mesh) in problem.meshes.numbered() {
            let first = layout.first_point[e];
            for boundary in (0..mesh.n_mesh).step_by(per_chunk).chain([mesh.n_mesh - 1]) {
                let near = boundary.saturating_sub(order)..(boundary + order + 1).min(mesh.n_mesh);
                points.extend(near.map(|p| first + p));
            }
            // Samples between points, in segments on either side of a boundary.
            let segments = per_chunk / (order - 1);
            let near = |s: usize| [0, segments - 1].contains(&(s % segments));
            points.extend(mesh.between.iter().filter(|b| near(b.segment)).map(|b| first + b.point));
        }
        let states = points.iter().flat_map(|&p| (0..layout.n_x).map(move |r| layout.state(p) + r));
        let mut columns: Vec<VariableId> = (0..layout.n_theta).map(VariableId).chain(states).collect();
        columns.sort_unstable();
        check_columns(&problem, &columns, &format!("order {order}, {grid:?}"));
    }
}

/// The objective is −ℓ (Eq. oem_coll_obj) written out, missing samples left out.
#[test]
fn the_objective_is_the_likelihood_written_out() {
    let model = models::linear();
    let records = [record(&model, "one", 90, true, 30), record(&model, "two", 20, false, 31)];
    for grid in [Grid::Samples(1), Grid::Uniform(30)] {
        let settings = Settings::default().order(3).grid(vec![grid]).threads(1);
        let problem = Collocation::new(&model, &records, mixed_noise(&model), &settings).unwrap();
        let xi = guess(&problem, 5);
        let sigma = problem.posed.noise.sigmas(&xi[problem.posed.n_model_parameters..]);
        let mut expected = 0.0;
        for (e, record) in records.iter().enumerate().map(|(e, r)| (ExperimentId(e), r)) {
            let y = problem.outputs_at_samples(&xi, e);
            for (c, sigma) in sigma.iter().enumerate() {
                for (z, y) in record.outputs[c].iter().zip(&y[c]).filter(|(z, _)| !z.is_nan()) {
                    expected += 0.5 * ((z - y) / sigma).powi(2) + sigma.ln();
                }
            }
            // The outputs, from the states at the samples.
            let p = |name: &str| {
                problem.posed.parameters.iter().position(|p| p.name == name).map(|i| xi[i]).unwrap()
            };
            for (i, &point) in problem.meshes[e].sample_points.iter().enumerate() {
                let at = problem.layout.state(problem.layout.first_point[e] + point);
                let (w, q) = (xi[at], xi[at + 1]);
                let az = p("Zw") * w + p("Zq") * q + p("Zde") * record.inputs[0][i];
                for (c, expected) in [w, q, az].into_iter().enumerate() {
                    assert!((y[c][i] - expected).abs() < 1e-12 * (1.0 + expected.abs()));
                }
            }
        }
        let found = problem.objective(&xi).unwrap();
        assert!((found - expected).abs() < 1e-12 * expected.abs(), "{found}, {expected}");
    }
}

/// Priors enter as ½((θ − mean)/std)².
#[test]
fn priors_add_to_the_objective() {
    let model = models::nonlinear();
    let mut plain = model.clone();
    plain.parameters.iter_mut().for_each(|p| p.prior = None);
    let build = |m: &Model| problem(m, &[12], known_noise(m), 4, vec![Grid::Samples(1)]);
    let (with, without) = (build(&model), build(&plain));
    let xi = guess(&with, 6);
    let difference = with.objective(&xi).unwrap() - without.objective(&xi).unwrap();
    let expected = 0.5 * ((0.3f64 - 0.2) / 0.05).powi(2) + 0.5 * ((-0.6f64 + 0.5) / 0.3).powi(2);
    assert!((difference - expected).abs() < 1e-10, "{difference}, {expected}");
}

#[test]
fn bounds_hold_fixed_parameters_and_positive_precisions() {
    let model = models::nonlinear();
    let problem = problem(&model, &[12], mixed_noise(&model), 4, vec![Grid::Samples(1)]);
    let (lower, upper) = problem.bounds();
    let place = |name: &str| problem.posed.parameters.iter().position(|p| p.name == name).unwrap();
    assert_eq!((lower[place("k")], upper[place("k")]), (0.4, 0.4));
    assert_eq!((lower[place("CLa")], upper[place("CLa")]), (0.0, 9.0));
    assert_eq!((lower[place("Cmq")], upper[place("Cmq")]), (f64::NEG_INFINITY, f64::INFINITY));
    let sigma = place("sigma_V");
    assert!((lower[sigma] - 1e-3).abs() < 1e-15 && (upper[sigma] - 1e3).abs() < 1e-9);
    assert!(lower[problem.layout.n_theta..].iter().all(|v| *v == f64::NEG_INFINITY));
}

#[test]
fn every_variable_and_constraint_has_its_own_name() {
    let model = models::nonlinear();
    let problem = problem(&model, &[12, 9], mixed_noise(&model), 4, vec![Grid::Uniform(5)]);
    let variables: HashSet<String> = (0..problem.n()).map(|i| problem.variable_name(VariableId(i))).collect();
    assert_eq!(variables.len(), problem.n());
    let constraints: HashSet<String> =
        (0..problem.m()).map(|i| problem.constraint_name(ConstraintId(i))).collect();
    assert_eq!(constraints.len(), problem.m());
    assert_eq!(problem.variable_name(VariableId(0)), "CL0");
    // States stand in the order in which they were declared, not that of their equations.
    let first = problem.variable_name(VariableId(problem.layout.n_theta));
    assert_eq!(first, "V at t = 0.3 of 'run 0'");
    let last = problem.constraint_name(ConstraintId(problem.m() - 1));
    assert!(last.starts_with("defect of q ending at") && last.ends_with("of 'run 1'"), "{last}");
}
