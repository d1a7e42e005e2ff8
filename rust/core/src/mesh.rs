//! The mesh of one experiment: segments, their Lobatto points, and where the samples lie.

use std::sync::Arc;

use crate::error::Error;
use crate::experiment::Experiment;
use crate::lgl::Lgl;

/// The division of an experiment into segments (Eq. multiple_shooting_grid).
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Grid {
    /// Every interval between samples is divided into this many segments.
    Samples(usize),
    /// This many segments of equal length, whatever the sample times.
    Uniform(usize),
    /// Segments between these times, which start and end with the record.
    Edges(Vec<f64>),
}

impl Grid {
    /// The grid of each experiment: one for all, or one each.
    pub(crate) fn for_each(grids: &[Grid], experiments: usize) -> Result<impl Iterator<Item = &Grid>, Error> {
        let count = grids.len();
        if count != 1 && count != experiments {
            return Err(Error::option(format!(
                "{count} grids for {experiments} experiments; give one, or one each"
            )));
        }
        Ok((0..experiments).map(move |e| &grids[e.min(count - 1)]))
    }
}

/// A Lobatto rule with its integration matrix.
#[derive(Clone, Debug)]
pub struct Rule {
    /// Nodes and weights.
    pub lgl: Lgl,
    /// `C[j,k]`, m × (m − 1), row-major (Eq. coll_integral_defn), per unit segment length.
    pub c: Vec<f64>,
}

impl Rule {
    /// The rule of an order.
    pub fn new(order: usize) -> Self {
        let lgl = Lgl::new(order);
        let c = lgl.integration_matrix();
        Rule { lgl, c }
    }

    /// Number of points of a segment, m.
    pub fn order(&self) -> usize {
        self.lgl.order
    }

    /// `C[j,k]`.
    #[inline(always)]
    pub fn c(&self, j: usize, k: usize) -> f64 {
        self.c[j * (self.lgl.order - 1) + k]
    }
}

/// One segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Start, s.
    pub t: f64,
    /// Length, s.
    pub h: f64,
    /// Its first point; it has m points, the last of which is the first of the next segment.
    pub point: usize,
}

/// A sample time that is no mesh point. The state there is a decision variable too, tied to the
/// segment by x(t) = x_k + Σ_j f_j ∫_{τ_k}^{t} λ_j: the dense output of the collocation polynomial,
/// so the samples cost no accuracy and f is still evaluated at mesh points alone.
#[derive(Clone, Debug, PartialEq)]
pub struct Between {
    /// Its point (after all mesh points).
    pub point: usize,
    /// Its segment.
    pub segment: usize,
    /// Node k on its left.
    pub node: usize,
    /// Integrals of λ_j from node k to the sample, times the segment's length.
    pub weights: Vec<f64>,
}

/// The mesh of one experiment. Points are counted from 0 within it.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// The rule of all segments.
    pub rule: Arc<Rule>,
    /// Segments, in time order.
    pub segments: Vec<Segment>,
    /// Times of all points, s: mesh points in order, then samples between them.
    pub times: Vec<f64>,
    /// Number of mesh points, m_points ≤ times.len().
    pub n_mesh: usize,
    /// Samples between mesh points.
    pub between: Vec<Between>,
    /// Point of each sample.
    pub sample_points: Vec<usize>,
    /// Whether inputs may jump where segments meet: a point there then has two values of f, one for each segment.
    pub jumps: bool,
}

/// Times closer than this fraction of a segment are the same time.
const SAME: f64 = 1e-9;

impl Mesh {
    /// The mesh of order m for sample times `t` (strictly increasing, at least two).
    ///
    /// # Errors
    /// For an order below 2, no segments, edges that do not span the record, or samples so close that
    /// they would share a point.
    pub fn new(order: usize, grid: &Grid, t: &[f64]) -> Result<Mesh, Error> {
        Mesh::between(order, &edges(grid, t)?, t)
    }

    /// The mesh of order m for a record. Segments also end where an input that is held between its samples jumps.
    ///
    /// # Errors
    /// As [`Mesh::new`].
    pub fn of(order: usize, grid: &Grid, record: &Experiment) -> Result<Mesh, Error> {
        let edges = divided(edges(grid, &record.t)?, &record.jumps());
        Ok(Mesh { jumps: record.any_held(), ..Mesh::between(order, &edges, &record.t)? })
    }

    fn between(order: usize, edges: &[f64], t: &[f64]) -> Result<Mesh, Error> {
        if !(2..=64).contains(&order) {
            return Err(Error::option(format!("collocation order {order}: choose 2 (trapezoid) to 64")));
        }
        let segments = edges.len() - 1;
        if segments.saturating_mul(order - 1) > MOST {
            return Err(Error::option(format!(
                "{segments} segments of order {order} have more than {MOST} points in a record; choose fewer, or a \
                 lower order"
            )));
        }
        let rule = Arc::new(Rule::new(order));
        let mut times = Vec::with_capacity((edges.len() - 1) * (order - 1) + 1);
        let mut segments = Vec::with_capacity(edges.len() - 1);
        for w in edges.windows(2) {
            let h = w[1] - w[0];
            segments.push(Segment { t: w[0], h, point: times.len() });
            times.extend(rule.lgl.nodes[..order - 1].iter().map(|x| w[0] + h * x));
        }
        times.push(edges[edges.len() - 1]);
        let n_mesh = times.len();
        let (between, sample_points) = (Vec::new(), Vec::new());
        let mut mesh = Mesh { rule, segments, times, n_mesh, between, sample_points, jumps: false };
        mesh.place_samples(t);
        // In time order, so that two samples at one point stand side by side.
        if let Some(i) = mesh.sample_points.windows(2).position(|w| w[0] == w[1]) {
            return Err(Error::data(format!(
                "the samples at t = {} and {} are too close together for the mesh; drop one of them",
                t[i],
                t[i + 1]
            )));
        }
        Ok(mesh)
    }

    fn place_samples(&mut self, t: &[f64]) {
        let order = self.rule.order();
        let mut s = 0;
        for &time in t {
            while s + 1 < self.segments.len() && time >= self.segments[s + 1].t - SAME * self.segments[s].h {
                s += 1;
            }
            let segment = self.segments[s];
            let place = (time - segment.t) / segment.h;
            let nodes = &self.rule.lgl.nodes;
            if let Some(j) = nodes.iter().position(|x| (x - place).abs() <= SAME) {
                self.sample_points.push(segment.point + j);
                continue;
            }
            let node = nodes[..order - 1].iter().rposition(|&x| x <= place).unwrap_or(0);
            let weights = self.rule.lgl.integrate_to(node, place).iter().map(|w| w * segment.h).collect();
            let point = self.times.len();
            self.times.push(time);
            self.sample_points.push(point);
            self.between.push(Between { point, segment: s, node, weights });
        }
    }

    /// Number of points, samples between mesh points among them.
    pub fn len(&self) -> usize {
        self.times.len()
    }

    /// Never: a mesh has at least two points.
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// Number of vector constraints: one for every point but the first.
    pub fn rows(&self) -> usize {
        self.times.len() - 1
    }
}

/// Most points of the mesh, segments or steps of a record: their states alone take gigabytes.
pub(crate) const MOST: usize = 10_000_000;
/// Returns the segments divided where one of these times (in order) lies within.
pub(crate) fn divided(edges: Vec<f64>, at: &[f64]) -> Vec<f64> {
    let mut out = Vec::with_capacity(edges.len() + at.len());
    for w in edges.windows(2) {
        let slack = SAME * (w[1] - w[0]);
        out.push(w[0]);
        let first = at.partition_point(|t| *t <= w[0] + slack);
        for &t in at[first..].iter().take_while(|t| **t < w[1] - slack) {
            if t > out[out.len() - 1] + slack {
                out.push(t);
            }
        }
    }
    out.extend(edges.last());
    out
}

/// Ends of the segments of a division.
pub(crate) fn edges(grid: &Grid, t: &[f64]) -> Result<Vec<f64>, Error> {
    let (first, last) = (t[0], t[t.len() - 1]);
    match grid {
        Grid::Samples(0) | Grid::Uniform(0) => {
            Err(Error::option("the mesh needs at least one segment; choose 1 or more".into()))
        }
        Grid::Samples(n) if n.saturating_mul(t.len() - 1) > MOST => Err(Error::option(format!(
            "{n} segments in each of {} intervals between samples: a record has at most {MOST} segments; choose fewer",
            t.len() - 1
        ))),
        Grid::Uniform(n) if *n > MOST => Err(Error::option(format!(
            "{n} equal segments: a record has at most {MOST} segments; choose fewer"
        ))),
        Grid::Samples(substeps) => {
            let mut edges = Vec::with_capacity((t.len() - 1) * substeps + 1);
            for w in t.windows(2) {
                let h = (w[1] - w[0]) / *substeps as f64;
                edges.extend((0..*substeps).map(|i| w[0] + h * i as f64));
            }
            edges.push(last);
            Ok(edges)
        }
        Grid::Uniform(n) => {
            let mut edges: Vec<f64> =
                (0..*n).map(|i| first + (last - first) * i as f64 / *n as f64).collect();
            edges.push(last);
            Ok(edges)
        }
        Grid::Edges(edges) => {
            let span = last - first;
            let fits = edges.len() >= 2
                && (edges[0] - first).abs() <= SAME * span
                && (edges[edges.len() - 1] - last).abs() <= SAME * span;
            if !fits {
                return Err(Error::option(format!(
                    "segment edges must start at the first sample ({first}) and end at the last ({last})"
                )));
            }
            if let Some(i) = edges.windows(2).position(|w| w[0].is_nan() || w[1].is_nan() || w[0] >= w[1]) {
                return Err(Error::option(format!("segment edges must increase; edge {} does not", i + 1)));
            }
            let mut edges = edges.clone();
            edges[0] = first;
            *edges.last_mut().expect("two edges") = last;
            Ok(edges)
        }
    }
}
