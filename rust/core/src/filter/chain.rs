//! The linear algebra of a path: a quadratic program along a chain, by elimination from its end.
//!
//! ```text
//!   minimise    Σ_k ( ½ δx_kᵀ Q_k δx_k + gx_kᵀ δx_k ) + Σ_k ( ½ |δε_k|² + gε_kᵀ δε_k )
//!   subject to  δx_{k+1} = A_k δx_k + G_k δε_k + d_k
//! ```
//!
//! This is block elimination of the block-tridiagonal Newton system (a Riccati recursion; Bryson and Ho, *Applied
//! Optimal Control*, 1975, chapter 13, from the other end of time). P_k is the Hessian of what remains from sample k
//! on. The noise ε_k has unit variance and enters through G_k = √h_k diag(q) in the rows of the noisy states alone:
//! states without process noise are nothing special, and neither is q = 0, where a matrix Q⁻¹ would be infinite.

use super::dense::{
    add_transposed_product, cholesky, dot, inverse, log_det, product, product_transposed, solve, symmetrise,
};

/// Matrices of a chain of N samples, n states and m noises, one after the other.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain {
    /// Number of samples, N.
    pub(super) samples: usize,
    /// Number of states, n.
    pub(super) n: usize,
    /// The state that each noise enters, m of them.
    pub(super) noisy: Vec<usize>,
    /// A_k, N−1 of (n, n).
    pub(super) a: Vec<f64>,
    /// √h_k q_i: N−1 of m.
    pub(super) g: Vec<f64>,
    /// Q_k, N of (n, n).
    pub(super) q: Vec<f64>,
    /// Standard deviation of the prior of each first state that has one, infinite for a flat one.
    pub(super) prior: Vec<Option<f64>>,
}

/// A chain, eliminated.
#[derive(Clone, Debug)]
pub(super) struct Factor {
    /// P_k, N of (n, n).
    p: Vec<f64>,
    /// Cholesky factors of S_k = I + Gᵀ P_{k+1} G, N−1 of (m, m).
    s: Vec<f64>,
    /// L_k = S⁻¹ Gᵀ P_{k+1}, N−1 of (m, n).
    gain: Vec<f64>,
    /// M_k = P_{k+1} − P_{k+1} G S⁻¹ Gᵀ P_{k+1}, N−1 of (n, n).
    pub(super) m: Vec<f64>,
    /// Cholesky factor of P_0.
    first: Vec<f64>,
}

/// Where there is no factorisation: the Hessian has no positive pivot there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum NotPositive {
    /// In the noise of an interval.
    Noise,
    /// At a first state.
    First(usize),
}

/// The solution of the quadratic program.
#[derive(Clone, Debug, Default)]
pub(super) struct Step {
    /// δx, N of n.
    pub(super) x: Vec<f64>,
    /// δε, N−1 of m.
    pub(super) e: Vec<f64>,
    /// Multipliers of the constraints, N−1 of n.
    pub(super) lambda: Vec<f64>,
    /// gᵀ H⁻¹ g: twice what the step promises, where there are no gaps.
    pub(super) decrement: f64,
}

impl Chain {
    /// F = I − G L.
    fn closed(&self, k: usize, gain: &[f64]) -> Vec<f64> {
        let (n, m) = (self.n, self.noisy.len());
        let mut f = vec![0.0; n * n];
        (0..n).for_each(|i| f[i * n + i] = 1.0);
        for (i, &state) in self.noisy.iter().enumerate() {
            for c in 0..n {
                f[state * n + c] -= self.g[k * m + i] * gain[i * n + c];
            }
        }
        f
    }

    /// Eliminates from the last sample to the first.
    pub(super) fn factor(&self) -> Result<Factor, NotPositive> {
        let (n, m, last) = (self.n, self.noisy.len(), self.samples - 1);
        let nn = n * n;
        let mut f = Factor {
            p: self.q.clone(),
            s: vec![0.0; last * m * m],
            gain: vec![0.0; last * m * n],
            m: vec![0.0; last * nn],
            first: Vec::new(),
        };
        let (mut pf, mut ma) = (vec![0.0; nn], vec![0.0; nn]);
        for k in (0..last).rev() {
            let (before, after) = f.p.split_at_mut((k + 1) * nn);
            let (p, next) = (&mut before[k * nn..], &after[..nn]);
            let g = &self.g[k * m..(k + 1) * m];
            let s = &mut f.s[k * m * m..(k + 1) * m * m];
            let gain = &mut f.gain[k * m * n..(k + 1) * m * n];
            for (i, &row) in self.noisy.iter().enumerate() {
                for (j, &column) in self.noisy.iter().enumerate() {
                    s[i * m + j] = f64::from(i == j) + g[i] * next[row * n + column] * g[j];
                }
                for c in 0..n {
                    gain[i * n + c] = g[i] * next[row * n + c];
                }
            }
            cholesky(s, m).map_err(|_| NotPositive::Noise)?;
            solve(s, gain, m, n);
            // M = Fᵀ P F + Lᵀ L (Joseph's form): it cannot lose its definiteness to rounding.
            let closed = self.closed(k, gain);
            product(&mut pf, next, &closed, [n, n, n]);
            let matrix = &mut f.m[k * nn..(k + 1) * nn];
            add_transposed_product(matrix, &closed, &pf, [n, n, n]);
            add_transposed_product(matrix, gain, gain, [n, m, n]);
            let a = &self.a[k * nn..(k + 1) * nn];
            product(&mut ma, matrix, a, [n, n, n]);
            add_transposed_product(p, a, &ma, [n, n, n]);
            symmetrise(p, n);
        }
        f.first = f.p[..nn].to_vec();
        cholesky(&mut f.first, n).map_err(NotPositive::First)?;
        Ok(f)
    }

    /// First states that have a prior.
    fn random(&self) -> Vec<(usize, f64)> {
        // An infinite deviation is a flat prior, of density 1.
        let unit = |s: f64| if s.is_finite() { s } else { 1.0 };
        self.prior.iter().enumerate().filter_map(|(i, s)| s.map(|s| (i, unit(s)))).collect()
    }

    /// Cholesky factor of S P_0 S over the first states with a prior of standard deviations S.
    fn random_first(&self, f: &Factor) -> Result<Vec<f64>, NotPositive> {
        let random = self.random();
        let mut block = Vec::with_capacity(random.len() * random.len());
        for &(i, si) in &random {
            block.extend(random.iter().map(|&(j, sj)| si * f.p[i * self.n + j] * sj));
        }
        cholesky(&mut block, random.len()).map_err(|j| NotPositive::First(random[j].0))?;
        Ok(block)
    }

    /// ln det of the Hessian in what is random: the noises ε, and first states with a prior in units of its
    /// standard deviation.
    pub(super) fn log_det(&self, f: &Factor) -> Result<f64, NotPositive> {
        let m = self.noisy.len();
        let noise: f64 =
            if m == 0 { 0.0 } else { f.s.chunks_exact(m * m).map(|s| log_det(s, m)).sum::<f64>() };
        Ok(noise + log_det(&self.random_first(f)?, self.random().len()))
    }

    /// Covariances W_k of the states, N of (n, n), where the first is `first`.
    fn spread(&self, f: &Factor, first: Vec<f64>) -> Vec<f64> {
        let (n, m) = (self.n, self.noisy.len());
        let nn = n * n;
        let mut w = first;
        w.reserve(self.samples * nn);
        let (mut fa, mut faw) = (vec![0.0; nn], vec![0.0; nn]);
        for k in 0..self.samples - 1 {
            let gain = &f.gain[k * m * n..(k + 1) * m * n];
            product(&mut fa, &self.closed(k, gain), &self.a[k * nn..(k + 1) * nn], [n, n, n]);
            product(&mut faw, &fa, &w[k * nn..(k + 1) * nn], [n, n, n]);
            let mut next = vec![0.0; nn];
            product_transposed(&mut next, &faw, &fa, [n, n, n]);
            let inverse = inverse(&f.s[k * m * m..(k + 1) * m * m], m);
            for (i, &row) in self.noisy.iter().enumerate() {
                for (j, &column) in self.noisy.iter().enumerate() {
                    next[row * n + column] += self.g[k * m + i] * inverse[i * m + j] * self.g[k * m + j];
                }
            }
            symmetrise(&mut next, n);
            w.extend(next);
        }
        w
    }

    /// Covariances of the states by what is random: ½ W_k is the derivative of ½ ln det with respect to Q_k.
    pub(super) fn random_covariances(&self, f: &Factor) -> Result<Vec<f64>, NotPositive> {
        let (n, random) = (self.n, self.random());
        let block = inverse(&self.random_first(f)?, random.len());
        let mut first = vec![0.0; n * n];
        for (i, &(row, si)) in random.iter().enumerate() {
            for (j, &(column, sj)) in random.iter().enumerate() {
                first[row * n + column] = si * block[i * random.len() + j] * sj;
            }
        }
        Ok(self.spread(f, first))
    }

    /// Covariances of the states given all data and the parameters.
    pub(super) fn covariances(&self, f: &Factor) -> Vec<f64> {
        self.spread(f, inverse(&f.first, self.n))
    }

    /// Derivatives of ½ ln det with respect to g: N−1 of m, from the covariances of [`Chain::random_covariances`].
    pub(super) fn noise_slopes(&self, f: &Factor, w: &[f64]) -> Vec<f64> {
        let (n, m) = (self.n, self.noisy.len());
        let nn = n * n;
        let mut out = vec![0.0; (self.samples - 1) * m];
        let (mut aw, mut spread, mut mw) = (vec![0.0; nn], vec![0.0; nn], vec![0.0; nn]);
        for k in 0..self.samples - 1 {
            let a = &self.a[k * nn..(k + 1) * nn];
            product(&mut aw, a, &w[k * nn..(k + 1) * nn], [n, n, n]);
            product_transposed(&mut spread, &aw, a, [n, n, n]);
            product(&mut mw, &f.m[k * nn..(k + 1) * nn], &spread, [n, n, n]);
            let gain = &f.gain[k * m * n..(k + 1) * m * n];
            for (i, &state) in self.noisy.iter().enumerate() {
                let gain = &gain[i * n..(i + 1) * n];
                out[k * m + i] = gain[state] - dot(&mw[state * n..(state + 1) * n], gain);
            }
        }
        out
    }

    /// Solves the quadratic program: `gx` N of n, `ge` N−1 of m, the gaps `d` N−1 of n.
    pub(super) fn solve(&self, f: &Factor, gx: &[f64], ge: &[f64], d: &[f64]) -> Step {
        let (n, m, last) = (self.n, self.noisy.len(), self.samples - 1);
        let nn = n * n;
        let mut linear = gx.to_vec();
        let mut feed = vec![0.0; last * m];
        let mut decrement = 0.0;
        let (mut slope, mut back) = (vec![0.0; n], vec![0.0; m]);
        for k in (0..last).rev() {
            let next = &f.p[(k + 1) * nn..(k + 2) * nn];
            for i in 0..n {
                slope[i] = linear[(k + 1) * n + i] + dot(&next[i * n..(i + 1) * n], &d[k * n..(k + 1) * n]);
            }
            let g = &self.g[k * m..(k + 1) * m];
            let right = &mut feed[k * m..(k + 1) * m];
            for (i, &state) in self.noisy.iter().enumerate() {
                right[i] = ge[k * m + i] + g[i] * slope[state];
            }
            back.copy_from_slice(right);
            solve(&f.s[k * m * m..(k + 1) * m * m], right, m, 1);
            decrement += dot(&back, right);
            for i in 0..n {
                let through: f64 = (0..m).map(|j| next[i * n + self.noisy[j]] * g[j] * right[j]).sum();
                slope[i] -= through;
            }
            let a = &self.a[k * nn..(k + 1) * nn];
            add_transposed_product(&mut linear[k * n..(k + 1) * n], a, &slope, [n, n, 1]);
        }
        let mut step = Step {
            x: linear[..n].iter().map(|p| -p).collect(),
            e: vec![0.0; last * m],
            lambda: vec![0.0; last * n],
            decrement: 0.0,
        };
        solve(&f.first, &mut step.x, n, 1);
        step.decrement = decrement - dot(&step.x, &linear[..n]);
        let mut next = vec![0.0; n];
        for k in 0..last {
            let x = &step.x[k * n..(k + 1) * n];
            let a = &self.a[k * nn..(k + 1) * nn];
            for i in 0..n {
                next[i] = d[k * n + i] + dot(&a[i * n..(i + 1) * n], x);
            }
            let gain = &f.gain[k * m * n..(k + 1) * m * n];
            // κ holds S⁻¹ Gᵀ P d already.
            let ax: Vec<f64> = (0..n).map(|i| next[i] - d[k * n + i]).collect();
            for (i, &state) in self.noisy.iter().enumerate() {
                let e = -feed[k * m + i] - dot(&gain[i * n..(i + 1) * n], &ax);
                step.e[k * m + i] = e;
                next[state] += self.g[k * m + i] * e;
            }
            step.x.extend(&next);
            let p = &f.p[(k + 1) * nn..(k + 2) * nn];
            for i in 0..n {
                step.lambda[k * n + i] = linear[(k + 1) * n + i] + dot(&p[i * n..(i + 1) * n], &next);
            }
        }
        step
    }

    /// The Hessian in p parameters once path and noises are eliminated (the Schur complement), and how the first
    /// state follows them, (n, p): `b` N−1 of ∂Φ/∂θ (n, p); `cross` N of the Hessian between x and θ (n, p),
    /// `own` (p, p) between parameters, summed.
    pub(super) fn border(
        &self,
        f: &Factor,
        b: &[f64],
        cross: &[f64],
        own: &[f64],
        p: usize,
    ) -> (Vec<f64>, Vec<f64>) {
        let (n, m, last) = (self.n, self.noisy.len(), self.samples - 1);
        let (nn, np) = (n * n, n * p);
        let mut schur = own.to_vec();
        let mut now = cross[last * np..].to_vec();
        let mut r = vec![0.0; np];
        for k in (0..last).rev() {
            let next = &f.p[(k + 1) * nn..(k + 2) * nn];
            let (b, g) = (&b[k * np..(k + 1) * np], &self.g[k * m..(k + 1) * m]);
            product(&mut r, next, b, [n, n, p]);
            // bᵀ P b + bᵀ V + Vᵀ b, with V the block between x and θ.
            add_transposed_product(&mut schur, b, &r, [p, n, p]);
            add_transposed_product(&mut schur, b, &now, [p, n, p]);
            add_transposed_product(&mut schur, &now, b, [p, n, p]);
            r.iter_mut().zip(&now).for_each(|(r, v)| *r += v);
            let mut through = vec![0.0; m * p];
            for (i, &state) in self.noisy.iter().enumerate() {
                for c in 0..p {
                    through[i * p + c] = g[i] * r[state * p + c];
                }
            }
            let mut solved = through.clone();
            solve(&f.s[k * m * m..(k + 1) * m * m], &mut solved, m, p);
            let minus: Vec<f64> = through.iter().map(|v| -v).collect();
            add_transposed_product(&mut schur, &minus, &solved, [p, m, p]);
            for i in 0..n {
                for (j, &state) in self.noisy.iter().enumerate() {
                    let factor = next[i * n + state] * g[j];
                    for c in 0..p {
                        r[i * p + c] -= factor * solved[j * p + c];
                    }
                }
            }
            now.copy_from_slice(&cross[k * np..(k + 1) * np]);
            add_transposed_product(&mut now, &self.a[k * nn..(k + 1) * nn], &r, [n, n, p]);
        }
        let mut follows: Vec<f64> = now.iter().map(|v| -v).collect();
        solve(&f.first, &mut follows, n, p);
        add_transposed_product(&mut schur, &now, &follows, [p, n, p]);
        symmetrise(&mut schur, p);
        (schur, follows)
    }
}
