//! ZᵀHZ and ZᵀK of a group, summed over its points: half of the work of a factorisation.
//!
//! Sensitivities Z of a point and what stands right of them, [H Z, K], are collected until they fill
//! the nearest cache; then one product of two slim matrices adds them all, its blocks in registers.

use super::dense::{for_vectors, sum_rows};
use super::plan::Shape;

/// Rows that are collected: two matrices of as many rows of some 30 columns stay in the first cache.
const ROWS: usize = 64;
/// Rows of a block of the product. With two vectors across, sums fit the registers of any level.
const BLOCK: usize = 4;

/// The sums, and what is collected for them.
#[derive(Clone, Debug)]
pub(super) struct Products {
    n: usize,
    used: usize,
    width: usize,
    /// Of a record: where the couplings start.
    couplings: usize,
    /// Length of a row of the sums: width and couplings.
    length: usize,
    z: Vec<f64>,
    right: Vec<f64>,
    rows: usize,
    zeros: Vec<f64>,
    sums: Vec<f64>,
}

impl Products {
    pub fn new(shape: &Shape) -> Products {
        let (rows, length) = (ROWS.max(shape.n), shape.width + shape.coupling);
        Products {
            n: shape.n,
            used: shape.used(),
            width: shape.width,
            couplings: shape.couplings(),
            length,
            z: vec![0.0; rows * shape.width],
            right: vec![0.0; rows * length],
            rows: 0,
            zeros: vec![0.0; shape.width],
            sums: vec![0.0; shape.width * length],
        }
    }

    pub fn clear(&mut self) {
        self.rows = 0;
        self.sums.fill(0.0);
    }

    /// Entry of ΣZᵀHZ: of a symmetric matrix one half is summed.
    pub fn square(&self, i: usize, j: usize) -> f64 {
        self.sums[i.min(j) * self.length + i.max(j)]
    }

    /// Entry of ΣZᵀK.
    pub fn cross(&self, i: usize, c: usize) -> f64 {
        self.sums[i * self.length + self.width + c]
    }

    /// Takes a point: its record [H, K] and sensitivities.
    #[inline(always)]
    pub fn add_point(&mut self, record: &[f64], z: &[f64]) {
        let (n, width, length) = (self.n, self.width, self.length);
        if (self.rows + n) * width > self.z.len() {
            self.flush();
        }
        self.z[self.rows * width..][..n * width].copy_from_slice(&z[..n * width]);
        let right = &mut self.right[self.rows * length..][..n * length];
        for_vectors!(width / 8, bend(n, width, length, &record[..n * n], z, &self.zeros, right));
        let coupling = length - width;
        for i in 0..n {
            let k = &record[self.couplings + i * coupling..][..coupling];
            right[i * length + width..(i + 1) * length].copy_from_slice(k);
        }
        self.rows += n;
    }

    /// Adds what is collected to the sums.
    #[inline(always)]
    pub fn flush(&mut self) {
        let (width, length, rows) = (self.width, self.length, self.rows);
        for i in (0..self.used).step_by(BLOCK) {
            let mut j = i & !7;
            while j < length {
                let sums = &mut self.sums[i * length + j..];
                if j + 16 <= length {
                    add_block::<2>(rows, &self.z[i..], width, &self.right[j..], length, sums);
                    j += 16;
                } else {
                    add_block::<1>(rows, &self.z[i..], width, &self.right[j..], length, sums);
                    j += 8;
                }
            }
        }
        self.rows = 0;
    }
}

/// H Z of a point.
#[inline(always)]
fn bend<const V: usize>(
    n: usize,
    width: usize,
    length: usize,
    h: &[f64],
    z: &[f64],
    zeros: &[f64],
    to: &mut [f64],
) {
    for i in 0..n {
        let h = &h[i * n..(i + 1) * n];
        sum_rows::<V>(&mut to[i * length..][..width], (zeros, zeros), h, z, width);
    }
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
