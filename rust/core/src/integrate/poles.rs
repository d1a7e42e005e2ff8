//! Poles of the state equations, which a step of an integration may cross unnoticed.
//!
//! Where a divisor vanishes, as K + x in a saturated rate of a state that has become negative, slopes grow without limit, and the
//! solution ends. All stages of a step may lie off the pole and the error of the step be small by chance. The divisor then has
//! another sign at the end of the step.

use super::field::{Bad, Field};
use crate::expr::graph::{Graph, Id, Item};
use crate::expr::ops::Op;

/// Bisections for the place of a pole.
const HALVINGS: usize = 40;
/// A slope grows without limit where each of the differences between distances from the pole of these parts of the step is so
/// many times that before: of a simple pole it is ten times that. Where numerator and divisor vanish together it is less.
const DISTANCES: [f64; 4] = [1e-3, 1e-4, 1e-5, 1e-6];
const GROWS: f64 = 5.0;

/// Returns the divisors of some expressions that depend on given symbols.
pub(super) fn divisors(graph: &mut Graph, roots: &[Id], symbols: &[Id]) -> Vec<Id> {
    let nodes = graph.reachable(roots);
    let mut depends = vec![false; nodes.last().map_or(0, |n| n.index() + 1)];
    let mut found = Vec::new();
    for id in nodes {
        depends[id.index()] = symbols.contains(&id) || graph.args(id).iter().any(|a| depends[a.index()]);
        let Item::Apply(op, [a, b, _]) = graph.item(id) else { continue };
        let divisor = match op {
            Op::Div => b,
            Op::Recip => a,
            Op::Pow if graph.as_constant(b).is_some_and(|power| power < 0.0) => a,
            Op::Tan => a,
            _ => continue,
        };
        if depends[divisor.index()] {
            found.push(if op == Op::Tan { graph.apply(Op::Cos, &[divisor]) } else { divisor });
        }
    }
    found.sort();
    found.dedup();
    found
}

impl Field<'_> {
    /// Returns whether a pole lies on the line from a state to another a time `h` later; `bad` then says where.
    pub fn has_pole_between(&mut self, (t, h): (f64, f64), x: &[f64], next: &[f64]) -> bool {
        let (Some(first), Some(last)) = (self.divisors_at(t, x), self.divisors_at(t + h, next)) else {
            return false;
        };
        let found = (0..first.len()).find(|&k| {
            // Steps that end ever closer to a pole become too short to show it.
            let known = self.poles.contains(&k);
            first[k] * last[k] < 0.0 && (known || self.is_pole(k, (t, h), x, next, first[k]))
        });
        self.poles.extend(found.filter(|k| !self.poles.contains(k)));
        found.is_some()
    }

    fn is_pole(&mut self, k: usize, (t, h): (f64, f64), x: &[f64], next: &[f64], first: f64) -> bool {
        let at = |part: f64| -> Vec<f64> { x.iter().zip(next).map(|(a, b)| a + part * (b - a)).collect() };
        let (mut below, mut above) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (below + above);
            let divisors = self.divisors_at(t + middle * h, &at(middle)).unwrap_or_default();
            if divisors[k] * first > 0.0 { below = middle } else { above = middle }
        }
        let slopes = DISTANCES.map(|distance| {
            let (part, mut slope) = (below - distance, vec![0.0; x.len()]);
            self.slope(t + part * h, &at(part), &mut slope);
            slope
        });
        let grows = |i: &usize| {
            let differences = slopes.windows(2).map(|w| (w[1][*i] - w[0][*i]).abs());
            let differences: Vec<f64> = differences.collect();
            differences.windows(2).all(|w| w[1].is_nan() || w[1] > GROWS * w[0])
        };
        let Some(i) = (0..x.len()).find(grows) else { return false };
        let mut there = slopes[DISTANCES.len() - 1].clone();
        there[i] = f64::INFINITY;
        let point = self.point(t + below * h, &at(below)).to_vec();
        let bad: Bad = (point[0], point, there);
        self.bad = Some(bad);
        true
    }
}
