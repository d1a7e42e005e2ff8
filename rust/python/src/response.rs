//! Answers of a fitted path to forces on its equations.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use phugoid::diagnosis::Response;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::problem::PyProblem;

/// How the path of a collocation problem answers to slopes (k, points · n_x) added to its equations, and its
/// tangents along some variables: (k + tangents, n_θ + n_x · samples), parameters first, then the states at the
/// samples of each experiment, sample by sample. `None` where something is not finite.
#[pyfunction]
pub fn responses<'py>(
    py: Python<'py>,
    problem: &PyProblem,
    xi: PyReadonlyArray1<'py, f64>,
    held: Vec<usize>,
    slopes: PyReadonlyArray2<'py, f64>,
    tangents: Vec<usize>,
) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
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
    let (rows, forced) = (slopes.nrows() + tangents.len(), slopes.nrows());
    let found = py.detach(|| {
        let mut response = Response::new(problem, xi, &held).ok()?;
        let mut d = vec![0.0; layout.n()];
        let mut out = Vec::with_capacity(rows * width);
        for row in 0..rows {
            if row < forced {
                let slope = slopes.row(row);
                response.forced(slope.to_slice().unwrap_or(&slope.to_vec()), &mut d);
            } else {
                response.tangent(tangents[row - forced], &mut d);
            }
            out.extend_from_slice(&d[..layout.n_theta]);
            for (mesh, first) in problem.meshes.iter().zip(&layout.first_point) {
                for point in &mesh.sample_points {
                    out.extend_from_slice(&d[layout.state(first + point)..][..layout.n_x]);
                }
            }
        }
        Some(out)
    });
    found.map(|out| PyArray1::from_vec(py, out).reshape([rows, width])).transpose()
}
