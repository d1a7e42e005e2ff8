//! Samples in blocks of lanes.

use super::layout::Layout;
use crate::index::ExperimentId;
use crate::tape::{BLOCK, LANE_MULTIPLE};

/// Consecutive samples of an experiment.
#[derive(Clone, Debug)]
pub(crate) struct Samples {
    pub(crate) experiment: ExperimentId,
    /// Number of samples; the lanes after them repeat the last.
    pub(crate) n: usize,
    /// Point of each lane, counted over all experiments.
    pub(crate) points: Vec<u32>,
    /// Data columns of the likelihood at each lane, column by column.
    pub(crate) data: Vec<f64>,
    /// First entry of the Hessian.
    pub(crate) hessian: usize,
}

impl Samples {
    /// Cuts the samples of an experiment, at these of its points, into blocks; `columns` are its data columns.
    pub(crate) fn cut(
        experiment: ExperimentId,
        points: &[usize],
        layout: &Layout,
        columns: &[Vec<f64>],
    ) -> Vec<Samples> {
        let point0 = layout.first_point[experiment];
        let mut blocks = Vec::new();
        for (i, points) in points.chunks(BLOCK).enumerate() {
            let (first, n) = (i * BLOCK, points.len());
            let lanes = n.next_multiple_of(LANE_MULTIPLE);
            let lane = |l: usize| l.min(n - 1);
            let mut data = Vec::with_capacity(columns.len() * lanes);
            for column in columns {
                data.extend((0..lanes).map(|l| column[first + lane(l)]));
            }
            let points = (0..lanes).map(|l| (point0 + points[lane(l)]).0 as u32).collect();
            blocks.push(Samples { experiment, n, points, data, hessian: 0 });
        }
        blocks
    }
}
