//! Every operation of the table: its value on lanes and its first and second derivatives.
#![allow(clippy::needless_range_loop)] // one index into several columns

use std::collections::HashMap;

use crate::common::{Random, Run, close, slope, ulps, values};
use phugoid::expr::{Expr, Graph, Op};
use phugoid::internals::graph::Id;
use phugoid::internals::operations::{Entry, TABLE};

const N: usize = 104; // more than a block, and no multiple of it
const NAMES: [&str; 3] = ["a", "b", "c"];

/// Kinks, jumps and poles: zero of an argument, equality of two.
const CLEARANCE: f64 = 0.15;

/// A regular point of an operation: inside its domain, away from kinks, jumps and poles.
fn regular(entry: &Entry, random: &mut Random) -> Vec<f64> {
    loop {
        let reach = if entry.op == Op::Tan { 1.2 } else { 2.5 };
        let within = |&(low, high): &(f64, f64), random: &mut Random| {
            let (low, high) = (f64::max(low, -reach), f64::min(high, reach));
            let margin = 0.05 * (high - low);
            random.between(low + margin, high - margin)
        };
        let mut x: Vec<f64> = entry.domain.iter().map(|d| within(d, random)).collect();
        if entry.op == Op::Where {
            x[0] = if x[0] < 0.0 { 0.0 } else { 1.0 };
        }
        let apart = entry.arity < 2 || (x[0] - x[1]).abs() > CLEARANCE;
        if apart && x.iter().skip(usize::from(entry.op == Op::Where)).all(|x| x.abs() > CLEARANCE) {
            return x;
        }
    }
}

/// Columns of regular points: `[argument][lane]`.
fn regular_columns(entry: &Entry, seed: u64) -> Vec<Vec<f64>> {
    let mut random = Random(seed);
    let points: Vec<Vec<f64>> = (0..N).map(|_| regular(entry, &mut random)).collect();
    (0..entry.arity).map(|i| points.iter().map(|x| x[i]).collect()).collect()
}

fn applied(entry: &Entry) -> (Graph, Vec<Id>, Id) {
    let mut graph = Graph::new();
    let args: Vec<Id> = NAMES[..entry.arity].iter().map(|n| graph.symbol(n)).collect();
    let root = graph.apply(entry.op, &args);
    (graph, args, root)
}

/// The value of a node at a point, node by node.
fn at(expr: &Expr, x: &[f64]) -> f64 {
    let pairs: Vec<(&str, f64)> = NAMES.iter().copied().zip(x.iter().copied()).collect();
    expr.evaluate(&values(&pairs)).unwrap()
}

/// A quotient is stored as a · (1/b), so it is rounded once more.
const LAST_PLACES: u64 = 2;

#[test]
fn lanes_and_uniforms_have_the_value_of_the_table() {
    for entry in &TABLE {
        let columns = regular_columns(entry, 1);
        let (graph, args, root) = applied(entry);
        for uniform in 0..1 << entry.arity {
            // Bit i: argument i is the same on all lanes, a parameter.
            let is_uniform = |i: usize| uniform >> i & 1 == 1;
            let choose = |wanted: bool| (0..entry.arity).filter(move |&i| is_uniform(i) == wanted);
            let run = Run {
                lanes: choose(false).map(|i| (args[i], &columns[i][..])).collect(),
                uniforms: choose(true).map(|i| (args[i], columns[i][0])).collect(),
            };
            let found = &run.evaluate(&graph, &[root], N)[0];
            for l in 0..N {
                let x: Vec<f64> =
                    (0..entry.arity).map(|i| columns[i][if is_uniform(i) { 0 } else { l }]).collect();
                let expected = (entry.value)(&x);
                assert!(expected.is_finite(), "{} at {x:?}", entry.name);
                let distance = ulps(found[l], expected);
                assert!(
                    distance <= LAST_PLACES,
                    "{} at {x:?}: {} on the tape, {expected} in the table ({distance} ulp)",
                    entry.name,
                    found[l]
                );
            }
        }
    }
}

#[test]
fn special_arguments_have_the_value_of_the_table() {
    let special =
        [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 1e-300, 1e300, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
    for entry in TABLE.iter().filter(|e| e.op != Op::Div) {
        let count = special.len().pow(entry.arity as u32);
        let column = |i: usize| -> Vec<f64> {
            (0..count).map(|l| special[l / special.len().pow(i as u32) % special.len()]).collect()
        };
        let columns: Vec<Vec<f64>> = (0..entry.arity).map(column).collect();
        let (graph, args, root) = applied(entry);
        let lanes = args.iter().zip(&columns).map(|(&a, c)| (a, &c[..])).collect();
        let found = &Run { lanes, uniforms: vec![] }.evaluate(&graph, &[root], count)[0];
        for l in 0..count {
            let x: Vec<f64> = columns.iter().map(|c| c[l]).collect();
            let expected = (entry.value)(&x);
            assert!(
                ulps(found[l], expected) <= LAST_PLACES,
                "{} at {x:?}: {} on the tape, {expected} in the table",
                entry.name,
                found[l]
            );
        }
    }
}

/// Repeated multiplication in place of `powf`: each product rounds once.
#[test]
fn whole_powers_agree_with_the_table() {
    for exponent in (-9i32..=9).chain([-64, 31, 64, 65]) {
        let mut graph = Graph::new();
        let (x, y) = (graph.symbol("a"), graph.constant(f64::from(exponent)));
        let root = graph.apply(Op::Pow, &[x, y]);
        let mut random = Random(2);
        let column: Vec<f64> =
            (0..N).map(|l| random.between(0.3, 2.0) * if l % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let run = Run { lanes: vec![(x, &column)], uniforms: vec![] };
        let found = &run.evaluate(&graph, &[root], N)[0];
        for (x, found) in column.iter().zip(found) {
            let expected = (Op::Pow.entry().value)(&[*x, f64::from(exponent)]);
            let allowed = 1 + exponent.unsigned_abs();
            assert!(ulps(*found, expected) <= u64::from(allowed), "{x}^{exponent}: {found} not {expected}");
        }
    }
}

#[test]
fn first_derivatives_agree_with_differences() {
    for entry in &TABLE {
        let columns = regular_columns(entry, 3);
        let (mut graph, args, root) = applied(entry);
        let expr = graph.export(root);
        let gradient = graph.gradient(root, &args);
        let zero = graph.zero();
        let nodes: Vec<Id> = gradient.iter().map(|g| g.unwrap_or(zero)).collect();
        let lanes = args.iter().zip(&columns).map(|(&a, c)| (a, &c[..])).collect();
        let found = Run { lanes, uniforms: vec![] }.evaluate(&graph, &nodes, N);
        compare(entry, &columns, 1e-8, &|i, l, x| (found[i][l], at(&expr, x)));
    }
}

#[test]
fn second_derivatives_agree_with_differences_of_the_first() {
    for entry in &TABLE {
        let columns = regular_columns(entry, 4);
        let (mut graph, args, root) = applied(entry);
        for slope_node in graph.gradient(root, &args).into_iter().flatten() {
            let expr = graph.export(slope_node);
            let second = graph.gradient(slope_node, &args);
            let zero = graph.zero();
            let nodes: Vec<Id> = second.iter().map(|g| g.unwrap_or(zero)).collect();
            let lanes = args.iter().zip(&columns).map(|(&a, c)| (a, &c[..])).collect();
            let found = Run { lanes, uniforms: vec![] }.evaluate(&graph, &nodes, N);
            compare(entry, &columns, 1e-6, &|i, l, x| (found[i][l], at(&expr, x)));
        }
    }
}

type Both<'a> = dyn Fn(usize, usize, &[f64]) -> (f64, f64) + 'a;

/// Compares the derivative with respect to each argument with the slope of the function:
/// `both(i, l, x)` is the derivative in argument i on lane l, and the function at x.
fn compare(entry: &Entry, columns: &[Vec<f64>], relative: f64, both: &Both) {
    for i in 0..entry.arity {
        if entry.op == Op::Where && i == 0 {
            continue; // piecewise constant, with a jump at 0
        }
        for l in 0..columns[0].len() {
            let x: Vec<f64> = columns.iter().map(|c| c[l]).collect();
            let (low, high) = entry.domain[i];
            let room = [1.0, x[i].abs(), x[i] - low, high - x[i]].into_iter().fold(f64::INFINITY, f64::min);
            let moved = |v: f64| {
                let mut y = x.clone();
                y[i] = v;
                both(i, l, &y).1
            };
            let (found, expected) = (both(i, l, &x).0, slope(moved, x[i], 0.05 * room));
            // Where the derivative vanishes the differences leave their rounding errors.
            let size = both(i, l, &x).1.abs().max(1.0) / room;
            assert!(
                close(found, expected, relative) || (found - expected).abs() < 1e-12 * size,
                "d {}/d{} at {x:?}: {found}, by differences {expected}",
                entry.name,
                NAMES[i]
            );
        }
    }
}

#[test]
fn derivatives_outside_the_usual_quadrant_hold_too() {
    // The domain in the table is where any argument is safe; these are safe as well.
    let cases: [(Op, &[f64]); 5] = [
        (Op::Atan2, &[0.7, -1.3]),
        (Op::Atan2, &[-0.7, -1.3]),
        (Op::Recip, &[-0.8]),
        (Op::Tan, &[2.5]),
        (Op::Div, &[0.3, -2.0]),
    ];
    for (op, x) in cases {
        let (mut graph, args, root) = applied(op.entry());
        let expr = graph.export(root);
        for (i, derivative) in graph.gradient(root, &args).into_iter().enumerate() {
            let found = at(&graph.export(derivative.unwrap()), x);
            let moved = |v: f64| {
                let mut y = x.to_vec();
                y[i] = v;
                at(&expr, &y)
            };
            let expected = slope(moved, x[i], 0.02);
            assert!(close(found, expected, 1e-8), "{op:?} at {x:?}: {found}, by differences {expected}");
        }
    }
}

#[test]
fn a_power_with_a_constant_exponent_takes_a_negative_base() {
    let x = Expr::symbol("a");
    for exponent in [-5.0, -3.0, -2.0, -1.0, 2.0, 3.0, 4.0, 7.0] {
        let first = x.pow(exponent).derivative("a");
        let second = first.derivative("a");
        let base: f64 = -1.3;
        let expected = exponent * base.powf(exponent - 1.0);
        assert!(close(at(&first, &[base]), expected, 1e-14), "{exponent}: {}", at(&first, &[base]));
        let expected = exponent * (exponent - 1.0) * base.powf(exponent - 2.0);
        assert!(close(at(&second, &[base]), expected, 1e-14), "{exponent}: {}", at(&second, &[base]));
    }
}

#[test]
fn an_operation_is_found_by_its_name_alone() {
    let mut names: HashMap<&str, Op> = HashMap::new();
    for entry in &TABLE {
        assert!(names.insert(entry.name, entry.op).is_none(), "two operations are called {}", entry.name);
        assert_eq!(Op::from_name(entry.name), Some(entry.op));
    }
    assert_eq!(Op::from_name("sine"), None);
}
