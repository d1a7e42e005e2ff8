//! What can be wrong with a model, with data or at an evaluation, in the user's own names.

use thiserror::Error;

/// An error of this crate. The text names the user's variable and says what to do.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Error {
    /// The model is incomplete or contradicts itself.
    #[error("{0}")]
    Model(String),
    /// The data do not fit the model or are unusable.
    #[error("{0}")]
    Data(String),
    /// An option contradicts another or is out of range.
    #[error("{0}")]
    Option(String),
    /// A function is not finite at a point.
    #[error("{0}")]
    Evaluation(String),
}

/// " Did you mean 'x'?" for the closest of some names, or nothing where none is close.
pub fn did_you_mean<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    known
        .into_iter()
        .map(|k| (strsim::jaro_winkler(&name.to_lowercase(), &k.to_lowercase()), k))
        .filter(|(score, _)| *score > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, k)| format!(" Did you mean '{k}'?"))
        .unwrap_or_default()
}
