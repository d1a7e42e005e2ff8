//! A model: states, inputs, parameters, quantities, state equations and outputs.
//!
//! ẋ = f(x, u, θ) (Eq. state_dynamics) and y = g(x, u, θ) (Eq. output_equations) of the paper.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::condition::{Condition, End};
use crate::error::{Error, did_you_mean};
use crate::expr::Expr;
use crate::expr::graph::{Graph, Id};
use crate::expr::pool::Pool;
use crate::transform::Transform;

/// Name of the symbol of time.
pub const TIME: &str = "time";

/// A named variable with its unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Variable {
    /// Name.
    pub name: String,
    /// Unit, as text; empty where unknown.
    pub unit: String,
}

/// An unknown parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name.
    pub name: String,
    /// Unit, as text.
    pub unit: String,
    /// Starting value.
    pub start: f64,
    /// Lower bound; `None` for none.
    pub lower: Option<f64>,
    /// Upper bound; `None` for none.
    pub upper: Option<f64>,
    /// Mean and standard deviation of a Gaussian prior.
    pub prior: Option<(f64, f64)>,
    /// Whether it is held at its start.
    pub fixed: bool,
    /// Whether each experiment has its own value: biases, wind.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub local: bool,
    /// How a solver sees it.
    #[serde(default, skip_serializing_if = "is_none")]
    pub transform: Transform,
}

fn is_none(transform: &Transform) -> bool {
    *transform == Transform::None
}

impl Parameter {
    /// A free parameter that starts at a value.
    pub fn new(name: &str, start: f64) -> Self {
        let name = name.to_owned();
        Parameter {
            name,
            unit: String::new(),
            start,
            lower: None,
            upper: None,
            prior: None,
            fixed: false,
            local: false,
            transform: Transform::None,
        }
    }
}

/// A named equation: quantity, state equation or output.
#[derive(Clone, Debug, PartialEq)]
pub struct Equation {
    /// Name of the quantity, state or output.
    pub name: String,
    /// Unit of an output.
    pub unit: String,
    /// Right-hand side.
    pub expr: Expr,
    /// Where the user wrote it: `file:line`.
    pub source: Option<String>,
}

impl Equation {
    fn place(&self) -> String {
        self.source.as_ref().map(|s| format!(" ({s})")).unwrap_or_default()
    }
}

/// A model. See the [module](self).
///
/// Declaring a variable gives its symbol; equations are written with Rust's operators and the methods of
/// [`Expr`]. The last argument of an equation is where it was written, `file:line`, for messages.
///
/// ```
/// use phugoid::{Model, Parameter};
///
/// let mut m = Model::new("short period");
/// let (w, q) = (m.state("w", "m/s")?, m.state("q", "rad/s")?);
/// let de = m.input("de", "rad")?;
/// let zw = m.parameter(Parameter::new("Zw", 0.0))?;
/// let mw = m.parameter(Parameter { upper: Some(0.0), ..Parameter::new("Mw", -0.1) })?;
/// let mde = m.parameter(Parameter { prior: Some((-10.0, 5.0)), ..Parameter::new("Mde", -8.0) })?;
/// let lift = m.quantity("lift", zw * &w, None)?; // enters wherever it is used
/// m.equation("w", &lift + 44.6 * &q, None)?;
/// m.equation("q", mw * &w + mde * de, Some("aircraft.rs:12".into()))?;
/// m.output("q", q, "", None)?; // in the unit of the state
/// m.output("az", lift, "m/s²", None)?;
/// m.check()?;
///
/// let error = m.equation("theta", w.sin(), None).unwrap_err();
/// assert_eq!(error.to_string(), "state equation: 'theta' is not a state.");
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    /// Title.
    pub name: String,
    /// States, in order.
    pub states: Vec<Variable>,
    /// Inputs, in order.
    pub inputs: Vec<Variable>,
    /// Parameters, in order.
    pub parameters: Vec<Parameter>,
    /// Named intermediates; a term added to one enters wherever it is used.
    pub quantities: Vec<Equation>,
    /// State equations, one a state, in any order.
    pub dynamics: Vec<Equation>,
    /// Outputs, in order.
    pub outputs: Vec<Equation>,
    /// Conditions on the ends of each record.
    pub conditions: Vec<Condition>,
}

/// A model's expressions in one graph.
#[derive(Clone, Debug)]
pub struct Compiled {
    /// The graph.
    pub graph: Graph,
    /// Time and inputs: the data that f and g see.
    pub data: Vec<Id>,
    /// State symbols.
    pub states: Vec<Id>,
    /// Parameter symbols.
    pub parameters: Vec<Id>,
    /// Right-hand sides f, in the order of the states.
    pub dynamics: Vec<Id>,
    /// Outputs g.
    pub outputs: Vec<Id>,
    /// Right-hand sides of the conditions.
    pub conditions: Vec<Id>,
}

impl Model {
    /// An empty model.
    pub fn new(name: &str) -> Self {
        Model { name: name.to_owned(), ..Model::default() }
    }

    fn claim(&self, kind: &str, name: &str) -> Result<(), Error> {
        let valid = name.chars().next().is_some_and(|c| c.is_alphabetic() || c == '_')
            && name.chars().all(|c| c.is_alphanumeric() || c == '_');
        if !valid {
            return Err(Error::Model(format!(
                "{kind} '{name}': a name starts with a letter and holds letters, digits and underscores only"
            )));
        }
        if name == TIME {
            return Err(Error::Model(format!("{kind} 'time': this name is the symbol of time (model.time)")));
        }
        let taken = [
            ("state", self.states.iter().any(|v| v.name == name)),
            ("input", self.inputs.iter().any(|v| v.name == name)),
            ("parameter", self.parameters.iter().any(|v| v.name == name)),
            ("quantity", self.quantities.iter().any(|v| v.name == name)),
        ];
        match taken.iter().find(|t| t.1) {
            Some((other, _)) => {
                Err(Error::Model(format!("{kind} '{name}': there is a {other} of this name already")))
            }
            None => Ok(()),
        }
    }

    /// Declares a state; returns its symbol.
    pub fn state(&mut self, name: &str, unit: &str) -> Result<Expr, Error> {
        self.claim("state", name)?;
        self.states.push(Variable { name: name.to_owned(), unit: unit.to_owned() });
        Ok(Expr::symbol(name))
    }

    /// Declares an input; returns its symbol.
    pub fn input(&mut self, name: &str, unit: &str) -> Result<Expr, Error> {
        self.claim("input", name)?;
        self.inputs.push(Variable { name: name.to_owned(), unit: unit.to_owned() });
        Ok(Expr::symbol(name))
    }

    /// Declares a parameter; returns its symbol.
    pub fn parameter(&mut self, parameter: Parameter) -> Result<Expr, Error> {
        self.claim("parameter", &parameter.name)?;
        let Parameter { name, start, lower, upper, prior, .. } = &parameter;
        let (low, high) = (lower.unwrap_or(f64::NEG_INFINITY), upper.unwrap_or(f64::INFINITY));
        let wrong = if !start.is_finite() {
            Some(format!("its start {start} is not a finite number"))
        } else if low.is_nan() || high.is_nan() || low > high {
            Some(format!("its bounds ({low}, {high}) are not a lower and an upper bound"))
        } else if *start < low || *start > high {
            Some(format!("its start {start} lies outside its bounds ({low}, {high}); move one of them"))
        } else if parameter.transform == Transform::Log && *start <= 0.0 {
            Some(format!(
                "its start {start} has no logarithm; a parameter with transform \"log\" is positive"
            ))
        } else if let Transform::Scale(scale) = parameter.transform
            && !(scale > 0.0 && scale.is_finite())
        {
            Some(format!("its scale {scale} is not a positive number"))
        } else {
            prior.filter(|(mean, std)| !mean.is_finite() || !std.is_finite() || *std <= 0.0).map(
                |(mean, std)| {
                    format!("its prior ({mean}, {std}) is not a mean and a positive standard deviation")
                },
            )
        };
        if let Some(wrong) = wrong {
            return Err(Error::Model(format!("parameter '{name}': {wrong}")));
        }
        let symbol = Expr::symbol(name);
        self.parameters.push(parameter);
        Ok(symbol)
    }

    /// The symbol of time, s.
    pub fn time(&self) -> Expr {
        Expr::symbol(TIME)
    }

    /// Names an intermediate; returns its symbol.
    pub fn quantity(&mut self, name: &str, expr: Expr, source: Option<String>) -> Result<Expr, Error> {
        self.claim("quantity", name)?;
        self.quantities.push(Equation { name: name.to_owned(), unit: String::new(), expr, source });
        Ok(Expr::symbol(name))
    }

    /// Gives the state equation ẋ = `expr` of a state.
    pub fn equation(&mut self, state: &str, expr: Expr, source: Option<String>) -> Result<(), Error> {
        let place = source.as_ref().map(|s| format!(" ({s})")).unwrap_or_default();
        if !self.states.iter().any(|s| s.name == state) {
            let hint = did_you_mean(state, self.states.iter().map(|s| s.name.as_str()));
            return Err(Error::Model(format!("state equation{place}: '{state}' is not a state.{hint}")));
        }
        if self.dynamics.iter().any(|e| e.name == state) {
            return Err(Error::Model(format!("state equation{place}: '{state}' has an equation already")));
        }
        self.dynamics.push(Equation { name: state.to_owned(), unit: String::new(), expr, source });
        Ok(())
    }

    /// Declares an output.
    pub fn output(
        &mut self,
        name: &str,
        expr: Expr,
        unit: &str,
        source: Option<String>,
    ) -> Result<(), Error> {
        if self.outputs.iter().any(|e| e.name == name) {
            return Err(Error::Model(format!("output '{name}': there is an output of this name already")));
        }
        // An output that is a plain state or input has its unit.
        let unit = match expr.as_symbol() {
            Some(symbol) if unit.is_empty() => {
                let same = |v: &&Variable| v.name == symbol;
                self.states.iter().chain(&self.inputs).find(same).map_or(String::new(), |v| v.unit.clone())
            }
            _ => unit.to_owned(),
        };
        self.outputs.push(Equation { name: name.to_owned(), unit, expr, source });
        Ok(())
    }

    /// Sets a condition on an end of each record: the state equals `expr` there, or differs by it between
    /// the ends. States without a condition are free at both ends.
    pub fn condition(
        &mut self,
        end: End,
        state: &str,
        expr: Expr,
        source: Option<String>,
    ) -> Result<(), Error> {
        let place = source.as_ref().map(|s| format!(" ({s})")).unwrap_or_default();
        if !self.states.iter().any(|s| s.name == state) {
            let hint = did_you_mean(state, self.states.iter().map(|s| s.name.as_str()));
            return Err(Error::Model(format!("condition{place}: '{state}' is not a state.{hint}")));
        }
        if self.conditions.iter().any(|c| c.state == state && c.end == end) {
            return Err(Error::Model(format!("condition{place}: '{state}' has such a condition already")));
        }
        if self.conditions.len() == self.states.len() {
            return Err(Error::Model(format!(
                "condition{place}: {} states have {} conditions already; with more nothing is left to choose",
                self.states.len(),
                self.conditions.len()
            )));
        }
        self.conditions.push(Condition { end, state: state.to_owned(), expr, source });
        Ok(())
    }

    /// The state equation of a state.
    pub fn dynamics_of(&self, state: &str) -> Option<&Equation> {
        self.dynamics.iter().find(|e| e.name == state)
    }

    /// Checks that the model is complete.
    ///
    /// # Errors
    /// For no states or outputs, a state without equation, an undeclared symbol, or a parameter
    /// that appears in no equation.
    pub fn check(&self) -> Result<(), Error> {
        let fail = |text: String| Err(Error::Model(format!("model '{}': {text}", self.name)));
        if self.states.is_empty() {
            return fail("it has no states; declare them with states(...)".into());
        }
        if self.outputs.is_empty() {
            return fail("it has no outputs; declare what is measured with outputs(...)".into());
        }
        for state in &self.states {
            if self.dynamics_of(&state.name).is_none() {
                return fail(format!("state '{0}' has no equation; give dynamics({0}=...)", state.name));
            }
        }
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
                    return fail(format!("{kind} {name}{prime}{place}: it holds the constant {number}"));
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
            let place = c.source.as_ref().map(|s| format!(" ({s})")).unwrap_or_default();
            let periodic =
                |symbol: &str| c.end == End::Periodic && !self.parameters.iter().any(|p| p.name == symbol);
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
        let used = self.used();
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

    /// Symbols that dynamics and outputs depend on, through quantities too.
    fn used(&self) -> HashSet<Arc<str>> {
        let equations = self.dynamics.iter().chain(&self.outputs);
        let mut used: HashSet<Arc<str>> = equations.flat_map(|e| e.expr.symbols()).collect();
        used.extend(self.conditions.iter().flat_map(|c| c.expr.symbols()));
        for quantity in self.quantities.iter().rev() {
            if used.contains(quantity.name.as_str()) {
                used.extend(quantity.expr.symbols());
            }
        }
        used
    }

    /// The model's expressions in one graph, quantities put in where they are used.
    ///
    /// # Errors
    /// As [`Model::check`].
    pub fn compile(&self) -> Result<Compiled, Error> {
        self.check()?;
        let mut graph = Graph::new();
        let mut data = vec![graph.symbol(TIME)];
        data.extend(self.inputs.iter().map(|v| graph.symbol(&v.name)));
        let states = self.states.iter().map(|v| graph.symbol(&v.name)).collect();
        let parameters = self.parameters.iter().map(|p| graph.symbol(&p.name)).collect();
        let mut define: HashMap<Arc<str>, Id> = HashMap::new();
        for quantity in &self.quantities {
            let id = graph.import(&quantity.expr, &define);
            define.insert(quantity.name.as_str().into(), id);
        }
        let dynamics = self
            .states
            .iter()
            .map(|s| graph.import(&self.dynamics_of(&s.name).expect("checked").expr, &define))
            .collect();
        let outputs = self.outputs.iter().map(|e| graph.import(&e.expr, &define)).collect();
        let conditions = self.conditions.iter().map(|c| graph.import(&c.expr, &define)).collect();
        Ok(Compiled { graph, data, states, parameters, dynamics, outputs, conditions })
    }

    /// The right-hand sides with quantities put in, as expressions: f in the order of the states, then g.
    pub fn expanded(&self) -> (Vec<Expr>, Vec<Expr>) {
        let mut define: HashMap<Arc<str>, Expr> = HashMap::new();
        for quantity in &self.quantities {
            let expr = quantity.expr.substitute(&define);
            define.insert(quantity.name.as_str().into(), expr);
        }
        let expand = |e: &Equation| e.expr.substitute(&define);
        let dynamics = self.states.iter().filter_map(|s| self.dynamics_of(&s.name)).map(expand).collect();
        (dynamics, self.outputs.iter().map(expand).collect())
    }
}

/// An equation as it is saved; its expression is a root of the pool.
#[derive(Serialize, Deserialize)]
struct SavedEquation {
    name: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    unit: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    source: Option<String>,
}

#[derive(Serialize, Deserialize)]
struct SavedModel {
    format: String,
    version: u32,
    name: String,
    states: Vec<Variable>,
    inputs: Vec<Variable>,
    parameters: Vec<Parameter>,
    quantities: Vec<SavedEquation>,
    dynamics: Vec<SavedEquation>,
    outputs: Vec<SavedEquation>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    conditions: Vec<SavedCondition>,
    expressions: Pool,
}

#[derive(Serialize, Deserialize)]
struct SavedCondition {
    end: End,
    state: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    source: Option<String>,
}

const FORMAT: &str = "phugoid-model";
/// Models with conditions, with local or transformed parameters are of version 2: older releases would read
/// them as other models.
const VERSION: u32 = 2;

impl Model {
    /// The model as JSON text; [`Model::from_json`] reads it back exactly.
    pub fn to_json(&self) -> String {
        let save = |equations: &[Equation]| {
            let one = |e: &Equation| SavedEquation {
                name: e.name.clone(),
                unit: e.unit.clone(),
                source: e.source.clone(),
            };
            equations.iter().map(one).collect()
        };
        let equations = self.quantities.iter().chain(&self.dynamics).chain(&self.outputs);
        let all = equations.map(|e| &e.expr).chain(self.conditions.iter().map(|c| &c.expr));
        let plain = |p: &Parameter| !p.local && p.transform == Transform::None;
        let old = self.conditions.is_empty() && self.parameters.iter().all(plain);
        let condition =
            |c: &Condition| SavedCondition { end: c.end, state: c.state.clone(), source: c.source.clone() };
        let saved = SavedModel {
            format: FORMAT.into(),
            version: if old { 1 } else { VERSION },
            name: self.name.clone(),
            states: self.states.clone(),
            inputs: self.inputs.clone(),
            parameters: self.parameters.clone(),
            quantities: save(&self.quantities),
            dynamics: save(&self.dynamics),
            outputs: save(&self.outputs),
            conditions: self.conditions.iter().map(condition).collect(),
            expressions: Pool::new(all),
        };
        serde_json::to_string(&saved).expect("a model is plain data")
    }

    /// Reads a saved model: one of [`Model::to_json`], or one that `Model.save` of the Python package wrote.
    /// It evaluates to the same bits wherever it was saved.
    ///
    /// ```
    /// use phugoid::{Model, Parameter};
    ///
    /// let mut m = Model::new("decay");
    /// let x = m.state("x", "m")?;
    /// let rate = m.parameter(Parameter::new("rate", 0.1))?;
    /// m.equation("x", -(rate * &x), None)?;
    /// m.output("x", x, "", None)?;
    ///
    /// let text = m.to_json(); // or std::fs::read_to_string("model.json")
    /// assert_eq!(Model::from_json(&text)?, m);
    /// # Ok::<(), phugoid::Error>(())
    /// ```
    ///
    /// # Errors
    /// For text that is no saved model, or one of a later version.
    pub fn from_json(text: &str) -> Result<Model, Error> {
        let fail = |what: String| Error::Model(format!("saved model: {what}"));
        let saved: SavedModel = serde_json::from_str(text).map_err(|e| fail(e.to_string()))?;
        if saved.format != FORMAT || saved.version > VERSION {
            let (format, version) = (&saved.format, saved.version);
            return Err(fail(format!(
                "format '{format}' version {version}; this release reads {FORMAT} up to {VERSION}"
            )));
        }
        let exprs = saved.expressions.expressions().map_err(fail)?;
        let (nq, nd, ny) = (saved.quantities.len(), saved.dynamics.len(), saved.outputs.len());
        if exprs.len() != nq + nd + ny + saved.conditions.len() {
            return Err(fail("the number of expressions is not the number of equations".into()));
        }
        // Declared one by one, so that a damaged file fails as a wrong model does.
        let mut exprs = exprs.into_iter();
        let mut model = Model::new(&saved.name);
        for v in &saved.states {
            model.state(&v.name, &v.unit)?;
        }
        for v in &saved.inputs {
            model.input(&v.name, &v.unit)?;
        }
        for p in saved.parameters {
            model.parameter(p)?;
        }
        for (e, expr) in saved.quantities.into_iter().zip(exprs.by_ref()) {
            model.quantity(&e.name, expr, e.source)?;
        }
        for (e, expr) in saved.dynamics.into_iter().zip(exprs.by_ref()) {
            model.equation(&e.name, expr, e.source)?;
        }
        for (e, expr) in saved.outputs.into_iter().zip(exprs.by_ref()) {
            model.output(&e.name, expr, &e.unit, e.source)?;
        }
        for (c, expr) in saved.conditions.into_iter().zip(exprs) {
            model.condition(c.end, &c.state, expr, c.source)?;
        }
        Ok(model)
    }
}

/// The first constant of an expression that is not finite.
fn not_finite(expr: &Expr) -> Option<f64> {
    let mut found = None;
    expr.visit(|e| found = found.or(e.as_constant().filter(|c| !c.is_finite())));
    found
}
