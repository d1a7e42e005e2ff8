//! Conditions on the ends of a record that its states cannot meet determine parameters, for the arrow factorisation, too.
#![allow(clippy::needless_range_loop)]

use crate::common::Random;
use nalgebra::{DMatrix, DVector};
use phugoid::collocation::{Collocation, Settings};
use phugoid::linalg::arrow::ArrowKkt;
use phugoid::linalg::sparse::SparseKkt;
use phugoid::linalg::{Effort, Entries, Factor, KktError, KktSolver, kkt_for};
use phugoid::model::End;
use phugoid::nlp::{Nlp, PointId, VariableId};
use phugoid::noise::Noise;
use phugoid::{Experiment, Expr, Grid, Model, Parameter, Sigma};

/// x' = a x + c u, y' = b x − y + d: what grows, and what follows.
fn model(conditions: &[(End, &str, f64)]) -> Model {
    let mut m = Model::new("growth");
    let (x, y, u) = (m.state("x", "").unwrap(), m.state("y", "").unwrap(), m.input("u", "").unwrap());
    let [a, b, c, d] = ["a", "b", "c", "d"].map(|name| m.parameter(Parameter::new(name, 1.0)).unwrap());
    m.equation("x", a * &x + c * u).unwrap();
    m.equation("y", b * &x - &y + d).unwrap();
    m.output("x", x, "").unwrap();
    m.output("y", y, "").unwrap();
    for (end, state, value) in conditions {
        m.condition(*end, state, Expr::from(*value)).unwrap();
    }
    m
}

/// Two records of so many seconds, sampled ten times a second.
fn problem(conditions: &[(End, &str, f64)], seconds: u32) -> Collocation {
    let m = model(conditions);
    let t: Vec<f64> = (0..=10 * seconds).map(|k| 0.1 * f64::from(k)).collect();
    let record = |name: &str, phase: f64| {
        let wave = |shift: f64| t.iter().map(|t| (1.3 * t + shift).sin()).collect::<Vec<_>>();
        let columns = [("u", wave(phase)), ("x", wave(0.4)), ("y", wave(0.9 * phase))];
        Experiment::new(&m, name, t.clone(), columns).unwrap()
    };
    let records = [record("one", 0.3), record("two", 1.1)];
    let settings = Settings::default().order(3).grid(vec![Grid::Samples(2)]).threads(1);
    let noise = Noise::Gaussian(vec![Sigma::Known(0.5), Sigma::Known(0.2)]);
    Collocation::new(&m, &records, noise, &settings).unwrap()
}

struct Case {
    problem: Collocation,
    hessian: Vec<f64>,
    jacobian: Vec<f64>,
}

impl Case {
    fn new(conditions: &[(End, &str, f64)], seconds: u32, a: f64, state: f64) -> Case {
        let problem = problem(conditions, seconds);
        let mut random = Random(5);
        let mut xi: Vec<f64> = (0..problem.n()).map(|_| state * random.between(0.5, 1.5)).collect();
        xi[..4].copy_from_slice(&[a, 0.7, 0.3, -0.2]);
        let mut hessian = vec![0.0; problem.hessian_structure().len()];
        problem.gauss_newton(&xi, 1.0, &mut hessian).unwrap();
        let mut jacobian = vec![0.0; problem.jacobian_structure().len()];
        problem.jacobian(&xi, &mut jacobian).unwrap();
        Case { problem, hessian, jacobian }
    }

    fn entries(&self) -> Entries<'_> {
        Entries { hessian: &self.hessian, jacobian: &self.jacobian }
    }

    fn arrow(&self) -> ArrowKkt {
        let p = &self.problem;
        let chains = p.chains().unwrap();
        ArrowKkt::new(chains, p.hessian_structure(), p.jacobian_structure(), (p.n(), p.m()), &[1.0, 0.5])
            .unwrap()
    }

    fn sparse(&self) -> SparseKkt {
        let p = &self.problem;
        let (columns, rows) = (vec![1.0; p.n()], vec![1.0; p.m()]);
        SparseKkt::new(p.n(), p.m(), p.hessian_structure(), p.jacobian_structure(), &columns, &rows)
    }

    /// H and A.
    fn dense(&self) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n, m) = (self.problem.n(), self.problem.m());
        let (mut h, mut a) = (DMatrix::zeros(n, n), DMatrix::zeros(m, n));
        let s = self.problem.hessian_structure();
        for (t, v) in self.hessian.iter().enumerate() {
            let (r, c) = (s.rows[t] as usize, s.columns[t] as usize);
            h[(r, c)] += v;
            if r != c {
                h[(c, r)] += v;
            }
        }
        let s = self.problem.jacobian_structure();
        for (t, v) in self.jacobian.iter().enumerate() {
            a[(s.rows[t] as usize, s.columns[t] as usize)] += v;
        }
        (h, a)
    }

    /// A random right-hand side, p and q.
    fn right(&self) -> (Vec<f64>, Vec<f64>) {
        let mut random = Random(9);
        let mut some = |count| (0..count).map(|_| random.between(-1.0, 1.0)).collect();
        (some(self.problem.n()), some(self.problem.m()))
    }
}

fn solve(factor: &mut dyn Factor, held: &[bool], (p, q): &(Vec<f64>, Vec<f64>)) -> (Vec<f64>, Vec<f64>) {
    assert!(factor.finish(held, 0.0).is_positive());
    let (mut d, mut lambda) = (vec![0.0; p.len()], vec![0.0; q.len()]);
    factor.solve(p, q, &mut d, &mut lambda);
    (d, lambda)
}

const GIVEN: [(End, &str, f64); 2] = [(End::Initial, "x", 1.0), (End::Initial, "y", 0.5)];
const RETURNS: [(End, &str, f64); 2] = [(End::Periodic, "x", 0.0), (End::Initial, "y", 0.5)];

/// Given initial states with little growth, and with so much that nothing but the parameters decide where it ends (10⁹, 10²⁶);
/// an integrator that ends where it began.
fn cases() -> [Case; 4] {
    [
        Case::new(&GIVEN, 8, -0.3, 1.0),
        Case::new(&GIVEN, 8, 2.6, 1.0),
        Case::new(&GIVEN, 20, 3.0, 1.0),
        Case::new(&RETURNS, 8, 0.0, 1.0),
    ]
}

#[test]
fn the_arrow_solves_as_dense_algebra_and_the_sparse_factorisation_do() {
    for (number, case) in cases().iter().enumerate() {
        let (n, m) = (case.problem.n(), case.problem.m());
        let (h, a) = case.dense();
        for hold in [None, Some(1), Some(3)] {
            let mut held = vec![false; n];
            hold.into_iter().for_each(|i| held[i] = true);
            let right = case.right();
            let mut arrow = case.arrow();
            let (d, lambda) = solve(arrow.factorize(&case.entries(), Effort::FULL).unwrap(), &held, &right);
            let (d, lambda) = (DVector::from_vec(d), DVector::from_vec(lambda));
            // What is left of the equations, of the order of rounding in their terms.
            let mut rest = &h * &d + a.transpose() * &lambda - DVector::from_vec(right.0.clone());
            let terms = h.abs() * d.abs() + a.abs().transpose() * lambda.abs();
            (0..n).filter(|&i| held[i]).for_each(|i| rest[i] = 0.0);
            for i in 0..n {
                assert!(rest[i].abs() <= 1e-9 * terms.amax(), "case {number} {hold:?}: {} at {i}", rest[i]);
                assert!(!held[i] || d[i] == 0.0);
            }
            let rest = &a * &d - DVector::from_vec(right.1.clone());
            let terms = a.abs() * d.abs();
            for i in 0..m {
                assert!(
                    rest[i].abs() <= 1e-11 * (1.0 + terms[i]),
                    "case {number} {hold:?}: {} in {i}",
                    rest[i]
                );
            }
            let mut sparse = case.sparse();
            let (other, _) = solve(sparse.factorize(&case.entries(), Effort::FULL).unwrap(), &held, &right);
            let size = d.amax();
            for i in 0..n {
                let apart = (d[i] - other[i]).abs();
                assert!(apart <= 1e-6 * size, "case {number} {hold:?}: d[{i}] {} for {}", d[i], other[i]);
            }
        }
    }
}

#[test]
fn the_covariance_is_that_of_the_sparse_factorisation() {
    for (number, case) in cases().iter().enumerate() {
        let (mut arrow, mut sparse) = (case.arrow(), case.sparse());
        let held = vec![false; case.problem.n()];
        let first = case.problem.layout.state(PointId(0));
        let wanted: Vec<VariableId> = (0..4).map(VariableId).chain([first]).collect();
        let covariance = |factor: &mut dyn Factor| {
            assert!(factor.finish(&held, 0.0).is_positive());
            let mut out = vec![0.0; wanted.len() * wanted.len()];
            factor.covariance(&wanted, &mut out);
            DMatrix::from_row_slice(wanted.len(), wanted.len(), &out)
        };
        let of_arrow = covariance(arrow.factorize(&case.entries(), Effort::FULL).unwrap());
        let of_sparse = covariance(sparse.factorize(&case.entries(), Effort::FULL).unwrap());
        for i in 0..4 {
            for j in 0..4 {
                // Of what a motion that grows by 10²⁶ determines there is no variance left, but for rounding.
                let rounding = 1e-14 * of_sparse.diagonal().max();
                let scale = (of_sparse[(i, i)] * of_sparse[(j, j)]).sqrt();
                let apart = (of_arrow[(i, j)] - of_sparse[(i, j)]).abs();
                assert!(
                    apart <= 1e-6 * scale + rounding,
                    "case {number}: {} {}",
                    of_arrow[(i, j)],
                    of_sparse[(i, j)]
                );
            }
        }
    }
}

/// The small system of the parameters gives the same step of them as a solution for all variables, and what holds them.
#[test]
fn the_reduced_system_gives_the_parameters_of_the_whole_solution() {
    for (number, case) in cases().iter().enumerate() {
        let n = case.problem.n();
        let (h, a) = case.dense();
        let (p, q) = case.right();
        let mut arrow = case.arrow();
        let factor = arrow.factorize(&case.entries(), Effort::FULL).unwrap();
        let count = factor.reduce(&p, &q);
        assert_eq!(count, case.problem.layout.n_theta);
        for hold in [None, Some(1), Some(3)] {
            let (mut held, mut to) = (vec![false; n], DVector::zeros(n));
            hold.into_iter().for_each(|i| (held[i], to[i]) = (true, 0.25));
            assert!(factor.finish(&held, 0.0).is_positive());
            let (mut d, mut z) = (vec![0.0; count], vec![0.0; count]);
            factor.solve_reduced(&to.as_slice()[..count], &mut d, &mut z);
            let moved_p = DVector::from_vec(p.clone()) - &h * &to;
            let moved_q = DVector::from_vec(q.clone()) - &a * &to;
            let (mut whole, mut lambda) = (vec![0.0; n], vec![0.0; q.len()]);
            factor.solve(moved_p.as_slice(), moved_q.as_slice(), &mut whole, &mut lambda);
            let whole = DVector::from_vec(whole) + &to;
            let size = whole.rows(0, count).amax();
            let holds =
                DVector::from_vec(p.clone()) - &h * &whole - a.transpose() * DVector::from_vec(lambda);
            for i in 0..count {
                assert!(
                    (d[i] - whole[i]).abs() <= 1e-6 * size,
                    "case {number} {hold:?}: {} {}",
                    d[i],
                    whole[i]
                );
                let expected = if held[i] { holds[i] } else { 0.0 };
                let scale = holds[i].abs() + h.amax() * size;
                assert!(
                    (z[i] - expected).abs() <= 1e-6 * scale,
                    "case {number} {hold:?}: {} {expected}",
                    z[i]
                );
            }
        }
    }
}

/// The sparse factorisation serves only where constraints depend on each other, which it can name, and for that iterate only.
#[test]
fn the_next_iterate_is_for_the_arrow_again() {
    let both = [(End::Initial, "x", 1.0), (End::Final, "x", 1.0)];
    let good = Case::new(&both, 4, 0.1, 1.0);
    let mut kkt = kkt_for(&good.problem, &[1.0, 1.0]);
    assert!(kkt.factorize(&good.entries(), Effort::FULL).is_ok());
    let flops = kkt.flops();
    // Nothing moves x: no parameter has an influence on where it ends.
    let mut bad = Case::new(&both, 4, 0.0, 0.0);
    for t in 0..bad.jacobian.len() {
        if (bad.problem.jacobian_structure().columns[t] as usize) < 4 {
            bad.jacobian[t] = 0.0;
        }
    }
    let found = kkt.factorize(&bad.entries(), Effort::FULL).map(|_| ());
    assert!(matches!(found, Err(KktError::Dependent { .. })), "{found:?}");
    assert!(kkt.factorize(&good.entries(), Effort::FULL).is_ok());
    assert_eq!(kkt.flops(), flops);
    assert!(kkt.factor().is_some());
}
