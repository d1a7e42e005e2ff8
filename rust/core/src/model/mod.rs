//! A model: states, inputs, parameters, quantities, state equations and outputs.
//!
//! ẋ = f(x, u, θ) (Eq. state_dynamics) and y = g(x, u, θ) (Eq. output_equations) of the paper.

mod check;
mod compiled;
mod declared;
mod delays;
mod equations;
mod kinks;
#[cfg(feature = "serde")]
mod saved;
mod scaling;

pub use crate::condition::{Condition, End};
pub use crate::constant::Constant;
pub use crate::parameter::Parameter;
pub use crate::transform::Transform;
pub use compiled::Compiled;
pub(crate) use delays::rates;
pub use delays::{Delays, LateInput, LateOutput};
pub use equations::WrittenAt;
pub use kinks::Kink;
pub use scaling::Scaling;

use crate::error::Error;
use crate::expr::Expr;
use crate::noise::NoiseModel;

/// Name of the symbol of time.
pub const TIME: &str = "time";

/// A named variable with its unit; where it starts and its bounds are a state's alone.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Variable {
    /// Name.
    pub name: String,
    /// Unit, as text; empty where unknown.
    pub unit: String,
    /// The start of the path of a state that is not measured; `None` for no declaration.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub start: Option<f64>,
    /// Lower bound of a state; `None` for none.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub lower: Option<f64>,
    /// Upper bound of a state; `None` for none.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub upper: Option<f64>,
}

impl Variable {
    /// A variable without start and bounds.
    pub fn new(name: &str, unit: &str) -> Self {
        Variable { name: name.to_owned(), unit: unit.to_owned(), ..Variable::default() }
    }

    /// Lower and upper bound.
    pub fn bounds(&self) -> (f64, f64) {
        (self.lower.unwrap_or(f64::NEG_INFINITY), self.upper.unwrap_or(f64::INFINITY))
    }

    /// Returns an error in its numbers, if there is one.
    fn wrong(&self) -> Option<String> {
        let (low, high) = self.bounds();
        if low.is_nan() || high.is_nan() || low >= high || low == f64::INFINITY || high == f64::NEG_INFINITY {
            return Some(format!(
                "its bounds ({low}, {high}) are not a lower bound and a greater upper bound"
            ));
        }
        let start = self.start?;
        if !start.is_finite() {
            return Some(format!("its start {start} is not a finite number"));
        }
        (start < low || start > high)
            .then(|| format!("its start {start} lies outside its bounds ({low}, {high}); move one of them"))
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
    /// The user's line: `file:line`.
    pub source: Option<String>,
}

impl Equation {
    fn place(&self) -> String {
        place(self.source.as_deref())
    }
}

/// Returns the line of a declaration, as messages show it.
fn place(source: Option<&str>) -> String {
    source.map(|s| format!(" ({s})")).unwrap_or_default()
}

fn valid_name(name: &str) -> bool {
    name.chars().next().is_some_and(|c| c.is_alphabetic() || c == '_')
        && name.chars().all(|c| c.is_alphanumeric() || c == '_')
}

/// A model. See the [module](self).
///
/// Declaring a variable gives its symbol; equations are written with Rust's operators and the methods of
/// [`Expr`]. Messages name the line of an equation.
///
/// ```
/// use phugoid::{Model, Parameter};
///
/// let mut m = Model::new("short period");
/// let (w, q) = (m.state("w", "m/s")?, m.state("q", "rad/s")?);
/// let de = m.input("de", "rad")?;
/// let zw = m.parameter(Parameter::new("Zw", 0.0))?;
/// let mw = m.parameter(Parameter::new("Mw", -0.1).upper(0.0))?;
/// let mde = m.parameter(Parameter::new("Mde", -8.0).prior((-10.0, 5.0)))?;
/// let lift = m.quantity("lift", zw * &w)?; // enters wherever it is used
/// m.equation("w", &lift + 44.6 * &q)?;
/// m.equation("q", mw * &w + mde * de)?;
/// m.output("q", q, "")?; // in the unit of the state
/// m.output("az", lift, "m/s²")?;
/// m.check()?;
///
/// let error = m.equation("theta", w.sin()).unwrap_err();
/// assert!(error.to_string().ends_with("'theta' is not a state."), "{error}"); // behind the file and line of the equation
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
    /// Known constants, in order.
    pub constants: Vec<Constant>,
    /// Named intermediates; a term added to one enters wherever it is used.
    pub quantities: Vec<Equation>,
    /// State equations, one a state, in any order.
    pub dynamics: Vec<Equation>,
    /// Outputs, in order.
    pub outputs: Vec<Equation>,
    /// Conditions on the ends of each record.
    pub conditions: Vec<Condition>,
    /// Inputs and outputs that are late.
    pub delays: Delays,
    /// The noise model, unless an estimation is given another.
    pub noise: NoiseModel,
}

impl Model {
    /// An empty model.
    pub fn new(name: &str) -> Self {
        Model { name: name.to_owned(), ..Model::default() }
    }

    fn claim(&self, kind: &str, name: &str) -> Result<(), Error> {
        if !valid_name(name) {
            return Err(Error::model(format!(
                "{kind} '{name}': a name starts with a letter and contains only letters, digits and underscores"
            ))
            .about(name));
        }
        if name == TIME {
            return Err(Error::model(format!("{kind} 'time': this name is the symbol of time (model.time)")));
        }
        let taken = [
            ("state", self.states.iter().any(|v| v.name == name)),
            ("input", self.inputs.iter().any(|v| v.name == name)),
            ("parameter", self.parameters.iter().any(|v| v.name == name)),
            ("constant", self.constants.iter().any(|v| v.name == name)),
            ("quantity", self.quantities.iter().any(|v| v.name == name)),
        ];
        match taken.iter().find(|t| t.1) {
            Some((other, _)) => {
                Err(Error::model(format!("{kind} '{name}': there is a {other} of this name already"))
                    .about(name))
            }
            None => Ok(()),
        }
    }

    /// Declares a state; returns its symbol.
    pub fn state(&mut self, name: &str, unit: &str) -> Result<Expr, Error> {
        self.state_within(Variable::new(name, unit))
    }

    /// Declares a state with a start or bounds: its path starts there where no output measures it, and stays within
    /// the bounds at the points of the mesh (collocation), where segments start (multiple shooting), or at the first
    /// sample (single shooting).
    pub fn state_within(&mut self, state: Variable) -> Result<Expr, Error> {
        self.claim("state", &state.name)?;
        let name = &state.name;
        if let Some(wrong) = state.wrong() {
            return Err(Error::model(format!("state '{name}': {wrong}")).about(name));
        }
        let symbol = Expr::symbol(name);
        self.states.push(state);
        Ok(symbol)
    }

    /// Declares an input; returns its symbol.
    pub fn input(&mut self, name: &str, unit: &str) -> Result<Expr, Error> {
        self.claim("input", name)?;
        self.inputs.push(Variable::new(name, unit));
        Ok(Expr::symbol(name))
    }

    /// Declares a parameter; returns its symbol.
    pub fn parameter(&mut self, parameter: Parameter) -> Result<Expr, Error> {
        self.claim("parameter", &parameter.name)?;
        let name = &parameter.name;
        if let Some(wrong) = parameter.wrong() {
            return Err(Error::model(format!("parameter '{name}': {wrong}")).about(name));
        }
        let symbol = Expr::symbol(name);
        self.parameters.push(parameter);
        Ok(symbol)
    }

    /// Declares a known constant; returns its value under its name, for the equations.
    ///
    /// ```
    /// use phugoid::{Constant, Model};
    ///
    /// let mut m = Model::new("fall");
    /// let v = m.state("v", "m/s")?;
    /// let g = m.constant(Constant::new("g", 9.80665).unit("m/s²").meaning("gravity"))?;
    /// m.equation("v", -g)?;
    /// m.output("v", v, "")?;
    /// assert_eq!(m.dynamics[0].expr.to_string(), "-g");
    /// # Ok::<(), phugoid::Error>(())
    /// ```
    ///
    /// # Errors
    /// When the name is taken, or is none, and for a value that is not finite.
    pub fn constant(&mut self, constant: Constant) -> Result<Expr, Error> {
        self.claim("constant", &constant.name)?;
        let name = &constant.name;
        if let Some(wrong) = constant.wrong() {
            return Err(Error::model(format!("constant '{name}': {wrong}")).about(name));
        }
        let symbol = Expr::named(name, constant.value);
        self.constants.push(constant);
        Ok(symbol)
    }

    /// The symbol of time, s.
    pub fn time(&self) -> Expr {
        Expr::symbol(TIME)
    }

    /// The state equation of a state.
    pub fn dynamics_of(&self, state: &str) -> Option<&Equation> {
        self.dynamics.iter().find(|e| e.name == state)
    }
}
