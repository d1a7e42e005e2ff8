//! A function of a point, with its first and second derivatives as tapes.

use std::sync::Arc;

use super::terms::{Slopes, Terms};
use super::{Inputs, Sink, Tape};
use crate::error::Error;
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

/// r functions of the *local variables* of a point, in order: the states x, then the parameters θ. Where the functions
/// are the slopes of states, there may be more states than functions: those beyond are constants.
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
    /// Entries of the lower triangle of the Hessian of the weighted sum; see [`Pairs`].
    pub hessian: Tape,
    /// Local variables of each entry, row ≥ column.
    pub hessian_pattern: Pattern,
    /// Entries of a Hessian without the curvature of residuals, where there are residuals; in the
    /// order of [`Function::hessian_pattern`].
    pub gauss_newton: Option<Tape>,
}

/// The meaning of the symbols of a function.
#[derive(Clone, Debug)]
pub struct Arguments {
    /// Data: inputs, time, measurements.
    pub data: Vec<Id>,
    /// States.
    pub states: Vec<Id>,
    /// Parameters.
    pub parameters: Vec<Id>,
}

/// Most entries of second derivatives: so many have 2,047 parameters that act jointly. Beyond, tapes take
/// gigabytes.
const MOST_ENTRIES: usize = 1 << 21;

/// The treatment of the entries of a Hessian between parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pairs {
    /// They are kept, lane by lane.
    Kept,
    /// They are summed over the lanes, each in a place of its own, in the order of the pattern.
    Summed,
    /// There are none, nor any between a state and a parameter: second derivatives are by the states alone.
    Absent,
}

impl Function {
    /// Differentiates and compiles; the Hessian is that of the sum of the functions times weights.
    ///
    /// # Errors
    /// When a function depends on another symbol than its arguments, or second derivatives have more than 2²¹
    /// entries.
    pub fn new(
        mut graph: Graph,
        arguments: &Arguments,
        roots: Vec<Id>,
        pairs: Pairs,
    ) -> Result<Function, Error> {
        let mut inputs = arguments.inputs();
        let mut sum = graph.zero();
        for (i, &root) in roots.iter().enumerate() {
            let weight = graph.symbol(&format!("weight of function {i}"));
            inputs.lanes.push(weight);
            let term = graph.mul(weight, root);
            sum = graph.add(sum, term);
        }
        let variables = if pairs == Pairs::Absent { arguments.states.clone() } else { arguments.variables() };
        let second = second_derivatives(&mut graph, sum, &variables)?;
        let n_states = arguments.states.len();
        let mut places = 0..;
        let sink = |&column: &usize| match pairs {
            Pairs::Summed if column >= n_states => Sink::Sum(places.next().expect("without end")),
            _ => Sink::Keep,
        };
        let sinks: Vec<Sink> = second.columns.iter().map(sink).collect();
        let hessian = Tape::compile_into(&graph, &inputs, &second.values, &sinks)?;
        Function::with_hessian(graph, arguments, roots, hessian, second)
    }

    /// Functions of which only values are wanted: there are no entries of derivatives.
    ///
    /// # Errors
    /// When a function depends on another symbol than its arguments.
    pub fn of_values(graph: Graph, arguments: &Arguments, roots: Vec<Id>) -> Result<Function, Error> {
        let none = || Tape::compile(&graph, &arguments.inputs(), &[]);
        let value = Tape::compile(&graph, &arguments.inputs(), &roots)?;
        let (jacobian, hessian) = (none()?, none()?);
        Ok(Function {
            graph: Arc::new(graph),
            roots,
            n_data: arguments.data.len(),
            n_states: arguments.states.len(),
            value,
            jacobian,
            jacobian_pattern: Pattern::default(),
            hessian,
            hessian_pattern: Pattern::default(),
            gauss_newton: None,
        })
    }

    /// A single function f = rest − ½ Σ residual² − Σ ρ, with Hessians of **−f**, which is what is minimised:
    /// the exact one and Gauss-Newton's. Neither is weighted; both have sinks: entries with a state are
    /// stored, those between parameters summed.
    ///
    /// −∇²f = −∇²rest + Σ ∇e ∇eᵀ + Σ e ∇²e: put together from the residuals e, it takes a third of the
    /// instructions of a second derivative of the whole. For a loss ρ(r, η) the second term is ρ'' ∇r ∇rᵀ, the
    /// third ρ' ∇²r, and there are those with its own parameters η. Gauss-Newton's has ω ∇r ∇rᵀ with the loss's
    /// weight ω, and for η the squared slopes ρ_η ρ_ηᵀ, which on average are the curvature (Berndt et al., 1974).
    /// For the logarithm l of a standard deviation that is an expression of the model, Gauss-Newton's has ∇l ∇lᵀ:
    /// with the ∇l ∇lᵀ that ∇e ∇eᵀ has on average, it is the Fisher information of a Gaussian.
    ///
    /// # Errors
    /// As [`Function::new`].
    pub fn of_terms(mut graph: Graph, arguments: &Arguments, terms: &Terms) -> Result<Function, Error> {
        let variables = arguments.variables();
        let (squares, losses, rest) = (&terms.squares, &terms.losses, terms.rest);
        let losses: Vec<Slopes> = losses.iter().map(|loss| loss.slopes(&mut graph, &variables)).collect();
        let residuals: Vec<Id> =
            squares.iter().copied().chain(terms.losses.iter().map(|l| l.residual)).collect();
        let slopes: Vec<Vec<Option<Id>>> =
            residuals.iter().map(|&residual| graph.gradient(residual, &variables)).collect();
        for slopes in &slopes {
            let joint = slopes.iter().flatten().count();
            if joint * (joint + 1) / 2 > MOST_ENTRIES {
                return Err(too_many(variables.len()));
            }
        }
        let of_rest = second_derivatives(&mut graph, rest, &variables)?.by_place();
        let log_slopes: Vec<Vec<Option<Id>>> =
            terms.logs.iter().map(|&log| graph.gradient(log, &variables)).collect();
        let all_logs = terms.logs.iter().fold(graph.zero(), |sum, &log| graph.add(sum, log));
        let of_logs = second_derivatives(&mut graph, all_logs, &variables)?.by_place();
        let mut sum = graph.zero();
        let weights: Vec<Id> = (0..residuals.len()).map(|k| graph.symbol(&format!("residual {k}"))).collect();
        for (&weight, &residual) in weights.iter().zip(&residuals) {
            let term = graph.mul(weight, residual);
            sum = graph.add(sum, term);
        }
        let mut curved = second_derivatives(&mut graph, sum, &variables)?;
        let pulls: Vec<Id> = squares.iter().copied().chain(losses.iter().map(|l| l.first)).collect();
        curved.values = graph.replace(&curved.values, &weights, &pulls);
        let curved = curved.by_place();

        let (mut exact, mut approximate) = (Vec::new(), Vec::new());
        let mut second = Sparse::default();
        for a in 0..variables.len() {
            for b in 0..=a {
                let mut entry = of_rest.get(&(a, b)).map(|&r| graph.neg(r));
                for slopes in &slopes[..squares.len()] {
                    if let (Some(x), Some(y)) = (slopes[a], slopes[b]) {
                        let product = graph.product(x, y);
                        let so_far = entry.unwrap_or_else(|| graph.zero());
                        entry = Some(graph.add(so_far, product));
                    }
                }
                let bend = curved.get(&(a, b)).copied();
                let mut more: Option<(Id, Id)> = None;
                for (slopes, loss) in slopes[squares.len()..].iter().zip(&losses) {
                    if let Some((e, g)) = loss.second(&mut graph, (a, b), (slopes[a], slopes[b])) {
                        let (x, y) = more.unwrap_or_else(|| (graph.zero(), graph.zero()));
                        more = Some((graph.add(x, e), graph.add(y, g)));
                    }
                }
                let log_bend = of_logs.get(&(a, b)).copied();
                let mut log_square = None;
                for slopes in &log_slopes {
                    if let (Some(x), Some(y)) = (slopes[a], slopes[b]) {
                        let product = graph.product(x, y);
                        let so_far = log_square.unwrap_or_else(|| graph.zero());
                        log_square = Some(graph.add(so_far, product));
                    }
                }
                if log_bend.is_some() || log_square.is_some() {
                    let (x, y) = more.unwrap_or_else(|| (graph.zero(), graph.zero()));
                    let exact = log_bend.map_or(x, |l| graph.add(x, l));
                    more = Some((exact, log_square.map_or(y, |l| graph.add(y, l))));
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
            if exact.len() > MOST_ENTRIES {
                return Err(too_many(variables.len()));
            }
        }
        let inputs = arguments.inputs();
        let sinks = second_sinks(&second, arguments.states.len());
        let gauss_newton = Some(Tape::compile_into(&graph, &inputs, &approximate, &sinks)?);
        let hessian = Tape::compile_into(&graph, &inputs, &exact, &sinks)?;

        let half = graph.constant(0.5);
        let mut root = graph.sub(rest, all_logs);
        for &residual in squares {
            let square = graph.mul(residual, residual);
            let loss = graph.mul(half, square);
            root = graph.sub(root, loss);
        }
        for loss in &losses {
            root = graph.sub(root, loss.value);
        }
        let function = Function::with_hessian(graph, arguments, vec![root], hessian, second)?;
        Ok(Function { gauss_newton, ..function })
    }

    fn with_hessian(
        mut graph: Graph,
        arguments: &Arguments,
        roots: Vec<Id>,
        hessian: Tape,
        second: Sparse,
    ) -> Result<Function, Error> {
        let inputs = arguments.inputs();
        let value = Tape::compile(&graph, &inputs, &roots)?;
        let first = graph.jacobian(&roots, &arguments.variables());
        let jacobian = Tape::compile(&graph, &inputs, &first.values)?;
        Ok(Function {
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
        })
    }
}

fn second_derivatives(graph: &mut Graph, root: Id, variables: &[Id]) -> Result<Sparse, Error> {
    graph.hessian_within(root, variables, MOST_ENTRIES).ok_or_else(|| too_many(variables.len()))
}

fn too_many(n: usize) -> Error {
    Error::model(format!(
        "of {n} states and parameters so many act jointly in one equation that there are more than {MOST_ENTRIES} \
         second derivatives; at most 2,047 may: write those that are known as numbers, or describe the same by fewer"
    ))
}

/// Entries with a state are stored one row after the other, those between parameters summed.
fn second_sinks(second: &Sparse, n_states: usize) -> Vec<Sink> {
    let (mut rows, mut sums) = (0.., 0..);
    let sink = |&column: &usize| match column < n_states {
        true => Sink::Store(rows.next().expect("without end")),
        false => Sink::Sum(sums.next().expect("without end")),
    };
    second.columns.iter().map(sink).collect()
}

impl Arguments {
    /// The local variables: states, then parameters.
    fn variables(&self) -> Vec<Id> {
        self.states.iter().chain(&self.parameters).copied().collect()
    }

    /// Returns the inputs of a tape: data and states by lane, parameters uniform.
    fn inputs(&self) -> Inputs {
        let lanes = self.data.iter().chain(&self.states).copied().collect();
        Inputs { lanes, uniforms: self.parameters.clone() }
    }
}
