//! The linear algebra of a path: a quadratic program along a chain, by elimination from its end.
//!
//! ```text
//!   minimise    Σ_k ( ½ δx_kᵀ Q_k δx_k + gx_kᵀ δx_k ) + Σ_k ( ½ |δε_k|² + geᵀ_k δε_k + ½ δz_kᵀ C_k δz_k )
//!   subject to  δx_{k+1} = B_k δz_k + d_k,     z_k = (x_k, ε_k),     B_k = (A_k, G_k)
//! ```
//!
//! This is block elimination of the block-tridiagonal Newton system (a Riccati recursion; Bryson and Ho, *Applied
//! Optimal Control*, 1975, chapter 13, from the other end of time). P_k is the Hessian of what remains from sample k
//! on. The noises ε_k have unit variance: states that they do not reach are nothing special, and neither is q = 0, where
//! a matrix Q⁻¹ would be infinite.

use crate::interrupt::{Turns, current};

use crate::dense::{
    add_transposed_product, cholesky, dot, inverse, log_det, product, product_transposed, rounding, solve,
    symmetrise,
};

/// Matrices of a chain of N samples, n states and m noises an interval, one after the other.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain {
    /// Number of samples, N.
    pub(super) samples: usize,
    /// Number of states, n.
    pub(super) n: usize,
    /// Number of noises of an interval, m.
    pub(super) m: usize,
    /// B_k = (A_k, G_k), N−1 of (n, n + m).
    pub(super) b: Vec<f64>,
    /// C_k, N−1 of (n + m, n + m).
    pub(super) c: Vec<f64>,
    /// Q_k, N of (n, n).
    pub(super) q: Vec<f64>,
    /// Standard deviation of the prior of each initial state that has one, infinite for a flat one.
    pub(super) prior: Vec<Option<f64>>,
}

/// A chain, eliminated.
#[derive(Clone, Debug)]
pub(super) struct Factor {
    /// P_k, N of (n, n).
    pub(super) p: Vec<f64>,
    /// Cholesky factors of S_k = I + C_εε + Gᵀ P_{k+1} G, N−1 of (m, m).
    s: Vec<f64>,
    /// L_k = S⁻¹ (C_εx + Gᵀ P_{k+1} A), N−1 of (m, n).
    gain: Vec<f64>,
    /// Cholesky factor of P_0.
    first: Vec<f64>,
}

/// Covariances of what is random.
#[derive(Clone, Debug, Default)]
pub(super) struct Spread {
    /// The block of the states, N of (n, n).
    pub(super) x: Vec<f64>,
    /// The block of states and noises z_k together, N−1 of (n + m, n + m).
    pub(super) z: Vec<f64>,
}

/// The reason why a quantity of a chain was not computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Fault {
    /// The Hessian has no positive pivot in the noise of an interval.
    Noise,
    /// It has none at an initial state.
    First(usize),
    /// The interrupt in force ended the work.
    Stopped,
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
    /// The size of z.
    pub(super) fn width(&self) -> usize {
        self.n + self.m
    }

    fn of<'a>(&self, all: &'a [f64], k: usize, rows: usize, columns: usize) -> &'a [f64] {
        &all[k * rows * columns..(k + 1) * rows * columns]
    }

    /// Returns the interrupt check of a loop over the intervals with so many products of square matrices of the size
    /// of z.
    fn turns(&self, products: usize) -> impl FnMut() -> Result<(), Fault> {
        let mut turns: Turns = current().turns(products * self.width().pow(3));
        move || if turns.stop() { Err(Fault::Stopped) } else { Ok(()) }
    }

    /// T = (I; −L): how z_k follows x_k, (n + m, n).
    fn closed(&self, gain: &[f64]) -> Vec<f64> {
        let n = self.n;
        let mut t = vec![0.0; n * n];
        (0..n).for_each(|i| t[i * n + i] = 1.0);
        t.extend(gain.iter().map(|v| -v));
        t
    }

    /// Eliminates from the last sample to the first.
    pub(super) fn factor(&self) -> Result<Factor, Fault> {
        let (n, m, width, last) = (self.n, self.m, self.width(), self.samples - 1);
        let nn = n * n;
        let mut f = Factor {
            p: self.q.clone(),
            s: vec![0.0; last * m * m],
            gain: vec![0.0; last * m * n],
            first: Vec::new(),
        };
        let (mut pb, mut h) = (vec![0.0; n * width], vec![0.0; width * width]);
        let (mut bt, mut pbt, mut ct) = (vec![0.0; nn], vec![0.0; nn], vec![0.0; width * n]);
        let mut turn = self.turns(6);
        for k in (0..last).rev() {
            turn()?;
            let (before, after) = f.p.split_at_mut((k + 1) * nn);
            let (p, next) = (&mut before[k * nn..], &after[..nn]);
            let (b, c) = (self.of(&self.b, k, n, width), self.of(&self.c, k, width, width));
            product(&mut pb, next, b, [n, n, width]);
            h.copy_from_slice(c);
            add_transposed_product(&mut h, b, &pb, [width, n, width]);
            let (s, gain) = (&mut f.s[k * m * m..(k + 1) * m * m], &mut f.gain[k * m * n..(k + 1) * m * n]);
            for i in 0..m {
                let row = &h[(n + i) * width..(n + i + 1) * width];
                gain[i * n..(i + 1) * n].copy_from_slice(&row[..n]);
                s[i * m..(i + 1) * m].copy_from_slice(&row[n..]);
                s[i * m + i] += 1.0;
            }
            cholesky(s, m, rounding).map_err(|_| Fault::Noise)?;
            solve(s, gain, m, n);
            // Tᵀ H T (Joseph's form): what is a sum of squares cannot lose its definiteness to rounding.
            let t = self.closed(gain);
            product(&mut bt, b, &t, [n, width, n]);
            product(&mut pbt, next, &bt, [n, n, n]);
            product(&mut ct, c, &t, [width, width, n]);
            add_transposed_product(p, &bt, &pbt, [n, n, n]);
            add_transposed_product(p, gain, gain, [n, m, n]);
            add_transposed_product(p, &t, &ct, [n, width, n]);
            symmetrise(p, n);
        }
        f.first = f.p[..nn].to_vec();
        cholesky(&mut f.first, n, rounding).map_err(Fault::First)?;
        Ok(f)
    }

    /// Initial states that have a prior.
    fn random(&self) -> Vec<(usize, f64)> {
        // An infinite deviation is a flat prior, of density 1.
        let unit = |s: f64| if s.is_finite() { s } else { 1.0 };
        self.prior.iter().enumerate().filter_map(|(i, s)| s.map(|s| (i, unit(s)))).collect()
    }

    /// Cholesky factor of S P_0 S over the initial states with a prior of standard deviations S.
    fn random_first(&self, f: &Factor) -> Result<Vec<f64>, Fault> {
        let random = self.random();
        let mut block = Vec::with_capacity(random.len() * random.len());
        for &(i, si) in &random {
            block.extend(random.iter().map(|&(j, sj)| si * f.p[i * self.n + j] * sj));
        }
        cholesky(&mut block, random.len(), rounding).map_err(|j| Fault::First(random[j].0))?;
        Ok(block)
    }

    /// ln det of the Hessian in what is random: the noises ε, and initial states with a prior in units of its
    /// standard deviation.
    pub(super) fn log_det(&self, f: &Factor) -> Result<f64, Fault> {
        let m = self.m;
        let noise: f64 = f.s.chunks_exact(m * m).map(|s| log_det(s, m)).sum();
        Ok(noise + log_det(&self.random_first(f)?, self.random().len()))
    }

    /// Covariances, where that of the initial state is `first`.
    fn spread(&self, f: &Factor, first: Vec<f64>) -> Result<Spread, Fault> {
        let (n, m, width) = (self.n, self.m, self.width());
        let mut out = Spread { x: first.clone(), z: Vec::with_capacity((self.samples - 1) * width * width) };
        let mut now = first;
        let (mut tw, mut z, mut bz) = (vec![0.0; width * n], vec![0.0; width * width], vec![0.0; n * width]);
        let mut turn = self.turns(5);
        for k in 0..self.samples - 1 {
            turn()?;
            let t = self.closed(self.of(&f.gain, k, m, n));
            product(&mut tw, &t, &now, [width, n, n]);
            product_transposed(&mut z, &tw, &t, [width, n, width]);
            let free = inverse(self.of(&f.s, k, m, m), m);
            for i in 0..m {
                for j in 0..m {
                    z[(n + i) * width + n + j] += free[i * m + j];
                }
            }
            let b = self.of(&self.b, k, n, width);
            product(&mut bz, b, &z, [n, width, width]);
            product_transposed(&mut now, &bz, b, [n, width, n]);
            symmetrise(&mut now, n);
            out.x.extend(&now);
            out.z.extend(&z);
        }
        Ok(out)
    }

    /// Covariances of what is random: half of them is the derivative of ½ ln det with respect to Q and C.
    pub(super) fn random_covariances(&self, f: &Factor) -> Result<Spread, Fault> {
        let (n, random) = (self.n, self.random());
        let block = inverse(&self.random_first(f)?, random.len());
        let mut first = vec![0.0; n * n];
        for (i, &(row, si)) in random.iter().enumerate() {
            for (j, &(column, sj)) in random.iter().enumerate() {
                first[row * n + column] = si * block[i * random.len() + j] * sj;
            }
        }
        self.spread(f, first)
    }

    /// Covariances of the states given all data and the parameters, N of (n, n).
    pub(super) fn covariances(&self, f: &Factor) -> Result<Vec<f64>, Fault> {
        Ok(self.spread(f, inverse(&f.first, self.n))?.x)
    }

    /// Derivatives of ½ ln det with respect to B_k, N−1 of (n, n + m): P_{k+1} B_k W with W the covariance of z_k, for
    /// the slope of all that comes after is P_{k+1} x_{k+1} once later noises have answered.
    pub(super) fn passage_slopes(&self, f: &Factor, spread: &Spread) -> Result<Vec<f64>, Fault> {
        let (n, width) = (self.n, self.width());
        let mut out = vec![0.0; (self.samples - 1) * n * width];
        let mut bw = vec![0.0; n * width];
        let mut turn = self.turns(2);
        for (k, out) in out.chunks_exact_mut(n * width).enumerate() {
            turn()?;
            let (b, w) = (self.of(&self.b, k, n, width), self.of(&spread.z, k, width, width));
            product(&mut bw, b, w, [n, width, width]);
            product(out, self.of(&f.p, k + 1, n, n), &bw, [n, n, width]);
        }
        Ok(out)
    }

    /// Solves the quadratic program: `gx` N of n, `ge` N−1 of m, the gaps `d` N−1 of n.
    pub(super) fn solve(&self, f: &Factor, gx: &[f64], ge: &[f64], d: &[f64]) -> Result<Step, Fault> {
        let (n, m, width, last) = (self.n, self.m, self.width(), self.samples - 1);
        let mut linear = gx.to_vec();
        let mut feed = vec![0.0; last * m];
        let mut decrement = 0.0;
        let (mut slope, mut along) = (vec![0.0; n], vec![0.0; width]);
        let mut turn = self.turns(1);
        for k in (0..last).rev() {
            turn()?;
            let next = self.of(&f.p, k + 1, n, n);
            for i in 0..n {
                slope[i] = linear[(k + 1) * n + i] + dot(&next[i * n..(i + 1) * n], &d[k * n..(k + 1) * n]);
            }
            along[..n].fill(0.0);
            along[n..].copy_from_slice(&ge[k * m..(k + 1) * m]);
            add_transposed_product(&mut along, self.of(&self.b, k, n, width), &slope, [width, n, 1]);
            let right = &mut feed[k * m..(k + 1) * m];
            right.copy_from_slice(&along[n..]);
            solve(self.of(&f.s, k, m, m), right, m, 1);
            decrement += dot(&along[n..], right);
            let gain = self.of(&f.gain, k, m, n);
            for i in 0..n {
                let through: f64 = (0..m).map(|j| gain[j * n + i] * along[n + j]).sum();
                linear[k * n + i] += along[i] - through;
            }
        }
        let mut step = Step {
            x: linear[..n].iter().map(|p| -p).collect(),
            e: vec![0.0; last * m],
            lambda: vec![0.0; last * n],
            decrement: 0.0,
        };
        solve(&f.first, &mut step.x, n, 1);
        step.decrement = decrement - dot(&step.x, &linear[..n]);
        let mut z = vec![0.0; width];
        for k in 0..last {
            z[..n].copy_from_slice(&step.x[k * n..(k + 1) * n]);
            let gain = self.of(&f.gain, k, m, n);
            for i in 0..m {
                z[n + i] = -feed[k * m + i] - dot(&gain[i * n..(i + 1) * n], &z[..n]);
            }
            step.e[k * m..(k + 1) * m].copy_from_slice(&z[n..]);
            let b = self.of(&self.b, k, n, width);
            let next: Vec<f64> =
                (0..n).map(|i| d[k * n + i] + dot(&b[i * width..(i + 1) * width], &z)).collect();
            let p = self.of(&f.p, k + 1, n, n);
            for i in 0..n {
                step.lambda[k * n + i] = linear[(k + 1) * n + i] + dot(&p[i * n..(i + 1) * n], &next);
            }
            step.x.extend(&next);
        }
        Ok(step)
    }

    /// The Hessian in p parameters once path and noises are eliminated (the Schur complement), and how the first
    /// state follows them, (n, p): `by_p` N−1 of ∂Φ/∂θ (n, p); `cross` N of the Hessian between x and θ (n, p),
    /// `own` (p, p) between parameters, summed.
    pub(super) fn border(
        &self,
        f: &Factor,
        by_p: &[f64],
        cross: &[f64],
        own: &[f64],
        p: usize,
    ) -> Result<(Vec<f64>, Vec<f64>), Fault> {
        let (n, m, width, last) = (self.n, self.m, self.width(), self.samples - 1);
        let np = n * p;
        let mut schur = own.to_vec();
        let mut now = cross[last * np..].to_vec();
        let mut r = vec![0.0; np];
        let mut turns = current().turns((self.width() + p).pow(3));
        for k in (0..last).rev() {
            if turns.stop() {
                return Err(Fault::Stopped);
            }
            let by_p = &by_p[k * np..(k + 1) * np];
            product(&mut r, self.of(&f.p, k + 1, n, n), by_p, [n, n, p]);
            // bᵀ P b + bᵀ V + Vᵀ b, with V the block between x and θ.
            add_transposed_product(&mut schur, by_p, &r, [p, n, p]);
            add_transposed_product(&mut schur, by_p, &now, [p, n, p]);
            add_transposed_product(&mut schur, &now, by_p, [p, n, p]);
            r.iter_mut().zip(&now).for_each(|(r, v)| *r += v);
            let mut along = vec![0.0; width * p];
            add_transposed_product(&mut along, self.of(&self.b, k, n, width), &r, [width, n, p]);
            let (of_x, of_e) = along.split_at(np);
            let mut solved: Vec<f64> = of_e.iter().map(|v| -v).collect();
            solve(self.of(&f.s, k, m, m), &mut solved, m, p);
            add_transposed_product(&mut schur, of_e, &solved, [p, m, p]);
            now.copy_from_slice(&cross[k * np..(k + 1) * np]);
            now.iter_mut().zip(of_x).for_each(|(now, v)| *now += v);
            let minus: Vec<f64> = of_e.iter().map(|v| -v).collect();
            add_transposed_product(&mut now, self.of(&f.gain, k, m, n), &minus, [n, m, p]);
        }
        let mut follows: Vec<f64> = now.iter().map(|v| -v).collect();
        solve(&f.first, &mut follows, n, p);
        add_transposed_product(&mut schur, &now, &follows, [p, n, p]);
        symmetrise(&mut schur, p);
        Ok((schur, follows))
    }
}
