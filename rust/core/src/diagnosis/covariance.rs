//! Covariance of the estimates, and their distance from the optimum, from one factorisation.

use super::SLIGHT;
use crate::linalg::kkt_for;
use crate::nlp::{Nlp, NotFinite};
use crate::solver::state_units;

/// What the Newton system at a point tells about some of the variables.
#[derive(Clone, Debug, PartialEq)]
pub struct Information {
    /// Covariance of the k variables asked for, row-major k × k. Rows and columns of variables that
    /// the data do not determine are NaN.
    pub covariance: Vec<f64>,
    /// The Newton step that is left (k): how far they are from the optimum. NaN as above.
    pub step: Vec<f64>,
    /// Groups of variables in a direction in which the likelihood has no curvature: they are without
    /// influence, or trade off.
    pub undetermined: Vec<Vec<usize>>,
    /// Whether the likelihood even grows in some direction: not a maximum.
    pub saddle: bool,
}

/// Why there is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoInformation {
    /// A derivative is not finite there, or the constraints depend on each other.
    NotFinite,
    /// It was told not to go on.
    Stopped,
}

impl From<NotFinite> for NoInformation {
    fn from(_: NotFinite) -> Self {
        Self::NotFinite
    }
}

/// Parts of a weak direction below this, relative to the greatest, do not count.
const PART: f64 = 0.1;

/// The inverse of the KKT matrix [H Aᵀ; A 0], H the Hessian of the Lagrangian, has Z (ZᵀHZ)⁻¹ Zᵀ for its
/// first block, Z a basis of the null space of A: the inverse of the observed information, the states
/// following their equations. Variables `held` (fixed, at a bound) do not vary.
///
/// `go_on` is asked between its parts, which take long where there are many states.
///
/// # Errors
/// [`NoInformation::NotFinite`] when a derivative is not finite there, or the constraints depend on each other;
/// [`NoInformation::Stopped`] when it was told not to go on.
pub fn information(
    nlp: &dyn Nlp,
    xi: &[f64],
    lambda: &[f64],
    wanted: &[usize],
    held: &[usize],
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Information, NoInformation> {
    let mut unless_stopped = || if go_on() { Ok(()) } else { Err(NoInformation::Stopped) };
    let (n, m, k) = (nlp.n(), nlp.m(), wanted.len());
    let mut hessian = vec![0.0; nlp.hessian_structure().len()];
    let mut jacobian = vec![0.0; nlp.jacobian_structure().len()];
    let (mut gradient, mut c) = (vec![0.0; n], vec![0.0; m]);
    nlp.hessian(xi, 1.0, lambda, &mut hessian)?;
    nlp.jacobian(xi, &mut jacobian)?;
    nlp.gradient(xi, &mut gradient)?;
    nlp.constraints(xi, &mut c)?;
    unless_stopped()?;
    let mut kkt = kkt_for(nlp, &state_units(nlp, xi));
    kkt.set_refinement(true);
    kkt.factorize(&hessian, &jacobian).map_err(|_| NoInformation::NotFinite)?;
    unless_stopped()?;
    let mut holding = vec![false; n];
    held.iter().for_each(|&i| holding[i] = true);

    let mut undetermined = Vec::new();
    let mut saddle = false;
    let mut found = kkt.finish(&holding, 0.0);
    // What the data leave open is set aside, one variable of each direction at a time.
    while !found.is_positive() {
        saddle |= found.negative > 0;
        let mut next: Vec<usize> = Vec::new();
        for direction in kkt.weak_directions() {
            let most = direction.first().map_or(0.0, |x| x.1.abs());
            let part = direction.iter().filter(|x| x.1.abs() > PART * most);
            let mut part: Vec<usize> = part.map(|x| x.0).collect();
            next.extend(part.first());
            part.sort_unstable();
            undetermined.push(part);
        }
        let border = nlp.chains().map_or(n, |c| c.border);
        let mut any = false;
        for i in next.into_iter().filter(|&i| i < border) {
            any |= !holding[i];
            holding[i] = true;
        }
        if !any {
            // Initial states cannot be set aside. A curvature that is nothing beside that of the others
            // keeps them where they are.
            found = kkt.finish(&holding, SLIGHT);
            break;
        }
        found = kkt.finish(&holding, 0.0);
    }

    if !found.is_positive() {
        let nothing = vec![f64::NAN; k * k];
        return Ok(Information { covariance: nothing, step: vec![f64::NAN; k], undetermined, saddle });
    }
    unless_stopped()?;
    let mut covariance = vec![0.0; k * k];
    kkt.covariance(wanted, &mut covariance);
    gradient.iter_mut().for_each(|g| *g = -*g);
    let s = nlp.jacobian_structure();
    for ((&r, &column), a) in s.rows.iter().zip(&s.columns).zip(&jacobian) {
        gradient[column as usize] -= a * lambda[r as usize];
    }
    c.iter_mut().for_each(|c| *c = -*c);
    let (mut d, mut more) = (vec![0.0; n], vec![0.0; m]);
    kkt.solve(&gradient, &c, &mut d, &mut more);
    let mut step: Vec<f64> = wanted.iter().map(|&i| d[i]).collect();
    for i in 0..k {
        for j in 0..i {
            let mean = 0.5 * (covariance[i * k + j] + covariance[j * k + i]);
            (covariance[i * k + j], covariance[j * k + i]) = (mean, mean);
        }
    }
    for (i, variable) in wanted.iter().enumerate() {
        if undetermined.iter().any(|d| d.contains(variable)) {
            step[i] = f64::NAN;
            for j in 0..k {
                (covariance[i * k + j], covariance[j * k + i]) = (f64::NAN, f64::NAN);
            }
        }
    }
    Ok(Information { covariance, step, undetermined, saddle })
}
