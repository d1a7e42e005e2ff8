//! The arrow factorisation against dense linear algebra.
#![allow(clippy::needless_range_loop)]

use crate::common::Random;
use crate::common::flights::{TRUTH, problem};
use crate::common::models::{self, guess, mixed_noise, record};
use nalgebra::{DMatrix, DVector};
use phugoid::Grid;
use phugoid::collocation::{Collocation, Settings};
use phugoid::linalg::arrow::ArrowKkt;
use phugoid::linalg::sparse::SparseKkt;
use phugoid::linalg::{Effort, Entries, Factor, KktSolver};
use phugoid::model::Model;
use phugoid::nlp::{ExperimentId, Nlp, PointId, VariableId};
use phugoid::solver::state_units;

struct Case {
    problem: Collocation,
    xi: Vec<f64>,
    hessian: Vec<f64>,
    jacobian: Vec<f64>,
}

fn case(model: &Model, order: usize, grid: Grid, exact: bool) -> Case {
    let records = [record(model, "one", 13, true, 1), record(model, "two", 6, false, 2)];
    let settings = Settings::default().order(order).grid(vec![grid]).threads(1);
    let problem = Collocation::new(model, &records, mixed_noise(model), &settings).unwrap();
    let xi = guess(&problem, 3);
    let mut random = Random(7);
    let lambda: Vec<f64> = (0..problem.m()).map(|_| random.between(-1.0, 1.0)).collect();
    let mut hessian = vec![0.0; problem.hessian_structure().len()];
    if exact {
        problem.hessian(&xi, 1.0, &lambda, &mut hessian).unwrap();
    } else {
        problem.gauss_newton(&xi, 1.0, &mut hessian).unwrap();
    }
    let mut jacobian = vec![0.0; problem.jacobian_structure().len()];
    problem.jacobian(&xi, &mut jacobian).unwrap();
    Case { problem, xi, hessian, jacobian }
}

impl Case {
    fn arrow(&self) -> ArrowKkt {
        let p = &self.problem;
        let units: Vec<f64> = (0..p.layout.n_x).map(|i| [0.1, 3.0, 40.0][i % 3]).collect();
        let chains = p.chains().unwrap();
        ArrowKkt::new(chains, p.hessian_structure(), p.jacobian_structure(), (p.n(), p.m()), &units).unwrap()
    }

    /// [H Aᵀ; A 0], with identity rows for variables held.
    fn dense(&self, held: &[bool]) -> DMatrix<f64> {
        let (n, m) = (self.problem.n(), self.problem.m());
        let mut k = DMatrix::zeros(n + m, n + m);
        let s = self.problem.hessian_structure();
        for (t, v) in self.hessian.iter().enumerate() {
            let (r, c) = (s.rows[t] as usize, s.columns[t] as usize);
            k[(r, c)] += v;
            if r != c {
                k[(c, r)] += v;
            }
        }
        let s = self.problem.jacobian_structure();
        for (t, v) in self.jacobian.iter().enumerate() {
            let (r, c) = (s.rows[t] as usize, s.columns[t] as usize);
            k[(n + r, c)] += v;
            k[(c, n + r)] += v;
        }
        for i in (0..n).filter(|&i| held[i]) {
            k.row_mut(i).fill(0.0);
            k.column_mut(i).fill(0.0);
            k[(i, i)] = 1.0;
        }
        k
    }
}

fn cases() -> Vec<Case> {
    let mut all = Vec::new();
    for model in [models::nonlinear(), models::scalar(), models::linear()] {
        for order in [2, 3, 5] {
            for grid in [Grid::Samples(1), Grid::Samples(2), Grid::Uniform(5)] {
                for exact in [false, true] {
                    all.push(case(&model, order, grid.clone(), exact));
                }
            }
        }
    }
    all
}

#[test]
fn it_solves_as_dense_algebra_does_and_counts_the_same_inertia() {
    let mut positive = 0;
    for (number, case) in cases().iter().enumerate() {
        let (n, m) = (case.problem.n(), case.problem.m());
        let mut random = Random(number as u64);
        let mut held = vec![false; n];
        held[0] = number % 2 == 0;
        let mut arrow = case.arrow();
        arrow.factorize(&Entries { hessian: &case.hessian, jacobian: &case.jacobian }, Effort::FULL).unwrap();
        let found = arrow.finish(&held, 0.0);
        let dense = case.dense(&held);
        let eigen = dense.clone().symmetric_eigenvalues();
        let negative = eigen.iter().filter(|e| **e < 0.0).count();
        assert_eq!(
            found.is_positive(),
            negative == m,
            "case {number}: {found:?}, {negative} of {m} negative"
        );
        if !found.is_positive() {
            continue;
        }
        positive += 1;
        let p: Vec<f64> = (0..n).map(|_| random.between(-1.0, 1.0)).collect();
        let q: Vec<f64> = (0..m).map(|_| random.between(-1.0, 1.0)).collect();
        let (mut d, mut lambda) = (vec![0.0; n], vec![0.0; m]);
        arrow.solve(&p, &q, &mut d, &mut lambda);
        let mut right = DVector::from_iterator(n + m, p.iter().chain(&q).copied());
        if held[0] {
            right[0] = 0.0;
        }
        let expected = dense.clone().lu().solve(&right).unwrap();
        let got = DVector::from_iterator(n + m, d.iter().chain(&lambda).copied());
        let rest = (&dense * &got - &right).amax() / (dense.amax() * got.amax());
        assert!(rest < 1e-13, "case {number}: residual {rest:e}");
        for i in 0..n {
            let size = expected.rows(0, n).amax();
            assert!(
                (got[i] - expected[i]).abs() <= 1e-8 * size,
                "case {number}: d[{i}] {} for {}",
                got[i],
                expected[i]
            );
        }
    }
    assert!(positive >= 20, "only {positive} cases could be solved");
}

#[test]
fn a_shift_makes_any_curvature_positive_and_its_inertia_is_reported() {
    let mut indefinite = 0;
    for case in cases() {
        let mut arrow = case.arrow();
        arrow.factorize(&Entries { hessian: &case.hessian, jacobian: &case.jacobian }, Effort::FULL).unwrap();
        let held = vec![false; case.problem.n()];
        let found = arrow.finish(&held, 0.0);
        if found.is_positive() {
            continue;
        }
        indefinite += 1;
        assert!(!arrow.weak_directions().is_empty());
        assert!(arrow.finish(&held, 1e6).is_positive());
        // The first answer comes again.
        assert_eq!(arrow.finish(&held, 0.0), found);
    }
    assert!(indefinite >= 5, "{indefinite}");
}

#[test]
fn covariance_is_the_block_of_the_inverse() {
    let case = case(&models::linear(), 3, Grid::Samples(1), false);
    let mut arrow = case.arrow();
    arrow.factorize(&Entries { hessian: &case.hessian, jacobian: &case.jacobian }, Effort::FULL).unwrap();
    let held = vec![false; case.problem.n()];
    assert!(arrow.finish(&held, 0.0).is_positive());
    let inverse = case.dense(&held).try_inverse().unwrap();
    // Parameters and initial states of both experiments, read off; and other states, by solving.
    let l = &case.problem.layout;
    let [one, other] = [0, 1].map(|e| l.state(l.first_point[ExperimentId(e)]));
    let first = [one, one + 1, other, other + 1];
    for others in [vec![], vec![l.state(PointId(3))]] {
        let wanted: Vec<VariableId> = (0..l.n_theta).map(VariableId).chain(first).chain(others).collect();
        let mut covariance = vec![0.0; wanted.len() * wanted.len()];
        arrow.covariance(&wanted, &mut covariance);
        for i in 0..wanted.len() {
            for j in 0..wanted.len() {
                let (a, b) = (wanted[i].0, wanted[j].0);
                let scale = (inverse[(a, a)] * inverse[(b, b)]).abs().sqrt();
                let got = covariance[i * wanted.len() + j];
                assert!(
                    (got - inverse[(a, b)]).abs() < 1e-9 * scale,
                    "{a}, {b}: {got} for {}",
                    inverse[(a, b)]
                );
            }
        }
    }
    assert_eq!(case.xi.len(), case.problem.n());
}

#[test]
fn it_is_as_accurate_where_small_changes_grow_without_limit() {
    // A minute of an aircraft more unstable than most: a change at its start has grown by 10¹⁰⁰ at its end.
    let settings = Settings::default().order(3).threads(1);
    let (p, xi) = problem(&models::linear(), 1201, &settings);
    let mut xi = xi;
    xi[..6].copy_from_slice(&TRUTH);
    xi[3] = 1.0;
    let (n, m) = (p.n(), p.m());
    let mut hessian = vec![0.0; p.hessian_structure().len()];
    p.gauss_newton(&xi, 1.0, &mut hessian).unwrap();
    let mut jacobian = vec![0.0; p.jacobian_structure().len()];
    p.jacobian(&xi, &mut jacobian).unwrap();
    let units = state_units(&p, &xi);
    let chains = p.chains().unwrap();
    let mut arrow =
        ArrowKkt::new(chains, p.hessian_structure(), p.jacobian_structure(), (n, m), &units).unwrap();
    let least = arrow.groups();
    let mut sparse = SparseKkt::new(
        n,
        m,
        p.hessian_structure(),
        p.jacobian_structure(),
        &units.iter().copied().cycle().take(n).collect::<Vec<_>>(),
        &units.iter().copied().cycle().take(m).collect::<Vec<_>>(),
    );
    let mut random = Random(11);
    let right: Vec<f64> = (0..n + m).map(|_| random.between(-1.0, 1.0)).collect();
    let solved: [(Vec<f64>, Vec<f64>); 2] = [&mut arrow as &mut dyn KktSolver, &mut sparse].map(|kkt| {
        let kkt = kkt.factorize(&Entries { hessian: &hessian, jacobian: &jacobian }, Effort::FULL).unwrap();
        assert!(kkt.finish(&vec![false; n], 0.0).is_positive());
        let (mut d, mut lambda) = (vec![0.0; n], vec![0.0; m]);
        kkt.solve(&right[..n], &right[n..], &mut d, &mut lambda);
        (d, lambda)
    });
    assert!(arrow.groups() > 3 * least, "{} groups of at least {least}", arrow.groups());
    // The equations hold to rounding, and both answers are the same.
    let s = p.jacobian_structure();
    let (mut rest, mut size) = (right[n..].to_vec(), vec![0.0f64; m]);
    for (t, a) in jacobian.iter().enumerate() {
        let (r, c) = (s.rows[t] as usize, s.columns[t] as usize);
        rest[r] -= a * solved[0].0[c];
        size[r] += (a * solved[0].0[c]).abs();
    }
    let worst = rest.iter().zip(&size).fold(0.0f64, |w, (r, s)| w.max(r.abs() / (s + 1.0)));
    assert!(worst < 1e-13, "{worst:e}");
    for (a, b) in [(&solved[0].0, &solved[1].0), (&solved[0].1, &solved[1].1)] {
        let size = b.iter().fold(0.0f64, |s, x| s.max(x.abs()));
        let apart = a.iter().zip(b).fold(0.0f64, |s, (x, y)| s.max((x - y).abs()));
        assert!(apart < 1e-9 * size, "{apart:e} of {size:e}");
    }
}

#[test]
fn states_that_rest_need_no_refinement() {
    // Without the parameters a defect at the end of the record moves an unstable aircraft less and less before it: to 10⁻³⁰
    // and less, of which rounding leaves nothing.
    let settings = Settings::default().order(3).threads(1);
    let (p, mut xi) = problem(&models::linear(), 1201, &settings);
    xi[..6].copy_from_slice(&TRUTH);
    xi[3] = 1.0;
    let (n, m) = (p.n(), p.m());
    let (h, a) = (p.hessian_structure(), p.jacobian_structure());
    let (mut hessian, mut jacobian) = (vec![0.0; h.len()], vec![0.0; a.len()]);
    p.gauss_newton(&xi, 1.0, &mut hessian).unwrap();
    p.jacobian(&xi, &mut jacobian).unwrap();
    let mut arrow = ArrowKkt::new(p.chains().unwrap(), h, a, (n, m), &state_units(&p, &xi)).unwrap();
    arrow.factorize(&Entries { hessian: &hessian, jacobian: &jacobian }, Effort::FULL).unwrap();
    let held: Vec<bool> = (0..n).map(|i| i < p.n_parameters()).collect();
    assert!(arrow.finish(&held, 0.0).is_positive());
    let mut q = vec![0.0; m];
    q[m - 1] = 1.0;
    let (mut d, mut lambda) = (vec![0.0; n], vec![0.0; m]);
    arrow.solve(&vec![0.0; n], &q, &mut d, &mut lambda);
    let first = &d[p.n_parameters()..p.n_parameters() + 10];
    assert!(first.iter().all(|x| x.abs() < 1e-17), "{first:?}");
    assert!(arrow.refinements() < 2, "{} steps of refinement", arrow.refinements());
}
