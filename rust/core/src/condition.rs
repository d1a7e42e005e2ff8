//! Conditions on the ends of a record: initial, final and periodic ones.
//!
//! Without any, all initial states are free. A condition takes a freedom away: x(t₀) = x₀(θ), x(t_f) = x_f,
//! or x(t_f) = x(t₀).

use crate::expr::Expr;

/// The end of a record at which a condition holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "lowercase"))]
pub enum End {
    /// At the first sample.
    Initial,
    /// At the last sample.
    Final,
    /// The state at the last sample is that at the first, but for the right-hand side.
    Periodic,
}

/// A condition: the state equals the right-hand side at an end, or differs by it between the ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// The end at which it holds.
    pub end: End,
    /// The state.
    pub state: String,
    /// The right-hand side: an expression in parameters, in inputs, time and other states at that end; for a
    /// periodic condition in parameters alone.
    pub expr: Expr,
    /// The user's line: `file:line`.
    pub source: Option<String>,
}
