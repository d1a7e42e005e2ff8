//! Where runs end that do not converge: at their best point, and not after endless small steps.

use phugoid::Experiment;
use phugoid::Interpolation;
use phugoid::collocation::{Collocation, Settings};
use phugoid::expr::Expr;
use phugoid::model::{Model, Parameter};
use phugoid::noise::{Noise, Sigma};
use phugoid::solver::{Control, Settings as Options, Solution, Status, solve};

/// A decay that is measured as it is, and beside it two outputs of the parameters a, b that are measured as 0.
fn problem(start: [f64; 2], outputs: impl Fn(&Expr, &Expr) -> [Expr; 2]) -> (Collocation, Vec<f64>) {
    let mut m = Model::new("banana");
    let x = m.state("x", "").unwrap();
    let a = m.parameter(Parameter::new("a", start[0])).unwrap();
    let b = m.parameter(Parameter::new("b", start[1])).unwrap();
    m.equation("x", -&x).unwrap();
    m.output("x", x, "").unwrap();
    for (name, output) in ["y", "z"].into_iter().zip(outputs(&a, &b)) {
        m.output(name, output, "").unwrap();
    }
    let e = Experiment {
        name: "one".into(),
        t: vec![0.0, 0.1],
        inputs: Vec::new(),
        outputs: vec![vec![1.0, 0.9], vec![0.0; 2], vec![0.0; 2]],
        interpolation: Interpolation::Linear,
        signals: Vec::new(),
    };
    let noise = Noise::Gaussian(vec![Sigma::Known(1.0); 3]);
    let settings = Settings::default().order(2).threads(1);
    let p = Collocation::new(&m, &[e], noise, &settings).unwrap();
    // On its equations from the start.
    let mut xi = start.to_vec();
    xi.extend([1.0, 0.95 / 1.05]);
    assert_eq!(xi.len(), 4);
    (p, xi)
}

/// Rosenbrock's valley, with its end at (1, 1).
fn rosenbrock(a: &Expr, b: &Expr) -> [Expr; 2] {
    [10.0 * (b - a * a), 1.0 - a]
}

/// Along b = sin 5a there is little to gain, and it is far; across, much to lose.
fn valley(a: &Expr, b: &Expr) -> [Expr; 2] {
    [1000.0 * (b - (5.0 * a).sin()), 0.05 * (a - 30.0)]
}

fn end(p: &Collocation, xi: &[f64], options: &Options, stop: usize) -> Solution {
    let mut watch = |line: &phugoid::solver::Iteration| {
        if line.number == stop { Control::Stop } else { Control::Continue }
    };
    solve(p, xi, None, options, &mut watch).unwrap()
}

#[test]
fn a_run_that_is_ended_gives_its_best_point_and_not_the_last_on_trust() {
    let mut trusted = 0;
    let problems = [
        problem([-1.2, 1.0], rosenbrock),
        problem([0.0, 0.0], rosenbrock),
        problem([2.0, -1.0], rosenbrock),
        problem([0.0, 0.0], valley),
    ];
    for (number, (p, xi)) in problems.into_iter().enumerate() {
        let whole = end(&p, &xi, &Options::default(), usize::MAX);
        if number < 3 {
            assert_eq!(whole.status, Status::Converged, "{}", whole.message);
            assert!((whole.xi[0] - 1.0).abs() < 1e-6 && (whole.xi[1] - 1.0).abs() < 1e-6, "{:?}", whole.xi);
        }
        for k in 0..whole.iterations.min(40) {
            let limited = Options::default().max_iterations(k);
            let ends = [
                (end(&p, &xi, &limited, usize::MAX), Status::IterationLimit),
                (end(&p, &xi, &Options::default(), k), Status::Interrupted),
            ];
            for (s, status) in ends {
                assert_eq!((s.status, s.history.len()), (status, k + 1));
                let on = s.history.iter().filter(|line| line.defect < 1e-6);
                let best = on.map(|line| line.objective).fold(f64::INFINITY, f64::min);
                assert!((s.objective - best).abs() < 1e-9, "{number}, {k}: {} for {best}", s.objective);
                // What is told of the point is true.
                let again = phugoid::nlp::Nlp::objective(&p, &s.xi).unwrap();
                assert_eq!(again, s.objective, "{number}, {k}");
                assert!(s.defect < 1e-6);
                trusted += usize::from(s.history[k].objective > best + 1.0);
            }
        }
    }
    assert!(trusted >= 2, "no run was stopped on trust");
}

#[test]
fn a_curved_valley_that_the_data_hardly_determine_ends_with_the_names_of_its_parameters() {
    let (p, xi) = problem([0.0, 0.0], valley);
    let s = end(&p, &xi, &Options::default(), usize::MAX);
    assert_eq!(s.status, Status::Acceptable, "{}", s.message);
    assert!(s.message.contains("hardly determine") && s.message.contains('a'), "{}", s.message);
    assert!(s.iterations < 100, "{}", s.iterations);
    let best = s.history.iter().map(|line| line.objective).fold(f64::INFINITY, f64::min);
    assert!((s.objective - best).abs() < 1e-9, "{} for {best}", s.objective);
}
