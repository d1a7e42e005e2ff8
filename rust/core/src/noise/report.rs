//! Noise parameters in the user's terms.

/// A named value of the noise, a function of its parameters.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Reported {
    /// `sigma_<output>`, `corr_<output>_<output>`, or a parameter of a density, `dof_<output>`.
    pub name: String,
    /// The output whose unit it has, if any.
    pub output: Option<usize>,
    /// Value.
    pub value: f64,
    /// Derivatives with respect to all parameters of the noise.
    pub gradient: Vec<f64>,
    /// The parameter whose bounds are its own, if any. Where `gradient` is negative there, the lower
    /// bound of one is the upper bound of the other.
    pub bounded_by: Option<usize>,
    /// Lower and upper bound of the value.
    pub bounds: (f64, f64),
}

impl Reported {
    /// 1/p of parameter `i` of `n`.
    pub(super) fn inverse(
        name: String,
        output: Option<usize>,
        i: usize,
        values: &[f64],
        bounds: (f64, f64),
    ) -> Self {
        let mut gradient = vec![0.0; values.len()];
        gradient[i] = -1.0 / (values[i] * values[i]);
        Reported { name, output, value: 1.0 / values[i], gradient, bounded_by: Some(i), bounds }
    }

    /// Parameter `i` itself.
    pub(super) fn plain(name: String, i: usize, values: &[f64], bounds: (f64, f64)) -> Self {
        let mut gradient = vec![0.0; values.len()];
        gradient[i] = 1.0;
        Reported { name, output: None, value: values[i], gradient, bounded_by: Some(i), bounds }
    }

    /// σ² of the value from the covariance of all parameters of the noise (`n × n`, by a function), and its
    /// covariance with another value: gradientᵀ C gradient' (the delta method). NaN where a parameter that
    /// matters has none.
    pub fn covariance(&self, other: &Reported, of_parameters: impl Fn(usize, usize) -> f64) -> f64 {
        let mut sum = 0.0;
        for (i, a) in self.gradient.iter().enumerate().filter(|g| *g.1 != 0.0) {
            for (j, b) in other.gradient.iter().enumerate().filter(|g| *g.1 != 0.0) {
                sum += a * b * of_parameters(i, j);
            }
        }
        sum
    }
}
