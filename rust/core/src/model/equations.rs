//! The equations of a model as the user writes them, with their lines.

use std::panic::Location;

use super::{Equation, Model, Variable, place};
use crate::condition::{Condition, End};
use crate::error::{Error, did_you_mean};
use crate::expr::Expr;

/// A model to which equations are added that were written elsewhere than in Rust, as in a script or a file.
#[derive(Debug)]
pub struct WrittenAt<'a> {
    model: &'a mut Model,
    source: Option<String>,
}

impl Model {
    /// Adds equations that were written at this place, `file:line`, which messages name in place of the line in Rust.
    pub fn written_at(&mut self, source: Option<String>) -> WrittenAt<'_> {
        WrittenAt { model: self, source }
    }

    #[track_caller]
    fn here(&mut self) -> WrittenAt<'_> {
        let caller = Location::caller();
        self.written_at(Some(format!("{}:{}", caller.file(), caller.line())))
    }

    /// Names an intermediate; returns its symbol.
    ///
    /// # Errors
    /// When the name is taken, or is none.
    #[track_caller]
    pub fn quantity(&mut self, name: &str, expr: Expr) -> Result<Expr, Error> {
        self.here().quantity(name, expr)
    }

    /// Gives the state equation ẋ = `expr` of a state.
    ///
    /// # Errors
    /// When there is no such state, or it has an equation.
    #[track_caller]
    pub fn equation(&mut self, state: &str, expr: Expr) -> Result<(), Error> {
        self.here().equation(state, expr)
    }

    /// Declares an output.
    ///
    /// # Errors
    /// When the name is taken.
    #[track_caller]
    pub fn output(&mut self, name: &str, expr: Expr, unit: &str) -> Result<(), Error> {
        self.here().output(name, expr, unit)
    }

    /// Sets a condition on an end of each record: the state equals `expr` there, or differs by it between
    /// the ends. States without a condition are free at both ends.
    ///
    /// # Errors
    /// When there is no such state, it has such a condition, or there are as many conditions as states.
    #[track_caller]
    pub fn condition(&mut self, end: End, state: &str, expr: Expr) -> Result<(), Error> {
        self.here().condition(end, state, expr)
    }
}

impl WrittenAt<'_> {
    /// As [`Model::quantity`].
    ///
    /// # Errors
    /// As there.
    pub fn quantity(self, name: &str, expr: Expr) -> Result<Expr, Error> {
        let WrittenAt { model, source } = self;
        model.claim("quantity", name)?;
        model.quantities.push(Equation { name: name.to_owned(), unit: String::new(), expr, source });
        Ok(Expr::symbol(name))
    }

    /// As [`Model::equation`].
    ///
    /// # Errors
    /// As there.
    pub fn equation(self, state: &str, expr: Expr) -> Result<(), Error> {
        let WrittenAt { model, source } = self;
        let place = place(source.as_deref());
        model.expect_state(state, &format!("state equation{place}"))?;
        if model.dynamics.iter().any(|e| e.name == state) {
            return Err(Error::model(format!("state equation{place}: '{state}' already has an equation"))
                .about(state));
        }
        model.dynamics.push(Equation { name: state.to_owned(), unit: String::new(), expr, source });
        Ok(())
    }

    /// As [`Model::output`].
    ///
    /// # Errors
    /// As there.
    pub fn output(self, name: &str, expr: Expr, unit: &str) -> Result<(), Error> {
        let WrittenAt { model, source } = self;
        if model.outputs.iter().any(|e| e.name == name) {
            return Err(
                Error::model(format!("output '{name}': there is an output of this name already")).about(name)
            );
        }
        // An output that is a plain state or input has its unit.
        let unit = match expr.as_symbol() {
            Some(symbol) if unit.is_empty() => {
                let same = |v: &&Variable| v.name == symbol;
                model.states.iter().chain(&model.inputs).find(same).map_or(String::new(), |v| v.unit.clone())
            }
            _ => unit.to_owned(),
        };
        model.outputs.push(Equation { name: name.to_owned(), unit, expr, source });
        Ok(())
    }

    /// As [`Model::condition`].
    ///
    /// # Errors
    /// As there.
    pub fn condition(self, end: End, state: &str, expr: Expr) -> Result<(), Error> {
        let WrittenAt { model, source } = self;
        let place = place(source.as_deref());
        model.expect_state(state, &format!("condition{place}"))?;
        if model.conditions.iter().any(|c| c.state == state && c.end == end) {
            return Err(Error::model(format!("condition{place}: '{state}' already has such a condition"))
                .about(state));
        }
        if model.conditions.len() == model.states.len() {
            return Err(Error::model(format!(
                "condition{place}: {} states already have {} conditions; another would leave nothing to estimate",
                model.states.len(),
                model.conditions.len()
            )));
        }
        model.conditions.push(Condition { end, state: state.to_owned(), expr, source });
        Ok(())
    }
}

impl Model {
    fn expect_state(&self, name: &str, what: &str) -> Result<(), Error> {
        if self.states.iter().any(|s| s.name == name) {
            return Ok(());
        }
        let hint = did_you_mean(name, self.states.iter().map(|s| s.name.as_str()));
        Err(Error::model(format!("{what}: '{name}' is not a state.{hint}")).about(name))
    }
}
