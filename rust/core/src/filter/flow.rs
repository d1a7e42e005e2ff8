//! Φ(z), the solution of the state equations from a sample to the next by states and noises z = (x, ε), with its exact
//! first and second derivatives: those of the steps of [`integrate`](crate::integrate).

use super::noises::{Driven, LANES};
use crate::error::Error;
use crate::integrate::flow::{self, Memory};
use crate::integrate::group::{Group, Lane};
use crate::integrate::tableau::Tableau;
use crate::interrupt::current;
use crate::tape::{Function, Pairs, Tape};

/// The state equations with their derivatives, compiled.
#[derive(Clone, Debug)]
pub(super) struct Flow {
    /// The noises are states without a slope: constants of an interval. It is linear in them, and they do not meet the
    /// states there.
    f: Function,
    tableau: Tableau,
    /// Parameters of the model: the first ones.
    p: usize,
}

/// The linearisation of all intervals of a record.
#[derive(Clone, Debug, Default)]
pub(super) struct Linear {
    /// Φ, of n.
    pub(super) end: Vec<f64>,
    /// Φ_z, of (n, n + m).
    pub(super) b: Vec<f64>,
    /// Φ_θ by the model's parameters, of (n, p), where asked for.
    pub(super) by_p: Vec<f64>,
    /// Σ_i λ_i ∂²Φ_i/∂z², of (n + m, n + m); empty without λ.
    pub(super) curvature: Vec<f64>,
}

/// The quantities that are computed beside Φ and Φ_z.
pub(super) enum Beside<'a> {
    /// The second derivatives with these weights λ.
    Curvature(&'a [f64]),
    /// The derivatives by the model's parameters.
    Parameters,
}

impl Flow {
    /// `p` is the number of the model's own parameters among those of `driven`.
    pub(super) fn new(driven: &Driven, p: usize, tableau: Tableau) -> Result<Flow, Error> {
        let f = Function::new(driven.graph.clone(), &driven.arguments, driven.f.clone(), Pairs::Absent)?;
        Ok(Flow { f, tableau, p })
    }

    fn n(&self) -> usize {
        self.f.roots.len()
    }

    /// Number of noises.
    fn m(&self) -> usize {
        self.f.n_states - self.n()
    }

    fn of<'a>(&'a self, group: &'a Group, n_p: usize) -> flow::Flow<'a> {
        flow::Flow { f: &self.f, tableau: &self.tableau, group, n_p }
    }

    fn uniforms(&self, tape: &Tape, theta: &[f64]) -> Vec<f64> {
        let mut out = Vec::new();
        tape.uniforms(theta, &mut out);
        out
    }

    /// States and noises of the intervals of a group.
    fn own<'a>(&self, group: &Group, x: &'a [f64], e: &'a [f64]) -> (&'a [f64], &'a [f64]) {
        let of = |all: &'a [f64], size: usize| &all[group.node.0 * size..][..group.n * size];
        (of(x, self.n()), of(e, self.m()))
    }

    /// Φ from the states at all samples but the last, rows of n, and the noises, rows of m; None where it is not finite,
    /// or the interrupt in force stops it.
    pub(super) fn ends(
        &self,
        theta: &[f64],
        groups: &[Group],
        x: &[f64],
        e: &[f64],
        memory: &mut Memory,
    ) -> Option<Vec<f64>> {
        let mut out = Vec::new();
        let uniforms = self.uniforms(&self.f.value, theta);
        let interrupt = current();
        for group in groups {
            let (flow, (x, e)) = (self.of(group, 0), self.own(group, x, e));
            if interrupt.stops() || !flow.forward::<LANES>(x, e, &uniforms, memory) {
                return None;
            }
            self.add_ends::<LANES>(&flow, memory, &mut out);
        }
        Some(out)
    }

    /// Appends the states at the ends of a group's intervals, rows of n.
    fn add_ends<const W: usize>(&self, flow: &flow::Flow<'_>, memory: &Memory, out: &mut Vec<f64>) {
        let end = &memory.points.x[flow.at_step(flow.group.steps) * W..];
        for Lane(lane) in flow.group.lanes() {
            out.extend(end.iter().skip(lane).step_by(W));
        }
    }

    /// The states of a whole record from the first, with noises: N of n. They are not finite from where a solution is
    /// not.
    pub(super) fn along(&self, theta: &[f64], groups: &[Group], first: &[f64], e: &[f64]) -> Vec<f64> {
        let (mut out, mut memory) = (first.to_vec(), Memory::default());
        let uniforms = self.uniforms(&self.f.value, theta);
        for (group, lane) in groups.iter().flat_map(|g| g.lanes().map(move |lane| (g, lane))) {
            let alone = group.alone(lane);
            let (flow, (x, e)) = (self.of(&alone, 0), self.own(&alone, &out, e));
            flow.forward::<1>(x, e, &uniforms, &mut memory);
            self.add_ends::<1>(&flow, &memory, &mut out);
        }
        out
    }

    /// Φ with its first derivatives, and what is wanted beside; None where something is not finite, or the interrupt in
    /// force stops it.
    pub(super) fn linearise(
        &self,
        theta: &[f64],
        groups: &[Group],
        x: &[f64],
        e: &[f64],
        beside: &Beside<'_>,
        memory: &mut Memory,
    ) -> Option<Linear> {
        let (n, width) = (self.n(), self.f.n_states);
        let p = if matches!(beside, Beside::Parameters) { self.p } else { 0 };
        let tapes = [&self.f.value, &self.f.jacobian, &self.f.hessian];
        let uniforms = tapes.map(|tape| self.uniforms(tape, theta));
        let mut out = Linear::default();
        let interrupt = current();
        for group in groups {
            let (flow, (x, e)) = (self.of(group, p), self.own(group, x, e));
            let done = !interrupt.stops()
                && flow.forward::<LANES>(x, e, &uniforms[0], memory)
                && flow.linearise::<LANES>(&uniforms[1], memory)
                && flow.sensitivities::<LANES>(memory);
            if !done {
                return None;
            }
            self.add_ends::<LANES>(&flow, memory, &mut out.end);
            for lane in group.lanes() {
                let slope = flow.end::<LANES>(lane, memory);
                for r in 0..n {
                    out.b.extend((0..width).map(|c| slope(r, c)));
                    out.by_p.extend((width..width + p).map(|c| slope(r, c)));
                }
            }
            let Beside::Curvature(lambda) = beside else { continue };
            memory.sums.clear();
            memory.sums.resize(width * width * LANES, 0.0);
            if !self.f.hessian_pattern.is_empty() {
                let end = |lane: Lane, r: usize| lambda[group.node_of(lane).0 * n + r];
                let done = flow.backward::<LANES>(memory, |_, _| 0.0, end)
                    && flow.curvature::<LANES>(&uniforms[2], width, memory);
                if !done {
                    return None;
                }
            }
            for Lane(lane) in group.lanes() {
                let entry = |i: usize, j: usize| memory.sums[(i.max(j) * width + i.min(j)) * LANES + lane];
                out.curvature.extend((0..width * width).map(|at| entry(at / width, at % width)));
            }
        }
        Some(out)
    }
}
