//! The noise as a problem has it: with starts and bounds.

use super::Estimation;
use super::start::{Given, Start};
use crate::error::{Error, did_you_mean};
use crate::noise::{Channel, Covariance, Density, Dof, Joint, Noise, NoiseModel, SIGMA, Scale, Sigma};

/// Standard deviations without bounds of their own lie within these factors of the spread.
const RANGE: (f64, f64) = (1e-9, 1e6);

impl Estimation<'_> {
    /// The noise, with starts that follow from the measurements.
    pub(super) fn resolve_noise(&self, outputs: &[&str]) -> Result<Noise, Error> {
        self.given().check(self.experiments.iter().map(|e| e.name.as_str()), &names(&self.noise, outputs))?;
        let one = |(c, name): (usize, &&str)| {
            let samples: Vec<&[f64]> = self.experiments.iter().map(|e| &e.outputs[c][..]).collect();
            let unknown = matches!(self.noise.scale_of(name), None | Some(Scale::Unknown { .. }))
                && !matches!(self.noise.joint, Joint::Known(_));
            if unknown && !samples.is_empty() && !samples.iter().any(|z| moves(z)) {
                return Err(Error::data(format!(
                    "output '{name}' is the same in all samples, so its standard deviation cannot be estimated; \
                     take it out of the model, or give its standard deviation as known"
                )).about(name));
            }
            Ok(spread(&samples))
        };
        let spreads: Vec<f64> = outputs.iter().enumerate().map(one).collect::<Result<_, _>>()?;
        resolved(&self.noise, outputs, &spreads, &self.given())
    }
}

/// What may be started of the noise beside its scales.
fn names(noise: &NoiseModel, outputs: &[&str]) -> Vec<String> {
    if noise.joint == Joint::Unknown {
        let pairs = (0..outputs.len()).flat_map(|a| (a + 1..outputs.len()).map(move |b| (a, b)));
        return pairs.map(|(a, b)| format!("corr_{}_{}", outputs[a], outputs[b])).collect();
    }
    let own = |name: &&str| match noise.density_of(name) {
        Density::StudentT(Dof::Unknown { .. }) => vec![format!("dof_{name}")],
        Density::Custom(custom) => custom.parameters.iter().map(|p| format!("{}_{name}", p.name)).collect(),
        _ => Vec::new(),
    };
    outputs.iter().flat_map(own).collect()
}

/// Checks numbers, and that what is said is said of outputs.
fn check(noise: &NoiseModel, outputs: &[&str]) -> Result<(), Error> {
    for name in noise.scales.iter().map(|n| &n.0).chain(noise.densities.iter().map(|d| &d.0)) {
        if !outputs.contains(&name.as_str()) {
            let hint = did_you_mean(name, outputs.iter().copied());
            return Err(Error::model(format!("noise: '{name}' is not an output.{hint}")).about(name));
        }
    }
    noise.check()
}

/// The noise of these outputs with starts and bounds. `spreads` are the standard deviations of their measurements.
///
/// # Errors
/// For what cannot be right in it or in the starts.
pub fn resolved(
    noise: &NoiseModel,
    outputs: &[&str],
    spreads: &[f64],
    given: &Given<'_>,
) -> Result<Noise, Error> {
    check(noise, outputs)?;
    check_joint(noise, outputs, given)?;
    if let Joint::Known(matrix) = &noise.joint {
        return Covariance::known(outputs.len(), matrix).map(Noise::Correlated);
    }
    let sigmas = sigmas(noise, outputs, spreads, given)?;
    if noise.joint == Joint::Unknown {
        let n = outputs.len();
        let mut correlation = vec![0.0; n * n];
        for a in 0..n {
            correlation[a * n + a] = 1.0;
            for b in a + 1..n {
                let name = format!("corr_{}_{}", outputs[a], outputs[b]);
                let value = given.value(&name, 0.0, (-1.0, 1.0))?;
                (correlation[a * n + b], correlation[b * n + a]) = (value, value);
            }
        }
        return Ok(Noise::Correlated(Covariance::unknown(sigmas).starting_at(&correlation)));
    }
    if noise.densities.is_empty() {
        return Ok(Noise::Gaussian(sigmas));
    }
    let channel = |(name, sigma): (&&str, Sigma)| {
        let mut density = noise.density_of(name);
        match &mut density {
            Density::StudentT(Dof::Unknown { start, lower, upper }) => {
                *start = given.value(&format!("dof_{name}"), *start, (*lower, *upper))?;
            }
            Density::Custom(custom) => {
                for p in &mut custom.parameters {
                    let bounds = (p.lower.unwrap_or(f64::NEG_INFINITY), p.upper.unwrap_or(f64::INFINITY));
                    p.start = given.value(&format!("{}_{name}", p.name), p.start, bounds)?;
                }
            }
            _ => {}
        }
        Ok(Channel { sigma, density })
    };
    outputs.iter().zip(sigmas).map(channel).collect::<Result<_, Error>>().map(Noise::Independent)
}

/// What is said of single outputs has no place where a covariance says all.
fn check_joint(noise: &NoiseModel, outputs: &[&str], given: &Given<'_>) -> Result<(), Error> {
    let fail = |text: String| Err(Error::model(format!("noise: {text}")));
    let said = |name: &&&str| noise.density_of(name) != Density::Gaussian;
    match (&noise.joint, outputs.iter().find(said)) {
        (Joint::Independent, _) => Ok(()),
        (_, Some(output)) => {
            fail(format!("correlated noise is Gaussian: leave out the density of '{output}'"))
        }
        (Joint::Known(_), None) => {
            let scale = noise.scales.first().map(|s| format!("{SIGMA}{}", s.0));
            let given = given.values.iter().find(|s| outputs.iter().any(|o| s.0 == format!("{SIGMA}{o}")));
            match scale.or_else(|| given.map(|s| s.0.clone())) {
                Some(name) => {
                    fail(format!("the covariance is known, and it contains {name}: leave that out"))
                }
                None => Ok(()),
            }
        }
        (Joint::Unknown, None) => Ok(()),
    }
}

/// Scales with starts and bounds.
fn sigmas(
    noise: &NoiseModel,
    outputs: &[&str],
    spreads: &[f64],
    given: &Given<'_>,
) -> Result<Vec<Sigma>, Error> {
    let one = |(c, name): (usize, &&str)| {
        let said = noise.scale_of(name);
        let sigma = format!("{SIGMA}{name}");
        if let Some(Scale::Known(value)) = said {
            return match given.of(&sigma) {
                Some(_) => Err(Error::model(format!(
                    "{sigma} is known ({value}) and cannot be given a start as well"
                ))),
                None => Ok(Sigma::Known(*value)),
            };
        }
        if let Some(Scale::Expression(expr)) = said {
            return match given.of(&sigma) {
                Some(_) => Err(Error::model(format!(
                    "{sigma} is given by an expression ({expr}) and cannot be given a start as well"
                ))),
                None => Ok(Sigma::Expression(expr.clone())),
            };
        }
        let spread = spreads[c];
        let (mut start, mut lower, mut upper) = (spread, RANGE.0 * spread, RANGE.1 * spread);
        let (s, bounds) = match said {
            Some(Scale::Unknown { start, bounds }) => (*start, *bounds),
            _ => (None, None),
        };
        match (bounds, given.of(&sigma)) {
            (Some(said), _) => (lower, upper) = said,
            (None, Some(Start::Value(v))) => (lower, upper) = (lower.min(*v), upper.max(*v)),
            (None, _) => {
                (lower, upper) = (s.map_or(lower, |v| lower.min(v)), s.map_or(upper, |v| upper.max(v)))
            }
        }
        start = s.unwrap_or_else(|| start.min(upper).max(lower));
        start = given.value(&sigma, start, (lower, upper))?;
        // No useful fit is worse than a constant. Beside others of its kind, an output with a start far
        // above its spread would have no say in the first steps, and these can lead far away.
        Ok(Sigma::Unknown { start: start.min(spread.max(lower)), lower, upper })
    };
    outputs.iter().enumerate().map(one).collect()
}

/// Whether the samples that are there differ by more than rounding.
fn moves(z: &[f64]) -> bool {
    let present = || z.iter().copied().filter(|v| !v.is_nan());
    let (low, high) = present().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (v.min(l), v.max(h)));
    high - low > 4.0 * f64::EPSILON * low.abs().max(high.abs())
}

/// Standard deviation of the measurements of an output over all experiments: the scale of its noise.
pub(crate) fn spread(samples: &[&[f64]]) -> f64 {
    let mut z: Vec<f64> = samples.iter().copied().flatten().copied().filter(|v| !v.is_nan()).collect();
    let n = z.len() as f64;
    let mean = pairwise_sum(&z) / n;
    z.iter_mut().for_each(|v| *v = (*v - mean) * (*v - mean));
    let spread = (pairwise_sum(&z) / n).sqrt();
    if spread > 0.0 { spread } else { 1.0 }
}

/// The sum, halves apart, whose rounding error grows with the logarithm of their number: in numpy's order, to its bits.
fn pairwise_sum(z: &[f64]) -> f64 {
    if z.len() > 128 {
        let half = z.len() / 2;
        let (first, second) = z.split_at(half - half % 8);
        return pairwise_sum(first) + pairwise_sum(second);
    }
    let (whole, rest) = z.as_chunks::<8>();
    let total = whole.split_first().map(|(first, others)| {
        let mut r = *first;
        others.iter().for_each(|chunk| r.iter_mut().zip(chunk).for_each(|(r, v)| *r += v));
        ((r[0] + r[1]) + (r[2] + r[3])) + ((r[4] + r[5]) + (r[6] + r[7]))
    });
    total.into_iter().chain(rest.iter().copied()).reduce(|a, b| a + b).unwrap_or(0.0)
}
