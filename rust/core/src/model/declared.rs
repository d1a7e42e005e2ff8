//! Whether what is declared is sound, however it came into the fields of a model: names, numbers of parameters, delays.

use std::collections::HashSet;

use super::{Model, TIME, valid_name};
use crate::error::{Error, did_you_mean};

impl Model {
    /// Checks names, parameters, equations without a state, conditions, delays and noise.
    ///
    /// # Errors
    /// Names what is wrong and says what to do.
    pub(super) fn check_declared(&self) -> Result<(), Error> {
        let found = self
            .wrong_names()
            .or_else(|| self.wrong_parameters())
            .or_else(|| self.wrong_constants())
            .or_else(|| self.wrong_equations())
            .or_else(|| self.wrong_delays());
        if let Some(text) = found {
            return Err(Error::model(format!("model '{}': {text}", self.name)).about(&self.name));
        }
        self.noise.check()
    }

    fn wrong_names(&self) -> Option<String> {
        let names = (self.states.iter().map(|v| ("state", &v.name)))
            .chain(self.inputs.iter().map(|v| ("input", &v.name)))
            .chain(self.parameters.iter().map(|p| ("parameter", &p.name)))
            .chain(self.constants.iter().map(|c| ("constant", &c.name)))
            .chain(self.quantities.iter().map(|e| ("quantity", &e.name)));
        let mut seen: HashSet<&str> = HashSet::from([TIME]);
        for (kind, name) in names {
            if !valid_name(name) {
                return Some(format!(
                    "{kind} '{name}': a name starts with a letter and contains only letters, digits and underscores"
                ));
            }
            if !seen.insert(name) {
                return Some(format!("{kind} '{name}': this name is already in use; choose another"));
            }
        }
        let mut outputs = HashSet::new();
        let twice = self.outputs.iter().find(|o| !outputs.insert(o.name.as_str()))?;
        Some(format!("output '{}' is declared twice; give one another name", twice.name))
    }

    fn wrong_parameters(&self) -> Option<String> {
        self.parameters.iter().find_map(|p| Some(format!("parameter '{}': {}", p.name, p.wrong()?)))
    }

    fn wrong_constants(&self) -> Option<String> {
        self.constants.iter().find_map(|c| Some(format!("constant '{}': {}", c.name, c.wrong()?)))
    }

    fn wrong_equations(&self) -> Option<String> {
        let state = |name: &str| self.states.iter().any(|s| s.name == name);
        let hint = |name: &str| did_you_mean(name, self.states.iter().map(|s| s.name.as_str()));
        for (k, e) in self.dynamics.iter().enumerate() {
            let (name, place) = (&e.name, e.place());
            if !state(name) {
                return Some(format!("equation of {name}'{place}: '{name}' is not a state.{}", hint(name)));
            }
            if self.dynamics[..k].iter().any(|other| other.name == *name) {
                return Some(format!("equation of {name}'{place}: '{name}' already has an equation"));
            }
        }
        for (k, c) in self.conditions.iter().enumerate() {
            let name = &c.state;
            if !state(name) {
                return Some(format!("condition of {name}: '{name}' is not a state.{}", hint(name)));
            }
            if self.conditions[..k].iter().any(|other| other.state == *name && other.end == c.end) {
                return Some(format!("condition of {name}: it already has such a condition"));
            }
        }
        (self.conditions.len() > self.states.len()).then(|| {
            format!(
                "{} states have {} conditions; there are at most as many conditions as states",
                self.states.len(),
                self.conditions.len()
            )
        })
    }

    fn wrong_delays(&self) -> Option<String> {
        let parameter = |name: &str| self.parameters.iter().any(|p| p.name == name);
        let input = |name: &str| self.inputs.iter().any(|v| v.name == name);
        for (k, late) in self.delays.inputs.iter().enumerate() {
            let (name, of, by) = (&late.name, &late.of, &late.by);
            if !input(name) || !input(of) || !parameter(by) {
                return Some(format!(
                    "the delay of '{of}' by '{by}', called '{name}': it is not one of the model's inputs by one of its \
                     parameters"
                ));
            }
            if self.delays.input(of).is_some() {
                return Some(format!(
                    "the delay of '{of}' by '{by}', called '{name}': '{of}' is a delayed input itself; delay the \
                     measured input, by one parameter for the whole delay"
                ));
            }
            if self.delays.inputs[..k].iter().any(|other| other.name == *name) {
                return Some(format!("the delayed input '{name}' is declared twice"));
            }
        }
        for (k, late) in self.delays.outputs.iter().enumerate() {
            let (output, by) = (&late.output, &late.by);
            if !self.outputs.iter().any(|o| o.name == *output) || !parameter(by) {
                return Some(format!(
                    "the delay of the sensor of '{output}' by '{by}': it is not one of the model's outputs by one of \
                     its parameters"
                ));
            }
            if self.delays.outputs[..k].iter().any(|other| other.output == *output) {
                return Some(format!("the sensor of '{output}' has two delays; take one out"));
            }
        }
        None
    }
}
