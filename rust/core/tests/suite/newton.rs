//! The Newton solver from start to end.

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::common::flights::{SIGMA, TRUTH, problem};
use crate::common::models;
use phugoid::Grid;
use phugoid::collocation::{Collocation, Settings};
use phugoid::expr::Expr;
use phugoid::internals::diagnosis::information;
use phugoid::internals::initial::{self, Initial};
use phugoid::interrupt::{Interrupt, current};
use phugoid::model::{Model, Parameter};
use phugoid::nlp::{ConstraintId, Named, Nlp, NotFinite, Structure, VariableId};
use phugoid::solver::{Control, Settings as Options, Solution, Status, solve};

fn settings(order: usize) -> Settings {
    Settings::default().order(order)
}

fn run(problem: &Collocation, xi: &[f64], options: &Options) -> Solution {
    solve(problem, xi, None, options, &mut |_| Control::Continue).unwrap()
}

/// Truth in standard errors.
fn errors(problem: &Collocation, solution: &Solution) -> Vec<f64> {
    let wanted: Vec<VariableId> = (0..TRUTH.len()).map(VariableId).collect();
    let found =
        information(problem, &solution.xi, &solution.multipliers, &wanted, &[], &solution.kkt).unwrap();
    let error = |i: usize| (solution.xi[i] - TRUTH[i]) / found.covariance[i * wanted.len() + i].sqrt();
    wanted.iter().map(|i| error(i.0)).collect()
}

#[test]
fn it_finds_an_unstable_aircraft_from_zero_at_any_order() {
    // Twelve seconds and a hundred: a small change at the start grows by 10³ and 10³⁰.
    for (order, n) in [(2, 241), (3, 241), (4, 241), (5, 121), (4, 2001)] {
        let (p, xi) = problem(&models::linear(), n, &settings(order));
        for initial in [Initial::Start, Initial::Regression] {
            let options = Options::default();
            let s = initial::solve(&p, &xi, None, initial, &options, &mut |_| Control::Continue).unwrap();
            assert_eq!(s.status, Status::Converged, "order {order}, {n} samples: {}", s.message);
            assert!(s.iterations <= 15, "order {order}: {} iterations", s.iterations);
            // The trapezoid's own error is larger than that of the noise.
            let limit = if order == 2 { 12.0 } else { 4.0 };
            let errors = errors(&p, &s);
            assert!(errors.iter().all(|e| e.abs() < limit), "order {order}, {n} samples: {errors:?}");
            for (i, sigma) in SIGMA.iter().enumerate() {
                assert!((1.0 / s.xi[6 + i] / sigma - 1.0).abs() < 0.15, "sigma {i}: {}", 1.0 / s.xi[6 + i]);
            }
        }
    }
}

#[test]
fn samples_between_mesh_points_change_nothing_of_that() {
    let grid = vec![Grid::Uniform(70)];
    let (p, xi) = problem(&models::linear(), 241, &Settings::default().order(5).grid(grid).threads(1));
    let s = run(&p, &xi, &Options::default());
    assert_eq!(s.status, Status::Converged, "{}", s.message);
    // The input has corners that the mesh does not see.
    assert!(errors(&p, &s).iter().all(|e| e.abs() < 12.0));
}

#[test]
fn the_counts_of_a_run() {
    // A snapshot: a change here is a change of behaviour.
    let (p, xi) = problem(&models::linear(), 241, &settings(4));
    let s = run(&p, &xi, &Options::default());
    let e = s.evaluations;
    assert_eq!(
        (s.iterations, e.hessian, e.gauss_newton, e.factorizations),
        (s.iterations, e.hessian, e.gauss_newton, e.hessian + e.gauss_newton)
    );
    assert!((4..=8).contains(&s.iterations), "{} iterations", s.iterations);
    assert!(e.objective <= 3 * s.iterations + 4, "{e:?}");
    assert!(s.flops > 0);
}

#[test]
fn the_result_has_the_same_bits_on_any_number_of_threads() {
    let solved: Vec<Solution> = [1, 2, 3, 8]
        .map(|threads| {
            let (p, xi) = problem(&models::linear(), 4001, &settings(3).threads(threads));
            run(&p, &xi, &Options::default())
        })
        .into();
    for other in &solved[1..] {
        assert!(solved[0].xi.iter().zip(&other.xi).all(|(a, b)| a.to_bits() == b.to_bits()));
        assert_eq!(solved[0].evaluations, other.evaluations);
    }
}

#[test]
fn it_goes_on_from_a_solution_at_once() {
    let (p, xi) = problem(&models::linear(), 241, &settings(4));
    let first = run(&p, &xi, &Options::default());
    let again =
        solve(&p, &first.xi, Some(&first.multipliers), &Options::default(), &mut |_| Control::Continue);
    let again = again.unwrap();
    assert_eq!((again.status, again.iterations), (Status::Converged, 0));
}

#[test]
fn limits_and_the_watch_end_a_run_with_its_best_point() {
    let (p, xi) = problem(&models::linear(), 241, &settings(4));
    let s = run(&p, &xi, &Options::default().max_iterations(2));
    assert_eq!((s.status, s.iterations), (Status::IterationLimit, 2));
    let none = std::time::Duration::ZERO;
    let s = run(&p, &xi, &Options::default().time_limit(none));
    assert_eq!((s.status, s.iterations), (Status::TimeLimit, 0));
    let mut seen = 0;
    let s = solve(&p, &xi, None, &Options::default(), &mut |line| {
        assert_eq!(line.number, seen);
        seen += 1;
        if line.number == 3 { Control::Stop } else { Control::Continue }
    })
    .unwrap();
    assert_eq!((s.status, s.iterations, s.history.len()), (Status::Interrupted, 3, 4));
    assert!(s.objective < s.history[0].objective);
}

/// The short period with one parameter changed.
fn with(parameter: Parameter) -> Model {
    let mut m = models::linear();
    let i = m.parameters.iter().position(|p| p.name == parameter.name).unwrap();
    m.parameters[i] = parameter;
    m
}

#[test]
fn bounds_hold_and_what_is_at_one_stays_there() {
    let free = {
        let (p, xi) = problem(&models::linear(), 241, &settings(4));
        run(&p, &xi, &Options::default())
    };
    // Below what the data want, and far from it in between.
    let bounded = Parameter::new("Mde", -5.0).lower(-12.0).upper(0.0);
    let (p, xi) = problem(&with(bounded), 241, &settings(4));
    let s = run(&p, &xi, &Options::default());
    assert_eq!((s.status, s.xi[5]), (Status::Converged, -12.0));
    assert!(s.objective > free.objective);
    // Fixed there, the rest is the same.
    let fixed = Parameter::new("Mde", -12.0).fixed(true);
    let (p, mut xi) = problem(&with(fixed), 241, &settings(4));
    xi[5] = -12.0;
    let other = run(&p, &xi, &Options::default());
    assert_eq!(other.status, Status::Converged);
    assert!((s.objective - other.objective).abs() < 1e-9 * s.objective.abs());
    // Bounds that do not bind do not matter, whatever was held on the way.
    let wide = Parameter::new("Mde", -5.0).lower(-14.0).upper(-1.0);
    let (p, xi) = problem(&with(wide), 241, &settings(4));
    let other = run(&p, &xi, &Options::default());
    assert_eq!(other.status, Status::Converged);
    assert!((free.objective - other.objective).abs() < 1e-9 * free.objective.abs());
}

#[test]
fn what_the_data_do_not_determine_is_named() {
    // Mq enters as a sum with another parameter.
    let mut m = models::linear();
    let extra = m.parameter(Parameter::new("Mextra", 0.0)).unwrap();
    let q = m.dynamics.iter_mut().find(|e| e.name == "q").unwrap();
    q.expr = q.expr.clone() + &extra * Expr::symbol("q");
    let (p, mut xi) = problem(&m, 241, &settings(4));
    xi[6] = 0.0;
    let s = run(&p, &xi, &Options::default());
    assert_eq!(s.status, Status::Unidentifiable, "{}", s.message);
    assert!(s.message.ends_with("(Mq, Mextra)"), "{}", s.message);
    // One without influence.
    let mut m = models::linear();
    let idle = m.parameter(Parameter::new("idle", 1.0)).unwrap();
    let q = m.dynamics.iter_mut().find(|e| e.name == "q").unwrap();
    q.expr = q.expr.clone() + &idle * 1e-300;
    let (p, mut xi) = problem(&m, 241, &settings(4));
    xi[6] = 1.0;
    let s = run(&p, &xi, &Options::default());
    assert_eq!(s.status, Status::Unidentifiable, "{}", s.message);
    assert!(s.message.ends_with("(idle)"), "{}", s.message);
}

#[test]
fn not_finite_at_the_start_is_an_error_and_on_the_way_it_is_not() {
    // A logarithm of a parameter: from 40 the first full step leaves its domain.
    let mut m = Model::new("lag");
    let (x, u) = (m.state("x", "").unwrap(), m.input("u", "").unwrap());
    let a = m.parameter(Parameter::new("a", 40.0)).unwrap();
    m.equation("x", a.log() * (&u - &x)).unwrap();
    m.output("x", x, "").unwrap();
    let mut e = models::record(&m, "one", 60, false, 1);
    let mut state = 0.5;
    for i in 0..e.t.len() {
        e.outputs[0][i] = state + 0.01 * (37.0 * e.t[i]).sin();
        if let Some(next) = e.t.get(i + 1) {
            state += (next - e.t[i]) * (e.inputs[0][i] - state);
        }
    }
    let noise = crate::common::flights::unknown_noise(&e);
    let p = Collocation::new(&m, std::slice::from_ref(&e), noise, &settings(3)).unwrap();
    let mut xi: Vec<f64> = p.posed.parameters.iter().map(|p| p.start).collect();
    xi.resize(p.n(), 0.7);
    let s = run(&p, &xi, &Options::default());
    assert_eq!(s.status, Status::Converged, "{}", s.message);
    assert!((s.xi[0].ln() - 1.0).abs() < 0.3, "{}", s.xi[0]);
    xi[0] = -1.0;
    assert!(solve(&p, &xi, None, &Options::default(), &mut |_| Control::Continue).is_err());
}

#[test]
fn a_hopeless_model_ends_within_its_limits() {
    // ẋ = (1 + a²) x² reaches infinity within the record from anywhere above 0.
    let mut m = Model::new("explosion");
    let x = m.state("x", "").unwrap();
    let a = m.parameter(Parameter::new("a", 1.0)).unwrap();
    m.equation("x", (1.0 + &a * &a) * 50.0 * &x * &x + 40.0).unwrap();
    m.output("x", x, "").unwrap();
    let e = models::record(&m, "one", 40, false, 1);
    let noise = crate::common::flights::unknown_noise(&e);
    let p = Collocation::new(&m, std::slice::from_ref(&e), noise, &settings(3)).unwrap();
    let mut xi: Vec<f64> = p.posed.parameters.iter().map(|p| p.start).collect();
    xi.resize(p.n(), 0.7);
    for gauss_newton in [true, false] {
        let s = run(&p, &xi, &Options::default().gauss_newton(gauss_newton).max_iterations(60));
        assert_ne!(s.status, Status::Converged);
        assert!(s.iterations <= 60 && !s.message.is_empty());
        assert!(s.xi.iter().all(|x| x.is_finite()));
    }
}

/// A program that does not tell of its chains, and that is stopped in an evaluation of its Jacobian.
struct Shapeless {
    inner: Collocation,
    /// Evaluations of the Jacobian until then; `usize::MAX` where it never is.
    until_stop: AtomicUsize,
    /// How often somebody asked what is not finite.
    explained: AtomicUsize,
}

impl Shapeless {
    fn new(inner: Collocation, until_stop: usize) -> Shapeless {
        Shapeless { inner, until_stop: AtomicUsize::new(until_stop), explained: AtomicUsize::new(0) }
    }
}

impl Nlp for Shapeless {
    fn n(&self) -> usize {
        self.inner.n()
    }
    fn m(&self) -> usize {
        self.inner.m()
    }
    fn bounds(&self) -> (Vec<f64>, Vec<f64>) {
        self.inner.bounds()
    }
    fn objective(&self, xi: &[f64]) -> Result<f64, NotFinite> {
        self.inner.objective(xi)
    }
    fn gradient(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.inner.gradient(xi, out)
    }
    fn constraints(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.inner.constraints(xi, out)
    }
    fn jacobian_structure(&self) -> &Structure {
        self.inner.jacobian_structure()
    }
    fn jacobian(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        if self.until_stop.fetch_sub(1, Ordering::Relaxed) == 0 {
            current().stop();
            return Err(NotFinite);
        }
        self.inner.jacobian(xi, out)
    }
    fn hessian_structure(&self) -> &Structure {
        self.inner.hessian_structure()
    }
    fn hessian(&self, xi: &[f64], factor: f64, lambda: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.inner.hessian(xi, factor, lambda, out)
    }
    fn gauss_newton(&self, xi: &[f64], factor: f64, out: &mut [f64]) -> Result<(), NotFinite> {
        self.inner.gauss_newton(xi, factor, out)
    }
    fn profiled(&self) -> std::ops::Range<usize> {
        self.inner.profiled()
    }
    fn profile(&self, xi: &[f64], gradient: &[f64], reach: &phugoid::nlp::Reach<'_>, out: &mut [f64]) -> f64 {
        self.inner.profile(xi, gradient, reach, out)
    }
}

impl Named for Shapeless {
    fn variable_name(&self, i: VariableId) -> String {
        self.inner.variable_name(i)
    }
    fn constraint_name(&self, i: ConstraintId) -> String {
        self.inner.constraint_name(i)
    }
    fn explain(&self, xi: &[f64]) -> Option<String> {
        self.explained.fetch_add(1, Ordering::Relaxed);
        self.inner.explain(xi)
    }
}

#[test]
fn a_program_without_chains_is_solved_by_the_sparse_factorisation() {
    let (p, xi) = problem(&models::linear(), 61, &settings(3));
    let known = run(&p, &xi, &Options::default());
    let s = solve(&Shapeless::new(p, usize::MAX), &xi, None, &Options::default(), &mut |_| Control::Continue)
        .unwrap();
    assert_eq!((known.status, s.status), (Status::Converged, Status::Converged), "{}", s.message);
    assert!((s.objective - known.objective).abs() < 1e-8);
    for i in 0..TRUTH.len() {
        assert!((s.xi[i] / known.xi[i] - 1.0).abs() < 1e-7, "{i}: {} for {}", s.xi[i], known.xi[i]);
    }
}

#[test]
fn an_evaluation_that_was_stopped_is_not_searched_for_what_is_not_finite() {
    let (p, xi) = problem(&models::linear(), 61, &settings(3));
    let p = Shapeless::new(p, 2);
    let options = Options::default();
    let s =
        Interrupt::within(None).run(|| solve(&p, &xi, None, &options, &mut |_| Control::Continue).unwrap());
    assert_eq!((s.status, s.iterations), (Status::Interrupted, 2));
    assert_eq!(p.explained.load(Ordering::Relaxed), 0);
}
