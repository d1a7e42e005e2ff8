//! The Newton system of any program with few degrees of freedom, by its null space.
//!
//! ```text
//!   H, A  →  basis of A      →  Z              →  ZᵀHZ        →  held, shifted
//!            sparse LU of Aᵀ    A Z = 0, dense    small, dense   Cholesky, or eigenvalues
//! ```
//!
//! An ordinary differential equation leaves little to choose: parameters and initial states. So the null
//! space of A has few dimensions, k = n − m, and everything that matters happens there. The basis needs
//! A alone; row exchanges keep it stable, whatever the system does. The reduced Hessian is formed
//! explicitly: its inertia *is* the answer, without a count of pivots of the whole, in which zeros
//! drown. Holding and shifting touch it alone, which makes `finish` cheap. The zero block is never
//! touched, and nothing is regularised.
//!
//! What else there is has one of these faults. LDLᵀ with pivots in a fixed order, or exchanged within
//! supernodes only (faer's `intranode_lblt`), meets zeros on the diagonal of the zero block, and grows
//! without limit in an unstable system; its inertia is then that of another matrix. Sparse LU of the
//! whole KKT matrix solves it but knows no inertia, and dense parameters make it slow. (faer's LU takes
//! square matrices only and leaves no choice of pivots, so the one of Aᵀ is our own; the order, and all
//! dense work, is faer's.)
//!
//! The price: work grows with n k² and storage with n k. With thousands of degrees of freedom, choose
//! another method.

mod basis;
mod holding;
mod order;
mod products;
mod reduced;
mod rows;

use super::{Curvature, Direction, Effort, Entries, Factor, KktError, KktSolver};
use crate::index::{ConstraintId, VariableId};
use crate::interrupt::current;
use crate::nlp::Structure;
use crate::tape::lanes::all_finite;
use basis::Basis;
use reduced::Reduced;
use rows::{Rows, Triplet};

/// Most steps of refinement.
const REFINEMENTS: usize = 3;
/// Residuals of this part of their terms are rounding errors.
const ROUNDING: f64 = 4.0 * f64::EPSILON;
/// Terms of less than this part of the greatest of the solution are rounding errors.
const NOTHING: f64 = 1e3 * f64::EPSILON;
/// Variables with less than this part of the greatest in a weak direction are not named.
const MINOR: f64 = 0.1;

/// Factorises the Newton system of any structure; see the [module](self).
///
/// The diagonal that `finish` shifts by is |H_ii|, and 1 where that is zero, in units of the variables;
/// see [`SparseKkt::shift_diagonal`]. It is added to H, so that Zᵀ(H + shift D)Z is what must be positive.
///
/// Held variables may be any. Where the constraints, with others that are held, determine one already, it
/// cannot be held as well: the KKT matrix is singular. `finish` then counts a zero for it and names it
/// alone as a weak direction, and `solve` leaves it where the constraints want it.
#[derive(Debug)]
pub struct SparseKkt {
    n: usize,
    m: usize,
    scale: Vec<f64>,
    row_scale: Vec<f64>,
    /// H, both triangles, and A, in units.
    h: Rows,
    a: Rows,
    basis: Basis,
    reduced: Reduced,
    /// D.
    diagonal: Vec<f64>,
    is_assembled: bool,
    held: Vec<bool>,
    shift: f64,
    weak: Vec<Direction>,
    /// Right-hand side, solution, correction, residual in units.
    right: System,
    solution: System,
    correction: System,
    rest: System,
    g: Vec<f64>,
    target: Vec<f64>,
    zeros: Vec<f64>,
}

/// A vector of the system.
#[derive(Clone, Debug)]
struct System {
    d: Vec<f64>,
    lambda: Vec<f64>,
}

impl System {
    fn new(n: usize, m: usize) -> System {
        System { d: vec![0.0; n], lambda: vec![0.0; m] }
    }

    fn add(&mut self, other: &System, factor: f64) {
        self.d.iter_mut().zip(&other.d).for_each(|(x, y)| *x += factor * y);
        self.lambda.iter_mut().zip(&other.lambda).for_each(|(x, y)| *x += factor * y);
    }
}

impl SparseKkt {
    /// Prepares for `n` variables and `m` constraints with the lower triangle of H and A at the places of
    /// `hessian` and `jacobian`. `scale` (n) holds the units of the variables, `row_scale` (m) those of the
    /// constraints: in these, both are of order one. All are positive.
    pub fn new(
        n: usize,
        m: usize,
        hessian: &Structure,
        jacobian: &Structure,
        scale: &[f64],
        row_scale: &[f64],
    ) -> SparseKkt {
        assert_eq!((scale.len(), row_scale.len()), (n, m), "one unit for each variable and constraint");
        let mut symmetric = Vec::with_capacity(2 * hessian.len());
        for (number, (&row, &column)) in hessian.rows.iter().zip(&hessian.columns).enumerate() {
            let factor = scale[row as usize] * scale[column as usize];
            let number = number as u32;
            symmetric.push(Triplet { row, column, number, factor });
            if row != column {
                symmetric.push(Triplet { row: column, column: row, number, factor });
            }
        }
        let places = jacobian.rows.iter().zip(&jacobian.columns).enumerate();
        let jacobian = places
            .map(|(number, (&row, &column))| {
                let factor = scale[column as usize] / row_scale[row as usize];
                Triplet { row, column, number: number as u32, factor }
            })
            .collect();
        let a = Rows::new(m, jacobian);
        let system = System::new(n, m);
        SparseKkt {
            n,
            m,
            scale: scale.to_vec(),
            row_scale: row_scale.to_vec(),
            h: Rows::new(n, symmetric),
            basis: Basis::new(n, &a),
            a,
            reduced: Reduced::default(),
            diagonal: vec![1.0; n],
            is_assembled: false,
            held: vec![false; n],
            shift: 0.0,
            weak: Vec::new(),
            right: system.clone(),
            solution: system.clone(),
            correction: system.clone(),
            rest: system,
            g: vec![0.0; n],
            target: Vec::new(),
            zeros: vec![0.0; m],
        }
    }

    /// The diagonal D that `finish` multiplies by its shift and adds to H, in the units of H as given:
    /// |H_ii|, and 1/unit² where that is zero.
    pub fn shift_diagonal(&self) -> Vec<f64> {
        self.diagonal.iter().zip(&self.scale).map(|(d, s)| d / (s * s)).collect()
    }

    /// (H + shift D) d.
    fn curve(&self, i: usize, d: &[f64]) -> f64 {
        self.h.row(i).map(|(j, h)| h * d[j]).sum::<f64>() + self.shift * self.diagonal[i] * d[i]
    }

    /// Solves for `rest` into `correction`, once.
    fn solve_once(&mut self) {
        let mut correction =
            std::mem::replace(&mut self.correction, System { d: Vec::new(), lambda: Vec::new() });
        let mut g = std::mem::take(&mut self.g);
        let (d, lambda) = (&mut correction.d, &mut correction.lambda);
        // Any step that meets the constraints, then the best along them.
        d.fill(0.0);
        self.basis.complete(&self.a, &self.rest.lambda, d, true);
        (0..self.n).for_each(|i| g[i] = self.rest.d[i] - self.curve(i, d));
        self.basis.multipliers(&self.a, &mut g, lambda, true);
        self.target.clear();
        self.target.extend(self.reduced.holding().kept().iter().map(|&v| -d[v as usize]));
        self.reduced.solve(&self.basis, &g, &mut self.target, d);
        self.basis.complete(&self.a, &self.rest.lambda, d, false);
        self.reduced.holding().kept().iter().for_each(|&v| d[v as usize] = 0.0);
        (0..self.n).for_each(|i| g[i] = self.rest.d[i] - self.curve(i, d));
        for (&v, nu) in self.reduced.holding().kept().iter().zip(&self.target) {
            g[v as usize] -= nu;
        }
        self.basis.multipliers(&self.a, &mut g, lambda, false);
        self.correction = correction;
        self.g = g;
    }

    /// Residual of `solution` into `rest`; its greatest part of the sum of its terms.
    ///
    /// Where all terms of a row are themselves errors there is nothing to compare with. As Arioli, Demmel
    /// and Duff (1989) do, such rows are judged by the size of the whole solution.
    fn residual(&mut self) -> f64 {
        let (x, lambda) = (&self.solution.d, &self.solution.lambda);
        let largest = x.iter().chain(lambda).fold(0.0f64, |a, x| a.max(x.abs()));
        let least = NOTHING * largest;
        // `g` adds up sizes.
        for i in 0..self.n {
            let own = self.shift * self.diagonal[i];
            let mut rest = self.right.d[i] - own * x[i];
            let mut size = self.right.d[i].abs() + own * (x[i].abs() + least);
            for (j, h) in self.h.row(i) {
                rest -= h * x[j];
                size += h.abs() * (x[j].abs() + least);
            }
            (self.rest.d[i], self.g[i]) = (rest, size);
        }
        let mut worst = 0.0f64;
        for (c, &l) in lambda.iter().enumerate() {
            let (mut rest, mut size) = (self.right.lambda[c], self.right.lambda[c].abs());
            for (v, a) in self.a.row(c) {
                rest -= a * x[v];
                size += a.abs() * (x[v].abs() + least);
                self.rest.d[v] -= a * l;
                self.g[v] += a.abs() * (l.abs() + least);
            }
            self.rest.lambda[c] = rest;
            worst = worse(worst, rest, size);
        }
        for i in 0..self.n {
            if self.held[i] {
                self.rest.d[i] = 0.0;
            }
            worst = worse(worst, self.rest.d[i], self.g[i]);
        }
        worst
    }

    /// Names the variables of weak directions.
    fn name_weak_directions(&mut self) {
        self.weak.clear();
        let mut d = std::mem::take(&mut self.g);
        for number in 0..self.reduced.weak() {
            self.reduced.weak_direction(number, &self.basis, &mut d);
            self.basis.complete(&self.a, &self.zeros, &mut d, false);
            let part = |i: usize| if self.held[i] { 0.0 } else { d[i] * self.diagonal[i].sqrt() };
            let length = (0..self.n).map(|i| part(i).powi(2)).sum::<f64>().sqrt();
            let largest = (0..self.n).fold(0.0f64, |a, i| a.max(part(i).abs()));
            let named = (0..self.n).filter(|&i| part(i).abs() >= MINOR * largest && part(i) != 0.0);
            let mut parts: Direction = named.map(|i| (VariableId(i), part(i) / length)).collect();
            parts.sort_by(|x, y| y.1.abs().total_cmp(&x.1.abs()));
            self.weak.push(parts);
        }
        self.g = d;
        self.weak
            .extend(self.reduced.holding().immovable().iter().map(|&v| vec![(VariableId(v as usize), 1.0)]));
    }
}

/// The greater of a part and rest/size; anything that is not finite is the worst.
fn worse(worst: f64, rest: f64, size: f64) -> f64 {
    if rest.is_nan() {
        return f64::INFINITY;
    }
    if rest == 0.0 { worst } else { worst.max(rest.abs() / size) }
}

impl KktSolver for SparseKkt {
    fn factorize(&mut self, entries: &Entries<'_>, _: Effort) -> Result<&mut dyn Factor, KktError> {
        self.is_assembled = false;
        self.a.fill(entries.jacobian);
        if !all_finite(self.a.values()) {
            return Err(KktError::NotFinite);
        }
        let found = self.basis.factorize(&self.a);
        if current().stops() {
            return Err(KktError::Stopped);
        }
        found.map_err(|row| KktError::Dependent { row: ConstraintId(row) })?;
        self.replace_hessian(entries)?;
        Ok(self)
    }

    fn factor(&mut self) -> Option<&mut dyn Factor> {
        self.is_assembled.then_some(self)
    }

    fn flops(&self) -> u64 {
        self.basis.operations() + self.reduced.operations()
    }
}

impl Factor for SparseKkt {
    fn replace_hessian(&mut self, entries: &Entries<'_>) -> Result<(), KktError> {
        self.is_assembled = false;
        self.h.fill(entries.hessian);
        if !all_finite(self.h.values()) {
            return Err(KktError::NotFinite);
        }
        self.diagonal.fill(1.0);
        for (i, d) in self.diagonal.iter_mut().enumerate() {
            if let Some((_, h)) = self.h.row(i).find(|&(j, h)| i == j && h != 0.0) {
                *d = h.abs();
            }
        }
        self.reduced.assemble(&self.h, &self.basis);
        self.is_assembled = true;
        Ok(())
    }

    fn finish(&mut self, held: &[bool], shift: f64) -> Curvature {
        self.held.copy_from_slice(held);
        self.shift = shift;
        if !self.is_assembled || current().stops() {
            // Nothing is known, so nothing is positive.
            self.weak.clear();
            return Curvature { negative: 0, zero: self.n.saturating_sub(self.m).max(1) };
        }
        let found = self.reduced.finish(&self.basis, held, shift, &self.diagonal);
        self.name_weak_directions();
        found
    }

    fn solve(&mut self, p: &[f64], q: &[f64], d: &mut [f64], lambda: &mut [f64]) {
        if !self.is_assembled || current().stops() {
            d.fill(f64::NAN);
            lambda.fill(f64::NAN);
            return;
        }
        for (i, &p) in p.iter().enumerate() {
            self.right.d[i] = if self.held[i] { 0.0 } else { self.scale[i] * p };
        }
        for (to, (q, scale)) in self.right.lambda.iter_mut().zip(q.iter().zip(&self.row_scale)) {
            *to = q / scale;
        }
        self.rest.clone_from(&self.right);
        self.solve_once();
        self.solution.clone_from(&self.correction);
        let mut worst = self.residual();
        for _ in 0..REFINEMENTS {
            if worst <= ROUNDING {
                break;
            }
            self.solve_once();
            self.solution.add(&self.correction, 1.0);
            let now = self.residual();
            if now >= worst {
                self.solution.add(&self.correction, -1.0);
                break;
            }
            worst = now;
        }
        for (to, (x, scale)) in d.iter_mut().zip(self.solution.d.iter().zip(&self.scale)) {
            *to = scale * x;
        }
        for (to, (x, scale)) in lambda.iter_mut().zip(self.solution.lambda.iter().zip(&self.row_scale)) {
            *to = x / scale;
        }
    }

    fn weak_directions(&self) -> &[Direction] {
        &self.weak
    }

    fn sizes(&self) -> (usize, usize) {
        (self.n, self.m)
    }
}
