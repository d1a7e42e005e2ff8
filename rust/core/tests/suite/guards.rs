//! `where` keeps what is not finite on the branch not taken out of values and derivatives.
#![allow(clippy::needless_range_loop)] // one index into several columns

use std::collections::HashMap;

use crate::common::{Run, close, slope, values};
use phugoid::expr::{Expr, Graph, Op, atan2, gt, le, lt, max, min, select};
use phugoid::internals::graph::Id;
use phugoid::internals::tape::{Arguments, Function, LANE_MULTIPLE, Pairs, Workspace};

fn x() -> Expr {
    Expr::symbol("x")
}

fn y() -> Expr {
    Expr::symbol("y")
}

/// √x where x > 0, and 0 elsewhere.
fn guarded() -> Expr {
    select(gt(x(), 0.0), x().sqrt(), 0.0)
}

/// Expressions that are finite and smooth in x and y at x < 0, and at x = 0 as well.
fn cases() -> Vec<Expr> {
    let (r, yes) = (x().sqrt(), gt(x(), 0.0));
    vec![
        guarded(),
        select(le(x(), 0.0), 0.0, &r),
        select(&yes, &r, y()),
        select(le(x(), 0.0), y().sin(), &r),
        select(&yes, x().log(), 0.0),
        select(&yes, 1.0 / x(), 0.0),
        select(&yes, x().pow(1.5), y() * y()),
        select(&yes, x().pow(y()), y()),
        select(&yes, &r / y(), 1.0),
        select(lt(0.0, x()), y() * &r, -1.0),
        // Inside sums, products, quotients and functions.
        y() * guarded(),
        guarded() * y().sin(),
        -guarded() * 3.0,
        guarded() + y(),
        (guarded() + y()).pow(2.0),
        (y() - guarded()).pow(3.0),
        guarded() * guarded(),
        guarded().sin() * y(),
        (guarded() * y()).exp(),
        y() / (1.0 + guarded()),
        guarded() / (2.0 + y()),
        atan2(guarded(), 1.0 + y()),
        max(guarded(), -1.0) * min(y(), 5.0),
        x() * guarded() + y(),
        // Parts used more than once within the branch.
        select(&yes, &r + r.pow(3.0), 0.0),
        select(&yes, &r * r.sin() + r.exp(), y()),
        select(&yes, r.sin() - 2.0 * r.cos(), 1.0),
        y() * select(&yes, &r + y() * r.pow(3.0), x() * y()),
        // Nested, and one part under several conditions.
        select(&yes, select(lt(x(), 1.0), &r, 1.0), 0.0),
        select(gt(x(), 1.0), 1.0, select(&yes, &r, 0.0)),
        select(&yes, &r, 0.0) + select(gt(x(), 0.5), &r, 0.0),
        select(&yes, &r, 0.0) - y() * select(gt(x(), 0.5), &r * y(), 2.0),
        (select(&yes, &r, 0.0) + select(gt(x(), 0.5), &r, y())) * (1.0 + y()),
        select(Expr::apply(Op::And, vec![yes.clone(), gt(y(), -9.0)]), &r, 0.0),
    ]
}

fn evaluate(expr: &Expr, x: f64, y: f64) -> f64 {
    expr.evaluate(&values(&[("x", x), ("y", y)])).unwrap()
}

struct Derivatives {
    graph: Graph,
    symbols: [Id; 2],
    /// Value, first and second derivatives, with their names.
    nodes: Vec<(String, Id)>,
}

fn differentiate(expr: &Expr) -> Derivatives {
    let mut graph = Graph::new();
    let symbols = ["x", "y"].map(|n| graph.symbol(n));
    let root = graph.import(expr, &HashMap::new());
    let zero = graph.zero();
    let mut nodes = vec![("value".to_owned(), root)];
    let gradient = graph.gradient(root, &symbols);
    for (i, slope) in gradient.into_iter().enumerate() {
        let slope = slope.unwrap_or(zero);
        nodes.push((format!("d/d{}", ["x", "y"][i]), slope));
        for (j, second) in graph.gradient(slope, &symbols).into_iter().enumerate() {
            nodes.push((format!("d²/d{}d{}", ["x", "y"][i], ["x", "y"][j]), second.unwrap_or(zero)));
        }
    }
    Derivatives { graph, symbols, nodes }
}

/// At x < 0 (the branch with √x is off) and at the switch itself.
const OFF: [f64; 4] = [-1.0, -1e-300, 0.0, -7.5];

#[test]
fn derivatives_are_finite_and_right_where_the_branch_is_off() {
    for expr in cases() {
        let d = differentiate(&expr);
        let ids: Vec<Id> = d.nodes.iter().map(|n| n.1).collect();
        let ys = [0.8; OFF.len()];
        let run = Run { lanes: vec![(d.symbols[0], &OFF), (d.symbols[1], &ys)], uniforms: vec![] };
        let found = run.evaluate(&d.graph, &ids, OFF.len());
        for (l, &x) in OFF.iter().enumerate() {
            for ((name, id), found) in d.nodes.iter().zip(&found) {
                let number = found[l];
                assert!(number.is_finite(), "{name} of {expr} is {number} at x = {x}");
                let node = evaluate(&d.graph.export(*id), x, ys[l]);
                assert!(close(number, node, 1e-13), "{name} of {expr} at x = {x}: {number} and {node}");
            }
        }
        // Differences of the value and of first derivatives, well inside the branch.
        for (f, of) in [(0, [1, 4]), (1, [2, 3]), (4, [5, 6])] {
            let f = d.graph.export(d.nodes[f].1);
            for (i, &node) in of.iter().enumerate() {
                let (x, y) = (-1.0, 0.8);
                let moved = |v: f64| if i == 0 { evaluate(&f, v, y) } else { evaluate(&f, x, v) };
                let expected = slope(moved, if i == 0 { x } else { y }, 0.05);
                let number = found[node][0];
                assert!(
                    (number - expected).abs() < 1e-8 * (1.0 + expected.abs()),
                    "{} of {expr}: {number}, by differences {expected}",
                    d.nodes[node].0
                );
            }
        }
    }
}

#[test]
fn derivatives_are_right_where_the_branch_is_on() {
    for expr in cases() {
        let d = differentiate(&expr);
        let (x, y) = (1.7, 0.8);
        for (f, of) in [(0, [1, 4]), (1, [2, 3]), (4, [5, 6])] {
            let f = d.graph.export(d.nodes[f].1);
            for (i, &node) in of.iter().enumerate() {
                let moved = |v: f64| if i == 0 { evaluate(&f, v, y) } else { evaluate(&f, x, v) };
                let expected = slope(moved, if i == 0 { x } else { y }, 0.05);
                let number = evaluate(&d.graph.export(d.nodes[node].1), x, y);
                assert!(
                    (number - expected).abs() < 1e-8 * (1.0 + expected.abs()),
                    "{} of {expr}: {number}, by differences {expected}",
                    d.nodes[node].0
                );
            }
        }
    }
}

/// The Hessian of a model is that of a weighted sum, in which one √x may stand under the
/// conditions of several equations.
#[test]
fn the_weighted_hessian_of_several_functions_is_finite() {
    let r = x().sqrt();
    let functions = [
        select(gt(x(), 0.0), &r, 0.0),
        select(gt(x(), 0.5), &r * y(), 2.0),
        select(le(x(), 0.0), y(), r.pow(3.0)),
    ];
    let mut graph = Graph::new();
    let states = ["x", "y"].map(|n| graph.symbol(n)).to_vec();
    let roots = functions.iter().map(|f| graph.import(f, &HashMap::new())).collect();
    let arguments = Arguments { data: vec![], states, parameters: vec![] };
    let f = Function::new(graph, &arguments, roots, Pairs::Kept).unwrap();
    let mut workspace = Workspace::default();
    let n = LANE_MULTIPLE;
    let registers = workspace.registers(&f.hessian, n);
    // x, y, then three weights.
    for (register, value) in registers.chunks_exact_mut(n).zip([-1.0, 0.8, 0.3, -0.7, 1.1]) {
        register.fill(value);
        register[0] = if value == -1.0 { 0.0 } else { value };
    }
    let mut uniforms = Vec::new();
    f.hessian.uniforms(&[], &mut uniforms);
    f.hessian.run(registers, &uniforms, n);
    for (operand, place) in f.hessian.outputs.iter().zip(f.hessian_pattern.iter()) {
        let value = f.hessian.read(*operand, registers, &uniforms, n);
        for l in 0..n {
            assert_eq!(value.at(l), 0.0, "entry {place:?} on lane {l}");
        }
    }
}
