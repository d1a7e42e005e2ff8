//! Models as JSON text.

use serde::{Deserialize, Serialize};

use super::{Delays, Equation, LateInput, LateOutput, Model, Parameter, Variable};
use crate::condition::{Condition, End};
use crate::constant::Constant;
use crate::error::Error;
use crate::expr::Expr;
use crate::expr::pool::Pool;
use crate::noise::SavedNoise;
use crate::pairs::Pairs;
use crate::transform::Transform;

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
    /// Older releases, which do not know these, read the same numbers without names.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    constants: Vec<Constant>,
    quantities: Vec<SavedEquation>,
    dynamics: Vec<SavedEquation>,
    outputs: Vec<SavedEquation>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    conditions: Vec<SavedCondition>,
    expressions: Pool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    noise: Option<SavedNoise>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    delays: Option<SavedDelays>,
}

/// Late inputs by name: the input and the parameter; late outputs: the parameter.
#[derive(Serialize, Deserialize)]
struct SavedDelays {
    #[serde(default)]
    inputs: Pairs<(String, String)>,
    #[serde(default)]
    outputs: Pairs<String>,
}

impl SavedDelays {
    fn of(delays: &Delays) -> Option<SavedDelays> {
        let input = |l: &LateInput| (l.name.clone(), (l.of.clone(), l.by.clone()));
        let output = |l: &LateOutput| (l.output.clone(), l.by.clone());
        let (inputs, outputs) = (&delays.inputs, &delays.outputs);
        (!delays.is_empty()).then(|| SavedDelays {
            inputs: inputs.iter().map(input).collect(),
            outputs: outputs.iter().map(output).collect(),
        })
    }

    /// Declares the delays; the symbols of delayed inputs are declared as inputs already.
    fn declare(self, model: &mut Model) -> Result<(), Error> {
        for (name, (of, by)) in self.inputs.0 {
            let known = |name: &str| model.inputs.iter().any(|v| v.name == name);
            let parameter = model.parameters.iter().any(|p| p.name == by);
            if !(known(&name) && known(&of) && parameter) {
                return Err(Error::model(format!(
                    "saved model: the delay of '{of}' by '{by}', called '{name}', is not one of its inputs by one of \
                     its parameters"
                )).about(&of).about(&by).about(&name));
            }
            model.delays.inputs.push(LateInput { name, of, by });
        }
        if let Some(late) = model.delays.inputs.iter().find(|l| model.delays.input(&l.of).is_some()) {
            return Err(Error::model(format!(
                "saved model: '{}' delays '{}', which is a delayed input itself; delay the measured input, by one \
                 parameter for the whole delay",
                late.name, late.of
            )).about(&late.name).about(&late.of));
        }
        self.outputs.0.iter().try_for_each(|(output, by)| model.sensor_delay(output, &Expr::symbol(by)))
    }
}

#[derive(Serialize, Deserialize)]
struct SavedCondition {
    end: End,
    state: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    source: Option<String>,
}

const FORMAT: &str = "phugoid-model";
/// Models with conditions, with local or transformed parameters are of version 2, those with bounds of states of
/// version 3: older releases would read them as other models.
const VERSION: u32 = 3;

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
        let within = self.states.iter().any(|s| s.lower.is_some() || s.upper.is_some());
        let old = self.conditions.is_empty() && self.parameters.iter().all(plain);
        let condition =
            |c: &Condition| SavedCondition { end: c.end, state: c.state.clone(), source: c.source.clone() };
        let saved = SavedModel {
            format: FORMAT.into(),
            version: match (within, old) {
                (true, _) => VERSION,
                (false, true) => 1,
                (false, false) => 2,
            },
            name: self.name.clone(),
            states: self.states.clone(),
            inputs: self.inputs.clone(),
            parameters: self.parameters.clone(),
            constants: self.constants.clone(),
            quantities: save(&self.quantities),
            dynamics: save(&self.dynamics),
            outputs: save(&self.outputs),
            conditions: self.conditions.iter().map(condition).collect(),
            expressions: Pool::new(all),
            noise: SavedNoise::of(&self.noise),
            delays: SavedDelays::of(&self.delays),
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
    /// m.equation("x", -(rate * &x))?;
    /// m.output("x", x, "")?;
    ///
    /// let text = m.to_json(); // or std::fs::read_to_string("model.json")
    /// assert_eq!(Model::from_json(&text)?, m);
    /// # Ok::<(), phugoid::Error>(())
    /// ```
    ///
    /// # Errors
    /// For text that is no saved model, or one of a later version.
    pub fn from_json(text: &str) -> Result<Model, Error> {
        let fail = |what: String| Error::model(format!("saved model: {what}"));
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
            model.state_within(v.clone())?;
        }
        for v in &saved.inputs {
            model.input(&v.name, &v.unit)?;
        }
        for p in saved.parameters {
            model.parameter(p)?;
        }
        for c in saved.constants {
            model.constant(c)?;
        }
        for (e, expr) in saved.quantities.into_iter().zip(exprs.by_ref()) {
            model.written_at(e.source).quantity(&e.name, expr)?;
        }
        for (e, expr) in saved.dynamics.into_iter().zip(exprs.by_ref()) {
            model.written_at(e.source).equation(&e.name, expr)?;
        }
        for (e, expr) in saved.outputs.into_iter().zip(exprs.by_ref()) {
            model.written_at(e.source).output(&e.name, expr, &e.unit)?;
        }
        for (c, expr) in saved.conditions.into_iter().zip(exprs) {
            model.written_at(c.source).condition(c.end, &c.state, expr)?;
        }
        if let Some(delays) = saved.delays {
            delays.declare(&mut model)?;
        }
        if let Some(noise) = saved.noise {
            let outputs: Vec<&str> = model.outputs.iter().map(|o| o.name.as_str()).collect();
            model.noise = noise.declared(&outputs).map_err(fail)?;
        }
        Ok(model)
    }
}
