//! What an estimation gives back.

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use phugoid::estimate::{
    Bound as Limit, CollocatedPath, Estimate, Fit, KinkWidth, LeftInError, RefinementStep, SmoothingStep,
    Transcription,
};
use phugoid::model::{Delays, Model};
use phugoid::noise::NoiseModel;
use phugoid::{Experiment, Grid, Signal};
use pyo3::prelude::*;

use crate::errors::raise;
use crate::interrupt::interruptible;
use crate::model::PyModel;
use crate::newton::PySolution;

/// An estimate: name, value, standard error, unit, bounds, and "lower", "upper" or "fixed" for what keeps it.
pub type Estimated = (String, f64, f64, String, (f64, f64), Option<&'static str>);

type Array<'py> = Bound<'py, PyArray1<f64>>;

/// A record that was moved: times, inputs, outputs, how each input behaves between samples, and its signal: times,
/// samples, delay, order of the derivative.
type MovedRecord<'py> = (
    Array<'py>,
    Vec<Array<'py>>,
    Vec<Array<'py>>,
    Vec<&'static str>,
    Vec<(Array<'py>, Array<'py>, f64, usize)>,
);

/// Estimates with standard errors, time histories and warnings at the end of an estimation.
#[pyclass(name = "Fit", module = "phugoid._core", frozen)]
pub struct PyFit(pub Fit);

pub fn estimated(e: &Estimate) -> Estimated {
    let kept = e.bound.map(|b| match b {
        Limit::Lower => "lower",
        Limit::Upper => "upper",
        Limit::Fixed => "fixed",
    });
    (e.name.clone(), e.value, e.std_error, e.unit.clone(), e.bounds, kept)
}

fn arrays<'py>(py: Python<'py>, channels: &[Vec<f64>]) -> Vec<Array<'py>> {
    channels.iter().map(|c| PyArray1::from_slice(py, c)).collect()
}

#[pymethods]
impl PyFit {
    /// Parameters of the model, then those of the noise.
    #[getter]
    fn parameters(&self) -> Vec<Estimated> {
        self.0.parameters.iter().map(estimated).collect()
    }

    /// For each experiment, the states at the first sample.
    #[getter]
    fn initial(&self) -> Vec<Vec<Estimated>> {
        self.0.records.iter().map(|r| r.initial.iter().map(estimated).collect()).collect()
    }

    /// Covariance of the parameters in their order, (n, n).
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let n = self.0.parameters.len();
        PyArray1::from_slice(py, &self.0.covariance).reshape([n, n])
    }

    #[getter]
    fn log_likelihood(&self) -> f64 {
        self.0.log_likelihood
    }

    /// That of the integrated model, where it was asked for; NaN where it cannot be integrated.
    #[getter]
    fn integrated(&self) -> Option<f64> {
        self.0.integrated
    }

    #[getter]
    fn feasible(&self) -> bool {
        self.0.feasible
    }

    #[getter]
    fn status(&self) -> String {
        self.0.status.to_string()
    }

    #[getter]
    fn message(&self) -> &str {
        &self.0.message
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.0.warnings.clone()
    }

    /// Whether residuals are not those of noise that is known, which the first warning says.
    #[getter]
    fn unlike_noise(&self) -> bool {
        self.0.unlike_noise
    }

    /// Number of parameters of the model and initial states that were estimated.
    #[getter]
    fn unknowns(&self) -> usize {
        self.0.unknowns
    }

    /// Number of iterations, of all passes.
    #[getter]
    fn iterations(&self) -> usize {
        self.0.iterations
    }

    /// Where the solver ended.
    #[getter]
    fn solution(&self) -> PySolution {
        PySolution(self.0.solution.clone())
    }

    /// Of an experiment: states, outputs and residuals at its samples, times of the mesh and states there.
    #[allow(clippy::type_complexity)] // a tuple for Python
    fn record<'py>(
        &self,
        py: Python<'py>,
        index: usize,
    ) -> (Vec<Array<'py>>, Vec<Array<'py>>, Vec<Array<'py>>, Array<'py>, Vec<Array<'py>>) {
        let r = &self.0.records[index];
        let mesh = PyArray1::from_slice(py, &r.mesh_t);
        (
            arrays(py, &r.states),
            arrays(py, &r.outputs),
            arrays(py, &r.residuals),
            mesh,
            arrays(py, &r.mesh_states),
        )
    }

    /// The model that was fitted, without delays and noise.
    #[getter]
    fn model(&self) -> PyModel {
        PyModel(Model { noise: NoiseModel::new(), delays: Delays::default(), ..self.0.model.clone() })
    }

    /// Points of a segment, of collocation.
    #[getter]
    fn order(&self) -> Option<usize> {
        let Transcription::Collocation(settings) = &self.0.transcription else { return None };
        Some(settings.order)
    }

    /// Mesh refinement: tolerance; order, segments, largest error, segments too coarse, iterations and log-likelihood of each
    /// pass; estimates of the first.
    #[getter]
    #[allow(clippy::type_complexity)] // a tuple for Python
    fn refinement(&self) -> Option<(f64, Vec<(usize, usize, f64, usize, usize, f64)>, Vec<(String, f64)>)> {
        let refinement = self.0.refinement.as_ref()?;
        let step =
            |s: &RefinementStep| (s.order, s.segments, s.largest, s.coarse, s.iterations, s.log_likelihood);
        let first = refinement.first.iter().map(|e| (e.name.clone(), e.value)).collect();
        Some((refinement.tolerance, refinement.steps.iter().map(step).collect(), first))
    }

    /// Smoothing of kinks: kink, width and unit; width as a part, segments, iterations and log-likelihood of each pass;
    /// parameter, change with widths of zero and standard error.
    #[getter]
    #[allow(clippy::type_complexity)] // a tuple for Python
    fn smoothing(
        &self,
    ) -> Option<(Vec<(String, f64, String)>, Vec<(f64, usize, usize, f64)>, Vec<(String, f64, f64)>)> {
        let s = self.0.smoothing.as_ref()?;
        let step = |s: &SmoothingStep| (s.part, s.segments, s.iterations, s.log_likelihood);
        let width = |w: &KinkWidth| (w.kink.clone(), w.width, w.unit.clone());
        let left = |l: &LeftInError| (l.name.clone(), l.change, l.std_error);
        let widths = s.widths.iter().map(width).collect();
        Some((widths, s.steps.iter().map(step).collect(), s.left.iter().map(left).collect()))
    }

    /// Ends of the segments in each experiment, where they were given so.
    #[getter]
    fn edges(&self) -> Option<Vec<Vec<f64>>> {
        let Transcription::Collocation(settings) = &self.0.transcription else { return None };
        let edges = |grid: &Grid| if let Grid::Edges(edges) = grid { Some(edges.clone()) } else { None };
        settings.grid.iter().map(edges).collect()
    }

    /// Where delays are estimated or kinks were smoothed: the fit at fixed delays or of the smooth model, and its records.
    #[getter]
    fn moved<'py>(&self, py: Python<'py>) -> Option<(PyFit, Vec<MovedRecord<'py>>)> {
        let moved = self.0.moved.as_ref()?;
        let signal = |(i, s): (usize, &Option<Signal>), e: &Experiment| {
            let (t, values, delay, order) = match s {
                Some(s) => (&s.t, &s.values, s.delay, s.derivative),
                None => (&e.t, &e.inputs[i], 0.0, 0),
            };
            (PyArray1::from_slice(py, t), PyArray1::from_slice(py, values), delay, order)
        };
        let record = |e: &Experiment| {
            let signals = e.signals.iter().enumerate().map(|s| signal(s, e)).collect();
            let kinds = (0..e.inputs.len()).map(|i| e.kind(i).name()).collect();
            (PyArray1::from_slice(py, &e.t), arrays(py, &e.inputs), arrays(py, &e.outputs), kinds, signals)
        };
        let records = moved.experiments.iter().map(record).collect();
        Some((PyFit(moved.fit.clone()), records))
    }
}

/// The error that each segment of a mesh adds to a path of the states: ends of the segments, errors of each state, and what is
/// small for it. `sigmas` are the standard deviations of the outputs' noise.
#[pyfunction]
#[allow(clippy::type_complexity, clippy::too_many_arguments, clippy::needless_pass_by_value)] // as Python gives them
pub fn integration_error<'py>(
    py: Python<'py>,
    model: &PyModel,
    record: crate::problem::Record<'py>,
    parameters: Vec<f64>,
    sigmas: Vec<Option<f64>>,
    order: usize,
    t: Vec<f64>,
    states: Vec<Vec<f64>>,
) -> PyResult<(Array<'py>, Vec<Array<'py>>, Vec<f64>)> {
    let experiment = crate::problem::experiment(record)?;
    let path = CollocatedPath {
        model: &model.0,
        experiment: &experiment,
        parameters: &parameters,
        sigmas: &sigmas,
        order,
        t: &t,
        states: &states,
    };
    let found = interruptible(py, None, || path.integration_error())?.map_err(raise)?;
    Ok((PyArray1::from_vec(py, found.edges), arrays(py, &found.errors), found.scales))
}
