//! Integrations that end where a slope has a pole: no step goes over it.

use phugoid::simulate::Method;
use phugoid::{Experiment, Expr, Model, Parameter, Simulation};

/// Integrates x' = f(x, k) from 1 until t = 2, with one sample there.
fn end(equation: impl Fn(Expr, Expr) -> Expr, k: f64, method: Method) -> Result<f64, String> {
    let mut m = Model::new("pole");
    let x = m.state("x", "").unwrap();
    let of = m.parameter(Parameter::new("k", k)).unwrap();
    m.equation("x", equation(x.clone(), of)).unwrap();
    m.output("y", x, "").unwrap();
    let run = Experiment::new(&m, "run", vec![0.0, 2.0], [("y", vec![1.0, f64::NAN])]).unwrap();
    let found = Simulation::new(&m, &run).parameter("k", k).initial("x", 1.0).method(method).run();
    found.map(|path| path.states[0][1]).map_err(|e| e.to_string())
}

#[test]
fn no_step_crosses_a_pole() {
    let of_a_pole = |why: &str| why.contains("not finite") || why.contains("have a pole");
    for method in [Method::Automatic, Method::Explicit, Method::Implicit] {
        for k in [0.7, 1.0, 1.3, 2.0, 5.0, 20.0] {
            // Ends at t = 1/(2 k), and at 1/k.
            let why = end(|x, k| -k / x, k, method).expect_err("there is no solution");
            assert!(of_a_pole(&why), "{method:?}, {k}: {why}");
            // A slope that is small beside the pole but next to it.
            let why = end(|x, k| -1e-9 * k / (x - 0.3) - 1.0, k, method).expect_err("there is no solution");
            assert!(of_a_pole(&why), "{method:?}, {k}: {why}");
            let why = end(|x, k| k * x.clone() * x, k, method).expect_err("there is no solution");
            assert!(why.contains("without limit"), "{method:?}, {k}: {why}");
        }
    }
}

#[test]
fn a_divisor_that_vanishes_with_its_numerator_is_no_pole() {
    for method in [Method::Explicit, Method::Implicit] {
        let slope = |x: Expr, k: Expr| -k * (x.clone() * x.clone() - x.clone() * 0.5) / (x - 0.5) - 0.5;
        let exact = 1.5 * (-2.0_f64).exp() - 0.5;
        assert!((end(slope, 1.0, method).unwrap() - exact).abs() < 1e-4);
    }
}
