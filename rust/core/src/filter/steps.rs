//! Steps of the classical Runge-Kutta method of order 4 over the intervals between samples, in lanes.

use super::block::{Block, Loaded};
use super::noises::legendre;
use crate::experiment::Experiment;
use crate::tape::Workspace;

/// Weight of each stage in the step, and how far the point of a stage lies along the slope of the one before.
pub(super) const WEIGHTS: [f64; 4] = [1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0];
pub(super) const REACH: [f64; 4] = [0.0, 0.5, 0.5, 1.0];

/// Intervals of a record: step lengths and data at the nodes of the steps.
#[derive(Clone, Debug)]
pub(super) struct Intervals {
    /// Lengths, s.
    pub(super) h: Vec<f64>,
    /// Time, inputs, and the polynomials of the noise over √h: [node][column][interval], three nodes a substep. An
    /// input that is held and jumps inside a substep is its mean there.
    nodes: Vec<Vec<Vec<f64>>>,
    substeps: usize,
}

impl Intervals {
    pub(super) fn new(experiment: &Experiment, substeps: usize, terms: usize) -> Self {
        let t = &experiment.t;
        let pairs = || t.windows(2);
        let share = |node: usize| node as f64 / (2 * substeps) as f64;
        let time = |w: &[f64], node: usize| {
            if node == 2 * substeps { w[1] } else { w[0] + share(node) * (w[1] - w[0]) }
        };
        let at = |of_step: usize| {
            let (substep, node) = (of_step / 3, 2 * (of_step / 3) + of_step % 3);
            let spans: Vec<[f64; 2]> =
                pairs().map(|w| [time(w, 2 * substep), time(w, 2 * substep + 2)]).collect();
            let times: Vec<f64> = pairs().map(|w| time(w, node)).collect();
            let inputs = (0..experiment.inputs.len()).map(|c| experiment.input_over(c, &times, &spans));
            let inputs: Vec<Vec<f64>> = inputs.collect();
            let mut columns = [vec![times], inputs].concat();
            let scaled = |value: f64| pairs().map(|w| value / (w[1] - w[0]).sqrt()).collect();
            columns.extend(legendre(share(node), terms).into_iter().map(scaled));
            columns
        };
        Intervals {
            h: pairs().map(|w| w[1] - w[0]).collect(),
            nodes: (0..3 * substeps).map(at).collect(),
            substeps,
        }
    }

    /// Data of the four stages of a substep.
    pub(super) fn stages(&self, block: &Block, substep: usize) -> [Vec<f64>; 4] {
        [0, 1, 1, 2].map(|node| block.cut(&self.nodes[3 * substep + node]))
    }

    /// Length of a substep on each lane.
    pub(super) fn steps(&self, block: &Block) -> Vec<f64> {
        let h = block.gather(&self.h, 1);
        h.into_iter().map(|h| h / self.substeps as f64).collect()
    }
}

/// Runge-Kutta steps of a system over an interval, from columns of lanes; `keep` is given the points of the four
/// stages of every step.
pub(super) fn forward(
    slope_of: &Loaded<'_>,
    intervals: &Intervals,
    block: &Block,
    mut x: Vec<f64>,
    constants: &[f64],
    workspace: &mut Workspace,
    mut keep: impl FnMut([Vec<f64>; 4]),
) -> Vec<f64> {
    let steps = intervals.steps(block);
    let mut slope = vec![0.0; x.len()];
    for substep in 0..intervals.substeps {
        let data = intervals.stages(block, substep);
        let mut total = x.clone();
        let mut points = <[Vec<f64>; 4]>::default();
        for stage in 0..4 {
            let mut point = x.clone();
            if stage > 0 {
                add_scaled(&mut point, &slope, &steps, REACH[stage]);
            }
            slope_of.run(workspace, block.lanes, &[&data[stage], &point, constants], &mut slope);
            add_scaled(&mut total, &slope, &steps, WEIGHTS[stage]);
            points[stage] = point;
        }
        keep(points);
        x = total;
    }
    x
}

/// to += factor · scale · from, with one scale a lane, for columns of lanes.
pub(super) fn add_scaled(to: &mut [f64], from: &[f64], scale: &[f64], factor: f64) {
    for (to, from) in to.chunks_exact_mut(scale.len()).zip(from.chunks_exact(scale.len())) {
        for ((t, f), s) in to.iter_mut().zip(from).zip(scale) {
            *t += factor * s * f;
        }
    }
}
