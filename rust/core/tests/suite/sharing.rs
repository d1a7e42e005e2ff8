//! Equal parts are stored once, constants are folded, and zeros are known to be zero.

use std::collections::HashMap;

use phugoid::expr::{Expr, Graph, Op};
use phugoid::internals::graph::{Id, Item};
use phugoid::internals::tape::{Inputs, Tape};

fn symbols() -> [Expr; 3] {
    ["a", "b", "c"].map(Expr::symbol)
}

fn import(expr: &Expr) -> (Graph, Id) {
    let mut graph = Graph::new();
    let root = graph.import(expr, &HashMap::new());
    (graph, root)
}

fn count(expr: &Expr, op: Op) -> usize {
    let (graph, root) = import(expr);
    graph
        .reachable(&[root])
        .into_iter()
        .filter(|&id| matches!(graph.item(id), Item::Apply(o, _) if o == op))
        .count()
}

fn instructions(expr: &Expr) -> usize {
    let (mut graph, root) = import(expr);
    let lanes = ["a", "b", "c"].map(|n| graph.symbol(n)).to_vec();
    Tape::compile(&graph, &Inputs { lanes, uniforms: vec![] }, &[root]).unwrap().instructions()
}

#[test]
fn a_product_written_twice_is_computed_once() {
    let [a, b, _] = symbols();
    // sin(ab) + cos(ab): product, sine and cosine together, sum.
    assert_eq!(instructions(&((&a * &b).sin() + (&a * &b).cos())), 3);
    assert_eq!(count(&((&a * &b).sin() + (&a * &b).cos()), Op::Mul), 1);
    // ab + ab: product, doubled.
    assert_eq!(instructions(&(&a * &b + &a * &b)), 2);
    // The order of factors and terms does not matter, nor constants that scale one use.
    assert_eq!(count(&((&a * &b).sin() * (&b * &a).exp()), Op::Mul), 2);
    assert_eq!(count(&((&a + &b).sin() * (&b + &a).exp()), Op::Add), 1);
    assert_eq!(instructions(&((2.0 * &a * &b).sin() + (&a * &b).exp())), 5);
}

#[test]
fn quotients_by_the_same_number_share_the_reciprocal() {
    let [a, b, c] = symbols();
    assert_eq!(count(&(&a / &c + &b / &c), Op::Recip), 1);
    let slope = (&a / &c).derivative("c");
    assert_eq!(count(&((&a / &c) + slope), Op::Recip), 1);
}

#[test]
fn constants_fold() {
    let [a, ..] = symbols();
    let two = Expr::constant(2.0);
    let cases = [
        (&two + &two, 4.0),
        ((&two * 3.0).sqrt().pow(2.0) - 1.0, 5.0),
        (&a - &a, 0.0),
        (0.0 * a.sin(), 0.0),
        (a.pow(0.0), 1.0),
        (phugoid::expr::select(1.0, 7.0, a.log()), 7.0),
        (phugoid::expr::lt(1.0, 2.0), 1.0),
    ];
    for (expr, value) in cases {
        let found = expr.simplified().as_constant();
        assert!(found.is_some_and(|f| (f - value).abs() < 1e-14), "{expr} folds to {found:?}");
    }
    for (expr, text) in [
        (&a * 1.0 + 0.0, "a"),
        (-(-&a), "a"),
        (2.0 * (3.0 * &a), "6*a"),
        (a.pow(1.0), "a"),
        (&a * (&two - 1.0), "a"),
    ] {
        assert_eq!(expr.simplified().to_string(), text);
    }
}

#[test]
fn a_failure_in_constants_stays_visible() {
    let zero = Expr::constant(0.0);
    for (expr, text) in [((&zero - 1.0).log(), "log(-1)"), (1.0 / &zero, "1/0"), (zero.log(), "log(0)")] {
        assert_eq!(expr.simplified().to_string(), text);
        assert!(!expr.simplified().evaluate(&HashMap::new()).unwrap().is_finite());
    }
}

#[test]
fn derivatives_that_vanish_are_known_to_vanish() {
    let [a, b, c] = symbols();
    for expr in [
        &a * &b,
        &a * &b + 0.0 * &c,
        (&a + &c - &c) * &b,
        &a + &c.sign() * &b - c.sign() * &b,
        a.pow(c.pow(0.0)),
        phugoid::expr::select(phugoid::expr::lt(&c, 1.0), &a, &b),
    ] {
        let (mut graph, root) = import(&expr);
        let symbols = ["a", "b", "c"].map(|n| graph.symbol(n));
        assert!(graph.gradient(root, &symbols)[2].is_none(), "{expr} depends on c");
    }
    // A linear function has no second derivatives, a bilinear one a single one.
    for (expr, places) in [(&a + 2.0 * &b - &c, vec![]), (&a * &b + &c, vec![(1, 0)])] {
        let (mut graph, root) = import(&expr);
        let symbols = ["a", "b", "c"].map(|n| graph.symbol(n));
        let hessian = graph.hessian(root, &symbols);
        let found: Vec<(usize, usize)> = hessian.rows.into_iter().zip(hessian.columns).collect();
        assert_eq!(found, places, "{expr}");
    }
}
