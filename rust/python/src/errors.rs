//! Errors of the core as the exceptions of `phugoid.errors`.

use phugoid::{Error, ErrorKind};
use pyo3::prelude::*;

/// The Python exception for an error.
pub fn raise(error: Error) -> PyErr {
    let class = match error.kind() {
        ErrorKind::Model => "ModelError",
        ErrorKind::Data => "DataError",
        ErrorKind::Option => "OptionError",
        _ => "EvaluationError",
    };
    named(class, error.to_string())
}

/// An exception of `phugoid.errors` by name.
pub fn named(class: &str, text: String) -> PyErr {
    Python::attach(|py| {
        let made = py.import("phugoid.errors").and_then(|m| m.getattr(class)).and_then(|c| c.call1((text,)));
        match made {
            Ok(exception) => PyErr::from_value(exception),
            Err(error) => error,
        }
    })
}
