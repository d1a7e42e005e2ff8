//! A known constant with its name.

use crate::setters::setters;

/// A known constant of a model: a wing area, a mass, the acceleration of gravity.
///
/// Equations are printed with its name, and compiled with its value, so that it costs what the number would.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Constant {
    /// Name.
    pub name: String,
    /// Value, in the unit.
    pub value: f64,
    /// Unit, as text; empty where unknown.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "String::is_empty"))]
    pub unit: String,
    /// Describes it in words; empty where nothing was said.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "String::is_empty"))]
    pub meaning: String,
}

impl Constant {
    setters! { ; into unit: String, into meaning: String }

    /// A constant without unit and meaning.
    pub fn new(name: &str, value: f64) -> Self {
        Constant { name: name.to_owned(), value, unit: String::new(), meaning: String::new() }
    }

    /// Returns an error in its value, if there is one.
    pub(crate) fn wrong(&self) -> Option<String> {
        (!self.value.is_finite()).then(|| format!("its value {} is not a finite number", self.value))
    }
}
