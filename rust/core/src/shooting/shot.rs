//! The integrated path: segment by segment, and as states and outputs over time.

use super::Shooting;
use super::pieces::{by_width, integrate_group};
use crate::index::{ConstraintId, ExperimentId, PointId, StateId};
use crate::integrate::flow::Memory;
use crate::nlp::NotFinite;
use crate::problem::boundary::Boundary;
use crate::problem::layout::{ConstraintPlace, Layout};
use crate::problem::posed::Posed;
use crate::problem::transcribed::Transcribed;

/// One segment as integrated.
pub(super) struct Shot {
    pub(super) x: Vec<f64>,
    pub(super) data: Vec<f64>,
    pub(super) n_x: usize,
    pub(super) columns: usize,
    pub(super) stages: usize,
}

impl Shot {
    /// States at a point.
    pub(super) fn state(&self, point: usize) -> &[f64] {
        &self.x[point * self.n_x..][..self.n_x]
    }

    /// Time and inputs at a point.
    pub(super) fn data(&self, point: usize) -> &[f64] {
        &self.data[point * self.columns..][..self.columns]
    }
}

impl Shooting {
    /// Integrates the segments of an experiment and hands each lane's states over: segment, states at the points
    /// (`[point·n_x + state]`), times of the points and inputs there (`[point][column]`).
    pub(super) fn shoot(&self, xi: &[f64], experiment: ExperimentId, mut see: impl FnMut(usize, Shot)) {
        let uniforms = self.uniforms_of(&self.posed.f.value, xi);
        let mut m = Memory::default();
        let mut segment = 0;
        for group in self.groups.iter().filter(|g| g.experiment == experiment) {
            by_width!(group, integrate_group(self, group, xi, &uniforms, &mut m));
            let (w, n_x, columns) = (group.width, self.layout.n_x, self.posed.f.n_data);
            for lane in 0..group.n {
                let own = |v: &[f64]| v.iter().skip(lane).step_by(w).copied().collect::<Vec<f64>>();
                let (x, data) = (own(&m.points.x), own(&group.data));
                see(segment, Shot { x, data, n_x, columns, stages: self.tableau.b.len() });
                segment += 1;
            }
        }
    }
}

impl Transcribed for Shooting {
    fn posed(&self) -> &Posed {
        &self.posed
    }

    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn boundary_states(&self) -> Vec<StateId> {
        self.boundary.as_ref().map_or_else(Vec::new, Boundary::all_states)
    }

    fn path_constraint_name(&self, of: ConstraintPlace) -> String {
        let ConstraintPlace { experiment: e, row, state } = of;
        let (t, name) = (self.nodes[e][row + 1], &self.posed.state_names[state]);
        format!("continuity of {name} at t = {t} of '{}'", self.posed.experiments[e].name)
    }

    fn condition_name(&self, i: ConstraintId) -> String {
        self.boundary.as_ref().map_or_else(String::new, |b| b.name(i, &self.posed.experiments))
    }

    fn why_not_finite(&self, xi: &[f64]) -> Option<String> {
        self.explained(xi)
    }

    fn point_times(&self, experiment: ExperimentId) -> &[f64] {
        &self.nodes[experiment]
    }

    fn states_at_samples(&self, xi: &[f64], experiment: ExperimentId) -> Vec<Vec<f64>> {
        let points = self.sampled.first_point[experiment].0..self.sampled.first_point[experiment + 1].0;
        let zeta = self.integrate(xi);
        let path = |r: usize| {
            let at = |point| zeta.as_ref().map_or(f64::NAN, |z| z[self.sampled.state(point) + r]);
            points.clone().map(PointId).map(at).collect()
        };
        (0..self.layout.n_x).map(path).collect()
    }

    fn outputs_at_samples(&self, xi: &[f64], experiment: ExperimentId) -> Vec<Vec<f64>> {
        match self.integrate(xi) {
            Ok(zeta) => self.objective.outputs(&self.posed, &self.sampled, &zeta, experiment),
            Err(NotFinite) => {
                let record = &self.posed.experiments[experiment];
                vec![vec![f64::NAN; record.t.len()]; record.outputs.len()]
            }
        }
    }

    fn path(&self, xi: &[f64], experiment: ExperimentId) -> (Vec<f64>, Vec<Vec<f64>>) {
        let track = &self.tracks[experiment];
        let samples = &self.posed.experiments[experiment].t;
        // A single segment with steps from sample to sample is the path that the likelihood was computed from.
        if let [ends] = &track.segments[..]
            && ends == samples
        {
            return (samples.clone(), self.states_at_samples(xi, experiment));
        }
        let (mut times, mut path) = (Vec::new(), vec![Vec::new(); self.layout.n_x]);
        self.shoot(xi, experiment, |s, shot| {
            let ends = &track.segments[s];
            // Where segments meet, the later one's start.
            let n = ends.len() - usize::from(s + 1 < track.segments.len());
            times.extend(&ends[..n]);
            for i in 0..n {
                let x = shot.state(i * shot.stages);
                path.iter_mut().zip(x).for_each(|(path, x)| path.push(*x));
            }
        });
        (times, path)
    }
}
