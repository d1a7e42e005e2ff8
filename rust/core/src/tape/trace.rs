//! Which sub-expression became not finite, and from what.

use std::collections::HashMap;
use std::sync::Arc;

use crate::expr::graph::{Graph, Id};

/// The first sub-expression that is not finite although its arguments are.
#[derive(Clone, Debug)]
pub struct Trace {
    /// The sub-expression, printed.
    pub expression: String,
    /// Its value: NaN or infinite.
    pub value: f64,
    /// Its arguments, printed, with their values.
    pub arguments: Vec<(String, f64)>,
}

/// Evaluates `roots` at numbers, node by node, and finds where they stop being finite. `None` when
/// all are finite.
pub fn trace(graph: &Graph, roots: &[Id], values: &HashMap<Arc<str>, f64>) -> Option<Trace> {
    let mut done: HashMap<Id, f64> = HashMap::new();
    for id in graph.reachable(roots) {
        let args = graph.args(id);
        let numbers: Vec<f64> = args.iter().map(|a| done[a]).collect();
        let value = match graph.symbol_name(id) {
            Some(name) => values.get(name).copied().unwrap_or(f64::NAN),
            None => graph.value(id, &numbers),
        };
        if !value.is_finite() {
            let arguments =
                args.iter().zip(&numbers).map(|(&a, &x)| (graph.export(a).to_string(), x)).collect();
            return Some(Trace { expression: graph.export(id).to_string(), value, arguments });
        }
        done.insert(id, value);
    }
    None
}
