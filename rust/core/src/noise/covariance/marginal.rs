//! The log-density, of whole samples and of samples in part.
//!
//! Where a part of a sample is missing, its density is the marginal one of the rest. The root of the
//! inverse of a part of R follows from W by plane rotations: an output is moved out by rotating the rows above
//! its own until none but its own depends on it, and that row goes. Outputs are ordered by the number of
//! their measurements, the fewest first: those at the start go without a rotation.

use std::collections::HashSet;

use super::Covariance;
use crate::error::Error;
use crate::expr::Op;
use crate::expr::graph::{Graph, Id};
use crate::noise::{Missing, Sample};
use crate::tape::Terms;

/// Most second derivatives of roots, as [`Covariance::effort`] estimates them: a tape holds four times as many
/// numbers, and more take minutes.
const MOST_EFFORT: usize = 16_000;

impl Covariance {
    /// Whether the roots of all patterns can be differentiated in good time.
    ///
    /// # Errors
    /// When outputs are missing in too many different combinations.
    pub(in crate::noise) fn check_missing(&self, missing: &Missing) -> Result<(), Error> {
        if self.known || self.effort(missing) <= MOST_EFFORT {
            return Ok(());
        }
        Err(Error::data(format!(
            "outputs are missing in {} different combinations, more than noise with an unknown covariance can take in; \
             let samples be missing as a whole (NaN in all outputs) where some outputs are, or take independent noise",
            missing.patterns.len()
        )))
    }

    /// About how many second derivatives the roots of all patterns have. A row depends on which outputs after
    /// it are missing, and on the entries of its own and the rows down to the last of them.
    fn effort(&self, missing: &Missing) -> usize {
        let n = self.n();
        let mut seen: HashSet<(usize, Vec<usize>)> = HashSet::new();
        let mut effort = 0;
        for set in &missing.patterns {
            let present = |i: usize| set[self.order[i]];
            for i in (0..n).filter(|&i| present(i)) {
                let gone: Vec<usize> = (i + 1..n).filter(|&m| !present(m)).collect();
                let Some(&last) = gone.last() else { continue };
                let (own, entries) = (n - i - gone.len(), (i..=last).map(|k| n - k).sum::<usize>());
                if seen.insert((i, gone)) {
                    effort += own * entries * (entries + 1) / 2;
                }
            }
        }
        effort
    }

    pub(in crate::noise) fn log_density(
        &self,
        graph: &mut Graph,
        sample: &Sample<'_>,
        parameters: &[Id],
    ) -> Terms {
        let n = self.n();
        let mut rows = vec![vec![graph.zero(); n]; n];
        if self.known {
            let w = self.start();
            self.places().for_each(|(i, j)| rows[i][j] = graph.constant(w[(i, j)]));
        } else {
            self.places().zip(parameters).for_each(|((i, j), id)| rows[i][j] = *id);
        }
        let (mut lanes, mut rest) = (rows.clone(), log_diagonal(graph, &rows, |_| true));
        for (set, flag) in sample.patterns {
            let present = |i: usize| set[self.order[i]];
            let part = marginal(graph, &rows, present);
            for (i, j) in self.places() {
                // Patterns exclude each other: what is as without gaps needs no switch.
                if part[i][j] != rows[i][j] {
                    lanes[i][j] = graph.select(*flag, part[i][j], lanes[i][j]);
                }
            }
            let log = log_diagonal(graph, &part, present);
            rest = graph.select(*flag, log, rest);
        }
        let residuals: Vec<Id> = self.order.iter().map(|&c| sample.residual(graph, c)).collect();
        let mut squares = Vec::with_capacity(n);
        for (i, lane) in lanes.iter().enumerate() {
            let mut sum = graph.zero();
            for j in i..n {
                let term = graph.mul(lane[j], residuals[j]);
                sum = graph.add(sum, term);
            }
            squares.push(sum);
        }
        Terms { squares, losses: Vec::new(), rest, logs: Vec::new() }
    }
}

/// Σ ln w_ii over some rows.
fn log_diagonal(graph: &mut Graph, rows: &[Vec<Id>], which: impl Fn(usize) -> bool) -> Id {
    let mut sum = graph.zero();
    for i in (0..rows.len()).filter(|&i| which(i)) {
        let log = graph.unary(Op::Log, rows[i][i]);
        sum = graph.add(sum, log);
    }
    sum
}

/// The root of the inverse of the part of R that belongs to the outputs present, in their rows and columns;
/// the others are 0.
fn marginal(graph: &mut Graph, rows: &[Vec<Id>], present: impl Fn(usize) -> bool) -> Vec<Vec<Id>> {
    let n = rows.len();
    let mut rows = rows.to_vec();
    let zero = graph.zero();
    for m in (0..n).filter(|&m| !present(m)) {
        for i in (0..m).rev().filter(|&i| present(i)) {
            let (below, above) = (rows[m][m], rows[i][m]);
            if graph.as_constant(above) == Some(0.0) {
                continue;
            }
            let (x, y) = (graph.mul(below, below), graph.mul(above, above));
            let square = graph.add(x, y);
            let length = graph.unary(Op::Sqrt, square);
            let inverse = graph.recip(length);
            let (upper, lower) = (rows[i].clone(), rows[m].clone());
            let (cosine, sine) = (graph.mul(below, inverse), graph.mul(above, inverse));
            for j in i..n {
                let (a, b) = (upper[j], lower[j]);
                let (ca, sb) = (graph.mul(cosine, a), graph.mul(sine, b));
                let (sa, cb) = (graph.mul(sine, a), graph.mul(cosine, b));
                rows[i][j] = if j == m { zero } else { graph.sub(ca, sb) };
                rows[m][j] = if j == m { length } else { graph.add(sa, cb) };
            }
        }
        rows[m].fill(zero);
    }
    rows
}
