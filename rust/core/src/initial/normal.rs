//! Normal equations of a regression, from sparse entries that stand in any order.

use crate::interrupt::current;
use crate::nlp::Structure;
use crate::simd::kernel;

/// Rows gathered before they are added to the normal matrix: they stay in a cache.
const ROWS: usize = 512;
/// Operations, about, between two looks at the interrupt.
const ASK: usize = 500_000;

/// Rows of ∂c/∂θ, gathered block by block, and the sums AᵀWA and AᵀWc.
///
/// Entries of one row stand apart in the structure, but not far: entries are cut into blocks that no row
/// crosses, so that only a block's rows are held at a time.
pub(super) struct Normal {
    k: usize,
    width: usize,
    /// Ends of the blocks of entries.
    ends: Vec<usize>,
    /// For each constraint its row within its block.
    slots: Vec<u32>,
    rows: Vec<f64>,
    ids: Vec<u32>,
    /// Row-major, k rows of `width`, the lower triangle; then AᵀWc.
    square: Vec<f64>,
    right: Vec<f64>,
}

impl Normal {
    /// Plans for the columns with a place among `k`, of the first `m` constraints.
    pub fn new(structure: &Structure, place: &[usize], k: usize, m: usize) -> Normal {
        let own = || {
            let entries = structure.rows.iter().zip(&structure.columns).enumerate();
            entries.filter(|(_, (r, c))| (**r as usize) < m && among(place, **c))
        };
        let mut last = vec![0u32; m];
        own().for_each(|(t, (&r, _))| last[r as usize] = t as u32);
        let (mut ends, mut slots) = (Vec::new(), vec![u32::MAX; m]);
        let (mut reach, mut count, mut most) = (0, 0, 0);
        for (t, (&r, _)) in own() {
            let slot = &mut slots[r as usize];
            if *slot == u32::MAX {
                *slot = count;
                count += 1;
                most = most.max(count);
            }
            reach = reach.max(last[r as usize] as usize);
            if t == reach && count as usize >= ROWS {
                ends.push(t + 1);
                count = 0;
            }
        }
        ends.push(structure.len());
        let width = k.next_multiple_of(8);
        Normal {
            k,
            width,
            ends,
            slots,
            rows: vec![0.0; most as usize * width],
            ids: vec![0; most as usize],
            square: vec![0.0; k * width],
            right: vec![0.0; width],
        }
    }

    /// Sums over all rows with entries `values`, the constraints `c`, and weights that repeat along them. Nothing where
    /// the interrupt in force stops it.
    pub fn sum(
        &mut self,
        s: &Structure,
        values: &[f64],
        place: &[usize],
        c: &[f64],
        weights: &[f64],
    ) -> Option<()> {
        let interrupt = current();
        let ask = 1 + ASK / (1 + self.k * self.k);
        self.square.fill(0.0);
        self.right.fill(0.0);
        let mut start = 0;
        for &end in &self.ends {
            let mut count = 0;
            for t in start..end {
                if s.rows[t] as usize >= self.slots.len() || !among(place, s.columns[t]) {
                    continue;
                }
                let slot = self.slots[s.rows[t] as usize] as usize;
                if slot >= count {
                    self.rows[count * self.width..(slot + 1) * self.width].fill(0.0);
                    count = slot + 1;
                }
                self.ids[slot] = s.rows[t];
                self.rows[slot * self.width + place[s.columns[t] as usize]] += values[t];
            }
            let rows = self.rows.chunks_exact(self.width).zip(&self.ids[..count]);
            for (number, (row, &id)) in rows.enumerate() {
                if number % ask == 0 && interrupt.stops() {
                    return None;
                }
                let w = weights[id as usize % weights.len()];
                add_row(row, w, w * c[id as usize], self.k, &mut self.square, &mut self.right);
            }
            start = end;
        }
        Some(())
    }

    /// Entry of AᵀWA, i ≥ j.
    pub fn square(&self, i: usize, j: usize) -> f64 {
        self.square[i * self.width + j]
    }

    /// Entry of AᵀWc.
    pub fn right(&self, i: usize) -> f64 {
        self.right[i]
    }
}

fn among(place: &[usize], column: u32) -> bool {
    place.get(column as usize).is_some_and(|p| *p != usize::MAX)
}

kernel! {
    fn add_row(row: &[f64], w: f64, wc: f64, k: usize, square: &mut [f64], right: &mut [f64]) {
        let vectors = row.as_chunks::<8>().0;
        for (t, r) in right.as_chunks_mut::<8>().0.iter_mut().zip(vectors) {
            *t = std::array::from_fn(|l| wc.mul_add(r[l], t[l]));
        }
        for (i, to) in square.chunks_exact_mut(row.len()).enumerate().take(k) {
            if row[i] != 0.0 {
                let factor = w * row[i];
                for (t, r) in to.as_chunks_mut::<8>().0.iter_mut().zip(&vectors[..=i / 8]) {
                    *t = std::array::from_fn(|l| factor.mul_add(r[l], t[l]));
                }
            }
        }
    }
}
