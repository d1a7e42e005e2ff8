//! Covariance of the estimates, and their distance from the optimum, from one factorisation.

use super::SLIGHT;
use crate::dense::symmetrise;
use crate::index::VariableId;
use crate::interrupt::current;
use crate::linalg::{Effort, Entries, KktChoice, KktError};
use crate::nlp::{Nlp, NotFinite};
use crate::solver::Units;

/// The information of the Newton system at a point about some of the variables.
#[derive(Clone, Debug, PartialEq)]
pub struct Information {
    /// Covariance of the k variables asked for, row-major k × k. Rows and columns of variables that
    /// the data do not determine are NaN.
    pub covariance: Vec<f64>,
    /// The Newton step that is left (k): how far they are from the optimum. NaN as above.
    pub step: Vec<f64>,
    /// Groups of variables in a direction in which the likelihood has no curvature: they are without
    /// influence, or trade off.
    pub undetermined: Vec<Vec<VariableId>>,
    /// Whether the likelihood even grows in some direction: not a maximum.
    pub saddle: bool,
}

/// The reason why there is no information.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoInformation {
    /// A derivative is not finite there.
    #[error("a derivative of the model is not finite")]
    NotFinite,
    /// The Newton system cannot be factorised: constraints that depend on each other, above all.
    #[error(transparent)]
    Singular(KktError),
    /// The interrupt stopped it.
    #[error("there was no time left")]
    Stopped,
}

impl From<NotFinite> for NoInformation {
    fn from(_: NotFinite) -> Self {
        Self::NotFinite
    }
}

/// Parts of a weak direction below this, relative to the greatest, do not count.
const PART: f64 = 0.1;
/// A variable trades off too when it moves by more than this part of its standard error while the one that moves most,
/// in standard errors of its own, moves by one. So small a part is no trade, it is rounding.
const MOVES: f64 = 1e-3;
/// The part of a variable's variance that the variables before it leave, below which it is one with them.
const LEFT: f64 = 1e-11;
/// The factor by which the slight curvature is raised to see what depends on it.
const STRONGER: f64 = 100.0;
/// A parameter with a standard error below this part of it is known, whatever others are.
const KNOWN: f64 = 0.1;

/// The inverse of the KKT matrix [H Aᵀ; A 0], H the Hessian of the Lagrangian, has Z (ZᵀHZ)⁻¹ Zᵀ for its
/// first block, Z a basis of the null space of A: the inverse of the observed information, the states
/// following their equations. Variables `held` (fixed, at a bound) do not vary.
///
/// # Errors
/// [`NoInformation::NotFinite`] when a derivative is not finite there, [`NoInformation::Singular`] when the constraints
/// depend on each other, [`NoInformation::Stopped`] when the interrupt stopped it.
pub fn information(
    nlp: &dyn Nlp,
    xi: &[f64],
    lambda: &[f64],
    wanted: &[VariableId],
    held: &[VariableId],
    kkt: &KktChoice,
) -> Result<Information, NoInformation> {
    let found = informed(nlp, xi, lambda, wanted, held, kkt);
    // Whatever was found after a stop is none.
    if current().stops() { Err(NoInformation::Stopped) } else { found }
}

fn informed(
    nlp: &dyn Nlp,
    xi: &[f64],
    lambda: &[f64],
    wanted: &[VariableId],
    held: &[VariableId],
    kkt: &KktChoice,
) -> Result<Information, NoInformation> {
    let interrupt = current();
    let unless_stopped = || if interrupt.stops() { Err(NoInformation::Stopped) } else { Ok(()) };
    unless_stopped()?;
    let (n, m, k) = (nlp.n(), nlp.m(), wanted.len());
    let mut hessian = vec![0.0; nlp.hessian_structure().len()];
    let mut jacobian = vec![0.0; nlp.jacobian_structure().len()];
    let (mut gradient, mut c) = (vec![0.0; n], vec![0.0; m]);
    nlp.hessian(xi, 1.0, lambda, &mut hessian)?;
    nlp.jacobian(xi, &mut jacobian)?;
    nlp.gradient(xi, &mut gradient)?;
    nlp.constraints(xi, &mut c)?;
    unless_stopped()?;
    let units = Units::new(nlp, xi);
    let mut kkt = kkt.take_or_make(nlp, &units.states);
    let entries = Entries { hessian: &hessian, jacobian: &jacobian };
    let kkt = kkt.factorize(&entries, Effort::FULL).map_err(NoInformation::Singular)?;
    unless_stopped()?;
    let mut holding = vec![false; n];
    held.iter().for_each(|i| holding[i.0] = true);

    let border = nlp.chains().map_or(n, |c| c.border);
    let mut undetermined = Vec::new();
    let mut saddle = false;
    let mut leads = Vec::new(); // variables set aside, and their groups
    let mut found = kkt.finish(&holding, 0.0);
    let mut kept = false; // by a slight curvature
    // What the data leave open is set aside, one variable of each direction at a time.
    while !found.is_positive() {
        unless_stopped()?;
        saddle |= found.negative > 0;
        let mut next: Vec<(VariableId, usize)> = Vec::new(); // a variable, and its group
        for direction in kkt.weak_directions() {
            let most = direction.first().map_or(0.0, |x| x.1.abs());
            let part = direction.iter().filter(|x| x.1.abs() > PART * most);
            let mut part: Vec<VariableId> = part.map(|x| x.0).collect();
            next.extend(part.first().map(|&i| (i, undetermined.len())));
            part.sort_unstable();
            undetermined.push(part);
        }
        let mut any = false;
        for (i, group) in next.into_iter().filter(|(i, _)| i.0 < border) {
            if !holding[i.0] {
                (any, holding[i.0]) = (true, true);
                leads.push((i, group));
            }
        }
        if !any {
            // Initial states cannot be set aside. A curvature that is nothing beside that of the others
            // keeps them where they are.
            found = kkt.finish(&holding, SLIGHT);
            kept = true;
            break;
        }
        found = kkt.finish(&holding, 0.0);
    }

    let mut covariance = vec![0.0; k * k];
    while found.is_positive() {
        unless_stopped()?;
        kkt.covariance(wanted, &mut covariance);
        // Rounding may leave a little curvature where there is none: such a trade is set aside as others are.
        let Some((lead, trade)) = confounded(&covariance, wanted, xi, nlp.n_parameters()) else {
            break;
        };
        holding[lead.0] = true;
        leads.push((lead, undetermined.len()));
        undetermined.push(trade);
        found = kkt.finish(&holding, if kept { SLIGHT } else { 0.0 });
    }

    if !found.is_positive() {
        let nothing = vec![f64::NAN; k * k];
        return Ok(Information { covariance: nothing, step: vec![f64::NAN; k], undetermined, saddle });
    }
    if kept && kkt.finish(&holding, STRONGER * SLIGHT).is_positive() {
        // A parameter whose variance follows the slight curvature has none of its own.
        let mut other = vec![0.0; k * k];
        kkt.covariance(wanted, &mut other);
        let follows =
            |i: usize| wanted[i].0 < nlp.n_parameters() && other[i * k + i] < 0.5 * covariance[i * k + i];
        let alone: Vec<VariableId> = (0..k).filter(|&i| follows(i)).map(|i| wanted[i]).collect();
        let named: Vec<VariableId> = undetermined.iter().flatten().copied().collect();
        undetermined.extend(alone.into_iter().filter(|i| !named.contains(i)).map(|i| vec![i]));
        kkt.finish(&holding, SLIGHT);
    }
    gradient.iter_mut().for_each(|g| *g = -*g);
    let s = nlp.jacobian_structure();
    for ((&r, &column), a) in s.rows.iter().zip(&s.columns).zip(&jacobian) {
        gradient[column as usize] -= a * lambda[r as usize];
    }
    c.iter_mut().for_each(|c| *c = -*c);
    let (mut d, mut more) = (vec![0.0; n], vec![0.0; m]);
    kkt.solve(&gradient, &c, &mut d, &mut more);
    let mut step: Vec<f64> = wanted.iter().map(|&i| d[i]).collect();
    symmetrise(&mut covariance, k);
    let mut sizes = vec![0.0; border];
    units.size_border(nlp, xi, (&jacobian, &hessian), &mut sizes);
    let sigmas: Vec<f64> = (0..k).map(|i| covariance[i * k + i].sqrt()).collect();
    for (lead, group) in leads {
        let group: &mut Vec<VariableId> = &mut undetermined[group];
        let (p, q) = column(nlp, &hessian, &jacobian, lead);
        kkt.solve(&p, &q, &mut d, &mut more);
        group.extend(companions(&d, wanted, &sigmas, if sizes[lead] > 0.0 { sizes[lead] } else { 1.0 }));
        group.sort_unstable();
        group.dedup();
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

/// The column of a variable in the KKT matrix, its sign changed: the right-hand side of the response to a unit change.
fn column(nlp: &dyn Nlp, hessian: &[f64], jacobian: &[f64], variable: VariableId) -> (Vec<f64>, Vec<f64>) {
    let (mut p, mut q) = (vec![0.0; nlp.n()], vec![0.0; nlp.m()]);
    let s = nlp.hessian_structure();
    for ((&r, &c), h) in s.rows.iter().zip(&s.columns).zip(hessian) {
        let (r, c) = (r as usize, c as usize);
        if r == variable.0 {
            p[c] -= h;
        } else if c == variable.0 {
            p[r] -= h;
        }
    }
    let s = nlp.jacobian_structure();
    for ((&r, &c), a) in s.rows.iter().zip(&s.columns).zip(jacobian) {
        if c as usize == variable.0 {
            q[r as usize] -= a;
        }
    }
    (p, q)
}

/// Returns which variables are confounded with one that is set aside: `d` is how far all move when it moves by one,
/// and it may move by `far`. Their standard errors `sigmas`, of the variables `wanted`, are those with it fixed,
/// which say nothing of where the variables are.
fn companions(d: &[f64], wanted: &[VariableId], sigmas: &[f64], far: f64) -> Vec<VariableId> {
    let moves = wanted.iter().zip(sigmas).filter(|(_, s)| **s > 0.0).map(|(&i, s)| (i, d[i].abs() / s));
    let moves: Vec<(VariableId, f64)> = moves.collect();
    let most = moves.iter().fold(0.0f64, |a, m| a.max(m.1));
    if most * far < MOVES {
        return Vec::new(); // it moves nothing: it is without influence
    }
    moves.into_iter().filter(|m| m.1 > MOVES * most).map(|m| m.0).collect()
}

/// The first parameter (of `n`) that is a linear combination of those before it, by the covariance (k × k of
/// `wanted`): returns the one with the greatest part in the combination, and all with a part. A parameter and an
/// initial state are not compared: those of an unstable motion are collinear up to rounding, and yet well determined.
fn confounded(
    covariance: &[f64],
    wanted: &[VariableId],
    xi: &[f64],
    n: usize,
) -> Option<(VariableId, Vec<VariableId>)> {
    let k = wanted.len();
    let known: Vec<usize> = (0..k).filter(|&i| wanted[i].0 < n && covariance[i * k + i] > 0.0).collect();
    // Rows of the Cholesky factor of the correlation matrix.
    let mut l: Vec<Vec<f64>> = Vec::with_capacity(known.len());
    for &i in &known {
        let mut row = Vec::with_capacity(l.len() + 1);
        for (before, &j) in l.iter().zip(&known) {
            let entry = covariance[i * k + j] / (covariance[i * k + i] * covariance[j * k + j]).sqrt();
            let sum: f64 = row.iter().zip(before).map(|(a, b): (&f64, &f64)| a * b).sum();
            row.push((entry - sum) / before[row.len()]);
        }
        let left = 1.0 - row.iter().map(|x| x * x).sum::<f64>();
        if left < LEFT {
            // What of those before it is left out of it: Lᵀ v = row.
            let entries = row.clone();
            for j in (0..row.len()).rev() {
                row[j] /= l[j][j];
                let v = row[j];
                (0..j).for_each(|c| row[c] -= l[j][c] * v);
            }
            row.push(1.0);
            let most = row.iter().fold(0.0f64, |a, v| a.max(v.abs()));
            let parts = row.iter().zip(&known).filter(|(v, _)| v.abs() > PART * most);
            let parts: Vec<(f64, VariableId)> = parts.map(|(v, &i)| (v.abs(), wanted[i])).collect();
            let lead = parts.iter().max_by(|a, b| a.0.total_cmp(&b.0))?.1;
            let error =
                |v: VariableId| covariance[(0..k).find(|&i| wanted[i] == v).map_or(0, |i| i * k + i)].sqrt();
            if parts.iter().all(|&(_, v)| error(v) < KNOWN * xi[v].abs()) {
                // A combination is known far better than they are, as by an output without noise; but so are they.
                l.push([entries, vec![left.max(f64::EPSILON).sqrt()]].concat());
                continue;
            }
            let mut trade: Vec<VariableId> = parts.into_iter().map(|p| p.1).collect();
            trade.sort_unstable();
            return Some((lead, trade));
        }
        row.push(left.sqrt());
        l.push(row);
    }
    None
}
