//! One part of a group's equations: eliminated segment by segment, and solved with.

use std::ops::Range;

use super::chain::ChainPlan;
use super::lu::{eliminate, solve, solve_transposed};
use super::part::{Part, PartPlan};
use super::shape::Shape;
use super::vectors::{axpy, copy_rows, dot, for_vectors, sum_rows};

/// A part of a group, with all that its elimination keeps.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    /// E: a row of sensitivities for each own row.
    e: Vec<f64>,
    /// LU of M: a row of d for each own row, reciprocals of the pivots on the diagonal.
    lu: Vec<f64>,
    pivots: Vec<u16>,
    /// The panel in which a segment is eliminated.
    panel: Vec<f64>,
    /// Sensitivities of the last state, and of the own points of the last segment.
    pub z: Vec<f64>,
    pub next: Vec<f64>,
    /// 0 for the columns of states, 1 for those of θ.
    mask: Vec<f64>,
    /// The start of a solution: states and θ, padded.
    start: Vec<f64>,
    /// The effect of later points on the states before them, and on θ.
    pub bent: Vec<f64>,
    v: Vec<f64>,
}

/// The common data of all pieces of a group: its segments, and the own row of its first.
#[derive(Clone, Copy)]
pub(super) struct Along<'a> {
    pub shape: &'a Shape,
    pub plan: &'a ChainPlan,
    pub segments: &'a Range<usize>,
    pub row: usize,
}

impl Along<'_> {
    /// Points before a segment, within the group.
    #[inline(always)]
    fn point(&self, s: usize) -> usize {
        self.plan.point(s) - self.plan.point(self.segments.start)
    }

    /// Own rows of a segment, within the group.
    #[inline(always)]
    pub fn rows(&self, s: usize) -> Range<usize> {
        let n = self.shape.n;
        self.point(s) * n..self.point(s + 1) * n
    }

    /// Returns the rows of a part, numbered through.
    #[inline(always)]
    fn part_rows(&self, part: &Part, s: usize) -> Range<usize> {
        let own = part.states.len();
        self.point(s) * own..self.point(s + 1) * own
    }
}

impl Piece {
    pub fn new(part: &Part, points: usize, segments: usize, total: usize, most: usize) -> Piece {
        let (n, d) = (part.states.len(), part.rows(points));
        Piece {
            e: vec![0.0; total * n * part.width],
            lu: vec![0.0; total * n * d],
            pivots: vec![0; segments * d],
            panel: vec![0.0; most * n * part.panel(points)],
            z: vec![0.0; n * part.width],
            next: vec![0.0; most * n * part.width],
            mask: (0..part.width).map(|j| f64::from(u8::from(j >= n))).collect(),
            start: vec![0.0; part.width],
            bent: vec![0.0; part.width],
            v: vec![0.0; most * n],
        }
    }

    /// Sensitivities at the start of a group: [I 0].
    #[inline(always)]
    pub fn restart(&mut self, part: &Part) {
        self.z.fill(0.0);
        (0..part.states.len()).for_each(|i| self.z[i * part.width + i] = 1.0);
    }

    /// Eliminates a segment, the i-th of the group, and follows the sensitivities; a row of the part that
    /// depends on others where that cannot be.
    #[inline(always)]
    pub fn factorize(
        &mut self,
        part: &Part,
        plan: &PartPlan,
        along: Along<'_>,
        (i, s): (usize, usize),
        jacobian: &[f64],
    ) -> Result<(), usize> {
        let (n, width, d) = (part.states.len(), part.width, part.rows(along.plan.chain.points));
        let own = along.part_rows(part, s);
        let (rows, length) = (own.len(), plan.columns.len());
        let panel = &mut self.panel[..rows * length];
        panel.fill(0.0);
        for (entry, place) in plan.jacobian.of(s) {
            panel[place] += jacobian[entry];
        }
        for point in panel.chunks_exact_mut(n * length) {
            for (row, unit) in point.chunks_exact_mut(length).zip(&plan.rows) {
                for (x, c) in row.iter_mut().zip(&plan.columns) {
                    *x *= unit * c;
                }
            }
        }
        let pivots = &mut self.pivots[i * d..(i + 1) * d];
        let e = &mut self.e[own.start * width..own.end * width];
        let lu = &mut self.lu[own.start * d..own.end * d];
        for_vectors!(length / 8, eliminate(panel, d, width, lu, pivots))?;
        for_vectors!(width / 8, copy_rows(e, width, &panel[length - width..], length));
        // Sensitivities of the own points: Y = E_x Z + [0 E_θ].
        let next = &mut self.next[..rows * width];
        for_vectors!(width / 8, follow(n, width, e, &self.z, &self.mask, next));
        self.z.copy_from_slice(&next[(d - n) * width..d * width]);
        Ok(())
    }

    /// Largest sensitivity of the last state to the start of the group.
    #[inline(always)]
    pub fn growth(&self, part: &Part) -> f64 {
        let mut growth = 0.0;
        for row in self.z.chunks_exact(part.width) {
            let own = &row[..part.states.len()];
            own.iter().for_each(|x| growth = if x.abs() > growth { x.abs() } else { growth });
        }
        growth
    }

    /// Particular solution: the own variables for right-hand sides q of the chain's rows and a start of zero.
    #[inline(always)]
    pub fn forward(&mut self, part: &Part, along: Along<'_>, q: &[f64], y: &mut [f64], at_end: &mut [f64]) {
        let (n, width, d) = (part.states.len(), part.width, part.rows(along.plan.chain.points));
        self.start.fill(0.0);
        for (i, s) in along.segments.clone().enumerate() {
            let (all, own) = (along.rows(s), along.part_rows(part, s));
            let v = &mut self.v[..own.len()];
            gather(&part.states, along.shape.n, &q[along.row + all.start..along.row + all.end], v);
            let (e, m) = (&self.e[own.start * width..], &self.lu[own.start * d..own.end * d]);
            solve(m, own.len(), d, &self.pivots[i * d..(i + 1) * d], v);
            for (y, e) in v.iter_mut().zip(e.chunks_exact(width)) {
                for (e, x) in e[..n].iter().zip(&self.start) {
                    *y = e.mul_add(*x, *y);
                }
            }
            self.start[..n].copy_from_slice(&v[d - n..d]);
            scatter(&part.states, along.shape.n, v, &mut y[all]);
        }
        part.states.iter().zip(&self.start).for_each(|(&s, x)| at_end[s] = *x);
    }

    /// Backwards: what v on the own variables leaves on the start of the group and on θ, in `bent`.
    #[inline(always)]
    pub fn backward(&mut self, part: &Part, along: Along<'_>, all_v: &[f64]) {
        let (n, width, d) = (part.states.len(), part.width, part.rows(along.plan.chain.points));
        self.bent.fill(0.0);
        for s in along.segments.clone().rev() {
            let own = along.part_rows(part, s);
            let v = &mut self.v[..own.len()];
            gather(&part.states, along.shape.n, &all_v[along.rows(s)], v);
            v[d - n..d].iter_mut().zip(&self.bent).for_each(|(v, x)| *v += x);
            self.bent[..n].fill(0.0);
            let e = &self.e[own.start * width..];
            for (v, e) in v.iter().zip(e.chunks_exact(width)) {
                axpy::<0>(&mut self.bent, *v, e);
            }
        }
    }

    /// Adds to a particular solution what the group's start and θ make of it.
    #[inline(always)]
    pub fn expand(&mut self, part: &Part, along: Along<'_>, a: &[f64], theta: &[f64], y: &mut [f64]) {
        let (n, width, d) = (part.states.len(), part.width, part.rows(along.plan.chain.points));
        self.start.fill(0.0);
        self.start.iter_mut().zip(&part.states).for_each(|(x, &s)| *x = a[s]);
        for (x, &p) in self.start[n..].iter_mut().zip(&part.dynamic) {
            *x = theta[along.shape.dynamic[p]];
        }
        for s in along.segments.clone() {
            let (all, own) = (along.rows(s), along.part_rows(part, s));
            let v = &mut self.v[..own.len()];
            let e = &self.e[own.start * width..];
            for (v, e) in v.iter_mut().zip(e.chunks_exact(width)) {
                *v = dot(e, &self.start);
            }
            self.start[..n].copy_from_slice(&v[d - n..d]);
            if n == along.shape.n {
                y[all].iter_mut().zip(&*v).for_each(|(y, v)| *y += v);
                continue;
            }
            for (y, v) in y[all].chunks_exact_mut(along.shape.n).zip(v.chunks_exact(n)) {
                part.states.iter().zip(v).for_each(|(&s, v)| y[s] += v);
            }
        }
    }

    /// Multipliers of the own rows, in place of v on the own variables, from that of the group's end.
    #[inline(always)]
    pub fn multipliers(&mut self, part: &Part, along: Along<'_>, at_end: &[f64], all_v: &mut [f64]) {
        let (n, width, d) = (part.states.len(), part.width, part.rows(along.plan.chain.points));
        self.bent.iter_mut().zip(&part.states).for_each(|(b, &s)| *b = at_end[s]);
        for (i, s) in along.segments.clone().enumerate().rev() {
            let (all, own) = (along.rows(s), along.part_rows(part, s));
            let v = &mut self.v[..own.len()];
            gather(&part.states, along.shape.n, &all_v[all.clone()], v);
            v[d - n..d].iter_mut().zip(&self.bent).for_each(|(v, x)| *v += x);
            self.bent[..n].fill(0.0);
            let (e, m) = (&self.e[own.start * width..], &self.lu[own.start * d..own.end * d]);
            for (v, e) in v.iter().zip(e.chunks_exact(width)) {
                for (b, e) in self.bent[..n].iter_mut().zip(e) {
                    *b = v.mul_add(*e, *b);
                }
            }
            solve_transposed(m, own.len(), d, &self.pivots[i * d..(i + 1) * d], v);
            scatter(&part.states, along.shape.n, v, &mut all_v[all]);
        }
    }
}

/// The rows of some states among all of them.
#[inline(always)]
fn gather(states: &[usize], n: usize, from: &[f64], to: &mut [f64]) {
    if states.len() == n {
        return to.copy_from_slice(from);
    }
    for (to, from) in to.chunks_exact_mut(states.len()).zip(from.chunks_exact(n)) {
        to.iter_mut().zip(states).for_each(|(t, &s)| *t = from[s]);
    }
}

/// And back.
#[inline(always)]
fn scatter(states: &[usize], n: usize, from: &[f64], to: &mut [f64]) {
    if states.len() == n {
        return to.copy_from_slice(from);
    }
    for (to, from) in to.chunks_exact_mut(n).zip(from.chunks_exact(states.len())) {
        from.iter().zip(states).for_each(|(f, &s)| to[s] = *f);
    }
}

/// Y = E_x Z + [0 E_θ], row by row.
#[inline(always)]
fn follow<const V: usize>(n: usize, width: usize, e: &[f64], z: &[f64], mask: &[f64], next: &mut [f64]) {
    for (y, e) in next.chunks_exact_mut(width).zip(e.chunks_exact(width)) {
        sum_rows::<V>(y, (mask, e), &e[..n], z, width);
    }
}
