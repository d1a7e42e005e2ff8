//! The unit of work: consecutive segments whose points fill one block of lanes.
//!
//! Lanes are laid out node by node, not point by point: lane(j, s) = j·(S+1) + s for node j of
//! segment s. What a segment combines from its nodes then runs over contiguous lanes for all its
//! segments at once, whatever the order of the rule. The end point of a chunk is the first of the
//! next: it is evaluated in both, one point in about 64 more.
//!
//! Where inputs jump between segments ([`Mesh::jumps`]), f has two values at a point where two segments meet. Such a
//! chunk has lanes for the last node of each segment too, lane(j, s) = j·S + s, and shares no lane with the next.

use std::sync::Arc;

use crate::index::{ExperimentId, PointId};
use crate::mesh::{Between, Mesh, Rule};
use crate::problem::layout::Layout;
use crate::tape::{BLOCK, LANE_MULTIPLE};

#[derive(Clone, Debug)]
pub(super) struct Chunk {
    pub(super) experiment: ExperimentId,
    pub(super) rule: Arc<Rule>,
    /// Lengths of the S segments, s.
    pub(super) h: Vec<f64>,
    /// Length of the segment before the first, where there is one in the experiment.
    pub(super) h_before: Option<f64>,
    /// Whether the last segment ends the experiment, or shares no lane with the next.
    pub(super) last: bool,
    /// Whether the last node of a segment has lanes of its own.
    pub(super) jumps: bool,
    /// Point of each lane, counted over all experiments. Spare lanes repeat a point.
    pub(super) points: Vec<u32>,
    /// First vector constraint.
    pub(super) row: usize,
    /// Samples between mesh points, their segment counted within the chunk.
    pub(super) between: Vec<Tie>,
    /// Ties in the segment before the first: they weigh f at this chunk's first point.
    pub(super) between_before: Vec<Tie>,
    /// Data columns of the dynamics at each lane, column by column.
    pub(super) data: Vec<f64>,
    /// First entry of the Jacobian.
    pub(super) jacobian: usize,
    /// Number of its entries.
    pub(super) jacobian_entries: usize,
    /// First entry of the Hessian.
    pub(super) hessian: usize,
}

/// The constraint of a sample between mesh points.
#[derive(Clone, Debug)]
pub(super) struct Tie {
    pub(super) segment: usize,
    pub(super) node: usize,
    pub(super) weights: Vec<f64>,
    /// The sample's point, counted over all experiments.
    pub(super) point: PointId,
    pub(super) row: usize,
}

/// Segments of a full chunk: a multiple of eight where the order allows it, so that loops over
/// segments have no rest.
pub fn segments_in_chunk(order: usize) -> usize {
    let most = (BLOCK / (order - 1)).saturating_sub(1).max(1);
    if most >= LANE_MULTIPLE { most - most % LANE_MULTIPLE } else { most }
}

impl Chunk {
    /// Cuts the mesh of an experiment into chunks. `data` and the first entries are filled later.
    pub(super) fn cut(experiment: ExperimentId, mesh: &Mesh, layout: &Layout) -> Vec<Chunk> {
        let (k, jumps) = (mesh.rule.order() - 1, mesh.jumps);
        let size = segments_in_chunk(mesh.rule.order() + usize::from(jumps));
        let (point0, row0) = (layout.first_point[experiment], layout.first_row(experiment));
        let mut chunks: Vec<Chunk> = Vec::new();
        let mut between = mesh.between.iter().peekable();
        for (i, segments) in mesh.segments.chunks(size).enumerate() {
            let (first, n) = (i * size, segments.len());
            let mut chunk = Chunk {
                experiment,
                rule: mesh.rule.clone(),
                h: segments.iter().map(|s| s.h).collect(),
                h_before: first.checked_sub(1).filter(|_| !jumps).map(|p| mesh.segments[p].h),
                last: jumps || first + n == mesh.segments.len(),
                jumps,
                points: Vec::new(),
                row: row0 + first * k,
                between: Vec::new(),
                between_before: Vec::new(),
                data: Vec::new(),
                jacobian: 0,
                jacobian_entries: 0,
                hessian: 0,
            };
            for j in 0..k + usize::from(jumps) {
                for s in 0..n + usize::from(!jumps) {
                    // Only node 0 has an (S+1)-th place: the end point.
                    let s = if j == 0 { s } else { s.min(n - 1) };
                    chunk.points.push((point0 + segments[0].point + s * k + j).0 as u32);
                }
            }
            let spare = *chunk.points.last().unwrap();
            chunk.points.resize(chunk.points.len().next_multiple_of(LANE_MULTIPLE), spare);
            while let Some(tie) = between.next_if(|b| b.segment < first + n) {
                chunk.between.push(tied(tie, first, point0, row0));
            }
            if let Some(before) = chunks.last().filter(|_| !jumps) {
                let ties = before.between.iter().filter(|t| t.segment + 1 == before.segments());
                chunk.between_before = ties.cloned().collect();
            }
            chunks.push(chunk);
        }
        chunks
    }

    /// Number of segments, S.
    pub(super) fn segments(&self) -> usize {
        self.h.len()
    }

    /// Number of lanes.
    pub(super) fn lanes(&self) -> usize {
        self.points.len()
    }

    /// First lane of node j; lanes of the S segments follow. The last node is the next segment's first, unless inputs
    /// jump between them.
    #[inline(always)]
    pub(super) fn lane(&self, j: usize) -> usize {
        match j + 1 == self.rule.order() {
            _ if self.jumps => j * self.segments(),
            true => 1,
            false => j * (self.segments() + 1),
        }
    }

    /// Segment of the chunk to which each lane belongs where inputs jump; spare lanes repeat the last.
    pub(super) fn segment_of_lanes(&self) -> impl Iterator<Item = usize> + '_ {
        let (n, last) = (self.segments(), self.segments() * self.rule.order() - 1);
        (0..self.lanes()).map(move |lane| lane.min(last) % n)
    }

    /// C[j,k] and first lane of every node j: what constraint k combines.
    #[inline(always)]
    pub(super) fn terms(&self, k: usize) -> impl Iterator<Item = (f64, usize)> + Clone + '_ {
        (0..self.rule.order()).map(move |j| (self.rule.c(j, k), self.lane(j)))
    }

    /// Runs of lanes whose points belong to this chunk: the end point belongs to the next one.
    pub(super) fn own(&self) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        let (n, nodes) = (self.segments(), self.rule.order() - usize::from(!self.jumps));
        (0..nodes).map(move |j| {
            let start = self.lane(j);
            start..start + n + usize::from(j == 0 && self.last && !self.jumps)
        })
    }

    /// Number of points that belong to this chunk.
    pub(super) fn n_own(&self) -> usize {
        self.own().map(|r| r.len()).sum()
    }
}

/// The vector constraint of the sample at point p of its experiment is number p − 1 within it, as
/// for mesh points.
fn tied(b: &Between, first_segment: usize, point0: PointId, row0: usize) -> Tie {
    Tie {
        segment: b.segment - first_segment,
        node: b.node,
        weights: b.weights.clone(),
        point: point0 + b.point,
        row: row0 + b.point - 1,
    }
}
