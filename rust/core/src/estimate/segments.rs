//! The segments of a mesh along a known motion: as long as the local error of collocation allows.

use super::refine::in_parts;
use crate::dense::largest;
use crate::lgl::Lgl;

/// A state below this part of its largest value counts as this large where errors are weighed.
const SMALL: f64 = 1e-4;
/// A step of the integration is divided into so many segments at most.
const PIECES: usize = 16;

/// A motion of n states over S steps of an integration.
pub(super) struct Motion {
    /// Ends of the steps, S + 1 of them.
    pub ends: Vec<f64>,
    /// Times of the ends and of the middles of the steps, 2 S + 1 of them.
    pub times: Vec<f64>,
    /// States there, `[state][time]`.
    pub states: Vec<Vec<f64>>,
    /// Slopes at the ends of the two halves of each step, from within: `[half][end][state]`, 2 S halves.
    pub slopes: Vec<[Vec<f64>; 2]>,
}

impl Motion {
    /// Returns the ends of segments of collocation of an order whose local error is at most this part of each state.
    ///
    /// The local error is that of the quadrature of the state equations along the motion (Eq. coll_integral_defn),
    /// at all nodes of the segment: x(t_j) - x(t_0) - h Σ_k w_jk x'(t_k). Each time of `fixed`, in order, is the end of a
    /// segment where it is the end of a step.
    pub fn segments(&self, order: usize, tolerance: f64, fixed: &[f64]) -> Vec<f64> {
        if self.slopes.len() != 2 * (self.ends.len() - 1) {
            return self.ends.clone();
        }
        let lgl = Lgl::new(order);
        let least = self.states.iter().map(|x| SMALL * largest(x.iter().copied())).collect();
        let rises = lgl.nodes.iter().map(|node| lgl.integrate_to(0, *node)).collect();
        let rule = Quadrature { motion: self, nodes: &lgl.nodes, rises, least };
        let suits = |from: f64, to: f64| rule.error(from, to) <= tolerance;
        let last = self.ends.len() - 1;
        let is_fixed = |k: usize| k == last || fixed.binary_search_by(|t| t.total_cmp(&self.ends[k])).is_ok();
        let mut found = vec![self.ends[0]];
        let (mut at, mut length) = (0, 1);
        while at < last {
            let stop = (at + 1..=last).find(|&k| is_fixed(k)).expect("the last end is fixed");
            // The longest run of steps that suits: doubled or halved from the last one, then bisected.
            let fits = |steps: usize| suits(self.ends[at], self.ends[at + steps]);
            let most = stop - at;
            let mut steps = usize::min(length, most);
            let mut beyond = most + 1;
            while steps > 0 && !fits(steps) {
                beyond = steps;
                steps /= 2;
            }
            while beyond - steps > 1 && steps > 0 {
                let next = if beyond > most { (2 * steps).min(most) } else { (steps + beyond) / 2 };
                if next == steps {
                    break;
                }
                if fits(next) { steps = next } else { beyond = next }
            }
            if steps == 0 {
                let divided = |pieces| in_parts(&self.ends[at..=at + 1], pieces);
                let mut pieces = 2;
                while pieces < PIECES && !divided(pieces).windows(2).all(|w| suits(w[0], w[1])) {
                    pieces *= 2;
                }
                found.extend(&divided(pieces)[1..pieces]);
                steps = 1;
            }
            (at, length) = (at + steps, steps);
            found.push(self.ends[at]);
        }
        found
    }

    /// Returns the times of the nodes of all segments of an order, and the states there, `[state][time]`.
    pub fn on_mesh(&self, order: usize, ends: &[f64]) -> (Vec<f64>, Vec<Vec<f64>>) {
        if self.slopes.len() != 2 * (self.ends.len() - 1) {
            return (self.times.clone(), self.states.clone());
        }
        let lgl = Lgl::new(order);
        let mut times = vec![ends[0]];
        for w in ends.windows(2) {
            let inner = lgl.nodes[1..order - 1].iter().map(|node| w[0] + (w[1] - w[0]) * node);
            times.extend(inner.chain([w[1]]));
        }
        let places: Vec<(usize, f64)> = times.iter().map(|t| self.place(*t, false)).collect();
        let of_state = |i| places.iter().map(|(step, u)| self.at(*step, *u, i).0).collect();
        (times, (0..self.states.len()).map(of_state).collect())
    }

    /// Returns the step to which a time belongs, and its part of the step; the end of a step belongs to the one after unless
    /// it is to be the `last` of its own.
    fn place(&self, t: f64, last: bool) -> (usize, f64) {
        let ends = &self.ends;
        let after = ends.partition_point(|e| *e < t || (*e == t && !last));
        let step = after.clamp(1, ends.len() - 1) - 1;
        (step, (t - ends[step]) / (ends[step + 1] - ends[step]))
    }

    /// Returns a state and its slope at a time within a segment, by the polynomial of degree 5 through values and slopes at
    /// both ends and the middle of a step.
    fn at(&self, step: usize, u: f64, state: usize) -> (f64, f64) {
        let h = self.ends[step + 1] - self.ends[step];
        let x = &self.states[state][2 * step..=2 * step + 2];
        let [first, second] = [&self.slopes[2 * step], &self.slopes[2 * step + 1]];
        let middle = 0.5 * (first[1][state] + second[0][state]);
        let slopes = [first[0][state], middle, second[1][state]];
        let (l, dl) = (
            [2.0 * (u - 0.5) * (u - 1.0), -4.0 * u * (u - 1.0), 2.0 * u * (u - 0.5)],
            [4.0 * u - 3.0, 4.0 - 8.0 * u, 4.0 * u - 1.0],
        );
        let (mut value, mut slope) = (0.0, 0.0);
        for (i, (node, bend)) in [(0.0, -3.0), (0.5, 0.0), (1.0, 3.0)].into_iter().enumerate() {
            let (off, l, dl) = (u - node, l[i], dl[i]);
            let weight = 1.0 - 2.0 * off * bend;
            value += x[i] * weight * l * l + h * slopes[i] * off * l * l;
            slope += x[i] * (2.0 * weight * l * dl - 2.0 * bend * l * l)
                + h * slopes[i] * (l * l + 2.0 * off * l * dl);
        }
        (value, slope / h)
    }
}

struct Quadrature<'a> {
    motion: &'a Motion,
    nodes: &'a [f64],
    /// Weights of the slopes in the integral up to each node, per unit length.
    rises: Vec<Vec<f64>>,
    /// Replaces the size of each state where that is smaller.
    least: Vec<f64>,
}

impl Quadrature<'_> {
    /// Returns the largest local error of any state at a node of a segment, in units of its size there.
    fn error(&self, from: f64, to: f64) -> f64 {
        let (motion, m) = (self.motion, self.nodes.len());
        let places: Vec<(usize, f64)> = self
            .nodes
            .iter()
            .enumerate()
            .map(|(j, node)| {
                let t = if j + 1 == m { to } else { from + (to - from) * node };
                motion.place(t, j + 1 == m)
            })
            .collect();
        let of_state = |(i, least): (usize, &f64)| {
            let points: Vec<(f64, f64)> = places.iter().map(|(step, u)| motion.at(*step, *u, i)).collect();
            let size = points.iter().fold(*least, |l, p| l.max(p.0.abs()));
            let at_node = |(j, (x, _)): (usize, &(f64, f64))| {
                let rise: f64 = self.rises[j].iter().zip(&points).map(|(w, p)| w * p.1).sum();
                x - points[0].0 - (to - from) * rise
            };
            let error = largest(points.iter().enumerate().skip(1).map(at_node));
            if error > 0.0 { error / size } else { 0.0 } // a state that is 0 has no size
        };
        largest(self.least.iter().enumerate().map(of_state))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE: f64 = 3.0;

    /// x' = -3 x from 1, in 60 equal steps until t = 6.
    fn decay() -> Motion {
        let ends: Vec<f64> = (0..=60).map(|k| 0.1 * f64::from(k)).collect();
        let times: Vec<f64> = (0..=120).map(|k| 0.05 * f64::from(k)).collect();
        let x = |t: f64| (-RATE * t).exp();
        let slopes = times.windows(2).map(|w| [vec![-RATE * x(w[0])], vec![-RATE * x(w[1])]]).collect();
        Motion { ends, states: vec![times.iter().map(|t| x(*t)).collect()], times, slopes }
    }

    /// The largest local error of a segment, as a part of the state, from the exact solution.
    fn local_error(order: usize, from: f64, to: f64) -> f64 {
        let lgl = Lgl::new(order);
        let (h, x) = (to - from, |t: f64| (-RATE * t).exp());
        let slopes: Vec<f64> = lgl.nodes.iter().map(|node| -RATE * x(from + h * node)).collect();
        let of_node = |node: &f64| {
            let rise: f64 = lgl.integrate_to(0, *node).iter().zip(&slopes).map(|(w, f)| w * f).sum();
            (x(from + h * node) - x(from) - h * rise).abs() / x(from).max(SMALL)
        };
        lgl.nodes.iter().map(of_node).fold(0.0, f64::max)
    }

    #[test]
    fn segments_are_as_long_as_the_local_error_allows() {
        for (order, tolerance) in [(3, 1e-3), (4, 1e-3), (4, 1e-5), (5, 1e-6)] {
            let ends = decay().segments(order, tolerance, &[]);
            assert_eq!((ends[0], ends[ends.len() - 1]), (0.0, 6.0));
            for w in ends.windows(2) {
                assert!(local_error(order, w[0], w[1]) <= 1.01 * tolerance, "order {order}, {w:?}");
            }
            // One step of the integration more would be too long, where a segment is not the last one.
            for w in ends[..ends.len() - 1].windows(2).filter(|w| w[1] - w[0] > 0.099) {
                assert!(local_error(order, w[0], w[1] + 0.1) > 0.99 * tolerance, "order {order}, {w:?}");
            }
        }
    }

    #[test]
    fn a_step_that_is_too_long_is_divided_and_fixed_times_are_kept() {
        let fine = decay().segments(2, 1e-4, &[]);
        assert!(fine.windows(2).any(|w| w[1] - w[0] < 0.09), "{fine:?}");
        let motion = decay();
        let fixed = [motion.ends[7], motion.ends[31]];
        let ends = motion.segments(6, 1e-2, &fixed);
        assert!(fixed.iter().all(|t| ends.contains(t)), "{ends:?}");
        assert!(ends.len() < 20, "{ends:?}");
    }
}
