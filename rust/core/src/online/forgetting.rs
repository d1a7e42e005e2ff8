//! How information on samples before the window loses its weight.

use super::settings::Forgetting;
use super::triangle::Triangle;

/// Memory for forgetting in directions.
#[derive(Clone, Debug)]
pub(super) struct Direction {
    n: usize,
    /// An equation of outputs.
    row: Vec<f64>,
    /// Orthonormal rows in the space of the rows of R that belong to parameters, n_y of p.
    basis: Vec<f64>,
    work: Vec<f64>,
    block: Triangle,
}

/// A row of which less than this part is independent of those before is no direction of its own.
const INDEPENDENT: f64 = 1e-8;

impl Direction {
    pub(super) fn new(n: usize, p: usize, n_y: usize) -> Direction {
        Direction {
            n,
            row: vec![0.0; n + p],
            basis: vec![0.0; n_y * p],
            work: vec![0.0; p * (p + 1)],
            block: Triangle::new(p),
        }
    }

    /// Operations so far.
    pub(super) fn flops(&self) -> u64 {
        self.block.flops
    }

    /// Operations, at most.
    pub(super) fn bound(&self) -> u64 {
        let (m, p) = (self.row.len(), self.block.m);
        let n_y = self.basis.len() / p.max(1);
        let absorb: usize = (0..p).map(|j| 4 * (p + 1 - j) * (1 + p)).sum();
        (m * (m + 2) + n_y * (2 * self.n * m + p * p + 8 * n_y * p + 4 * p * (p + 1)) + absorb) as u64
    }

    /// Forgets for an interval, s, at the end of which samples bring the equations `rows` of outputs.
    pub(super) fn forget(&mut self, info: &mut Triangle, how: Forgetting, interval: f64, rows: &[f64]) {
        match how {
            Forgetting::None => {}
            Forgetting::Exponential(time) => info.scale((-0.5 * interval / time).exp()),
            Forgetting::Directional(time) => self.directions(info, (-0.5 * interval / time).exp(), rows),
        }
    }

    /// Multiplies by `root` what R knows of the parameters in the directions φ in which rows depend on them, with the states as they
    /// follow from the parameters. With R of the parameters alone, V = R φ and U an orthonormal basis of its columns, RᵀR becomes
    /// RᵀR − (1 − root²) RᵀUUᵀR, which for one row is the update of Cao and Schwartz (2000), eq. 12. R then is
    /// (I − (1 − root) UUᵀ) R, made triangular again.
    fn directions(&mut self, info: &mut Triangle, root: f64, rows: &[f64]) {
        let (n, m, w, p) = (self.n, info.m, info.width(), self.block.m);
        if p == 0 {
            return;
        }
        let mut found = 0;
        for row in rows.chunks_exact(w) {
            self.row.copy_from_slice(&row[..m]);
            for j in 0..n {
                let known = &info.r[j * w..j * w + m];
                let part = if known[j] == 0.0 { 0.0 } else { self.row[j] / known[j] };
                self.row[j..].iter_mut().zip(&known[j..]).for_each(|(v, r)| *v -= part * r);
            }
            let (known, rest) = self.basis.split_at_mut(found * p);
            let Some(own) = rest.get_mut(..p) else { break };
            for (i, v) in own.iter_mut().enumerate() {
                let of_row = &info.r[(n + i) * w + n..(n + i) * w + m];
                *v = of_row[i..].iter().zip(&self.row[n + i..]).map(|(r, h)| r * h).sum();
            }
            let size = own.iter().map(|v| v * v).sum::<f64>().sqrt();
            // Twice is enough.
            for _ in 0..2 {
                for u in known.chunks_exact(p) {
                    let along: f64 = own.iter().zip(u).map(|(a, b)| a * b).sum();
                    own.iter_mut().zip(u).for_each(|(a, b)| *a -= along * b);
                }
            }
            let left = own.iter().map(|v| v * v).sum::<f64>().sqrt();
            if left > INDEPENDENT * size {
                own.iter_mut().for_each(|v| *v /= left);
                found += 1;
            }
            self.block.flops += (2 * n * m + p * p + 8 * found * p) as u64;
        }
        if found == 0 {
            return;
        }
        let own = p + 1;
        for (i, row) in self.work.chunks_exact_mut(own).enumerate() {
            row.copy_from_slice(&info.r[(n + i) * w + n..(n + i + 1) * w]);
        }
        for u in self.basis[..found * p].chunks_exact(p) {
            for c in 0..own {
                let along: f64 = (0..p).map(|i| u[i] * self.work[i * own + c]).sum();
                (0..p).for_each(|i| self.work[i * own + c] -= (1.0 - root) * along * u[i]);
            }
        }
        self.block.flops += (4 * found * p * own) as u64;
        self.block.r.fill(0.0);
        self.block.absorb(&mut self.work);
        for (i, row) in self.block.r.chunks_exact(own).enumerate() {
            info.r[(n + i) * w + n..(n + i + 1) * w].copy_from_slice(row);
        }
    }
}
