//! Collocation as a nonlinear program: values, derivatives and names of its variables and constraints.

use std::ops::Range;

use super::Collocation;
use super::chunk::Chunk;
use super::defects::Job;
use crate::index::{ConstraintId, ExperimentId, StateId, VariableId};
use crate::nlp::{Chains, Nlp, NotFinite, Reach, Structure};
use crate::problem::boundary::Boundary;
use crate::problem::disjoint::Disjoint;
use crate::problem::layout::{ConstraintPlace, Layout};
use crate::problem::objective::add;
use crate::problem::posed::Posed;
use crate::problem::transcribed::Transcribed;
use crate::tape::{Tape, Workspace};
use crate::threads::Threads;

impl Nlp for Collocation {
    fn n(&self) -> usize {
        self.layout.n()
    }

    fn m(&self) -> usize {
        self.layout.m() + self.boundary.as_ref().map_or(0, Boundary::rows)
    }

    fn bounds(&self) -> (Vec<f64>, Vec<f64>) {
        self.posed.bounds_of(self.n())
    }

    fn objective(&self, xi: &[f64]) -> Result<f64, NotFinite> {
        self.objective.value(&self.posed, &self.layout, xi)
    }

    fn gradient(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.objective.gradient(&self.posed, &self.layout, xi, out)
    }

    fn constraints(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.at_ends(|b, problem| b.values(problem, xi, out))?;
        self.defects(xi, |_| true, out)
    }

    fn constraints_within(&self, xi: &[f64], rows: &[Range<usize>], out: &mut [f64]) {
        let _ = self.at_ends(|b, problem| b.values(problem, xi, out));
        let _ = self.defects(xi, |chunk| self.has_rows(chunk, rows), out);
    }

    fn jacobian_within(&self, xi: &[f64], rows: &[Range<usize>], out: &mut [f64]) {
        let _ = self.at_ends(|b, problem| b.jacobian(problem, xi, out));
        let _ = self.jacobian_of_chunks(xi, |chunk| self.has_rows(chunk, rows), out);
    }

    fn jacobian_structure(&self) -> &Structure {
        if let Some(structure) = self.jacobian_structure.get() {
            return structure;
        }
        // Not within `get_or_init`: a thread that waits for others there might take up work that asks for it again.
        let structure = self.jacobian_of_defects();
        self.jacobian_structure.get_or_init(|| structure)
    }

    fn jacobian(&self, xi: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        self.at_ends(|b, problem| b.jacobian(problem, xi, out))?;
        self.jacobian_of_chunks(xi, |_| true, out)
    }

    fn hessian_structure(&self) -> &Structure {
        &self.hessian_structure
    }

    fn hessian(&self, xi: &[f64], factor: f64, lambda: &[f64], out: &mut [f64]) -> Result<(), NotFinite> {
        // The others are written; those between parameters are added up.
        let first = self.first_pair;
        let (stored, between) = out.split_at_mut(first);
        between.fill(0.0);
        let shared = Disjoint::new(stored);
        let finite = self.posed.each(
            &self.chunks,
            (&self.dynamics.f.hessian, xi),
            self.pairs[ExperimentId(0)].len(),
            |chunk, uniforms, scratch, part| {
                let job = self.dynamics_job(chunk, xi, uniforms);
                job.hessian(&mut scratch.workspace, lambda, &shared, part, &mut scratch.weights)
            },
            |e, part| add(between, first, &self.pairs[e], part),
        );
        let finite = finite.and(self.objective.hessian(&self.posed, &self.layout, true, xi, factor, out));
        finite.and(self.at_ends(|b, problem| b.hessian(problem, xi, lambda, out)))
    }

    fn gauss_newton(&self, xi: &[f64], factor: f64, out: &mut [f64]) -> Result<(), NotFinite> {
        out.fill(0.0);
        self.objective.hessian(&self.posed, &self.layout, false, xi, factor, out)
    }

    fn chains(&self) -> Option<&Chains> {
        Some(&self.chains)
    }

    fn longest_step(&self, i: VariableId) -> f64 {
        self.posed.estimands.transforms.get(i).map_or(f64::INFINITY, |t| t.longest_step())
    }

    fn threads(&self) -> Threads {
        self.posed.threads.clone()
    }

    fn profiled(&self) -> Range<usize> {
        self.posed.profiled_noise()
    }

    fn profile(&self, xi: &[f64], gradient: &[f64], reach: &Reach<'_>, out: &mut [f64]) -> f64 {
        self.posed.profile_noise(xi, gradient, reach, out)
    }
}

impl Collocation {
    /// Evaluates the defects of some chunks.
    fn defects(
        &self,
        xi: &[f64],
        wanted: impl Fn(&Chunk) -> bool + Sync,
        out: &mut [f64],
    ) -> Result<(), NotFinite> {
        self.of_chunks((&self.dynamics.f.value, xi), wanted, out, |job, workspace, out| {
            job.defects(workspace, out)
        })
    }

    /// Evaluates the Jacobian of the defects of some chunks.
    fn jacobian_of_chunks(
        &self,
        xi: &[f64],
        wanted: impl Fn(&Chunk) -> bool + Sync,
        out: &mut [f64],
    ) -> Result<(), NotFinite> {
        self.of_chunks((&self.dynamics.f.jacobian, xi), wanted, out, |job, workspace, out| {
            job.jacobian(workspace, out)
        })
    }

    /// Does the job of each of some chunks, with a tape; what it returns says whether all is finite.
    fn of_chunks(
        &self,
        (tape, xi): (&Tape, &[f64]),
        wanted: impl Fn(&Chunk) -> bool + Sync,
        out: &mut [f64],
        work: impl Fn(&Job<'_>, &mut Workspace, &Disjoint<'_>) -> bool + Sync,
    ) -> Result<(), NotFinite> {
        let out = Disjoint::new(out);
        self.posed.each(
            &self.chunks,
            (tape, xi),
            0,
            |chunk, uniforms, scratch, _| {
                !wanted(chunk) || work(&self.dynamics_job(chunk, xi, uniforms), &mut scratch.workspace, &out)
            },
            |_, _| (),
        )
    }

    /// Returns whether some of these constraints are defects of a chunk.
    fn has_rows(&self, chunk: &Chunk, rows: &[Range<usize>]) -> bool {
        let n_x = self.layout.n_x;
        let own = chunk.row * n_x..(chunk.row + chunk.segments() * (chunk.rule.order() - 1)) * n_x;
        rows.iter().any(|r| r.start < own.end && own.start < r.end)
            || chunk.between.iter().any(|tie| rows.iter().any(|r| r.contains(&(tie.row * n_x))))
    }
}

impl Transcribed for Collocation {
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
        let (t, name) = (&self.meshes[e].times, &self.posed.state_names[state]);
        format!("defect of {name} ending at t = {} of '{}'", t[row + 1], self.posed.experiments[e].name)
    }

    fn condition_name(&self, i: ConstraintId) -> String {
        self.boundary.as_ref().map_or_else(String::new, |b| b.name(i, &self.posed.experiments))
    }

    fn why_not_finite(&self, xi: &[f64]) -> Option<String> {
        self.explained(xi)
    }

    fn point_times(&self, experiment: ExperimentId) -> &[f64] {
        &self.meshes[experiment].times
    }

    fn states_at_samples(&self, xi: &[f64], experiment: ExperimentId) -> Vec<Vec<f64>> {
        let (first, points) = (self.layout.first_point[experiment], &self.meshes[experiment].sample_points);
        let path = |r: usize| points.iter().map(|&p| xi[self.layout.state(first + p) + r]).collect();
        (0..self.layout.n_x).map(path).collect()
    }

    fn outputs_at_samples(&self, xi: &[f64], experiment: ExperimentId) -> Vec<Vec<f64>> {
        Collocation::outputs_at_samples(self, xi, experiment)
    }

    fn path(&self, xi: &[f64], experiment: ExperimentId) -> (Vec<f64>, Vec<Vec<f64>>) {
        let (first, mesh) = (self.layout.first_point[experiment], &self.meshes[experiment]);
        let path = |r: usize| (0..mesh.n_mesh).map(|p| xi[self.layout.state(first + p) + r]).collect();
        (mesh.times[..mesh.n_mesh].to_vec(), (0..self.layout.n_x).map(path).collect())
    }
}
