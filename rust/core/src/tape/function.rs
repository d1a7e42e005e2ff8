//! A function of a point, with its first and second derivatives as tapes.

use std::sync::Arc;

use super::{Inputs, Tape};
use crate::expr::graph::{Graph, Id};

/// Positions of structurally nonzero entries.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pattern {
    /// Row of each entry.
    pub rows: Vec<usize>,
    /// Column of each entry.
    pub columns: Vec<usize>,
}

impl Pattern {
    /// Number of entries.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are no entries.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Rows and columns in pairs.
    pub fn iter(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.rows.iter().copied().zip(self.columns.iter().copied())
    }
}

/// r functions of the *local variables* of a point, in order: the states x, then the parameters θ.
/// Lane inputs are the data columns, then the states, then (Hessian only) one weight a function.
#[derive(Clone, Debug)]
pub struct Function {
    /// The expressions, for tracing failures.
    pub graph: Arc<Graph>,
    /// Nodes of the functions.
    pub roots: Vec<Id>,
    /// Number of data columns.
    pub n_data: usize,
    /// Number of states.
    pub n_states: usize,
    /// Number of parameters.
    pub n_parameters: usize,
    /// Values.
    pub value: Tape,
    /// Entries of the Jacobian, in the order of [`Function::jacobian_pattern`].
    pub jacobian: Tape,
    /// Function (row) and local variable (column) of each entry.
    pub jacobian_pattern: Pattern,
    /// Entries of the lower triangle of the Hessian of the weighted sum.
    pub hessian: Tape,
    /// Local variables of each entry, row ≥ column.
    pub hessian_pattern: Pattern,
    /// Entries of a Hessian without the curvature of residuals, where there are residuals; in the
    /// order of [`Function::hessian_pattern`].
    pub gauss_newton: Option<Tape>,
}

/// What the symbols of a function are.
#[derive(Clone, Debug)]
pub struct Arguments {
    /// Data: inputs, time, measurements.
    pub data: Vec<Id>,
    /// States.
    pub states: Vec<Id>,
    /// Parameters.
    pub parameters: Vec<Id>,
}

impl Function {
    /// Differentiates and compiles. A single function needs no weight: its Hessian is unweighted.
    pub fn new(mut graph: Graph, arguments: &Arguments, roots: Vec<Id>) -> Function {
        let variables: Vec<Id> = arguments.states.iter().chain(&arguments.parameters).copied().collect();
        let lanes: Vec<Id> = arguments.data.iter().chain(&arguments.states).copied().collect();
        let inputs = Inputs { lanes, uniforms: arguments.parameters.clone() };
        let value = Tape::compile(&graph, &inputs, &roots);

        let sparse = graph.jacobian(&roots, &variables);
        let jacobian = Tape::compile(&graph, &inputs, &sparse.values);
        let jacobian_pattern = Pattern { rows: sparse.rows, columns: sparse.columns };

        let mut weighted = inputs;
        let sum = if roots.len() == 1 {
            roots[0]
        } else {
            let mut sum = graph.zero();
            for (i, &root) in roots.iter().enumerate() {
                let weight = graph.symbol(&format!("weight of function {i}"));
                weighted.lanes.push(weight);
                let term = graph.mul(weight, root);
                sum = graph.add(sum, term);
            }
            sum
        };
        let sparse = graph.hessian(sum, &variables);
        let hessian = Tape::compile(&graph, &weighted, &sparse.values);
        let hessian_pattern = Pattern { rows: sparse.rows, columns: sparse.columns };

        Function {
            graph: Arc::new(graph),
            roots,
            n_data: arguments.data.len(),
            n_states: arguments.states.len(),
            n_parameters: arguments.parameters.len(),
            value,
            jacobian,
            jacobian_pattern,
            hessian,
            hessian_pattern,
            gauss_newton: None,
        }
    }

    /// A single function rest − ½ Σ residual², with its Gauss-Newton Hessian.
    pub fn of_squares(
        mut graph: Graph,
        arguments: &Arguments,
        residuals: &[Id],
        rest: Id,
        root: Id,
    ) -> Function {
        let variables: Vec<Id> = arguments.states.iter().chain(&arguments.parameters).copied().collect();
        let slopes = graph.jacobian(residuals, &variables);
        let curvature = graph.hessian(rest, &variables);
        let full = graph.hessian(root, &variables);
        let mut entries: Vec<Id> = Vec::with_capacity(full.values.len());
        for (&a, &b) in full.rows.iter().zip(&full.columns) {
            let own = curvature.rows.iter().zip(&curvature.columns).position(|(&r, &c)| (r, c) == (a, b));
            let mut sum = own.map_or_else(|| graph.zero(), |k| curvature.values[k]);
            for k in 0..residuals.len() {
                if let (Some(x), Some(y)) = (slopes.find(k, a), slopes.find(k, b)) {
                    let product = graph.mul(x, y);
                    sum = graph.sub(sum, product);
                }
            }
            entries.push(sum);
        }
        let lanes = arguments.data.iter().chain(&arguments.states).copied().collect();
        let inputs = Inputs { lanes, uniforms: arguments.parameters.clone() };
        let gauss_newton = Some(Tape::compile(&graph, &inputs, &entries));
        Function { gauss_newton, ..Function::new(graph, arguments, vec![root]) }
    }
}
