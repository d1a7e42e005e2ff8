//! The states that satisfy the defects converge to the solution at the order of the rule.
#![allow(clippy::needless_range_loop)] // one index into several columns

use crate::common::newton::solve_defects;
use phugoid::Experiment;
use phugoid::Grid;
use phugoid::Interpolation;
use phugoid::collocation::{Collocation, Settings};
use phugoid::expr::Expr;
use phugoid::model::Model;
use phugoid::nlp::{ExperimentId, PointId};
use phugoid::noise::{Noise, Sigma};

/// A model without inputs, every state an output, and its solution.
struct Known {
    model: Model,
    solution: fn(f64) -> Vec<f64>,
}

fn known(name: &str, equations: &[(&str, Expr)], solution: fn(f64) -> Vec<f64>) -> Known {
    let mut model = Model::new(name);
    for (state, _) in equations {
        let x = model.state(state, "").unwrap();
        model.output(state, x, "").unwrap();
    }
    for (state, rhs) in equations {
        model.equation(state, rhs.clone()).unwrap();
    }
    Known { model, solution }
}

/// x' = −x + cos t.
fn forced() -> Known {
    let (x, t) = (Expr::symbol("x"), Expr::symbol("time"));
    known("forced", &[("x", t.cos() - x)], |t| vec![0.5 * (t.cos() + t.sin()) + 0.7 * (-t).exp()])
}

/// The logistic equation x' = 2 x (1 − x/3), x(0) = 0.2.
fn logistic() -> Known {
    let x = Expr::symbol("x");
    known("logistic", &[("x", 2.0 * &x * (1.0 - &x / 3.0))], |t| vec![3.0 / (1.0 + 14.0 * (-2.0 * t).exp())])
}

/// A unit vector turned at the rate of its squared length: nonlinear in both states.
fn turning() -> Known {
    let (a, b) = (Expr::symbol("a"), Expr::symbol("b"));
    let rate = &a * &a + &b * &b;
    known("turning", &[("a", -&b * &rate), ("b", &a * &rate)], |t| vec![t.cos(), t.sin()])
}

/// Swing of a pendulum with energy on the separatrix: φ = 4 atan(eᵗ) − π, φ' = 2/cosh t.
fn pendulum() -> Known {
    let (phi, rate) = (Expr::symbol("phi"), Expr::symbol("rate"));
    known("pendulum", &[("phi", rate), ("rate", -phi.sin())], |t| {
        vec![4.0 * t.exp().atan() - std::f64::consts::PI, 2.0 / t.cosh()]
    })
}

const SPAN: f64 = 4.0;

/// Largest error at ends of segments, and at samples between points, of n uniform segments.
fn errors(known: &Known, order: usize, n: usize, samples: usize) -> (f64, f64) {
    let t: Vec<f64> = (0..=samples).map(|i| SPAN * i as f64 / samples as f64).collect();
    let n_x = known.model.states.len();
    let record = Experiment {
        name: "run".into(),
        outputs: vec![vec![0.0; t.len()]; n_x],
        t,
        inputs: vec![],
        interpolation: Interpolation::Linear,
        signals: Vec::new(),
    };
    let noise = Noise::Gaussian(vec![Sigma::Known(1.0); n_x]);
    let settings = Settings::default().order(order).grid(vec![Grid::Uniform(n)]).threads(1);
    let problem = Collocation::new(&known.model, &[record], noise, &settings).unwrap();
    let mesh = &problem.meshes[ExperimentId(0)];
    // From the solution: the first point is right, and Newton's method finds the discrete solution next to it.
    let mut xi: Vec<f64> = mesh.times.iter().flat_map(|&t| (known.solution)(t)).collect();
    solve_defects(&problem, &mut xi);
    let error = |point: usize| {
        let exact = (known.solution)(mesh.times[point]);
        let at = problem.layout.state(PointId(point)).0;
        exact.iter().zip(&xi[at..]).map(|(e, x)| (e - x).abs()).fold(0.0, f64::max)
    };
    let ends = mesh.segments.iter().map(|s| error(s.point + order - 1)).fold(0.0, f64::max);
    let between = mesh.between.iter().map(|b| error(b.point)).fold(0.0, f64::max);
    (ends, between)
}

/// Rounding errors of the whole record.
const FLOOR: f64 = 1e-12;

/// Doubles the number of segments until the errors reach the floor, and asserts the order.
fn falls(known: &Known, rule: usize, order: f64, most: usize, error: impl Fn(usize) -> f64) {
    let mut sizes = std::iter::successors(Some(4), |n| Some(2 * n)).take_while(|&n| n <= most);
    let mut before = error(sizes.next().unwrap());
    let (mut orders, mut smallest) = (Vec::new(), before);
    for n in sizes {
        let now = error(n);
        smallest = now;
        if now < FLOOR {
            break;
        }
        orders.push((before / now).log2());
        before = now;
    }
    let name = &known.model.name;
    // The last before rounding errors show; the first meshes are too coarse for the asymptote.
    let reached = *orders.last().unwrap();
    // Errors may still fall faster than in the limit, but not more slowly.
    let right = order - 0.1 < reached && reached < order + 0.3;
    assert!(right, "{name}, m = {rule}: order {order} expected, found {orders:?}");
    let floor_due = order >= 6.0 || (order >= 4.0 && most >= 2048);
    assert!(!floor_due || smallest < FLOOR, "{name}, m = {rule}: the error stays at {smallest:e}");
}

#[test]
fn ends_of_segments_converge_at_twice_the_points_less_two() {
    for known in [forced(), logistic(), turning(), pendulum()] {
        for (m, most) in [(2, 512), (3, 4096), (4, 512), (5, 256)] {
            falls(&known, m, 2.0 * m as f64 - 2.0, most, |n| errors(&known, m, n, 1).0);
        }
    }
}

/// Between points the collocation polynomial has the local error h^{m+1} of its degree m, beside that of
/// the ends of segments.
#[test]
fn samples_between_points_converge_at_one_order_more_than_the_points() {
    for known in [forced(), turning()] {
        for (m, most) in [(2, 512), (3, 512), (4, 256), (5, 128)] {
            let order = f64::min(2.0 * m as f64 - 2.0, m as f64 + 1.0);
            // Many samples, so that the largest error is found within the segments.
            falls(&known, m, order, most, |n| errors(&known, m, n, 4999).1);
        }
    }
}

#[test]
fn high_orders_are_exact_to_rounding_on_few_segments() {
    for known in [forced(), logistic(), turning(), pendulum()] {
        for (m, n) in [(8, 24), (12, 10), (20, 5)] {
            let error = errors(&known, m, n, 7).0.max(errors(&known, m, n, 7).1);
            assert!(error < FLOOR, "{}, m = {m}: {error:e}", known.model.name);
        }
    }
}
