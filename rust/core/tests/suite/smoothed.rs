//! Kinks of the state equations made smooth.

use std::collections::HashMap;

use phugoid::Model;
use phugoid::expr::{Expr, Op, gt, lt, max, min, select};

fn model(right: impl Fn(&Expr, &Expr) -> Expr) -> Model {
    let mut m = Model::new("kinked");
    let (x, u) = (m.state("x", "m").unwrap(), m.input("u", "").unwrap());
    m.equation("x", right(&x, &u)).unwrap();
    m
}

fn value(m: &Model, x: f64) -> f64 {
    m.dynamics[0].expr.evaluate(&HashMap::from([("x".into(), x), ("u".into(), 2.0)])).unwrap()
}

#[test]
fn far_from_their_kinks_all_operations_keep_their_values() {
    let both = |x: &Expr| Expr::apply(Op::And, vec![gt(x, -1.0), lt(x, 1.0)]);
    let either = |x: &Expr| Expr::apply(Op::Or, vec![lt(x, -1.0), gt(x, 1.0)]);
    let models = [
        model(|x, _| x.abs()),
        model(|x, _| x.sign()),
        model(|x, _| min(x, 0.5)),
        model(|x, _| max(x, -0.5)),
        model(|x, _| 3.0 * gt(x, 0.0)),
        model(|x, u| select(both(x), u, 5.0)),
        model(|x, u| select(either(x), u, 5.0)),
        model(|x, u| select(Expr::apply(Op::Not, vec![both(x)]), u, 5.0)),
        model(|x, u| select(Expr::apply(Op::And, vec![gt(x, 0.0), u.clone()]), u, 5.0)),
    ];
    for m in models {
        let smooth = m.smoothed(&vec![1e-4; m.kinks().len()]).unwrap();
        for x in [-3.0, -0.7, 0.2, 0.9, 2.0] {
            assert!((value(&smooth, x) - value(&m, x)).abs() < 1e-7, "{} at {x}", m.dynamics[0].expr);
        }
    }
}

#[test]
fn a_branch_that_is_not_finite_does_not_enter_where_it_is_not_taken() {
    let m = model(|x, _| select(gt(x, 0.0), (x + 0.5).log(), 0.0));
    let smooth = m.smoothed(&[1e-3]).unwrap();
    assert_eq!(value(&smooth, -1.0), 0.0);
    assert!((value(&smooth, 0.0) - 0.5 * 0.5f64.ln()).abs() < 1e-12);
}

#[test]
fn kinks_of_inputs_of_time_and_of_outputs_alone_are_none() {
    let mut m = model(|x, u| u.abs() * x + gt(Expr::symbol("time"), 1.0));
    let x = Expr::symbol("x");
    let shown = m.quantity("shown", x.abs()).unwrap();
    m.output("y", shown, "").unwrap();
    assert!(m.kinks().is_empty());
    assert_eq!(m.smoothed(&[]).unwrap(), m);
}

#[test]
fn factors_make_a_kink_smooth() {
    let smooth: [fn(&Expr, &Expr) -> Expr; 3] = [
        |x, u| -0.3 * x * x.abs() / (1.0 + u),
        |x, _| -(x - 2.0) * 0.1 * (x - 2.0).abs(),
        |x, _| x.pow(2.0) * x.sign(),
    ];
    assert!(smooth.iter().all(|f| model(f).kinks().is_empty()));
    let kinked: [fn(&Expr, &Expr) -> Expr; 5] = [
        |x, u| x.abs() * u,
        |x, _| x * x.sign(),
        |x, _| x.abs() / x,
        |x, _| x * x.abs() + x.abs(),
        |x, _| x * (x - 1.0).abs(),
    ];
    assert!(kinked.iter().all(|f| model(f).kinks().len() == 1));
}

#[test]
fn quantities_of_state_equations_are_smoothed_in_their_place() {
    let mut m = Model::new("kinked");
    let v = m.state("v", "m/s").unwrap();
    let force = m.quantity("force", v.sign()).unwrap();
    m.equation("v", -max(force, 0.5)).unwrap();
    let kinks = m.kinks();
    assert_eq!(kinks.iter().map(|k| &*k.place).collect::<Vec<_>>(), ["force", "v'"]);
    assert_eq!(kinks[1].argument, v.sign() - 0.5);
    assert_eq!(m.smoothed(&[0.1, 0.2]).unwrap().quantities[0].expr, (v / 0.1).tanh());
}

#[test]
fn there_must_be_a_positive_width_for_each_kink() {
    let m = model(|x, _| x.abs());
    for widths in [&[][..], &[0.0], &[-1.0], &[f64::NAN], &[1.0, 1.0]] {
        assert!(m.smoothed(widths).unwrap_err().to_string().contains("give 1 positive widths"));
    }
}
