//! The contribution of a group of segments to each function of a shooting problem: the group is integrated, and its
//! states, slopes and curvatures go to their places.

use super::Shooting;
use crate::index::ExperimentId;
use crate::integrate::adjoint::{Sizes, congruence};
use crate::integrate::flow::Memory;
use crate::integrate::group::{Group, Lane};
use crate::interrupt::current;
use crate::problem::disjoint::Disjoint;
use crate::tape::BLOCK;

/// Calls a method of a group for its number of lanes.
macro_rules! by_width {
    ($group:expr, $call:ident ( $($arg:expr),* )) => {
        if $group.width == 1 { $call::<1>($($arg),*) } else { $call::<{ $crate::integrate::group::WIDE }>($($arg),*) }
    };
}

pub(super) use by_width;

/// Uniform values of a tape, one list an experiment; a single one where they do not differ.
pub(super) type Uniforms = Vec<Vec<f64>>;

/// Number of entries of a lower triangle of n rows; where row n starts.
pub(super) fn triangle(n: usize) -> usize {
    n * (n + 1) / 2
}

pub(super) fn of<'a>(uniforms: &'a Uniforms, group: &Group) -> &'a [f64] {
    &uniforms[if uniforms.len() > 1 { group.experiment.0 } else { 0 }]
}

pub(super) fn integrate_group<const W: usize>(
    p: &Shooting,
    group: &Group,
    xi: &[f64],
    uniforms: &Uniforms,
    m: &mut Memory,
) -> bool {
    p.flow(group).forward::<W>(p.start(group, xi), &[], of(uniforms, group), m)
}

/// Integrates, and writes the states at the samples.
pub(super) fn states_at<const W: usize>(
    p: &Shooting,
    group: &Group,
    xi: &[f64],
    uniforms: &Uniforms,
    m: &mut Memory,
    out: &Disjoint<'_>,
) -> bool {
    let finite = integrate_group::<W>(p, group, xi, uniforms, m);
    for sample in &group.samples {
        // SAFETY: a sample belongs to one group.
        let x = unsafe { out.part(p.sampled.state(sample.point).0, p.layout.n_x) };
        p.flow(group).state::<W>(sample, m, |r, v| x[r] = v);
    }
    finite
}

/// Integrates and writes the defects at the ends of segments.
pub(super) fn defects_of<const W: usize>(
    p: &Shooting,
    group: &Group,
    xi: &[f64],
    uniforms: &Uniforms,
    m: &mut Memory,
    out: &Disjoint<'_>,
) -> bool {
    let (finite, n_x) = (integrate_group::<W>(p, group, xi, uniforms, m), p.layout.n_x);
    let end = p.flow(group).at_step(group.steps) * W;
    for lane in 0..group.n - usize::from(group.last) {
        let next = p.layout.state(group.node + lane + 1);
        // SAFETY: the rows of groups do not overlap.
        let c = unsafe { out.part(p.row(group, Lane(lane)) * n_x, n_x) };
        (0..n_x).for_each(|r| c[r] = xi[next + r] - m.points.x[end + r * W + lane]);
    }
    finite
}

pub(super) fn linearised<const W: usize>(
    p: &Shooting,
    group: &Group,
    xi: &[f64],
    uniforms: &[Uniforms; 2],
    m: &mut Memory,
) -> bool {
    integrate_group::<W>(p, group, xi, &uniforms[0], m)
        && p.flow(group).linearise::<W>(of(&uniforms[1], group), m)
}

/// Entries of the Jacobian of the ends of segments.
pub(super) fn jacobian_of<const W: usize>(
    p: &Shooting,
    group: &Group,
    xi: &[f64],
    uniforms: &[Uniforms; 2],
    m: &mut Memory,
    out: &Disjoint<'_>,
) -> bool {
    if !linearised::<W>(p, group, xi, uniforms, m) {
        return false;
    }
    let flow = p.flow(group);
    if !flow.sensitivities::<W>(m) {
        return false;
    }
    let (n_x, n_q) = (p.layout.n_x, flow.n_q());
    let mut finite = true;
    for lane in 0..group.n - usize::from(group.last) {
        let row = p.row(group, Lane(lane));
        let size = n_x * (n_q + 1);
        // SAFETY: the rows of groups do not overlap.
        let entries = unsafe { out.part(row * size, size) };
        let s = flow.end::<W>(Lane(lane), m);
        for r in 0..n_x {
            let own = &mut entries[r * (n_q + 1)..][..n_q + 1];
            own[0] = 1.0;
            (0..n_q).for_each(|q| own[q + 1] = -s(r, q));
            finite &= own.iter().all(|v| v.is_finite());
        }
    }
    finite
}

/// Gradient with respect to the nodes, and sums of that with respect to parameters, from that at the samples.
pub(super) fn gradient_of<const W: usize>(
    p: &Shooting,
    group: &Group,
    (xi, at_samples): (&[f64], &[f64]),
    uniforms: &[Uniforms; 2],
    m: &mut Memory,
    out: &Disjoint<'_>,
    theta: &mut [f64],
) -> bool {
    if !linearised::<W>(p, group, xi, uniforms, m) {
        return false;
    }
    let flow = p.flow(group);
    if !flow.backward::<W>(m, |s, r| at_samples[p.sampled.state(s.point) + r], |_, _| 0.0) {
        return false;
    }
    flow.parameter_gradient::<W>(m, theta);
    let n_x = p.layout.n_x;
    // SAFETY: a node belongs to one group.
    let nodes = unsafe { out.part(group.node.0 * n_x, group.n * n_x) };
    for (i, g) in nodes.iter_mut().enumerate() {
        *g = m.ax[i % n_x * W + i / n_x];
    }
    nodes.iter().chain(theta.iter()).all(|v| v.is_finite())
}

/// The data of the second derivatives of groups.
pub(super) struct Second<'a> {
    pub(super) problem: &'a Shooting,
    pub(super) xi: &'a [f64],
    pub(super) uniforms: [Uniforms; 2],
    pub(super) curvature: Uniforms,
    /// The objective's, and its gradient, as a function of the states at the samples.
    pub(super) sampled: &'a [f64],
    pub(super) gradient: &'a [f64],
    pub(super) lambda: Option<&'a [f64]>,
    pub(super) out: Disjoint<'a>,
}

/// Entries of the Hessian at the nodes of a group, and sums of those between parameters.
pub(super) fn hessian_of<const W: usize>(
    job: &Second<'_>,
    group: &Group,
    m: &mut Memory,
    pairs: &mut [f64],
) -> bool {
    let p = job.problem;
    if !linearised::<W>(p, group, job.xi, &job.uniforms, m) {
        return false;
    }
    let flow = p.flow(group);
    if !flow.sensitivities::<W>(m) {
        return false;
    }
    let n_x = p.layout.n_x;
    let n_seen = p.posed.estimands.maps[ExperimentId(0)].len();
    let (n_q, n_all) = (flow.n_q(), n_x + n_seen);
    m.sums.clear();
    m.sums.resize(n_all * n_all * W, 0.0);
    m.own.clear();
    m.own.resize(n_all * n_all * W, 0.0);
    let mut finite = true;
    if let Some(lambda) = job.lambda {
        let multiplier = |lane: Lane, r: usize| {
            let follows = !(group.last && lane.0 + 1 == group.n);
            if follows { -lambda[p.row(group, lane) * n_x + r] } else { 0.0 }
        };
        let done = flow.backward::<W>(m, |s, r| job.gradient[p.sampled.state(s.point) + r], multiplier);
        finite &= done && flow.curvature::<W>(of(&job.curvature, group), n_all, m);
    }

    // The samples': those that couple with states; the others are between parameters already.
    let likelihood = &p.posed.likelihood;
    let pattern = || likelihood.hessian_pattern.iter().filter(|(_, c)| *c < n_x);
    let first_sample = p.sampled.first_point[group.experiment];
    let first_block = p.objective.samples.iter().position(|s| s.experiment == group.experiment);
    let mut turns = current().turns(n_x * n_q * (n_q + n_x));
    for sample in &group.samples {
        if turns.stop() {
            return false;
        }
        flow.sample_sensitivity::<W>(sample, m);
        let k = sample.point.0 - first_sample.0;
        let block = &p.objective.samples[first_block.unwrap_or(0) + k / BLOCK];
        let entry = |i: usize| job.sampled[block.hessian + i * block.n + k % BLOCK];
        let terms = pattern().enumerate().map(|(i, at)| (at, [entry(i)]));
        let own = &mut m.own[sample.lane.0 * n_all * n_all..][..n_all * n_all];
        let sizes = Sizes { x: n_x, q: n_q, all: n_all };
        congruence::<1>(terms, sizes, &m.sensitivity, &mut m.product, own);
    }

    let node_entries = triangle(n_x) + n_x * n_seen;
    for lane in 0..group.n {
        let value = |a: usize, b: usize| {
            let at = a * n_all + b;
            m.sums[at * W + lane] + m.own[lane * n_all * n_all + at]
        };
        // SAFETY: a node belongs to one group.
        let entries = unsafe { job.out.part((group.node + lane).0 * node_entries, node_entries) };
        let mut entry = entries.iter_mut();
        let mut put = |v: f64| *entry.next().expect("as many entries as in the structure") = v;
        for r in 0..n_x {
            (0..=r).for_each(|q| put(value(r, q)));
            (0..n_seen).for_each(|t| put(value(n_x + t, r)));
        }
        for r in 0..n_seen {
            (0..=r).for_each(|q| pairs[triangle(r) + q] += value(n_x + r, n_x + q));
        }
        finite &= entries.iter().all(|v| v.is_finite());
    }
    finite && pairs.iter().all(|v| v.is_finite())
}
