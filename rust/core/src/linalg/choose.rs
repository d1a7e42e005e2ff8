//! The factorisation that fits a program.

use super::KktSolver;
use super::arrow::ArrowKkt;
use super::sparse::SparseKkt;
use crate::nlp::Nlp;

/// The arrow factorisation where the program has chains, else the sparse one. `units` are those of the
/// states of a point where there are chains, else a single one or one each variable.
pub fn kkt_for(nlp: &dyn Nlp, units: &[f64]) -> Box<dyn KktSolver> {
    let sizes = (nlp.n(), nlp.m());
    let arrow = nlp.chains().and_then(|chains| {
        ArrowKkt::new(chains, nlp.hessian_structure(), nlp.jacobian_structure(), sizes, &units[..chains.n_x])
    });
    match arrow {
        Some(arrow) => Box::new(arrow.with_threads(nlp.threads())),
        None => {
            let columns: Vec<f64> = units.iter().copied().cycle().take(sizes.0).collect();
            let rows: Vec<f64> = units.iter().copied().cycle().take(sizes.1).collect();
            Box::new(SparseKkt::new(
                sizes.0,
                sizes.1,
                nlp.hessian_structure(),
                nlp.jacobian_structure(),
                &columns,
                &rows,
            ))
        }
    }
}
