//! Errors in a model, in data or at an evaluation, in the user's own names.

use std::fmt;

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

/// What an [`Error`] is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The model is incomplete or contradicts itself.
    Model,
    /// The data do not fit the model or are unusable.
    Data,
    /// An option contradicts another or is out of range.
    Option,
    /// A function is not finite at a point.
    Evaluation,
}

/// An error of this crate. Its text names the user's variable and says what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    kind: ErrorKind,
    text: String,
    names: Vec<String>,
}

impl Error {
    fn new(kind: ErrorKind, text: String) -> Error {
        Error { kind, text, names: Vec::new() }
    }

    pub(crate) fn model(text: String) -> Error {
        Error::new(ErrorKind::Model, text)
    }

    pub(crate) fn data(text: String) -> Error {
        Error::new(ErrorKind::Data, text)
    }

    pub(crate) fn option(text: String) -> Error {
        Error::new(ErrorKind::Option, text)
    }

    pub(crate) fn evaluation(text: String) -> Error {
        Error::new(ErrorKind::Evaluation, text)
    }

    /// Adds the name of what is wrong.
    pub(crate) fn about(mut self, name: impl AsRef<str>) -> Error {
        self.names.push(name.as_ref().to_owned());
        self
    }

    /// What it is about.
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// The user's names for what is wrong: an experiment and its channel, a parameter, an output.
    pub fn names(&self) -> &[String] {
        &self.names
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&shortened(&self.text, MESSAGE))
    }
}

impl std::error::Error for Error {}

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
