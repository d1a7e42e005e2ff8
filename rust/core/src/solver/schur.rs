//! The objective as a function of the variables that a run held, all others eliminated.

use super::newton::Newton;
use super::newton_system::NewtonSystem;
use super::program::Program;
use crate::index::VariableId;
use crate::linalg::Entries;
use crate::nlp::Nlp;

/// The least value V of φ under the constraints for given values of some variables, with its derivatives with respect to these.
/// The gradient is that of the Lagrangian; the Hessian is the Schur complement of all other variables and of the multipliers in
/// the KKT matrix.
#[derive(Clone, Debug)]
pub(crate) struct Schur {
    /// V, the Lagrangian at the end of the run: what defects are left enters to second order.
    pub value: f64,
    /// ∂V, one for each of the variables that were held.
    pub gradient: Vec<f64>,
    /// ∂²V, row-major.
    pub hessian: Vec<f64>,
}

impl Newton<'_> {
    /// Returns V and its derivatives with respect to variables that are held, where the run ended. The gradient is evaluated
    /// there; the Hessian is that of the last factorisation, which was a step before, or, if asked for, the one of Gauss and
    /// Newton with the derivatives of the constraints there. `None` where something is not finite.
    pub fn schur(&mut self, held: &[VariableId], gauss_newton: bool) -> Option<Schur> {
        let Newton { program, iterate, system, .. } = self;
        iterate.evaluate(program).ok()?;
        if gauss_newton {
            iterate.gauss_newton(program).ok()?;
            system.kkt.factor()?.replace_hessian(&iterate.entries()).ok()?;
        }
        let pull: f64 = iterate.multipliers.iter().zip(&iterate.point.c).map(|(l, c)| l * c).sum();
        let entries = Entries { hessian: &iterate.hessian, jacobian: &iterate.jacobian };
        let sides = (&iterate.gradient[..], &iterate.point.c[..]);
        let (gradient, hessian) = system.schur(program, &entries, sides, held)?;
        let value = iterate.point.objective + pull;
        let finite = value.is_finite() && gradient.iter().chain(&hessian).all(|v| v.is_finite());
        finite.then_some(Schur { value, gradient, hessian })
    }
}

/// Gradient and Hessian, row-major.
type Derivatives = (Vec<f64>, Vec<f64>);

impl NewtonSystem {
    /// Returns gradient and Hessian of the objective with respect to held variables, from the gradient and the constraints at
    /// the iterate and the factor of the matrix.
    fn schur(
        &mut self,
        program: &Program<'_>,
        entries: &Entries<'_>,
        (gradient, c): (&[f64], &[f64]),
        of: &[VariableId],
    ) -> Option<Derivatives> {
        let NewtonSystem { kkt, active, damping, p, q, .. } = self;
        let factor = kkt.factor()?;
        if !factor.finish(active.held(), damping.shift()).is_positive() {
            return None;
        }
        p.iter_mut().zip(gradient).for_each(|(p, g)| *p = -g);
        q.iter_mut().zip(c).for_each(|(q, c)| *q = -c);
        let count = factor.reduce(p, q);
        let k = of.len();
        let mut hessian = vec![0.0; k * k];
        if of.iter().all(|i| i.0 < count) {
            let (mut to, mut d) = (vec![0.0; count], vec![0.0; count]);
            let (mut at_rest, mut forces) = (vec![0.0; count], vec![0.0; count]);
            factor.solve_reduced(&to, &mut d, &mut at_rest);
            for (row, &i) in hessian.chunks_exact_mut(k).zip(of) {
                to[i] = 1.0;
                factor.solve_reduced(&to, &mut d, &mut forces);
                to[i] = 0.0;
                row.iter_mut().zip(of).for_each(|(h, &j)| *h = at_rest[j.0] - forces[j.0]);
            }
            return Some((of.iter().map(|&j| -at_rest[j.0]).collect(), symmetric(hessian, k)));
        }
        // The factorisation has no such variables: by one solution for each.
        let (mut d, mut lambda) = (vec![0.0; p.len()], vec![0.0; q.len()]);
        factor.solve(p, q, &mut d, &mut lambda);
        let (mut of_d, mut of_lambda) = (vec![0.0; p.len()], vec![0.0; p.len()]);
        multiply(program.nlp, entries, (&d, &lambda), (&mut of_d, &mut of_lambda), &mut []);
        let found = of.iter().map(|&j| gradient[j.0] + of_d[j.0] + of_lambda[j.0]).collect();
        for (row, &i) in hessian.chunks_exact_mut(k).zip(of) {
            d.fill(0.0);
            d[i.0] = 1.0;
            lambda.fill(0.0);
            multiply(program.nlp, entries, (&d, &lambda), (p, &mut of_lambda), q);
            p.iter_mut().chain(q.iter_mut()).for_each(|v| *v = -*v);
            factor.solve(p, q, &mut d, &mut lambda);
            d[i.0] += 1.0;
            multiply(program.nlp, entries, (&d, &lambda), (&mut of_d, &mut of_lambda), &mut []);
            row.iter_mut().zip(of).for_each(|(h, &j)| *h = of_d[j.0] + of_lambda[j.0]);
        }
        Some((found, symmetric(hessian, k)))
    }
}

/// Sets the three products H d, Aᵀλ and, unless it is empty, A d.
fn multiply(
    nlp: &dyn Nlp,
    entries: &Entries<'_>,
    (d, lambda): (&[f64], &[f64]),
    (of_h, of_transposed): (&mut [f64], &mut [f64]),
    of_a: &mut [f64],
) {
    of_h.fill(0.0);
    of_transposed.fill(0.0);
    of_a.fill(0.0);
    let s = nlp.hessian_structure();
    for ((&r, &c), h) in s.rows.iter().zip(&s.columns).zip(entries.hessian) {
        let (r, c) = (r as usize, c as usize);
        of_h[r] += h * d[c];
        if r != c {
            of_h[c] += h * d[r];
        }
    }
    let s = nlp.jacobian_structure();
    for ((&r, &c), a) in s.rows.iter().zip(&s.columns).zip(entries.jacobian) {
        let (r, c) = (r as usize, c as usize);
        of_transposed[c] += a * lambda[r];
        if let Some(of_a) = of_a.get_mut(r) {
            *of_a += a * d[c];
        }
    }
}

/// The mean of a matrix and its transpose.
fn symmetric(mut matrix: Vec<f64>, k: usize) -> Vec<f64> {
    for i in 0..k {
        for j in 0..i {
            let mean = 0.5 * (matrix[i * k + j] + matrix[j * k + i]);
            (matrix[i * k + j], matrix[j * k + i]) = (mean, mean);
        }
    }
    matrix
}
