//! The factorisation that fits a program.

use super::arrow::ArrowKkt;
use super::sparse::SparseKkt;
use super::{Curvature, KktError, KktSolver};
use crate::interrupt::current;
use crate::nlp::{Chains, Nlp, Structure};

/// The arrow factorisation where the program has chains, else the sparse one. `units` are those of the
/// states of a point where there are chains, else a single one or one each variable.
pub fn kkt_for(nlp: &dyn Nlp, units: &[f64]) -> Box<dyn KktSolver> {
    if current().stops() {
        return Box::new(Unmade((nlp.n(), nlp.m())));
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
        return Box::new(sparse(nlp, units));
    };
    let arrow = arrow.with_threads(nlp.threads());
    if chains.boundary_states().next().is_none() {
        return Box::new(arrow);
    }
    let (columns, rows) = scales(nlp, units);
    Box::new(Either {
        now: Box::new(arrow),
        other: Some(Parts { hessian: structures.0.clone(), jacobian: structures.1.clone(), columns, rows }),
    })
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
        nlp.chains().into_iter().flat_map(Chains::boundary_states).map(|s| units[s]).collect();
    let mut rows: Vec<f64> = units.iter().copied().cycle().take(nlp.m() - at_ends.len()).collect();
    rows.extend(at_ends);
    (columns, rows)
}

/// Of a run that was stopped before it began: to plan an elimination takes long in large programs.
struct Unmade((usize, usize));

impl KktSolver for Unmade {
    fn factorize(&mut self, _: &[f64], _: &[f64]) -> Result<(), KktError> {
        Err(KktError::Stopped)
    }

    fn finish(&mut self, _: &[bool], _: f64) -> Curvature {
        Curvature { negative: 0, zero: 1 }
    }

    fn solve(&mut self, _: &[f64], _: &[f64], d: &mut [f64], lambda: &mut [f64]) {
        d.fill(f64::NAN);
        lambda.fill(f64::NAN);
    }

    fn weak_directions(&self) -> &[Vec<(usize, f64)>] {
        &[]
    }

    fn sizes(&self) -> (usize, usize) {
        self.0
    }

    fn flops(&self) -> u64 {
        0
    }
}

/// The arrow as long as it serves. Boundary conditions may determine parameters instead of states, as when an
/// integrator without feedback is to end where it began; the ends of the chain cannot meet these, and the
/// sparse factorisation takes over.
struct Either {
    now: Box<dyn KktSolver>,
    /// What the other is made from, while the arrow is in use.
    other: Option<Parts>,
}

struct Parts {
    hessian: Structure,
    jacobian: Structure,
    columns: Vec<f64>,
    rows: Vec<f64>,
}

impl KktSolver for Either {
    fn factorize(&mut self, hessian: &[f64], jacobian: &[f64]) -> Result<(), KktError> {
        let done = self.now.factorize(hessian, jacobian);
        // Of these the other knows better; everything else would stop it, too.
        if !matches!(done, Err(KktError::Boundary | KktError::Dependent { .. })) {
            return done;
        }
        let Some(parts) = self.other.take() else { return done };
        let Parts { hessian: h, jacobian: a, columns, rows } = &parts;
        self.now = Box::new(SparseKkt::new(columns.len(), rows.len(), h, a, columns, rows));
        self.now.factorize(hessian, jacobian)
    }

    fn set_hurry(&mut self, on: bool) {
        self.now.set_hurry(on);
    }

    fn finish(&mut self, held: &[bool], shift: f64) -> Curvature {
        self.now.finish(held, shift)
    }

    fn set_refinement(&mut self, on: bool) {
        self.now.set_refinement(on);
    }

    fn solve(&mut self, p: &[f64], q: &[f64], d: &mut [f64], lambda: &mut [f64]) {
        self.now.solve(p, q, d, lambda);
    }

    fn weak_directions(&self) -> &[Vec<(usize, f64)>] {
        self.now.weak_directions()
    }

    fn covariance(&mut self, wanted: &[usize], out: &mut [f64]) {
        self.now.covariance(wanted, out);
    }

    fn sizes(&self) -> (usize, usize) {
        self.now.sizes()
    }

    fn flops(&self) -> u64 {
        self.now.flops()
    }
}
