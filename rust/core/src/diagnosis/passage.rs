//! A channel's autoregressive model along a segment: each sample predicted from all before it, also past a gap.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::simd::kernel;

/// Over gaps longer than this, variances are the stationary ones less the remaining knowledge; else they are summed
/// up step by step, which loses no digits.
const LONG: usize = 64;
/// Least ratio of the standard deviation of the errors to that of the noise at which something is known past a gap. Below
/// it the covariances of values in a row differ by less than their digits tell, and Kalman's filter would be of any size.
const PREDICTABLE: f64 = 1e-5;
/// Samples that are predicted together: they stay in the first cache.
const AT_ONCE: usize = 512;

/// The autoregressive model of a channel: the best predictors from 0, 1, ..., p samples, the latest first, and the
/// standard deviations of their errors.
pub struct Predictors {
    coefficients: Vec<Vec<f64>>,
    sigmas: Vec<f64>,
}

impl Predictors {
    /// Predictor k has k coefficients; there are as many standard deviations as predictors, one at least.
    pub fn new(coefficients: Vec<Vec<f64>>, sigmas: Vec<f64>) -> Self {
        assert!(
            coefficients.len() == sigmas.len() && coefficients.iter().enumerate().all(|(k, c)| c.len() == k)
        );
        Predictors { coefficients, sigmas }
    }

    fn order(&self) -> usize {
        self.sigmas.len() - 1
    }

    /// (p, p) from the last p values, the newest first, to those one step later, but for the error.
    fn transition(&self) -> DMatrix<f64> {
        let p = self.order();
        let a = &self.coefficients[p];
        DMatrix::from_fn(p, p, |i, j| if i == 0 { a[j] } else { f64::from(i == j + 1) })
    }

    /// (p, p) of p values in a row, by Levinson's recursion.
    pub(super) fn covariance(&self) -> DMatrix<f64> {
        let p = self.order();
        let mut gamma = vec![self.sigmas[0] * self.sigmas[0]];
        for k in 1..p {
            let known: f64 =
                self.coefficients[k - 1].iter().zip(gamma.iter().rev()).map(|(a, g)| a * g).sum();
            gamma.push(known + self.coefficients[k][k - 1] * self.sigmas[k - 1].powi(2));
        }
        DMatrix::from_fn(p, p, |i, j| gamma[i.abs_diff(j)])
    }
}

/// The step to a sample whose last p places are not all measured, by Kalman's filter (1960): the effect of the
/// sample's error on the last p values, and its standard deviation.
struct Step {
    gain: DVector<f64>,
    sigma: f64,
}

/// Samples without a gap.
struct Run {
    samples: Range<usize>,
    /// The transition of knowledge of p values to the first sample, over the gap before it.
    transition: Option<DMatrix<f64>>,
    steps: Vec<Step>,
}

/// The errors are those of the exact likelihood. Where the last p samples are there, they alone count; at the beginning
/// and after a gap, p samples long at most, Kalman's filter says what is known; nothing, where the noise is so nearly
/// predictable that no digits are left for it.
pub struct Passage {
    predictor: Vec<f64>,
    sigma: f64,
    runs: Vec<Run>,
    /// Predictors from fewer samples and the standard deviations of their errors, where each run begins without
    /// knowledge of those before it.
    fewer: Vec<(Vec<f64>, f64)>,
}

impl Passage {
    /// Along samples at `places` (increasing) of a grid of time; `covariance` is that of the model.
    pub(super) fn new(model: &Predictors, covariance: &DMatrix<f64>, places: &[usize]) -> Self {
        let p = model.order();
        let (step, last) = (model.transition(), model.sigmas[p]);
        let alone = last < PREDICTABLE * model.sigmas[0];
        let mut known = covariance.clone(); // of the error of what is known of the last p values
        let mut runs = Vec::new();
        let mut begin = 0;
        for end in 1..=places.len() {
            if end < places.len() && places[end] == places[end - 1] + 1 {
                continue;
            }
            let mut run = Run { samples: begin..end, transition: None, steps: Vec::new() };
            for i in begin..if alone { begin } else { end.min(begin + p) } {
                let gap = if i == 0 { 0 } else { places[i] - places[i - 1] };
                if gap > LONG {
                    let over = step.pow(u32::try_from(gap).unwrap_or(u32::MAX));
                    known = covariance + &over * (known - covariance) * over.transpose();
                } else {
                    for _ in 0..gap {
                        known = &step * known * step.transpose();
                        known[(0, 0)] += last * last;
                    }
                }
                if i == begin && i > 0 {
                    run.transition = Some(step.pow(u32::try_from(gap).unwrap_or(u32::MAX)));
                }
                let gain = known.column(0) / known[(0, 0)];
                run.steps.push(Step { sigma: known[(0, 0)].sqrt(), gain: gain.clone() });
                known -= gain * known.row(0).clone_owned();
            }
            if end - begin >= p {
                known.fill(0.0);
            }
            runs.push(run);
            begin = end;
        }
        let orders = model.coefficients.iter().cloned().zip(model.sigmas.iter().copied());
        let fewer = if alone { orders.take(p).collect() } else { Vec::new() };
        Passage { predictor: model.coefficients[p].clone(), sigma: last, runs, fewer }
    }

    /// Number of samples.
    pub(super) fn len(&self) -> usize {
        self.runs.last().map_or(0, |run| run.samples.end)
    }

    /// Prediction errors of samples, in units of their standard deviations.
    pub(super) fn errors(&self, x: &[f64], out: &mut [f64]) {
        let p = self.predictor.len();
        let mut state = DVector::zeros(p);
        for run in &self.runs {
            let (x, out) = (&x[run.samples.clone()], &mut out[run.samples.clone()]);
            predicted(x, &self.predictor, 1.0 / self.sigma, out);
            for (t, (predictor, sigma)) in self.fewer.iter().enumerate().take(x.len()) {
                let known: f64 = predictor.iter().zip(x[..t].iter().rev()).map(|(a, x)| a * x).sum();
                out[t] = (x[t] - known) / sigma;
            }
            if let Some(transition) = &run.transition {
                state = transition * state;
            }
            for (t, step) in run.steps.iter().enumerate() {
                if t > 0 {
                    let next = self.predictor.iter().zip(&state).map(|(a, s)| a * s).sum();
                    state.as_mut_slice().rotate_right(1);
                    state[0] = next;
                }
                let error = x[t] - state[0];
                out[t] = error / step.sigma;
                state.axpy(error, &step.gain, 1.0);
            }
            if x.len() >= p {
                state.iter_mut().zip(x.iter().rev()).for_each(|(s, x)| *s = *x);
            }
        }
    }

    /// Logarithms of the standard deviations of the errors.
    pub(super) fn log_scales(&self, out: &mut [f64]) {
        out.fill(self.sigma.ln());
        for run in &self.runs {
            let out = &mut out[run.samples.clone()];
            let sigmas = run.steps.iter().map(|step| step.sigma).chain(self.fewer.iter().map(|f| f.1));
            out.iter_mut().zip(sigmas).for_each(|(out, sigma)| *out = sigma.ln());
        }
    }
}

kernel! {
    /// Errors of the samples from the p-th on, predicted from the p before, times a scale; those of the first are not set.
    fn predicted(x: &[f64], predictor: &[f64], scale: f64, out: &mut [f64]) {
        let p = predictor.len();
        let mut t = p;
        while t < x.len() {
            let end = x.len().min(t + AT_ONCE);
            let out = &mut out[t..end];
            for (o, x) in out.iter_mut().zip(&x[t..end]) {
                *o = x * scale;
            }
            for (i, a) in predictor.iter().enumerate() {
                let a = -a * scale;
                for (o, x) in out.iter_mut().zip(&x[t - 1 - i..end - 1 - i]) {
                    *o = a.mul_add(*x, *o);
                }
            }
            t = end;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals of a simulation that has left its record: of ten coefficients, next to nothing is new.
    #[test]
    fn gaps_in_noise_that_is_nearly_predictable_leave_errors_finite() {
        let reflections: [f64; 10] = [
            0.995_665_55,
            -0.994_635_61,
            0.979_315_02,
            -0.972_133_72,
            0.943_485_48,
            -0.928_796_6,
            0.885_981_24,
            -0.861_787_3,
            0.765_562_08,
            -0.545_996_61,
        ];
        let (mut coefficients, mut sigmas) = (vec![vec![]], vec![2.6e-3]);
        for k in reflections {
            let before: &Vec<f64> = coefficients.last().unwrap();
            let mut next: Vec<f64> = before.iter().zip(before.iter().rev()).map(|(a, b)| a - k * b).collect();
            next.push(k);
            sigmas.push(sigmas.last().unwrap() * (1.0 - k * k).sqrt());
            coefficients.push(next);
        }
        let model = Predictors::new(coefficients, sigmas);
        let places: Vec<usize> = (0..45).chain([94]).chain(160..190).collect();
        let passage = Passage::new(&model, &model.covariance(), &places);
        let x: Vec<f64> = places.iter().map(|&i| 2e-3 * (0.01 * i as f64).sin()).collect();
        let mut out = vec![0.0; x.len()];
        passage.errors(&x, &mut out);
        // The model's own predictions of so smooth a sequence are off by less than a few of their deviations.
        assert!(out.iter().all(|e| e.abs() < 10.0), "{out:?}");
        passage.log_scales(&mut out);
        assert!(out.iter().all(|s| *s >= model.sigmas[10].ln() && *s <= model.sigmas[0].ln()));
    }
}
