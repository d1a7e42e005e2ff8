//! Variables of the basis that are held: as they follow from free ones, these lose freedom.
//!
//! A held free variable is simply left out of the coordinates. Rows C of Z of held variables of the basis
//! are turned by reflections (Householder's QR with exchanges) into a triangle: Cᵀ = Q [R; 0]. In
//! coordinates Qᵀy the first ones are then fixed, the others free.

use super::basis::Basis;

/// A held variable of which others held leave less than this part free cannot be held.
const IMMOVABLE: f64 = 1e-10;
/// Nor can one that moves by less than this, in units, with any of the free variables.
const UNMOVED: f64 = 1e-12;

/// Held variables of the basis.
#[derive(Debug, Default)]
pub(super) struct Holding {
    /// Number of coordinates.
    k: usize,
    /// The held variables, in the order of the first coordinates, and those that cannot be held.
    kept: Vec<u32>,
    immovable: Vec<u32>,
    /// Unit vectors, one row each.
    reflections: Vec<f64>,
    /// R, row-major.
    triangle: Vec<f64>,
    length: Vec<f64>,
    side: Vec<f64>,
}

impl Holding {
    /// Held variables, by coordinate.
    pub fn kept(&self) -> &[u32] {
        &self.kept
    }

    /// Held variables that constraints and others held leave no choice.
    pub fn immovable(&self) -> &[u32] {
        &self.immovable
    }

    /// Looks for held variables in the basis. Coordinates are free variables `active` over `root`.
    pub fn choose(&mut self, basis: &Basis, held: &[bool], active: &[usize], root: &[f64]) {
        let k = active.len();
        self.k = k;
        self.kept.clear();
        self.immovable.clear();
        self.reflections.clear();
        self.length.clear();
        self.kept.extend(basis.pivots().iter().filter(|&&v| held[v as usize]));
        // Rows of Z, their lengths made 1, so that units play no part.
        for &v in &self.kept {
            let z = basis.place(v as usize).map_or(&[][..], |j| basis.z(j));
            let start = self.reflections.len();
            let moves = active.iter().any(|&j| z[j].abs() > UNMOVED);
            self.reflections.extend(active.iter().zip(root).map(|(&j, root)| z[j] * root));
            let length = norm(&self.reflections[start..]);
            let scale = if moves { length.recip() } else { 0.0 };
            self.reflections[start..].iter_mut().for_each(|z| *z *= scale);
            self.length.push(length);
        }
        let count = self.kept.len();
        self.triangle.clear();
        self.triangle.resize(count * count, 0.0);
        let mut rank = 0;
        while rank < count.min(k) && self.reflect_longest(rank) {
            rank += 1;
        }
        self.immovable.extend(self.kept.drain(rank..));
        self.reflections.truncate(rank * k);
        for r in 0..rank {
            for c in r..rank {
                self.triangle[r * rank + c] = self.triangle[r * count + c] * self.length[c];
            }
        }
    }

    /// Turns the row of which most is left into the next coordinate; whether there is one.
    fn reflect_longest(&mut self, rank: usize) -> bool {
        let (k, count) = (self.k, self.kept.len());
        let rest = |i: usize| (i, norm(&self.reflections[i * k + rank..(i + 1) * k]));
        let (best, length) = (rank..count).map(rest).fold((rank, 0.0), |a, b| if b.1 > a.1 { b } else { a });
        if length <= IMMOVABLE {
            return false;
        }
        self.kept.swap(rank, best);
        self.length.swap(rank, best);
        (0..k).for_each(|c| self.reflections.swap(rank * k + c, best * k + c));
        (0..rank).for_each(|r| self.triangle.swap(r * count + rank, r * count + best));
        let (done, after) = self.reflections.split_at_mut((rank + 1) * k);
        let v = &mut done[rank * k..];
        v[..rank].fill(0.0);
        let head = if v[rank] > 0.0 { -length } else { length };
        v[rank] -= head;
        let size = norm(v);
        v.iter_mut().for_each(|x| *x /= size);
        self.triangle[rank * count + rank] = head;
        for (i, row) in after.chunks_exact_mut(k).enumerate() {
            reflect(v, row);
            self.triangle[rank * count + rank + 1 + i] = row[rank];
        }
        true
    }

    /// QᵀMQ, M symmetric.
    pub fn turn_matrix(&mut self, matrix: &mut [f64]) {
        let k = self.k.max(1);
        for v in self.reflections.chunks_exact(k) {
            matrix.chunks_exact_mut(k).for_each(|row| reflect(v, row));
            self.side.clear();
            self.side.resize(k, 0.0);
            for (row, v) in matrix.chunks_exact(k).zip(v) {
                self.side.iter_mut().zip(row).for_each(|(s, value)| *s += v * value);
            }
            for (row, v) in matrix.chunks_exact_mut(k).zip(v) {
                row.iter_mut().zip(&self.side).for_each(|(value, s)| *value -= 2.0 * v * s);
            }
        }
    }

    /// Qᵀy.
    pub fn turn(&self, y: &mut [f64]) {
        self.reflections.chunks_exact(self.k.max(1)).for_each(|v| reflect(v, y));
    }

    /// Q y.
    pub fn turn_back(&self, y: &mut [f64]) {
        self.reflections.chunks_exact(self.k.max(1)).rev().for_each(|v| reflect(v, y));
    }

    /// Solves Rᵀx = b in place: the first coordinates at which kept variables are b.
    pub fn coordinates(&self, b: &mut [f64]) {
        let rank = self.kept.len();
        for i in 0..rank {
            let sum: f64 = (0..i).map(|r| self.triangle[r * rank + i] * b[r]).sum();
            b[i] = (b[i] - sum) / self.triangle[i * rank + i];
        }
    }

    /// Solves R x = b in place: what must pull at kept variables to cancel b in the first coordinates.
    pub fn pull(&self, b: &mut [f64]) {
        let rank = self.kept.len();
        for i in (0..rank).rev() {
            let sum: f64 = (i + 1..rank).map(|c| self.triangle[i * rank + c] * b[c]).sum();
            b[i] = (b[i] - sum) / self.triangle[i * rank + i];
        }
    }
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Reflects x at the plane across the unit vector v.
fn reflect(v: &[f64], x: &mut [f64]) {
    let along: f64 = v.iter().zip(&*x).map(|(v, x)| v * x).sum();
    x.iter_mut().zip(v).for_each(|(x, v)| *x -= 2.0 * along * v);
}
