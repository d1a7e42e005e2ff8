//! The basis: the variables that the constraints determine, and the free ones.
//!
//! A has full rank, so some m of its columns, the *basis* B, are independent; the n − m variables of the
//! other columns F are *free*. A sparse LU decomposition of Aᵀ with row exchanges finds a basis:
//!
//! ```text
//!   Pᵀ Aᵀ Q = [ L ] U      B = Uᵀ Lᵀ      Z = [ −B⁻¹F ]    A Z = 0
//!             [ M ]        F = Uᵀ Mᵀ          [   I   ]
//! ```
//!
//! Of all variables that a constraint may determine the one with the largest coefficient is taken. This
//! is what keeps Z small: in an unstable system, states at the end of a record are free and those before
//! follow from them backwards, as errors then decay. (A fixed choice, say by structure, would let them
//! grow without limit; to exchange only where pivots are tiny would let them grow by a little a step,
//! thousands of steps.)
//!
//! Variables in a large part of the constraints, parameters, are kept out of the decomposition as long
//! as the others have a good basis, which then stays as sparse as it is without them. Where the others
//! have none they take part: a system that first decays and then grows ends where it does only for the
//! right parameter, which is then determined rather than free.

use super::order::minimum_degree;
use super::rows::Rows;
use crate::interrupt::current;
use crate::simd::kernel;

/// A variable that stands in this many times as many constraints as the median is heavy.
const HEAVY: usize = 8;
/// Pivots below this part of their constraint's largest coefficient are none; nor is a basis one whose
/// inverse is as large as this suggests.
const DEPENDENT: f64 = 1e-13;
/// The threshold of pivots where heavy variables are available as replacements.
const POOR: f64 = 1e-8;

/// The greatest growth of defects of order one in the solution, in units, with heavy variables outside.
const GROWTH: f64 = 1e6;

/// Heavy variables that take part are determined only where this part of their coefficient is more than
/// any other variable's: each makes all that follows denser.
const RELUCTANT: f64 = 1e-4;

/// Not yet determined, during elimination.
const OPEN: u32 = u32::MAX;
/// Kept out of it.
const OUTSIDE: u32 = u32::MAX - 1;

/// Columns of a sparse triangular factor.
#[derive(Clone, Debug, Default)]
struct Columns {
    start: Vec<usize>,
    index: Vec<u32>,
    value: Vec<f64>,
}

impl Columns {
    fn clear(&mut self) {
        self.start.clear();
        self.start.push(0);
        self.index.clear();
        self.value.clear();
    }

    #[inline(always)]
    fn push(&mut self, index: u32, value: f64) {
        self.index.push(index);
        self.value.push(value);
    }

    fn end(&mut self) {
        self.start.push(self.index.len());
    }

    #[inline(always)]
    fn column(&self, j: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.start[j]..self.start[j + 1];
        self.index[range.clone()].iter().map(|&i| i as usize).zip(self.value[range].iter().copied())
    }
}

/// The basis and what the free variables do to it.
#[derive(Clone, Debug)]
pub(super) struct Basis {
    n: usize,
    m: usize,
    /// Constraints in the order of elimination.
    order: Vec<u32>,
    heavy: Vec<u32>,
    /// The weights of coefficients in comparisons, by variable.
    weight: Vec<f64>,
    /// Columns of [L; M] below the pivots, by variable, and of U above the diagonal, by position.
    lower: Columns,
    upper: Columns,
    diagonal: Vec<f64>,
    /// The largest coefficient of each constraint, by position.
    size: Vec<f64>,
    /// The variable that each constraint determines, by position in the order.
    pivot: Vec<u32>,
    /// The position of each variable, or m + its number among the free ones.
    place: Vec<u32>,
    /// Free variables: first heavy ones that the decomposition does not know, `n_outside` of them.
    free: Vec<u32>,
    n_outside: usize,
    /// −B⁻¹F by rows in the order of positions, each `stride` long.
    z: Vec<f64>,
    stride: usize,
    work: Work,
    operations: u64,
}

/// The memory of the elimination of one constraint.
#[derive(Clone, Debug, Default)]
struct Work {
    /// Its coefficients, by variable.
    x: Vec<f64>,
    mark: Vec<u32>,
    /// Positions on the way, with how far their columns have been looked through; those done.
    path: Vec<(u32, usize)>,
    done: Vec<u32>,
    /// Variables that may be determined.
    open: Vec<u32>,
    /// One number a position.
    y: Vec<f64>,
}

impl Basis {
    /// Orders constraints so that little fills in, whatever the exchanges: by minimum degree on A Aᵀ.
    pub fn new(n: usize, a: &Rows) -> Basis {
        let m = a.count();
        let mut count = vec![0usize; n];
        for i in 0..m {
            a.columns(i).iter().for_each(|&c| count[c as usize] += 1);
        }
        let mut sorted: Vec<usize> = count.iter().copied().filter(|&c| c > 0).collect();
        sorted.sort_unstable();
        let most = sorted.get(sorted.len() / 2).map_or(0, |median| HEAVY * median);
        let heavy: Vec<u32> = (0..n as u32).filter(|&v| count[v as usize] > most).collect();
        Basis {
            n,
            m,
            order: minimum_degree(n, a, |v| count[v] <= most),
            weight: count.iter().map(|&c| if c > most { RELUCTANT } else { 1.0 }).collect(),
            heavy,
            lower: Columns::default(),
            upper: Columns::default(),
            diagonal: Vec::with_capacity(m),
            size: Vec::with_capacity(m),
            pivot: Vec::with_capacity(m),
            place: vec![OPEN; n],
            free: Vec::with_capacity(n.saturating_sub(m)),
            n_outside: 0,
            z: Vec::new(),
            stride: 0,
            work: Work { x: vec![0.0; n], mark: vec![0; n], y: vec![0.0; m], ..Work::default() },
            operations: 0,
        }
    }

    /// Finds a basis; a constraint that depends on others where there is none.
    pub fn factorize(&mut self, a: &Rows) -> Result<(), usize> {
        let outside = !self.heavy.is_empty() && self.eliminate(a, true).is_ok() && self.growth() <= GROWTH;
        if !outside {
            self.eliminate(a, false)?;
            if self.growth() > DEPENDENT.recip() {
                return Err(self.least_determined());
            }
        }
        self.free.clear();
        self.n_outside = if outside { self.heavy.len() } else { 0 };
        self.free.extend(&self.heavy[..self.n_outside]);
        self.free.extend((0..self.n as u32).filter(|&v| self.place[v as usize] == OPEN));
        for (column, &v) in self.free.iter().enumerate() {
            self.place[v as usize] = (self.m + column) as u32;
        }
        self.stride = self.free.len().next_multiple_of(8);
        self.z.clear();
        self.z.resize(self.m * self.stride, 0.0);
        sensitivities(self, a);
        Ok(())
    }

    /// The left-looking decomposition of Gilbert and Peierls (1988): constraint by constraint, what earlier
    /// pivots do to it is found by a search through their columns, in time proportional to the arithmetic.
    fn eliminate(&mut self, a: &Rows, keep_outside: bool) -> Result<(), usize> {
        self.lower.clear();
        self.upper.clear();
        self.diagonal.clear();
        self.pivot.clear();
        self.size.clear();
        self.place.fill(OPEN);
        self.work.mark.fill(0);
        self.operations = 0;
        if keep_outside {
            self.heavy.iter().for_each(|&v| self.place[v as usize] = OUTSIDE);
        }
        let poor = if keep_outside { POOR } else { DEPENDENT };
        let interrupt = current();
        for j in 0..self.m {
            let constraint = self.order[j] as usize;
            if j % 64 == 63 && interrupt.stops() {
                return Err(constraint);
            }
            let mut size = 0.0f64;
            for (v, value) in a.row(constraint) {
                size = size.max(value.abs());
                if self.place[v] != OUTSIDE && value != 0.0 {
                    self.visit(v, j as u32 + 1);
                    self.work.x[v] = value;
                }
            }
            let Work { x, done, open, .. } = &mut self.work;
            // Each one before those that it reaches.
            for &i in done.iter().rev() {
                let of = std::mem::take(&mut x[self.pivot[i as usize] as usize]);
                if of != 0.0 {
                    self.upper.push(i, of);
                    for (v, l) in self.lower.column(i as usize) {
                        x[v] -= l * of;
                    }
                    let i = i as usize;
                    self.operations += 2 * (self.lower.start[i + 1] - self.lower.start[i]) as u64;
                }
            }
            self.upper.end();
            self.size.push(size);
            let (mut best, mut largest) = (OPEN, 0.0);
            for &v in open.iter() {
                let compared = self.weight[v as usize] * x[v as usize].abs();
                if compared > largest {
                    (best, largest) = (v, compared);
                }
            }
            let pivot = if best == OPEN { 0.0 } else { std::mem::take(&mut x[best as usize]) };
            let determined = pivot.abs() > poor * size && pivot.is_finite();
            if determined {
                self.place[best as usize] = j as u32;
                self.pivot.push(best);
                self.diagonal.push(pivot);
                for &v in open.iter() {
                    if x[v as usize] != 0.0 {
                        self.lower.push(v, x[v as usize] / pivot);
                    }
                }
                self.operations += open.len() as u64;
                self.lower.end();
            }
            open.iter().for_each(|&v| x[v as usize] = 0.0);
            done.clear();
            open.clear();
            if !determined {
                return Err(constraint);
            }
        }
        Ok(())
    }

    /// Finds everything that a coefficient of variable `v` changes: pivots to `done`, in an order in which
    /// each comes after those that it reaches; variables that are no pivots to `open`.
    fn visit(&mut self, v: usize, stamp: u32) {
        let Work { mark, path, done, open, .. } = &mut self.work;
        if mark[v] == stamp {
            return;
        }
        mark[v] = stamp;
        if self.place[v] == OPEN {
            open.push(v as u32);
            return;
        }
        path.push((self.place[v], self.lower.start[self.place[v] as usize]));
        while let Some((j, at)) = path.last_mut() {
            if *at == self.lower.start[*j as usize + 1] {
                done.push(*j);
                path.pop();
                continue;
            }
            let v = self.lower.index[*at] as usize;
            *at += 1;
            if mark[v] == stamp {
                continue;
            }
            mark[v] = stamp;
            match self.place[v] {
                OPEN => open.push(v as u32),
                i => path.push((i, self.lower.start[i as usize])),
            }
        }
    }

    /// An estimate of ‖B⁻¹‖, its rows scaled to 1: the solution for defects of order one, their signs such
    /// that it becomes large (as in LINPACK).
    fn growth(&mut self) -> f64 {
        let Work { x, y, .. } = &mut self.work;
        for j in 0..self.m {
            let sum: f64 = self.upper.column(j).map(|(i, u)| u * y[i]).sum();
            y[j] = -(sum + self.size[j].copysign(sum)) / self.diagonal[j];
        }
        let mut largest = 0.0f64;
        for j in (0..self.m).rev() {
            // Free variables are zero in x, as it is left by the elimination.
            let value = y[j] - self.lower.column(j).map(|(v, l)| l * x[v]).sum::<f64>();
            x[self.pivot[j] as usize] = value;
            largest = if value.is_nan() { f64::INFINITY } else { largest.max(value.abs()) };
        }
        x.fill(0.0);
        largest
    }

    /// The constraint with the smallest pivot.
    fn least_determined(&self) -> usize {
        let part = |j: &usize| self.diagonal[*j].abs() / self.size[*j];
        let least = (0..self.m).min_by(|i, j| part(i).total_cmp(&part(j)));
        least.map_or(0, |j| self.order[j] as usize)
    }

    /// Free variables.
    pub fn free(&self) -> &[u32] {
        &self.free
    }

    /// Variables that the constraints determine, by position.
    pub fn pivots(&self) -> &[u32] {
        &self.pivot
    }

    /// A variable's position in the basis, or its number among the free variables.
    #[inline(always)]
    pub fn place(&self, v: usize) -> Result<usize, usize> {
        let place = self.place[v] as usize;
        if place < self.m { Ok(place) } else { Err(place - self.m) }
    }

    /// The row of Z of a position, padded with zeros.
    #[inline(always)]
    pub fn z(&self, position: usize) -> &[f64] {
        &self.z[position * self.stride..(position + 1) * self.stride]
    }

    /// Length of a row of Z.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Counted floating-point operations of the last decomposition, and of Z.
    pub fn operations(&self) -> u64 {
        self.operations
    }

    /// Completes d, whose free variables are given, so that A d = q. With `at_zero` these are zero.
    pub fn complete(&mut self, a: &Rows, q: &[f64], d: &mut [f64], at_zero: bool) {
        let outside = if at_zero { self.m..self.m } else { self.m..self.m + self.n_outside };
        let y = &mut self.work.y;
        for j in 0..self.m {
            let constraint = self.order[j] as usize;
            let mut rest = q[constraint];
            if !outside.is_empty() {
                for (v, value) in a.row(constraint) {
                    if outside.contains(&(self.place[v] as usize)) {
                        rest -= value * d[v];
                    }
                }
            }
            for (i, u) in self.upper.column(j) {
                rest -= u * y[i];
            }
            y[j] = rest / self.diagonal[j];
        }
        for j in (0..self.m).rev() {
            let mut value = y[j];
            for (v, l) in self.lower.column(j) {
                value -= l * d[v];
            }
            d[self.pivot[j] as usize] = value;
        }
    }

    /// Finds λ so that g − Aᵀλ vanishes in the basis. With `reduce`, what it is at free variables, Zᵀg, is
    /// left in g.
    pub fn multipliers(&mut self, a: &Rows, g: &mut [f64], lambda: &mut [f64], reduce: bool) {
        let outside = if reduce { self.m..self.m + self.n_outside } else { self.m..self.m };
        let y = &mut self.work.y;
        for j in 0..self.m {
            let value = g[self.pivot[j] as usize];
            for (v, l) in self.lower.column(j) {
                g[v] -= l * value;
            }
            y[j] = value;
        }
        for j in (0..self.m).rev() {
            let value = y[j] / self.diagonal[j];
            for (i, u) in self.upper.column(j) {
                y[i] -= u * value;
            }
            let constraint = self.order[j] as usize;
            lambda[constraint] = value;
            if !outside.is_empty() {
                for (v, of) in a.row(constraint) {
                    if outside.contains(&(self.place[v] as usize)) {
                        g[v] -= of * value;
                    }
                }
            }
        }
    }
}

kernel! {
    /// Z = −B⁻¹F, all columns at once.
    fn sensitivities(b: &mut Basis, a: &Rows) {
        let (m, stride) = (b.m, b.stride);
        let outside = b.n_outside.next_multiple_of(8);
        if outside > 0 {
            for j in 0..m {
                let (before, row) = b.z.split_at_mut(j * stride);
                let row = &mut row[..outside];
                for (v, value) in a.row(b.order[j] as usize) {
                    let place = b.place[v] as usize;
                    if place >= m && place - m < b.n_outside {
                        row[place - m] -= value;
                    }
                }
                for (i, u) in b.upper.column(j) {
                    axpy(row, -u, &before[i * stride..i * stride + outside]);
                    b.operations += 2 * b.n_outside as u64;
                }
                let divisor = b.diagonal[j];
                row.iter_mut().for_each(|z| *z /= divisor);
            }
        }
        for j in (0..m).rev() {
            let (row, after) = b.z.split_at_mut((j + 1) * stride);
            let row = &mut row[j * stride..];
            for (v, l) in b.lower.column(j) {
                match (b.place[v] as usize).checked_sub(m) {
                    Some(column) => row[column] -= l,
                    None => {
                        let other = (b.place[v] as usize - j - 1) * stride;
                        axpy(row, -l, &after[other..other + stride]);
                        b.operations += 2 * b.free.len() as u64;
                    }
                }
            }
        }
    }
}

/// to += a · from, over whole vectors of eight.
#[inline(always)]
pub(super) fn axpy(to: &mut [f64], a: f64, from: &[f64]) {
    let (to, from) = (to.as_chunks_mut::<8>().0, from.as_chunks::<8>().0);
    for (t, &f) in to.iter_mut().zip(from) {
        *t = std::array::from_fn(|l| a.mul_add(f[l], t[l]));
    }
}
