//! Residuals and sensitivities made white.

use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArrayDyn,
    PyUntypedArrayMethods,
};
use phugoid::internals::diagnosis::{Predictors, Run, Whitening};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

type Channel<'py> =
    (Vec<PyReadonlyArray1<'py, f64>>, PyReadonlyArray1<'py, f64>, Vec<(usize, PyReadonlyArray1<'py, isize>)>);

/// Autoregressive models, of order 0, 1, ..., of runs (n,), or (k, n) of k sequences of the same samples: their predictors,
/// and the variances of these.
#[pyfunction]
pub fn burg<'py>(
    py: Python<'py>,
    runs: Vec<PyReadonlyArrayDyn<'py, f64>>,
) -> (Vec<Bound<'py, PyArray1<f64>>>, Bound<'py, PyArray1<f64>>) {
    let one = |run: &PyReadonlyArrayDyn<'py, f64>| Run {
        values: run.as_array().iter().copied().collect(),
        n: run.shape().last().copied().unwrap_or(0),
    };
    let runs = runs.iter().map(one).filter(|run| run.n > 0).collect();
    let (predictors, powers) = py.detach(|| phugoid::internals::diagnosis::burg(runs));
    (predictors.into_iter().map(|p| PyArray1::from_vec(py, p)).collect(), PyArray1::from_vec(py, powers))
}

/// Prediction errors of autoregressive models of channels.
#[pyclass(name = "Whitening", module = "phugoid._core", frozen)]
pub struct PyWhitening(Whitening);

#[pymethods]
impl PyWhitening {
    /// Channels are (predictors of order 0, 1, ..., standard deviations, segments: first row and places in time);
    /// mixings are (inverse of a root, rows (times, n)).
    #[new]
    fn new(
        channels: Vec<Channel<'_>>,
        mixings: Vec<(PyReadonlyArray2<'_, f64>, PyReadonlyArray2<'_, isize>)>,
    ) -> PyResult<Self> {
        let wrong = || {
            PyValueError::new_err("predictor k has k coefficients and a standard deviation; places increase")
        };
        let mut models = Vec::with_capacity(channels.len());
        for (predictors, sigmas, segments) in &channels {
            let predictors: Vec<Vec<f64>> = predictors.iter().map(|p| p.as_array().to_vec()).collect();
            let sigmas = sigmas.as_array().to_vec();
            if sigmas.is_empty()
                || predictors.len() != sigmas.len()
                || predictors.iter().enumerate().any(|(k, p)| p.len() != k)
            {
                return Err(wrong());
            }
            let places = |p: &PyReadonlyArray1<'_, isize>| {
                p.as_array().iter().map(|&i| i as usize).collect::<Vec<_>>()
            };
            let segments: Vec<_> = segments.iter().map(|(first, p)| (*first, places(p))).collect();
            if segments.iter().any(|(_, places)| places.windows(2).any(|w| w[1] <= w[0])) {
                return Err(wrong());
            }
            models.push((Predictors::new(predictors, sigmas), segments));
        }
        let mixings: Vec<_> = mixings
            .iter()
            .map(|(inverse, at)| {
                (
                    inverse.as_array().iter().copied().collect(),
                    at.as_array().iter().map(|&i| i as usize).collect(),
                )
            })
            .collect();
        let rows: usize =
            models.iter().flat_map(|(_, segments)| segments).map(|(_, places)| places.len()).sum();
        let inside =
            |(inverse, at): &(Vec<f64>, Vec<usize>)| !inverse.is_empty() && at.iter().all(|&i| i < rows);
        let found = Whitening::new(&models, mixings.iter().filter(|m| inside(m)).cloned().collect());
        if found.rows() != rows || !mixings.iter().all(inside) {
            return Err(PyValueError::new_err("uniform segments must contain every row"));
        }
        Ok(PyWhitening(found))
    }

    /// Columns (k, rows), whitened.
    fn errors<'py>(
        &self,
        py: Python<'py>,
        columns: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let shape = self.checked(&columns)?;
        let columns = row_by_row(&columns)?;
        PyArray1::from_vec(py, py.detach(|| self.0.errors(columns))).reshape(shape)
    }

    /// (rows,) logarithms of what errors are divided by.
    fn log_scales<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_vec(py, self.0.log_scales())
    }

    /// Products of columns (k, rows), whitened, with vectors (m, rows): (k, m); and with each other within groups of so
    /// many columns: their squares, one after the other.
    #[allow(clippy::type_complexity)]
    fn products<'py>(
        &self,
        py: Python<'py>,
        columns: PyReadonlyArray2<'py, f64>,
        vectors: PyReadonlyArray2<'py, f64>,
        sizes: Vec<usize>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
        let ([k, _], [m, _]) = (self.checked(&columns)?, self.checked(&vectors)?);
        if sizes.iter().sum::<usize>() != k {
            return Err(PyValueError::new_err(format!("groups hold {k} columns")));
        }
        let (columns, vectors) = (row_by_row(&columns)?, row_by_row(&vectors)?);
        let (along, grams) = py.detach(|| self.0.products(columns, vectors, &sizes));
        Ok((PyArray1::from_vec(py, along).reshape([k, m])?, PyArray1::from_vec(py, grams)))
    }
}

impl PyWhitening {
    fn checked(&self, columns: &PyReadonlyArray2<'_, f64>) -> PyResult<[usize; 2]> {
        let shape = columns.as_array().raw_dim();
        if shape[1] != self.0.rows() {
            return Err(PyValueError::new_err(format!("columns are (k, {})", self.0.rows())));
        }
        Ok([shape[0], shape[1]])
    }
}

/// Entries row by row; `as_slice` would give those of a transposed array too, column by column.
fn row_by_row<'a>(matrix: &'a PyReadonlyArray2<'_, f64>) -> PyResult<&'a [f64]> {
    matrix.as_array().to_slice().ok_or_else(|| PyValueError::new_err("columns stand row by row"))
}
