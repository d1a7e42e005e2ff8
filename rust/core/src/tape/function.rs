//! A function of a point, with its first and second derivatives as tapes.

use std::sync::Arc;

use super::terms::{Slopes, Terms};
use super::{Inputs, Sink, Tape};
use crate::expr::derive::Sparse;
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
/// Lane inputs are the data columns, then the states, then (Hessian of [`Function::new`] only) one
/// weight a function.
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
    /// Differentiates and compiles; the Hessian is that of the sum of the functions times weights.
    pub fn new(mut graph: Graph, arguments: &Arguments, roots: Vec<Id>) -> Function {
        let mut inputs = arguments.inputs();
        let mut sum = graph.zero();
        for (i, &root) in roots.iter().enumerate() {
            let weight = graph.symbol(&format!("weight of function {i}"));
            inputs.lanes.push(weight);
            let term = graph.mul(weight, root);
            sum = graph.add(sum, term);
        }
        let second = graph.hessian(sum, &arguments.variables());
        let hessian = Tape::compile(&graph, &inputs, &second.values);
        Function::with_hessian(graph, arguments, roots, hessian, second)
    }

    /// A single function f = rest − ½ Σ residual² − Σ ρ, with Hessians of **−f**, which is what is minimised:
    /// the exact one and Gauss-Newton's. Neither is weighted; both have sinks: entries with a state are
    /// stored, those between parameters summed.
    ///
    /// −∇²f = −∇²rest + Σ ∇e ∇eᵀ + Σ e ∇²e: put together from the residuals e, it takes a third of the
    /// instructions of a second derivative of the whole. For a loss ρ(r, η) the second term is ρ'' ∇r ∇rᵀ, the
    /// third ρ' ∇²r, and there are those with its own parameters η. Gauss-Newton's has ω ∇r ∇rᵀ with the loss's
    /// weight ω, and for η the squared slopes ρ_η ρ_ηᵀ, which on average are the curvature (Berndt et al., 1974).
    pub fn of_terms(mut graph: Graph, arguments: &Arguments, terms: &Terms) -> Function {
        let variables = arguments.variables();
        let (squares, losses, rest) = (&terms.squares, &terms.losses, terms.rest);
        let losses: Vec<Slopes> = losses.iter().map(|loss| loss.slopes(&mut graph, &variables)).collect();
        let residuals: Vec<Id> =
            squares.iter().copied().chain(terms.losses.iter().map(|l| l.residual)).collect();
        let slopes = graph.jacobian(&residuals, &variables);
        let of_rest = graph.hessian(rest, &variables);
        let mut sum = graph.zero();
        let weights: Vec<Id> = (0..residuals.len()).map(|k| graph.symbol(&format!("residual {k}"))).collect();
        for (&weight, &residual) in weights.iter().zip(&residuals) {
            let term = graph.mul(weight, residual);
            sum = graph.add(sum, term);
        }
        let curved = graph.hessian(sum, &variables);
        let pulls: Vec<Id> = squares.iter().copied().chain(losses.iter().map(|l| l.first)).collect();
        let curved_values = graph.replace(&curved.values, &weights, &pulls);

        let (mut exact, mut approximate) = (Vec::new(), Vec::new());
        let mut second = Sparse::default();
        for a in 0..variables.len() {
            for b in 0..=a {
                let mut entry = of_rest.find(a, b).map(|r| graph.neg(r));
                for k in 0..squares.len() {
                    if let (Some(x), Some(y)) = (slopes.find(k, a), slopes.find(k, b)) {
                        let product = graph.product(x, y);
                        let so_far = entry.unwrap_or_else(|| graph.zero());
                        entry = Some(graph.add(so_far, product));
                    }
                }
                let bend = curved.position(a, b).map(|at| curved_values[at]);
                let mut more: Option<(Id, Id)> = None;
                for (k, loss) in (squares.len()..).zip(&losses) {
                    let pair = (slopes.find(k, a), slopes.find(k, b));
                    if let Some((e, g)) = loss.second(&mut graph, (a, b), pair) {
                        let (x, y) = more.unwrap_or_else(|| (graph.zero(), graph.zero()));
                        more = Some((graph.add(x, e), graph.add(y, g)));
                    }
                }
                if entry.is_none() && bend.is_none() && more.is_none() {
                    continue;
                }
                let smooth = entry.unwrap_or_else(|| graph.zero());
                let (full, part) =
                    more.map_or((smooth, smooth), |m| (graph.add(smooth, m.0), graph.add(smooth, m.1)));
                second.rows.push(a);
                second.columns.push(b);
                approximate.push(part);
                exact.push(bend.map_or(full, |bend| graph.add(full, bend)));
            }
        }
        let inputs = arguments.inputs();
        let sinks = second_sinks(&second, arguments.states.len());
        let gauss_newton = Some(Tape::compile_into(&graph, &inputs, &approximate, &sinks));
        let hessian = Tape::compile_into(&graph, &inputs, &exact, &sinks);

        let half = graph.constant(0.5);
        let mut root = rest;
        for &residual in squares {
            let square = graph.mul(residual, residual);
            let loss = graph.mul(half, square);
            root = graph.sub(root, loss);
        }
        for loss in &losses {
            root = graph.sub(root, loss.value);
        }
        Function { gauss_newton, ..Function::with_hessian(graph, arguments, vec![root], hessian, second) }
    }

    fn with_hessian(
        mut graph: Graph,
        arguments: &Arguments,
        roots: Vec<Id>,
        hessian: Tape,
        second: Sparse,
    ) -> Function {
        let inputs = arguments.inputs();
        let value = Tape::compile(&graph, &inputs, &roots);
        let first = graph.jacobian(&roots, &arguments.variables());
        let jacobian = Tape::compile(&graph, &inputs, &first.values);
        Function {
            graph: Arc::new(graph),
            roots,
            n_data: arguments.data.len(),
            n_states: arguments.states.len(),
            value,
            jacobian,
            jacobian_pattern: Pattern { rows: first.rows, columns: first.columns },
            hessian,
            hessian_pattern: Pattern { rows: second.rows, columns: second.columns },
            gauss_newton: None,
        }
    }
}

/// Entries with a state are stored one row after the other, those between parameters summed.
fn second_sinks(second: &Sparse, n_states: usize) -> Vec<Sink> {
    let (mut rows, mut sums) = (0, 0);
    let next = |count: &mut u16| {
        *count += 1;
        *count - 1
    };
    let sink = |&column: &usize| {
        if column < n_states { Sink::Store(next(&mut rows)) } else { Sink::Sum(next(&mut sums)) }
    };
    second.columns.iter().map(sink).collect()
}

impl Arguments {
    /// The local variables: states, then parameters.
    fn variables(&self) -> Vec<Id> {
        self.states.iter().chain(&self.parameters).copied().collect()
    }

    /// What a tape is given: data and states by lane, parameters uniform.
    fn inputs(&self) -> Inputs {
        let lanes = self.data.iter().chain(&self.states).copied().collect();
        Inputs { lanes, uniforms: self.parameters.clone() }
    }
}
