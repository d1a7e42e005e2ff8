//! Errors in a model, in data or at an evaluation, in the user's own names.

use thiserror::Error;

/// Most characters of a message.
const MESSAGE: usize = 2000;

/// A text of at most so many characters: its beginning and end, where it is longer.
pub fn shortened(text: &str, most: usize) -> String {
    let count = text.chars().count();
    if count <= most {
        return text.to_owned();
    }
    let note = format!(" ... ({count} characters) ... ");
    let left = most.saturating_sub(note.len());
    let end = left / 3;
    let head: String = text.chars().take(left - end).collect();
    let tail: String = text.chars().skip(count - end).collect();
    head + &note + &tail
}

/// An error of this crate. The text names the user's variable and says what to do.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Error {
    /// The model is incomplete or contradicts itself.
    #[error("{}", shortened(.0, MESSAGE))]
    Model(String),
    /// The data do not fit the model or are unusable.
    #[error("{}", shortened(.0, MESSAGE))]
    Data(String),
    /// An option contradicts another or is out of range.
    #[error("{}", shortened(.0, MESSAGE))]
    Option(String),
    /// A function is not finite at a point.
    #[error("{}", shortened(.0, MESSAGE))]
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
