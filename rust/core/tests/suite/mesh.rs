//! Meshes: segments, points, and where the samples lie.

use phugoid::ErrorKind;
use phugoid::internals::mesh::{Grid, Mesh};

const ORDERS: [usize; 6] = [2, 3, 4, 5, 8, 12];

fn irregular() -> Vec<f64> {
    vec![1.0, 1.1, 1.25, 1.3, 1.7, 2.0, 2.01, 2.6, 3.0]
}

/// What must hold of any mesh.
fn sound(mesh: &Mesh, t: &[f64]) {
    let m = mesh.rule.order();
    // Points: segments one after the other, sharing their ends; then samples between points.
    assert_eq!(mesh.n_mesh, mesh.segments.len() * (m - 1) + 1);
    assert_eq!(mesh.len(), mesh.n_mesh + mesh.between.len());
    assert_eq!(mesh.rows(), mesh.len() - 1);
    assert!(mesh.times[..mesh.n_mesh].is_sorted_by(|a, b| a < b), "{:?}", mesh.times);
    assert_eq!((mesh.times[0], mesh.times[mesh.n_mesh - 1]), (t[0], t[t.len() - 1]));
    for (s, segment) in mesh.segments.iter().enumerate() {
        assert_eq!(segment.point, s * (m - 1));
        assert_eq!(segment.t, mesh.times[segment.point]);
        for (j, node) in mesh.rule.lgl.nodes.iter().enumerate() {
            let expected = segment.t + node * segment.h;
            assert!((mesh.times[segment.point + j] - expected).abs() < 1e-12);
        }
    }
    // Every sample has its own point, at its time.
    assert_eq!(mesh.sample_points.len(), t.len());
    for (&point, &time) in mesh.sample_points.iter().zip(t) {
        assert!((mesh.times[point] - time).abs() < 1e-9, "sample at {time} at point {point}");
    }
    let mut points = mesh.sample_points.clone();
    points.sort_unstable();
    points.dedup();
    assert_eq!(points.len(), t.len(), "two samples share a point");
    // Samples between points: in time order, right of their node.
    for (i, b) in mesh.between.iter().enumerate() {
        assert_eq!(b.point, mesh.n_mesh + i);
        let segment = mesh.segments[b.segment];
        let (time, left) = (mesh.times[b.point], segment.point + b.node);
        assert!(mesh.times[left] < time && time < mesh.times[left + 1], "{time} after node {}", b.node);
        assert_eq!(b.weights.len(), m);
    }
    assert!(mesh.between.is_sorted_by_key(|b| b.segment));
}

#[test]
fn samples_are_ends_of_segments() {
    let t = irregular();
    for m in ORDERS {
        for substeps in [1, 2, 5] {
            let mesh = Mesh::new(m, &Grid::Samples(substeps), &t).unwrap();
            sound(&mesh, &t);
            assert_eq!(mesh.segments.len(), (t.len() - 1) * substeps);
            assert!(mesh.between.is_empty());
            let expected: Vec<usize> = (0..t.len()).map(|i| i * substeps * (m - 1)).collect();
            assert_eq!(mesh.sample_points, expected);
            for (i, w) in t.windows(2).enumerate() {
                for segment in &mesh.segments[i * substeps..(i + 1) * substeps] {
                    assert!((segment.h - (w[1] - w[0]) / substeps as f64).abs() < 1e-14);
                }
            }
        }
    }
}

#[test]
fn times_far_from_zero_keep_their_samples_on_the_mesh() {
    // Seconds since 1970, at 100 Hz: rounding is a fifty-thousandth of an interval.
    let t: Vec<f64> = (0..200).map(|i| 1.7e9 + 0.01 * f64::from(i)).collect();
    for m in ORDERS {
        let mesh = Mesh::new(m, &Grid::Samples(1), &t).unwrap();
        assert!(mesh.between.is_empty());
        let expected: Vec<usize> = (0..t.len()).map(|i| i * (m - 1)).collect();
        assert_eq!(mesh.sample_points, expected);
    }
}

#[test]
fn a_uniform_grid_that_meets_no_samples_ties_them() {
    let t = irregular();
    for m in ORDERS {
        for n in [1, 3, 7, 40] {
            let mesh = Mesh::new(m, &Grid::Uniform(n), &t).unwrap();
            sound(&mesh, &t);
            assert_eq!(mesh.segments.len(), n);
            for segment in &mesh.segments {
                assert!((segment.h - 2.0 / n as f64).abs() < 1e-14);
            }
            // The first and the last sample are points always.
            assert_eq!(mesh.sample_points[0], 0);
            assert_eq!(*mesh.sample_points.last().unwrap(), mesh.n_mesh - 1);
        }
    }
}

#[test]
fn a_uniform_grid_that_meets_the_samples_ties_none() {
    let t: Vec<f64> = (0..=30).map(|i| 0.1 * f64::from(i)).collect();
    for m in ORDERS {
        for factor in [1, 3] {
            let mesh = Mesh::new(m, &Grid::Uniform(30 * factor), &t).unwrap();
            sound(&mesh, &t);
            assert!(mesh.between.is_empty(), "order {m}: {:?}", mesh.between);
        }
    }
    // Order 3 has its middle node on every second sample.
    let mesh = Mesh::new(3, &Grid::Uniform(15), &t).unwrap();
    assert!(mesh.between.is_empty());
    assert_eq!(mesh.sample_points, (0..=30).collect::<Vec<usize>>());
}

#[test]
fn edges_are_used_as_given() {
    let t = irregular();
    let edges = vec![1.0, 1.2, 1.25, 2.9, 3.0];
    for m in ORDERS {
        let mesh = Mesh::new(m, &Grid::Edges(edges.clone()), &t).unwrap();
        sound(&mesh, &t);
        let starts: Vec<f64> = mesh.segments.iter().map(|s| s.t).collect();
        assert_eq!(starts, edges[..4]);
    }
}

#[test]
fn wrong_options_are_named() {
    let t = irregular();
    let cases = [
        (1, Grid::Samples(1), "order 1"),
        (0, Grid::Samples(1), "order 0"),
        (65, Grid::Samples(1), "order 65"),
        (4, Grid::Samples(0), "at least one segment"),
        (4, Grid::Uniform(0), "at least one segment"),
        (4, Grid::Edges(vec![]), "first sample (1)"),
        (4, Grid::Edges(vec![1.0]), "end at the last (3)"),
        (4, Grid::Edges(vec![0.0, 3.0]), "first sample (1)"),
        (4, Grid::Edges(vec![1.0, 2.0]), "end at the last (3)"),
        (4, Grid::Edges(vec![1.0, 2.0, 2.0, 3.0]), "edge 2"),
        (4, Grid::Edges(vec![1.0, 2.5, 2.0, 3.0]), "edge 2"),
        (4, Grid::Edges(vec![1.0, f64::NAN, 3.0]), "edge 1"),
        (4, Grid::Edges(vec![f64::NAN, 2.0, 3.0]), "first sample"),
    ];
    for (order, grid, named) in cases {
        match Mesh::new(order, &grid, &t) {
            Err(error) if error.kind() == ErrorKind::Option => {
                assert!(error.to_string().contains(named), "'{named}' is not in: {error}");
            }
            other => panic!("{grid:?} of order {order}: {other:?}"),
        }
    }
}

/// Two samples so close that they would be one point of a long segment: their likelihood terms
/// would overwrite each other.
#[test]
fn samples_closer_than_the_mesh_can_tell_are_refused() {
    let t = [0.0, 0.5, 0.5 + 1e-11, 1.0];
    for grid in [Grid::Uniform(2), Grid::Edges(vec![0.0, 0.5, 1.0])] {
        match Mesh::new(4, &grid, &t) {
            Err(error) if error.kind() == ErrorKind::Data => {
                assert!(error.to_string().contains("0.5"), "{error}")
            }
            other => panic!("{other:?}"),
        }
    }
    sound(&Mesh::new(4, &Grid::Samples(1), &t).unwrap(), &t);
}

/// The polynomial Σ i·τ^i of a degree, and its integral, τ from the start of the record.
fn polynomial(degree: usize, tau: f64) -> (f64, f64) {
    let term = |i: usize| (i + 1) as f64 * tau.powi(i as i32);
    ((0..=degree).map(term).sum(), (0..=degree).map(|i| tau.powi(i as i32 + 1)).sum())
}

#[test]
fn dense_output_is_exact_for_polynomials() {
    let t = irregular();
    for m in ORDERS {
        for n in [1, 3, 7] {
            let mesh = Mesh::new(m, &Grid::Uniform(n), &t).unwrap();
            assert!(!mesh.between.is_empty());
            for b in &mesh.between {
                let segment = mesh.segments[b.segment];
                for degree in 0..m {
                    let at = |point: usize| polynomial(degree, mesh.times[point] - t[0]);
                    let moved: f64 =
                        b.weights.iter().enumerate().map(|(j, w)| w * at(segment.point + j).0).sum();
                    let found = at(segment.point + b.node).1 + moved;
                    let expected = at(b.point).1;
                    assert!(
                        (found - expected).abs() <= 1e-13 * expected,
                        "order {m}, degree {degree}: {found}, {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn the_integration_matrix_is_exact_for_polynomials() {
    let t = irregular();
    for m in ORDERS {
        let mesh = Mesh::new(m, &Grid::Samples(1), &t).unwrap();
        for segment in &mesh.segments {
            for degree in 0..m {
                let at = |j: usize| polynomial(degree, mesh.times[segment.point + j] - t[0]);
                for k in 0..m - 1 {
                    let found: f64 = (0..m).map(|j| segment.h * mesh.rule.c(j, k) * at(j).0).sum();
                    let expected = at(k + 1).1 - at(k).1;
                    assert!((found - expected).abs() <= 1e-13 * at(k + 1).1, "order {m}, degree {degree}");
                }
            }
        }
    }
}
