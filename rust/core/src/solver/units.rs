//! Units in which steps and defects are of order one.

use crate::nlp::Nlp;

/// What the states do along the path ξ: their spread at all points, else their size, else 1. One for
/// each of the n_x states; a defect is measured in that of its state. A single 1 where the program has
/// no chains.
pub fn state_units(nlp: &dyn Nlp, xi: &[f64]) -> Vec<f64> {
    let Some(chains) = nlp.chains() else { return vec![1.0] };
    let n = chains.n_x;
    let states = &xi[chains.border..];
    let count = (states.len() / n) as f64;
    let unit = |i: usize| {
        let values = || states.iter().skip(i).step_by(n);
        let mean = values().sum::<f64>() / count;
        let spread = (values().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt();
        let size = values().fold(0.0f64, |a, x| a.max(x.abs()));
        // A spread of rounding errors is none.
        if spread > 1e-12 * size {
            spread
        } else if size > 0.0 {
            size
        } else {
            1.0
        }
    };
    (0..n).map(unit).collect()
}
