//! The Newton solver.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use phugoid::internals::diagnosis::{NoInformation, information as information_of};
use phugoid::internals::initial::{Initial, solve};
use phugoid::internals::problem::Transcribed;
use phugoid::interrupt::Interrupt;
use phugoid::linalg::{KktChoice, KktError};
use phugoid::nlp::VariableId;
use phugoid::solver::{Control, Iteration, Settings, Solution};
use pyo3::exceptions::{PyTimeoutError, PyValueError};
use pyo3::prelude::*;

use crate::errors::named;
use crate::interrupt::{seconds, watched};
use crate::problem::PyProblem;

/// Where the solver ended.
#[pyclass(name = "NewtonSolution", module = "phugoid._core", frozen)]
pub struct PySolution(pub Solution);

/// A line of the iteration table: number, log-likelihood, defect, promise, step, trials, shift, exact.
pub type Line = (usize, f64, f64, f64, f64, usize, f64, bool);

pub fn line(i: &Iteration) -> Line {
    (i.number, -i.objective, i.defect, i.promise, i.step, i.trials, i.shift, i.exact)
}

#[pymethods]
impl PySolution {
    #[getter]
    fn xi<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.0.xi)
    }

    #[getter]
    fn multipliers<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.0.multipliers)
    }

    /// Those of lower and upper bounds; zeros of a solver that has none.
    #[getter]
    fn bound_multipliers<'py>(&self, py: Python<'py>) -> [Bound<'py, PyArray1<f64>>; 2] {
        let zeros = || vec![0.0; self.0.xi.len()];
        let (low, high) = self.0.bound_multipliers.clone().unwrap_or_else(|| (zeros(), zeros()));
        [PyArray1::from_vec(py, low), PyArray1::from_vec(py, high)]
    }

    /// Units of the states, in which defects are measured.
    #[getter]
    fn units(&self) -> Vec<f64> {
        self.0.units.clone()
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
    fn iterations(&self) -> usize {
        self.0.iterations
    }

    /// Seconds.
    #[getter]
    fn time(&self) -> f64 {
        self.0.time.as_secs_f64()
    }

    /// Counted floating-point operations of one factorisation.
    #[getter]
    fn flops(&self) -> u64 {
        self.0.flops
    }

    #[getter]
    fn history(&self) -> Vec<Line> {
        self.0.history.iter().map(line).collect()
    }

    /// Calls of objective, gradient, constraints, Jacobian, Hessian, Gauss-Newton Hessian, then
    /// factorisations and solutions of the Newton system.
    #[getter]
    fn evaluations(&self) -> [usize; 8] {
        let e = self.0.evaluations;
        [
            e.objective,
            e.gradient,
            e.constraints,
            e.jacobian,
            e.hessian,
            e.gauss_newton,
            e.factorizations,
            e.solutions,
        ]
    }
}

fn check_sizes(nlp: &dyn Transcribed, xi: &[f64], multipliers: Option<&[f64]>) -> PyResult<()> {
    if xi.len() != nlp.n() || multipliers.is_some_and(|m| m.len() != nlp.m()) {
        let (n, m) = (nlp.n(), nlp.m());
        return Err(PyValueError::new_err(format!("the problem has {n} unknowns and {m} equations")));
    }
    Ok(())
}

/// Covariance (k, k) of some variables, the Newton step (k,) that is left, groups of variables that the
/// data do not determine, and whether the point is a saddle. EvaluationError where there is none: something is not
/// finite, or a constraint depends on others. `stop` is asked now and then: where it says so, and at a Ctrl-C that
/// nobody has taken, KeyboardInterrupt; where it takes more than `time_limit` seconds, TimeoutError.
#[pyfunction]
#[pyo3(signature = (problem, xi, multipliers, wanted, held, time_limit = None, stop = None))]
#[allow(clippy::type_complexity, clippy::too_many_arguments)] // a tuple for Python
pub fn information<'py>(
    py: Python<'py>,
    problem: &PyProblem,
    xi: PyReadonlyArray1<'py, f64>,
    multipliers: PyReadonlyArray1<'py, f64>,
    wanted: Vec<usize>,
    held: Vec<usize>,
    time_limit: Option<f64>,
    stop: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>, Vec<Vec<usize>>, bool)> {
    let (nlp, xi, lambda) = (problem.inner(), xi.as_slice()?, multipliers.as_slice()?);
    check_sizes(nlp, xi, Some(lambda))?;
    if let Some(i) = wanted.iter().chain(&held).find(|&&i| i >= nlp.n()) {
        return Err(PyValueError::new_err(format!("there is no unknown {i} among {}", nlp.n())));
    }
    let variables = |of: Vec<usize>| of.into_iter().map(VariableId).collect::<Vec<_>>();
    let (wanted, held) = (variables(wanted), variables(held));
    let limit = seconds(time_limit);
    let work = || {
        Interrupt::within(limit)
            .run(|| information_of(nlp, xi, lambda, &wanted, &held, &KktChoice::default()))
    };
    let (found, error) = watched(py, stop.as_ref(), |_| work());
    if let Some(error) = error {
        return Err(error);
    }
    let found = match found {
        Ok(found) => found,
        Err(NoInformation::NotFinite) => {
            let what = py.detach(|| nlp.explain(xi));
            let what = what.unwrap_or_else(|| "a derivative of the model is not finite".into());
            return Err(named("EvaluationError", what));
        }
        Err(NoInformation::Singular(KktError::Dependent { row })) => {
            return Err(named(
                "EvaluationError",
                format!("the {} depends linearly on others", nlp.constraint_name(row)),
            ));
        }
        Err(NoInformation::Singular(other)) => return Err(named("EvaluationError", other.to_string())),
        Err(NoInformation::Stopped) => {
            return Err(PyTimeoutError::new_err("the time limit was reached"));
        }
    };
    let covariance = PyArray1::from_vec(py, found.covariance).reshape([wanted.len(), wanted.len()])?;
    let groups = found.undetermined.into_iter().map(|group| group.into_iter().map(|i| i.0).collect());
    Ok((covariance, PyArray1::from_vec(py, found.step), groups.collect(), found.saddle))
}

/// Minimises from xi without the interpreter lock. `watch` is called with each line of the table, `stop` is asked now and
/// then. A KeyboardInterrupt from one of them or from Ctrl-C, and a `stop` that says so, end the run with the best point
/// so far; `time_limit` is in seconds, and none where it is more than a clock can tell.
#[pyfunction]
#[pyo3(signature = (problem, xi, multipliers, max_iterations, tolerance, time_limit, gauss_newton, regression, wide, watch, stop = None, paths = false))]
#[allow(clippy::too_many_arguments)] // options, all by name in Python
pub fn newton(
    py: Python<'_>,
    problem: &PyProblem,
    xi: PyReadonlyArray1<'_, f64>,
    multipliers: Option<PyReadonlyArray1<'_, f64>>,
    max_iterations: usize,
    tolerance: f64,
    time_limit: Option<f64>,
    gauss_newton: bool,
    regression: bool,
    wide: bool,
    watch: Option<Py<PyAny>>,
    stop: Option<Py<PyAny>>,
    paths: bool,
) -> PyResult<PySolution> {
    let nlp = problem.inner();
    let xi = xi.as_slice()?.to_vec();
    let multipliers = multipliers.map(|m| m.as_slice().map(<[f64]>::to_vec)).transpose()?;
    check_sizes(nlp, &xi, multipliers.as_deref())?;
    let settings = Settings::default().max_iterations(max_iterations).tolerance(tolerance);
    let settings = settings.time_limit(seconds(time_limit)).gauss_newton(gauss_newton);
    let initial = match (regression, wide) {
        (false, _) if paths => Initial::Paths,
        (false, _) => Initial::Start,
        (true, false) => Initial::Regression,
        (true, true) => Initial::Places,
    };
    let watch = watch.as_ref();
    let (solved, error) = watched(py, stop.as_ref(), |caller| {
        let mut each = |i: &Iteration| {
            let line = line(i);
            let Some(watch) = watch else { return Control::Continue };
            if caller.call(move |py| watch.call1(py, line).map(|_| ())) {
                Control::Continue
            } else {
                Control::Stop
            }
        };
        solve(nlp, &xi, multipliers.as_deref(), initial, &settings, &mut each)
    });
    let interrupt = |e: &PyErr| e.is_instance_of::<pyo3::exceptions::PyKeyboardInterrupt>(py);
    if let Some(e) = error.filter(|e| !interrupt(e)) {
        return Err(e);
    }
    solved.map(PySolution).map_err(|_| {
        let what = py.detach(|| nlp.explain(&xi));
        let what = what.unwrap_or_else(|| "a function of the model is not finite".into());
        named("EvaluationError", format!("at the starting point, {what}; give other start values, or bounds"))
    })
}
