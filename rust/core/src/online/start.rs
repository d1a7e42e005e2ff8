//! From a model and settings to an estimator: what is checked and compiled once.

use std::sync::Arc;

use super::bounds::Bounds;
use super::detector::Detector;
use super::gauss_newton::{GaussNewton, Parts};
use super::horizon::Horizon;
use super::map::Map;
use super::noise::NoiseLevel;
use super::sensors::Sensors;
use super::settings::{Forgetting, Settings};
use crate::error::{Error, did_you_mean};
use crate::interpolate::Interpolation;
use crate::measured::Measured;
use crate::model::Model;
use crate::noise::{Density, Joint, Scale};
use crate::parameter::Parameter;

/// Standard deviation of the start value of a parameter for which none is given, over the larger of its size and 1.
const DIFFUSE: f64 = 10.0;
/// Standard deviation of an initial state that is measured, over that of its measurement.
const FLAT: f64 = 1e4;
/// Least standard deviation of a state for given parameters, over that of its measurement, or of its initial value: far
/// below what matters to the estimates, and far above rounding errors.
const LEAST: f64 = 1e-5;
/// States and noises of a segment that are made triangular without taking memory.
const MOST_STATES: usize = 64;

/// What is known of an initial state.
#[derive(Clone, Copy, Debug)]
pub(super) struct Initial {
    /// The output that it starts at.
    measured: Option<Measured>,
    /// The output that measures it.
    scale: Option<Measured>,
    /// Value and standard deviation where no output measures it.
    otherwise: (f64, f64),
}

impl Initial {
    /// Value and standard deviation, from the outputs of the first sample.
    pub(super) fn at(&self, outputs: &[f64], sigma: &[f64]) -> (f64, f64) {
        let found = self.measured.map(|m| ((outputs[m.output] - m.offset) / m.slope, m));
        match found.filter(|(x, _)| x.is_finite()) {
            Some((x, m)) => (x, (FLAT * sigma[m.output] / m.slope.abs()).max(x.abs())),
            None => self.otherwise,
        }
    }
}

/// Names of what a sample has.
#[derive(Clone, Debug)]
pub(super) struct Names {
    pub(super) states: Vec<Arc<str>>,
    pub(super) inputs: Vec<Arc<str>>,
    pub(super) outputs: Vec<Arc<str>>,
}

/// The parts of an estimator.
pub(super) struct Prepared {
    pub(super) names: Names,
    pub(super) solver: GaussNewton,
    pub(super) horizon: Horizon,
    pub(super) noise: NoiseLevel,
    pub(super) detector: Option<Detector>,
    pub(super) initial: Vec<Initial>,
    pub(super) held: Vec<bool>,
}

fn fail<T>(text: String, name: &str) -> Result<T, Error> {
    Err(Error::option(format!("Online: {text}")).about(name))
}

/// The place of a name among those of a kind.
fn find(kind: &str, name: &str, known: &[&str]) -> Result<usize, Error> {
    match known.iter().position(|k| *k == name) {
        Some(at) => Ok(at),
        None => fail(
            format!("the model has no {kind} '{name}'.{}", did_you_mean(name, known.iter().copied())),
            name,
        ),
    }
}

fn positive(what: &str, name: &str, value: f64) -> Result<f64, Error> {
    if value > 0.0 && value.is_finite() {
        return Ok(value);
    }
    fail(format!("{what} of '{name}' is {value}; it must be a positive number"), name)
}

/// Checks numbers that belong to no name.
fn check(settings: &Settings) -> Result<(), Error> {
    let counts = [
        ("window", settings.window, 10_000),
        ("iterations", settings.iterations, 1_000),
        ("substeps", settings.substeps, 10_000),
    ];
    for (name, value, most) in counts {
        if value == 0 || value > most {
            return fail(format!("{name} is {value}; it must be from 1 to {most}"), name);
        }
    }
    if settings.first_window > 10_000 {
        return fail(
            format!("first_window is {}; it must be at most 10000", settings.first_window),
            "first_window",
        );
    }
    let mut sizes = vec![("tolerance", settings.tolerance), ("noise_weight", settings.noise_weight)];
    match settings.forgetting {
        Forgetting::None => {}
        Forgetting::Exponential(time) | Forgetting::Directional(time) => sizes.push(("forgetting", time)),
    }
    if let Some(detect) = &settings.detect {
        sizes.extend([("mean_samples", detect.mean_samples), ("change", detect.change)]);
        for (name, value) in [("onsets", detect.onsets), ("spacing", detect.spacing)] {
            if value == 0 || value > 10_000 {
                return fail(format!("detect: {name} is {value}; it must be from 1 to 10000"), name);
            }
        }
        if detect.after.is_nan() || detect.after < 0.0 {
            return fail(format!("detect: after is {}; it must be a time, s", detect.after), "after");
        }
    }
    for (name, value) in sizes {
        if value.is_nan() || value <= 0.0 || value.is_infinite() {
            return fail(format!("{name} is {value}; it must be a positive number"), name);
        }
    }
    if settings.max_gap.is_nan() || settings.max_gap <= 0.0 {
        return fail(format!("max_gap is {}; it must be a positive time, s", settings.max_gap), "max_gap");
    }
    if settings.interpolation == Interpolation::Cubic {
        let text = "inputs cannot be cubic between samples: a cubic spline needs samples that are still to come; use \
                    linear or held ones";
        return fail(text.into(), "interpolation");
    }
    Ok(())
}

/// Standard deviations of the noise by output.
fn sigmas(model: &Model, settings: &Settings) -> Result<Vec<f64>, Error> {
    let names: Vec<&str> = model.outputs.iter().map(|e| e.name.as_str()).collect();
    let mut given = vec![None; names.len()];
    for (name, value) in &settings.sigmas {
        given[find("output", name, &names)?] = Some(positive("sigma", name, *value)?);
    }
    if model.noise.joint != Joint::Independent {
        return fail("the noise of the outputs must be independent".into(), "noise");
    }
    let mut found = Vec::with_capacity(names.len());
    for (name, given) in names.iter().zip(given) {
        if model.noise.density_of(name) != Density::Gaussian {
            return fail(format!("the noise of output '{name}' must be Gaussian"), name);
        }
        let declared = match model.noise.scale_of(name) {
            Some(Scale::Known(value)) => Some(*value),
            Some(Scale::Unknown { start, .. }) => *start,
            _ => None,
        };
        let Some(value) = given.or(declared) else {
            return fail(
                format!("give the standard deviation of the noise of output '{name}' (sigma)"),
                name,
            );
        };
        found.push(positive("sigma", name, value)?);
    }
    Ok(found)
}

/// Means and standard deviations of the parameters, or 0 for a fixed one.
fn priors(model: &Model, settings: &Settings) -> Result<Vec<f64>, Error> {
    let names: Vec<&str> = model.parameters.iter().map(|p| p.name.as_str()).collect();
    let one = |p: &Parameter| match p.prior {
        _ if p.fixed => 0.0,
        Some((_, deviation)) => deviation,
        None => DIFFUSE * p.start.abs().max(1.0),
    };
    let mut found: Vec<f64> = model.parameters.iter().map(one).collect();
    for (name, value) in &settings.parameters {
        let at = find("parameter", name, &names)?;
        if model.parameters[at].fixed {
            return fail(format!("parameter '{name}' is fixed, and has no standard deviation"), name);
        }
        found[at] = positive("the standard deviation", name, *value)?;
    }
    Ok(found)
}

fn initial(model: &Model, settings: &Settings, values: &[f64]) -> Result<Vec<Initial>, Error> {
    let names: Vec<&str> = model.states.iter().map(|s| s.name.as_str()).collect();
    let (measured, declared) = (model.measured_states(values), model.declared_paths(values));
    let start = |(measured, declared): (Option<Measured>, Option<f64>)| {
        let value = declared.unwrap_or(0.0);
        Initial { measured, scale: measured, otherwise: (value, value.abs().max(1.0)) }
    };
    let mut found: Vec<Initial> = measured.into_iter().zip(declared).map(start).collect();
    for (name, value, deviation) in &settings.initial {
        let at = find("state", name, &names)?;
        if !value.is_finite() {
            return fail(format!("the initial value of '{name}' is {value}"), name);
        }
        let deviation = positive("the standard deviation of the initial value", name, *deviation)?;
        found[at] = Initial { measured: None, otherwise: (*value, deviation), ..found[at] };
    }
    Ok(found)
}

/// Checks and compiles.
pub(super) fn prepare(model: &Model, settings: &Settings) -> Result<Prepared, Error> {
    check(settings)?;
    let compiled = model.compile()?;
    if let Some(name) = model.delays.parameters().first() {
        let text = format!(
            "delays are not estimated while data arrive: give the value of '{name}' by Model::at_delays"
        );
        return fail(text, name);
    }
    let (n, n_u, n_y) = (model.states.len(), model.inputs.len(), model.outputs.len());
    let sigma = sigmas(model, settings)?;
    let deviations = priors(model, settings)?;
    let start = |p: &Parameter| p.prior.filter(|_| !p.fixed).map_or(p.start, |prior| prior.0);
    let within = |p: &Parameter| {
        start(p).max(p.lower.unwrap_or(f64::NEG_INFINITY)).min(p.upper.unwrap_or(f64::INFINITY))
    };
    let values: Vec<f64> = model.parameters.iter().map(within).collect();
    let initial = initial(model, settings, &values)?;
    let free: Vec<usize> = (0..values.len()).filter(|i| !model.parameters[*i].fixed).collect();
    let names: Vec<&str> = model.states.iter().map(|s| s.name.as_str()).collect();
    let mut driven: Vec<(usize, f64)> = Vec::new();
    for (name, value) in &settings.process_noise {
        let at = find("state", name, &names)?;
        if driven.iter().any(|d| d.0 == at) {
            return fail(format!("the process noise of '{name}' is given twice"), name);
        }
        driven.push((at, positive("the process noise", name, *value)?));
    }
    if n + driven.len() > MOST_STATES {
        let text = format!(
            "the model has {n} states, {} with process noise; at most {MOST_STATES} together",
            driven.len()
        );
        return fail(text, "states");
    }
    let held = vec![settings.interpolation == Interpolation::Hold; n_u];
    let map = Map::new(&compiled, settings.integrator, settings.substeps, held.clone())?;
    let bound = |own: fn(&Parameter) -> Option<f64>, none: f64| {
        free.iter().map(|i| own(&model.parameters[*i]).unwrap_or(none)).collect::<Vec<f64>>()
    };
    let bounds = Bounds::new(bound(|p| p.lower, f64::NEG_INFINITY), bound(|p| p.upper, f64::INFINITY));
    let theta: Vec<f64> = free.iter().map(|i| values[*i]).collect();
    let mut horizon = Horizon::new(settings.window.max(settings.first_window), n_u, n_y, n, &theta);
    let w = horizon.arrival.width();
    for (k, i) in free.iter().enumerate() {
        horizon.arrival.r[(n + k) * w + n + k] = 1.0 / deviations[*i];
        // A prior whose mean lies beyond a bound keeps it.
        horizon.reference[n + k] = start(&model.parameters[*i]);
    }
    let shared = |names: Vec<&str>| names.into_iter().map(Arc::from).collect::<Vec<Arc<str>>>();
    let outputs = shared(model.outputs.iter().map(|e| e.name.as_str()).collect());
    let detector = match &settings.detect {
        None => None,
        Some(detect) => {
            let names: Vec<&str> = model.parameters.iter().map(|p| p.name.as_str()).collect();
            let mut watched: Vec<(Arc<str>, usize)> = Vec::new();
            for name in &detect.watch {
                let at = find("parameter", name, &names)?;
                let Some(place) = free.iter().position(|i| *i == at) else {
                    return fail(format!("detect: parameter '{name}' is fixed, and not estimated"), name);
                };
                if watched.iter().any(|w| w.1 == place) {
                    return fail(format!("detect: parameter '{name}' is named twice"), name);
                }
                watched.push((name.as_str().into(), place));
            }
            Some(Detector::new(detect, outputs.clone(), watched, n, n + free.len()))
        }
    };
    let least = |i: &Initial| {
        let scale = i.scale.map_or(i.otherwise.1, |m| sigma[m.output] / m.slope.abs());
        1.0 / (LEAST * scale)
    };
    let most = initial.iter().map(least).collect();
    let parts = Parts {
        most,
        map,
        sensors: Sensors::new(&compiled)?,
        free,
        values,
        bounds,
        driven,
        window: settings.window.max(settings.first_window),
        n,
        n_y,
    };
    Ok(Prepared {
        names: Names {
            states: shared(names),
            inputs: shared(model.inputs.iter().map(|v| v.name.as_str()).collect()),
            outputs,
        },
        solver: GaussNewton::new(parts),
        horizon,
        noise: NoiseLevel::new(sigma, settings.estimate_noise, settings.noise_weight),
        detector,
        initial,
        held,
    })
}
