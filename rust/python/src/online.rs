//! Estimation while data arrive.

use std::time::Duration;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use phugoid::Interpolation;
use phugoid::internals::integrate::Integrator;
use phugoid::online::{Alarm, Arrival, Cause, Detect, Estimate, Forgetting, Online, OnlineError, Settings};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::{named, raise};
use crate::model::{DelaySpec, PyModel};

/// An estimator. `phugoid.Online` wraps it.
#[pyclass(name = "Online", module = "phugoid._core", unsendable)]
pub struct PyOnline(Online);

/// Since, noticed, kind, name, value before, change, its error, share.
type AlarmParts = (f64, f64, &'static str, Option<String>, f64, f64, f64, f64);

fn alarm(alarm: &Alarm) -> AlarmParts {
    let (kind, name, numbers) = match &alarm.cause {
        Cause::Parameter { name, before, change, error, .. } => {
            ("parameter", Some(name.to_string()), [*before, *change, *error])
        }
        Cause::Output { name, .. } => ("output", Some(name.to_string()), [f64::NAN; 3]),
        _ => ("several", None, [f64::NAN; 3]),
    };
    let [before, change, error] = numbers;
    (alarm.since, alarm.noticed, kind, name, before, change, error, alarm.share)
}

fn arrival(arrival: Arrival) -> &'static str {
    match arrival {
        Arrival::Late => "late",
        Arrival::TooLate => "too late",
        _ => "latest",
    }
}

fn refuse(error: OnlineError) -> PyErr {
    let class = match error {
        OnlineError::Diverged { .. } | OnlineError::Singular { .. } => "EvaluationError",
        _ => "DataError",
    };
    named(class, format!("Online: {error}"))
}

/// Numbers of an estimate that `run` keeps of each sample, by name.
const KEPT: [&str; 8] = [
    "states",
    "state_errors",
    "parameters",
    "parameter_errors",
    "sigma",
    "innovations",
    "innovation_errors",
    "normalised",
];

fn kept(e: &Estimate) -> [&[f64]; 8] {
    [
        &e.states,
        &e.state_errors,
        &e.parameters,
        &e.parameter_errors,
        &e.sigma,
        &e.innovations,
        &e.innovation_errors,
        &e.normalised,
    ]
}

#[pymethods]
impl PyOnline {
    /// `forgetting` is a kind and a time constant, `detect` what `Detect` has, in its order.
    #[new]
    #[allow(clippy::too_many_arguments, clippy::type_complexity)] // as Python gives them
    fn new(
        model: &PyModel,
        delays: DelaySpec,
        counts: (usize, usize, usize, usize),
        numbers: (f64, f64, f64),
        sigmas: Vec<(String, f64)>,
        estimate_noise: bool,
        parameters: Vec<(String, f64)>,
        initial: Vec<(String, f64, f64)>,
        process_noise: Vec<(String, f64)>,
        forgetting: Option<(String, f64)>,
        methods: (String, String),
        deadline: Option<f64>,
        detect: Option<(f64, f64, Vec<String>, usize, usize, f64)>,
    ) -> PyResult<PyOnline> {
        let unknown = |what: &str, name: &str| PyValueError::new_err(format!("unknown {what} '{name}'"));
        let (window, first_window, iterations, substeps) = counts;
        let (tolerance, noise_weight, max_gap) = numbers;
        let forgetting = match forgetting {
            None => Forgetting::None,
            Some((kind, time)) if kind == "exponential" => Forgetting::Exponential(time),
            Some((kind, time)) if kind == "directional" => Forgetting::Directional(time),
            Some((kind, _)) => return Err(unknown("forgetting", &kind)),
        };
        let interpolation = match &*methods.0 {
            "linear" => Interpolation::Linear,
            "hold" => Interpolation::Hold,
            "cubic" => Interpolation::Cubic,
            other => return Err(unknown("interpolation", other)),
        };
        let integrator =
            Integrator::from_name(&methods.1).ok_or_else(|| unknown("integrator", &methods.1))?;
        let mut settings = Settings::default()
            .window(window)
            .first_window(first_window)
            .iterations(iterations)
            .substeps(substeps)
            .tolerance(tolerance)
            .noise_weight(noise_weight)
            .max_gap(max_gap)
            .estimate_noise(estimate_noise)
            .forgetting(forgetting)
            .interpolation(interpolation)
            .integrator(integrator)
            .deadline(deadline.and_then(|s| Duration::try_from_secs_f64(s).ok()));
        settings.sigmas = sigmas;
        settings.parameters = parameters;
        settings.initial = initial;
        settings.process_noise = process_noise;
        settings.detect = detect.map(|(mean_samples, after, watch, onsets, spacing, change)| {
            let detect =
                Detect::new(mean_samples).after(after).onsets(onsets).spacing(spacing).change(change);
            watch.iter().fold(detect, |detect, name| detect.watch(name))
        });
        Ok(PyOnline(Online::new(&model.late(delays), settings).map_err(raise)?))
    }

    /// Takes a sample.
    fn push(
        &mut self,
        t: f64,
        inputs: PyReadonlyArray1<'_, f64>,
        outputs: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<()> {
        self.0.push(t, inputs.as_slice()?, outputs.as_slice()?).map_err(refuse)?;
        Ok(())
    }

    /// Takes the samples of rows of inputs (N, n_u) and outputs (N, n_y): what an estimate has after each of them, by name, and the
    /// last alarm.
    fn run<'py>(
        &mut self,
        py: Python<'py>,
        t: PyReadonlyArray1<'py, f64>,
        inputs: PyReadonlyArray2<'py, f64>,
        outputs: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (t, u, y) = (t.as_slice()?, inputs.as_slice()?, outputs.as_slice()?);
        let widths = kept(self.0.estimate()).map(<[f64]>::len);
        let count = t.len();
        let rows = |all: &[f64], k: usize| -> Vec<f64> {
            let width = all.len() / count.max(1);
            all[k * width..(k + 1) * width].to_vec()
        };
        let mut columns: [Vec<f64>; 8] = widths.map(|w| Vec::with_capacity(w * count));
        let (mut iterations, mut alarmed) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let online = &mut self.0;
        for (k, &now) in t.iter().enumerate() {
            if k % 1000 == 0 {
                py.check_signals()?;
            }
            let estimate = online.push(now, &rows(u, k), &rows(y, k)).map_err(refuse)?;
            columns.iter_mut().zip(kept(estimate)).for_each(|(all, own)| all.extend(own));
            iterations.push(estimate.iterations as f64);
            alarmed.push(estimate.alarm.as_ref().map_or(f64::NAN, |a| a.since));
        }
        let out = PyDict::new(py);
        for ((name, values), width) in KEPT.iter().zip(columns).zip(widths) {
            out.set_item(name, PyArray1::from_vec(py, values).reshape([count, width])?)?;
        }
        out.set_item("iterations", PyArray1::from_vec(py, iterations))?;
        out.set_item("alarm_since", PyArray1::from_vec(py, alarmed))?;
        Ok(out)
    }

    /// The estimate: arrays by name, and what else it says.
    fn estimate<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let e = self.0.estimate();
        let out = PyDict::new(py);
        for (name, values) in KEPT.iter().zip(kept(e)) {
            out.set_item(name, PyArray1::from_slice(py, values))?;
        }
        let m = e.covariance.len().isqrt();
        let covariance: Bound<'py, PyArray2<f64>> =
            PyArray1::from_slice(py, &e.covariance).reshape([m, m])?;
        out.set_item("covariance", covariance)?;
        out.set_item("t", e.t)?;
        out.set_item("arrival", arrival(e.arrival))?;
        out.set_item("at_bound", e.at_bound.clone())?;
        out.set_item("iterations", e.iterations)?;
        out.set_item("converged", e.converged)?;
        out.set_item("in_time", e.in_time)?;
        out.set_item("alarm", e.alarm.as_ref().map(alarm))?;
        Ok(out)
    }

    /// Ends the record.
    fn restart(&mut self) {
        self.0.restart();
    }

    /// Forgets the alarm.
    fn acknowledge(&mut self) {
        self.0.acknowledge();
    }

    /// Operations of a push, at most.
    fn work(&self) -> u64 {
        self.0.work()
    }
}
