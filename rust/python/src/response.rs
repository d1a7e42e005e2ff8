//! Answers of a fitted path to forces on its equations.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use phugoid::collocation::Collocation;
use phugoid::diagnosis::{self, Forward, Outputs, Place, Response};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::problem::PyProblem;

type Matrix<'py> = Bound<'py, PyArray2<f64>>;

fn collocation<'a>(problem: &'a PyProblem, xi: &[f64]) -> PyResult<&'a Collocation> {
    let Some(problem) = problem.collocation() else {
        return Err(PyValueError::new_err("responses are those of a collocation problem"));
    };
    if xi.len() != problem.layout.n() {
        return Err(PyValueError::new_err(format!(
            "the problem has {} variables, xi {}",
            problem.layout.n(),
            xi.len()
        )));
    }
    Ok(problem)
}

/// Tangents of the path of a collocation problem along some variables: (tangents, n_θ + n_x · samples), parameters
/// first, then the states at the samples of each experiment, sample by sample; `None` where something is not finite. And
/// whether that is forward in time: then they are those of one variable alone, a parameter or a first state, whatever
/// conditions there are.
#[pyfunction]
pub fn tangents<'py>(
    py: Python<'py>,
    problem: &PyProblem,
    xi: PyReadonlyArray1<'py, f64>,
    held: Vec<usize>,
    variables: Vec<usize>,
) -> PyResult<Option<(Matrix<'py>, bool)>> {
    let xi = xi.as_slice()?;
    let problem = collocation(problem, xi)?;
    let layout = &problem.layout;
    let samples: usize = problem.meshes.iter().map(|m| m.sample_points.len()).sum();
    let width = layout.n_theta + layout.n_x * samples;
    let found = py.detach(|| {
        let mut out = Vec::with_capacity(variables.len() * width);
        if let Some(forward) = Forward::new(problem, xi).ok()? {
            for (&i, states) in variables.iter().zip(forward.tangents(&variables)) {
                out.extend((0..layout.n_theta).map(|p| f64::from(p == i)));
                out.extend(states);
            }
            return Some((out, true));
        }
        let mut response = Response::new(problem, xi, &held).ok()?;
        let mut d = vec![0.0; layout.n()];
        for &i in &variables {
            response.tangent(i, &mut d);
            out.extend_from_slice(&d[..layout.n_theta]);
            for (mesh, first) in problem.meshes.iter().zip(&layout.first_point) {
                for point in &mesh.sample_points {
                    out.extend_from_slice(&d[layout.state(first + point)..][..layout.n_x]);
                }
            }
        }
        Some((out, false))
    });
    let rows = variables.len();
    found.map(|(out, forward)| Ok((PyArray1::from_vec(py, out).reshape([rows, width])?, forward))).transpose()
}

/// How outputs answer to signals (k, points) at a place, which adds `slopes` (mesh points, n_x) to f and `direct`
/// (samples, n_y) to the outputs for a signal of 1: (k, rows), and how parameters take part, (k, n_θ); `None` where
/// something is not finite. `by_state` (samples, n_y, n_x) and `by_parameter` (samples, n_y, n_θ) are derivatives of the
/// outputs, `rows` (samples, n_y) tells which row each is, -1 that it is none. Of several experiments all is after each
/// other. Forward in time parameters and first states take no part; where the motion is too unstable for that, the
/// least.
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
) -> PyResult<Option<(Matrix<'py>, Matrix<'py>)>> {
    let xi = xi.as_slice()?;
    let problem = collocation(problem, xi)?;
    let (n, n_theta) = (problem.layout.n_x, problem.layout.n_theta);
    let total = |f: fn(&phugoid::mesh::Mesh) -> usize| problem.meshes.iter().map(f).sum::<usize>();
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
    let found = py.detach(|| diagnosis::answers((problem, xi, &held), &outputs, &place, signals));
    let Ok((columns, parameters)) = found else { return Ok(None) };
    let matrix = |v: Vec<f64>, width: usize| PyArray1::from_vec(py, v).reshape([k, width]);
    Ok(Some((matrix(columns, width)?, matrix(parameters, n_theta)?)))
}
