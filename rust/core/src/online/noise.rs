//! Standard deviations of the measurement noise: given, or estimated while the data arrive.

/// A running estimate for each output.
#[derive(Clone, Debug)]
pub(super) struct NoiseLevel {
    /// Standard deviations, n_y.
    pub(super) sigma: Vec<f64>,
    /// Sums of products of innovation and residual, and of the weights of the samples.
    sums: Vec<f64>,
    weights: Vec<f64>,
    estimated: bool,
}

/// A standard deviation is never less than this part of the one it starts from: an output that repeats itself would take all weight.
const LEAST: f64 = 1e-3;

impl NoiseLevel {
    /// From given ones, which count for so many samples.
    pub(super) fn new(sigma: Vec<f64>, estimated: bool, weight: f64) -> NoiseLevel {
        let sums = sigma.iter().map(|s| weight * s * s).collect();
        NoiseLevel { weights: vec![weight; sigma.len()], sums, sigma, estimated }
    }

    /// Takes an innovation e and the residual r of the same sample after the update. The mean of e r is σ², whatever the
    /// covariance of the estimate: r = σ² S⁻¹ e for innovations of covariance S (G. Desroziers et al., *Q. J. R. Meteorol. Soc.*
    /// 131, 2005, eq. 1.4). Older products decay by `keep`.
    pub(super) fn update(&mut self, output: usize, innovation: f64, residual: f64, keep: f64) {
        let product = innovation * residual;
        if !self.estimated || !product.is_finite() {
            return;
        }
        let (sum, weight) = (&mut self.sums[output], &mut self.weights[output]);
        *sum = keep * *sum + product;
        *weight = keep * *weight + 1.0;
        let least = LEAST * self.sigma[output];
        self.sigma[output] = (*sum / *weight).max(least * least).sqrt();
    }

    pub(super) fn copy_from(&mut self, other: &NoiseLevel) {
        self.sigma.copy_from_slice(&other.sigma);
        self.sums.copy_from_slice(&other.sums);
        self.weights.copy_from_slice(&other.weights);
    }
}
