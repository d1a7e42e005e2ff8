//! What is not finite is traced to the sub-expression, the experiment, the time and the inputs.

use phugoid::Experiment;
use phugoid::Interpolation;
use phugoid::collocation::{Collocation, Settings};
use phugoid::expr::{Expr, gt, select};
use phugoid::model::{Model, Parameter};
use phugoid::nlp::{ExperimentId, Named, Nlp, NotFinite};
use phugoid::noise::{Noise, Sigma};

const STEP: f64 = 0.5;

/// A problem of two records in one state x, one input u and one parameter p: x' = f, y = g, the
/// trapezoid at 0, 0.5, 1, ... s, u = 1, 2, 3, ... at the samples.
fn problem(f: &Expr, g: &Expr) -> Collocation {
    let mut model = Model::new("fragile");
    let x = model.state("x", "").unwrap();
    model.input("u", "").unwrap();
    let p = model.parameter(Parameter::new("p", 2.0)).unwrap();
    model.equation("x", f + 0.0 * &x).unwrap();
    model.output("y", g + p, "").unwrap();
    let record = |name: &str| Experiment {
        name: name.to_owned(),
        t: (0..6).map(|i| STEP * f64::from(i)).collect(),
        inputs: vec![(0..6).map(|i| f64::from(i + 1)).collect()],
        outputs: vec![vec![0.0; 6]],
        interpolation: Interpolation::Linear,
        signals: Vec::new(),
    };
    let sigma = Sigma::Unknown { start: 1.0, lower: 1e-3, upper: 1e3 };
    let settings = Settings::default().order(2);
    Collocation::new(&model, &[record("first"), record("second")], Noise::Gaussian(vec![sigma]), &settings)
        .unwrap()
}

fn x() -> Expr {
    Expr::symbol("x")
}

fn u() -> Expr {
    Expr::symbol("u")
}

/// All states 0.7, but `value` at 1.5 s of the second record.
fn point(problem: &Collocation, value: f64) -> Vec<f64> {
    let mut xi = vec![0.7; problem.n()];
    xi[0] = 2.0;
    xi[1] = 1.0;
    let at = problem.layout.first_point[ExperimentId(1)] + 3;
    xi[problem.layout.state(at)] = value;
    xi
}

/// Which of objective, gradient, constraints, Jacobian and Hessian fail.
fn failing(problem: &Collocation, xi: &[f64]) -> [bool; 5] {
    let lambda = vec![1.0; problem.m()];
    let failed = |r: Result<(), NotFinite>| r == Err(NotFinite);
    [
        problem.objective(xi) == Err(NotFinite),
        failed(problem.gradient(xi, &mut vec![0.0; problem.n()])),
        failed(problem.constraints(xi, &mut vec![0.0; problem.m()])),
        failed(problem.jacobian(xi, &mut vec![0.0; problem.jacobian_structure().len()])),
        failed(problem.hessian(xi, 1.0, &lambda, &mut vec![0.0; problem.hessian_structure().len()])),
    ]
}

fn explained(problem: &Collocation, xi: &[f64], words: &[&str]) {
    let text = problem.explain(xi).expect("an explanation");
    for word in words {
        assert!(text.contains(word), "'{word}' is not in: {text}");
    }
}

const PLACE: [&str; 3] = ["'second'", "t = 1.5", "u = 4"];

#[test]
fn nothing_to_explain_where_all_is_finite() {
    let p = problem(&(x().log() * u()), &x().sqrt());
    let xi = point(&p, 0.9);
    assert_eq!(failing(&p, &xi), [false; 5]);
    assert_eq!(p.explain(&xi), None);
}

#[test]
fn the_logarithm_of_a_negative_state() {
    let p = problem(&(u() * (2.0 * x() - 1.0).log()), &x());
    let xi = point(&p, -0.4);
    assert!(failing(&p, &xi)[2]);
    explained(&p, &xi, &PLACE);
    explained(&p, &xi, &["the equation of x' is not finite", "log(2*x - 1) = NaN", "2*x - 1 = -1.8"]);
}

#[test]
fn division_by_a_zero_state() {
    let p = problem(&((u() + 1.0) / x()), &x());
    let xi = point(&p, 0.0);
    assert!(failing(&p, &xi)[2]);
    explained(&p, &xi, &PLACE);
    explained(&p, &xi, &["x'", "1/x = inf", "x = 0"]);
}

#[test]
fn overflow_of_an_exponential() {
    let p = problem(&(1.0 - (100.0 * x()).exp()), &x());
    let xi = point(&p, 30.0);
    assert!(failing(&p, &xi)[2]);
    explained(&p, &xi, &PLACE);
    explained(&p, &xi, &["exp(100*x) = inf", "100*x = 3000"]);
}

#[test]
fn failure_of_an_output() {
    let p = problem(&x(), &(x() * (x() - 0.5).sqrt()));
    let xi = point(&p, 0.3);
    assert_eq!(failing(&p, &xi), [true, true, false, false, true]);
    explained(&p, &xi, &PLACE);
    explained(&p, &xi, &["an output is not finite", "sqrt(x - 0.5) = NaN"]);
}

#[test]
fn a_square_root_at_zero_has_a_value_but_no_derivative() {
    let p = problem(&(u() * x().sqrt()), &x());
    let xi = point(&p, 0.0);
    let found = failing(&p, &xi);
    assert!(!found[0] && !found[1] && !found[2] && found[3], "{found:?}");
    explained(&p, &xi, &PLACE);
    explained(&p, &xi, &["derivative", "with respect to x", "1/sqrt(x) = inf"]);
    let p = problem(&x(), &x().sqrt());
    let xi = point(&p, 0.0);
    let found = failing(&p, &xi);
    assert!(!found[0] && found[1] && !found[2] && !found[3], "{found:?}");
    explained(&p, &xi, &PLACE);
    explained(&p, &xi, &["derivative of an output", "with respect to x", "1/sqrt(x) = inf"]);
}

#[test]
fn a_second_derivative_alone() {
    let p = problem(&(u() * x().pow(1.5)), &x());
    let xi = point(&p, 0.0);
    assert_eq!(failing(&p, &xi), [false, false, false, false, true]);
    explained(&p, &xi, &PLACE);
    explained(&p, &xi, &["second derivative", "1/sqrt(x) = inf"]);
}

/// What a `where` leaves out is not to blame, though it is not finite.
#[test]
fn branches_not_taken_are_not_blamed() {
    let guarded = select(gt(x(), 0.0), x().log(), 0.0);
    let p = problem(&(&guarded + u() * (1.0 + x()).sqrt()), &guarded);
    let xi = point(&p, -0.5);
    assert_eq!(failing(&p, &xi), [false; 5]);
    assert_eq!(p.explain(&xi), None);
    let xi = point(&p, -1.3);
    assert!(failing(&p, &xi)[2]);
    explained(&p, &xi, &PLACE);
    explained(&p, &xi, &["sqrt(1 + x) = NaN"]);
    // Nor is an infinity that comes to nothing.
    let p = problem(&(1.0 / (100.0 * x()).exp() + (x() - 20.0).sqrt().pow(2.0)), &x());
    let mut xi = vec![21.0; p.n()];
    let at = p.layout.first_point[ExperimentId(1)] + 3;
    xi[p.layout.state(at)] = 19.0;
    assert!(failing(&p, &xi)[2]);
    explained(&p, &xi, &["sqrt(x - 20) = NaN", "'second'", "t = 1.5"]);
}

#[test]
fn a_variable_that_is_not_finite() {
    let p = problem(&x(), &x());
    let xi = point(&p, f64::NAN);
    explained(&p, &xi, &["x at t = 1.5 of 'second'", "NaN"]);
    let mut xi = point(&p, 0.5);
    xi[0] = f64::INFINITY;
    explained(&p, &xi, &["p", "inf"]);
}

#[test]
fn a_standard_deviation_that_is_not_positive() {
    let p = problem(&x(), &x());
    for precision in [0.0, -2.0] {
        let mut xi = point(&p, 0.5);
        xi[1] = precision;
        assert!(failing(&p, &xi)[0]);
        explained(&p, &xi, &["sigma_y", &precision.to_string()]);
    }
}
