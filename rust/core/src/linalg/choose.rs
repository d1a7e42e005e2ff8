//! The factorisation that fits a program.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use super::arrow::ArrowKkt;
use super::sparse::SparseKkt;
use super::{Effort, Entries, Factor, KktError, KktSolver};
use crate::interrupt::current;
use crate::nlp::{Chains, Nlp, Structure};

/// Makes the factorisation of a program's Newton systems, given units as [`kkt_for`] takes them.
type Make = dyn Fn(&dyn Nlp, &[f64]) -> Box<dyn KktSolver> + Send + Sync;

/// The choice of a factorisation: the one that fits a program ([`kkt_for`]), unless the user has another.
#[derive(Default)]
pub struct KktChoice {
    own: Option<Arc<Make>>,
    made: Mutex<Option<Box<dyn KktSolver>>>,
}

impl KktChoice {
    /// A factorisation of one's own, made for a program and the units of its states.
    pub fn own(make: impl Fn(&dyn Nlp, &[f64]) -> Box<dyn KktSolver> + Send + Sync + 'static) -> KktChoice {
        KktChoice { own: Some(Arc::new(make)), made: Mutex::default() }
    }

    /// Makes it.
    pub fn make(&self, nlp: &dyn Nlp, units: &[f64]) -> Box<dyn KktSolver> {
        self.own.as_ref().map_or_else(|| kkt_for(nlp, units), |make| make(nlp, units))
    }

    /// The same choice with one that was made for a program, which another system of the same program takes: to plan
    /// an elimination takes as long as two iterations. A clone of the choice has none.
    pub(crate) fn with_made(self, kkt: Box<dyn KktSolver>) -> KktChoice {
        KktChoice { own: self.own, made: Mutex::new(Some(kkt)) }
    }

    /// Takes the one that was made for the program, or makes it.
    pub(crate) fn take_or_make(&self, nlp: &dyn Nlp, units: &[f64]) -> Box<dyn KktSolver> {
        self.take_made().unwrap_or_else(|| self.make(nlp, units))
    }

    /// Takes the one that was made.
    pub(crate) fn take_made(&self) -> Option<Box<dyn KktSolver>> {
        self.made.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl Clone for KktChoice {
    fn clone(&self) -> KktChoice {
        KktChoice { own: self.own.clone(), made: Mutex::default() }
    }
}

impl fmt::Debug for KktChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.own.is_some() { "a factorisation of one's own" } else { "the one that fits" })
    }
}

impl PartialEq for KktChoice {
    fn eq(&self, other: &KktChoice) -> bool {
        self.own.as_ref().map(Arc::as_ptr).map(<*const Make>::cast::<()>)
            == other.own.as_ref().map(Arc::as_ptr).map(<*const Make>::cast::<()>)
    }
}

/// The arrow factorisation where the program has chains, else the sparse one. `units` are those of the
/// states of a point where there are chains, else a single one or one each variable.
pub fn kkt_for(nlp: &dyn Nlp, units: &[f64]) -> Box<dyn KktSolver> {
    if current().stops() {
        return Box::new(Unmade);
    }
    let Some(chains) = nlp.chains() else { return Box::new(sparse(nlp, units)) };
    // The chains of the arrow hold no variables in place.
    let (lower, upper) = nlp.bounds();
    if lower.iter().zip(&upper).skip(chains.border).any(|(l, u)| l.is_finite() || u.is_finite()) {
        return Box::new(sparse(nlp, units));
    }
    let sizes = (nlp.n(), nlp.m());
    let structures = (nlp.hessian_structure(), nlp.jacobian_structure());
    let Some(arrow) = ArrowKkt::new(chains, structures.0, structures.1, sizes, &units[..chains.n_x]) else {
        return if current().stops() { Box::new(Unmade) } else { Box::new(sparse(nlp, units)) };
    };
    let arrow = arrow.with_threads(nlp.threads());
    if chains.boundary_states().next().is_none() {
        return Box::new(arrow);
    }
    let (hessian, jacobian) = (structures.0.clone(), structures.1.clone());
    Box::new(Either { arrow, sparse: None, by_arrow: true, hessian, jacobian, scales: scales(nlp, units) })
}

fn sparse(nlp: &dyn Nlp, units: &[f64]) -> SparseKkt {
    let (columns, rows) = scales(nlp, units);
    SparseKkt::new(nlp.n(), nlp.m(), nlp.hessian_structure(), nlp.jacobian_structure(), &columns, &rows)
}

/// Units of all variables and constraints.
fn scales(nlp: &dyn Nlp, units: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let border = nlp.chains().map_or(0, |c| c.border);
    let mut columns = vec![1.0; border];
    columns.extend(units.iter().copied().cycle().take(nlp.n() - border));
    let at_ends: Vec<f64> =
        nlp.chains().into_iter().flat_map(Chains::boundary_states).map(|s| units[s.0]).collect();
    let mut rows: Vec<f64> = units.iter().copied().cycle().take(nlp.m() - at_ends.len()).collect();
    rows.extend(at_ends);
    (columns, rows)
}

/// The solver of a run that was stopped before a factorisation was planned: to plan one takes long in large programs.
struct Unmade;

impl KktSolver for Unmade {
    fn factorize(&mut self, _: &Entries<'_>, _: Effort) -> Result<&mut dyn Factor, KktError> {
        Err(KktError::Stopped)
    }

    fn factor(&mut self) -> Option<&mut dyn Factor> {
        None
    }

    fn flops(&self) -> u64 {
        0
    }
}

/// The arrow where it serves. Where constraints depend on each other the sparse factorisation takes over, which knows
/// better which ones. That may be so at one iterate only, and the sparse one takes many times as long where there are
/// many parameters: the next iterate is for the arrow again.
struct Either {
    arrow: ArrowKkt,
    sparse: Option<SparseKkt>,
    /// Whether the last factorisation is that of the arrow.
    by_arrow: bool,
    /// The structure that the sparse solver is made from.
    hessian: Structure,
    jacobian: Structure,
    scales: (Vec<f64>, Vec<f64>),
}

impl KktSolver for Either {
    fn factorize(&mut self, entries: &Entries<'_>, effort: Effort) -> Result<&mut dyn Factor, KktError> {
        self.by_arrow = true;
        match self.arrow.eliminate_all(entries, effort) {
            Ok(()) => return Ok(&mut self.arrow),
            // Of these the other knows better; everything else would stop it, too.
            Err(KktError::Boundary | KktError::Dependent { .. }) => {}
            Err(error) => return Err(error),
        }
        self.by_arrow = false;
        let (hessian, jacobian, (columns, rows)) = (&self.hessian, &self.jacobian, &self.scales);
        let make = || SparseKkt::new(columns.len(), rows.len(), hessian, jacobian, columns, rows);
        self.sparse.get_or_insert_with(make).factorize(entries, effort)
    }

    fn factor(&mut self) -> Option<&mut dyn Factor> {
        match &mut self.sparse {
            Some(sparse) if !self.by_arrow => sparse.factor(),
            _ => self.arrow.factor(),
        }
    }

    fn flops(&self) -> u64 {
        let sparse = self.sparse.as_ref().filter(|_| !self.by_arrow);
        sparse.map_or_else(|| self.arrow.flops(), KktSolver::flops)
    }
}
