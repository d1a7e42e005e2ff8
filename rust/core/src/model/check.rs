//! Whether a model is complete.

use std::collections::HashSet;
use std::sync::Arc;

use super::{Model, TIME, place};
use crate::condition::End;
use crate::error::{Error, did_you_mean};
use crate::expr::Expr;
use crate::noise::Scale;

impl Model {
    /// Checks that the model is complete and sound, however its fields were filled.
    ///
    /// # Errors
    /// For no states or outputs, a state without equation, an undeclared symbol, a parameter that appears in no
    /// equation; duplicate names, starts outside bounds and other invalid numbers, delays of an unknown
    /// input, and invalid noise.
    pub fn check(&self) -> Result<(), Error> {
        let fail =
            |text: String| Err(Error::model(format!("model '{}': {text}", self.name)).about(&self.name));
        if self.states.is_empty() {
            return fail("it has no states; declare at least one".into());
        }
        if self.outputs.is_empty() {
            return fail("it has no outputs; declare what is measured with outputs(...)".into());
        }
        for state in &self.states {
            if self.dynamics_of(&state.name).is_none() {
                return fail(format!("state '{0}' has no equation; give dynamics({0}=...)", state.name));
            }
        }
        self.check_declared()?;
        let mut known: HashSet<&str> = HashSet::from([TIME]);
        known.extend(self.states.iter().chain(&self.inputs).map(|v| v.name.as_str()));
        known.extend(self.parameters.iter().map(|p| p.name.as_str()));
        let kinds = [
            ("quantity", "", &self.quantities),
            ("equation of", "'", &self.dynamics),
            ("output", "", &self.outputs),
        ];
        for (kind, prime, equations) in kinds {
            for equation in equations {
                if let Some(number) = not_finite(&equation.expr) {
                    let (name, place) = (&equation.name, equation.place());
                    return fail(format!("{kind} {name}{prime}{place}: it contains the constant {number}"));
                }
                if let Some(text) = self.wrong_constant(&equation.expr) {
                    return fail(format!("{kind} {}{prime}{}: {text}", equation.name, equation.place()));
                }
                for symbol in equation.expr.symbols() {
                    if !known.contains(&*symbol) {
                        let hint = did_you_mean(&symbol, known.iter().copied());
                        let (name, place) = (&equation.name, equation.place());
                        return fail(format!(
                            "{kind} {name}{prime}{place}: symbol '{symbol}' is not declared in this model.{hint}"
                        ));
                    }
                }
                if kind == "quantity" {
                    known.insert(&equation.name);
                }
            }
        }
        for c in &self.conditions {
            let place = place(c.source.as_deref());
            let periodic =
                |symbol: &str| c.end == End::Periodic && !self.parameters.iter().any(|p| p.name == symbol);
            if let Some(text) = self.wrong_constant(&c.expr) {
                return fail(format!("condition of {}{place}: {text}", c.state));
            }
            for symbol in c.expr.symbols() {
                if !known.contains(&*symbol) {
                    let hint = did_you_mean(&symbol, known.iter().copied());
                    return fail(format!(
                        "condition of {}{place}: symbol '{symbol}' is not declared in this model.{hint}",
                        c.state
                    ));
                }
                if periodic(&symbol) {
                    return fail(format!(
                        "periodic condition of {}{place}: the difference between the ends may depend on parameters, \
                         not on '{symbol}'",
                        c.state
                    ));
                }
            }
        }
        for (output, scale) in &self.noise.scales {
            if let Scale::Expression(expr) = scale {
                self.check_scale(output, expr)?;
            }
        }
        let mut used = self.used();
        used.extend(self.delays.parameters().into_iter().map(Arc::from));
        for parameter in &self.parameters {
            if !used.contains(parameter.name.as_str()) {
                return fail(format!(
                    "parameter '{}' appears in no equation; use it, or take it out of the model",
                    parameter.name
                ));
            }
        }
        Ok(())
    }

    /// Checks an expression for the standard deviation of an output's noise.
    pub(crate) fn check_scale(&self, output: &str, expr: &Expr) -> Result<(), Error> {
        let variables = self.states.iter().chain(&self.inputs).map(|v| v.name.as_str());
        let known: Vec<&str> = variables
            .chain(self.parameters.iter().map(|p| p.name.as_str()))
            .chain(self.quantities.iter().map(|q| q.name.as_str()))
            .chain([TIME])
            .collect();
        let start = format!("model '{}': the noise of output {output}", self.name);
        if let Some(number) = not_finite(expr) {
            return Err(Error::model(format!("{start}: it contains the constant {number}")));
        }
        if let Some(text) = self.wrong_constant(expr) {
            return Err(Error::model(format!("{start}: {text}")));
        }
        match expr.symbols().iter().find(|s| !known.contains(&&***s)) {
            Some(symbol) => {
                let hint = did_you_mean(symbol, known.iter().copied());
                Err(Error::model(format!("{start}: symbol '{symbol}' is not declared in this model.{hint}"))
                    .about(symbol))
            }
            None => Ok(()),
        }
    }

    /// Says of a named constant in an expression that it is not one of this model, or has another value in it.
    fn wrong_constant(&self, expr: &Expr) -> Option<String> {
        expr.constants().iter().find_map(|(name, value)| {
            let Some(own) = self.constants.iter().find(|c| c.name == **name) else {
                let hint = did_you_mean(name, self.constants.iter().map(|c| c.name.as_str()));
                return Some(format!("constant '{name}' is not declared in this model.{hint}"));
            };
            (own.value.to_bits() != value.to_bits()).then(|| {
                format!("constant '{name}' is {value} here, but was declared as {} in this model", own.value)
            })
        })
    }

    /// Symbols that dynamics, outputs and noise depend on, through quantities too.
    fn used(&self) -> HashSet<Arc<str>> {
        let equations = self.dynamics.iter().chain(&self.outputs);
        let mut used: HashSet<Arc<str>> = equations.flat_map(|e| e.expr.symbols()).collect();
        used.extend(self.conditions.iter().flat_map(|c| c.expr.symbols()));
        for (_, scale) in &self.noise.scales {
            if let Scale::Expression(expr) = scale {
                used.extend(expr.symbols());
            }
        }
        for quantity in self.quantities.iter().rev() {
            if used.contains(quantity.name.as_str()) {
                used.extend(quantity.expr.symbols());
            }
        }
        used
    }
}

/// The first constant of an expression that is not finite.
fn not_finite(expr: &Expr) -> Option<f64> {
    let mut found = None;
    expr.visit(|e| found = found.or(e.as_constant().filter(|c| !c.is_finite())));
    found
}
