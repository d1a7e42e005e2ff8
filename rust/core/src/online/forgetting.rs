//! How information on samples before the window loses its weight.

use super::settings::Forgetting;
use super::triangle::Triangle;

/// Memory for forgetting in directions.
#[derive(Clone, Debug)]
pub(super) struct Direction {
    m: usize,
    /// Orthonormal rows in the space of the rows of R, n_y of m.
    basis: Vec<f64>,
    work: Vec<f64>,
}

/// A row of which less than this part is independent of those before is no direction of its own.
const INDEPENDENT: f64 = 1e-8;

impl Direction {
    pub(super) fn new(m: usize, n_y: usize) -> Direction {
        Direction { m, basis: vec![0.0; n_y * m], work: vec![0.0; m * (m + 1)] }
    }

    /// Operations, at most.
    pub(super) fn bound(&self) -> u64 {
        let (m, w, n_y) = (self.m, self.m + 1, self.basis.len() / self.m.max(1));
        let absorb: usize = (0..m).map(|j| 4 * (w - j) * (1 + m)).sum();
        (m * w * (1 + n_y) + absorb) as u64
    }

    /// Forgets for an interval, s, at the end of which samples bring the equations `rows` of outputs.
    pub(super) fn forget(&mut self, info: &mut Triangle, how: Forgetting, interval: f64, rows: &[f64]) {
        match how {
            Forgetting::None => {}
            Forgetting::Exponential(time) => info.scale((-0.5 * interval / time).exp()),
            Forgetting::Directional(time) => self.directions(info, (-0.5 * interval / time).exp(), rows),
        }
    }

    /// Multiplies by `root` what R knows in the directions of the rows h: with V = R H and U an orthonormal basis of its columns,
    /// RᵀR becomes RᵀR − (1 − root²) RᵀUUᵀR, which for one row is the update of Cao and Schwartz (2000), eq. 12. R then is
    /// (I − (1 − root) UUᵀ) R, made triangular again.
    fn directions(&mut self, info: &mut Triangle, root: f64, rows: &[f64]) {
        let (m, w) = (info.m, info.width());
        let mut found = 0;
        for row in rows.chunks_exact(w) {
            let (known, rest) = self.basis.split_at_mut(found * m);
            let Some(own) = rest.get_mut(..m) else { break };
            info.product(&row[..m], own);
            let size = own.iter().map(|v| v * v).sum::<f64>().sqrt();
            // Twice is enough.
            for _ in 0..2 {
                for u in known.chunks_exact(m) {
                    let along: f64 = own.iter().zip(u).map(|(a, b)| a * b).sum();
                    own.iter_mut().zip(u).for_each(|(a, b)| *a -= along * b);
                }
            }
            let left = own.iter().map(|v| v * v).sum::<f64>().sqrt();
            if left > INDEPENDENT * size {
                own.iter_mut().for_each(|v| *v /= left);
                found += 1;
            }
        }
        if found == 0 {
            return;
        }
        self.work.copy_from_slice(&info.r);
        for u in self.basis[..found * m].chunks_exact(m) {
            for c in 0..w {
                let along: f64 = (0..m).map(|i| u[i] * self.work[i * w + c]).sum();
                (0..m).for_each(|i| self.work[i * w + c] -= (1.0 - root) * along * u[i]);
            }
        }
        info.r.fill(0.0);
        info.absorb(&mut self.work);
    }
}
