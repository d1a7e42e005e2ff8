//! The likelihood of residuals with random effects.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use phugoid::internals::diagnosis::RandomEffects;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Logarithms of the variances, minus twice the log-likelihood, coefficients, factor of their normal equations, and the
/// effective number of those that are random.
type Found<'py> = (Bound<'py, PyArray1<f64>>, f64, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>, f64);

/// The likelihood of residuals of n_y outputs with k random coefficients at logarithms `x` of the variances (1 + n_y), or
/// from there at its maximum; `None` where the normal equations are not positive definite. `products` are those of the
/// columns with each other (n_y, m, m), with the residuals (n_y, m), the residuals' squares and the numbers of rows (n_y);
/// `prior` is the inverse of the coefficients' correlation (k, k), and the logarithm of the determinant of that correlation.
#[pyfunction]
#[allow(clippy::type_complexity)]
pub fn random_effects<'py>(
    py: Python<'py>,
    products: (
        PyReadonlyArray3<'py, f64>,
        PyReadonlyArray2<'py, f64>,
        PyReadonlyArray1<'py, f64>,
        PyReadonlyArray1<'py, f64>,
    ),
    k: usize,
    prior: (PyReadonlyArray2<'py, f64>, f64),
    x: PyReadonlyArray1<'py, f64>,
    maximised: bool,
) -> PyResult<Option<Found<'py>>> {
    let (grams, with_r, squares, counts) = &products;
    let (n_y, m) = with_r.as_array().dim();
    if grams.as_array().dim() != (n_y, m, m)
        || (squares.as_array().len(), counts.as_array().len(), x.as_array().len()) != (n_y, n_y, n_y + 1)
        || k > m
        || prior.0.as_array().dim() != (k, k)
    {
        return Err(PyValueError::new_err(format!(
            "there are {n_y} outputs, {m} columns, {k} of them random"
        )));
    }
    let effects = RandomEffects {
        k,
        grams: grams.as_slice()?,
        with_r: with_r.as_slice()?,
        squares: squares.as_slice()?,
        counts: counts.as_slice()?,
        precision: prior.0.as_slice()?,
        log_det: prior.1,
    };
    let x = x.as_slice()?;
    let found = py.detach(|| if maximised { effects.maximised(x) } else { effects.at(x) });
    let made = found.map(|f| {
        let factor = PyArray1::from_vec(py, f.factor).reshape([m, m])?;
        Ok((PyArray1::from_vec(py, f.x), f.value, PyArray1::from_vec(py, f.solution), factor, f.unknowns))
    });
    made.transpose()
}
