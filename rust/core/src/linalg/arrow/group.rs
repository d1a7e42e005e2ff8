//! A group of consecutive segments: its interior is eliminated segment by segment.
//!
//! Segment s with own variables y determines them: M y = q − N x − B θ, x the last states of the
//! segment before. With E = −M⁻¹[N B], y = E [x; θ] + M⁻¹q. So all points of a group are affine in
//! the states at its start, a, and in θ: sensitivities Z. The group is then a *form*: a quadratic
//! function of (a, b, θ), b the states at its end, with the one constraint b = X a + T θ + z.
//!
//! Nothing is lost this way as long as X stays small: errors grow with it. Where it passes
//! [`GROWTH`], as in an unstable system it must, the group ends, and another begins.

use std::ops::Range;

use super::dense::{axpy, copy_rows, dot, for_vectors, sum_rows};
use super::plan::{ChainPlan, Shape};
use super::products::Products;
use crate::simd::kernel;
use crate::tape::lanes::all_finite;

/// Greatest sensitivity of the end of a group to its start, in units of the states.
pub(super) const GROWTH: f64 = 100.0;

/// A quadratic function ½vᵀQv of v = (a, b, θ), with n constraints C_a a + C_b b + C_θ θ = c.
#[derive(Clone, Debug, Default)]
pub(super) struct Form {
    /// n × (2n + dynamic), row-major.
    pub c: Vec<f64>,
    /// (2n + B)², row-major.
    pub q: Vec<f64>,
}

/// The right-hand side of a form, and the solution.
#[derive(Clone, Debug, Default)]
pub(super) struct Side {
    /// c (n).
    pub c: Vec<f64>,
    /// What stands right of Q v + Cᵀ multiplier (2n + B).
    pub p: Vec<f64>,
    /// Multiplier of the constraint (n), after the solution is known.
    pub multiplier: Vec<f64>,
}

impl Form {
    pub fn new(shape: &Shape) -> Form {
        let f = shape.form();
        Form { c: vec![0.0; shape.n * (shape.n + shape.used())], q: vec![0.0; f * f] }
    }
}

impl Side {
    pub fn new(shape: &Shape) -> Side {
        Side { c: vec![0.0; shape.n], p: vec![0.0; shape.form()], multiplier: vec![0.0; shape.n] }
    }
}

/// Consecutive segments of a chain, with all that their elimination keeps.
#[derive(Clone, Debug)]
pub(super) struct Group {
    pub segments: Range<usize>,
    /// Own row, within the chain, of the first segment.
    row: usize,
    /// E: a row of sensitivities (width) for each own row.
    e: Vec<f64>,
    /// LU of M: a row of d for each own row, reciprocals of the pivots on the diagonal.
    lu: Vec<f64>,
    pivots: Vec<u16>,
    /// Where a segment is eliminated.
    panel: Vec<f64>,
    /// Hessian and couplings of each own point; of the chain's first point before them, in group 0.
    records: Vec<f64>,
    /// Points whose record is not zero.
    active: Vec<bool>,
    pub form: Form,
    pub side: Side,
    /// Own variables: particular solution, then solution.
    pub y: Vec<f64>,
    /// Multipliers of own rows.
    pub lambda: Vec<f64>,
    /// What the solution starts from: a and the dynamic θ, padded.
    start: Vec<f64>,
    z: Vec<f64>,
    next: Vec<f64>,
    /// 0 for the columns of states, 1 for those of θ.
    mask: Vec<f64>,
    bent: Vec<f64>,
    products: Products,
    cross: Vec<f64>,
    v: Vec<f64>,
    at_end: Vec<f64>,
    /// Segments before which the growth passed the limit, at the last factorisation.
    pub splits: Vec<usize>,
    /// Largest entry of X at the last factorisation.
    pub growth: f64,
}

/// What a group needs from outside.
#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub shape: &'a Shape,
    pub plan: &'a ChainPlan,
    /// 1/unit of each state.
    pub units: &'a [f64],
    /// What the columns of a panel are multiplied by: the unit of own states, then −unit of states
    /// before, −1 for θ.
    pub columns: &'a [f64],
    /// What a record is multiplied by.
    pub record: &'a [f64],
}

impl Group {
    pub fn new(context: &Context<'_>, segments: Range<usize>) -> Group {
        let (shape, plan) = (context.shape, context.plan);
        let n = shape.n;
        let row = plan.row(segments.start, n);
        let rows = plan.row(segments.end, n) - row;
        let first = usize::from(segments.start == 0);
        let most = segments.clone().map(|s| plan.row(s + 1, n) - plan.row(s, n)).max().unwrap_or(0);
        Group {
            row,
            e: vec![0.0; rows * shape.width],
            lu: vec![0.0; rows * plan.d],
            pivots: vec![0; segments.len() * plan.d],
            panel: vec![0.0; most * shape.panel(plan.d)],
            records: vec![0.0; (rows / n + first) * shape.record()],
            active: vec![false; rows / n + first],
            form: Form::new(shape),
            side: Side::new(shape),
            y: vec![0.0; rows],
            start: vec![0.0; shape.width],
            z: vec![0.0; n * shape.width],
            next: vec![0.0; most * shape.width],
            mask: (0..shape.width).map(|j| f64::from(u8::from(j >= n))).collect(),
            bent: vec![0.0; shape.width],
            products: Products::new(shape),
            cross: vec![0.0; shape.coupling],
            lambda: vec![0.0; rows],
            v: vec![0.0; most],
            at_end: vec![0.0; n],
            splits: Vec::new(),
            growth: 0.0,
            segments,
        }
    }

    /// Whether the chain starts here, so that its first point belongs to the group.
    fn has_first(&self) -> bool {
        self.segments.start == 0
    }

    /// Own rows of a segment, within the group.
    #[inline(always)]
    fn rows(&self, plan: &ChainPlan, n: usize, s: usize) -> Range<usize> {
        plan.row(s, n) - self.row..plan.row(s + 1, n) - self.row
    }

    /// Eliminates the interior; an own row of the chain that depends on others where it cannot.
    pub fn factorize(
        &mut self,
        context: &Context<'_>,
        hessian: &[f64],
        jacobian: &[f64],
    ) -> Result<(), usize> {
        self.splits.clear();
        self.growth = 0.0;
        factorize(self, context, hessian, jacobian)?;
        self.make_form(context.shape);
        Ok(())
    }

    /// Calls `each` for every point with curvature: its first own variable in the chain, `None` for the
    /// chain's first point, and its record.
    pub fn curvature(&self, n: usize, record: usize, mut each: impl FnMut(Option<usize>, &[f64])) {
        let first = usize::from(self.has_first());
        for (i, part) in self.records.chunks_exact(record).enumerate().filter(|(i, _)| self.active[*i]) {
            each((i >= first).then(|| self.row + (i - first) * n), part);
        }
    }

    /// Puts together the form from what the points have added up.
    fn make_form(&mut self, shape: &Shape) {
        let (n, used, width, f) = (shape.n, shape.used(), shape.width, shape.form());
        let columns = n + used;
        for i in 0..n {
            let row = &mut self.form.c[i * columns..(i + 1) * columns];
            let z = &self.z[i * width..i * width + used];
            for (c, z) in row[..n].iter_mut().zip(&z[..n]) {
                *c = -z;
            }
            row[n..2 * n].fill(0.0);
            row[n + i] = 1.0;
            for (c, z) in row[2 * n..].iter_mut().zip(&z[n..]) {
                *c = -z;
            }
        }
        let q = &mut self.form.q;
        q.fill(0.0);
        let place = |i: usize| if i < n { i } else { 2 * n + shape.dynamic[i - n] };
        for i in 0..used {
            let row = &mut q[place(i) * f..(place(i) + 1) * f];
            for j in 0..used {
                row[place(j)] += self.products.square(i, j);
            }
        }
        for i in 0..used {
            for (c, &b) in shape.coupled.iter().enumerate() {
                let value = self.products.cross(i, c);
                q[place(i) * f + 2 * n + b] += value;
                q[(2 * n + b) * f + place(i)] += value;
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

kernel! {
    fn factorize(g: &mut Group, context: &Context<'_>, hessian: &[f64], jacobian: &[f64]) -> Result<(), usize> {
        let (shape, plan) = (context.shape, context.plan);
        let (n, width, d) = (shape.n, shape.width, plan.d);
        let record = shape.record();
        restart(g, n, width);
        g.products.clear();
        let first_point = usize::from(g.has_first());
        if first_point > 0 {
            fill_records(&mut g.records[..record], plan, 0, hessian);
            g.active[0] = scale_record(&mut g.records[..record], n, context.record);
            if g.active[0] {
                g.products.add_point(&g.records[..record], &g.z);
            }
        }
        let mut point = first_point;
        let segments = g.segments.clone();
        let length = shape.panel(d);
        for (i, s) in segments.enumerate() {
            let own = g.rows(plan, n, s);
            let rows = own.len();
            let panel = &mut g.panel[..rows * length];
            panel.fill(0.0);
            for (entry, place) in plan.jacobian.of(s) {
                panel[place] += jacobian[entry];
            }
            for point in panel.chunks_exact_mut(n * length) {
                for (row, unit) in point.chunks_exact_mut(length).zip(context.units) {
                    for (x, c) in row.iter_mut().zip(context.columns) {
                        *x *= unit * c;
                    }
                }
            }
            let pivots = &mut g.pivots[i * d..(i + 1) * d];
            let e = &mut g.e[own.start * width..own.end * width];
            let lu = &mut g.lu[own.start * d..own.end * d];
            if let Err(row) = for_vectors!(length / 8, eliminate(panel, d, width, lu, pivots)) {
                return Err(plan.row(s, n) + row);
            }
            for_vectors!(width / 8, copy_rows(e, width, &panel[length - width..], length));
            // Sensitivities of the own points: Y = E_x Z + [0 E_θ].
            let next = &mut g.next[..rows * width];
            for_vectors!(width / 8, follow(n, width, e, &g.z, &g.mask, next));
            let points = rows / n;
            fill_records(&mut g.records[point * record..(point + points) * record], plan, s + 1, hessian);
            for j in 0..points {
                let part = &mut g.records[point * record..(point + 1) * record];
                g.active[point] = scale_record(part, n, context.record);
                if g.active[point] {
                    let y = &g.next[j * n * width..(j + 1) * n * width];
                    g.products.add_point(part, y);
                }
                point += 1;
            }
            g.z.copy_from_slice(&g.next[(d - n) * width..d * width]);
            if !all_finite(&g.z) {
                return Err(plan.row(s, n));
            }
            let mut growth = 0.0;
            for row in g.z.chunks_exact(width) {
                row[..n].iter().for_each(|x| growth = if x.abs() > growth { x.abs() } else { growth });
            }
            g.growth = g.growth.max(growth);
            if growth > GROWTH && s + 1 < g.segments.end {
                g.splits.push(s + 1);
                restart(g, n, width);
            }
        }
        g.products.flush();
        Ok(())
    }
}

/// Sensitivities at the start of a group: [I 0].
#[inline(always)]
fn restart(g: &mut Group, n: usize, width: usize) {
    g.z.fill(0.0);
    (0..n).for_each(|i| g.z[i * width + i] = 1.0);
}

/// Gathers the Hessians of points, their lower triangles, and their couplings.
#[inline(always)]
fn fill_records(records: &mut [f64], plan: &ChainPlan, panel: usize, hessian: &[f64]) {
    records.fill(0.0);
    for (entry, place) in plan.hessian.of(panel) {
        records[place] += hessian[entry];
    }
}

/// Into units, both triangles; whether there is anything.
#[inline(always)]
fn scale_record(record: &mut [f64], n: usize, factors: &[f64]) -> bool {
    for i in 1..n {
        for j in 0..i {
            record[j * n + i] = record[i * n + j];
        }
    }
    let mut any = 0;
    for (r, f) in record.iter_mut().zip(factors) {
        *r *= f;
        any |= r.to_bits() << 1;
    }
    any != 0
}

/// Y = E_x Z + [0 E_θ], row by row.
#[inline(always)]
fn follow<const V: usize>(n: usize, width: usize, e: &[f64], z: &[f64], mask: &[f64], next: &mut [f64]) {
    for (y, e) in next.chunks_exact_mut(width).zip(e.chunks_exact(width)) {
        sum_rows::<V>(y, (mask, e), &e[..n], z, width);
    }
}

#[inline(always)]
fn larger(x: f64, i: usize, best: &mut usize, size: &mut f64) {
    if x.abs() > *size {
        (*best, *size) = (i, x.abs());
    }
}

/// Row and size of the largest entry of the first column. Kept out of the kernel: for a handful of rows
/// the compiler makes thousands of vector instructions of it.
#[inline(never)]
fn first_pivot(panel: &[f64], length: usize, d: usize) -> (usize, f64) {
    let (mut best, mut size) = (0, 0.0);
    for i in 0..d {
        larger(panel[i * length], i, &mut best, &mut size);
    }
    (best, size)
}

/// Exchanges the first entries of two rows. Rare, and kept out of the kernel for the same reason.
#[cold]
#[inline(never)]
fn exchange(a: &mut [f64], stride: usize, count: usize, k: usize, i: usize) {
    let (low, high) = a.split_at_mut(i * stride);
    low[k * stride..k * stride + count].swap_with_slice(&mut high[..count]);
}

/// LU with row exchanges of the first d of `rows` rows of M, the rows after them (ties) eliminated
/// along; then M⁻¹ e in place of e, in a panel of rows [M, e]. The column that has no pivot where M is
/// singular.
#[inline(always)]
fn eliminate<const V: usize>(
    panel: &mut [f64],
    d: usize,
    width: usize,
    lu: &mut [f64],
    pivots: &mut [u16],
) -> Result<(), usize> {
    let first = d.next_multiple_of(8);
    let length = first + width;
    // The largest entry of the column to come is found while rows are eliminated.
    let (mut best, mut size) = first_pivot(panel, length, d);
    for k in 0..d {
        pivots[k] = best as u16;
        if !(size > 1e-280 && size.is_finite()) {
            return Err(k);
        }
        if best != k {
            exchange(panel, length, length, k, best);
            exchange(lu, d, k, k, best);
        }
        let (above, below) = panel.split_at_mut((k + 1) * length);
        let pivot_row = &above[k * length..];
        let inverse = 1.0 / pivot_row[k];
        let (lu_above, lu_below) = lu.split_at_mut((k + 1) * d);
        let u = &mut lu_above[k * d..];
        u[k] = inverse;
        u[k + 1..].copy_from_slice(&pivot_row[k + 1..d]);
        // Left of the pivot the row is zero: whole vectors may be taken, and all of few.
        let skipped = if V > 0 { 0 } else { k & !7 };
        let from = &pivot_row[skipped..];
        (best, size) = (k + 1, 0.0);
        let mut i = k;
        for (to, lu) in below.chunks_exact_mut(length).zip(lu_below.chunks_exact_mut(d)) {
            let l = to[k] * inverse;
            lu[k] = l;
            axpy::<V>(&mut to[skipped..], -l, from);
            i += 1;
            if i < d {
                larger(to[k + 1], i, &mut best, &mut size);
            }
        }
    }
    for k in (0..d).rev() {
        let inverse = lu[k * d + k];
        panel[k * length + first..(k + 1) * length].iter_mut().for_each(|x| *x *= inverse);
        let skipped = if V > 0 { 0 } else { first };
        let (above, row) = panel.split_at_mut(k * length);
        for (to, lu) in above.chunks_exact_mut(length).zip(lu.chunks_exact(d)) {
            axpy::<V>(&mut to[skipped..], -lu[k], &row[skipped..length]);
        }
    }
    Ok(())
}

/// y = M⁻¹ y, ties along.
#[inline(always)]
fn solve(m: &[f64], rows: usize, d: usize, pivots: &[u16], y: &mut [f64]) {
    for (k, &pivot) in pivots.iter().enumerate() {
        y.swap(k, pivot as usize);
    }
    for k in 0..d {
        let yk = y[k];
        for i in k + 1..rows {
            y[i] = (-m[i * d + k]).mul_add(yk, y[i]);
        }
    }
    for k in (0..d).rev() {
        y[k] *= m[k * d + k];
        let yk = y[k];
        for i in 0..k {
            y[i] = (-m[i * d + k]).mul_add(yk, y[i]);
        }
    }
}

/// v = M⁻ᵀ v, ties along.
#[inline(always)]
fn solve_transposed(m: &[f64], rows: usize, d: usize, pivots: &[u16], v: &mut [f64]) {
    for k in 0..d {
        v[k] *= m[k * d + k];
        let vk = v[k];
        for j in k + 1..d {
            v[j] = (-m[k * d + j]).mul_add(vk, v[j]);
        }
    }
    for k in (0..d).rev() {
        let mut sum = v[k];
        for i in k + 1..rows {
            sum = (-m[i * d + k]).mul_add(v[i], sum);
        }
        v[k] = sum;
    }
    for (k, &pivot) in pivots.iter().enumerate().rev() {
        v.swap(k, pivot as usize);
    }
}

kernel! {
    fn reduce(g: &mut Group, context: &Context<'_>, p: &[f64], q: &[f64], first: &[f64]) {
        let (shape, plan) = (context.shape, context.plan);
        let (n, width, d) = (shape.n, shape.width, plan.d);
        g.at_end.fill(0.0);
        for (i, s) in g.segments.clone().enumerate() {
            let own = g.rows(plan, n, s);
            let e = &g.e[own.start * width..own.end * width];
            let m = &g.lu[own.start * d..own.end * d];
            let y = &mut g.y[own.clone()];
            y.copy_from_slice(&q[g.row + own.start..g.row + own.end]);
            solve(m, own.len(), d, &g.pivots[i * d..(i + 1) * d], y);
            for (y, e) in y.iter_mut().zip(e.chunks_exact(width)) {
                for (e, x) in e[..n].iter().zip(&g.at_end) {
                    *y = e.mul_add(*x, *y);
                }
            }
            g.at_end.copy_from_slice(&y[d - n..d]);
        }
        g.side.c.copy_from_slice(&g.at_end);
        // Backwards: what the own points leave on the states before them, and on θ.
        let (record, coupled) = (shape.record(), shape.couplings());
        g.side.p.fill(0.0);
        g.cross[..shape.coupling].fill(0.0);
        g.bent[..width].fill(0.0);
        let first_point = usize::from(g.has_first());
        for s in g.segments.clone().rev() {
            let own = g.rows(plan, n, s);
            let e = &g.e[own.start * width..own.end * width];
            let v = &mut g.v[..own.len()];
            v.copy_from_slice(&p[g.row + own.start..g.row + own.end]);
            for j in 0..own.len() / n {
                let point = first_point + own.start / n + j;
                if g.active[point] {
                    let r = &g.records[point * record..(point + 1) * record];
                    let y = &g.y[own.start + j * n..][..n];
                    less_curvature(r, n, y, &mut v[j * n..(j + 1) * n]);
                    for (k, y) in r[coupled..].chunks_exact(shape.coupling.max(1)).zip(y) {
                        axpy::<0>(&mut g.cross[..shape.coupling], -y, k);
                    }
                }
            }
            if s + 1 < g.segments.end {
                v[d - n..d].iter_mut().zip(&g.bent[..n]).for_each(|(v, x)| *v += x);
                g.bent[..n].fill(0.0);
            }
            for (v, e) in v.iter().zip(e.chunks_exact(width)) {
                axpy::<0>(&mut g.bent[..width], *v, e);
            }
        }
        if g.has_first() {
            g.bent[..n].iter_mut().zip(first).for_each(|(b, p)| *b += p);
        }
        let (ends, theta) = g.side.p.split_at_mut(2 * n);
        ends[..n].copy_from_slice(&g.bent[..n]);
        for (x, &b) in g.bent[n..].iter().zip(&shape.dynamic) {
            theta[b] += x;
        }
        for (x, &b) in g.cross.iter().zip(&shape.coupled) {
            theta[b] += x;
        }
    }
}

/// v −= H y
#[inline(always)]
fn less_curvature(record: &[f64], n: usize, y: &[f64], v: &mut [f64]) {
    for (v, h) in v.iter_mut().zip(record.chunks_exact(n)) {
        for (h, y) in h.iter().zip(y) {
            *v = (-h).mul_add(*y, *v);
        }
    }
}

kernel! {
    fn expand(g: &mut Group, context: &Context<'_>, a: &[f64], theta: &[f64], p: &[f64]) {
        let (shape, plan) = (context.shape, context.plan);
        let (n, width, d) = (shape.n, shape.width, plan.d);
        g.start.fill(0.0);
        g.start[..n].copy_from_slice(a);
        for (x, &b) in g.start[n..].iter_mut().zip(&shape.dynamic) {
            *x = theta[b];
        }
        let coupling = shape.coupling;
        g.cross[..coupling].fill(0.0);
        for (x, &b) in g.cross.iter_mut().zip(&shape.coupled) {
            *x = theta[b];
        }
        // The particular solution plus what a and θ make of it.
        for s in g.segments.clone() {
            let own = g.rows(plan, n, s);
            let e = &g.e[own.start * width..own.end * width];
            for (r, (y, e)) in g.y[own.clone()].iter_mut().zip(e.chunks_exact(width)).enumerate() {
                let more = dot(e, &g.start);
                *y += more;
                if (d - n..d).contains(&r) {
                    g.at_end[r + n - d] = more;
                }
            }
            g.start[..n].copy_from_slice(&g.at_end);
        }
        let (record, coupled) = (shape.record(), shape.couplings());
        g.bent[..n].copy_from_slice(&g.side.multiplier);
        let first_point = usize::from(g.has_first());
        for (i, s) in g.segments.clone().enumerate().rev() {
            let own = g.rows(plan, n, s);
            let e = &g.e[own.start * width..own.end * width];
            let m = &g.lu[own.start * d..own.end * d];
            let v = &mut g.v[..own.len()];
            v.copy_from_slice(&p[g.row + own.start..g.row + own.end]);
            for j in 0..own.len() / n {
                let point = first_point + own.start / n + j;
                if g.active[point] {
                    let r = &g.records[point * record..(point + 1) * record];
                    let part = &mut v[j * n..(j + 1) * n];
                    less_curvature(r, n, &g.y[own.start + j * n..][..n], part);
                    for (k, v) in r[coupled..].chunks_exact(coupling.max(1)).zip(part) {
                        *v -= dot(k, &g.cross[..coupling]);
                    }
                }
            }
            v[d - n..d].iter_mut().zip(&g.bent[..n]).for_each(|(v, x)| *v += x);
            g.bent[..n].fill(0.0);
            for (v, e) in v.iter().zip(e.chunks_exact(width)) {
                for (b, e) in g.bent[..n].iter_mut().zip(e) {
                    *b = v.mul_add(*e, *b);
                }
            }
            solve_transposed(m, own.len(), d, &g.pivots[i * d..(i + 1) * d], v);
            g.lambda[own].copy_from_slice(v);
        }
    }
}
