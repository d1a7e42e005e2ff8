//! Messages on values that are not finite: where and from what. They need not be fast.

use std::collections::HashMap;
use std::sync::Arc;

use super::Collocation;
use crate::expr::graph::Id;
use crate::index::{ExperimentId, VariableId};
use crate::nlp::{Named, Nlp};
use crate::problem::explain::UNDERFLOW;
use crate::tape::{Function, trace};

impl Collocation {
    /// The sub-expression that is not finite at ξ, its arguments, and the experiment, time and inputs;
    /// `None` when everything is finite.
    pub(super) fn explained(&self, xi: &[f64]) -> Option<String> {
        self.explain_variables(xi)
            .or_else(|| self.posed.explain_noise(xi))
            .or_else(|| self.explain_dynamics(xi))
            .or_else(|| self.explain_outputs(xi))
            .or_else(|| self.explain_derivatives(xi))
            .or_else(|| self.objective(xi).is_err().then(|| UNDERFLOW.into()))
    }

    /// Values of all symbols at a point, with these inputs.
    fn symbols_at(
        &self,
        xi: &[f64],
        e: ExperimentId,
        point: usize,
        inputs: &[f64],
    ) -> HashMap<Arc<str>, f64> {
        let states = &xi[self.layout.states(self.layout.first_point[e] + point)];
        self.posed.symbols(xi, e, self.meshes[e].times[point], inputs.iter().copied(), states)
    }

    /// Points of an experiment at which f is evaluated, with the inputs there: one where two segments meet has two
    /// values of an input that jumps.
    fn evaluated(&self, e: ExperimentId) -> Vec<(usize, Vec<f64>)> {
        let first = self.layout.first_point[e];
        let mut found = Vec::new();
        for chunk in self.chunks_of(e) {
            for lane in chunk.own().flatten() {
                let inputs = chunk.data.chunks_exact(chunk.lanes()).skip(1).map(|column| column[lane]);
                found.push((chunk.points[lane] as usize - first.0, inputs.collect()));
            }
        }
        found.sort_by_key(|(point, _)| *point);
        found
    }

    /// Points of the samples of an experiment, with the inputs there.
    fn sampled(&self, e: ExperimentId) -> Vec<(usize, Vec<f64>)> {
        let columns = self.posed.sample_columns(e);
        let inputs = |k: usize| columns[1..].iter().take(self.inputs[e].len()).map(move |c| c[k]).collect();
        self.meshes[e].sample_points.iter().enumerate().map(|(k, &point)| (point, inputs(k))).collect()
    }

    fn explain_variables(&self, xi: &[f64]) -> Option<String> {
        let i = xi.iter().position(|v| !v.is_finite())?;
        Some(format!("{} is {}", self.variable_name(VariableId(i)), xi[i]))
    }

    fn explain_dynamics(&self, xi: &[f64]) -> Option<String> {
        let f = &self.posed.f;
        for (e, mesh) in self.meshes.numbered() {
            for (point, inputs) in self.evaluated(e) {
                let (t, names) = (mesh.times[point], self.symbols_at(xi, e, point, &inputs));
                for (root, state) in f.roots.iter().zip(&self.posed.state_names) {
                    let what = format!("the equation of {state}' is");
                    if let Some(text) = self.posed.describe(&what, f, &names, &[*root], e, t) {
                        return Some(text);
                    }
                }
            }
        }
        None
    }

    fn explain_outputs(&self, xi: &[f64]) -> Option<String> {
        for (e, experiment) in self.posed.experiments.numbered() {
            for (k, ((point, inputs), &t)) in self.sampled(e).into_iter().zip(&experiment.t).enumerate() {
                let names = self.symbols_at(xi, e, point, &inputs);
                // What an output is where nothing was measured does not matter.
                let measured = |c: &usize| !experiment.outputs[*c][k].is_nan();
                let roots: Vec<Id> = (0..self.posed.outputs.roots.len())
                    .filter(measured)
                    .map(|c| self.posed.outputs.roots[c])
                    .collect();
                let text = self.posed.describe("an output is", &self.posed.outputs, &names, &roots, e, t);
                if text.is_some() {
                    return text;
                }
            }
        }
        None
    }

    /// Explains a derivative that is not finite where values are finite (a square root at 0, say).
    fn explain_derivatives(&self, xi: &[f64]) -> Option<String> {
        let names: Vec<String> = self.posed.state_names.iter().cloned().chain(self.posed.seen()).collect();
        for is_output in [false, true] {
            let (what, function) = if is_output {
                ("an output", &*self.posed.outputs)
            } else {
                ("a state equation", &*self.posed.f)
            };
            let mut graph = (*function.graph).clone();
            let symbols: Vec<Id> = names.iter().map(|n| graph.symbol(n)).collect();
            let first = graph.jacobian(&function.roots, &symbols);
            let mut entries: Vec<(String, Id)> = (first.columns.iter().zip(&first.values))
                .map(|(&c, &id)| (format!("the derivative of {what} with respect to {} is", names[c]), id))
                .collect();
            for &root in &function.roots {
                let second = graph.hessian(root, &symbols);
                for ((&a, &b), &id) in second.rows.iter().zip(&second.columns).zip(&second.values) {
                    let (a, b) = (&names[a], &names[b]);
                    entries.push((
                        format!("the second derivative of {what} with respect to {a} and {b} is"),
                        id,
                    ));
                }
            }
            let ids: Vec<Id> = entries.iter().map(|e| e.1).collect();
            let function = Function { graph: Arc::new(graph), ..function.clone() };
            for (e, mesh) in self.meshes.numbered() {
                // f is evaluated at mesh points, g at samples.
                for (point, inputs) in if is_output { self.sampled(e) } else { self.evaluated(e) } {
                    let values = self.symbols_at(xi, e, point, &inputs);
                    if trace(&function.graph, &ids, &values).is_none() {
                        continue;
                    }
                    let at = |(what, id): &(String, Id)| {
                        self.posed.describe(what, &function, &values, &[*id], e, mesh.times[point])
                    };
                    return entries.iter().find_map(at);
                }
            }
        }
        None
    }
}
