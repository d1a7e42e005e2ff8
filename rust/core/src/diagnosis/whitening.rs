//! Residuals and sensitivities made white: prediction errors of autoregressive models, channel by channel, and what
//! scans of candidates ask of whitened columns, block by block.

use super::passage::{Passage, Predictors};
use crate::dense::large::transposed_product;
use crate::threads::Threads;
use crate::threads::prelude::*;

/// Columns that are worked on together: they stay in the cache.
const AT_ONCE: usize = 32;

/// Rows of the same time whose errors are made independent of each other: e is replaced by L⁻¹ e.
struct Mixing {
    /// L⁻¹ (n, n), lower triangular, row by row.
    inverse: Vec<f64>,
    /// Rows, n for each time.
    at: Vec<usize>,
    n: usize,
}

/// The segments of a channel: first row, and places of the samples on their grid of time.
pub type Segments = Vec<(usize, Vec<usize>)>;

/// The transform of rows of residuals, or of sensitivities, to prediction errors in units of their standard deviations,
/// those of the exact likelihood.
pub struct Whitening {
    /// First row and passage of each segment.
    passages: Vec<(usize, Passage)>,
    mixings: Vec<Mixing>,
    rows: usize,
}

impl Whitening {
    /// Makes the whitening from the model and the segments of each channel. Each mixing is L⁻¹ and rows, as many for each time.
    pub fn new(channels: &[(Predictors, Segments)], mixings: Vec<(Vec<f64>, Vec<usize>)>) -> Self {
        let segments = channels.iter().flat_map(|(model, segments)| {
            let covariance = model.covariance();
            segments.iter().map(move |(first, places)| (*first, Passage::new(model, &covariance, places)))
        });
        let passages: Vec<_> = segments.collect();
        let rows = passages.iter().map(|(first, p)| first + p.len()).max().unwrap_or(0);
        let mixings =
            mixings.into_iter().map(|(inverse, at)| Mixing { n: inverse.len().isqrt(), inverse, at });
        Whitening { passages, mixings: mixings.collect(), rows }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Columns (k · rows), one after the other, whitened.
    pub fn errors(&self, columns: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; columns.len()];
        if self.rows > 0 {
            let pairs = out.par_chunks_mut(self.rows).zip(columns.par_chunks(self.rows));
            let one = |(out, column): (&mut [f64], &[f64])| self.one(column, out);
            Threads::default().install(|| pairs.with_min_len(AT_ONCE).for_each(one));
        }
        out
    }

    fn one(&self, column: &[f64], out: &mut [f64]) {
        for (first, passage) in &self.passages {
            let own = *first..first + passage.len();
            passage.errors(&column[own.clone()], &mut out[own]);
        }
        for mixing in &self.mixings {
            for at in mixing.at.chunks_exact(mixing.n) {
                for (i, row) in mixing.inverse.chunks_exact(mixing.n).enumerate().rev() {
                    out[at[i]] = row[..=i].iter().zip(at).map(|(w, &j)| w * out[j]).sum();
                }
            }
        }
    }

    /// Logarithm of what each row's error is divided by.
    pub fn log_scales(&self) -> Vec<f64> {
        let mut out = vec![0.0; self.rows];
        for (first, passage) in &self.passages {
            passage.log_scales(&mut out[*first..first + passage.len()]);
        }
        for mixing in &self.mixings {
            for at in mixing.at.chunks_exact(mixing.n) {
                for (i, &row) in at.iter().enumerate() {
                    out[row] -= mixing.inverse[i * (mixing.n + 1)].ln();
                }
            }
        }
        out
    }

    /// Products of columns (k · rows), whitened, with vectors (m · rows): k · m; and with each other within groups, of
    /// `sizes` columns: a square for each, one after the other. Whitened columns are never stored all.
    pub fn products(&self, columns: &[f64], vectors: &[f64], sizes: &[usize]) -> (Vec<f64>, Vec<f64>) {
        let (n, m) = (self.rows.max(1), vectors.len() / self.rows.max(1));
        let mut blocks: Vec<(usize, usize, &[usize])> = Vec::new(); // columns from and to, and the groups' sizes
        let (mut begin, mut first, mut end) = (0, 0, 0);
        for (i, size) in sizes.iter().enumerate() {
            end += size;
            if end - begin >= AT_ONCE || i + 1 == sizes.len() {
                blocks.push((begin, end, &sizes[first..=i]));
                (begin, first) = (end, i + 1);
            }
        }
        let vectors = &vectors[..n * m];
        let found = blocks.into_par_iter().map_init(
            Vec::new,
            |white, (begin, end, sizes): (usize, usize, &[usize])| {
                let k = end - begin;
                white.resize(k * n, 0.0);
                for (out, column) in white.chunks_exact_mut(n).zip(columns[begin * n..].chunks_exact(n)) {
                    self.one(column, out);
                }
                let white = &white[..k * n];
                let mut along = vec![0.0; m * k];
                transposed_product(&mut along, vectors, white, [m, n, k]);
                let mut grams = Vec::with_capacity(sizes.iter().map(|s| s * s).sum());
                let mut first = 0;
                for &size in sizes {
                    let group = &white[first * n..(first + size) * n];
                    let mut gram = vec![0.0; size * size];
                    transposed_product(&mut gram, group, group, [size, n, size]);
                    grams.extend(gram);
                    first += size;
                }
                (along, grams)
            },
        );
        let found: Vec<_> = Threads::default().install(|| found.collect());
        let (along, grams): (Vec<_>, Vec<_>) = found.into_iter().unzip();
        (along.concat(), grams.concat())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_whitened_columns() {
        let model = Predictors::new(vec![vec![], vec![0.5], vec![0.6, -0.2]], vec![1.2, 1.0, 0.9]);
        let white = |n: usize| Predictors::new(vec![vec![]], vec![n as f64]);
        let places: Vec<usize> = (0..20).chain(23..40).collect();
        let segments = vec![(0, places)];
        let second = vec![(37, (0..37).collect())];
        let mixing = (vec![1.0, 0.0, -0.4, 1.1], (0..37).flat_map(|i| [i, 37 + i]).collect());
        let whitening = Whitening::new(&[(model, segments), (white(2), second)], vec![mixing]);
        let n = whitening.rows();
        let (k, m) = (70, 3);
        let columns: Vec<f64> = (0..k * n).map(|i| ((i * i) as f64 * 0.37).sin()).collect();
        let vectors: Vec<f64> = (0..m * n).map(|i| ((i * i) as f64 * 0.11).cos()).collect();
        let sizes: Vec<usize> = std::iter::repeat_n([1, 2, 2], 14).flatten().collect();
        let (along, grams) = whitening.products(&columns, &vectors, &sizes);
        let errors = whitening.errors(&columns);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let near = |a: f64, b: f64| (a - b).abs() < 1e-10;
        for (i, column) in errors.chunks(n).enumerate() {
            for (j, vector) in vectors.chunks(n).enumerate() {
                assert!(near(along[i * m + j], dot(column, vector)));
            }
        }
        let (mut first, mut at) = (0, 0);
        for size in sizes {
            for i in 0..size {
                for j in 0..size {
                    let [a, b] = [first + i, first + j].map(|c| &errors[c * n..(c + 1) * n]);
                    assert!(near(grams[at + i * size + j], dot(a, b)));
                }
            }
            first += size;
            at += size * size;
        }
    }
}
