//! Units in which steps and defects are of order one.

use crate::nlp::{Chains, Nlp};

/// Defects that sum to no more than this part of the unit of their state are none.
const SATISFIED: f64 = 1e-6;

/// Units of states, and of constraints: a defect is measured in that of its state, and so is a boundary
/// condition.
#[derive(Clone, Debug)]
pub(crate) struct Units {
    /// Those of the n_x states.
    pub states: Vec<f64>,
    /// Constraints in which they repeat.
    pub rows: usize,
    boundary: Vec<f64>,
}

impl Units {
    pub fn new(nlp: &dyn Nlp, xi: &[f64]) -> Units {
        let states = state_units(nlp, xi);
        let conditions = nlp.chains().into_iter().flat_map(Chains::boundary_states);
        let boundary: Vec<f64> = conditions.map(|s| states[s.0]).collect();
        Units { rows: nlp.m() - boundary.len(), states, boundary }
    }

    /// The unit of each constraint.
    pub fn each(&self) -> impl Iterator<Item = &f64> {
        self.states.iter().cycle().take(self.rows).chain(&self.boundary)
    }

    /// Sizes of variables before any derivative is known: zeros for the border of chains, and for a program without
    /// chains the units of the variables, or their values where these are greater.
    pub fn first_sizes(&self, nlp: &dyn Nlp, xi: &[f64]) -> Vec<f64> {
        match nlp.chains() {
            Some(chains) => vec![0.0; chains.border],
            None => self.states.iter().zip(xi).map(|(unit, x)| unit.max(x.abs())).collect(),
        }
    }

    /// Sets the sizes of border variables that are still zero, from the derivatives at ξ: the change that moves a defect by
    /// its unit, or an output by its noise, in the root mean square, or the value where that is greater. The size of a
    /// variable without influence at ξ stays zero.
    pub fn size_border(
        &self,
        nlp: &dyn Nlp,
        xi: &[f64],
        (jacobian, hessian): (&[f64], &[f64]),
        sizes: &mut [f64],
    ) {
        if !sizes.contains(&0.0) {
            return;
        }
        let mut influence = vec![0.0f64; sizes.len()];
        let s = nlp.jacobian_structure();
        for ((&row, &column), a) in s.rows.iter().zip(&s.columns).zip(jacobian) {
            if let Some(sum) = influence.get_mut(column as usize) {
                *sum = sum.hypot(a / self.of(row as usize));
            }
        }
        let s = nlp.hessian_structure();
        for ((&row, &column), h) in s.rows.iter().zip(&s.columns).zip(hessian) {
            if let Some(sum) = influence.get_mut(row as usize).filter(|_| row == column) {
                *sum = sum.hypot(h.abs().sqrt());
            }
        }
        let root = (self.rows.max(1) as f64).sqrt();
        for ((size, influence), x) in sizes.iter_mut().zip(influence).zip(xi) {
            let found = root / influence;
            if *size == 0.0 && found.is_finite() {
                *size = found.max(x.abs());
            }
        }
    }

    /// The unit of a constraint.
    pub fn of(&self, row: usize) -> f64 {
        if row < self.rows { self.states[row % self.states.len()] } else { self.boundary[row - self.rows] }
    }
}

/// What the states do along the path ξ: their spread at all points, else their size. A state whose path is zero, such
/// as one that starts there because nothing measures it, has the size that its equations ask for, else 1. One for each of
/// the n_x states; a defect is measured in that of its state. Where the program has neither chains nor constraints, as in
/// single shooting, one for each variable: the change that moves an output by its noise. Else a single 1.
pub fn state_units(nlp: &dyn Nlp, xi: &[f64]) -> Vec<f64> {
    let Some(chains) = nlp.chains() else {
        return if nlp.m() == 0 { units_from_curvature(nlp, xi) } else { vec![1.0] };
    };
    let n = chains.n_x;
    let states = &xi[chains.border..];
    let count = (states.len() / n) as f64;
    let unit = |i: usize| {
        let values = || states.iter().skip(i).step_by(n);
        // About the first value: of a path that stands still nothing is left, where a mean of many points has
        // rounding errors that would be taken for motion.
        let first = states[i];
        let mean = first + values().map(|x| x - first).sum::<f64>() / count;
        let size = values().fold(0.0f64, |a, x| a.max(x.abs()));
        // Divided by the size, so that squares neither overflow nor underflow, whatever the unit.
        let spread = (values().map(|x| ((x - mean) / size).powi(2)).sum::<f64>() / count).sqrt();
        // A spread of rounding errors is none.
        if spread > 1e-12 { spread * size } else { size }
    };
    let mut units: Vec<f64> = (0..n).map(unit).collect();
    if units.contains(&0.0) {
        sizes_from_equations(nlp, xi, chains, &mut units);
    }
    units
}

/// 1/√H_ii of each variable, H the Gauss-Newton Hessian; the size of a variable without curvature.
fn units_from_curvature(nlp: &dyn Nlp, xi: &[f64]) -> Vec<f64> {
    let mut hessian = vec![0.0; nlp.hessian_structure().len()];
    let mut units: Vec<f64> = xi.iter().map(|x| if *x == 0.0 { 1.0 } else { x.abs() }).collect();
    if nlp.gauss_newton(xi, 1.0, &mut hessian).is_ok() {
        let s = nlp.hessian_structure();
        let mut diagonal = vec![0.0; nlp.n()];
        for ((&row, _), h) in s.rows.iter().zip(&s.columns).zip(&hessian).filter(|((r, c), _)| r == c) {
            diagonal[row as usize] += h;
        }
        for (unit, h) in units.iter_mut().zip(diagonal).filter(|(_, h)| *h > 0.0 && h.is_finite()) {
            *unit = h.sqrt().recip();
        }
    }
    units
}

/// Replaces units that are zero. The defects of a state i whose motion is known show what a state j, whose path is zero,
/// should have done: Σ|c_i| / Σ|∂c_i/∂x_j|. Its own defects, of m in all, show what it should have done, too: Σ|c_j|/√m,
/// which is more where segments are long. The unit is the geometric mean of both, one of them, or else 1.
fn sizes_from_equations(nlp: &dyn Nlp, xi: &[f64], chains: &Chains, units: &mut [f64]) {
    let n = chains.n_x;
    let rows = nlp.m() - chains.boundary_states().count();
    let (mut c, mut jacobian) = (vec![0.0; nlp.m()], vec![0.0; nlp.jacobian_structure().len()]);
    let finite = nlp.constraints(xi, &mut c).is_ok() && nlp.jacobian(xi, &mut jacobian).is_ok();
    let (mut defects, mut slopes) = (vec![0.0; n], vec![0.0; n * n]);
    if finite {
        c[..rows].iter().enumerate().for_each(|(row, c)| defects[row % n] += c.abs());
        let s = nlp.jacobian_structure();
        for ((&row, &column), a) in s.rows.iter().zip(&s.columns).zip(&jacobian) {
            if let Some(state) =
                (column as usize).checked_sub(chains.border).filter(|_| (row as usize) < rows)
            {
                slopes[row as usize % n * n + state % n] += a.abs();
            }
        }
    }
    let zero: Vec<usize> = (0..n).filter(|&j| units[j] == 0.0).collect();
    // Those that follow from known ones may tell of others in turn.
    for _ in 0..n {
        let known = units.to_vec();
        for j in (0..n).filter(|&j| known[j] == 0.0) {
            // Where the path satisfies the equation of i, rounding errors are left, which say nothing of j.
            let tells = |i: &usize| known[*i] > 0.0 && defects[*i] > SATISFIED * known[*i];
            let from = (0..n).filter(tells).map(|i| defects[i] / slopes[i * n + j]);
            let least = from.filter(|size| *size > 0.0 && size.is_finite()).fold(f64::INFINITY, f64::min);
            units[j] = if least.is_finite() { least } else { 0.0 };
        }
    }
    // What a state's own defects add up to, as in a random walk: their signs are not known.
    let root = (rows.max(1) as f64).sqrt();
    for j in zero {
        let own = defects[j] / root;
        units[j] = match (units[j] > 0.0, own > 0.0) {
            (true, true) => (units[j] * own).sqrt(),
            (false, false) => 1.0,
            _ => units[j].max(own),
        };
    }
}
