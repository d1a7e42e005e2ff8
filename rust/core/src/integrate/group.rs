//! Segments that are integrated side by side, and the pieces of memory that it takes.

use super::steps::{Track, hermite};
use super::tableau::Tableau;
use crate::experiment::Experiment;

/// Consecutive segments of an experiment, one a *lane*: W lanes, 1 or [`WIDE`]. Stages are the *points*, s a step,
/// and one more where segments end. Where segments differ in steps, the shorter ones end with steps of no length.
#[derive(Clone, Debug)]
pub(crate) struct Group {
    pub(crate) experiment: usize,
    /// Lanes, W; those without a segment of their own repeat the last.
    pub(crate) width: usize,
    /// Number of segments.
    pub(crate) n: usize,
    /// Node at which the first starts, counted over all experiments.
    pub(crate) node: usize,
    /// Whether no node follows the last segment.
    pub(crate) last: bool,
    /// Number of steps.
    pub(crate) steps: usize,
    /// Length of a step, s: `h[step·W + lane]`.
    pub(crate) h: Vec<f64>,
    /// Time and inputs: `data[(point·columns + column)·W + lane]`.
    pub(crate) data: Vec<f64>,
    pub(crate) samples: Vec<Sampled>,
    /// Points at which f matters: the one at the end only for samples within steps.
    pub(crate) points: usize,
}

/// A sample of a group.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sampled {
    /// Which, counted over all experiments.
    pub(crate) index: usize,
    pub(crate) lane: usize,
    pub(crate) step: usize,
    /// Weights of x and ẋ at the beginning of the step and at its end; `None` for x at the beginning.
    pub(crate) weights: Option<[f64; 4]>,
}

/// Lanes of a wide group: those of a vector.
pub(crate) const WIDE: usize = 8;
/// With fewer segments than this, lanes would mostly be idle.
const FEW: usize = 3;

impl Group {
    /// Groups of an experiment, whose first node and first sample are given; `last` where no node follows the last
    /// segment.
    pub(crate) fn cut(
        e: usize,
        experiment: &Experiment,
        track: &Track,
        tableau: &Tableau,
        (node, sample): (usize, usize),
        last: bool,
    ) -> Vec<Group> {
        let width = if track.segments.len() < FEW { 1 } else { WIDE };
        let stages = tableau.b.len();
        let mut groups = Vec::new();
        for (g, segments) in track.segments.chunks(width).enumerate() {
            let first = g * width;
            let steps = segments.iter().map(|s| s.len() - 1).max().unwrap_or(0);
            let ends = |lane: usize, i: usize| {
                let s = &segments[lane.min(segments.len() - 1)];
                s[i.min(s.len() - 1)]
            };
            let h: Vec<f64> = (0..steps * width)
                .map(|at| ends(at % width, at / width + 1) - ends(at % width, at / width))
                .collect();
            let mut samples = Vec::new();
            for (k, place) in track.samples.iter().enumerate() {
                if (first..first + segments.len()).contains(&place.segment) {
                    let lane = place.segment - first;
                    let scaled = |share| {
                        let (w, h) = (hermite(share), h[place.step * width + lane]);
                        [w[0], w[1] * h, w[2], w[3] * h]
                    };
                    let weights = place.share.map(scaled);
                    samples.push(Sampled { index: sample + k, lane, step: place.step, weights });
                }
            }
            let times: Vec<f64> = (0..(steps * stages + 1) * width)
                .map(|at| {
                    let (point, lane) = (at / width, at % width);
                    let (i, j) = (point / stages, point % stages);
                    // To the bit where steps end: an input may have no value a hair beyond.
                    match tableau.c.get(j) {
                        _ if i == steps => ends(lane, i),
                        Some(c) if (c - 1.0).abs() < 1e-12 => ends(lane, i + 1),
                        Some(c) => ends(lane, i) + c * h[i * width + lane],
                        None => unreachable!("as many times as stages"),
                    }
                })
                .collect();
            // The step that each time belongs to; the end of the last to none.
            let spans: Vec<[f64; 2]> = (0..times.len())
                .map(|at| [0, 1].map(|end| ends(at % width, at / width / stages + end)))
                .collect();
            let mut columns = vec![times.clone()];
            columns.extend((0..experiment.inputs.len()).map(|c| experiment.input_over(c, &times, &spans)));
            let mut data = Vec::with_capacity(columns.len() * times.len());
            for point in 0..=steps * stages {
                columns.iter().for_each(|c| data.extend(&c[point * width..(point + 1) * width]));
            }
            groups.push(Group {
                experiment: e,
                width,
                n: segments.len(),
                node: node + first,
                last: last && first + segments.len() == track.segments.len(),
                steps,
                h,
                data,
                points: steps * stages + usize::from(samples.iter().any(|s| s.weights.is_some())),
                samples,
            });
        }
        groups
    }
}
