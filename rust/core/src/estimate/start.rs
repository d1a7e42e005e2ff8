//! Where an estimation starts: parameters as declared, standard deviations at the spread of the
//! measurements, states as measured.

use super::Estimation;
use super::measured::measured_states;
use crate::error::Error;
use crate::interpolate::{Interpolation, interpolate};
use crate::noise::{Channel, Covariance, Density, Dof, Joint, Noise, SIGMA, Scale, Sigma};
use crate::problem::Transcribed;

/// A starting value. It is made from a number, from the path of a state in the only experiment, or from
/// its paths in all of them.
#[derive(Clone, Debug, PartialEq)]
pub enum Start {
    /// A number, for a state at all times.
    Value(f64),
    /// Paths of a state, one an experiment, each of one value a sample.
    Paths(Vec<Vec<f64>>),
}

impl From<f64> for Start {
    fn from(value: f64) -> Self {
        Start::Value(value)
    }
}

impl From<Vec<f64>> for Start {
    fn from(path: Vec<f64>) -> Self {
        Start::Paths(vec![path])
    }
}

impl From<Vec<Vec<f64>>> for Start {
    fn from(paths: Vec<Vec<f64>>) -> Self {
        Start::Paths(paths)
    }
}

/// Standard deviations without bounds of their own lie within these factors of the spread.
const RANGE: (f64, f64) = (1e-9, 1e6);

impl Estimation<'_> {
    fn given(&self, name: &str) -> Option<&Start> {
        self.start.iter().rev().find(|s| s.0 == name).map(|s| &s.1)
    }

    /// The start of a parameter: given, or as a fit has it, or as declared.
    fn value(&self, name: &str, declared: f64, bounds: (f64, f64)) -> Result<f64, Error> {
        let fail = |text: String| Err(Error::Option(format!("start: '{name}' {text}")));
        match self.given(name) {
            Some(Start::Paths(_)) => fail("is a parameter: give one number".into()),
            Some(Start::Value(v)) if !v.is_finite() => fail(format!("is {v}, not a finite number")),
            Some(Start::Value(v)) if *v < bounds.0 || *v > bounds.1 => {
                fail(format!("= {v} lies outside its bounds {bounds:?}; move one of them"))
            }
            Some(Start::Value(v)) => Ok(*v),
            None => {
                let fitted = self.warm.and_then(|fit| fit.parameter(name)).map(|e| e.value);
                Ok(fitted.map_or(declared, |v| v.max(bounds.0).min(bounds.1)))
            }
        }
    }

    pub(super) fn parameters(&self) -> Result<Vec<f64>, Error> {
        let one = |p: &crate::model::Parameter| {
            let bounds = (p.lower.unwrap_or(f64::NEG_INFINITY), p.upper.unwrap_or(f64::INFINITY));
            if !p.fixed {
                return self.value(&p.name, p.start, bounds);
            }
            match self.given(&p.name) {
                Some(given) if *given != Start::Value(p.start) => Err(Error::Option(format!(
                    "start: '{}' is fixed at {} and cannot start elsewhere",
                    p.name, p.start
                ))),
                _ => Ok(p.start),
            }
        };
        self.model.parameters.iter().map(one).collect()
    }

    /// What may be started of the noise beside its scales.
    pub(super) fn names_of_noise(&self, outputs: &[&str]) -> Vec<String> {
        if self.noise.joint == Joint::Unknown {
            let pairs = (0..outputs.len()).flat_map(|a| (a + 1..outputs.len()).map(move |b| (a, b)));
            return pairs.map(|(a, b)| format!("corr_{}_{}", outputs[a], outputs[b])).collect();
        }
        let own = |name: &&str| match self.noise.density_of(name) {
            Density::StudentT(Dof::Unknown { .. }) => vec![format!("dof_{name}")],
            Density::Custom(custom) => {
                custom.parameters.iter().map(|p| format!("{}_{name}", p.name)).collect()
            }
            _ => Vec::new(),
        };
        outputs.iter().flat_map(own).collect()
    }

    /// The noise with starts and bounds.
    pub(super) fn resolve_noise(&self, outputs: &[&str]) -> Result<Noise, Error> {
        self.check_joint(outputs)?;
        if let Joint::Known(matrix) = &self.noise.joint {
            return Covariance::known(outputs.len(), matrix).map(Noise::Correlated);
        }
        let sigmas = self.resolve_sigmas(outputs)?;
        if self.noise.joint == Joint::Unknown {
            let n = outputs.len();
            let mut correlation = vec![0.0; n * n];
            for a in 0..n {
                correlation[a * n + a] = 1.0;
                for b in a + 1..n {
                    let name = format!("corr_{}_{}", outputs[a], outputs[b]);
                    let value = self.value(&name, 0.0, (-1.0, 1.0))?;
                    (correlation[a * n + b], correlation[b * n + a]) = (value, value);
                }
            }
            return Ok(Noise::Correlated(Covariance::unknown(sigmas).starting_at(&correlation)));
        }
        if self.noise.densities.is_empty() {
            return Ok(Noise::Gaussian(sigmas));
        }
        let channel = |(name, sigma): (&&str, Sigma)| {
            let mut density = self.noise.density_of(name);
            match &mut density {
                Density::StudentT(Dof::Unknown { start, lower, upper }) => {
                    *start = self.value(&format!("dof_{name}"), *start, (*lower, *upper))?;
                }
                Density::Custom(custom) => {
                    for p in &mut custom.parameters {
                        let bounds = (p.lower.unwrap_or(f64::NEG_INFINITY), p.upper.unwrap_or(f64::INFINITY));
                        p.start = self.value(&format!("{}_{name}", p.name), p.start, bounds)?;
                    }
                }
                _ => {}
            }
            Ok(Channel { sigma, density })
        };
        outputs.iter().zip(sigmas).map(channel).collect::<Result<_, Error>>().map(Noise::Independent)
    }

    /// What is said of single outputs has no place where a covariance says all.
    fn check_joint(&self, outputs: &[&str]) -> Result<(), Error> {
        let fail = |text: String| Err(Error::Option(format!("noise: {text}")));
        let said = |name: &&&str| self.noise.density_of(name) != Density::Gaussian;
        match (&self.noise.joint, outputs.iter().find(said)) {
            (Joint::Independent, _) => Ok(()),
            (_, Some(output)) => {
                fail(format!("correlated noise is Gaussian: leave out the density of '{output}'"))
            }
            (Joint::Known(_), None) => {
                let scale = self.noise.scales.first().map(|s| format!("{SIGMA}{}", s.0));
                let given = self.start.iter().find(|s| outputs.iter().any(|o| s.0 == format!("{SIGMA}{o}")));
                match scale.or_else(|| given.map(|s| s.0.clone())) {
                    Some(name) => {
                        fail(format!("the covariance is known, and {name} with it: leave that out"))
                    }
                    None => Ok(()),
                }
            }
            (Joint::Unknown, None) => Ok(()),
        }
    }

    /// Scales with starts and bounds.
    fn resolve_sigmas(&self, outputs: &[&str]) -> Result<Vec<Sigma>, Error> {
        let one = |(c, name): (usize, &&str)| {
            let said = self.noise.scale_of(name);
            let sigma = format!("{SIGMA}{name}");
            if let Some(Scale::Known(value)) = said {
                return match self.given(&sigma) {
                    Some(_) => Err(Error::Option(format!(
                        "{sigma} is known ({value}) and cannot be given a start as well"
                    ))),
                    None => Ok(Sigma::Known(*value)),
                };
            }
            let samples: Vec<&[f64]> = self.experiments.iter().map(|e| &e.outputs[c][..]).collect();
            if !samples.is_empty() && !samples.iter().any(|z| moves(z)) {
                return Err(Error::Data(format!(
                    "output '{name}' is the same in all samples, so its standard deviation cannot be estimated; \
                     take it out of the model, or give its standard deviation as known"
                )));
            }
            let spread = spread(&samples);
            let (mut start, mut lower, mut upper) = (spread, RANGE.0 * spread, RANGE.1 * spread);
            let (s, bounds) = match said {
                Some(Scale::Unknown { start, bounds }) => (*start, *bounds),
                _ => (None, None),
            };
            match (bounds, self.given(&sigma)) {
                (Some(said), _) => (lower, upper) = said,
                (None, Some(Start::Value(v))) => (lower, upper) = (lower.min(*v), upper.max(*v)),
                (None, _) => {
                    (lower, upper) = (s.map_or(lower, |v| lower.min(v)), s.map_or(upper, |v| upper.max(v)))
                }
            }
            start = s.unwrap_or_else(|| start.min(upper).max(lower));
            start = self.value(&sigma, start, (lower, upper))?;
            // No useful fit is worse than a constant. Beside others of its kind, an output with a start far
            // above its spread would have no say in the first steps, and these can lead far away.
            Ok(Sigma::Unknown { start: start.min(spread.max(lower)), lower, upper })
        };
        outputs.iter().enumerate().map(one).collect()
    }

    /// Whether all states are measured or given, so that a regression on them makes sense.
    pub(super) fn states_known(&self) -> bool {
        let parameters = self.parameters().unwrap_or_default();
        let measured = measured_states(self.model, &parameters);
        self.model.states.iter().zip(&measured).all(|(s, m)| m.is_some() || self.given(&s.name).is_some())
    }

    /// Parameters, precision roots of the noise, states at all points.
    pub(super) fn starting_point(&self, problem: &dyn Transcribed) -> Result<Vec<f64>, Error> {
        let declared = self.parameters()?;
        let measured = measured_states(self.model, &declared);
        let mut xi = Vec::with_capacity(problem.n());
        for (i, p) in problem.posed().parameters.iter().enumerate() {
            let value = if i >= problem.posed().n_model_parameters {
                p.start
            } else if problem.posed().estimands.experiment[i].is_some() && !p.fixed {
                let bounds = (p.lower.unwrap_or(f64::NEG_INFINITY), p.upper.unwrap_or(f64::INFINITY));
                self.value(&p.name, declared[problem.posed().estimands.parameter[i]], bounds)?
            } else {
                declared[problem.posed().estimands.parameter[i]]
            };
            xi.push(problem.posed().estimands.transforms[i].inverse(value));
        }
        xi.resize(problem.n(), 0.0);
        for (i, state) in self.model.states.iter().enumerate() {
            for (e, experiment) in self.experiments.iter().enumerate() {
                let (t, mesh) = (&experiment.t, problem.point_times(e));
                let at_points = |t: &[f64], x: &[f64]| interpolate(Interpolation::Linear, t, x, mesh);
                let fitted = self.warm.and_then(|fit| fit.path(e, &state.name));
                let path = match (self.given(&state.name), fitted, &measured[i]) {
                    (Some(Start::Value(v)), ..) if v.is_finite() => vec![*v; mesh.len()],
                    (Some(Start::Paths(paths)), ..)
                        if paths.len() == self.experiments.len()
                            && paths[e].len() == t.len()
                            && paths[e].iter().all(|x| x.is_finite()) =>
                    {
                        at_points(t, &paths[e])
                    }
                    (Some(_), ..) => {
                        return Err(Error::Option(format!(
                            "start: state '{}' takes a finite number, or a path of finite numbers for each of {} \
                             experiments ({} for '{}')",
                            state.name,
                            self.experiments.len(),
                            t.len(),
                            experiment.name
                        )));
                    }
                    (None, Some((t, x)), _) => interpolate(Interpolation::Cubic, t, x, mesh),
                    (None, None, Some(m)) => {
                        let (t, x) = m.samples(experiment);
                        at_points(&t, &x)
                    }
                    (None, None, None) => continue,
                };
                let first = problem.layout().first_point[e];
                path.iter().enumerate().for_each(|(p, x)| xi[problem.layout().state(first + p) + i] = *x);
            }
        }
        Ok(xi)
    }
}

/// Whether the samples that are there differ by more than rounding.
fn moves(z: &[f64]) -> bool {
    let present = || z.iter().copied().filter(|v| !v.is_nan());
    let (low, high) = present().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (v.min(l), v.max(h)));
    high - low > 4.0 * f64::EPSILON * low.abs().max(high.abs())
}

/// Standard deviation of the measurements of an output over all experiments: the scale of its noise.
fn spread(samples: &[&[f64]]) -> f64 {
    let present = || samples.iter().copied().flatten().filter(|v| !v.is_nan());
    let n = present().count() as f64;
    let mean = present().sum::<f64>() / n;
    let spread = (present().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    if spread > 0.0 { spread } else { 1.0 }
}
