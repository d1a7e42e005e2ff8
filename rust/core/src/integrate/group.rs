//! Segments that are integrated side by side, and the pieces of memory that it takes.

use super::steps::{Place, Track, hermite};
use super::tableau::Tableau;
use crate::experiment::Experiment;
use crate::index::{ExperimentId, PointId};

/// Consecutive segments of an experiment, one a *lane*: W lanes. Stages are the *points*, s a step,
/// and one more where segments end. Where segments differ in steps, the shorter ones end with steps of no length.
#[derive(Clone, Debug)]
pub(crate) struct Group {
    pub(crate) experiment: ExperimentId,
    /// Lanes, W; those without a segment of their own repeat the last.
    pub(crate) width: usize,
    /// Number of segments.
    pub(crate) n: usize,
    /// Node at which the first starts, counted over all experiments.
    pub(crate) node: PointId,
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

/// One of the segments of a group, by its place among them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Lane(pub(crate) usize);

/// A sample of a group.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sampled {
    /// Its point, counted over all experiments.
    pub(crate) point: PointId,
    pub(crate) lane: Lane,
    pub(crate) step: usize,
    /// Weights of x and ẋ at the beginning of the step and at its end; `None` for x at the beginning.
    pub(crate) weights: Option<[f64; 4]>,
}

/// The place of the segments of an experiment among those of all.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Origin {
    /// Number of the experiment.
    pub(crate) experiment: ExperimentId,
    /// Its first node.
    pub(crate) node: PointId,
    /// Its first sample.
    pub(crate) sample: PointId,
    /// Whether no node follows its last segment.
    pub(crate) last: bool,
}

/// Lanes of a wide group: those of a vector.
pub(crate) const WIDE: usize = 8;
/// With fewer segments than this, lanes would mostly be idle.
const FEW: usize = 3;

impl Group {
    /// Lanes for so many segments: 1 or [`WIDE`].
    pub(crate) fn width(segments: usize) -> usize {
        if segments < FEW { 1 } else { WIDE }
    }

    /// Groups of so many lanes of the segments of an experiment.
    pub(crate) fn cut(
        origin: Origin,
        experiment: &Experiment,
        track: &Track,
        tableau: &Tableau,
        width: usize,
    ) -> Vec<Group> {
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
            // Samples stand in the order of their segments.
            let before = |segment: usize| track.samples.partition_point(|p: &Place| p.segment < segment);
            let own = before(first)..before(first + segments.len());
            let sampled = |k: usize| {
                let place = &track.samples[k];
                let lane = place.segment - first;
                let scaled = |share| {
                    let (w, h) = (hermite(share), h[place.step * width + lane]);
                    [w[0], w[1] * h, w[2], w[3] * h]
                };
                let weights = place.share.map(scaled);
                Sampled { point: origin.sample + k, lane: Lane(lane), step: place.step, weights }
            };
            let samples: Vec<Sampled> = own.map(sampled).collect();
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
                experiment: origin.experiment,
                width,
                n: segments.len(),
                node: origin.node + first,
                last: origin.last && first + segments.len() == track.segments.len(),
                steps,
                h,
                data,
                points: steps * stages + usize::from(samples.iter().any(|s| s.weights.is_some())),
                samples,
            });
        }
        groups
    }

    /// Appends a column for each function of point and lane, where steps have so many stages.
    pub(crate) fn append(&mut self, stages: usize, columns: &[impl Fn(usize, Lane) -> f64]) {
        let points = self.steps * stages + 1;
        let own = self.data.len() / points;
        let mut data = Vec::with_capacity(self.data.len() + points * columns.len() * self.width);
        for (point, before) in self.data.chunks_exact(own).enumerate() {
            data.extend(before);
            for value in columns {
                data.extend((0..self.width).map(|lane| value(point, Lane(lane))));
            }
        }
        self.data = data;
    }

    /// Its lanes that have a segment of their own.
    pub(crate) fn lanes(&self) -> impl Iterator<Item = Lane> + use<> {
        (0..self.n).map(Lane)
    }

    /// The node at which a segment starts.
    pub(crate) fn node_of(&self, lane: Lane) -> PointId {
        self.node + lane.0
    }

    /// One of its segments, on a single lane, without samples.
    pub(crate) fn alone(&self, lane: Lane) -> Group {
        let own = |v: &[f64]| v.iter().skip(lane.0).step_by(self.width).copied().collect();
        Group {
            width: 1,
            n: 1,
            node: self.node_of(lane),
            last: self.last && lane.0 + 1 == self.n,
            h: own(&self.h),
            data: own(&self.data),
            samples: Vec::new(),
            ..*self
        }
    }
}
