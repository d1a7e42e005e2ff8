//! Answers of a fitted path to forces on its equations.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use phugoid::diagnosis::{Forward, Response};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::problem::PyProblem;

/// How the path of a collocation problem answers to slopes (k, points · n_x) added to its equations, and its
/// tangents along some variables: (k + tangents, n_θ + n_x · samples), parameters first, then the states at the
/// samples of each experiment, sample by sample; `None` where something is not finite. And whether that is forward in
/// time: then parameters and first states take no part in the answers to slopes, and tangents are those of one variable
/// alone, a parameter or a first state, whatever conditions there are. Else, where the motion is too unstable for
/// that, they take the least part that there is.
#[pyfunction]
pub fn responses<'py>(
    py: Python<'py>,
    problem: &PyProblem,
    xi: PyReadonlyArray1<'py, f64>,
    held: Vec<usize>,
    slopes: PyReadonlyArray2<'py, f64>,
    tangents: Vec<usize>,
) -> PyResult<Option<(Bound<'py, PyArray2<f64>>, bool)>> {
    let Some(problem) = problem.inner().collocation() else {
        return Err(PyValueError::new_err("responses are those of a collocation problem"));
    };
    let points: usize = problem.meshes.iter().map(|m| m.n_mesh).sum();
    let (layout, size) = (&problem.layout, points * problem.layout.n_x);
    let (xi, slopes) = (xi.as_slice()?, slopes.as_array());
    if xi.len() != layout.n() || slopes.ncols() != size {
        return Err(PyValueError::new_err(format!("slopes are (k, {size}), xi has {} entries", layout.n())));
    }
    let samples: usize = problem.meshes.iter().map(|m| m.sample_points.len()).sum();
    let width = layout.n_theta + layout.n_x * samples;
    let rows = slopes.nrows() + tangents.len();
    let forced: Vec<Vec<f64>> = slopes.rows().into_iter().map(|r| r.to_vec()).collect();
    let at_samples = |d: &[f64], out: &mut Vec<f64>| {
        for (mesh, first) in problem.meshes.iter().zip(&layout.first_point) {
            for point in &mesh.sample_points {
                out.extend_from_slice(&d[layout.state(first + point)..][..layout.n_x]);
            }
        }
    };
    let found = py.detach(|| {
        let mut out = Vec::with_capacity(rows * width);
        if let Some(forward) = Forward::new(problem, xi).ok()? {
            for states in forward.solve(&forced.iter().map(Vec::as_slice).collect::<Vec<_>>()) {
                out.resize(out.len() + layout.n_theta, 0.0);
                out.extend(states);
            }
            for (&i, states) in tangents.iter().zip(forward.tangents(&tangents)) {
                out.extend((0..layout.n_theta).map(|p| f64::from(p == i)));
                out.extend(states);
            }
            return Some((out, true));
        }
        let mut response = Response::new(problem, xi, &held).ok()?;
        let mut d = vec![0.0; layout.n()];
        for slope in &forced {
            response.forced(slope, &mut d);
            out.extend_from_slice(&d[..layout.n_theta]);
            at_samples(&d, &mut out);
        }
        for &i in &tangents {
            response.tangent(i, &mut d);
            out.extend_from_slice(&d[..layout.n_theta]);
            at_samples(&d, &mut out);
        }
        Some((out, false))
    });
    found.map(|(out, forward)| Ok((PyArray1::from_vec(py, out).reshape([rows, width])?, forward))).transpose()
}
