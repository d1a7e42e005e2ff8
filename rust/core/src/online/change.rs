//! Steps of parameters: the likelihood ratio of a change at each of several onsets (A. S. Willsky and H. L. Jones, *IEEE Transactions
//! on Automatic Control* 21, 1976).
//!
//! A change of a parameter by 1 at an onset makes an error of the estimate of states and parameters, which the linearised model
//! carries on and each update reduces. It shows in the innovations as a signature s. With d = Σ sᵀν and J = Σ sᵀs over the
//! normalised innovations ν since then, the change is d / J ± J^-½, and its likelihood ratio, averaged over changes of standard
//! deviation κ, is (1 + κ²J)^-½ exp(½ d² / (J + κ⁻²)).

use super::detector::{Detect, Sampled};
use super::evidence::log_sum;
use super::gauss_newton::GaussNewton;
use super::innovation::Innovation;

/// The evidence for a change of one parameter at one onset.
#[derive(Clone, Debug)]
struct Change {
    /// Error of the estimates for a change of 1, of m.
    error: Vec<f64>,
    since: f64,
    /// Value of the parameter then.
    before: f64,
    /// Standard deviation of the changes that are expected, κ; 0 for an onset that is not followed.
    spread: f64,
    /// d and J.
    along: f64,
    information: f64,
}

impl Change {
    /// The logarithm of its likelihood ratio.
    fn ratio(&self) -> f64 {
        if self.spread == 0.0 {
            return f64::NEG_INFINITY;
        }
        let (square, j) = (self.spread * self.spread, self.information);
        0.5 * self.along * self.along / (j + 1.0 / square) - 0.5 * (square * j).ln_1p()
    }
}

/// Changes of all watched parameters at all onsets.
#[derive(Debug)]
pub(super) struct Changes {
    /// Unknowns of the watched parameters.
    places: Vec<usize>,
    /// For each onset those of all watched parameters.
    all: Vec<Change>,
    /// Samples so far, and between two onsets.
    samples: usize,
    spacing: usize,
    relative: f64,
    n: usize,
    work: Vec<f64>,
    signature: Vec<f64>,
    flops: u64,
}

/// The change that explains the innovations best.
#[derive(Clone, Copy, Debug)]
pub(super) struct Best {
    /// Number of the parameter among the watched ones.
    pub(super) watched: usize,
    /// The logarithm of the statistic of this parameter, over all onsets.
    pub(super) statistic: f64,
    pub(super) since: f64,
    pub(super) before: f64,
    pub(super) change: f64,
    pub(super) error: f64,
}

impl Changes {
    pub(super) fn new(detect: &Detect, places: Vec<usize>, n: usize, m: usize, n_y: usize) -> Changes {
        let none = Change {
            error: vec![0.0; m],
            since: f64::NAN,
            before: 0.0,
            spread: 0.0,
            along: 0.0,
            information: 0.0,
        };
        Changes {
            all: vec![none; detect.onsets * places.len()],
            places: places.iter().map(|p| n + p).collect(),
            samples: 0,
            spacing: detect.spacing,
            relative: detect.change,
            n,
            work: vec![0.0; m],
            signature: vec![0.0; n_y],
            flops: 0,
        }
    }

    pub(super) fn flops(&self) -> u64 {
        self.flops
    }

    /// Operations of an update, at most.
    pub(super) fn bound(&self) -> u64 {
        let (m, n_y) = (self.work.len(), self.signature.len());
        (self.all.len() * (4 * m * (m + 1) + 2 * self.n * m + 2 * n_y * (m + n_y))) as u64
    }

    pub(super) fn reset(&mut self) {
        self.all.iter_mut().for_each(|c| c.spread = 0.0);
        self.samples = 0;
    }

    /// Takes the innovations of a sample: a change in the interval before it, or earlier, shows in them.
    pub(super) fn update(&mut self, solver: &mut GaussNewton, innovation: &Innovation, sample: Sampled<'_>) {
        if self.all.is_empty() {
            return;
        }
        let Some(segment) = sample.segment else { return };
        if self.samples.is_multiple_of(self.spacing) {
            self.begin(sample);
        }
        self.samples += 1;
        let (n, m, count) = (self.n, self.work.len(), solver.present.len());
        let Changes { all, work, signature, .. } = self;
        for own in all.iter_mut().filter(|c| c.spread > 0.0) {
            solver.carry(segment, &own.error, work);
            let signature = &mut signature[..count];
            for (s, row) in signature.iter_mut().zip(solver.last_rows.chunks_exact(m + 1)) {
                *s = row.iter().zip(work.iter()).map(|(h, e)| h * e).sum();
            }
            innovation.normalise(signature);
            for (s, v) in signature.iter().zip(&innovation.normalised) {
                own.along += s * v;
                own.information += s * s;
            }
            if count == 0 {
                own.error.copy_from_slice(work);
                continue;
            }
            // (I − K H) e = R⁺⁻¹ R⁺⁻ᵀ R⁻ᵀ R⁻ e
            solver.predicted.product(work, &mut own.error);
            solver.predicted.transposed_product(&own.error, work);
            solver.info.solve_transposed(work);
            solver.info.solve_for(work, &mut own.error);
            self.flops += (2 * n * m + 2 * count * (m + count)) as u64;
        }
    }

    /// Replaces the oldest onset by the sample before this one.
    fn begin(&mut self, sample: Sampled<'_>) {
        let watched = self.places.len();
        let onset = self.samples / self.spacing % (self.all.len() / watched);
        for (own, &place) in self.all[onset * watched..].iter_mut().zip(&self.places) {
            own.error.fill(0.0);
            own.error[place] = 1.0;
            own.since = sample.before;
            own.before = sample.theta[place - self.n];
            own.spread = self.relative * own.before.abs();
            (own.along, own.information) = (0.0, 0.0);
        }
    }

    /// The logarithm of the sum over parameters and onsets, each of which stands for as many samples as there are between two.
    pub(super) fn statistic(&self) -> f64 {
        (self.spacing as f64).ln() + log_sum(self.all.iter().map(Change::ratio))
    }

    pub(super) fn best(&self) -> Option<Best> {
        let watched = self.places.len();
        let size = |k: &usize| self.all[*k].ratio();
        let followed = (0..self.all.len()).filter(|k| self.all[*k].information > 0.0);
        let k = followed.max_by(|a, b| size(a).total_cmp(&size(b)))?;
        let own = &self.all[k];
        let sum = log_sum(self.all.iter().skip(k % watched).step_by(watched).map(Change::ratio));
        Some(Best {
            watched: k % watched,
            statistic: (self.spacing as f64).ln() + sum,
            since: own.since,
            before: own.before,
            change: own.along / own.information,
            error: own.information.powf(-0.5),
        })
    }
}
