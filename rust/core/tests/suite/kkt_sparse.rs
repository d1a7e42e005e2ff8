//! The sparse factorisation of Newton systems against dense linear algebra.
#![allow(clippy::needless_range_loop)] // one index into several columns

use crate::common::Random;
use crate::common::models::{self, guess, known_noise, mixed_noise, record};
use nalgebra::{DMatrix, DVector};
use phugoid::Experiment;
use phugoid::Grid;
use phugoid::Interpolation;
use phugoid::collocation::{Collocation, Settings};
use phugoid::linalg::sparse::SparseKkt;
use phugoid::linalg::{Curvature, Effort, Entries, Factor, KktError, KktSolver};
use phugoid::model::{Model, Parameter};
use phugoid::nlp::{Named, Nlp, Structure, VariableId};
use phugoid::noise::{Noise, Sigma};
use proptest::prelude::*;

/// A Newton system by triplets.
#[derive(Clone, Debug)]
struct Case {
    n: usize,
    m: usize,
    h: Structure,
    a: Structure,
    hessian: Vec<f64>,
    jacobian: Vec<f64>,
    scale: Vec<f64>,
    row_scale: Vec<f64>,
}

impl Case {
    fn new(n: usize, m: usize) -> Case {
        Case {
            n,
            m,
            h: Structure::default(),
            a: Structure::default(),
            hessian: Vec::new(),
            jacobian: Vec::new(),
            scale: vec![1.0; n],
            row_scale: vec![1.0; m],
        }
    }

    fn add_h(&mut self, row: usize, column: usize, value: f64) {
        self.h.rows.push(row.max(column) as u32);
        self.h.columns.push(row.min(column) as u32);
        self.hessian.push(value);
    }

    fn add_a(&mut self, row: usize, column: usize, value: f64) {
        self.a.rows.push(row as u32);
        self.a.columns.push(column as u32);
        self.jacobian.push(value);
    }

    fn sparse(&self) -> SparseKkt {
        SparseKkt::new(self.n, self.m, &self.h, &self.a, &self.scale, &self.row_scale)
    }

    fn entries(&self) -> Entries<'_> {
        Entries { hessian: &self.hessian, jacobian: &self.jacobian }
    }

    fn factorized(&self) -> SparseKkt {
        let mut kkt = self.sparse();
        kkt.factorize(&self.entries(), Effort::FULL).unwrap();
        kkt
    }

    fn dense_h(&self) -> DMatrix<f64> {
        let mut h = DMatrix::zeros(self.n, self.n);
        for (k, value) in self.hessian.iter().enumerate() {
            let (r, c) = (self.h.rows[k] as usize, self.h.columns[k] as usize);
            h[(r, c)] += value;
            if r != c {
                h[(c, r)] += value;
            }
        }
        h
    }

    fn dense_a(&self) -> DMatrix<f64> {
        let mut a = DMatrix::zeros(self.m, self.n);
        for (k, value) in self.jacobian.iter().enumerate() {
            a[(self.a.rows[k] as usize, self.a.columns[k] as usize)] += value;
        }
        a
    }

    /// [H + shift D, Aᵀ; A, 0] with identity rows and columns for held variables.
    fn dense(&self, held: &[bool], shift: &[f64]) -> DMatrix<f64> {
        let (n, m) = (self.n, self.m);
        let mut k = DMatrix::zeros(n + m, n + m);
        k.view_mut((0, 0), (n, n)).copy_from(&self.dense_h());
        (0..n).for_each(|i| k[(i, i)] += shift[i]);
        let a = self.dense_a();
        k.view_mut((n, 0), (m, n)).copy_from(&a);
        k.view_mut((0, n), (n, m)).copy_from(&a.transpose());
        for i in (0..n).filter(|&i| held[i]) {
            k.row_mut(i).fill(0.0);
            k.column_mut(i).fill(0.0);
            k[(i, i)] = 1.0;
        }
        k
    }

    /// D of the shift as documented.
    fn shift_diagonal(&self) -> Vec<f64> {
        let h = self.dense_h();
        (0..self.n).map(|i| if h[(i, i)] == 0.0 { self.scale[i].powi(-2) } else { h[(i, i)].abs() }).collect()
    }

    /// Rows and columns multiplied by units.
    fn in_units(&self, k: &DMatrix<f64>) -> DMatrix<f64> {
        let units = self.units();
        DMatrix::from_fn(k.nrows(), k.ncols(), |i, j| k[(i, j)] * units[i] * units[j])
    }

    fn units(&self) -> Vec<f64> {
        self.scale.iter().copied().chain(self.row_scale.iter().map(|s| 1.0 / s)).collect()
    }

    fn random_right(&self, random: &mut Random) -> DVector<f64> {
        let units = self.units();
        DVector::from_fn(self.n + self.m, |i, _| random.between(-1.0, 1.0) / units[i])
    }
}

/// Solves and returns (d, λ) as one vector.
fn solve(kkt: &mut SparseKkt, case: &Case, right: &DVector<f64>) -> DVector<f64> {
    let (mut d, mut lambda) = (vec![f64::NAN; case.n], vec![f64::NAN; case.m]);
    let right = right.as_slice();
    kkt.solve(&right[..case.n], &right[case.n..], &mut d, &mut lambda);
    DVector::from_iterator(case.n + case.m, d.into_iter().chain(lambda))
}

/// Greatest residual of an equation as a part of the sum of its terms, small ones as Arioli, Demmel and
/// Duff (1989) have it; in units.
fn backward_error(case: &Case, held: &[bool], shift: &[f64], x: &DVector<f64>, right: &DVector<f64>) -> f64 {
    let units = case.units();
    let x = DVector::from_fn(x.len(), |i, _| x[i] / units[i]);
    let least = 1e3 * f64::EPSILON * x.amax();
    let mut rest = DVector::from_fn(x.len(), |i, _| right[i] * units[i]);
    let mut size = rest.abs();
    let mut term = |i: usize, value: f64, j: usize| {
        if !(i < case.n && held[i]) {
            let value = value * units[i] * units[j];
            rest[i] -= value * x[j];
            size[i] += value.abs() * (x[j].abs() + least);
        }
    };
    for (k, &value) in case.hessian.iter().enumerate() {
        let (r, c) = (case.h.rows[k] as usize, case.h.columns[k] as usize);
        term(r, value, c);
        if r != c {
            term(c, value, r);
        }
    }
    for (k, &value) in case.jacobian.iter().enumerate() {
        let (r, c) = (case.n + case.a.rows[k] as usize, case.a.columns[k] as usize);
        term(r, value, c);
        term(c, value, r);
    }
    (0..case.n).for_each(|i| term(i, shift[i], i));
    (0..case.n).filter(|&i| held[i]).for_each(|i| rest[i] = x[i]);
    rest.iter().zip(&size).map(|(r, s)| if *r == 0.0 { 0.0 } else { (r / s).abs() }).fold(0.0, f64::max)
}

/// Checks inertia and solution; returns the curvature and the error of the solution in units, relative.
fn check(
    case: &Case,
    kkt: &mut SparseKkt,
    held: &[bool],
    shift: f64,
    random: &mut Random,
) -> (Curvature, f64) {
    let (n, m) = (case.n, case.m);
    let found = kkt.finish(held, shift);
    let diagonal: Vec<f64> = case.shift_diagonal().iter().map(|d| shift * d).collect();
    let dense = case.dense(held, &diagonal);
    let eigen = case.in_units(&dense).symmetric_eigenvalues();
    let negative = eigen.iter().filter(|e| **e < 0.0).count();
    assert_eq!(found, Curvature { negative: negative - m, zero: 0 }, "{n} variables, {m} constraints");
    assert_eq!(kkt.weak_directions().len(), found.negative);
    let mut right = case.random_right(random);
    // What is given for held variables does not matter.
    let x = solve(kkt, case, &right);
    (0..n).filter(|&i| held[i]).for_each(|i| right[i] = 0.0);
    let error = backward_error(case, held, &diagonal, &x, &right);
    assert!(error < 4e-15, "residual {error:e}");
    (0..n).filter(|&i| held[i]).for_each(|i| assert_eq!(x[i], 0.0));
    let expected = dense.lu().solve(&right).unwrap();
    let units = case.units();
    let in_units = |v: &DVector<f64>| DVector::from_fn(n + m, |i, _| v[i] / units[i]);
    let error = (in_units(&x) - in_units(&expected)).amax() / in_units(&expected).amax();
    (found, error)
}

/// A random system whose rows have about `entries` entries.
fn random_case(n: usize, m: usize, entries: usize, positive: bool, random: &mut Random) -> Case {
    let mut case = Case::new(n, m);
    let pick = |random: &mut Random, below: usize| (random.bits() % below as u64) as usize;
    for row in 0..m {
        // One entry makes rank likely.
        case.add_a(row, row, random.between(0.5, 2.0));
        for _ in 0..entries {
            let column = pick(random, n);
            case.add_a(row, column, random.between(-1.0, 1.0));
        }
    }
    // Squares of sparse rows; some variables have no part.
    for _ in 0..n + 2 {
        let places: Vec<usize> = (0..1 + pick(random, 3)).map(|_| pick(random, n)).collect();
        let values: Vec<f64> = places.iter().map(|_| random.between(-1.0, 1.0)).collect();
        let sign = if !positive && random.bits().is_multiple_of(3) { -1.0 } else { 1.0 };
        for (i, x) in places.iter().zip(&values) {
            for (j, y) in places.iter().zip(&values) {
                if i >= j {
                    case.add_h(*i, *j, sign * x * y);
                }
            }
        }
    }
    if positive {
        (0..n).for_each(|i| case.add_h(i, i, 0.3));
    }
    case
}

#[test]
fn it_solves_as_dense_algebra_does_and_counts_the_same_inertia() {
    let mut random = Random(1);
    let (mut worst, mut indefinite) = (0.0f64, 0);
    for number in 0..300usize {
        let n = 1 + number % 60;
        let m = (random.bits() % (n as u64 + 1)) as usize;
        let positive = number.is_multiple_of(2);
        let case = random_case(n, m, 1 + number % 5, positive, &mut random);
        let reduced = reduced_eigenvalues(&case, &vec![false; n]);
        if reduced.iter().any(|e| e.abs() < 1e-6) {
            continue;
        }
        let mut kkt = case.factorized();
        let (found, error) = check(&case, &mut kkt, &vec![false; n], 0.0, &mut random);
        assert_eq!(found.negative, reduced.iter().filter(|e| **e < 0.0).count());
        assert!(!positive || found.is_positive());
        indefinite += usize::from(!found.is_positive());
        worst = worst.max(error);
    }
    println!("worst difference from dense solutions {worst:e}; {indefinite} indefinite");
    assert!(worst < 1e-8, "{worst:e}");
    assert!(indefinite > 50, "{indefinite}");
}

/// Eigenvalues of ZᵀHZ, Z orthonormal, with some variables held.
fn reduced_eigenvalues(case: &Case, held: &[bool]) -> Vec<f64> {
    let n = case.n;
    let number = held.iter().filter(|h| **h).count();
    let mut a = DMatrix::zeros((case.m + number).max(n), n);
    a.view_mut((0, 0), (case.m, n)).copy_from(&case.dense_a());
    for (row, i) in (0..n).filter(|&i| held[i]).enumerate() {
        a[(case.m + row, i)] = 1.0;
    }
    let svd = a.svd(false, true);
    let v = svd.v_t.unwrap();
    let rows: Vec<usize> = (0..n).filter(|&i| svd.singular_values[i] < 1e-10).collect();
    let z = DMatrix::from_fn(n, rows.len(), |i, j| v[(rows[j], i)]);
    if rows.is_empty() {
        return Vec::new();
    }
    (z.transpose() * case.dense_h() * z).symmetric_eigenvalues().iter().copied().collect()
}

#[test]
fn variables_are_held_and_the_hessian_is_shifted() {
    let mut random = Random(2);
    let (mut worst, mut in_basis) = (0.0f64, 0);
    for number in 0..200usize {
        let n = 4 + number % 40;
        let m = (random.bits() % (n as u64 - 2)) as usize;
        let case = random_case(n, m, 3, number.is_multiple_of(3), &mut random);
        let mut kkt = case.factorized();
        // Several sides of bounds for one factorisation, as an active set tries them.
        for round in 0..4u64 {
            let most = (n - m) as u64;
            let mut held = vec![false; n];
            for _ in 0..random.bits() % most {
                held[(random.bits() % n as u64) as usize] = true;
            }
            let shift = [0.0, 0.7, 30.0, 0.0][round as usize];
            if number % 3 != 0 && shift == 0.0 {
                let eigen = reduced_eigenvalues(&case, &held);
                if eigen.iter().any(|e| e.abs() < 1e-6) {
                    continue;
                }
            }
            let diagonal: Vec<f64> = case.shift_diagonal().iter().map(|d| shift * d).collect();
            let dense = case.dense(&held, &diagonal);
            if dense.clone().singular_values().min() < 1e-5 {
                continue;
            }
            let (_, error) = check(&case, &mut kkt, &held, shift, &mut random);
            worst = worst.max(error);
            in_basis += usize::from(held.iter().any(|h| *h));
        }
    }
    println!("worst difference from dense solutions {worst:e} in {in_basis} cases");
    assert!(worst < 1e-8, "{worst:e}");
    assert!(in_basis > 200, "{in_basis}");
}

#[test]
fn a_great_shift_makes_any_hessian_positive() {
    let mut random = Random(3);
    for _ in 0..50 {
        let case = random_case(20, 8, 3, false, &mut random);
        let mut kkt = case.factorized();
        let held = vec![false; 20];
        let found = kkt.finish(&held, 0.0);
        let mut shift = 1e-3;
        while !kkt.finish(&held, shift).is_positive() {
            shift *= 10.0;
            assert!(shift < 1e8);
        }
        assert!(kkt.weak_directions().is_empty());
        // The first answer comes again.
        assert_eq!(kkt.finish(&held, 0.0), found);
    }
}

#[test]
fn the_diagonal_of_the_shift_is_as_documented() {
    let mut case = random_case(20, 8, 3, false, &mut Random(4));
    case.scale = (0..20).map(|i| 10f64.powi(i % 5 - 2)).collect();
    let kkt = case.factorized();
    for (found, expected) in kkt.shift_diagonal().iter().zip(case.shift_diagonal()) {
        assert!((found - expected).abs() <= 1e-14 * expected, "{found} for {expected}");
    }
}

#[test]
fn entries_at_one_place_add_up() {
    let mut random = Random(5);
    let case = random_case(25, 12, 3, true, &mut random);
    let mut parts = case.clone();
    for k in 0..case.hessian.len() {
        parts.hessian[k] *= 0.25;
        parts.add_h(case.h.rows[k] as usize, case.h.columns[k] as usize, 0.75 * case.hessian[k]);
    }
    for k in 0..case.jacobian.len() {
        parts.jacobian[k] *= -1.0;
        parts.add_a(case.a.rows[k] as usize, case.a.columns[k] as usize, 2.0 * case.jacobian[k]);
    }
    let right = case.random_right(&mut random);
    let mut found = [&case, &parts].map(|c| {
        let mut kkt = c.factorized();
        assert!(kkt.finish(&[false; 25], 0.0).is_positive());
        solve(&mut kkt, c, &right)
    });
    found[1] -= found[0].clone();
    assert!(found[1].amax() < 1e-12 * found[0].amax());
}

#[test]
fn units_do_not_matter() {
    let mut random = Random(6);
    let mut worst = 0.0f64;
    for number in 0..100usize {
        let n = 5 + number % 50;
        let m = n / 2;
        let plain = random_case(n, m, 3, number.is_multiple_of(2), &mut random);
        if reduced_eigenvalues(&plain, &vec![false; n]).iter().any(|e| e.abs() < 1e-6) {
            continue;
        }
        let mut case = plain.clone();
        case.scale = (0..n).map(|_| 10f64.powf(random.between(-8.0, 8.0))).collect();
        case.row_scale = (0..m).map(|_| 10f64.powf(random.between(-8.0, 8.0))).collect();
        for (k, value) in case.hessian.iter_mut().enumerate() {
            *value /= case.scale[case.h.rows[k] as usize] * case.scale[case.h.columns[k] as usize];
        }
        for (k, value) in case.jacobian.iter_mut().enumerate() {
            *value *= case.row_scale[case.a.rows[k] as usize] / case.scale[case.a.columns[k] as usize];
        }
        let mut kkt = case.factorized();
        let found = kkt.finish(&vec![false; n], 0.0);
        let mut reference = plain.factorized();
        assert_eq!(found, reference.finish(&vec![false; n], 0.0));
        let right = plain.random_right(&mut random);
        let units = case.units();
        let x = solve(&mut kkt, &case, &DVector::from_fn(n + m, |i, _| right[i] / units[i]));
        let expected = solve(&mut reference, &plain, &right);
        let error = DVector::from_fn(n + m, |i, _| x[i] / units[i] - expected[i]).amax() / expected.amax();
        worst = worst.max(error);
    }
    println!("worst difference {worst:e}");
    assert!(worst < 1e-10, "{worst:e}");
}

/// Units that are wrong by far cost little: pivots and curvature are judged in their own.
#[test]
fn wrong_units_are_survived() {
    let mut random = Random(16);
    let mut worst = 0.0f64;
    for number in 0..100usize {
        let n = 5 + number % 30;
        let m = n / 2;
        let mut case = random_case(n, m, 2, true, &mut random);
        let wrong: Vec<f64> = (0..n + m).map(|_| 10f64.powf(random.between(-3.0, 3.0))).collect();
        for (k, value) in case.hessian.iter_mut().enumerate() {
            *value *= wrong[case.h.rows[k] as usize] * wrong[case.h.columns[k] as usize];
        }
        for (k, value) in case.jacobian.iter_mut().enumerate() {
            *value *= wrong[n + case.a.rows[k] as usize] * wrong[case.a.columns[k] as usize];
        }
        let mut kkt = case.factorized();
        assert!(kkt.finish(&vec![false; n], 0.0).is_positive(), "{number}");
        let right = case.random_right(&mut random);
        let x = solve(&mut kkt, &case, &right);
        worst = worst.max(backward_error(&case, &vec![false; n], &vec![0.0; n], &x, &right));
    }
    println!("worst residual {worst:e}");
    assert!(worst < 4e-15, "{worst:e}");
}

#[test]
fn a_constraint_that_depends_on_others_is_named() {
    let mut random = Random(7);
    for number in 0..100usize {
        let (n, m) = (30, 12);
        let case = random_case(n, m, 3, true, &mut random);
        let mut dependent = case.clone();
        dependent.m += 1;
        dependent.row_scale.push(1.0);
        // The last is a sum of some others, or nothing.
        let of: Vec<usize> = (0..number % 4).map(|i| (number + 5 * i) % m).collect();
        for k in 0..case.jacobian.len() {
            if of.contains(&(case.a.rows[k] as usize)) {
                let factor = 1.0 + case.a.rows[k] as f64;
                dependent.add_a(m, case.a.columns[k] as usize, factor * case.jacobian[k]);
            }
        }
        let mut kkt = dependent.sparse();
        let error = kkt.factorize(&dependent.entries(), Effort::FULL).err().unwrap();
        let KktError::Dependent { row } = error else { panic!("{error}") };
        assert!(row.0 == m || of.contains(&row.0), "{row:?} for {m} or {of:?}");
        // Nothing is positive then, and nothing looks like a solution.
        assert!(!kkt.finish(&vec![false; n], 0.0).is_positive());
        assert!(solve(&mut kkt, &dependent, &DVector::zeros(n + m + 1)).iter().all(|x| x.is_nan()));
        // Other numbers at the same places may be independent.
        let other: Vec<f64> = dependent.jacobian.iter().map(|_| random.between(-1.0, 1.0)).collect();
        if !of.is_empty() {
            kkt.factorize(&Entries { jacobian: &other, ..dependent.entries() }, Effort::FULL).unwrap();
        }
    }
}

/// Every pivot passes, but two small ones one after the other leave no digit.
#[test]
fn constraints_that_depend_but_for_rounding_are_refused() {
    let small = 1e-8;
    let mut case = Case::new(4, 4);
    for (row, column, value) in [
        (0, 0, 1.0),
        (0, 1, 1.0),
        (1, 0, 1.0),
        (1, 1, 1.0 + small),
        (2, 2, 1.0),
        (2, 3, 1.0),
        (3, 1, 1.0),
        (3, 2, 1.0),
        (3, 3, 1.0 + small),
    ] {
        case.add_a(row, column, value);
    }
    assert!(case.sparse().factorize(&case.entries(), Effort::FULL).is_err());
    // One alone is bad, but not hopeless.
    case.jacobian[3] = 2.0;
    assert!(case.sparse().factorize(&case.entries(), Effort::FULL).is_ok());
}

#[test]
fn more_constraints_than_variables_depend_on_each_other() {
    let mut case = Case::new(2, 3);
    for row in 0..3 {
        case.add_a(row, 0, 1.0 + row as f64);
        case.add_a(row, 1, 1.0);
    }
    case.add_h(0, 0, 1.0);
    assert!(case.sparse().factorize(&case.entries(), Effort::FULL).is_err());
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    let case = random_case(10, 4, 2, true, &mut Random(8));
    let mut kkt = case.sparse();
    for bad in [f64::NAN, f64::INFINITY] {
        let mut jacobian = case.jacobian.clone();
        jacobian[5] = bad;
        let entries = Entries { jacobian: &jacobian, ..case.entries() };
        assert_eq!(kkt.factorize(&entries, Effort::FULL).err(), Some(KktError::NotFinite));
        let mut hessian = case.hessian.clone();
        hessian[3] = bad;
        let entries = Entries { hessian: &hessian, ..case.entries() };
        assert_eq!(kkt.factorize(&entries, Effort::FULL).err(), Some(KktError::NotFinite));
    }
    kkt.factorize(&case.entries(), Effort::FULL).unwrap();
    assert!(kkt.finish(&[false; 10], 0.0).is_positive());
}

/// x₀ and x₁ enter the objective as a sum only, x₅ not at all, x₆ through x₇ which does not count.
#[test]
fn directions_of_no_curvature_are_named() {
    let mut case = Case::new(8, 2);
    for (i, j, value) in
        [(0, 0, 4.0), (1, 0, 4.0), (1, 1, 4.0), (2, 2, 1.0), (3, 3, 2.0), (4, 3, 0.5), (4, 4, 3.0)]
    {
        case.add_h(i, j, value);
    }
    case.add_a(0, 2, 1.0);
    case.add_a(0, 3, -2.0);
    case.add_a(1, 6, 0.5);
    case.add_a(1, 7, -1.0);
    let mut kkt = case.factorized();
    assert_eq!(kkt.finish(&[false; 8], 0.0), Curvature { negative: 0, zero: 3 });
    let mut named = std::collections::BTreeSet::new();
    let (h, a) = (case.dense_h(), case.dense_a());
    for direction in kkt.weak_directions() {
        assert!(direction.windows(2).all(|w| w[0].1.abs() >= w[1].1.abs()));
        named.extend(direction.iter().map(|(i, _)| i.0));
        let d = DVector::from_fn(8, |i, _| {
            let unit = if h[(i, i)] == 0.0 { 1.0 } else { h[(i, i)].sqrt() };
            direction.iter().find(|x| x.0 == VariableId(i)).map_or(0.0, |x| x.1 / unit)
        });
        assert!((&a * &d).amax() < 1e-12 && (&h * &d).amax() < 1e-12, "{direction:?}");
    }
    assert_eq!(named.into_iter().collect::<Vec<_>>(), [0, 1, 5, 6, 7]);
    // One by one they are settled.
    let mut held = [false; 8];
    held[5] = true;
    held[7] = true;
    assert_eq!(kkt.finish(&held, 0.0), Curvature { negative: 0, zero: 1 });
    let [direction] = kkt.weak_directions() else { panic!() };
    let variables: Vec<usize> = direction.iter().map(|x| x.0.0).collect();
    assert!(variables == [0, 1] || variables == [1, 0]);
    assert!((direction[0].1 + direction[1].1).abs() < 1e-12);
    held[1] = true;
    assert!(kkt.finish(&held, 0.0).is_positive());
    assert!(kkt.weak_directions().is_empty());
    assert!(kkt.finish(&[false; 8], 1e-3).is_positive());
}

#[test]
fn directions_of_negative_curvature_have_it() {
    let mut random = Random(9);
    let mut found = 0;
    for _ in 0..50 {
        let case = random_case(12, 5, 2, false, &mut random);
        let mut kkt = case.factorized();
        kkt.finish(&[false; 12], 0.0);
        let h = case.dense_h();
        let units = case.shift_diagonal();
        for direction in kkt.weak_directions() {
            // Small parts are left out.
            if direction.len() < 4 {
                let mut d = DVector::zeros(12);
                direction.iter().for_each(|&(VariableId(i), part)| d[i] = part / units[i].sqrt());
                let curvature = (d.transpose() * &h * &d)[0];
                assert!(curvature < 0.05, "{curvature}");
                found += 1;
            }
        }
    }
    assert!(found > 5);
}

#[test]
fn what_constraints_determine_cannot_be_held() {
    let mut case = Case::new(4, 2);
    (0..4).for_each(|i| case.add_h(i, i, 1.0));
    // x₀ = 0 and x₁ + x₂ + x₃ = 0.
    case.add_a(0, 0, 2.0);
    (1..4).for_each(|i| case.add_a(1, i, 1.0));
    let mut kkt = case.factorized();
    assert_eq!(kkt.finish(&[true, false, false, false], 0.0), Curvature { negative: 0, zero: 1 });
    assert_eq!(kkt.weak_directions(), [[(VariableId(0), 1.0)]]);
    assert_eq!(kkt.finish(&[false, true, true, true], 0.0), Curvature { negative: 0, zero: 1 });
    assert!(kkt.weak_directions()[0][0].0 > VariableId(0));
    assert!(kkt.finish(&[false, true, true, false], 0.0).is_positive());
    let x = solve(&mut kkt, &case, &DVector::from_vec(vec![1.0, 2.0, 3.0, 4.0, 6.0, 5.0]));
    let expected = [3.0, 0.0, 0.0, 5.0, -1.0, -1.0];
    assert!((x - DVector::from_row_slice(&expected)).amax() < 1e-14);
}

/// H = [[0, h], [h, 0]]: nothing on the diagonal tells its size.
#[test]
fn a_saddle_with_nothing_on_its_diagonal_is_one() {
    for h in [1e-9, 1.0, 1e9] {
        let mut case = Case::new(3, 1);
        case.add_h(1, 0, h);
        case.add_a(0, 2, 1.0);
        let mut kkt = case.factorized();
        assert_eq!(kkt.finish(&[false; 3], 0.0), Curvature { negative: 1, zero: 0 });
        assert_eq!(kkt.finish(&[false; 3], 0.5 * h), Curvature { negative: 1, zero: 0 });
        assert!(kkt.finish(&[false; 3], 2.0 * h).is_positive());
    }
}

#[test]
fn no_constraints_no_variables_no_freedom() {
    let mut kkt = Case::new(0, 0).factorized();
    assert!(kkt.finish(&[], 0.0).is_positive());
    kkt.solve(&[], &[], &mut [], &mut []);
    let mut case = Case::new(2, 2);
    case.add_a(0, 1, 2.0);
    case.add_a(1, 0, 4.0);
    case.add_h(0, 0, -1.0);
    let mut kkt = case.factorized();
    assert!(kkt.finish(&[false; 2], 0.0).is_positive());
    let x = solve(&mut kkt, &case, &DVector::from_vec(vec![1.0, 1.0, 2.0, 4.0]));
    assert_eq!(x.as_slice(), [1.0, 1.0, 0.5, 0.5]);
    let mut case = Case::new(3, 0);
    (0..3).for_each(|i| case.add_h(i, i, 2.0));
    let mut kkt = case.factorized();
    assert!(kkt.finish(&[false; 3], 0.0).is_positive());
    let x = solve(&mut kkt, &case, &DVector::from_vec(vec![2.0, 4.0, 6.0]));
    assert!((x - DVector::from_vec(vec![1.0, 2.0, 3.0])).amax() < 1e-15);
}

/// x_{k+1} = Φ_k x_k + b θ with factors that grow by 10¹⁰⁰ and more over the record, and shrink.
#[test]
fn unstable_systems_are_no_harder() {
    for (rates, name) in [
        ([3.0, 3.0], "growing"),
        ([0.3, 0.3], "decaying"),
        ([3.0, 0.3], "first growing"),
        ([0.3, 3.0], "last growing"),
    ] {
        let steps = 300;
        let n = steps + 2; // θ, then the states
        let mut case = Case::new(n, steps);
        let mut random = Random(10);
        for k in 0..steps {
            case.add_a(k, 2 + k, 1.0);
            case.add_a(k, 1 + k, -rates[2 * k / steps] * random.between(0.8, 1.2));
            case.add_a(k, 0, random.between(0.0, 1.0));
        }
        for k in (0..=steps).step_by(3) {
            case.add_h(1 + k, 1 + k, 1.0);
        }
        let mut kkt = case.factorized();
        assert!(kkt.finish(&vec![false; n], 0.0).is_positive(), "{name}");
        let right = case.random_right(&mut random);
        let x = solve(&mut kkt, &case, &right);
        let error = backward_error(&case, &vec![false; n], &vec![0.0; n], &x, &right);
        assert!(error < 2e-15, "{name}: {error:e}");
    }
}

/// Four states, modes that grow and modes that decay all mixed.
#[test]
fn growing_and_decaying_modes_together_are_no_harder() {
    let (states, steps, parameters) = (4, 500, 3);
    let mut random = Random(17);
    let n = parameters + states * (steps + 1);
    let mut case = Case::new(n, states * steps);
    let modes = DMatrix::from_fn(4, 4, |i, j| random.between(-1.0, 1.0) + if i == j { 2.0 } else { 0.0 });
    let rates = DMatrix::from_diagonal(&DVector::from_vec(vec![2.0, 0.5, 1.3, 0.7]));
    let phi = &modes * rates * modes.clone().try_inverse().unwrap();
    for k in 0..steps {
        for i in 0..states {
            let row = states * k + i;
            case.add_a(row, parameters + states * (k + 1) + i, 1.0);
            (0..states).for_each(|j| case.add_a(row, parameters + states * k + j, -phi[(i, j)]));
            (0..parameters).for_each(|p| case.add_a(row, p, random.between(-1.0, 1.0)));
        }
    }
    // Only one state is measured.
    (0..=steps).for_each(|k| case.add_h(parameters + states * k, parameters + states * k, 1.0));
    let mut kkt = case.factorized();
    let held = vec![false; n];
    assert!(kkt.finish(&held, 0.0).is_positive());
    let right = case.random_right(&mut random);
    let x = solve(&mut kkt, &case, &right);
    let error = backward_error(&case, &held, &vec![0.0; n], &x, &right);
    assert!(error < 2e-15, "{error:e}");
}

/// What stood in memory before plays no part.
#[test]
fn a_second_factorisation_is_like_a_first() {
    let mut random = Random(11);
    let case = random_case(40, 20, 4, false, &mut random);
    let mut used = case.factorized();
    used.finish(&[true; 40], 2.0);
    for _ in 0..5 {
        let hessian: Vec<f64> = case.hessian.iter().map(|_| random.between(-1.0, 1.0)).collect();
        let jacobian: Vec<f64> = case.jacobian.iter().map(|_| random.between(-1.0, 1.0)).collect();
        let case = Case { hessian, jacobian, ..case.clone() };
        used.factorize(&case.entries(), Effort::FULL).unwrap();
        let mut fresh = case.factorized();
        let held: Vec<bool> = (0..40).map(|i| i % 11 == 3).collect();
        assert_eq!(used.finish(&held, 0.1), fresh.finish(&held, 0.1));
        let right = case.random_right(&mut random);
        assert_eq!(solve(&mut used, &case, &right), solve(&mut fresh, &case, &right));
        assert_eq!(used.flops(), fresh.flops());
        assert!(used.flops() > 0);
    }
}

#[test]
fn covariance_is_the_block_of_the_inverse() {
    let mut random = Random(12);
    let case = random_case(30, 18, 3, true, &mut random);
    let mut kkt = case.factorized();
    let mut held = vec![false; 30];
    held[4] = true;
    assert!(kkt.finish(&held, 0.0).is_positive());
    let inverse = case.dense(&held, &[0.0; 30]).try_inverse().unwrap();
    let wanted = [0, 7, 4, 29];
    let mut covariance = [f64::NAN; 16];
    kkt.covariance(&wanted.map(VariableId), &mut covariance);
    for (i, &r) in wanted.iter().enumerate() {
        for (j, &c) in wanted.iter().enumerate() {
            let expected = if held[r] || held[c] { 0.0 } else { inverse[(r, c)] };
            let scale = (inverse[(r, r)] * inverse[(c, c)]).sqrt();
            assert!((covariance[4 * i + j] - expected).abs() < 1e-11 * scale);
        }
    }
}

/// The system of a collocation problem at some point.
fn collocation(model: &Model, noise: Noise, order: usize, grid: Grid, exact: bool) -> (Collocation, Case) {
    let records = [record(model, "one", 13, true, 1), record(model, "two", 6, false, 2)];
    let settings = Settings::default().order(order).grid(vec![grid]).threads(1);
    let problem = Collocation::new(model, &records, noise, &settings).unwrap();
    let case = system(&problem, &guess(&problem, 3), exact);
    (problem, case)
}

fn system(problem: &Collocation, xi: &[f64], exact: bool) -> Case {
    let mut random = Random(7);
    let mut case = Case::new(problem.n(), problem.m());
    let lambda: Vec<f64> = (0..case.m).map(|_| random.between(-0.3, 0.3)).collect();
    case.h = problem.hessian_structure().clone();
    case.a = problem.jacobian_structure().clone();
    case.hessian = vec![f64::NAN; case.h.len()];
    case.jacobian = vec![f64::NAN; case.a.len()];
    if exact {
        problem.hessian(xi, 1.0, &lambda, &mut case.hessian).unwrap();
    } else {
        problem.gauss_newton(xi, 1.0, &mut case.hessian).unwrap();
    }
    problem.jacobian(xi, &mut case.jacobian).unwrap();
    for i in problem.layout.n_theta..case.n {
        case.scale[i] = [0.1, 3.0, 40.0, 1.0][(i - problem.layout.n_theta) % problem.layout.n_x];
    }
    for i in 0..case.m {
        case.row_scale[i] = [0.1, 3.0, 40.0, 1.0][i % problem.layout.n_x];
    }
    case
}

#[test]
fn collocation_problems_are_solved() {
    let (mut worst, mut positive, mut indefinite) = (0.0f64, 0, 0);
    for model in [models::nonlinear(), models::scalar(), models::linear()] {
        for (order, grid) in [(2, Grid::Samples(1)), (4, Grid::Samples(1)), (3, Grid::Uniform(5))] {
            for exact in [false, true] {
                for noise in [mixed_noise(&model), known_noise(&model)] {
                    let (problem, case) = collocation(&model, noise, order, grid.clone(), exact);
                    let (lower, upper) = problem.bounds();
                    let held: Vec<bool> = (0..case.n).map(|i| lower[i] == upper[i]).collect();
                    let mut kkt = case.factorized();
                    let mut random = Random(13);
                    let (found, error) = check(&case, &mut kkt, &held, 0.0, &mut random);
                    worst = worst.max(error);
                    positive += usize::from(found.is_positive());
                    indefinite += usize::from(!found.is_positive());
                    assert!(exact || found.is_positive(), "{}: {found:?}", model.name);
                    check(&case, &mut kkt, &held, 0.2, &mut random);
                }
            }
        }
    }
    println!("worst difference from dense solutions {worst:e}; {positive} positive, {indefinite} not");
    assert!(worst < 1e-8, "{worst:e}");
    assert!(positive >= 18 && indefinite > 5, "{positive}, {indefinite}");
}

/// A parameter that nothing depends on, and two that only their sum enters.
#[test]
fn parameters_that_data_cannot_tell_are_named() {
    let mut m = Model::new("redundant");
    let x = m.state("x", "").unwrap();
    let [a, b, c, idle] = ["a", "b", "c", "idle"].map(|p| m.parameter(Parameter::new(p, -0.3)).unwrap());
    let u = m.input("u", "").unwrap();
    m.equation("x", (&a + &b) * &x + &c + &idle * u).unwrap();
    m.output("x", x, "").unwrap();
    let mut records = [record(&m, "one", 40, false, 1)];
    records[0].inputs[0].fill(0.0);
    for (order, exact) in [(2, false), (4, false)] {
        let settings = Settings::default().order(order).grid(vec![Grid::Samples(1)]).threads(1);
        let problem = Collocation::new(&m, &records, known_noise(&m), &settings).unwrap();
        let case = system(&problem, &guess(&problem, 3), exact);
        let mut kkt = case.factorized();
        assert_eq!(kkt.finish(&vec![false; case.n], 0.0), Curvature { negative: 0, zero: 2 });
        let mut named = std::collections::BTreeSet::new();
        for direction in kkt.weak_directions() {
            named.extend(direction.iter().map(|(i, _)| problem.variable_name(*i)));
        }
        assert_eq!(named.into_iter().collect::<Vec<_>>(), ["a", "b", "idle"]);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn any_system_is_solved_to_rounding(
        seed in any::<u64>(), n in 1usize..40, part in 0.0f64..1.0, entries in 0usize..8, shift in 0.0f64..2.0,
    ) {
        let mut random = Random(seed);
        let m = ((n as f64) * part) as usize;
        let case = random_case(n, m, entries, true, &mut random);
        let mut kkt = case.sparse();
        if kkt.factorize(&case.entries(), Effort::FULL).is_ok() {
            let held = vec![false; n];
            prop_assert!(kkt.finish(&held, shift).is_positive());
            let right = case.random_right(&mut random);
            let x = solve(&mut kkt, &case, &right);
            let diagonal: Vec<f64> = case.shift_diagonal().iter().map(|d| shift * d).collect();
            let error = backward_error(&case, &held, &diagonal, &x, &right);
            prop_assert!(error < 4e-15, "residual {:e}", error);
        }
    }
}

/// Longitudinal motion with four states, as HFB-320's: 15 + 7 parameters, 601 samples.
fn large(order: usize, samples: usize) -> Collocation {
    let mut m = Model::new("longitudinal");
    let [v, alpha, theta, q] = ["V", "alpha", "theta", "q"].map(|s| m.state(s, "").unwrap());
    let [de, thrust] = ["de", "thrust"].map(|s| m.input(s, "").unwrap());
    let p = [
        "CD0", "CDV", "CDa", "CL0", "CLV", "CLa", "Cm0", "CmV", "Cma", "Cmq", "Cmde", "b1", "b2", "b3", "b4",
    ];
    let p = p.map(|name| m.parameter(Parameter::new(name, -0.1)).unwrap());
    let cd = &p[0] + &p[1] * &v + &p[2] * &alpha;
    let cl = &p[3] + &p[4] * &v + &p[5] * &alpha;
    let cm = &p[6] + &p[7] * &v + &p[8] * &alpha + &p[9] * &q + &p[10] * &de;
    m.equation("V", &thrust * alpha.cos() - &cd * &v * &v + (&theta - &alpha).sin() + &p[11]).unwrap();
    m.equation("alpha", &q - &cl * &v + (&theta - &alpha).cos() / &v + &p[12]).unwrap();
    m.equation("theta", &q + &p[13]).unwrap();
    m.equation("q", &cm * &v * &v + &p[14]).unwrap();
    let ax = &cl * alpha.sin() - &cd * alpha.cos();
    let az = -(&cl * alpha.cos()) - &cd * alpha.sin();
    for (name, value) in
        [("V", v), ("alpha", alpha), ("theta", theta), ("q", q), ("dq", cm), ("ax", ax), ("az", az)]
    {
        m.output(name, value, "").unwrap();
    }
    let mut random = Random(14);
    let mut channel = || (0..samples).map(|_| random.between(0.5, 1.0)).collect::<Vec<f64>>();
    let record = Experiment {
        name: "one".into(),
        t: (0..samples).map(|i| 0.1 * i as f64).collect(),
        inputs: vec![channel(), channel()],
        outputs: (0..7).map(|_| channel()).collect(),
        interpolation: Interpolation::Linear,
        signals: Vec::new(),
    };
    let noise = Noise::Gaussian(vec![Sigma::Unknown { start: 0.5, lower: 1e-3, upper: 1e3 }; 7]);
    let settings = Settings::default().order(order).grid(vec![Grid::Samples(1)]).threads(1);
    Collocation::new(&m, &[record], noise, &settings).unwrap()
}

#[test]
#[ignore = "a measurement: cargo test --release --test suite kkt_sparse -- --ignored --nocapture"]
fn timing() {
    for (order, exact) in [(2, false), (2, true), (4, false), (4, true)] {
        let problem = large(order, 601);
        let case = system(&problem, &guess(&problem, 5), exact);
        let began = std::time::Instant::now();
        let mut kkt = case.sparse();
        let analysed = began.elapsed();
        let held = vec![false; case.n];
        let mut best = [f64::INFINITY; 4];
        let mut random = Random(15);
        let right = case.random_right(&mut random);
        let mut found = Curvature::default();
        let mut x = right.clone();
        for _ in 0..30 {
            let began = std::time::Instant::now();
            kkt.factorize(&case.entries(), Effort::FULL).unwrap();
            best[0] = best[0].min(began.elapsed().as_secs_f64());
            let began = std::time::Instant::now();
            found = kkt.finish(&held, 0.0);
            best[1] = best[1].min(began.elapsed().as_secs_f64());
            let began = std::time::Instant::now();
            x = solve(&mut kkt, &case, &right);
            best[2] = best[2].min(began.elapsed().as_secs_f64());
            let began = std::time::Instant::now();
            kkt.finish(&held, 1.0);
            best[3] = best[3].min(began.elapsed().as_secs_f64());
        }
        let rest = backward_error(&case, &held, &vec![0.0; case.n], &x, &right);
        println!(
            "order {order}, exact {exact}: n {} m {} entries {} + {}; analysis {:.1} ms, factorize {:.2} ms, finish {:.3} ms, \
             solve {:.2} ms, finish with first shift {:.2} ms; {found:?}, {:.1} Mflop, residual {rest:.1e}",
            case.n,
            case.m,
            case.hessian.len(),
            case.jacobian.len(),
            1e3 * analysed.as_secs_f64(),
            1e3 * best[0],
            1e3 * best[1],
            1e3 * best[2],
            1e3 * best[3],
            kkt.flops() as f64 / 1e6,
        );
    }
}
