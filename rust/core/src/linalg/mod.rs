//! Newton systems: the seam of [`KktSolver`] and [`Factor`], and its implementations.

use crate::index::{ConstraintId, VariableId};

pub mod arrow;
mod choose;
pub mod sparse;

pub use choose::{KktChoice, kkt_for};

/// The reason why a Newton system was not factorised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum KktError {
    /// A constraint depends on others.
    #[error("constraint {} depends on others", row.0)]
    Dependent {
        /// The constraint.
        row: ConstraintId,
    },
    /// The boundary conditions determine more than the states at the ends of a chain, which is all that
    /// this factorisation lets them determine.
    #[error("the boundary conditions determine more than the states at the ends")]
    Boundary,
    /// An entry of H or A, or a number on the way, is not finite.
    #[error("the Newton system is not finite")]
    NotFinite,
    /// The factorisation would be very costly, and was to be quick: [`Effort::hurry`].
    #[error("the Newton system is too costly to factorise")]
    TooCostly,
    /// The run was stopped meanwhile.
    #[error("the factorisation was stopped")]
    Stopped,
}

/// The curvature of the Lagrangian along the constraints: of the *reduced* Hessian ZᵀHZ, Z a basis of
/// the null space of A.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Curvature {
    /// Number of its negative eigenvalues.
    pub negative: usize,
    /// Number of eigenvalues that are zero to working precision.
    pub zero: usize,
}

impl Curvature {
    /// Whether a step minimises: the KKT matrix has inertia (n, m, 0).
    pub fn is_positive(self) -> bool {
        self == Curvature::default()
    }
}

/// Variables and their part in a direction, in units of the root of the diagonal, the greatest first.
pub type Direction = Vec<(VariableId, f64)>;

/// The entries of H and A, at the places of the Nlp's structures.
#[derive(Clone, Copy, Debug)]
pub struct Entries<'a> {
    /// The entries of the lower triangle of H.
    pub hessian: &'a [f64],
    /// The entries of A.
    pub jacobian: &'a [f64],
}

/// The work that a factorisation may take, and the accuracy of its solutions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Whether solutions are refined against the entries until only rounding is left. Without it they are as good as
    /// the elimination, which is enough on the way.
    pub refine: bool,
    /// Whether a system that is very costly, as one of a wildly unstable motion may be, need not be factorised
    /// ([`KktError::TooCostly`]): there is another point to go on from.
    pub hurry: bool,
}

impl Effort {
    /// No limit on the work, and refined solutions.
    pub const FULL: Effort = Effort { refine: true, hurry: false };
}

/// A method to factorise a Newton system:
///
/// ```text
///   [ H + shift  Aᵀ ] [ d ]   [ p ]
///   [ A          0  ] [ λ ] = [ q ]
/// ```
///
/// with H and A given by the entries of the Nlp's structures (the lower triangle of H; entries at one
/// place add up). The zero block stays zero: to regularise it would let the fit cheat on the equations.
pub trait KktSolver: Send {
    /// Takes the entries of H and A and eliminates what can be eliminated once and for all. The factor uses the
    /// solver's own buffers: to factorise again allocates nothing.
    ///
    /// # Errors
    /// When A has not full rank, something is not finite, or as `effort` says.
    fn factorize(&mut self, entries: &Entries<'_>, effort: Effort) -> Result<&mut dyn Factor, KktError>;

    /// The factor of the last matrix, as it was left; `None` where there is none.
    fn factor(&mut self) -> Option<&mut dyn Factor>;

    /// Floating-point operations of one factorisation, counted.
    fn flops(&self) -> u64;
}

/// A factorised Newton system: it solves for right-hand sides, and gives inertia and covariances.
pub trait Factor {
    /// Completes the factorisation with some variables held in place (d = 0 there) and `shift` ≥ 0 times
    /// a positive diagonal, in units of the curvature, added to the reduced Hessian. May be called again
    /// with others. Only a positive curvature allows to solve.
    fn finish(&mut self, held: &[bool], shift: f64) -> Curvature;

    /// Solves for one right-hand side p (n), q (m).
    fn solve(&mut self, p: &[f64], q: &[f64], d: &mut [f64], lambda: &mut [f64]);

    /// Reduces a right-hand side to the variables that couple all others, so that [`Factor::solve_reduced`] gives their
    /// part of solutions at little cost. Their number: they are the first ones; 0 where the factorisation has none such.
    fn reduce(&mut self, _p: &[f64], _q: &[f64]) -> usize {
        0
    }

    /// Returns, for the right-hand side that was reduced, the first variables of the solution, `d`, with those held
    /// that the last `finish` held, each at its entry of `to`; and the forces that hold these: z = p − H d − Aᵀλ.
    fn solve_reduced(&mut self, _to: &[f64], _d: &mut [f64], _z: &mut [f64]) {}

    /// Directions of no curvature, or negative, found by the last `finish`.
    fn weak_directions(&self) -> &[Direction];

    /// The block of the inverse of the KKT matrix between some variables, row-major k × k: with H the
    /// observed information, their covariance. Rows of held variables are zero.
    fn covariance(&mut self, wanted: &[VariableId], out: &mut [f64]) {
        covariance_by_solving(self, wanted, out);
    }

    /// Factorises for another Hessian; the entries of A are the same, and what depends on them alone is used again.
    ///
    /// # Errors
    /// When something is not finite. There is no factor any more then.
    fn replace_hessian(&mut self, entries: &Entries<'_>) -> Result<(), KktError>;

    /// Numbers of variables and constraints.
    fn sizes(&self) -> (usize, usize);
}

/// The covariance by one solution for each variable.
fn covariance_by_solving<F: Factor + ?Sized>(kkt: &mut F, wanted: &[VariableId], out: &mut [f64]) {
    let (n, m) = kkt.sizes();
    let (mut p, q) = (vec![0.0; n], vec![0.0; m]);
    let (mut d, mut lambda) = (vec![0.0; n], vec![0.0; m]);
    for (row, &i) in out.chunks_exact_mut(wanted.len()).zip(wanted) {
        p[i] = 1.0;
        kkt.solve(&p, &q, &mut d, &mut lambda);
        p[i] = 0.0;
        row.iter_mut().zip(wanted).for_each(|(o, &j)| *o = d[j]);
    }
}
