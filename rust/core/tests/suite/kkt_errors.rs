//! Why a Newton system is not factorised is told apart, by every implementation.

use std::time::Duration;

use phugoid::collocation::{Collocation, Settings};
use phugoid::interrupt::Interrupt;
use phugoid::linalg::{Effort, Entries, KktError, KktSolver, kkt_for};
use phugoid::model::End;
use phugoid::nlp::Nlp;
use phugoid::noise::Noise;
use phugoid::{Experiment, Expr, Grid, Model, Parameter, Sigma};

/// x' = a x over 400 segments, with or without a condition on the initial state.
fn problem(condition: bool) -> Collocation {
    of_length(400, condition)
}

fn of_length(segments: u32, condition: bool) -> Collocation {
    let mut m = Model::new("growth");
    let (x, a) = (m.state("x", "").unwrap(), m.parameter(Parameter::new("a", 1.0)).unwrap());
    m.equation("x", a * &x).unwrap();
    m.output("x", x, "").unwrap();
    if condition {
        m.condition(End::Initial, "x", Expr::from(1.0)).unwrap();
    }
    let t: Vec<f64> = (0..=segments).map(f64::from).collect();
    let run = Experiment::new(&m, "run", t, [("x", vec![1.0; segments as usize + 1])]).unwrap();
    let settings = Settings::default().order(4).grid(vec![Grid::Samples(1)]).threads(1);
    Collocation::new(&m, &[run], Noise::Gaussian(vec![Sigma::Known(1.0)]), &settings).unwrap()
}

fn factorized(
    p: &Collocation,
    kkt: &mut dyn KktSolver,
    a: f64,
    (spoil, hurry): (bool, bool),
) -> Result<(), KktError> {
    let mut xi = vec![1.0; p.n()];
    xi[0] = a;
    let mut hessian = vec![0.0; p.hessian_structure().len()];
    let mut jacobian = vec![0.0; p.jacobian_structure().len()];
    p.gauss_newton(&xi, 1.0, &mut hessian).unwrap();
    p.jacobian(&xi, &mut jacobian).unwrap();
    if spoil {
        jacobian[7] = f64::NAN;
    }
    let entries = Entries { hessian: &hessian, jacobian: &jacobian };
    kkt.factorize(&entries, Effort { refine: true, hurry }).map(|_| ())
}

#[test]
fn a_costly_system_is_refused_in_a_hurry() {
    for condition in [false, true] {
        let p = problem(condition);
        let mut kkt = kkt_for(&p, &[1.0]);
        assert_eq!(factorized(&p, &mut *kkt, -0.1, (false, true)), Ok(()));
        // It grows a hundredfold and more in every segment: each is a group of its own.
        assert_eq!(factorized(&p, &mut *kkt, 6.0, (false, true)), Err(KktError::TooCostly));
        assert_eq!(factorized(&p, &mut *kkt, 6.0, (false, false)), Ok(()));
    }
}

#[test]
fn numbers_that_are_not_finite_are_no_dependence() {
    for condition in [false, true] {
        let p = problem(condition);
        let mut kkt = kkt_for(&p, &[1.0]);
        assert_eq!(factorized(&p, &mut *kkt, -0.1, (false, false)), Ok(()));
        let flops = kkt.flops();
        assert_eq!(factorized(&p, &mut *kkt, -0.1, (true, false)), Err(KktError::NotFinite));
        // The same factorisation goes on.
        assert_eq!(factorized(&p, &mut *kkt, -0.1, (false, false)), Ok(()));
        assert_eq!(kkt.flops(), flops);
    }
}

/// Planning the elimination of a long record takes tens of milliseconds: a limit that passes meanwhile ends it, and what
/// is not planned has no operations.
#[test]
fn planning_ends_where_the_time_does() {
    let p = of_length(200_000, false);
    assert!(kkt_for(&p, &[1.0]).flops() > 0);
    let limit = Interrupt::within(Some(Duration::from_millis(1)));
    let mut kkt = limit.run(|| kkt_for(&p, &[1.0]));
    assert_eq!(kkt.flops(), 0);
    assert_eq!(factorized(&p, &mut *kkt, -0.1, (false, false)), Err(KktError::Stopped));
}
