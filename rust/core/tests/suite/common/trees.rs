//! Random expression trees over three symbols, and how far rounding may move their values.

use std::collections::HashMap;
use std::sync::Arc;

use phugoid::expr::{Expr, Graph, Node, Op, atan2, le, lt, max, min, select};
use proptest::prelude::*;

pub const NAMES: [&str; 3] = ["a", "b", "c"];

fn leaf() -> impl Strategy<Value = Expr> {
    prop_oneof![
        4 => (0..3usize).prop_map(|i| Expr::symbol(NAMES[i])),
        1 => (-2.0..2.0).prop_map(Expr::constant),
        1 => prop_oneof![Just(0.0), Just(1.0), Just(-1.0), Just(2.0), Just(-0.5)].prop_map(Expr::constant),
    ]
}

/// A positive number, at least ½.
fn positive(x: &Expr) -> Expr {
    0.5 + x * x
}

/// One operation of one argument, the argument kept where it is smooth and of ordinary size.
fn unary(x: &Expr, choice: usize) -> Expr {
    let small = x.tanh();
    match choice {
        0 => -x,
        1 => x.sin(),
        2 => x.cos(),
        3 => small.tan(),
        4 => (0.9 * small).asin(),
        5 => (0.9 * small).acos(),
        6 => x.atan(),
        7 => small.sinh(),
        8 => small.cosh(),
        9 => small,
        10 => small.exp(),
        11 => positive(x).log(),
        12 => positive(x).sqrt(),
        13 => x.pow(2.0),
        14 => small.pow(3.0),
        15 => small.pow(5.0),
        16 => positive(x).pow(-0.5),
        17 => positive(x).pow(-3.0),
        _ => Expr::apply(Op::Recip, vec![positive(x)]),
    }
}

fn binary(x: &Expr, y: &Expr, choice: usize) -> Expr {
    match choice {
        0 => x + y,
        1 => x - y,
        2 => x * y,
        3 => x / positive(y),
        4 => positive(&x.tanh()).pow(y.tanh()),
        _ => atan2(x, positive(y)),
    }
}

/// Smooth trees of at most six levels.
pub fn smooth() -> impl Strategy<Value = Expr> {
    leaf().prop_recursive(6, 40, 2, |inner| {
        prop_oneof![
            (inner.clone(), 0..19usize).prop_map(|(x, choice)| unary(&x, choice)),
            (inner.clone(), inner.clone(), 0..6usize).prop_map(|(x, y, choice)| binary(&x, &y, choice)),
            // A part used twice.
            (inner, 0..6usize).prop_map(|(x, choice)| binary(&x.sin(), &x, choice)),
        ]
    })
}

/// Trees that have kinks and jumps besides.
pub fn any() -> impl Strategy<Value = Expr> {
    smooth().prop_recursive(3, 60, 4, |inner| {
        let pair = (inner.clone(), inner.clone());
        prop_oneof![
            pair.clone().prop_map(|(x, y)| min(x, y)),
            pair.clone().prop_map(|(x, y)| max(x, y)),
            inner.clone().prop_map(|x| x.abs()),
            inner.clone().prop_map(|x| x.sign()),
            (pair.clone(), inner.clone(), inner.clone(), 0..5usize).prop_map(|((x, y), yes, no, choice)| {
                let (less, at_most) = (lt(&x, &y), le(&no, &y));
                let condition = match choice {
                    0 => less,
                    1 => at_most,
                    2 => Expr::apply(Op::And, vec![less, at_most]),
                    3 => Expr::apply(Op::Or, vec![less, at_most]),
                    _ => Expr::apply(Op::Not, vec![less]),
                };
                select(condition, yes, no)
            }),
            (pair, 0..6usize).prop_map(|((x, y), choice)| binary(&x, &y, choice)),
        ]
    })
}

/// A first-order bound on what relative errors in every operation do to the value: |v| plus the
/// bounds of the arguments times the partial derivatives. Infinite where a comparison is so close
/// that rounding may turn it.
pub fn error_bound(root: &Expr, values: &HashMap<Arc<str>, f64>) -> f64 {
    let mut done: HashMap<*const Node, (f64, f64)> = HashMap::new();
    let mut partials: HashMap<Op, Vec<Expr>> = HashMap::new();
    root.visit(|e| {
        let args: Vec<(f64, f64)> = e.args().iter().map(|a| done[&std::ptr::from_ref(a.node())]).collect();
        let numbers: Vec<f64> = args.iter().map(|a| a.0).collect();
        let result = match e.node() {
            Node::Constant(c) | Node::Named(_, c) => (*c, 0.0),
            Node::Symbol(name) => (values[name], values[name].abs()),
            Node::Apply(op, _) => {
                let entry = op.entry();
                let value = (entry.value)(&numbers);
                let jump = match entry.op {
                    Op::Lt | Op::Le | Op::Min | Op::Max => (numbers[0] - numbers[1]).abs() < 1e-9,
                    Op::Sign | Op::Abs => numbers[0].abs() < 1e-9,
                    _ => false,
                };
                let slopes = partials.entry(entry.op).or_insert_with(|| slopes(entry.op));
                let pairs: Vec<(&str, f64)> = ARGUMENTS.into_iter().zip(numbers).collect();
                let at = super::values(&pairs);
                let carried: f64 = slopes
                    .iter()
                    .zip(&args)
                    .filter(|(_, arg)| arg.1 > 0.0)
                    .map(|(slope, arg)| (slope.evaluate(&at).unwrap().abs(), arg.1))
                    // What an argument does that min or max leaves out does not matter, be it without bound: 0·∞.
                    .filter(|(slope, _)| *slope > 0.0)
                    .map(|(slope, bound)| slope * bound)
                    .sum();
                (value, if jump { f64::INFINITY } else { value.abs() + carried })
            }
            Node::Lookup(..) => panic!("these trees hold no tables"),
        };
        done.insert(std::ptr::from_ref(e.node()), result);
    });
    done[&std::ptr::from_ref(root.node())].1
}

const ARGUMENTS: [&str; 3] = ["x0", "x1", "x2"];

/// Partial derivatives of an operation, as expressions of x0, x1, x2.
fn slopes(op: Op) -> Vec<Expr> {
    let mut graph = Graph::new();
    let args: Vec<_> = ARGUMENTS[..op.entry().arity].iter().map(|n| graph.symbol(n)).collect();
    let root = graph.apply(op, &args);
    let found = graph.gradient(root, &args);
    found.into_iter().map(|d| d.map_or(Expr::constant(0.0), |d| graph.export(d))).collect()
}
