//! Python bindings of `phugoid`: handles and views, no numerics.

mod collocation;
mod errors;
mod estimation;
mod evaluator;
mod expr;
mod filter;
mod fit;
mod fleet;
mod interrupt;
mod memory;
mod model;
mod newton;
mod noise;
mod online;
mod problem;
mod random_effects;
mod response;
mod shooting;
mod simulate;
mod start;
mod whitening;
mod worker;

use pyo3::prelude::*;

#[pymodule]
fn _core(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add_class::<expr::PyExpr>()?;
    m.add_class::<expr::PyTable>()?;
    m.add_class::<model::PyModel>()?;
    m.add_class::<noise::PyNoise>()?;
    m.add_class::<problem::PyProblem>()?;
    m.add_class::<collocation::PyCollocation>()?;
    m.add_class::<shooting::PyShooting>()?;
    m.add_class::<evaluator::PyEvaluator>()?;
    m.add_class::<filter::PyFilter>()?;
    m.add_class::<fit::PyFit>()?;
    m.add_class::<newton::PySolution>()?;
    m.add_class::<fleet::PyShare>()?;
    m.add_class::<online::PyOnline>()?;
    m.add_class::<whitening::PyWhitening>()?;
    m.add_function(wrap_pyfunction!(whitening::burg, m)?)?;
    m.add_function(wrap_pyfunction!(random_effects::random_effects, m)?)?;
    m.add_function(wrap_pyfunction!(memory::play, m)?)?;
    m.add_function(wrap_pyfunction!(memory::rate_limited, m)?)?;
    m.add_function(wrap_pyfunction!(memory::bouc_wen, m)?)?;
    m.add_function(wrap_pyfunction!(memory::lagged, m)?)?;
    m.add_function(wrap_pyfunction!(estimation::estimate, m)?)?;
    m.add_function(wrap_pyfunction!(estimation::unlike_noise, m)?)?;
    m.add_function(wrap_pyfunction!(fit::integration_error, m)?)?;
    m.add_function(wrap_pyfunction!(newton::newton, m)?)?;
    m.add_function(wrap_pyfunction!(start::check_start, m)?)?;
    m.add_function(wrap_pyfunction!(start::parameter_start, m)?)?;
    m.add_function(wrap_pyfunction!(start::state_start, m)?)?;
    m.add_function(wrap_pyfunction!(newton::information, m)?)?;
    m.add_function(wrap_pyfunction!(simulate::simulate, m)?)?;
    m.add_function(wrap_pyfunction!(response::answers, m)?)?;
    m.add_function(wrap_pyfunction!(response::tangents, m)?)?;
    m.add_function(wrap_pyfunction!(expr::apply, m)?)?;
    m.add_function(wrap_pyfunction!(expr::operations, m)?)?;
    m.add_function(wrap_pyfunction!(expr::symbol_parts, m)?)?;
    m.add_function(wrap_pyfunction!(expr::load_expression, m)?)?;
    m.add_function(wrap_pyfunction!(expr::interpolate, m)?)?;
    m.add_function(wrap_pyfunction!(problem::gaps, m)?)?;
    m.add_function(wrap_pyfunction!(problem::gap_warnings, m)?)?;
    Ok(())
}
