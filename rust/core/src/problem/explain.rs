//! Messages on what is not finite in a problem, where, and from what. They need not be fast.

use std::collections::HashMap;
use std::sync::Arc;

use super::posed::Posed;
use crate::expr::graph::Id;
use crate::index::ExperimentId;
use crate::tape::{Function, trace};

/// The explanation where all else is finite: a density far out in its tails may underflow.
pub(crate) const UNDERFLOW: &str = "the log-density of the noise is not finite: a residual is too large for its scale \
    sigma, which may start larger, or the density is not defined there";

impl Posed {
    /// The sub-expression of some functions that is not finite, where, and from what.
    pub(crate) fn describe(
        &self,
        what: &str,
        function: &Function,
        names: &HashMap<Arc<str>, f64>,
        roots: &[Id],
        e: ExperimentId,
        t: f64,
    ) -> Option<String> {
        let found = trace(&function.graph, roots, names)?;
        let mut text = format!(
            "{what} not finite in experiment '{}' at t = {t}: {} = {}",
            self.experiments[e].name, found.expression, found.value
        );
        for (name, value) in &found.arguments {
            if *name != value.to_string() {
                text += &format!(", {name} = {value}");
            }
        }
        let inputs: Vec<String> =
            self.input_names.iter().map(|n| format!("{n} = {}", names[n.as_str()])).collect();
        if !inputs.is_empty() {
            text += &format!("; inputs {}", inputs.join(", "));
        }
        Some(text)
    }

    /// Values of all symbols at a point: time, inputs and states there.
    pub(crate) fn symbols(
        &self,
        xi: &[f64],
        e: ExperimentId,
        t: f64,
        inputs: impl IntoIterator<Item = f64>,
        states: &[f64],
    ) -> HashMap<Arc<str>, f64> {
        let mut names: HashMap<Arc<str>, f64> = HashMap::new();
        for (name, &i) in self.seen().into_iter().zip(&self.estimands.maps[e]) {
            names.insert(name.into(), xi[i]);
        }
        names.insert(crate::model::TIME.into(), t);
        for (name, value) in self.input_names.iter().zip(inputs) {
            names.insert(name.as_str().into(), value);
        }
        for (name, value) in self.state_names.iter().zip(states) {
            names.insert(name.as_str().into(), *value);
        }
        names
    }

    /// Names of the parameters as functions of a point see them.
    pub(crate) fn seen(&self) -> Vec<String> {
        let model = self.model_names.iter().zip(&self.estimands.maps[ExperimentId(0)]);
        let model = model.map(|(name, &i)| self.estimands.transforms[i].name(name));
        model.chain(self.noise_names.iter().cloned()).collect()
    }

    /// A standard deviation that is not positive has no logarithm.
    pub(crate) fn explain_noise(&self, xi: &[f64]) -> Option<String> {
        let i = self.precision_roots().into_iter().find(|&i| xi[i] <= 0.0)?;
        Some(format!("{} is {}; a standard deviation must be positive", self.parameter_name(i), xi[i]))
    }
}
