//! A parameter without influence on what is measured has no standard error, and is named.

use phugoid::expr::Expr;
use phugoid::{Estimation, Experiment, Model, Parameter, Sigma};

type Right = fn(&Expr, &Expr, &Expr) -> Expr;

#[test]
fn of_a_state_that_nothing_measures() {
    let cases: [Right; 4] =
        [|_, _, q| q.clone(), |_, z, q| q * z, |x, z, q| q * x - z, |x, z, q| q * (x - z)];
    for right in cases {
        let mut m = Model::new("hidden");
        let [x, z] = ["x", "z"].map(|name| m.state(name, "").unwrap());
        let [p, q] = [("p", -0.3), ("q", 0.1)].map(|(n, v)| m.parameter(Parameter::new(n, v)).unwrap());
        m.equation("x", p * &x).unwrap();
        m.equation("z", right(&x, &z, &q)).unwrap();
        m.output("x", x, "").unwrap();
        let t: Vec<f64> = (0..101).map(|k| 0.05 * f64::from(k)).collect();
        let y = t.iter().map(|t| (-0.5 * t).exp() + 1e-3 * (1e4 * t).sin()).collect();
        let runs = [Experiment::new(&m, "run", t, [("x", y)]).unwrap()];
        let fit = Estimation::new(&m, &runs).noise("x", Sigma::Known(1e-3)).solve().unwrap();
        assert!(fit["q"].std_error.is_nan(), "{fit}");
        assert!(fit["p"].std_error > 1e-5 && fit["p"].std_error < 1e-2, "{fit}");
        assert!(fit.warnings.iter().any(|w| w.contains('q')), "{:?}", fit.warnings);
    }
}
