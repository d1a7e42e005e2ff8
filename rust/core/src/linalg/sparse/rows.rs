//! A sparse matrix by rows, filled again and again from triplets.

use std::ops::Range;

/// An entry by its number, and what it is multiplied by.
pub(super) struct Triplet {
    pub row: u32,
    pub column: u32,
    pub number: u32,
    pub factor: f64,
}

/// A sparse matrix by rows: entries at one place are added up, all are scaled.
#[derive(Clone, Debug)]
pub(super) struct Rows {
    start: Vec<usize>,
    column: Vec<u32>,
    value: Vec<f64>,
    /// Number of a triplet, its place in `value`, and what it is multiplied by, in the order of places.
    sources: Vec<(u32, u32, f64)>,
}

impl Rows {
    /// Lays out triplets.
    pub fn new(rows: usize, mut triplets: Vec<Triplet>) -> Rows {
        triplets.sort_unstable_by_key(|t| (t.row, t.column, t.number));
        let mut start = vec![0; rows + 1];
        let mut column: Vec<u32> = Vec::with_capacity(triplets.len());
        let mut sources = Vec::with_capacity(triplets.len());
        let mut last = None;
        for Triplet { row, column: col, number, factor } in triplets {
            if last != Some((row, col)) {
                last = Some((row, col));
                start[row as usize + 1] += 1;
                column.push(col);
            }
            sources.push((number, column.len() as u32 - 1, factor));
        }
        for i in 0..rows {
            start[i + 1] += start[i];
        }
        Rows { start, value: vec![0.0; column.len()], column, sources }
    }

    /// Takes new values.
    pub fn fill(&mut self, triplets: &[f64]) {
        self.value.fill(0.0);
        for &(number, place, factor) in &self.sources {
            self.value[place as usize] += factor * triplets[number as usize];
        }
    }

    /// Number of rows.
    pub fn count(&self) -> usize {
        self.start.len() - 1
    }

    fn range(&self, row: usize) -> Range<usize> {
        self.start[row]..self.start[row + 1]
    }

    /// Columns of a row, ascending.
    pub fn columns(&self, row: usize) -> &[u32] {
        &self.column[self.range(row)]
    }

    /// Columns and values of a row.
    #[inline(always)]
    pub fn row(&self, row: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.range(row);
        self.column[range.clone()].iter().map(|&c| c as usize).zip(self.value[range].iter().copied())
    }

    /// All values.
    pub fn values(&self) -> &[f64] {
        &self.value
    }
}
