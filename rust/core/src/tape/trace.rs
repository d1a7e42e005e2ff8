//! The search for the sub-expression that became not finite, and its arguments.

use std::collections::HashMap;
use std::sync::Arc;

use crate::expr::Op;
use crate::expr::graph::{Graph, Id, Item};

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

/// Evaluates `roots` at numbers, node by node; from the first root that is not finite, follows
/// arguments that are not finite to where it began. `None` when all roots are finite: what a `where`
/// leaves out, or an infinity that comes to nothing, is no failure.
pub fn trace(graph: &Graph, roots: &[Id], values: &HashMap<Arc<str>, f64>) -> Option<Trace> {
    let mut done: HashMap<Id, f64> = HashMap::new();
    for id in graph.reachable(roots) {
        let numbers: Vec<f64> = graph.args(id).iter().map(|a| done[a]).collect();
        let value = match graph.symbol_name(id) {
            Some(name) => values.get(name).copied().unwrap_or(f64::NAN),
            None => graph.value(id, &numbers),
        };
        done.insert(id, value);
    }
    let mut id = *roots.iter().find(|r| !done[r].is_finite())?;
    loop {
        let mut args = graph.args(id);
        if let Item::Apply(Op::Where, [condition, yes, no]) = graph.item(id) {
            args = vec![condition, if done[&condition] != 0.0 { yes } else { no }];
        }
        match args.iter().find(|a| !done[a].is_finite()) {
            Some(&arg) => id = arg,
            None => {
                let arguments = args.iter().map(|a| (graph.export(*a).brief(), done[a])).collect();
                return Some(Trace { expression: graph.export(id).brief(), value: done[&id], arguments });
            }
        }
    }
}
