//! The time update of square-root information: the oldest state is replaced by the next one, and its process noise eliminated.
//!
//! With δx⁺ = A δx + B δθ + G w + d and w of unit covariance, δx is A⁻¹(δx⁺ − B δθ − G w − d), and the rows of the states
//! together with I w = 0 are made triangular in (w, δx⁺) (Bierman 1977, section VI.2; P. Dyer and S. McReynolds 1969). The rows of
//! the parameters alone are not touched. A is regular wherever the Runge-Kutta steps are stable.

use super::triangle::Triangle;
use crate::dense::{factorise, solve_factorised_transposed, triangularise};

/// A segment between two nodes of the window, linearised.
#[derive(Clone, Debug)]
pub(super) struct Segment {
    /// ∂Φ/∂x, of (n, n).
    pub(super) a: Vec<f64>,
    /// ∂Φ/∂θ by the estimated parameters, of (n, p).
    pub(super) b: Vec<f64>,
    /// Φ(x) − x⁺, of n.
    pub(super) defect: Vec<f64>,
    /// Standard deviations of the noises that reach their states within the segment, of q.
    pub(super) noise: Vec<f64>,
    /// Factors of A, with their row exchanges.
    lu: Vec<f64>,
    pivots: Vec<u32>,
    /// Rows of the eliminated noises: (w, δx⁺, δθ | z), of (q, q + m + 1).
    eliminated: Vec<f64>,
}

/// Numbers of the states that process noise drives.
pub(super) type Driven<'a> = &'a [usize];

impl Segment {
    /// Of n states, p parameters and q noises.
    pub(super) fn new(n: usize, p: usize, q: usize) -> Segment {
        Segment {
            a: vec![0.0; n * n],
            b: vec![0.0; n * p],
            defect: vec![0.0; n],
            noise: vec![0.0; q],
            lu: vec![0.0; n * n],
            pivots: vec![0; n],
            eliminated: vec![0.0; q * (q + n + p + 1)],
        }
    }

    /// Carries information on (x, θ) over the segment to (x⁺, θ); `work` is of (q + n, q + m + 1). Whether A is regular.
    pub(super) fn advance(&mut self, info: &mut Triangle, driven: Driven<'_>, work: &mut [f64]) -> bool {
        let (n, q, m, w) = (self.defect.len(), driven.len(), info.m, info.width());
        let (p, wide) = (m - n, q + w);
        self.lu.copy_from_slice(&self.a);
        if !factorise(&mut self.lu, &mut self.pivots) {
            return false;
        }
        work.fill(0.0);
        (0..q).for_each(|i| work[i * wide + i] = 1.0);
        for i in 0..n {
            let row = &mut work[(q + i) * wide..(q + i + 1) * wide];
            let own = &info.r[i * w..(i + 1) * w];
            row[q..].copy_from_slice(own);
            // The row of R A⁻¹.
            let (noises, rest) = row.split_at_mut(q);
            let (x, rest) = rest.split_at_mut(n);
            if !solve_factorised_transposed(&self.lu, &self.pivots, x) {
                return false;
            }
            for (noise, (state, size)) in noises.iter_mut().zip(driven.iter().zip(&self.noise)) {
                *noise = -x[*state] * size;
            }
            for (x, (by, d)) in x.iter().zip(self.b.chunks_exact(p.max(1)).zip(&self.defect)) {
                rest[..p].iter_mut().zip(by).for_each(|(t, b)| *t -= x * b);
                rest[p] += x * d;
            }
            if p == 0 {
                rest[0] = own[m] + x.iter().zip(&self.defect).map(|(x, d)| x * d).sum::<f64>();
            }
        }
        triangularise(work, q + n, wide, q + n, None);
        self.eliminated.copy_from_slice(&work[..q * wide]);
        for i in 0..n {
            info.r[i * w..(i + 1) * w].copy_from_slice(&work[(q + i) * wide + q..(q + i + 1) * wide]);
        }
        info.flops += flops(n, p, q);
        work[(q + n) * wide - 1].is_finite()
    }

    /// The step of the state before the segment, from that behind it and of the parameters, `next` of m; into `before` of n.
    pub(super) fn back(&self, driven: Driven<'_>, next: &[f64], before: &mut [f64], w: &mut [f64]) {
        let (n, q, m) = (before.len(), driven.len(), next.len());
        let (p, wide) = (m - n, q + m + 1);
        for i in (0..q).rev() {
            let row = &self.eliminated[i * wide..(i + 1) * wide];
            let later: f64 = (i + 1..q).map(|j| row[j] * w[j]).sum();
            let known: f64 = row[q..q + m].iter().zip(next).map(|(r, d)| r * d).sum();
            w[i] = (row[q + m] - later - known) / row[i];
        }
        for i in 0..n {
            let by: f64 = self.b[i * p..(i + 1) * p].iter().zip(&next[n..]).map(|(b, d)| b * d).sum();
            before[i] = next[i] - by - self.defect[i];
        }
        for (j, (state, size)) in driven.iter().zip(&self.noise).enumerate() {
            before[*state] -= size * w[j];
        }
        crate::dense::solve_factorised(&self.lu, &self.pivots, before, 1);
    }
}

/// Operations of [`Segment::advance`], at most.
pub(super) fn flops(n: usize, p: usize, q: usize) -> u64 {
    let (factors, rows) = (2 * n * n * n / 3 + n * n, n * (2 * n * n + 2 * n * (p + 1) + q));
    let reflected: usize = (0..n + q).map(|j| 4 * (n + q - j) * (q + n + p + 2 - j)).sum();
    (factors + rows + reflected) as u64
}
