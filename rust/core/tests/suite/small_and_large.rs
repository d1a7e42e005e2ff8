//! expm1, log1p and hypot where the forms that they stand for lose all digits, overflow or vanish.

use crate::common::{Run, ulps};
use phugoid::expr::{Expr, Graph, hypot};

#[test]
fn values_are_right_at_all_sizes() {
    let sizes = (-1070..1020).step_by(5).map(|e| 1.3 * 2f64.powi(e)).chain([f64::from_bits(1), f64::MAX]);
    for x in sizes.flat_map(|x| [x, -x]) {
        let found = [
            phugoid::internals::math::expm1(x),
            phugoid::internals::math::log1p(x),
            phugoid::internals::math::hypot(x, 0.75 * x),
        ];
        let mut expected = [x.exp_m1(), x.ln_1p(), 1.25 * x.abs()];
        if x <= -1.0 {
            (expected[1], _) = (f64::NAN, ());
        }
        for (found, expected) in found.into_iter().zip(expected) {
            assert!(ulps(found, expected) <= 3, "at {x:e}: {found:e}, not {expected:e}");
        }
    }
    let zeros = [phugoid::internals::math::expm1(-0.0), phugoid::internals::math::log1p(-0.0)];
    assert!(zeros.iter().all(|z| z.to_bits() == (-0.0f64).to_bits()));
    assert_eq!(phugoid::internals::math::hypot(f64::NEG_INFINITY, 1.0), f64::INFINITY);
    assert_eq!(phugoid::internals::math::log1p(-1.0), f64::NEG_INFINITY);
    assert_eq!(
        [f64::NEG_INFINITY, f64::INFINITY].map(phugoid::internals::math::expm1),
        [-1.0, f64::INFINITY]
    );
}

#[test]
fn the_tape_has_the_bits_of_the_tree() {
    let mut random = crate::common::Random(3);
    let x: Vec<f64> = (0..960)
        .map(|k| match k {
            0 => -0.0,
            1 => 0.0,
            2 => f64::from_bits(1),
            3 => f64::MIN_POSITIVE,
            4 => 1e308,
            _ => random.between(-1.0, 1.0) * 10f64.powf(random.between(-320.0, 300.0)),
        })
        .collect();
    let s = Expr::symbol("x");
    for expr in [s.expm1(), s.log1p(), hypot(&s, 2.5), s.log1p().expm1()] {
        let mut graph = Graph::new();
        let root = graph.import(&expr, &Default::default());
        let symbol = graph.symbol("x");
        let run = Run { lanes: vec![(symbol, &x)], uniforms: vec![] };
        for (found, &x) in run.evaluate(&graph, &[root], x.len())[0].iter().zip(&x) {
            let expected = expr.evaluate(&crate::common::values(&[("x", x)])).unwrap();
            assert!(
                found.to_bits() == expected.to_bits() || found.is_nan() && expected.is_nan(),
                "{expr} at {x:e}"
            );
        }
    }
}
