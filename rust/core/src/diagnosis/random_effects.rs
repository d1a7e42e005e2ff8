//! The likelihood of residuals with random effects, and its maximum over the variances.

use crate::dense::{axpy, backward, cholesky, factorise, forward, inverse_of_first, solve_factorised};
use crate::interrupt::current;
use crate::simd::kernel;

/// Added to the normal equations of the parameters, in parts of their largest: directions that the rows do not determine
/// stay where they are.
const RIDGE: f64 = 1e-10;
/// The same for random coefficients, which have a prior already.
const ROUNDING: f64 = 1e-13;
/// Steps before those of Newton, and how many of those there are; twice the log-likelihood below which these are no gain,
/// and how far the logarithm of a variance goes at once.
const STEPS: usize = 2;
const NEWTON_STEPS: usize = 30;
const EQUAL: f64 = 2e-4;
const LONGEST: f64 = 3.0;
/// Part of the samples that is left beside coefficients, at least.
const LEFT: f64 = 1e-3;
/// Logarithm of the factor within which variances are sought about where they start: 1e6.
const RANGE: f64 = 13.815_510_557_964_274;
const TINY: f64 = 1e-300;

/// Residuals r = T b + G d + v, with free coefficients b, random ones d ~ N(0, s² C), and v white noise of a variance for
/// each of n_y outputs. Products are those of the m columns (G, T) and r over the rows of each output.
///
/// The likelihood is that of a linear mixed model, maximised over b (Harville 1977).
#[derive(Clone, Debug)]
pub struct RandomEffects<'a> {
    /// Number of random coefficients, k ≤ m.
    pub k: usize,
    /// (n_y, m, m) products of the columns with each other.
    pub grams: &'a [f64],
    /// (n_y, m) products of the columns with r.
    pub with_r: &'a [f64],
    /// (n_y) squares of r.
    pub squares: &'a [f64],
    /// (n_y) numbers of rows.
    pub counts: &'a [f64],
    /// (k, k) the inverse of C.
    pub precision: &'a [f64],
    /// ln det C.
    pub log_det: f64,
}

/// The likelihood at logarithms of the variances: s² first, then those of the noise.
#[derive(Clone, Debug)]
pub struct Marginal {
    /// Logarithms of the variances.
    pub x: Vec<f64>,
    /// Minus twice the logarithm of the likelihood, maximised over b.
    pub value: f64,
    /// Its gradient.
    pub gradient: Vec<f64>,
    /// The average information (Gilmour, Thompson and Cullis 1995), for its Hessian.
    pub information: Vec<f64>,
    /// The step of the fixed-point iteration of MacKay (1992, eq. 5).
    pub step: Vec<f64>,
    /// (m) the mean of the coefficients, (d, b).
    pub solution: Vec<f64>,
    /// (m, m) Cholesky factor of their normal equations, in the lower triangle.
    pub factor: Vec<f64>,
    /// The effective number of random coefficients.
    pub unknowns: f64,
}

impl RandomEffects<'_> {
    /// Evaluates the likelihood; `None` where the normal equations are not positive definite.
    pub fn at(&self, x: &[f64]) -> Option<Marginal> {
        let (k, n_y) = (self.k, self.counts.len());
        let m = self.with_r.len() / n_y.max(1);
        let s2 = x[0].exp();
        let weights: Vec<f64> = x[1..].iter().map(|x| (-x).exp()).collect();
        let (mut factor, mut right) = (vec![0.0; m * m], vec![0.0; m]);
        for (y, &weight) in weights.iter().enumerate() {
            axpy(&mut factor, weight, &self.grams[y * m * m..][..m * m]);
            axpy(&mut right, weight, &self.with_r[y * m..][..m]);
        }
        let largest = |range: std::ops::Range<usize>| range.map(|i| factor[i * m + i]).fold(0.0, f64::max);
        let (ridge, rounding) = (RIDGE * largest(k..m).max(TINY), ROUNDING * largest(0..k));
        (0..k).for_each(|i| factor[i * m + i] += rounding);
        (k..m).for_each(|i| factor[i * m + i] += ridge);
        for i in 0..k {
            axpy(&mut factor[i * m..][..k], 1.0 / s2, &self.precision[i * k..][..k]);
        }
        cholesky(&mut factor, m, |_| 0.0).ok()?;
        let mut solution = right.clone();
        forward(&factor, m, &mut solution);
        backward(&factor, m, &mut solution);
        // Coefficients come first: their own factor is the first part of the whole one.
        let inverse = inverse_of_first(&factor, m, k);
        let log_det =
            (0..k).map(|i| 2.0 * factor[i * m + i].ln()).sum::<f64>() + k as f64 * x[0] + self.log_det;
        let value =
            dot(self.counts, &x[1..]) + log_det + dot(self.squares, &weights) - dot(&right, &solution);

        // Squares that are left, and the samples and coefficients that they are worth, by part.
        let size = n_y + 1;
        let (d, b) = solution.split_at(k);
        let (mut squares, mut taken) = (vec![0.0; size], vec![0.0; size]);
        squares[0] = (0..k).map(|i| d[i] * dot(&self.precision[i * k..][..k], d)).sum::<f64>() / s2;
        taken[0] = dot(self.precision, &inverse) / s2;
        // What P of Gilmour, Thompson and Cullis makes of the parts' working variates, which are the coefficients' share
        // of the outputs and the residuals of each output: squares in the metric of the noise, and their projections.
        let mut metric = vec![0.0; size * size];
        let mut projected = vec![vec![0.0; m]; size];
        for (y, &weight) in weights.iter().enumerate() {
            let (gram, with_r) = (&self.grams[y * m * m..][..m * m], &self.with_r[y * m..][..m]);
            let (mut fitted, mut both) = (0.0, 0.0);
            for i in 0..m {
                let row = &gram[i * m..][..m];
                let (of_d, of_b) = (dot(&row[..k], d), dot(&row[k..], b));
                fitted += solution[i] * (of_d + of_b);
                projected[0][i] += weight * of_d;
                projected[y + 1][i] = weight * (with_r[i] - of_d - of_b);
                if i < k {
                    both += dot(&row[..k], &inverse[i * k..][..k]);
                }
            }
            squares[y + 1] = (self.squares[y] - 2.0 * dot(&solution, with_r) + fitted) * weight;
            taken[y + 1] = both * weight;
            metric[(y + 1) * size + y + 1] = squares[y + 1];
        }
        for y in 0..size {
            let inner = dot(d, &projected[y][..k]);
            (metric[y], metric[y * size]) = (inner, inner);
        }
        projected.iter_mut().for_each(|column| forward(&factor, m, column));
        let information = (0..size * size)
            .map(|at| metric[at] - dot(&projected[at / size], &projected[at % size]))
            .collect();
        let counts = || std::iter::once(k as f64).chain(self.counts.iter().copied());
        let gradient = counts().zip(squares.iter().zip(&taken)).map(|(n, (s, t))| n - s - t).collect();
        let step = counts().zip(squares.iter().zip(&taken));
        let step = step.map(|(n, (s, t))| (s.max(TINY) / (n - t).max(LEFT * n)).ln()).collect();
        let unknowns = k as f64 - taken[0];
        Some(Marginal { x: x.to_vec(), value, gradient, information, step, solution, factor, unknowns })
    }

    /// Maximises the likelihood over the variances, from their logarithms `x`: first by the steps of MacKay, which go far,
    /// then by Newton's with the average of the observed and the expected information, which settle them.
    ///
    /// `None` where the normal equations are not positive definite at a point that is tried, or the interrupt in force
    /// stops it.
    pub fn maximised(&self, x: &[f64]) -> Option<Marginal> {
        let within = |to: Vec<f64>| -> Vec<f64> {
            to.into_iter().zip(x).map(|(to, x)| to.clamp(x - RANGE, x + RANGE)).collect()
        };
        let moved = |from: &[f64], part: f64, step: &[f64]| -> Vec<f64> {
            from.iter().zip(step).map(|(x, s)| x + part * s).collect()
        };
        let mut best = self.at(x)?;
        for _ in 0..STEPS {
            let found = self.at(&within(moved(&best.x, 1.0, &best.step)))?;
            if found.value.is_nan() || found.value >= best.value {
                break;
            }
            best = found;
        }
        for _ in 0..NEWTON_STEPS {
            if current().stops() {
                return None;
            }
            let Some(step) = best.newton_step() else { break };
            let step: Vec<f64> =
                within(moved(&best.x, 1.0, &step)).iter().zip(&best.x).map(|(to, x)| to - x).collect();
            let gain = -0.5 * dot(&best.gradient, &step);
            if gain.is_nan() || gain <= EQUAL {
                break;
            }
            let mut better = None;
            for part in [1.0, 0.3, 0.1] {
                let found = self.at(&moved(&best.x, part, &step))?;
                if found.value < best.value {
                    better = Some(found);
                    break;
                }
            }
            match better {
                Some(found) => best = found,
                None => break,
            }
        }
        Some(best)
    }
}

impl Marginal {
    /// The step to where the gradient vanishes, no longer than a variance can be extrapolated; `None` where the
    /// information is singular.
    fn newton_step(&self) -> Option<Vec<f64>> {
        let n = self.x.len();
        let mut damped = self.information.clone();
        (0..n).for_each(|i| damped[i * n + i] += RIDGE * damped[i * n + i].max(TINY));
        let mut step: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        let mut pivots = vec![0; n];
        let solved = factorise(&mut damped, &mut pivots) && solve_factorised(&damped, &pivots, &mut step, 1);
        let longest = step.iter().fold(0.0f64, |most, s| most.max(s.abs()));
        step.iter_mut().for_each(|s| *s /= (longest / LONGEST).max(1.0));
        solved.then_some(step)
    }
}

kernel! {
    /// Σ a·b.
    fn dot(a: &[f64], b: &[f64]) -> f64 {
        crate::dense::dot_of(a, b)
    }
}
