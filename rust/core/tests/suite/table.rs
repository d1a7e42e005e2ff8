//! Interpolation tables: values, smoothness, derivatives, errors.

#[cfg(feature = "serde")]
use std::collections::HashSet;

use phugoid::{Table, TableError};
use proptest::prelude::*;

const X: [f64; 6] = [-2.0, -1.5, 0.1, 0.7, 2.0, 3.1];
const Y: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

fn f(x: f64, y: f64) -> f64 {
    (1.3 * x).sin() + x * y * y - (2.0 * y).cos() * x
}

fn one() -> Table {
    let values: Vec<f64> = X.iter().map(|&x| f(x, 0.4)).collect();
    Table::new_1d("Cm", &X, &values).unwrap()
}

fn two() -> Table {
    let mut values = Vec::new();
    for x in X {
        values.extend(Y.map(|y| f(x, y)));
    }
    Table::new_2d("CL", &X, &Y, &values).unwrap()
}

fn close(found: f64, expected: f64, tolerance: f64) {
    let error = (found - expected).abs();
    assert!(error <= tolerance, "{found} != {expected}, off by {error:e}");
}

/// Points inside cells, on grid points, on the edges, and outside.
fn points(axis: &[f64]) -> Vec<f64> {
    let (first, last) = (axis[0], axis[axis.len() - 1]);
    let mut points = vec![first - 3.0, first - 0.2, last + 0.2, last + 3.0];
    for pair in axis.windows(2) {
        points.push(pair[0]);
        points.push(pair[0] + 0.37 * (pair[1] - pair[0]));
    }
    points.push(last);
    points
}

#[test]
fn grid_values_are_reproduced_bit_for_bit() {
    let (one, two) = (one(), two());
    for (i, x) in X.into_iter().enumerate() {
        assert_eq!(one.eval1(0, x), one.values()[i]);
        for (j, y) in Y.into_iter().enumerate() {
            assert_eq!(two.eval2(0, 0, x, y), two.values()[i * Y.len() + j]);
        }
    }
    assert_eq!((one.name(), one.dimension(), two.dimension()), ("Cm", 1, 2));
    assert_eq!(two.axes(), [X.to_vec(), Y.to_vec()]);
}

/// Expected values by scipy 1.17.1, `CubicSpline(x, v, bc_type="natural")`.
#[test]
fn natural_spline_agrees_with_scipy() {
    let table = Table::new_1d("t", &X, &[1.0, -0.5, 0.25, 2.0, 1.75, -1.0]).unwrap();
    for (x, expected) in SCIPY {
        for (order, expected) in expected.into_iter().enumerate() {
            close(table.eval1(order as u8, x), expected, 2e-14);
        }
    }
}

const SCIPY: [(f64, [f64; 3]); 4] = [
    (-1.8, [0.3441569981823202, -3.1728473865785336, 1.595514337647998]),
    (-0.3, [-0.6915935366978992, 1.7981493704099147, 2.900133705418741]),
    (0.7, [2.0, 2.2175730155831808, -4.764093085009931]),
    (2.9, [-0.443473393827652, -2.7633076954182014, -0.2898800316530654]),
];

#[test]
fn first_to_third_derivatives_agree_with_differences() {
    let table = one();
    let h = 1e-5;
    for x in points(&X) {
        for order in 1..=2 {
            let difference = (table.eval1(order - 1, x + h) - table.eval1(order - 1, x - h)) / (2.0 * h);
            // At a grid point the second derivative has a kink, whose two
            // sides the difference averages.
            close(table.eval1(order, x), difference, 1e-4 * f64::from(order));
        }
        let one_sided = (table.eval1(2, x + h) - table.eval1(2, x)) / h;
        close(table.eval1(3, x), one_sided, 1e-9);
        assert_eq!(table.eval1(4, x), 0.0);
    }
}

#[test]
fn partial_derivatives_agree_with_differences() {
    let table = two();
    let h = 1e-5;
    for x in points(&X) {
        for y in points(&Y) {
            for (dx, dy) in [(1, 0), (2, 0), (1, 1), (2, 1), (1, 2), (2, 2)] {
                let at = |x| table.eval2(dx - 1, dy, x, y);
                let expected = (at(x + h) - at(x - h)) / (2.0 * h);
                close(table.eval2(dx, dy, x, y), expected, 2e-3);
            }
            for (dx, dy) in [(0, 1), (0, 2), (1, 1), (1, 2), (2, 1), (2, 2)] {
                let at = |y| table.eval2(dx, dy - 1, x, y);
                let expected = (at(y + h) - at(y - h)) / (2.0 * h);
                close(table.eval2(dx, dy, x, y), expected, 2e-3);
            }
            let one_sided = (table.eval2(2, 0, x + h, y) - table.eval2(2, 0, x, y)) / h;
            close(table.eval2(3, 0, x, y), one_sided, 1e-7);
            let one_sided = (table.eval2(0, 2, x, y + h) - table.eval2(0, 2, x, y)) / h;
            close(table.eval2(0, 3, x, y), one_sided, 1e-7);
        }
    }
}

#[test]
fn continuous_to_the_second_derivative_across_grid_lines_and_edges() {
    let (one, two) = (one(), two());
    for x in X {
        for order in 0..=2 {
            close(one.eval1(order, x.next_down()), one.eval1(order, x), 1e-13);
            for other in 0..=2 {
                for y in points(&Y) {
                    let below = two.eval2(order, other, x.next_down(), y);
                    close(below, two.eval2(order, other, x, y), 1e-12);
                }
            }
        }
    }
    for y in Y {
        for (dx, dy) in [(0, 0), (0, 1), (0, 2), (1, 1), (2, 2)] {
            for x in points(&X) {
                let below = two.eval2(dx, dy, x, y.next_down());
                close(below, two.eval2(dx, dy, x, y), 1e-12);
            }
        }
    }
}

#[test]
fn straight_outside_the_grid() {
    let (one, two) = (one(), two());
    for (edge, x) in [(X[0], -50.0), (X[5], 60.0)] {
        assert_eq!(one.eval1(1, x), one.eval1(1, edge));
        assert_eq!(one.eval1(2, x), 0.0);
        let line = one.eval1(0, edge) + one.eval1(1, edge) * (x - edge);
        close(one.eval1(0, x), line, 1e-13 * line.abs());
        for y in points(&Y) {
            assert_eq!(two.eval2(2, 0, x, y), 0.0);
            let line = two.eval2(0, 0, edge, y) + two.eval2(1, 0, edge, y) * (x - edge);
            close(two.eval2(0, 0, x, y), line, 1e-13 * (1.0 + line.abs()));
        }
    }
    // Past a corner: bilinear.
    let corner = |x: f64, y: f64| two.eval2(0, 0, x, y);
    let twist = corner(5.0, 3.0) - corner(4.0, 3.0) - corner(5.0, 2.0) + corner(4.0, 2.0);
    close(twist, two.eval2(1, 1, 3.1, 1.0), 1e-12);
}

#[test]
fn exchanging_the_axes_exchanges_the_partials() {
    let table = two();
    let mut values = Vec::new();
    for y in Y {
        values.extend(X.map(|x| f(x, y)));
    }
    let exchanged = Table::new_2d("CL", &Y, &X, &values).unwrap();
    for x in points(&X) {
        for y in points(&Y) {
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1), (2, 1), (0, 2), (2, 2)] {
                let found = exchanged.eval2(dy, dx, y, x);
                close(found, table.eval2(dx, dy, x, y), 1e-11);
            }
        }
    }
}

#[test]
fn linear_data_are_reproduced_exactly() {
    // Everything here is a sum of few powers of two, so that nothing rounds.
    let x = [-2.0, -1.0, 0.5, 0.75, 4.0];
    let y = [0.0, 0.25, 2.0];
    let line = |x: f64| 0.5 - 3.0 * x;
    let plane = |x: f64, y: f64| 0.5 - 3.0 * x + 2.0 * y + 0.25 * x * y;
    let one = Table::new_1d("line", &x, &x.map(line)).unwrap();
    let mut values = Vec::new();
    for x in x {
        values.extend(y.map(|y| plane(x, y)));
    }
    let two = Table::new_2d("plane", &x, &y, &values).unwrap();
    for at in [-8.0, -2.0, -1.25, 0.0, 0.625, 3.0, 4.0, 16.0] {
        assert_eq!(one.eval1(0, at), line(at));
        assert_eq!(one.eval1(1, at), -3.0);
        assert_eq!(one.eval1(2, at), 0.0);
        for y in [-1.0, 0.0, 0.125, 1.0, 2.0, 8.0] {
            assert_eq!(two.eval2(0, 0, at, y), plane(at, y));
            assert_eq!(two.eval2(1, 0, at, y), -3.0 + 0.25 * y);
            assert_eq!(two.eval2(0, 1, at, y), 2.0 + 0.25 * at);
            assert_eq!(two.eval2(1, 1, at, y), 0.25);
            assert_eq!(two.eval2(2, 0, at, y), 0.0);
        }
    }
    let two_points = Table::new_1d("two points", &[0.0, 2.0], &[1.0, 5.0]).unwrap();
    assert_eq!(two_points.eval1(0, 1.5), 4.0);
}

#[test]
fn nan_gives_nan_in_every_derivative() {
    let (one, two) = (one(), two());
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for dx in 0..=5 {
            assert!(one.eval1(dx, bad).is_nan());
            for dy in 0..=5 {
                assert!(two.eval2(dx, dy, bad, 0.3).is_nan());
                assert!(two.eval2(dx, dy, 0.3, bad).is_nan());
            }
        }
    }
}

#[test]
fn lanes_agree_with_single_points_bit_for_bit() {
    let (one, two) = (one(), two());
    // Out of order, so that the remembered cell is often wrong.
    let x: Vec<f64> = (0..200).map(|i| ((i * 37) % 101) as f64 / 15.0 - 3.0).collect();
    let y: Vec<f64> = (0..200).map(|i| ((i * 53) % 97) as f64 / 60.0 - 0.3).collect();
    let mut out = vec![0.0; x.len()];
    for dx in 0..=3 {
        one.eval1_lanes(dx, &mut out, &x);
        assert!(out.iter().zip(&x).all(|(o, &x)| *o == one.eval1(dx, x)));
        for dy in 0..=3 {
            two.eval2_lanes(dx, dy, &mut out, &x, &y);
            for i in 0..out.len() {
                assert_eq!(out[i], two.eval2(dx, dy, x[i], y[i]));
            }
        }
    }
}

#[test]
fn a_nearly_uniform_axis_is_searched_like_any_other() {
    // Steps of 0.1 are not exact; the direct look-up must not miss by one.
    let x: Vec<f64> = (0..1000).map(|i| i as f64 * 0.1 - 30.0).collect();
    let values: Vec<f64> = x.iter().map(|x| x.sin()).collect();
    let table = Table::new_1d("sin", &x, &values).unwrap();
    for (i, &x) in x.iter().enumerate() {
        assert_eq!(table.eval1(0, x), values[i]);
        close(table.eval1(0, x.next_down()), values[i], 1e-13);
    }
}

#[cfg(feature = "serde")]
#[test]
fn equality_hash_and_file_hold_the_content_only() {
    let (one, two) = (one(), two());
    for table in [&one, &two] {
        let text = serde_json::to_string(table).unwrap();
        let fields: serde_json::Value = serde_json::from_str(&text).unwrap();
        let mut names: Vec<&String> = fields.as_object().unwrap().keys().collect();
        names.sort();
        assert_eq!(names, ["axes", "name", "values"]);
        let back: Table = serde_json::from_str(&text).unwrap();
        assert_eq!(&back, table);
        assert_eq!(format!("{back:?}"), format!("{table:?}"));
        assert_eq!(HashSet::from([back, table.clone()]).len(), 1);
    }
    let mut values = one.values().to_vec();
    values[2] = values[2].next_up();
    let other = Table::new_1d("Cm", &X, &values).unwrap();
    let renamed = Table::new_1d("Cn", &X, one.values()).unwrap();
    assert_eq!(HashSet::from([one, other, renamed, two]).len(), 4);
}

#[cfg(feature = "serde")]
#[test]
fn a_damaged_file_is_refused() {
    let text = r#"{"name": "CD", "axes": [[0.0, 0.0]], "values": [1.0, 2.0]}"#;
    let error = serde_json::from_str::<Table>(text).unwrap_err().to_string();
    assert!(error.contains("table `CD`: the x axis must increase"), "{error}");
    let text = r#"{"name": "CD", "axes": [], "values": []}"#;
    let error = serde_json::from_str::<Table>(text).unwrap_err().to_string();
    assert!(error.contains("it has 0 axes; give 1 or 2"), "{error}");
}

#[test]
fn errors_name_the_table_and_the_place() {
    let message = |result: Result<Table, TableError>| result.unwrap_err().to_string();
    for (result, expected) in [
        (Table::new_1d("CD", &[1.0], &[1.0]), "table `CD`: the x axis has 1 point(s); give at least 2"),
        (Table::new_2d("CD", &[1.0, 2.0], &[], &[]), "table `CD`: the y axis has 0 point(s)"),
        (Table::new_1d("CD", &[0.0, 1.0, 1.0], &[0.0; 3]), "x[2] = 1 follows 1; sort the axis"),
        (Table::new_2d("CD", &[0.0, 1.0], &[0.0, 2.0, 1.5], &[0.0; 6]), "y[2] = 1.5 follows 2"),
        (
            Table::new_2d("CD", &[0.0, 1.0], &[0.0, 1.0, 2.0], &[0.0; 5]),
            "the grid has 6 points but there are 5 values",
        ),
        (
            Table::new_1d("CD", &[0.0, f64::NAN], &[0.0; 2]),
            "x[1] is NaN; every entry must be a finite number",
        ),
        (Table::new_1d("CD", &[0.0, 1.0], &[0.0, f64::INFINITY]), "values[1] is inf"),
        (Table::new_1d("CD", &[0.0, 1e-300], &[-1e200, 1e200]), "its slopes overflow"),
    ] {
        let found = message(result);
        assert!(found.contains(expected), "{found}");
        assert!(found.starts_with("table `CD`: "), "{found}");
    }
}

#[test]
#[should_panic(expected = "table `CL` has 2 variables, not 1")]
fn the_number_of_arguments_must_fit() {
    two().eval1(0, 0.0);
}

proptest! {
    /// Cells are found alike on any axis: within every cell the table is
    /// one cubic, whose third derivative is constant.
    #[test]
    fn any_axis_any_point(
        steps in prop::collection::vec(0.01..3.0_f64, 1..20),
        start in -10.0..10.0_f64,
        at in -20.0..60.0_f64,
    ) {
        let mut x = vec![start];
        steps.iter().for_each(|step| x.push(x[x.len() - 1] + step));
        let values: Vec<f64> = x.iter().map(|x| x.cos()).collect();
        let table = Table::new_1d("cos", &x, &values).unwrap();
        let cell = x.partition_point(|&knot| knot <= at);
        let outside = cell == 0 || cell == x.len();
        let expected = if outside { 0.0 } else { table.eval1(3, x[cell - 1]) };
        prop_assert_eq!(table.eval1(3, at), expected);
    }
}
