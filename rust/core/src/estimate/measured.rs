//! Which outputs measure a state by itself.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use crate::experiment::Experiment;
use crate::model::{Model, TIME};

/// An output that measures a state: z = offset + slope · x.
pub(crate) struct Measured {
    output: usize,
    offset: f64,
    slope: f64,
}

impl Measured {
    /// The state from the samples of the output: times and values.
    pub(crate) fn samples(&self, experiment: &Experiment) -> (Vec<f64>, Vec<f64>) {
        let samples = experiment.t.iter().zip(&experiment.outputs[self.output]).filter(|s| !s.1.is_nan());
        samples.map(|(t, z)| (*t, (z - self.offset) / self.slope)).unzip()
    }
}

/// For each state, the output that measures it: one that depends on no other state, input or time, and
/// on this one linearly, with these parameters.
pub(crate) fn measured_states(model: &Model, parameters: &[f64]) -> Vec<Option<Measured>> {
    let varying: HashSet<&str> =
        model.states.iter().chain(&model.inputs).map(|v| v.name.as_str()).chain([TIME]).collect();
    let mut numbers: HashMap<Arc<str>, f64> =
        model.parameters.iter().zip(parameters).map(|(p, v)| (p.name.as_str().into(), *v)).collect();
    let mut found: Vec<Option<Measured>> = model.states.iter().map(|_| None).collect();
    for (output, expr) in model.expanded().1.iter().enumerate() {
        let symbols = expr.symbols();
        let mut inside = symbols.iter().filter(|s| varying.contains(&***s));
        let (Some(name), None) = (inside.next(), inside.next()) else { continue };
        let Some(state) = model.states.iter().position(|s| *s.name == **name) else { continue };
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
