//! The Lobatto rule: closed forms, exactness, high-precision references, and
//! the order of the collocation method built on it.

use nalgebra::{DMatrix, DVector};
use phugoid::internals::lgl::Lgl;

fn close(found: f64, expected: f64, tolerance: f64) {
    let error = (found - expected).abs();
    assert!(error <= tolerance, "{found:e} != {expected:e}, off by {error:e}");
}

/// Shifted Legendre polynomials of degree 0 to `n` at `t`: they fill [-1, 1]
/// whatever the degree, where powers of `t` would leave nothing to compare.
fn legendre(n: usize, t: f64) -> Vec<f64> {
    let x = 2.0 * t - 1.0;
    let mut p = vec![1.0, x];
    for i in 1..n {
        let i_f = i as f64;
        p.push(((2.0 * i_f + 1.0) * x * p[i] - i_f * p[i - 1]) / (i_f + 1.0));
    }
    p
}

/// Antiderivative of the shifted Legendre polynomial of degree `n`.
fn legendre_integral(n: usize, t: f64) -> f64 {
    if n == 0 {
        return t;
    }
    let p = legendre(n + 1, t);
    (p[n + 1] - p[n - 1]) / (2.0 * (2 * n + 1) as f64)
}

#[test]
fn closed_forms() {
    let inner_4 = (1.0 - 0.2_f64.sqrt()) / 2.0;
    let inner_5 = (1.0 - (3.0_f64 / 7.0).sqrt()) / 2.0;
    let cases = [
        (vec![0.0, 1.0], vec![0.5, 0.5]),
        (vec![0.0, 0.5, 1.0], vec![1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0]),
        (vec![0.0, inner_4, 1.0 - inner_4, 1.0], vec![1.0 / 12.0, 5.0 / 12.0, 5.0 / 12.0, 1.0 / 12.0]),
        (
            vec![0.0, inner_5, 0.5, 1.0 - inner_5, 1.0],
            vec![0.05, 49.0 / 180.0, 16.0 / 45.0, 49.0 / 180.0, 0.05],
        ),
    ];
    for (nodes, weights) in cases {
        let rule = Lgl::new(nodes.len());
        assert_eq!(rule.order, nodes.len());
        for k in 0..rule.order {
            close(rule.nodes[k], nodes[k], 1.2e-16);
            close(rule.weights[k], weights[k], 1.2e-16);
        }
    }
}

#[test]
fn trapezoid_and_hermite_simpson() {
    assert_eq!(Lgl::new(2).integration_matrix(), [0.5, 0.5]);
    let expected = [5.0, -1.0, 8.0, 8.0, -1.0, 5.0];
    for (c, e) in Lgl::new(3).integration_matrix().iter().zip(expected) {
        close(*c, e / 24.0, 1.2e-16);
    }
}

#[test]
fn symmetric_to_the_last_bit() {
    for m in 2..=64 {
        let rule = Lgl::new(m);
        let c = rule.integration_matrix();
        assert_eq!((rule.nodes[0], rule.nodes[m - 1]), (0.0, 1.0));
        assert!(rule.nodes.windows(2).all(|pair| pair[0] < pair[1]));
        for k in 0..m {
            assert_eq!(rule.nodes[k] + rule.nodes[m - 1 - k], 1.0);
            assert_eq!(rule.nodes[k], 1.0 - rule.nodes[m - 1 - k]);
            assert_eq!(rule.weights[k], rule.weights[m - 1 - k]);
            for i in 0..m - 1 {
                assert_eq!(
                    c[k * (m - 1) + i],
                    c[(m - 1 - k) * (m - 1) + (m - 2 - i)],
                    "order {m}, entry {k}, {i}"
                );
            }
        }
    }
}

#[test]
fn sums_over_rows_and_columns() {
    for m in 2..=40 {
        let rule = Lgl::new(m);
        let c = rule.integration_matrix();
        close(rule.weights.iter().sum(), 1.0, 1e-15);
        for j in 0..m {
            let row = &c[j * (m - 1)..(j + 1) * (m - 1)];
            close(row.iter().sum(), rule.weights[j], 3e-16);
        }
        for k in 0..m - 1 {
            let column: f64 = (0..m).map(|j| c[j * (m - 1) + k]).sum();
            close(column, rule.nodes[k + 1] - rule.nodes[k], 3e-16);
        }
    }
}

#[test]
fn polynomials_are_integrated_exactly_on_every_subinterval() {
    for m in 2..=20 {
        let rule = Lgl::new(m);
        let c = rule.integration_matrix();
        for degree in 0..m {
            let p: Vec<f64> = (rule.nodes.iter()).map(|&t| legendre(degree.max(1), t)[degree]).collect();
            for k in 0..m - 1 {
                let terms = (0..m).map(|j| c[j * (m - 1) + k] * p[j]);
                let exact =
                    legendre_integral(degree, rule.nodes[k + 1]) - legendre_integral(degree, rule.nodes[k]);
                // Relative to the polynomial, whose greatest value is 1.
                close(terms.sum(), exact, 1e-15);
            }
        }
    }
}

#[test]
fn quadrature_is_exact_up_to_twice_the_order_less_three() {
    for m in 2..=20 {
        let rule = Lgl::new(m);
        for degree in 1..=2 * m - 3 {
            let sum: f64 =
                (rule.nodes.iter().zip(&rule.weights)).map(|(&t, w)| w * legendre(degree, t)[degree]).sum();
            close(sum, 0.0, 1e-15);
        }
    }
}

/// Computed by mpmath with 120 digits.
#[test]
#[allow(clippy::excessive_precision)]
fn order_20_against_multiple_precision() {
    let rule = Lgl::new(20);
    for (k, node) in [
        (1, 0.009628147553042914037276781),
        (2, 0.03203275059366728214190921),
        (5, 0.1681117988548443550767983),
        (9, 0.4597270313805890810120277),
    ] {
        close(rule.nodes[k], node, 1.2e-16);
    }
    for (k, weight) in [
        (0, 0.002631578947368421052631579),
        (1, 0.01611856159424447074580251),
        (5, 0.06035461381433736254971485),
        (9, 0.08037164319392287450386336),
    ] {
        close(rule.weights[k], weight, 1.2e-16);
    }
    let c = rule.integration_matrix();
    for (j, k, integral) in [
        (0, 0, 0.003684655037171023303951122),
        (1, 0, 0.00676882855384076935720988),
        (0, 1, -0.001825883623594879446714832),
        (9, 9, 0.04746653016816309348172272),
        (10, 9, 0.04746653016816309348172272),
        (4, 7, -0.004234747346348336926140834),
        (19, 0, 0.00001023774247233461692061109),
        (3, 16, -0.0002959777453142607324148338),
        (12, 5, 0.001821009356543390843551062),
    ] {
        close(c[j * 19 + k], integral, 2e-16);
    }
}

#[test]
fn basis_interpolates() {
    for m in [2, 3, 7, 20, 40] {
        let rule = Lgl::new(m);
        for k in 0..m {
            let basis = rule.basis(rule.nodes[k]);
            assert!((0..m).all(|j| basis[j] == f64::from(u8::from(j == k))));
        }
        for s in [1e-310, 1e-20, 0.1, 0.3, 0.77, 1.0 - 1e-16] {
            let basis = rule.basis(s);
            close(basis.iter().sum(), 1.0, 2e-15);
            for degree in 0..m {
                let value: f64 =
                    (0..m).map(|j| basis[j] * legendre(degree.max(1), rule.nodes[j])[degree]).sum();
                close(value, legendre(degree.max(1), s)[degree], 1e-14);
            }
        }
        assert!(rule.basis(f64::NAN).iter().all(|value| value.is_nan()));
    }
}

#[test]
fn dense_output_agrees_with_the_integration_matrix() {
    for m in [2, 3, 4, 9, 20] {
        let rule = Lgl::new(m);
        let c = rule.integration_matrix();
        for k in 0..m {
            assert!(rule.integrate_to(k, rule.nodes[k]).iter().all(|&i| i == 0.0));
            if k + 1 < m {
                let next = rule.integrate_to(k, rule.nodes[k + 1]);
                (0..m).for_each(|j| close(next[j], c[j * (m - 1) + k], 1e-16));
            }
            for s in [0.0, 0.2, 0.9, 1.0] {
                let integral = rule.integrate_to(k, s);
                for degree in 0..m {
                    let sum: f64 =
                        (0..m).map(|j| integral[j] * legendre(degree.max(1), rule.nodes[j])[degree]).sum();
                    let exact = legendre_integral(degree, s) - legendre_integral(degree, rule.nodes[k]);
                    close(sum, exact, 2e-15);
                }
            }
        }
    }
}

/// Error at t = 2 of `x' = -x`, solved by collocation over equal segments.
fn decay_error(m: usize, segments: usize) -> f64 {
    let h = 2.0 / segments as f64;
    let c = Lgl::new(m).integration_matrix();
    let mut x = 1.0;
    for _ in 0..segments {
        // x_{k+1} - x_k + h sum_j C[j, k] x_j = 0 for the points after the first.
        let defect = DMatrix::from_fn(m - 1, m, |k, j| {
            let step = f64::from(i8::from(j == k + 1)) - f64::from(i8::from(j == k));
            step + h * c[j * (m - 1) + k]
        });
        let right: DVector<f64> = defect.column(0) * -x;
        let inner = defect.columns(1, m - 1).into_owned();
        x = inner.lu().solve(&right).expect("a regular system")[m - 2];
    }
    (x - (-2.0_f64).exp()).abs()
}

#[test]
fn the_composite_method_has_order_twice_the_points_less_two() {
    for m in 2..=6 {
        // Fewer segments at high order, to stay above rounding.
        let segments = if m < 5 { 8 } else { 1 };
        let order = (decay_error(m, segments) / decay_error(m, 2 * segments)).log2();
        close(order, (2 * m - 2) as f64, 0.15);
    }
}

#[test]
#[should_panic(expected = "at least 2, got 1")]
fn one_point_is_too_few() {
    Lgl::new(1);
}
