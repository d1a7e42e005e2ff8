//! Square-root information: an upper triangle R and a right-hand side z with ‖R δ − z‖² the cost of a step δ of the last state and
//! the parameters (G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation*, 1977, chapters IV and V).
//!
//! Orthogonal transformations act on R itself, never on RᵀR, so that the condition of the problem is not squared.

/// Upper triangle of the states, then the parameters, with its right-hand side as the last column; row-major.
#[derive(Clone, Debug)]
pub(super) struct Triangle {
    /// Number of unknowns, m.
    pub(super) m: usize,
    /// R and z, of (m, m + 1).
    pub(super) r: Vec<f64>,
    /// Floating-point operations so far.
    pub(super) flops: u64,
}

impl Triangle {
    /// No information on so many unknowns.
    pub(super) fn new(m: usize) -> Triangle {
        Triangle { m, r: vec![0.0; m * (m + 1)], flops: 0 }
    }

    /// Columns of a row: the unknowns and the right-hand side.
    pub(super) fn width(&self) -> usize {
        self.m + 1
    }

    pub(super) fn copy_from(&mut self, other: &Triangle) {
        self.r.copy_from_slice(&other.r);
    }

    /// Moves the point that steps are counted from by `by`: z becomes z − R by.
    pub(super) fn shift(&mut self, by: &[f64]) {
        let (m, w) = (self.m, self.width());
        for i in 0..m {
            let moved: f64 = (i..m).map(|j| self.r[i * w + j] * by[j]).sum();
            self.r[i * w + m] -= moved;
        }
        self.flops += (m * (m + 1)) as u64;
    }

    /// Multiplies R and z by a number.
    pub(super) fn scale(&mut self, factor: f64) {
        self.r.iter_mut().for_each(|v| *v *= factor);
        self.flops += self.r.len() as u64;
    }

    /// Appends equations, rows of R δ = z of which those below the triangle are eliminated by Householder's reflections. The rows
    /// hold no information afterwards.
    pub(super) fn absorb(&mut self, rows: &mut [f64]) {
        let w = self.width();
        for j in 0..self.m {
            let below: f64 = rows.iter().skip(j).step_by(w).map(|v| v * v).sum();
            if below == 0.0 {
                continue;
            }
            let pivot = self.r[j * w + j];
            let norm = (pivot * pivot + below).sqrt();
            let head = if pivot > 0.0 { -norm } else { norm };
            let first = pivot - head;
            let factor = 2.0 / (first * first + below);
            let own = &mut self.r[j * w..(j + 1) * w];
            for c in j + 1..w {
                let along: f64 =
                    first * own[c] + rows.chunks_exact(w).map(|row| row[j] * row[c]).sum::<f64>();
                let step = factor * along;
                own[c] -= step * first;
                rows.chunks_exact_mut(w).for_each(|row| row[c] -= step * row[j]);
            }
            own[j] = head;
            rows.iter_mut().skip(j).step_by(w).for_each(|v| *v = 0.0);
            self.flops += (4 * (w - j) * (1 + rows.len() / w)) as u64;
        }
    }

    /// Solves rows `first..last` of R δ = z for δ there, with δ known behind. An unknown without information has δ = 0.
    pub(super) fn solve(&mut self, first: usize, last: usize, delta: &mut [f64]) {
        let (m, w) = (self.m, self.width());
        for i in (first..last).rev() {
            let row = &self.r[i * w..(i + 1) * w];
            let rest: f64 = (i + 1..m).map(|j| row[j] * delta[j]).sum();
            let value = (row[m] - rest) / row[i];
            delta[i] = if row[i] == 0.0 { 0.0 } else { value };
            self.flops += 2 * (m - i) as u64;
        }
    }

    /// Solves R v = b.
    pub(super) fn solve_for(&mut self, b: &[f64], v: &mut [f64]) {
        let (m, w) = (self.m, self.width());
        for i in (0..m).rev() {
            let rest: f64 = (i + 1..m).map(|j| self.r[i * w + j] * v[j]).sum();
            v[i] = (b[i] - rest) / self.r[i * w + i];
        }
        self.flops += (m * (m + 1)) as u64;
    }

    /// Solves Rᵀ v = b in place.
    pub(super) fn solve_transposed(&mut self, b: &mut [f64]) {
        let (m, w) = (self.m, self.width());
        for i in 0..m {
            b[i] /= self.r[i * w + i];
            let v = b[i];
            b[i + 1..m].iter_mut().zip(&self.r[i * w + i + 1..]).for_each(|(b, r)| *b -= r * v);
        }
        self.flops += (m * m) as u64;
    }

    /// R v, into `out`.
    pub(super) fn product(&mut self, v: &[f64], out: &mut [f64]) {
        let (m, w) = (self.m, self.width());
        for (i, out) in out.iter_mut().enumerate() {
            *out = (i..m).map(|j| self.r[i * w + j] * v[j]).sum();
        }
        self.flops += (m * (m + 1)) as u64;
    }

    /// Rᵀ v, into `out`.
    pub(super) fn transposed_product(&mut self, v: &[f64], out: &mut [f64]) {
        let (m, w) = (self.m, self.width());
        out.fill(0.0);
        for (i, v) in v.iter().enumerate() {
            out[i..m].iter_mut().zip(&self.r[i * w + i..]).for_each(|(out, r)| *out += r * v);
        }
        self.flops += (m * (m + 1)) as u64;
    }

    /// The covariance R⁻¹R⁻ᵀ, of (m, m), with `inverse` of the same size as memory. Infinite for an unknown without information.
    pub(super) fn covariance(&mut self, inverse: &mut [f64], out: &mut [f64]) {
        let (m, w) = (self.m, self.width());
        inverse.fill(0.0);
        for c in 0..m {
            inverse[c * m + c] = 1.0 / self.r[c * w + c];
            for i in (0..c).rev() {
                let sum: f64 = (i + 1..=c).map(|j| self.r[i * w + j] * inverse[j * m + c]).sum();
                inverse[i * m + c] = -sum / self.r[i * w + i];
            }
        }
        for i in 0..m {
            for j in 0..=i {
                let (a, b) = (&inverse[i * m + i..(i + 1) * m], &inverse[j * m + i..(j + 1) * m]);
                let sum: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                out[i * m + j] = sum;
                out[j * m + i] = sum;
            }
        }
        self.flops += (2 * m * m * m / 3 + 2 * m * m) as u64;
    }
}
