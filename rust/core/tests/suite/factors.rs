//! What a Newton system's factor answers, and when there is one.

use crate::common::flights::problem;
use crate::common::models;
use phugoid::collocation::{Collocation, Settings};
use phugoid::linalg::arrow::ArrowKkt;
use phugoid::linalg::sparse::SparseKkt;
use phugoid::linalg::{Effort, Entries, Factor, KktSolver};
use phugoid::nlp::Nlp;
use phugoid::solver::state_units;

/// Entries of the Gauss-Newton system at the start, and of one whose Hessian is another.
fn entries(p: &Collocation, xi: &[f64]) -> [Vec<f64>; 3] {
    let mut hessian = vec![0.0; p.hessian_structure().len()];
    let mut jacobian = vec![0.0; p.jacobian_structure().len()];
    p.gauss_newton(xi, 1.0, &mut hessian).unwrap();
    p.jacobian(xi, &mut jacobian).unwrap();
    let other = hessian.iter().map(|h| 1.7 * h).collect();
    [hessian, other, jacobian]
}

/// The arrow factorisation and the sparse one.
fn solvers(p: &Collocation, xi: &[f64]) -> [Box<dyn KktSolver>; 2] {
    let (n, m) = (p.n(), p.m());
    let (h, a, units) = (p.hessian_structure(), p.jacobian_structure(), state_units(p, xi));
    let cycled = |count| units.iter().copied().cycle().take(count).collect::<Vec<_>>();
    let arrow = ArrowKkt::new(p.chains().unwrap(), h, a, (n, m), &units).unwrap();
    [Box::new(arrow), Box::new(SparseKkt::new(n, m, h, a, &cycled(n), &cycled(m)))]
}

fn solved(p: &Collocation, factor: &mut dyn Factor) -> Vec<u64> {
    assert!(factor.finish(&vec![false; p.n()], 0.0).is_positive());
    let (mut d, mut lambda) = (vec![0.0; p.n()], vec![0.0; p.m()]);
    factor.solve(&vec![1.0; p.n()], &vec![-0.5; p.m()], &mut d, &mut lambda);
    d.iter().chain(&lambda).map(|x| x.to_bits()).collect()
}

#[test]
fn there_is_a_factor_only_of_what_was_factorised() {
    let (p, xi) = problem(&models::linear(), 61, &Settings::default().threads(1));
    let [hessian, _, mut jacobian] = entries(&p, &xi);
    for mut kkt in solvers(&p, &xi) {
        assert!(kkt.factor().is_none());
        let good = Entries { hessian: &hessian, jacobian: &jacobian };
        let bits = solved(&p, kkt.factorize(&good, Effort::FULL).unwrap());
        assert_eq!(solved(&p, kkt.factor().unwrap()), bits);
        let was = std::mem::replace(&mut jacobian[3], f64::NAN);
        let spoilt = Entries { hessian: &hessian, jacobian: &jacobian };
        assert!(kkt.factorize(&spoilt, Effort::FULL).is_err());
        assert!(kkt.factor().is_none());
        jacobian[3] = was;
    }
}

#[test]
fn another_hessian_leads_to_the_same_bits_as_a_new_factorisation() {
    let (p, xi) = problem(&models::linear(), 61, &Settings::default().threads(1));
    let [hessian, other, jacobian] = entries(&p, &xi);
    let first = Entries { hessian: &hessian, jacobian: &jacobian };
    let second = Entries { hessian: &other, jacobian: &jacobian };
    for mut kkt in solvers(&p, &xi) {
        let new = solved(&p, kkt.factorize(&second, Effort::FULL).unwrap());
        let factor = kkt.factorize(&first, Effort::FULL).unwrap();
        assert_ne!(solved(&p, factor), new);
        factor.replace_hessian(&second).unwrap();
        assert_eq!(solved(&p, factor), new);
    }
}
