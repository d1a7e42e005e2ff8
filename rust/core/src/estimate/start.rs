//! Where an estimation starts: parameters as declared, standard deviations at the spread of the
//! measurements, states as measured.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use super::{Estimation, Joint};
use crate::error::Error;
use crate::experiment::Experiment;
use crate::interpolate::{Interpolation, interpolate};
use crate::model::TIME;
use crate::noise::{Channel, Covariance, Density, Dof, Noise, SIGMA, Sigma};
use crate::transcription::Transcribed;

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

/// An output that measures a state: z = offset + slope · x.
struct Measured {
    output: usize,
    offset: f64,
    slope: f64,
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

    fn parameters(&self) -> Result<Vec<f64>, Error> {
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
        if let Joint::Unknown = self.joint {
            let pairs = (0..outputs.len()).flat_map(|a| (a + 1..outputs.len()).map(move |b| (a, b)));
            return pairs.map(|(a, b)| format!("corr_{}_{}", outputs[a], outputs[b])).collect();
        }
        let own = |name: &&str| match self.density_of(name) {
            Density::StudentT(Dof::Unknown { .. }) => vec![format!("dof_{name}")],
            Density::Custom(custom) => {
                custom.parameters.iter().map(|p| format!("{}_{name}", p.name)).collect()
            }
            _ => Vec::new(),
        };
        outputs.iter().flat_map(own).collect()
    }

    /// The density of an output, its parameters where they start.
    fn density_of(&self, output: &str) -> Density {
        let said = self.densities.iter().rev().find(|d| d.0 == output);
        said.map_or(Density::Gaussian, |d| d.1.clone())
    }

    /// The noise with starts and bounds.
    pub(super) fn resolve_noise(&self, outputs: &[&str]) -> Result<Noise, Error> {
        if let Joint::Known(matrix) = &self.joint {
            return Covariance::known(outputs.len(), matrix).map(Noise::Correlated);
        }
        let sigmas = self.resolve_sigmas(outputs)?;
        if let Joint::Unknown = self.joint {
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
        if self.densities.is_empty() {
            return Ok(Noise::Gaussian(sigmas));
        }
        let channel = |(name, sigma): (&&str, Sigma)| {
            let mut density = self.density_of(name);
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

    /// Scales with starts and bounds.
    fn resolve_sigmas(&self, outputs: &[&str]) -> Result<Vec<Sigma>, Error> {
        let one = |(c, name): (usize, &&str)| {
            let said = self.noise.iter().rev().find(|n| n.0 == **name).map(|n| &n.1);
            let sigma = format!("{SIGMA}{name}");
            if let Some(Sigma::Known(value)) = said {
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
            match (said, self.given(&sigma)) {
                (Some(Sigma::Unknown { start: s, lower: l, upper: u }), _) => {
                    (start, lower, upper) = (*s, *l, *u)
                }
                (_, Some(Start::Value(v))) => (lower, upper) = (lower.min(*v), upper.max(*v)),
                _ => {}
            }
            start = self.value(&sigma, start, (lower, upper))?;
            // No useful fit is worse than a constant. Beside others of its kind, an output with a start far
            // above its spread would have no say in the first steps, and these can lead far away.
            Ok(Sigma::Unknown { start: start.min(spread.max(lower)), lower, upper })
        };
        outputs.iter().enumerate().map(one).collect()
    }

    /// For each state, the output that measures it: one that depends on no other state, input or time, and
    /// on this one linearly, with the parameters at their start.
    fn measured_states(&self, parameters: &[f64]) -> Vec<Option<Measured>> {
        let model = self.model;
        let varying: HashSet<&str> =
            model.states.iter().chain(&model.inputs).map(|v| v.name.as_str()).chain([TIME]).collect();
        let mut numbers: HashMap<Arc<str>, f64> =
            model.parameters.iter().zip(parameters).map(|(p, v)| (p.name.as_str().into(), *v)).collect();
        let mut found: Vec<Option<Measured>> = model.states.iter().map(|_| None).collect();
        for (output, expr) in model.expanded().1.iter().enumerate() {
            let symbols = expr.symbols();
            let mut inside = symbols.iter().filter(|s| varying.contains(&***s));
            let (Some(name), None) = (inside.next(), inside.next()) else { continue };
            let Some(state) = model.states.iter().position(|s| *s.name == **name) else { continue };
            let slope = expr.derivative(name);
            if found[state].is_some() || slope.symbols().iter().any(|s| varying.contains(&**s)) {
                continue;
            }
            numbers.insert(name.clone(), 0.0);
            if let (Ok(offset), Ok(slope)) = (expr.evaluate(&numbers), slope.evaluate(&numbers))
                && offset.is_finite()
                && slope.is_finite()
                && slope != 0.0
            {
                found[state] = Some(Measured { output, offset, slope });
            }
            numbers.remove(name);
        }
        found
    }

    /// Whether all states are measured or given, so that a regression on them makes sense.
    pub(super) fn states_known(&self) -> bool {
        let parameters = self.parameters().unwrap_or_default();
        let measured = self.measured_states(&parameters);
        self.model.states.iter().zip(&measured).all(|(s, m)| m.is_some() || self.given(&s.name).is_some())
    }

    /// Parameters, precision roots of the noise, states at all points.
    pub(super) fn starting_point(&self, problem: &dyn Transcribed) -> Result<Vec<f64>, Error> {
        let declared = self.parameters()?;
        let measured = self.measured_states(&declared);
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
                let fitted =
                    self.warm.and_then(|fit| fit.state(e, &state.name)).filter(|x| x.len() == t.len());
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
                    (None, Some(path), _) => at_points(t, path),
                    (None, None, Some(m)) => {
                        let (t, x) = as_measured(experiment, m);
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

/// A state from the samples of the output that measures it: times and values.
fn as_measured(experiment: &Experiment, m: &Measured) -> (Vec<f64>, Vec<f64>) {
    let samples = experiment.t.iter().zip(&experiment.outputs[m.output]).filter(|s| !s.1.is_nan());
    samples.map(|(t, z)| (*t, (z - m.offset) / m.slope)).unzip()
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
