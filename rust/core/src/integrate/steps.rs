//! The segments of an experiment, their steps, and where its samples lie in them.

use crate::error::Error;
use crate::experiment::Experiment;
use crate::mesh::{Grid, MOST, divided, edges};

/// The division of segments into steps (Eq. multiple_shooting_mesh). In a record with inputs that are held between
/// their samples, steps also end where these jump and at the samples.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Steps {
    /// Steps from sample to sample, each interval in so many; they also end where a segment does.
    Samples(usize),
    /// A number of steps of equal length in each segment, independent of the sample times.
    Number(usize),
    /// Equal ones of at most this length, s, in each segment.
    Length(f64),
}

/// The steps of an experiment.
#[derive(Clone, Debug)]
pub(crate) struct Track {
    /// Times of the ends of steps, one list a segment; each starts where the one before ends.
    pub(crate) segments: Vec<Vec<f64>>,
    /// One a sample.
    pub(crate) samples: Vec<Place>,
}

/// The place of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    pub(crate) segment: usize,
    /// The step that it lies in, or begins; that after the last where it ends the segment.
    pub(crate) step: usize,
    /// Part of the step before it; `None` at its beginning.
    pub(crate) share: Option<f64>,
}

/// Times closer than this fraction of a step are the same time.
const SAME: f64 = 1e-9;

impl Track {
    /// # Errors
    /// For a division into segments that does not fit the record, or no steps.
    pub(crate) fn new(experiment: &Experiment, grid: &Grid, steps: &Steps) -> Result<Self, Error> {
        let t = &experiment.t;
        let sound = match *steps {
            Steps::Samples(n) | Steps::Number(n) => n > 0,
            Steps::Length(h) => h > 0.0 && h.is_finite(),
        };
        if !sound {
            return Err(Error::option(format!("{steps:?}: at least one step of positive length is needed")));
        }
        let edges = edges(grid, t)?;
        let count = match *steps {
            Steps::Samples(n) => n as f64 * (t.len() + edges.len()) as f64,
            Steps::Number(n) => n as f64 * (edges.len() - 1) as f64,
            Steps::Length(h) => (edges[edges.len() - 1] - edges[0]) / h + edges.len() as f64,
        };
        if count > MOST as f64 {
            return Err(Error::option(format!(
                "{steps:?}: experiment '{}' would have {count:.0} steps, at most {MOST} are allowed; choose \
                 fewer or longer ones",
                experiment.name
            ))
            .about(&experiment.name));
        }
        let ends = if experiment.any_held() { experiment.jumps() } else { Vec::new() };
        let segment = |w: &[f64]| {
            let parts =
                if experiment.any_held() { divided(divided(w.to_vec(), t), &ends) } else { w.to_vec() };
            let share = |part: &[f64]| (part[1] - part[0]) / (w[1] - w[0]);
            let mut out = Vec::new();
            for part in parts.windows(2) {
                out.pop();
                out.extend(divide(part[0], part[1], share(part), steps, t));
            }
            out
        };
        let segments: Vec<Vec<f64>> = edges.windows(2).map(segment).collect();
        let mut samples = Vec::with_capacity(t.len());
        let (mut s, mut i) = (0, 0);
        for &time in t {
            // A sample where two segments meet belongs to the later one, the last to the last.
            while s + 1 < segments.len() && time >= edges[s + 1] - SAME * (edges[s + 1] - edges[s]) {
                (s, i) = (s + 1, 0);
            }
            let ends = &segments[s];
            let near = |i: usize| SAME * (ends[i + 1] - ends[i]);
            while i + 1 < ends.len() && time >= ends[i + 1] - near(i) {
                i += 1;
            }
            let at_start = i + 1 == ends.len() || time <= ends[i] + near(i);
            let share = (!at_start).then(|| (time - ends[i]) / (ends[i + 1] - ends[i]));
            samples.push(Place { segment: s, step: i, share });
        }
        Ok(Track { segments, samples })
    }

    /// A segment from each of these times to the next, in so many equal steps, without samples.
    pub(crate) fn between(t: &[f64], steps: usize) -> Self {
        let segment = |w: &[f64]| divide(w[0], w[1], 1.0, &Steps::Number(steps), &[]);
        Track { segments: t.windows(2).map(segment).collect(), samples: Vec::new() }
    }

    /// Times at which segments start.
    pub(crate) fn starts(&self) -> Vec<f64> {
        self.segments.iter().map(|s| s[0]).collect()
    }
}

/// Ends of steps from a to b, which is this share of a segment.
fn divide(a: f64, b: f64, share: f64, steps: &Steps, t: &[f64]) -> Vec<f64> {
    let even = |from: f64, to: f64, n: usize, out: &mut Vec<f64>| {
        out.extend((0..n).map(|i| from + (to - from) * i as f64 / n as f64));
    };
    let mut out = Vec::new();
    match *steps {
        Steps::Number(n) => even(a, b, ((n as f64 * share * (1.0 - SAME)).ceil() as usize).max(1), &mut out),
        Steps::Length(h) => even(a, b, ((b - a) / h * (1.0 - SAME)).ceil().max(1.0) as usize, &mut out),
        Steps::Samples(n) => {
            let near = SAME * (b - a);
            let mut from = a;
            for &time in t.iter().filter(|&&time| time > a + near && time < b - near) {
                even(from, time, n, &mut out);
                from = time;
            }
            even(from, b, n, &mut out);
        }
    }
    out.push(b);
    out
}

/// Weights of x and h ẋ at the beginning of a step, then at its end, for the state at a part of it: the cubic
/// with these values and slopes.
pub(crate) fn hermite(share: f64) -> [f64; 4] {
    let (s, r) = (share, 1.0 - share);
    [(1.0 + 2.0 * s) * r * r, s * r * r, s * s * (3.0 - 2.0 * s), -s * s * r]
}
