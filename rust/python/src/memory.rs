//! Signals that follow others and remember their past.

use numpy::{PyArray1, PyReadonlyArray1};
use phugoid::internals::diagnosis::memory;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

type Vector<'py> = PyReadonlyArray1<'py, f64>;

/// Returns what follows a signal with play of a half width.
#[pyfunction]
pub fn play<'py>(py: Python<'py>, u: Vector<'py>, size: f64) -> Bound<'py, PyArray1<f64>> {
    PyArray1::from_vec(py, memory::play(&u.as_array().to_vec(), size))
}

/// Returns what follows a signal no faster than a rate.
#[pyfunction]
pub fn rate_limited<'py>(
    py: Python<'py>,
    t: Vector<'py>,
    u: Vector<'py>,
    rate: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    following(py, &t, &u, |t, u| memory::rate_limited(t, u, rate))
}

/// Returns the state of a hysteresis of Bouc and Wen along a motion.
#[pyfunction]
pub fn bouc_wen<'py>(py: Python<'py>, x: Vector<'py>, size: f64, turn: f64) -> Bound<'py, PyArray1<f64>> {
    PyArray1::from_vec(py, memory::bouc_wen(&x.as_array().to_vec(), size, turn))
}

/// Returns what follows a signal with a lag of first order.
#[pyfunction]
pub fn lagged<'py>(
    py: Python<'py>,
    t: Vector<'py>,
    u: Vector<'py>,
    tau: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    following(py, &t, &u, |t, u| memory::lagged(t, u, tau))
}

/// Returns what follows a signal at its times, of which there are as many.
fn following<'py>(
    py: Python<'py>,
    t: &Vector<'py>,
    u: &Vector<'py>,
    follow: impl Fn(&[f64], &[f64]) -> Vec<f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (t, u) = (t.as_array().to_vec(), u.as_array().to_vec());
    if t.len() != u.len() {
        return Err(PyValueError::new_err("t and u have the same length"));
    }
    Ok(PyArray1::from_vec(py, follow(&t, &u)))
}
