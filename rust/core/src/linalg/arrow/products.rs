//! ZᵀHZ and ZᵀK of a group, summed over its points: half of the work of a factorisation.
//!
//! Z is a point's sensitivities, H its Hessian, K its couplings with the border. Z falls into parts, and
//! H and K are lists of what is not zero. Z and H Z are collected until they fill the nearest caches;
//! then products of slim matrices add them all, their blocks in registers.

use super::part::Part;
use super::piece::Piece;
use super::run::Run;
use super::shape::Shape;
use super::vectors::{axpy, for_vectors};

/// Rows of a part that are collected: two matrices of as many rows of some 30 columns stay in the first cache.
const ROWS: usize = 64;
/// Numbers of H Z that are collected at most, so that they stay in the second.
const MOST: usize = 1 << 16;
/// Rows of a block of the product. With two vectors across, sums fit the registers of any level.
const BLOCK: usize = 4;

/// The sums, and what is collected for them.
#[derive(Clone, Debug)]
pub(super) struct Products {
    /// Points that are collected, and how many are.
    capacity: usize,
    points: usize,
    /// Sums for each part of a point's sensitivities, and rows of [H Z, K].
    collected: Vec<(Vec<f64>, Vec<f64>)>,
    /// Length of such a row: columns of all parts, then the coupled border, padded.
    length: usize,
    /// Part of each state, and place in it.
    place: Vec<(u32, u32)>,
    /// ΣZᵀ[H Z, K], and (ΣZᵀK)ᵀ of points without H.
    sums: Vec<f64>,
    crosses: Vec<f64>,
}

impl Products {
    pub fn new(shape: &Shape) -> Products {
        let length = shape.width + shape.coupled.len().next_multiple_of(8);
        let most = shape.parts.iter().map(|p| p.states.len()).max().unwrap_or(1);
        let capacity = (ROWS / most).min(MOST / (shape.n * length).max(1)).max(1);
        let mut place = vec![(0, 0); shape.n];
        for (p, part) in shape.parts.iter().enumerate() {
            part.states.iter().enumerate().for_each(|(i, &s)| place[s] = (p as u32, i as u32));
        }
        let collected = |part: &Part| {
            let rows = capacity * part.states.len();
            (vec![0.0; rows * part.width], vec![0.0; rows * length])
        };
        Products {
            capacity,
            points: 0,
            collected: shape.parts.iter().map(collected).collect(),
            length,
            place,
            sums: vec![0.0; shape.width * length],
            crosses: vec![0.0; shape.coupled.len() * shape.width],
        }
    }

    pub fn clear(&mut self) {
        self.points = 0;
        self.sums.fill(0.0);
        self.crosses.fill(0.0);
    }

    /// Entry of ΣZᵀHZ between columns of all parts: of a symmetric matrix one half is summed.
    pub fn square(&self, i: usize, j: usize) -> f64 {
        self.sums[i.min(j) * self.length + i.max(j)]
    }

    /// Entry of ΣZᵀK: a column of all parts, a coupled border variable.
    pub fn cross(&self, shape: &Shape, i: usize, c: usize) -> f64 {
        self.sums[i * self.length + shape.width + c] + self.crosses[c * shape.width + i]
    }

    /// Takes the points of a panel: what bends there, and sensitivities, as they stand in each piece.
    #[inline(always)]
    pub fn add<'a>(
        &mut self,
        shape: &Shape,
        runs: &[Run],
        values: &[f64],
        pieces: &'a [Piece],
        z: impl Fn(&'a Piece) -> &'a [f64],
    ) {
        let length = self.length;
        let (mut point, mut bent) = (u32::MAX, false);
        for (run, values) in Run::with(runs, values) {
            if run.point != point {
                self.points += usize::from(bent);
                (point, bent) = (run.point, false);
            }
            let (p, i) = self.place[run.state as usize];
            let (p, i) = (p as usize, i as usize);
            let part = &shape.parts[p];
            let at = (point as usize * part.states.len() + i) * part.width;
            let own = &z(&pieces[p])[at..at + part.width];
            let to = (self.points * part.states.len() + i) * length;
            if run.coupled && bent {
                let to = &mut self.collected[p].1[to + shape.width..][run.others()];
                to.iter_mut().zip(values).for_each(|(t, v)| *t += v);
            } else if run.coupled {
                let to = &mut self.crosses[run.other as usize * shape.width + part.first..];
                for_vectors!(part.width / 8, spread(values, own, to, shape.width));
            } else {
                if !bent {
                    bent = true;
                    self.open(shape, point as usize, pieces, &z);
                }
                let to = (self.points * part.states.len() + i) * length;
                for (other, &value) in run.others().zip(values) {
                    let (o, j) = self.place[other];
                    let (o, j) = (o as usize, j as usize);
                    let with = &shape.parts[o];
                    // The sums are symmetric: of two parts the first takes both.
                    if p <= o {
                        let across = &z(&pieces[o])[(point as usize * with.states.len() + j) * with.width..];
                        let to = &mut self.collected[p].1[to + with.first..];
                        for_vectors!(with.width / 8, add_row(to, value, across, with.width));
                    }
                    if o <= p && other != run.state as usize {
                        let to = (self.points * with.states.len() + j) * length + part.first;
                        let to = &mut self.collected[o].1[to..];
                        for_vectors!(part.width / 8, add_row(to, value, own, part.width));
                    }
                }
            }
        }
        self.points += usize::from(bent);
    }

    /// Makes room for a point, and takes its sensitivities.
    #[inline(always)]
    fn open<'a>(
        &mut self,
        shape: &Shape,
        point: usize,
        pieces: &'a [Piece],
        z: &impl Fn(&'a Piece) -> &'a [f64],
    ) {
        if self.points == self.capacity {
            self.flush(shape);
        }
        let length = self.length;
        for ((part, piece), (to, right)) in shape.parts.iter().zip(pieces).zip(&mut self.collected) {
            let n = part.states.len();
            let from = &z(piece)[point * n * part.width..][..n * part.width];
            to[self.points * n * part.width..][..n * part.width].copy_from_slice(from);
            for row in right[self.points * n * length..][..n * length].chunks_exact_mut(length) {
                part.meets.iter().for_each(|range| row[range.clone()].fill(0.0));
            }
        }
    }

    /// Adds what is collected to the sums.
    #[inline(always)]
    pub fn flush(&mut self, shape: &Shape) {
        let length = self.length;
        for (part, (z, right)) in shape.parts.iter().zip(&self.collected) {
            let rows = self.points * part.states.len();
            for i in (0..part.used()).step_by(BLOCK) {
                for range in &part.meets {
                    let mut j = range.start.max(part.first + (i & !7));
                    while j < range.end {
                        let sums = &mut self.sums[(part.first + i) * length + j..];
                        if j + 16 <= range.end {
                            add_block::<2>(rows, &z[i..], part.width, &right[j..], length, sums);
                            j += 16;
                        } else {
                            add_block::<1>(rows, &z[i..], part.width, &right[j..], length, sums);
                            j += 8;
                        }
                    }
                }
            }
        }
        self.points = 0;
    }
}

/// Adds a row times each value to one row after the other.
#[inline(always)]
fn spread<const V: usize>(values: &[f64], row: &[f64], to: &mut [f64], stride: usize) {
    for (k, &value) in values.iter().enumerate() {
        add_row::<V>(&mut to[k * stride..], value, row, row.len());
    }
}

#[inline(always)]
fn add_row<const V: usize>(to: &mut [f64], a: f64, from: &[f64], width: usize) {
    axpy::<V>(&mut to[..width], a, &from[..width]);
}

/// A block of `BLOCK` rows and V vectors of aᵀ b, added to `to`.
#[inline(always)]
fn add_block<const V: usize>(rows: usize, a: &[f64], width: usize, b: &[f64], length: usize, to: &mut [f64]) {
    let mut sums = [[[0.0; 8]; V]; BLOCK];
    for r in 0..rows {
        let a: &[f64; BLOCK] = a[r * width..].first_chunk().expect("a block");
        let b: &[[f64; 8]; V] = b[r * length..].as_chunks().0.first_chunk().expect("V vectors");
        for i in 0..BLOCK {
            for (sum, b) in sums[i].iter_mut().zip(b) {
                *sum = std::array::from_fn(|l| a[i].mul_add(b[l], sum[l]));
            }
        }
    }
    for i in 0..BLOCK {
        let to: &mut [[f64; 8]; V] = to[i * length..].as_chunks_mut().0.first_chunk_mut().expect("V vectors");
        for (to, sum) in to.iter_mut().zip(&sums[i]) {
            *to = std::array::from_fn(|l| to[l] + sum[l]);
        }
    }
}
