//! A group of consecutive segments: its interior is eliminated segment by segment.
//!
//! Segment s with own variables y determines them: M y = q − N x − B θ, x the last states of the
//! segment before. With E = −M⁻¹[N B], y = E [x; θ] + M⁻¹q. So all points of a group are affine in
//! the states at its start, a, and in θ: sensitivities Z. The group is then a *form*: a quadratic
//! function of (a, b, θ), b the states at its end, with the one constraint b = X a + T θ + z.
//!
//! Where the dynamics fall into parts, so do M, E and Z, and each [part](super::part) is eliminated by
//! itself; the Hessian brings them together.
//!
//! Nothing is lost this way as long as X stays small: errors grow with it. Where it passes
//! [`GROWTH`], as in an unstable system it must, the group ends, and another begins.

use std::ops::Range;

use super::chain::ChainPlan;
use super::form::{Form, Side};
use super::piece::{Along, Piece};
use super::products::Products;
use super::run::Run;
use super::shape::Shape;
use super::vectors::axpy;
use crate::index::ConstraintId;
use crate::interrupt::Interrupt;
use crate::linalg::KktError;
use crate::simd::kernel;
use crate::tape::lanes::all_finite;

/// Greatest sensitivity of the end of a group to its start, in units of the states.
pub(super) const GROWTH: f64 = 100.0;

/// Operations, about, between two looks at the interrupt.
const ASK: usize = 100_000;

/// Consecutive segments of a chain, with all that their elimination keeps.
#[derive(Clone, Debug)]
pub(super) struct Group {
    pub segments: Range<usize>,
    /// Own row, within the chain, of the first segment.
    row: usize,
    pieces: Vec<Piece>,
    /// Entries of the Hessian in units, panel by panel, and where those of each panel start.
    values: Vec<f64>,
    starts: Vec<usize>,
    pub form: Form,
    pub side: Side,
    /// Own variables: particular solution, then solution.
    pub y: Vec<f64>,
    /// Multipliers of own rows; on the way to them, what stands right of Mᵀ λ.
    pub lambda: Vec<f64>,
    /// The block of the coupled border.
    cross: Vec<f64>,
    /// Segments before which the growth passed the limit, at the last factorisation.
    pub splits: Vec<usize>,
}

/// The data that a group needs from outside.
#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub shape: &'a Shape,
    pub plan: &'a ChainPlan,
}

impl Group {
    pub fn new(context: &Context<'_>, segments: Range<usize>) -> Group {
        let (shape, plan) = (context.shape, context.plan);
        let (n, points) = (shape.n, plan.chain.points);
        let row = plan.row(segments.start, n);
        let rows = plan.row(segments.end, n) - row;
        let most = segments.clone().map(|s| plan.points(s)).max().unwrap_or(0);
        let mut starts = vec![0];
        for panel in panels(&segments) {
            starts.push(starts[starts.len() - 1] + plan.factors(panel).len());
        }
        let piece = |part| Piece::new(part, points, segments.len(), rows / n, most);
        Group {
            row,
            pieces: shape.parts.iter().map(piece).collect(),
            values: vec![0.0; starts[starts.len() - 1]],
            starts,
            form: Form::new(shape),
            side: Side::new(shape),
            y: vec![0.0; rows],
            lambda: vec![0.0; rows],
            cross: vec![0.0; shape.coupled.len()],
            splits: Vec::new(),
            segments,
        }
    }

    /// Eliminates the interior; an own row of the chain that depends on others where it cannot.
    pub fn factorize(
        &mut self,
        context: &Context<'_>,
        products: &mut Products,
        hessian: &[f64],
        jacobian: &[f64],
        interrupt: &Interrupt,
    ) -> Result<(), KktError> {
        self.splits.clear();
        factorize(self, context, products, hessian, jacobian, interrupt)?;
        self.form.put_together(context.shape, &self.pieces, products);
        Ok(())
    }

    /// Calls `each` for all entries of the Hessian that are not zero: the first own variable of their point
    /// in the chain, `None` for the chain's first point, what they are, and their values.
    #[inline]
    pub fn curvature(&self, context: &Context<'_>, mut each: impl FnMut(Option<usize>, &Run, &[f64])) {
        let n = context.shape.n;
        for (panel, start) in panels(&self.segments).zip(&self.starts) {
            let own = panel.checked_sub(1).map(|s| context.plan.row(s, n));
            for (run, values) in Run::with(context.plan.runs(panel), &self.values[*start..]) {
                each(own.map(|row| row + run.point as usize * n), run, values);
            }
        }
    }

    /// The right-hand side of the form for a right-hand side of the system: `p` and `q` hold those of
    /// the chain's own variables and rows, `first` that of its first point; all in units.
    pub fn reduce(&mut self, context: &Context<'_>, p: &[f64], q: &[f64], first: &[f64]) {
        reduce(self, context, p, q, first);
    }

    /// Own variables and multipliers of the group once its start, θ and the constraint's multiplier are
    /// known.
    pub fn expand(&mut self, context: &Context<'_>, a: &[f64], theta: &[f64], p: &[f64]) {
        expand(self, context, a, theta, p);
    }
}

/// Panels of the Hessian of some segments: the chain's first point comes before the first.
fn panels(segments: &Range<usize>) -> Range<usize> {
    segments.start + usize::from(segments.start > 0)..segments.end + 1
}

kernel! {
    fn factorize(
        g: &mut Group,
        context: &Context<'_>,
        products: &mut Products,
        hessian: &[f64],
        jacobian: &[f64],
        interrupt: &Interrupt,
    ) -> Result<(), KktError> {
        let (shape, plan) = (context.shape, context.plan);
        let ask = 1 + ASK / (1 + shape.form() * shape.form());
        let n = shape.n;
        let along = Along { shape, plan, segments: &g.segments, row: g.row };
        restart(shape, &mut g.pieces);
        products.clear();
        let mut starts = g.starts.iter();
        let mut bend = |panel: usize, values: &mut [f64]| {
            let (start, factors) = (*starts.next().expect("one for each panel"), plan.factors(panel));
            let own = start..start + factors.len();
            let values = &mut values[own.clone()];
            values.fill(0.0);
            for (entry, place) in plan.hessian.of(panel) {
                values[place] += hessian[entry];
            }
            values.iter_mut().zip(factors).for_each(|(v, f)| *v *= f);
            own
        };
        if g.segments.start == 0 {
            let own = bend(0, &mut g.values);
            products.add(shape, plan.runs(0), &g.values[own], &g.pieces, |piece| &piece.z);
        }
        for (i, s) in g.segments.clone().enumerate() {
            if i % ask == 0 && interrupt.stops() {
                return Err(KktError::Stopped);
            }
            let mut growth: f64 = 0.0;
            for (p, (part, piece)) in shape.parts.iter().zip(&mut g.pieces).enumerate() {
                if let Err(row) = piece.factorize(part, &plan.parts[p], along, (i, s), jacobian) {
                    return Err(KktError::Dependent { row: ConstraintId(plan.row(s, n) + part.row(row, n)) });
                }
                if !all_finite(&piece.z) {
                    return Err(KktError::NotFinite);
                }
                growth = growth.max(piece.growth(part));
            }
            let own = bend(s + 1, &mut g.values);
            products.add(shape, plan.runs(s + 1), &g.values[own], &g.pieces, |piece| &piece.next);
            if growth > GROWTH && s + 1 < g.segments.end {
                g.splits.push(s + 1);
                restart(shape, &mut g.pieces);
            }
        }
        products.flush(shape);
        Ok(())
    }
}

/// Sensitivities at the start of a group.
#[inline(always)]
fn restart(shape: &Shape, pieces: &mut [Piece]) {
    shape.parts.iter().zip(pieces).for_each(|(part, piece)| piece.restart(part));
}

kernel! {
    fn reduce(g: &mut Group, context: &Context<'_>, p: &[f64], q: &[f64], first: &[f64]) {
        let (shape, plan) = (context.shape, context.plan);
        let n = shape.n;
        let segments = g.segments.clone();
        let along = Along { shape, plan, segments: &segments, row: g.row };
        for (part, piece) in shape.parts.iter().zip(&mut g.pieces) {
            piece.forward(part, along, q, &mut g.y, &mut g.side.c);
        }
        // Backwards: what the own points leave on the states before them, and on θ.
        g.side.p.fill(0.0);
        g.cross.fill(0.0);
        pull(g, plan, n, p, |cross, values, y, _| axpy::<0>(cross, -y, values));
        let (ends, theta) = g.side.p.split_at_mut(2 * n);
        for (part, piece) in shape.parts.iter().zip(&mut g.pieces) {
            piece.backward(part, along, &g.lambda);
            let (states, dynamic) = piece.bent.split_at(part.states.len());
            part.states.iter().zip(states).for_each(|(&s, x)| ends[s] = *x);
            part.dynamic.iter().zip(dynamic).for_each(|(&d, x)| theta[shape.dynamic[d]] += x);
        }
        if g.segments.start == 0 {
            ends[..n].iter_mut().zip(first).for_each(|(b, p)| *b += p);
        }
        for (x, &b) in g.cross.iter().zip(&shape.coupled) {
            theta[b] += x;
        }
    }
}

/// v = p − H y of the own points, in place of their multipliers. What couples with the border is left to `across`:
/// its part of the border, the values, and y and v of the state.
#[inline(always)]
fn pull(
    g: &mut Group,
    plan: &ChainPlan,
    n: usize,
    p: &[f64],
    across: impl Fn(&mut [f64], &[f64], f64, &mut f64),
) {
    g.lambda.copy_from_slice(&p[g.row..g.row + g.y.len()]);
    let own = usize::from(g.segments.start == 0);
    for (panel, start) in panels(&g.segments).zip(&g.starts).skip(own) {
        let row = plan.row(panel - 1, n) - g.row;
        for (run, values) in Run::with(plan.runs(panel), &g.values[*start..]) {
            let point = row + run.point as usize * n;
            if run.coupled {
                let state = point + run.state as usize;
                across(&mut g.cross[run.others()], values, g.y[state], &mut g.lambda[state]);
            } else {
                less_curvature(run, values, &g.y[point..point + n], &mut g.lambda[point..point + n]);
            }
        }
    }
}

/// v −= H y of a point, for entries of a row of the lower triangle of H.
#[inline(always)]
fn less_curvature(run: &Run, values: &[f64], y: &[f64], v: &mut [f64]) {
    let i = run.state as usize;
    for (j, value) in run.others().zip(values) {
        v[i] = (-value).mul_add(y[j], v[i]);
        if i != j {
            v[j] = (-value).mul_add(y[i], v[j]);
        }
    }
}

kernel! {
    fn expand(g: &mut Group, context: &Context<'_>, a: &[f64], theta: &[f64], p: &[f64]) {
        let (shape, plan) = (context.shape, context.plan);
        let n = shape.n;
        let segments = g.segments.clone();
        let along = Along { shape, plan, segments: &segments, row: g.row };
        for (x, &b) in g.cross.iter_mut().zip(&shape.coupled) {
            *x = theta[b];
        }
        // The particular solution plus what a and θ make of it.
        for (part, piece) in shape.parts.iter().zip(&mut g.pieces) {
            piece.expand(part, along, a, theta, &mut g.y);
        }
        pull(g, plan, n, p, |cross, values, _, v| {
            *v -= values.iter().zip(cross).map(|(value, x)| value * *x).sum::<f64>();
        });
        for (part, piece) in shape.parts.iter().zip(&mut g.pieces) {
            piece.multipliers(part, along, &g.side.multiplier, &mut g.lambda);
        }
    }
}
