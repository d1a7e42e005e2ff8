//! Transcribed problems: what all have in common.

use std::sync::{Arc, Mutex};

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1};
use phugoid::Grid;
use phugoid::Interpolation;
use phugoid::collocation::Collocation;
use phugoid::internals::diagnosis::Linearisation;
use phugoid::internals::problem::{Posed, Transcribed};
use phugoid::nlp::check::check_derivatives;
use phugoid::nlp::{ConstraintId, ExperimentId, NotFinite, Structure, VariableId};
use phugoid::shooting::Shooting;
use phugoid::{Experiment, Parameter, Signal};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::named;

/// An input sampled at times of its own: times, samples, delay, derivative.
type SignalSpec<'py> = (PyReadonlyArray1<'py, f64>, PyReadonlyArray1<'py, f64>, f64, usize);

/// A record as Python hands it over: name, times, inputs, outputs, how each input behaves between samples, signals in
/// place of inputs.
pub type Record<'py> = (
    String,
    PyReadonlyArray1<'py, f64>,
    Vec<PyReadonlyArray1<'py, f64>>,
    Vec<PyReadonlyArray1<'py, f64>>,
    Vec<String>,
    Vec<Option<SignalSpec<'py>>>,
);

/// Segments: ("samples", n, None), ("uniform", n, None) or ("edges", 0, times).
pub type GridSpec = (String, usize, Option<Vec<f64>>);

/// A value of the noise: name, output, value, gradient, bounded by, bounds.
type Reported = (String, Option<usize>, f64, Vec<f64>, Option<usize>, f64, f64);

/// A problem on its own threads, without the interpreter lock. Each transcription is a class of its own below.
#[pyclass(name = "Problem", module = "phugoid._core", frozen, subclass)]
pub struct PyProblem(pub Transcription);

/// The last linearisation of a problem: what is asked of it comes in many calls.
pub type Kept = Mutex<Option<Linearisation<Arc<Collocation>>>>;

/// The transcriptions that there are.
pub enum Transcription {
    Collocation(Arc<Collocation>, Kept),
    Shooting(Arc<Shooting>),
}

type Array<'py> = Bound<'py, PyArray1<f64>>;
type Indices<'py> = (Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<u32>>);

fn vector(v: &PyReadonlyArray1<'_, f64>) -> Vec<f64> {
    v.as_array().to_vec()
}

fn arrays<'py>(py: Python<'py>, channels: Vec<Vec<f64>>) -> Vec<Array<'py>> {
    channels.into_iter().map(|c| PyArray1::from_vec(py, c)).collect()
}

fn indices<'py>(py: Python<'py>, s: &Structure) -> Indices<'py> {
    (PyArray1::from_slice(py, &s.rows), PyArray1::from_slice(py, &s.columns))
}

/// Divisions into segments.
pub fn grids(specs: Vec<GridSpec>) -> PyResult<Vec<Grid>> {
    specs.into_iter().map(grid).collect()
}

fn grid((kind, n, edges): GridSpec) -> PyResult<Grid> {
    match (kind.as_str(), edges) {
        ("samples", _) => Ok(Grid::Samples(n)),
        ("uniform", _) => Ok(Grid::Uniform(n)),
        ("edges", Some(edges)) => Ok(Grid::Edges(edges)),
        _ => Err(PyValueError::new_err(format!("unknown grid '{kind}'"))),
    }
}

fn signal((t, values, delay, derivative): &SignalSpec<'_>) -> Signal {
    let (t, values) = (vector(t), vector(values));
    Signal { t, values, delay: *delay, derivative: *derivative, interpolation: None }
}

/// How an input behaves between its samples.
pub fn interpolation(kind: &str) -> PyResult<Interpolation> {
    match kind {
        "linear" => Ok(Interpolation::Linear),
        "cubic" => Ok(Interpolation::Cubic),
        "hold" => Ok(Interpolation::Hold),
        _ => Err(PyValueError::new_err(format!("unknown interpolation '{kind}'"))),
    }
}

/// A record of the core.
pub fn experiment((name, t, inputs, outputs, kinds, signals): Record<'_>) -> PyResult<Experiment> {
    let kinds: Vec<Interpolation> = kinds.iter().map(|k| interpolation(k)).collect::<PyResult<_>>()?;
    let (t, inputs): (Vec<f64>, Vec<Vec<f64>>) = (vector(&t), inputs.iter().map(vector).collect());
    let common = kinds.first().copied().unwrap_or(Interpolation::Linear);
    let mut own: Vec<Option<Signal>> = signals.iter().map(|s| s.as_ref().map(signal)).collect();
    for ((own, kind), values) in own.iter_mut().zip(&kinds).zip(&inputs).filter(|((_, k), _)| **k != common) {
        let (t, values) = (t.clone(), values.clone());
        let as_sampled = || Signal { t, values, delay: 0.0, derivative: 0, interpolation: None };
        own.get_or_insert_with(as_sampled).interpolation = Some(*kind);
    }
    let outputs = outputs.iter().map(vector).collect();
    Ok(Experiment { name, t, inputs, outputs, interpolation: common, signals: own })
}

/// Numbers of the intervals between sample times that are gaps: longer than ten times those beside them.
#[pyfunction]
pub fn gaps(t: Vec<f64>) -> Vec<usize> {
    phugoid::internals::gaps::gaps(&t)
}

/// Warnings about gaps of records over which inputs of these names move, one for each record.
#[pyfunction]
pub fn gap_warnings(inputs: Vec<String>, experiments: Vec<Record<'_>>) -> PyResult<Vec<String>> {
    let records: Vec<Experiment> = experiments.into_iter().map(experiment).collect::<PyResult<_>>()?;
    let names: Vec<&str> = inputs.iter().map(String::as_str).collect();
    Ok(phugoid::internals::gaps::gap_warnings(&names, &records))
}

impl PyProblem {
    /// The problem itself.
    pub fn inner(&self) -> &dyn Transcribed {
        match &self.0 {
            Transcription::Collocation(problem, _) => &**problem,
            Transcription::Shooting(problem) => &**problem,
        }
    }

    /// The problem, if it is one by collocation, and its linearisation.
    pub fn collocation(&self) -> Option<(&Arc<Collocation>, &Kept)> {
        match &self.0 {
            Transcription::Collocation(problem, kept) => Some((problem, kept)),
            Transcription::Shooting(_) => None,
        }
    }

    fn posed(&self) -> &Posed {
        self.inner().posed()
    }

    fn of_noise(&self) -> impl Iterator<Item = &Parameter> {
        self.posed().parameters.iter().skip(self.posed().n_model_parameters)
    }

    fn slice<'a>(&self, x: &'a PyReadonlyArray1<'_, f64>, n: usize, what: &str) -> PyResult<&'a [f64]> {
        let x = x.as_slice().map_err(|_| PyValueError::new_err(format!("{what} must be contiguous")))?;
        if x.len() != n {
            return Err(PyValueError::new_err(format!("{what} has {} entries, the problem {n}", x.len())));
        }
        Ok(x)
    }

    /// Fills a new array outside the interpreter lock; `None` where something is not finite.
    fn fill<'py>(
        &self,
        py: Python<'py>,
        len: usize,
        f: impl FnOnce(&dyn Transcribed, &mut [f64]) -> Result<(), NotFinite> + Send,
    ) -> Option<Array<'py>> {
        // SAFETY: every callback writes all entries of its output.
        let array = unsafe { PyArray1::<f64>::new(py, len, false) };
        // SAFETY: the array was made here and is seen by nobody else yet.
        let out = unsafe { array.as_slice_mut().expect("a new array is contiguous") };
        py.detach(|| f(self.inner(), out)).ok().map(|()| array)
    }
}

#[pymethods]
impl PyProblem {
    /// Number of variables.
    #[getter]
    fn n(&self) -> usize {
        self.inner().n()
    }

    /// Number of constraints.
    #[getter]
    fn m(&self) -> usize {
        self.inner().m()
    }

    /// Number of parameters, those of the noise among them.
    #[getter]
    fn n_theta(&self) -> usize {
        self.inner().layout().n_theta
    }

    /// Number of states.
    #[getter]
    fn n_states(&self) -> usize {
        self.inner().layout().n_x
    }

    /// For each boundary condition, which follow all other constraints, the state in whose unit it is.
    #[getter]
    fn boundary_states(&self) -> Vec<usize> {
        self.inner().boundary_states().into_iter().map(|s| s.0).collect()
    }

    /// First point of each experiment, and the total.
    #[getter]
    fn first_point(&self) -> Vec<usize> {
        self.inner().layout().first_point.iter().map(|p| p.0).collect()
    }

    /// For each variable that is a parameter of the model: its name, the parameter's place in the model, and the
    /// experiment that it belongs to, if it is of one.
    #[getter]
    fn estimands(&self) -> Vec<(String, usize, Option<usize>)> {
        let all = &self.posed().estimands;
        let of_model = self.posed().parameters.numbered().take(self.posed().n_model_parameters);
        let one =
            |(i, p): (_, &Parameter)| (p.name.clone(), all.parameter[i].0, all.experiment[i].map(|e| e.0));
        of_model.map(one).collect()
    }

    /// The variables of parameters with these values, in the order of `estimands`.
    fn variables(&self, values: Vec<f64>) -> Vec<f64> {
        values.iter().zip(&self.posed().estimands.transforms).map(|(v, t)| t.inverse(*v)).collect()
    }

    /// Values of the parameters, and their derivatives with respect to the variables.
    fn values(&self, variables: Vec<f64>) -> Vec<(f64, f64)> {
        variables
            .iter()
            .zip(&self.posed().estimands.transforms)
            .map(|(v, t)| (t.value(*v), t.slope(*v)))
            .collect()
    }

    /// Names of the noise parameters.
    #[getter]
    fn noise_parameters(&self) -> Vec<String> {
        self.of_noise().map(|p| p.name.clone()).collect()
    }

    /// Where the noise parameters start.
    #[getter]
    fn noise_start(&self) -> Vec<f64> {
        self.of_noise().map(|p| p.start).collect()
    }

    /// Variables that are 1/sigma of an output, given others where noise is correlated.
    #[getter]
    fn precision_roots(&self) -> Vec<usize> {
        self.posed().precision_roots().into_iter().map(|i| i.0).collect()
    }

    /// Scales of all outputs.
    fn sigmas(&self, xi: PyReadonlyArray1<'_, f64>) -> PyResult<Vec<f64>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        Ok(self.posed().sigmas(xi))
    }

    /// The noise in the user's terms: name, number of the output whose unit it has, value, gradient with respect
    /// to the noise parameters, number of the one whose bounds are its own, lower and upper bound.
    fn noise_report(&self, xi: PyReadonlyArray1<'_, f64>) -> PyResult<Vec<Reported>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        let one = |r: phugoid::noise::Reported| {
            (r.name, r.output, r.value, r.gradient, r.bounded_by, r.bounds.0, r.bounds.1)
        };
        Ok(self.posed().noise_report(xi).into_iter().map(one).collect())
    }

    /// Inputs at the points of an experiment, `[input][point]`; none unless by collocation.
    fn point_inputs<'py>(&self, py: Python<'py>, experiment: usize) -> Vec<Array<'py>> {
        let inputs = self.collocation().map(|(c, _)| c.inputs[ExperimentId(experiment)].clone());
        arrays(py, inputs.unwrap_or_default())
    }

    /// Place among the points of an experiment of each of its samples; none unless by collocation.
    fn sample_points(&self, experiment: usize) -> Vec<usize> {
        self.collocation()
            .map(|(c, _)| c.meshes[ExperimentId(experiment)].sample_points.clone())
            .unwrap_or_default()
    }

    /// Times of the points of an experiment whose states are variables.
    fn point_times<'py>(&self, py: Python<'py>, experiment: usize) -> Array<'py> {
        PyArray1::from_slice(py, self.inner().point_times(ExperimentId(experiment)))
    }

    /// Times of the mesh on which the equations of an experiment are solved, and the states there, one array a state.
    fn path<'py>(
        &self,
        py: Python<'py>,
        xi: PyReadonlyArray1<'py, f64>,
        experiment: usize,
    ) -> PyResult<(Array<'py>, Vec<Array<'py>>)> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        let (times, states) = py.detach(|| self.inner().path(xi, ExperimentId(experiment)));
        Ok((PyArray1::from_vec(py, times), arrays(py, states)))
    }

    /// States at the samples of an experiment, one array a state.
    fn states<'py>(
        &self,
        py: Python<'py>,
        xi: PyReadonlyArray1<'py, f64>,
        experiment: usize,
    ) -> PyResult<Vec<Array<'py>>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        Ok(arrays(py, py.detach(|| self.inner().states_at_samples(xi, ExperimentId(experiment)))))
    }

    fn bounds<'py>(&self, py: Python<'py>) -> (Array<'py>, Array<'py>) {
        let (lower, upper) = self.inner().bounds();
        (PyArray1::from_vec(py, lower), PyArray1::from_vec(py, upper))
    }

    /// φ = −ℓ; NaN where something is not finite.
    fn objective(&self, py: Python<'_>, xi: PyReadonlyArray1<'_, f64>) -> PyResult<f64> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        Ok(py.detach(|| self.inner().objective(xi)).unwrap_or(f64::NAN))
    }

    fn gradient<'py>(&self, py: Python<'py>, xi: PyReadonlyArray1<'py, f64>) -> PyResult<Option<Array<'py>>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        Ok(self.fill(py, self.inner().n(), |p, out| p.gradient(xi, out)))
    }

    fn constraints<'py>(
        &self,
        py: Python<'py>,
        xi: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Option<Array<'py>>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        Ok(self.fill(py, self.inner().m(), |p, out| p.constraints(xi, out)))
    }

    fn jacobian_structure<'py>(&self, py: Python<'py>) -> Indices<'py> {
        indices(py, self.inner().jacobian_structure())
    }

    fn jacobian<'py>(&self, py: Python<'py>, xi: PyReadonlyArray1<'py, f64>) -> PyResult<Option<Array<'py>>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        Ok(self.fill(py, self.inner().jacobian_structure().len(), |p, out| p.jacobian(xi, out)))
    }

    fn hessian_structure<'py>(&self, py: Python<'py>) -> Indices<'py> {
        indices(py, self.inner().hessian_structure())
    }

    fn hessian<'py>(
        &self,
        py: Python<'py>,
        xi: PyReadonlyArray1<'py, f64>,
        factor: f64,
        multipliers: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Option<Array<'py>>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        let lambda = self.slice(&multipliers, self.inner().m(), "the multipliers")?;
        Ok(self.fill(py, self.inner().hessian_structure().len(), |p, out| p.hessian(xi, factor, lambda, out)))
    }

    /// Entries, at the places of the Hessian, of its Gauss-Newton approximation.
    fn gauss_newton<'py>(
        &self,
        py: Python<'py>,
        xi: PyReadonlyArray1<'py, f64>,
        factor: f64,
    ) -> PyResult<Option<Array<'py>>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        Ok(self.fill(py, self.inner().hessian_structure().len(), |p, out| p.gauss_newton(xi, factor, out)))
    }

    /// Model outputs at the samples of an experiment, one array an output.
    fn outputs<'py>(
        &self,
        py: Python<'py>,
        xi: PyReadonlyArray1<'py, f64>,
        experiment: usize,
    ) -> PyResult<Vec<Array<'py>>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        Ok(arrays(py, py.detach(|| self.inner().outputs_at_samples(xi, ExperimentId(experiment)))))
    }

    fn variable_name(&self, i: usize) -> String {
        self.inner().variable_name(VariableId(i))
    }

    fn constraint_name(&self, i: usize) -> String {
        self.inner().constraint_name(ConstraintId(i))
    }

    /// What is not finite at xi, where and from what.
    fn explain(&self, py: Python<'_>, xi: PyReadonlyArray1<'_, f64>) -> PyResult<Option<String>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        Ok(py.detach(|| self.inner().explain(xi)))
    }

    /// Entries of derivatives that differ from difference quotients: (entry, computed, difference).
    fn check_derivatives(
        &self,
        xi: PyReadonlyArray1<'_, f64>,
        multipliers: PyReadonlyArray1<'_, f64>,
        columns: Vec<usize>,
        tolerance: f64,
    ) -> PyResult<Vec<(String, f64, f64)>> {
        let xi = self.slice(&xi, self.inner().n(), "xi")?;
        let lambda = self.slice(&multipliers, self.inner().m(), "the multipliers")?;
        let columns: Vec<VariableId> = columns.into_iter().map(VariableId).collect();
        let wrong = check_derivatives(self.inner(), xi, lambda, &columns, tolerance)
            .map_err(|_| named("EvaluationError", self.inner().explain(xi).unwrap_or_default()))?;
        Ok(wrong.into_iter().map(|w| (w.entry, w.computed, w.difference)).collect())
    }

    /// Instructions on lanes of the tapes of f, ∂f, ∂²f, ℓ, ∂ℓ, ∂²ℓ.
    fn instructions(&self) -> [usize; 6] {
        self.posed().instructions()
    }
}
