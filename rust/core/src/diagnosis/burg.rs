//! Autoregressive models of residuals by Burg's recursion.

/// The greatest order.
const LONGEST: usize = 12;
/// Samples for each coefficient, and samples whose lags are all there for each.
const SAMPLES_EACH: usize = 10;
const PAIRS_EACH: usize = 5;
/// Of all samples, the part whose lags are all there: of a record in tatters little can be said.
const TATTERS: usize = 4;
/// A reflection coefficient this near to 1 is as good as a unit root: the filter stays invertible.
const EDGE: f64 = 1.0 - 1e-6;
/// What is left of the variance where the next sample is known from those before it: rounding.
const EXACT: f64 = 1e-14;

/// Residuals that are equally spaced and without a gap: sequences of `n` values each, one after the other, that stand
/// for the same samples.
pub struct Run {
    /// All sequences, one after the other.
    pub values: Vec<f64>,
    /// Samples of each.
    pub n: usize,
}

/// The AR models of some runs of one series, of all orders up to the best: the predictors of order 0, 1, ..., and the
/// variances of their errors.
///
/// The squares of a run's sequences are added, and its samples count once. The order has the least BIC (Schwarz 1978), of
/// those up to 12 and a tenth of the samples, as long as the lags are there for a quarter of the samples. What an order
/// gains counts for the samples that have its lags: where there are gaps, few have long ones. The mean is not removed.
pub fn burg(runs: Vec<Run>) -> (Vec<Vec<f64>>, Vec<f64>) {
    let n: usize = runs.iter().map(|run| run.n).sum();
    let power = runs.iter().flat_map(|run| &run.values).map(|v| v * v).sum::<f64>() / n.max(1) as f64;
    let (mut predictors, mut powers) = (vec![Vec::new()], vec![power]);
    // At place t: the error of the prediction of sample t from those before it, and that of the sample so many steps
    // before, from those after it.
    let mut errors: Vec<(Run, Vec<f64>)> = runs
        .into_iter()
        .map(|run| {
            let backward = run.values.clone();
            (run, backward)
        })
        .collect();
    let (mut best, mut bic, mut best_bic) = (0, 0.0, 0.0);
    for p in 1..=LONGEST.min(n / SAMPLES_EACH) {
        // Runs that are shorter than the lags say nothing more.
        errors.retain(|(run, _)| run.n > p);
        let count: usize = errors.iter().map(|(run, _)| run.n - p).sum();
        let (mut product, mut size) = (0.0, 0.0);
        for (run, backward) in &errors {
            for (f, b) in run.values.chunks_exact(run.n).zip(backward.chunks_exact(run.n)) {
                for (f, b) in f[p..].iter().zip(&b[p - 1..]) {
                    product += f * b;
                    size += f * f + b * b;
                }
            }
        }
        if size.is_nan() || size <= 0.0 || count < (n / TATTERS).max(PAIRS_EACH * p) {
            break;
        }
        let k = (2.0 * product / size).clamp(-EDGE, EDGE);
        let before: &Vec<f64> = &predictors[p - 1];
        let mut next: Vec<f64> = before.iter().zip(before.iter().rev()).map(|(a, b)| a - k * b).collect();
        next.push(k);
        predictors.push(next);
        powers.push(powers[p - 1] * (1.0 - k * k));
        for (run, backward) in &mut errors {
            for (f, b) in run.values.chunks_exact_mut(run.n).zip(backward.chunks_exact_mut(run.n)) {
                for t in (p..f.len()).rev() {
                    let (forward, back) = (f[t], b[t - 1]);
                    f[t] = forward - k * back;
                    b[t] = back - k * forward;
                }
            }
        }
        bic += count as f64 * (-k * k).ln_1p() + (n as f64).ln();
        if bic < best_bic {
            (best, best_bic) = (p, bic);
        }
        // As a constant and a pure sine are.
        if k.abs() == EDGE || powers[p] <= EXACT * power {
            break;
        }
    }
    predictors.truncate(best + 1);
    powers.truncate(best + 1);
    (predictors, powers)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// r[t] = 1.2 r[t-1] - 0.5 r[t-2] + e[t], with e from a linear congruential generator.
    fn series(n: usize) -> Vec<f64> {
        let mut seed = 1_u64;
        let mut e = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let mut r = vec![0.0; n];
        for t in 2..n {
            r[t] = 1.2 * r[t - 1] - 0.5 * r[t - 2] + e();
        }
        r
    }

    #[test]
    fn a_process_of_order_two_is_found() {
        let (predictors, powers) = burg(vec![Run { values: series(20_000), n: 20_000 }]);
        assert_eq!(predictors.len(), 3);
        assert!((predictors[2][0] - 1.2).abs() < 0.03 && (predictors[2][1] + 0.5).abs() < 0.03);
        assert!((powers[2] * 12.0 - 1.0).abs() < 0.03, "the variance of a uniform variable is 1/12");
    }

    #[test]
    fn two_sequences_of_the_same_samples_have_the_sum_of_their_powers() {
        let r = series(2_000);
        let (alone, power) = burg(vec![Run { values: r.clone(), n: 2_000 }]);
        let (both, powers) = burg(vec![Run { values: [r.clone(), r].concat(), n: 2_000 }]);
        assert_eq!(alone.len(), both.len());
        assert!((powers[0] / power[0] - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_constant_is_predicted_and_no_runs_are_white() {
        let (predictors, powers) = burg(vec![Run { values: vec![1.0; 100], n: 100 }]);
        assert_eq!(predictors.len(), 2);
        assert!(powers[1] < 1e-5);
        assert_eq!(burg(Vec::new()).1, [0.0]);
    }
}
