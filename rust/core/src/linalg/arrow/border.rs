//! The dense border: what is left when all chains are eliminated.
//!
//! ```text
//!   [ K  Eᵀ ] [ x ]   [ p ]
//!   [ E  0  ] [ f ] = [ c ]
//! ```
//!
//! x are the border variables and the ends of chains that stay beside them, E the few constraints that are
//! [deferred](super::top), most often none. These are met in an orthonormal basis of their null space, [Y₁ Y₂] R = Eᵀ.

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use nalgebra::{DMatrix, Dyn, SymmetricEigen};

use super::deferred::Deferred;
use crate::dense::{backward, cholesky, forward};
use crate::interrupt::current;
use crate::linalg::Curvature;

/// Pivots of the reduced Hessian, its diagonal scaled to 1, at or below this are no curvature.
pub(super) const TINY: f64 = 1e-13;

/// Rows from which the eigenvectors of a matrix take long, and how often the interrupt is asked then.
const LARGE: usize = 150;
const ASK: Duration = Duration::from_millis(5);

/// The dense border, factorised.
#[derive(Clone, Debug, Default)]
pub(super) struct Border {
    /// Factor of the matrix, or of what is left of it where constraints are met.
    l: Vec<f64>,
    scale: Vec<f64>,
    /// The elimination of the constraints in the last factorisation.
    deferred: Deferred,
}

impl Border {
    /// Factorises a matrix as large as `of`, with `shift` times the diagonal `of` added and some variables held, along
    /// the `constraints`, rows as long.
    pub fn factorize(
        &mut self,
        (s, constraints): (&[f64], &[f64]),
        of: &[f64],
        held: &[bool],
        shift: f64,
        weak: &mut Vec<Vec<(usize, f64)>>,
    ) -> Curvature {
        self.scale.clear();
        self.scale.extend(of.iter().map(|d| scale_of(*d)));
        self.deferred.turn(constraints, &self.scale, held);
        self.fill(s, held, shift);
        let b = of.len() - self.deferred.met();
        if cholesky(&mut self.l, b, |_| TINY).is_ok() {
            return Curvature::default();
        }
        if current().stops() {
            return Curvature { negative: 0, zero: 1 };
        }
        self.fill(s, held, shift);
        let (found, vectors) = directions(&self.l[..b * b], b);
        for v in vectors {
            let mut part: Vec<(usize, f64)> = self.deferred.outward(v).into_iter().enumerate().collect();
            part.sort_by(|x, y| y.1.abs().total_cmp(&x.1.abs()));
            weak.push(part);
        }
        found
    }

    /// Whether there are values of the variables that meet constraints, whatever stands on their right; `of` is the
    /// diagonal of the matrix.
    pub fn can_meet(&mut self, constraints: &[f64], of: &[f64]) -> bool {
        if constraints.is_empty() {
            return true;
        }
        self.scale.clear();
        self.scale.extend(of.iter().map(|d| scale_of(*d)));
        self.deferred.turn(constraints, &self.scale, &vec![false; of.len()]);
        self.deferred.met() * of.len() == constraints.len()
    }

    /// The matrix with a diagonal near 1, the shift added, and identity rows for what is held; then what is left of
    /// it along the constraints.
    fn fill(&mut self, s: &[f64], held: &[bool], shift: f64) {
        let b = self.scale.len();
        self.l.clear();
        self.l.extend_from_slice(s);
        for i in 0..b {
            for j in 0..b {
                let l = &mut self.l[i * b + j];
                *l *= self.scale[i] * self.scale[j];
                if held[i] || held[j] {
                    *l = f64::from(u8::from(i == j));
                }
            }
            if !held[i] {
                self.l[i * b + i] += shift;
            }
        }
        self.deferred.project(&mut self.l);
    }

    /// Solves in place for p; the constraints have `right` on their right, and get their multipliers in its place.
    pub fn solve(&self, p: &mut [f64], right: &mut [f64]) {
        p.iter_mut().zip(&self.scale).for_each(|(p, s)| *p *= s);
        let inner = |p: &mut [f64]| {
            forward(&self.l, p.len(), p);
            backward(&self.l, p.len(), p);
        };
        if right.is_empty() {
            inner(p);
        } else {
            self.deferred.solve(p, right, inner);
        }
        p.iter_mut().zip(&self.scale).for_each(|(p, s)| *p *= s);
    }
}

/// Returns the factor that scales a diagonal entry to 1; 1 where there is none.
pub(super) fn scale_of(diagonal: f64) -> f64 {
    let size = diagonal.abs();
    if size > 1e-290 && size.is_finite() { 1.0 / size.sqrt() } else { 1.0 }
}

/// The eigenvectors of a symmetric matrix, unless the interrupt in force comes first. Those of a large one take seconds
/// in which nothing can be asked: they are left to a thread, which is not waited for then.
fn eigen(a: DMatrix<f64>) -> Option<SymmetricEigen<f64, Dyn>> {
    let interrupt = current();
    if a.nrows() < LARGE || interrupt.is_none() {
        return Some(SymmetricEigen::new(a));
    }
    let (sender, receiver) = channel();
    thread::spawn(move || sender.send(SymmetricEigen::new(a)));
    loop {
        match receiver.recv_timeout(ASK) {
            Ok(found) => return Some(found),
            Err(RecvTimeoutError::Timeout) if !interrupt.stops() => {}
            Err(_) => return None,
        }
    }
}

/// Inertia of a symmetric matrix, and the directions in which it has no positive curvature.
pub(super) fn directions(a: &[f64], n: usize) -> (Curvature, Vec<Vec<f64>>) {
    if a.iter().any(|x| !x.is_finite()) {
        return (Curvature { negative: 0, zero: n }, Vec::new());
    }
    let Some(eigen) = eigen(DMatrix::from_row_slice(n, n, a)) else {
        return (Curvature { negative: 0, zero: n }, Vec::new());
    };
    let size = eigen.eigenvalues.amax().max(1.0);
    let mut found = Curvature::default();
    let mut vectors = Vec::new();
    for (k, value) in eigen.eigenvalues.iter().enumerate() {
        if *value < -TINY * size {
            found.negative += 1;
        } else if *value <= 4.0 * TINY * size {
            found.zero += 1;
        } else {
            continue;
        }
        vectors.push(eigen.eigenvectors.column(k).iter().copied().collect());
    }
    // Cholesky said no: at least one is not positive.
    if found == Curvature::default() {
        found.zero = 1;
        let least = eigen.eigenvalues.imin();
        vectors.push(eigen.eigenvectors.column(least).iter().copied().collect());
    }
    (found, vectors)
}
