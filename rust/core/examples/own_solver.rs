//! A solver and a factorisation of one's own in an estimation: plain Newton steps, and dense null-space linear algebra.
//!
//!     cargo run --release --example own_solver

use nalgebra::{DMatrix, DVector, SVD, SymmetricEigen};
use phugoid::estimate::{Beginning, Problem, Solver};
use phugoid::linalg::{Curvature, Direction, Effort, Entries, Factor, KktChoice, KktError, KktSolver};
use phugoid::nlp::{Nlp, NotFinite, Structure, VariableId};
use phugoid::solver::{Control, Iteration, Settings, Solution, Status};
use phugoid::{Estimation, Experiment, Model, Parameter, Sigma};

/// Below this part of the greatest, singular values and eigenvalues are zero.
const ZERO: f64 = 1e-11;

/// The Newton system as dense matrices, solved in the null space of the constraints.
struct Dense {
    structures: [Structure; 2],
    h: DMatrix<f64>,
    a: DMatrix<f64>,
    held: Vec<bool>,
    /// Of the constraints in the variables that are not held.
    decomposed: Option<SVD<f64, nalgebra::Dyn, nalgebra::Dyn>>,
    /// A basis Z of their null space, and the inverse of ZᵀHZ.
    basis: DMatrix<f64>,
    inverse: DMatrix<f64>,
    weak: Vec<Direction>,
}

impl Dense {
    fn new(nlp: &dyn Nlp) -> Dense {
        let (n, m) = (nlp.n(), nlp.m());
        Dense {
            structures: [nlp.hessian_structure().clone(), nlp.jacobian_structure().clone()],
            h: DMatrix::zeros(n, n),
            a: DMatrix::zeros(m, n),
            held: vec![false; n],
            decomposed: None,
            basis: DMatrix::zeros(n, 0),
            inverse: DMatrix::zeros(0, 0),
            weak: Vec::new(),
        }
    }
}

impl KktSolver for Dense {
    fn factorize(&mut self, entries: &Entries<'_>, _: Effort) -> Result<&mut dyn Factor, KktError> {
        self.replace_hessian(entries)?;
        Ok(self)
    }

    fn factor(&mut self) -> Option<&mut dyn Factor> {
        Some(self)
    }

    fn flops(&self) -> u64 {
        8 * (self.h.nrows() as u64).pow(3)
    }
}

impl Factor for Dense {
    fn replace_hessian(&mut self, entries: &Entries<'_>) -> Result<(), KktError> {
        if !entries.hessian.iter().chain(entries.jacobian).all(|v| v.is_finite()) {
            return Err(KktError::NotFinite);
        }
        let [h, a] = &self.structures;
        self.h.fill(0.0);
        self.a.fill(0.0);
        for ((&r, &c), v) in h.rows.iter().zip(&h.columns).zip(entries.hessian) {
            self.h[(r as usize, c as usize)] += v;
            if r != c {
                self.h[(c as usize, r as usize)] += v;
            }
        }
        for ((&r, &c), v) in a.rows.iter().zip(&a.columns).zip(entries.jacobian) {
            self.a[(r as usize, c as usize)] += v;
        }
        Ok(())
    }

    fn finish(&mut self, held: &[bool], shift: f64) -> Curvature {
        self.held.copy_from_slice(held);
        // Square, so that the decomposition has all right singular vectors.
        let (m, n) = self.a.shape();
        let mut a = DMatrix::zeros(m.max(n), n);
        a.rows_mut(0, m).copy_from(&self.a);
        (0..n).filter(|&i| held[i]).for_each(|i| a.column_mut(i).fill(0.0));
        let svd = a.svd(true, true);
        let greatest = svd.singular_values.max();
        let right = svd.v_t.as_ref().expect("asked for");
        let is_held = |k: usize| (0..n).any(|i| held[i] && right[(k, i)].abs() > 0.5);
        let null: Vec<usize> =
            (0..n).filter(|&k| svd.singular_values[k] <= ZERO * greatest && !is_held(k)).collect();
        let mut basis = right.select_rows(&null).transpose();
        (0..n).filter(|&i| held[i]).for_each(|i| basis.row_mut(i).fill(0.0));
        let mut reduced = basis.tr_mul(&(&self.h * &basis));
        for i in 0..reduced.nrows() {
            reduced[(i, i)] += shift * reduced[(i, i)].abs();
        }
        let eigen = SymmetricEigen::new(reduced);
        let small = ZERO * eigen.eigenvalues.amax();
        let mut found = Curvature::default();
        self.weak.clear();
        for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            if *value > small {
                continue;
            }
            if *value < -small {
                found.negative += 1
            } else {
                found.zero += 1
            }
            let parts = &basis * vector;
            let mut direction: Direction =
                parts.iter().enumerate().map(|(i, part)| (VariableId(i), *part)).collect();
            direction.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
            self.weak.push(direction);
        }
        if found.is_positive() {
            let inverse = DMatrix::from_diagonal(&eigen.eigenvalues.map(f64::recip));
            self.inverse = &eigen.eigenvectors * inverse * eigen.eigenvectors.transpose();
        }
        (self.decomposed, self.basis) = (Some(svd), basis);
        found
    }

    fn solve(&mut self, p: &[f64], q: &[f64], d: &mut [f64], lambda: &mut [f64]) {
        let svd = self.decomposed.as_ref().expect("finished");
        let small = ZERO * svd.singular_values.max();
        let mut right = DVector::zeros(svd.u.as_ref().expect("asked for").nrows());
        right.rows_mut(0, q.len()).copy_from_slice(q);
        // d = d₀ + Z w: d₀ meets the constraints, w minimises along them.
        let first = svd.solve(&right, small).expect("both sides are there");
        let p = DVector::from_column_slice(p);
        let w = &self.inverse * self.basis.tr_mul(&(&p - &self.h * &first));
        let step = first + &self.basis * w;
        // Aᵀλ = p − H d, where variables are not held.
        let mut rest = p - &self.h * &step;
        (0..rest.len()).filter(|&i| self.held[i]).for_each(|i| rest[i] = 0.0);
        let (u, v) = (svd.u.as_ref().expect("asked for"), svd.v_t.as_ref().expect("asked for"));
        let scaled = (v * rest).zip_map(&svd.singular_values, |x, s| if s > small { x / s } else { 0.0 });
        d.copy_from_slice(step.as_slice());
        lambda.copy_from_slice((u * scaled).rows(0, lambda.len()).as_slice());
    }

    fn weak_directions(&self) -> &[Direction] {
        &self.weak
    }

    fn sizes(&self) -> (usize, usize) {
        (self.a.ncols(), self.a.nrows())
    }
}

fn dense() -> KktChoice {
    KktChoice::own(|nlp, _| Box::new(Dense::new(nlp)))
}

/// Full Gauss-Newton steps without bounds: enough where all states are measured.
#[derive(Debug)]
struct FullSteps;

impl Solver for FullSteps {
    fn solve(
        &self,
        problem: &Problem,
        from: &Beginning<'_>,
        _watch: &mut dyn FnMut(&Iteration) -> Control,
    ) -> Result<Solution, NotFinite> {
        let nlp: &dyn Nlp = problem.transcribed();
        let (n, m) = (nlp.n(), nlp.m());
        let (lower, upper) = nlp.bounds();
        let fixed: Vec<bool> = lower.iter().zip(&upper).map(|(l, u)| l == u).collect();
        let (mut gradient, mut c) = (vec![0.0; n], vec![0.0; m]);
        let mut hessian = vec![0.0; nlp.hessian_structure().len()];
        let mut jacobian = vec![0.0; nlp.jacobian_structure().len()];
        let (mut d, mut lambda) = (vec![0.0; n], vec![0.0; m]);
        let (mut xi, mut status, mut iterations) = (from.xi.to_vec(), Status::IterationLimit, 0);
        let mut kkt = dense().make(nlp, &[1.0]);
        while iterations < from.max_iterations {
            nlp.gradient(&xi, &mut gradient)?;
            nlp.constraints(&xi, &mut c)?;
            nlp.gauss_newton(&xi, 1.0, &mut hessian)?;
            nlp.jacobian(&xi, &mut jacobian)?;
            let entries = Entries { hessian: &hessian, jacobian: &jacobian };
            let Ok(factor) = kkt.factorize(&entries, Effort::FULL) else { break };
            if !factor.finish(&fixed, 0.0).is_positive() {
                status = Status::Unidentifiable;
                break;
            }
            let p: Vec<f64> = gradient.iter().map(|g| -g).collect();
            let q: Vec<f64> = c.iter().map(|c| -c).collect();
            factor.solve(&p, &q, &mut d, &mut lambda);
            xi.iter_mut().zip(&d).for_each(|(x, d)| *x += d);
            iterations += 1;
            if d.iter().zip(&xi).all(|(d, x)| d.abs() < 1e-10 * (1.0 + x.abs())) {
                status = Status::Converged;
                break;
            }
        }
        let mut solution = Solution::new(xi, lambda, status);
        solution.objective = nlp.objective(&solution.xi)?;
        solution.iterations = iterations;
        solution.kkt = dense(); // for the standard errors
        Ok(solution)
    }
}

pub fn main() -> Result<(), phugoid::Error> {
    let mut m = Model::new("mass on a spring");
    let (x, v) = (m.state("x", "m")?, m.state("v", "m/s")?);
    let (k, c) = (m.parameter(Parameter::new("k", 3.0))?, m.parameter(Parameter::new("c", 0.0))?);
    m.equation("x", v.clone())?;
    m.equation("v", -k * &x - c * &v)?;
    m.output("x", x, "m")?;
    m.output("v", v, "m/s")?;
    let t: Vec<f64> = (0..40).map(|i| 0.1 * f64::from(i)).collect();
    let noise = |t: f64| 0.005 * (1e5 * t).sin();
    let x = t.iter().map(|t| (-0.1 * t).exp() * (2.0 * t).cos() + noise(*t)).collect();
    let slope = |t: f64| -(-0.1 * t).exp() * (0.1 * (2.0 * t).cos() + 2.0 * (2.0 * t).sin());
    let v = t.iter().map(|t| slope(*t) + noise(t + 1.0)).collect();
    let run = [Experiment::new(&m, "release", t, [("x", x), ("v", v)])?];
    let known = Sigma::Known(0.005);
    let estimation = Estimation::new(&m, &run).noise("x", known.clone()).noise("v", known);

    let usual = estimation.clone().solve()?;
    let factorised = estimation.clone().solver(Settings::default().kkt(dense())).solve()?;
    let solved = estimation.own_solver(&FullSteps).solve()?;
    println!(
        "{usual}\nWith a factorisation of one's own:\n{factorised}\nWith a solver of one's own as well:\n{solved}"
    );
    for fit in [factorised, solved] {
        assert_eq!(fit.status, Status::Converged, "{}", fit.message);
        for name in ["k", "c"] {
            let (found, expected) = (&fit[name], &usual[name]);
            assert!((found.value - expected.value).abs() < 1e-3 * expected.std_error, "{name}");
            assert!((found.std_error / expected.std_error - 1.0).abs() < 1e-3, "{name}: {}", found.std_error);
        }
    }
    Ok(())
}
