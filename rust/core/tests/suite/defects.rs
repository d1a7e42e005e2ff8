//! The defects (Eq. oem_coll_cxdot) written out: f node by node, data at the times of the points.
#![allow(clippy::needless_range_loop)] // one index into several columns

use crate::common::models::{self, guess, known_noise, record};
use crate::common::values;
use phugoid::Grid;
use phugoid::collocation::{Collocation, Settings};
use phugoid::internals::interpolate::{Interpolation, interpolate};
use phugoid::model::Model;
use phugoid::nlp::{ConstraintId, Named, Nlp};

fn check(model: &Model, order: usize, grid: Grid, interpolation: Interpolation) {
    // The first record is longer than a chunk.
    let mut records = [record(model, "one", 90, false, 1), record(model, "two", 8, false, 2)];
    records.iter_mut().for_each(|r| r.interpolation = interpolation);
    let settings = Settings::default().order(order).grid(vec![grid]).threads(1);
    let problem = Collocation::new(model, &records, known_noise(model), &settings).unwrap();
    let xi = guess(&problem, 3);
    let mut found = vec![f64::NAN; problem.m()];
    problem.constraints(&xi, &mut found).unwrap();

    let (f, _) = model.expanded();
    let n_x = model.states.len();
    let mut expected = Vec::new();
    for (record, (e, mesh)) in records.iter().zip(problem.meshes.numbered()) {
        let inputs: Vec<Vec<f64>> =
            record.inputs.iter().map(|u| interpolate(interpolation, &record.t, u, &mesh.times)).collect();
        let x = |point: usize| &xi[problem.layout.states(problem.layout.first_point[e] + point)];
        let f_at = |point: usize| -> Vec<f64> {
            let mut at = values(&[("time", mesh.times[point])]);
            at.extend(problem.posed.parameters.iter().zip(&xi).map(|(p, v)| (p.name.as_str().into(), *v)));
            at.extend(model.states.iter().zip(x(point)).map(|(s, v)| (s.name.as_str().into(), *v)));
            at.extend(model.inputs.iter().zip(&inputs).map(|(u, v)| (u.name.as_str().into(), v[point])));
            f.iter().map(|f| f.evaluate(&at).unwrap()).collect()
        };
        let c = mesh.rule.lgl.integration_matrix();
        for segment in &mesh.segments {
            let slopes: Vec<Vec<f64>> = (0..order).map(|j| f_at(segment.point + j)).collect();
            for k in 0..order - 1 {
                for r in 0..n_x {
                    let moved: f64 = (0..order).map(|j| c[j * (order - 1) + k] * slopes[j][r]).sum();
                    let point = segment.point + k;
                    expected.push(x(point + 1)[r] - x(point)[r] - segment.h * moved);
                }
            }
        }
        for b in &mesh.between {
            let segment = mesh.segments[b.segment];
            let place = (mesh.times[b.point] - segment.t) / segment.h;
            let weights = mesh.rule.lgl.integrate_to(b.node, place);
            let slopes: Vec<Vec<f64>> = (0..order).map(|j| f_at(segment.point + j)).collect();
            for r in 0..n_x {
                let moved: f64 = (0..order).map(|j| weights[j] * slopes[j][r]).sum();
                expected.push(x(b.point)[r] - x(segment.point + b.node)[r] - segment.h * moved);
            }
        }
    }
    assert_eq!(found.len(), expected.len());
    for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
        assert!(
            (found - expected).abs() < 1e-12 * (1.0 + expected.abs()),
            "{}, order {order}: {found} for {expected}",
            problem.constraint_name(ConstraintId(i))
        );
    }
}

#[test]
fn defects_are_those_of_the_model_and_the_data() {
    for model in [models::linear(), models::nonlinear(), models::scalar()] {
        for order in [2, 3, 4, 8] {
            for grid in [Grid::Samples(1), Grid::Samples(3), Grid::Uniform(40)] {
                for interpolation in [Interpolation::Linear, Interpolation::Cubic] {
                    check(&model, order, grid.clone(), interpolation);
                }
            }
        }
    }
}
