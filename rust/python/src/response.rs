//! Answers of a fitted path to forces on its equations.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use phugoid::collocation::Collocation;
use phugoid::internals::diagnosis::{Linearisation, Outputs, Place};
use phugoid::nlp::{Nlp, VariableId};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::interrupt::interruptible;
use crate::problem::{Kept, PyProblem};

type Matrix<'py> = Bound<'py, PyArray2<f64>>;

/// A linearisation is kept for the next call where the Jacobian has no more entries: about 100 MB.
const KEPT: usize = 2_000_000;

fn collocation<'a>(problem: &'a PyProblem, xi: &[f64]) -> PyResult<(&'a Arc<Collocation>, &'a Kept)> {
    let Some(found) = problem.collocation() else {
        return Err(PyValueError::new_err("responses are those of a collocation problem"));
    };
    let n = found.0.layout.n();
    if xi.len() != n {
        return Err(PyValueError::new_err(format!("the problem has {n} variables, xi {}", xi.len())));
    }
    Ok(found)
}

fn numbers(variables: Vec<usize>) -> Vec<VariableId> {
    variables.into_iter().map(VariableId).collect()
}

/// Asks the linearisation about ξ: the one that is kept, or a new one, which is kept then.
fn ask<R>(
    (problem, kept): (&Arc<Collocation>, &Kept),
    xi: &[f64],
    held: &[VariableId],
    question: impl FnOnce(&mut Linearisation<Arc<Collocation>>) -> R,
) -> R {
    let new = || Linearisation::new(problem.clone(), xi, held);
    // Another thread may be at it.
    let mut own = None;
    let mut guard = kept.try_lock().ok().filter(|_| problem.jacobian_structure().len() <= KEPT);
    let place = guard.as_deref_mut().unwrap_or(&mut own);
    if place.as_ref().is_none_or(|l| !l.is_at(xi, held)) {
        *place = None;
    }
    question(place.get_or_insert_with(new))
}

/// Tangents of the path of a collocation problem along some variables: (tangents, n_θ + n_x · samples), parameters
/// first, then the states at the samples of each experiment, sample by sample; `None` where something is not finite. And
/// whether that is forward in time: then they are those of one variable alone, a parameter or an initial state, whatever
/// conditions there are. `stop` is asked now and then whether to end with a KeyboardInterrupt.
#[pyfunction]
pub fn tangents<'py>(
    py: Python<'py>,
    problem: &PyProblem,
    xi: PyReadonlyArray1<'py, f64>,
    held: Vec<usize>,
    variables: Vec<usize>,
    stop: Py<PyAny>,
) -> PyResult<Option<(Matrix<'py>, bool)>> {
    let xi = xi.as_slice()?;
    let of = collocation(problem, xi)?;
    let layout = &of.0.layout;
    let samples: usize = of.0.meshes.iter().map(|m| m.sample_points.len()).sum();
    let width = layout.n_theta + layout.n_x * samples;
    let (held, variables) = (numbers(held), numbers(variables));
    let found = interruptible(py, Some(&stop), || ask(of, xi, &held, |l| l.tangents(&variables)).ok())?;
    let rows = variables.len();
    found.map(|(out, forward)| Ok((PyArray1::from_vec(py, out).reshape([rows, width])?, forward))).transpose()
}

/// How outputs answer to signals (k, points) at a place, which adds `slopes` (mesh points, n_x) to f and `direct`
/// (samples, n_y) to the outputs for a signal of 1: (k, rows), and how parameters take part, (k, n_θ); `None` where
/// something is not finite. `by_state` (samples, n_y, n_x) and `by_parameter` (samples, n_y, n_θ) are derivatives of the
/// outputs, `rows` (samples, n_y) tells which row each is, -1 that it is none. Of several experiments all is after each
/// other. Forward in time parameters and initial states take no part; where the motion is too unstable for that, the
/// least. `stop` is asked now and then whether to end with a KeyboardInterrupt.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn answers<'py>(
    py: Python<'py>,
    problem: &PyProblem,
    xi: PyReadonlyArray1<'py, f64>,
    held: Vec<usize>,
    by_state: PyReadonlyArray3<'py, f64>,
    by_parameter: PyReadonlyArray3<'py, f64>,
    rows: PyReadonlyArray2<'py, isize>,
    slopes: PyReadonlyArray2<'py, f64>,
    direct: PyReadonlyArray2<'py, f64>,
    signals: PyReadonlyArray2<'py, f64>,
    stop: Py<PyAny>,
) -> PyResult<Option<(Matrix<'py>, Matrix<'py>)>> {
    let xi = xi.as_slice()?;
    let of = collocation(problem, xi)?;
    let problem = of.0;
    let (n, n_theta) = (problem.layout.n_x, problem.layout.n_theta);
    let total = |f: fn(&phugoid::internals::mesh::Mesh) -> usize| problem.meshes.iter().map(f).sum::<usize>();
    let [points, mesh_points, samples] =
        [total(|m| m.times.len()), total(|m| m.n_mesh), total(|m| m.sample_points.len())];
    let (k, n_y) = (signals.as_array().nrows(), rows.as_array().ncols());
    if by_state.as_array().dim() != (samples, n_y, n)
        || by_parameter.as_array().dim() != (samples, n_y, n_theta)
        || rows.as_array().nrows() != samples
        || slopes.as_array().dim() != (mesh_points, n)
        || direct.as_array().dim() != (samples, n_y)
        || signals.as_array().ncols() != points
    {
        return Err(PyValueError::new_err(format!(
            "there are {points} points, {mesh_points} of the mesh, and {samples} samples"
        )));
    }
    let not_so = || PyValueError::new_err("arrays stand row by row");
    let rows = rows.as_array().to_slice().ok_or_else(not_so)?;
    let width = rows.iter().filter(|&&r| r >= 0).count();
    if rows.iter().any(|&r| usize::try_from(r).is_ok_and(|r| r >= width)) {
        return Err(PyValueError::new_err(format!("of {width} rows")));
    }
    let outputs =
        Outputs { by_state: by_state.as_slice()?, by_parameter: by_parameter.as_slice()?, rows, n_y };
    let place = Place { slopes: slopes.as_slice()?, outputs: direct.as_slice()? };
    let signals = signals.as_slice()?;
    let held = numbers(held);
    let answered = || ask(of, xi, &held, |l| l.answers(&outputs, &place, signals));
    let found = interruptible(py, Some(&stop), answered)?;
    let Ok((columns, parameters)) = found else { return Ok(None) };
    let matrix = |v: Vec<f64>, width: usize| PyArray1::from_vec(py, v).reshape([k, width]);
    Ok(Some((matrix(columns, width)?, matrix(parameters, n_theta)?)))
}
