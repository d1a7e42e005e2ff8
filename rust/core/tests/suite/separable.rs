//! Models that are not linear in their parameters: which parameters these are, and starts far from the optimum.

use phugoid::expr::Expr;
use phugoid::model::Transform;
use phugoid::model::{Model, Parameter};
use phugoid::nlp::{Named, Separable};
use phugoid::solver::Status;
use phugoid::{Estimation, Experiment, Sigma};

/// A state that is forced by `force(parameters, u)`, measured with its rate.
fn model(names: &[&str], starts: &[f64], force: impl Fn(&[Expr], &Expr) -> Expr) -> Model {
    let mut m = Model::new("forced");
    let x = m.state("x", "m").unwrap();
    let u = m.input("u", "").unwrap();
    let p: Vec<Expr> = names
        .iter()
        .zip(starts)
        .map(|(name, start)| m.parameter(Parameter::new(name, *start)).unwrap())
        .collect();
    let rate = force(&p, &u) - &x;
    m.equation("x", rate.clone()).unwrap();
    m.output("x", x, "").unwrap();
    m.output("rate", rate, "").unwrap();
    m
}

fn nonlinear(m: &Model) -> Vec<String> {
    let t: Vec<f64> = (0..30).map(|k| 0.1 * f64::from(k)).collect();
    let wave = |f: fn(f64) -> f64| t.iter().map(|t| f(*t)).collect::<Vec<f64>>();
    let run = Experiment::new(
        m,
        "run",
        t.clone(),
        [("u", wave(f64::sin)), ("x", wave(f64::cos)), ("rate", wave(f64::sin))],
    );
    let runs = [run.unwrap()];
    let (problem, _) = Estimation::new(m, &runs).noise("x", Sigma::Known(0.1)).transcribe().unwrap();
    problem.nonlinear().into_iter().map(|i| problem.variable_name(i)).collect()
}

#[test]
fn it_is_known_which_parameters_a_model_is_not_linear_in() {
    let none: [&str; 0] = [];
    let linear = model(&["a", "b"], &[1.0, 1.0], |p, u| &p[0] * u + &p[1] * (u * u).sin());
    assert_eq!(nonlinear(&linear), none);
    let inside = model(&["a", "b", "c"], &[1.0; 3], |p, u| &p[0] * (&p[1] * u).exp() + &p[2] * u);
    assert_eq!(nonlinear(&inside), ["b"]);
    // Of a product, the factor that is in most products.
    let product = model(&["a", "b", "c"], &[1.0; 3], |p, u| &p[0] * &p[1] * u + &p[0] * &p[2]);
    assert_eq!(nonlinear(&product), ["a"]);
    // As the solver sees it, in ln a.
    let mut transformed = model(&["a", "b"], &[1.0, 1.0], |p, u| &p[0] * u + &p[1]);
    transformed.parameters[0].transform = Transform::Log;
    assert_eq!(nonlinear(&transformed), ["ln a"]);
    // In the outputs alone.
    let mut measured = model(&["a", "b", "c"], &[1.0; 3], |p, u| &p[2] * u);
    let [a, b] = ["a", "b"].map(Expr::symbol);
    measured.outputs[0].expr = &a * &measured.outputs[0].expr + (&b * &a).exp();
    assert_eq!(nonlinear(&measured), ["a", "b"]);
}

/// u / (u + e) saturates: from a start in the denominator that is much too large or small, a Newton step leads past
/// infinity.
#[test]
fn a_parameter_in_a_denominator_is_found_from_anywhere() {
    let force =
        |p: &[Expr], u: &Expr| &p[0] * u * (Expr::from(1.0) / (u + &p[1])) + &p[2] * (&p[3] * u).exp();
    let truth = [3.0, 0.5, -0.4, 0.8];
    let value = |u: f64| truth[0] * u / (u + truth[1]) + truth[2] * (truth[3] * u).exp();
    let input = |t: f64| 1.2 + (0.7 * t).sin() * (0.11 * t).cos();
    let n = 400;
    let t: Vec<f64> = (0..n).map(|k| 0.05 * f64::from(k)).collect();
    // The state by small steps of the midpoint rule, and a little noise that repeats itself.
    let (mut x, mut state) = (vec![0.3], 0.3);
    for k in 1..n {
        for i in 0..50 {
            let (at, h) = (0.05 * (f64::from(k - 1) + f64::from(i) / 50.0), 0.001);
            let half = state + 0.5 * h * (value(input(at)) - state);
            state += h * (value(input(at + 0.5 * h)) - half);
        }
        x.push(state);
    }
    let noise = |k: usize, f: f64| 2e-3 * ((k as f64 * f).sin() + (k as f64 * 1.7 * f).cos());
    let rate: Vec<f64> =
        t.iter().zip(&x).enumerate().map(|(k, (t, x))| value(input(*t)) - x + noise(k, 12.9)).collect();
    let u: Vec<f64> = t.iter().map(|t| input(*t)).collect();
    let x: Vec<f64> = x.iter().enumerate().map(|(k, x)| x + noise(k, 7.3)).collect();
    for start in
        [[1.0, 0.05, 1.0, 0.1], [-2.0, 5.0, 2.0, 3.0], [1.0, 40.0, 0.0, -1.0], [10.0, 0.3, -3.0, 0.2]]
    {
        let m = model(&["a", "e", "b", "c"], &start, force);
        let run = Experiment::new(
            &m,
            "run",
            t.clone(),
            [("u", u.clone()), ("x", x.clone()), ("rate", rate.clone())],
        );
        let fit = Estimation::new(&m, &[run.unwrap()]).solve().unwrap();
        assert_eq!(fit.solution.status, Status::Converged, "{start:?}: {}", fit.solution.message);
        for (name, truth) in ["a", "e", "b", "c"].iter().zip(truth) {
            assert!(
                (fit[*name].value - truth).abs() < 0.05 * truth.abs(),
                "{start:?}: {name} = {}",
                fit[*name].value
            );
        }
    }
}
