//! Innovations that are larger than the model allows, or have a mean: likelihood ratios of each sample.

use super::evidence::{log_sum, softplus};
use super::innovation::Innovation;

/// Means of a shifted innovation, in standard deviations; both signs have half the weight.
const MEANS: [f64; 2] = [0.5, 1.5];
/// Factors of the standard deviation of an innovation.
const FACTORS: [f64; 2] = [1.5, 4.0];
/// The same for all outputs together.
const TOGETHER: f64 = 1.3;

/// Kinds of change of one output.
const KINDS: usize = 2 * MEANS.len() + FACTORS.len();

/// The statistic of one kind of change, and where its onset is.
#[derive(Clone, Copy, Debug)]
struct Running {
    /// Logarithm of its weight.
    weight: f64,
    /// Logarithm of the sum over all onsets of the likelihood ratio since then.
    sum: f64,
    /// Largest logarithm of a likelihood ratio over all onsets (Page 1954), and the onset.
    cusum: f64,
    since: f64,
}

impl Running {
    fn take(&mut self, log_ratio: f64, t: f64) {
        self.sum = softplus(self.sum) + log_ratio;
        if self.cusum <= 0.0 {
            (self.cusum, self.since) = (0.0, t);
        }
        self.cusum += log_ratio;
    }
}

/// Statistics of all outputs.
#[derive(Debug)]
pub(super) struct Shifts {
    /// `KINDS` for each output, then the one of all together.
    running: Vec<Running>,
}

/// The kind of change with the largest statistic.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shift {
    /// Its logarithm.
    pub(super) statistic: f64,
    pub(super) since: f64,
    pub(super) output: Option<usize>,
}

impl Shifts {
    pub(super) fn new(n_y: usize) -> Shifts {
        let mut running = Vec::with_capacity(n_y * KINDS + 1);
        for k in 0..n_y * KINDS + 1 {
            let half = k < n_y * KINDS && k % KINDS < 2 * MEANS.len();
            let weight = if half { 0.5_f64.ln() } else { 0.0 };
            running.push(Running { weight, sum: f64::NEG_INFINITY, cusum: 0.0, since: f64::NAN });
        }
        Shifts { running }
    }

    /// Number of kinds of change, which weights add up to.
    pub(super) fn kinds(&self) -> usize {
        (self.running.len() - 1) / KINDS * (MEANS.len() + FACTORS.len()) + 1
    }

    pub(super) fn reset(&mut self) {
        for own in &mut self.running {
            (own.sum, own.cusum, own.since) = (f64::NEG_INFINITY, 0.0, f64::NAN);
        }
    }

    /// Takes the innovations of the outputs of these numbers.
    pub(super) fn update(&mut self, present: &[usize], innovation: &Innovation, t: f64) {
        for (&output, &u) in present.iter().zip(&innovation.own) {
            let own = &mut self.running[output * KINDS..(output + 1) * KINDS];
            let means = MEANS.iter().flat_map(|m| [*m, -m]).map(|m| m * u - 0.5 * m * m);
            let factors = FACTORS.iter().map(|f| 0.5 * u * u * (1.0 - 1.0 / (f * f)) - f.ln());
            own.iter_mut().zip(means.chain(factors)).for_each(|(own, ratio)| own.take(ratio, t));
        }
        let (count, square) =
            (present.len() as f64, innovation.normalised.iter().map(|v| v * v).sum::<f64>());
        if let Some(all) = self.running.last_mut() {
            all.take(0.5 * square * (1.0 - 1.0 / (TOGETHER * TOGETHER)) - count * TOGETHER.ln(), t);
        }
    }

    /// The logarithm of the sum over all kinds.
    pub(super) fn statistic(&self) -> f64 {
        log_sum(self.running.iter().map(|r| r.weight + r.sum))
    }

    pub(super) fn best(&self) -> Shift {
        let last = self.running.len() - 1;
        let size = |k: &usize| self.running[*k].weight + self.running[*k].sum;
        let k = (0..=last).max_by(|a, b| size(a).total_cmp(&size(b))).unwrap_or(last);
        Shift { statistic: size(&k), since: self.running[k].since, output: (k < last).then_some(k / KINDS) }
    }
}
