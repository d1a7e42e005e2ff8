//! Which states are known before an estimation: measured by an output, or declared.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use crate::condition::End;
use crate::experiment::Experiment;
use crate::expr::Expr;
use crate::model::{Model, TIME};

/// Samples of an output from which a state is worked out, at most.
const MOST: usize = 2000;

/// An output that measures a state: z = offset + slope · x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Number of the output.
    pub output: usize,
    /// In the unit of the output.
    pub offset: f64,
    /// In the unit of the output over that of the state.
    pub slope: f64,
}

impl Measured {
    /// The state from the samples of the output: times and values.
    pub(crate) fn samples(&self, experiment: &Experiment) -> (Vec<f64>, Vec<f64>) {
        let samples = experiment.t.iter().zip(&experiment.outputs[self.output]).filter(|s| !s.1.is_nan());
        samples.map(|(t, z)| (*t, (z - self.offset) / self.slope)).unzip()
    }
}

impl Model {
    fn values(&self, parameters: &[f64]) -> HashMap<Arc<str>, f64> {
        self.parameters.iter().zip(parameters).map(|(p, v)| (p.name.as_str().into(), *v)).collect()
    }

    /// Returns the names of all that changes in the course of a record.
    fn varying(&self) -> HashSet<&str> {
        self.states.iter().chain(&self.inputs).map(|v| v.name.as_str()).chain([TIME]).collect()
    }

    /// For each state, the output that measures it: one that depends on no other state, input or time, and
    /// on this one linearly, with these parameters.
    pub fn measured_states(&self, parameters: &[f64]) -> Vec<Option<Measured>> {
        let varying = self.varying();
        let mut numbers = self.values(parameters);
        let mut found: Vec<Option<Measured>> = self.states.iter().map(|_| None).collect();
        for (output, expr) in self.expanded().1.iter().enumerate() {
            let symbols = expr.symbols();
            let mut inside = symbols.iter().filter(|s| varying.contains(&***s));
            let (Some(name), None) = (inside.next(), inside.next()) else { continue };
            let Some(state) = self.states.iter().position(|s| *s.name == **name) else { continue };
            let slope = expr.derivative(name);
            if found[state].is_some() || slope.symbols().iter().any(|s| varying.contains(&**s)) {
                continue;
            }
            numbers.insert(name.clone(), 0.0);
            if let (Ok(offset), Ok(slope)) = (expr.evaluate(&numbers), slope.evaluate(&numbers))
                && offset.is_finite()
                && slope.is_finite()
                && slope != 0.0
            {
                found[state] = Some(Measured { output, offset, slope });
            }
            numbers.remove(name);
        }
        found
    }

    /// Samples of a state that no output measures by itself: of an output on which it acts with a constant slope, beside
    /// states that are known, inputs and time, such as a vane ahead of the centre of gravity, alpha - l q / V. `known` holds the
    /// others at the samples, where they are, and `outputs` the right-hand sides of the outputs, expanded. Times and values;
    /// none where there is no such output.
    pub(crate) fn measured_beside_others(
        &self,
        outputs: &[Expr],
        state: usize,
        experiment: &Experiment,
        parameters: &[f64],
        known: &[Option<Vec<f64>>],
    ) -> Option<(Vec<f64>, Vec<f64>)> {
        let name: Arc<str> = self.states[state].name.as_str().into();
        let varying = self.varying();
        let number = |s: &str| self.states.iter().position(|x| x.name == s);
        let mut numbers = self.values(parameters);
        let step = experiment.t.len().div_ceil(MOST);
        for (output, expr) in outputs.iter().enumerate() {
            let symbols = expr.symbols();
            let others = symbols.iter().filter_map(|s| number(s)).filter(|&i| i != state);
            let others: Vec<usize> = others.collect();
            if !symbols.contains(&name) || others.iter().any(|&i| known[i].is_none()) {
                continue;
            }
            let slope = expr.derivative(&name);
            if slope.symbols().iter().any(|s| varying.contains(&**s)) {
                continue;
            }
            numbers.insert(name.clone(), 0.0);
            let mut at = |j: usize| {
                numbers.insert(TIME.into(), experiment.t[j]);
                for (input, values) in self.inputs.iter().zip(&experiment.inputs) {
                    numbers.insert(input.name.as_str().into(), values[j]);
                }
                for &i in &others {
                    numbers.insert(self.states[i].name.as_str().into(), known[i].as_ref()?[j]);
                }
                let (rest, slope) = (expr.evaluate(&numbers).ok()?, slope.evaluate(&numbers).ok()?);
                let value = (experiment.outputs[output][j] - rest) / slope;
                value.is_finite().then_some((experiment.t[j], value))
            };
            let found: (Vec<f64>, Vec<f64>) =
                (0..experiment.t.len()).step_by(step).filter_map(&mut at).unzip();
            if !found.0.is_empty() {
                return Some(found);
            }
        }
        None
    }

    /// For each state, where it starts if that is declared, or follows from an initial condition and these parameters.
    pub fn declared_paths(&self, parameters: &[f64]) -> Vec<Option<f64>> {
        let numbers = self.values(parameters);
        let of_condition = |state: &str| {
            let mut own = self.conditions.iter().filter(|c| c.end == End::Initial && c.state == state);
            own.find_map(|c| c.expr.evaluate(&numbers).ok().filter(|v| v.is_finite()))
        };
        self.states.iter().map(|s| s.start.or_else(|| of_condition(&s.name))).collect()
    }
}
