//! Inputs and outputs that are late.
//!
//! A delay moves a signal along its samples, so the structure of the problem would change with it. Instead signals are
//! moved by a base τ₀, and what is left, d = τ − τ₀, enters by Taylor's series: u(t − τ) = u₀ − d u̇₀ + ½d² ü₀ with
//! the derivatives of the interpolated input; at a sensor the state is x − d f + ½d² ḟ. First and second derivatives
//! with respect to τ are exact at d = 0. The problem is solved, the base moved to the estimate, and so on until
//! nothing is left ([`Estimation`](crate::Estimation) does that): there the optimum, and the standard errors, are
//! those of the delayed model itself.

use std::collections::HashMap;
use std::sync::Arc;

use super::{Equation, Model, TIME, Variable};
use crate::error::{Error, did_you_mean};
use crate::expr::Expr;

/// An input u(t − τ) that acts late.
#[derive(Clone, Debug, PartialEq)]
pub struct LateInput {
    /// Its name among the model's inputs.
    pub name: String,
    /// The input that it is, τ before.
    pub of: String,
    /// The parameter τ, s.
    pub by: String,
}

/// An output that is measured late, z(t) = y(t − τ).
#[derive(Clone, Debug, PartialEq)]
pub struct LateOutput {
    /// The output.
    pub output: String,
    /// The parameter τ, s.
    pub by: String,
}

/// The delays of a model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Delays {
    /// Late inputs.
    pub inputs: Vec<LateInput>,
    /// Late outputs.
    pub outputs: Vec<LateOutput>,
}

impl Delays {
    /// Whether nothing is late.
    pub fn is_empty(&self) -> bool {
        self.inputs.is_empty() && self.outputs.is_empty()
    }

    /// The parameters that are delays, each once.
    pub fn parameters(&self) -> Vec<&str> {
        let mut found: Vec<&str> = Vec::new();
        let all = self.inputs.iter().map(|l| &l.by).chain(self.outputs.iter().map(|l| &l.by));
        for name in all {
            if !found.contains(&name.as_str()) {
                found.push(name);
            }
        }
        found
    }

    /// The late input of a name.
    pub fn input(&self, name: &str) -> Option<&LateInput> {
        self.inputs.iter().find(|l| l.name == name)
    }

    /// The parameter by which an output is late.
    pub fn output(&self, name: &str) -> Option<&str> {
        self.outputs.iter().find(|l| l.output == name).map(|l| l.by.as_str())
    }
}

/// Names of the first and the second derivative of an input with respect to time.
pub(crate) fn rates(input: &str) -> [String; 2] {
    [format!("{input}_rate"), format!("{input}_bend")]
}

impl Model {
    /// The symbol of an input that acts late, u(t − τ), with the parameter τ (s) estimated. Before the first sample
    /// the input is taken as constant; a delay below zero is a lead.
    ///
    /// ```
    /// use phugoid::{Model, Parameter};
    ///
    /// let mut m = Model::new("pitch");
    /// let (q, de) = (m.state("q", "rad/s")?, m.input("de", "rad")?);
    /// let tau = m.parameter(Parameter::new("tau", 0.0).lower(0.0).upper(0.5))?;
    /// let de_late = m.delay(&de, &tau, "de_late")?;
    /// m.equation("q", -2.0 * &q - 5.0 * de_late)?;
    /// m.output("q", q, "")?;
    /// assert_eq!(m.input_names(), ["de"]); // what records must have
    /// # Ok::<(), phugoid::Error>(())
    /// ```
    ///
    /// # Errors
    /// For other expressions than the symbols of an input and a parameter, and for a name that is taken.
    pub fn delay(&mut self, input: &Expr, by: &Expr, name: &str) -> Result<Expr, Error> {
        let of = self.symbol_of(input, &self.input_names(), "delay", "an input")?;
        let by = self.symbol_of(by, &self.parameter_names(), &format!("delay of {of}"), "a parameter")?;
        let unit = self.inputs.iter().find(|v| v.name == of).map_or(String::new(), |v| v.unit.clone());
        let symbol = self.input(name, &unit)?;
        self.delays.inputs.push(LateInput { name: name.to_owned(), of, by });
        Ok(symbol)
    }

    /// Says that an output is measured late, z(t) = y(t − τ), τ a parameter (s).
    ///
    /// # Errors
    /// For a name that is no output, and another expression than the symbol of a parameter.
    pub fn sensor_delay(&mut self, output: &str, by: &Expr) -> Result<(), Error> {
        let known = || self.outputs.iter().map(|o| o.name.as_str());
        if !known().any(|o| o == output) {
            let hint = did_you_mean(output, known());
            return Err(
                Error::model(format!("sensor_delay: '{output}' is not an output.{hint}")).about(output)
            );
        }
        let place = format!("sensor_delay of {output}");
        let by = self.symbol_of(by, &self.parameter_names(), &place, "a parameter")?;
        self.delays.outputs.retain(|l| l.output != output);
        self.delays.outputs.push(LateOutput { output: output.to_owned(), by });
        Ok(())
    }

    fn symbol_of(&self, expr: &Expr, known: &[&str], place: &str, what: &str) -> Result<String, Error> {
        match expr.as_symbol().filter(|s| known.contains(s)) {
            Some(symbol) => Ok(symbol.to_owned()),
            None => Err(Error::model(format!(
                "{place}: give the symbol of {what} of this model, not '{}'",
                expr.brief()
            ))),
        }
    }

    /// Names of the inputs that records must have, in order: late ones follow from these.
    pub fn input_names(&self) -> Vec<&str> {
        let names = self.inputs.iter().map(|v| v.name.as_str());
        names.filter(|name| self.delays.input(name).is_none()).collect()
    }

    fn parameter_names(&self) -> Vec<&str> {
        self.parameters.iter().map(|p| p.name.as_str()).collect()
    }

    /// The model without delays, for data that were moved by a base (s) of each parameter that is one: parameters
    /// are the same, but delays stay within `reach` of their base. Inputs are followed by their derivatives
    /// ([`rates`]), where these occur.
    pub fn at_delays(&self, base: &HashMap<&str, f64>, reach: f64) -> Model {
        let rest = |tau: &str| Expr::symbol(tau) - base[tau];
        let late: HashMap<Arc<str>, Expr> = self
            .delays
            .inputs
            .iter()
            .map(|l| (l.name.as_str().into(), moved(&l.name, &rest(&l.by))))
            .collect();
        let mut model = Model { delays: Delays::default(), ..self.clone() };
        let equations = model.quantities.iter_mut().chain(&mut model.dynamics);
        equations.for_each(|e| e.expr = e.expr.substitute(&late));
        model.conditions.iter_mut().for_each(|c| c.expr = c.expr.substitute(&late));
        let (f, g) = self.expanded();
        let slopes: HashMap<&str, &Expr> = self
            .states
            .iter()
            .filter(|s| self.dynamics_of(&s.name).is_some())
            .map(|s| s.name.as_str())
            .zip(&f)
            .collect();
        for (output, whole) in model.outputs.iter_mut().zip(&g) {
            output.expr = match self.delays.output(&output.name) {
                Some(tau) => self.earlier(whole, &rest(tau), &slopes, &late, &rest),
                None => output.expr.substitute(&late),
            };
        }
        for p in model.parameters.iter_mut() {
            if let Some(at) = base.get(p.name.as_str()) {
                let low = p.lower.unwrap_or(f64::NEG_INFINITY).max(at - reach);
                let high = p.upper.unwrap_or(f64::INFINITY).min(at + reach);
                let finite = |b: f64| b.is_finite().then_some(b);
                (p.lower, p.upper, p.start) = (finite(low), finite(high), at.max(low).min(high));
            }
        }
        let all: Vec<&Equation> =
            model.quantities.iter().chain(&model.dynamics).chain(&model.outputs).collect();
        let mut used: std::collections::BTreeSet<Arc<str>> =
            all.iter().flat_map(|e| e.expr.symbols()).collect();
        used.extend(model.conditions.iter().flat_map(|c| c.expr.symbols()));
        for input in &self.inputs {
            for (name, unit) in rates(&input.name).into_iter().zip(["s", "s²"]) {
                if used.contains(name.as_str()) {
                    let unit =
                        if input.unit.is_empty() { String::new() } else { format!("{}/{unit}", input.unit) };
                    model.inputs.push(Variable { name, unit, ..Variable::default() });
                }
            }
        }
        model
    }

    /// An output, quantities put in, as it was a little earlier: states by the equations, inputs by their rates.
    fn earlier(
        &self,
        g: &Expr,
        by: &Expr,
        slopes: &HashMap<&str, &Expr>,
        late: &HashMap<Arc<str>, Expr>,
        rest: &dyn Fn(&str) -> Expr,
    ) -> Expr {
        let mut at: HashMap<Arc<str>, Expr> = HashMap::from([(TIME.into(), Expr::symbol(TIME) - by)]);
        for input in &self.inputs {
            let by = match self.delays.input(&input.name) {
                Some(own) => by + rest(&own.by),
                None => by.clone(),
            };
            at.insert(input.name.as_str().into(), moved(&input.name, &by));
        }
        let now = |e: &Expr| e.substitute(late);
        for (state, right) in slopes {
            let mut bend = now(&right.derivative(TIME));
            for symbol in right.symbols() {
                if let Some(slope) = slopes.get(&*symbol) {
                    bend = bend + now(&right.derivative(&symbol)) * now(slope);
                } else if self.inputs.iter().any(|v| *v.name == *symbol) {
                    let [rate, of_rate] = rates(&symbol).map(|name| Expr::symbol(&name));
                    let rate = match self.delays.input(&symbol) {
                        Some(own) => rate - rest(&own.by) * of_rate,
                        None => rate,
                    };
                    bend = bend + now(&right.derivative(&symbol)) * rate;
                }
            }
            let then = Expr::symbol(state) - by * now(right) + 0.5 * by * by * bend;
            at.insert((*state).into(), then);
        }
        g.substitute(&at)
    }
}

/// A signal earlier by a little, by its derivatives.
fn moved(name: &str, by: &Expr) -> Expr {
    let [rate, bend] = rates(name).map(|name| Expr::symbol(&name));
    Expr::symbol(name) - by * rate + 0.5 * by * by * bend
}
