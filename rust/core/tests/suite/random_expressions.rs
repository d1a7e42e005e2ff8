//! Random expressions: values node by node, on a tape and simplified; derivatives by differences.
#![allow(clippy::needless_range_loop)] // one index into several columns

use std::collections::HashMap;
use std::sync::Arc;

use crate::common::trees::{self, NAMES, error_bound};
use crate::common::{Random, Run, parse, slope, values};
use phugoid::expr::{Expr, Graph};
use phugoid::internals::graph::Id;
use proptest::prelude::*;

const N: usize = 24;

/// Rounding errors of different orders of evaluation, as a part of the first-order bound.
const ROUNDING: f64 = 1e-14;

fn points(seed: u64) -> [Vec<f64>; 3] {
    let mut random = Random(seed);
    [0; 3].map(|_| (0..N).map(|_| random.between(-1.5, 1.5)).collect())
}

fn at(columns: &[Vec<f64>; 3], lane: usize) -> HashMap<Arc<str>, f64> {
    values(&[0, 1, 2].map(|i| (NAMES[i], columns[i][lane])))
}

/// An expression in a graph, with its derivatives with respect to the three symbols.
struct Differentiated {
    graph: Graph,
    symbols: [Id; 3],
    root: Id,
    gradient: Vec<Option<Id>>,
    /// Row, column and node of the lower triangle.
    hessian: Vec<(usize, usize, Id)>,
}

impl Differentiated {
    fn new(expr: &Expr) -> Self {
        let mut graph = Graph::new();
        let symbols = NAMES.map(|n| graph.symbol(n));
        let root = graph.import(expr, &HashMap::new());
        let gradient = graph.gradient(root, &symbols);
        let sparse = graph.hessian(root, &symbols);
        let hessian = sparse
            .rows
            .iter()
            .zip(&sparse.columns)
            .zip(&sparse.values)
            .map(|((&r, &c), &v)| (r, c, v))
            .collect();
        Differentiated { graph, symbols, root, gradient, hessian }
    }

    fn on_lanes(&self, nodes: &[Id], columns: &[Vec<f64>; 3]) -> Vec<Vec<f64>> {
        let lanes = self.symbols.iter().zip(columns).map(|(&s, c)| (s, &c[..])).collect();
        Run { lanes, uniforms: vec![] }.evaluate(&self.graph, nodes, N)
    }
}

/// Compares a computed derivative with the slope of a function of one symbol, where the
/// differences are sharp enough to judge it. Returns whether they were.
fn judge(computed: f64, f: &dyn Fn(f64) -> f64, x: f64, what: &str) -> Result<bool, TestCaseError> {
    let (coarse, fine) = (slope(f, x, 0.04), slope(f, x, 0.02));
    let allowed = 1e-6 * (1.0 + fine.abs());
    if (coarse - fine).abs() > 0.1 * allowed {
        return Ok(false);
    }
    prop_assert!((computed - fine).abs() <= allowed, "{what}: {computed}, by differences {fine}");
    Ok(true)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn tape_and_simplified_form_have_the_same_value(expr in trees::any(), seed: u64) {
        let columns = points(seed);
        let d = Differentiated::new(&expr);
        let simplified = expr.simplified();
        let found = &d.on_lanes(&[d.root], &columns)[0];
        for l in 0..N {
            let at = at(&columns, l);
            let bound = error_bound(&expr, &at);
            if !bound.is_finite() {
                continue;
            }
            let value = expr.evaluate(&at).unwrap();
            prop_assert!(value.is_finite());
            for (which, other) in [("tape", found[l]), ("simplified", simplified.evaluate(&at).unwrap())] {
                prop_assert!(
                    (other - value).abs() <= ROUNDING * bound,
                    "{which}: {other}, node by node {value}, bound {bound}\n{expr}"
                );
            }
        }
    }

    #[test]
    fn values_that_depend_on_parameters_alone_are_the_same(expr in trees::any(), seed: u64, which in 0..8usize) {
        let columns = points(seed);
        let d = Differentiated::new(&expr);
        let choose = |wanted: bool| (0..3).filter(move |&i| (which >> i & 1 == 1) == wanted);
        let run = Run {
            lanes: choose(false).map(|i| (d.symbols[i], &columns[i][..])).collect(),
            uniforms: choose(true).map(|i| (d.symbols[i], columns[i][0])).collect(),
        };
        let found = &run.evaluate(&d.graph, &[d.root], N)[0];
        for l in 0..N {
            let at = values(&[0, 1, 2].map(|i| (NAMES[i], columns[i][if which >> i & 1 == 1 { 0 } else { l }])));
            let bound = error_bound(&expr, &at);
            let value = expr.evaluate(&at).unwrap();
            prop_assert!(!bound.is_finite() || (found[l] - value).abs() <= ROUNDING * bound, "{expr}");
        }
    }

    #[test]
    fn first_derivatives_agree_with_differences(expr in trees::smooth(), seed: u64) {
        let columns = points(seed);
        let mut d = Differentiated::new(&expr);
        let zero = d.graph.zero();
        let nodes: Vec<Id> = d.gradient.iter().map(|g| g.unwrap_or(zero)).collect();
        let found = d.on_lanes(&nodes, &columns);
        let mut judged = 0;
        for l in 0..4 {
            for i in 0..3 {
                let f = |v: f64| {
                    let mut at = at(&columns, l);
                    at.insert(NAMES[i].into(), v);
                    expr.evaluate(&at).unwrap()
                };
                let x = columns[i][l];
                judged += usize::from(judge(found[i][l], &f, x, &format!("d/d{} of {expr}", NAMES[i]))?);
                if d.gradient[i].is_none() {
                    // A structural zero: the value does not move at all, beyond rounding.
                    let bound = error_bound(&expr, &at(&columns, l));
                    prop_assert!((f(x) - f(x + 0.7)).abs() <= 10.0 * ROUNDING * bound, "{expr}");
                }
            }
        }
        prop_assume!(judged > 0);
    }

    #[test]
    fn second_derivatives_agree_with_differences_of_the_first(expr in trees::smooth(), seed: u64) {
        let columns = points(seed);
        let d = Differentiated::new(&expr);
        let gradient: Vec<Expr> =
            d.gradient.iter().map(|g| g.map_or(Expr::constant(0.0), |g| d.graph.export(g))).collect();
        let nodes: Vec<Id> = d.hessian.iter().map(|h| h.2).collect();
        let found = d.on_lanes(&nodes, &columns);
        for row in 0..3 {
            for column in 0..=row {
                let entry = d.hessian.iter().position(|h| (h.0, h.1) == (row, column));
                for l in 0..2 {
                    let computed = entry.map_or(0.0, |e| found[e][l]);
                    // By rows and by columns: the matrix is symmetric.
                    for (f, x) in [(row, column), (column, row)] {
                        let moved = |v: f64| {
                            let mut at = at(&columns, l);
                            at.insert(NAMES[x].into(), v);
                            gradient[f].evaluate(&at).unwrap()
                        };
                        let what = format!("d²/d{}d{} of {expr}", NAMES[row], NAMES[column]);
                        judge(computed, &moved, columns[x][l], &what)?;
                    }
                }
            }
        }
        prop_assert!(d.hessian.iter().all(|h| h.1 <= h.0));
    }

    #[test]
    fn printed_text_reads_back_with_the_same_value(expr in trees::any(), seed: u64) {
        let columns = points(seed);
        let text = expr.to_string();
        for l in 0..4 {
            let at = at(&columns, l);
            let (value, bound) = (expr.evaluate(&at).unwrap(), error_bound(&expr, &at));
            let read = parse::evaluate(&text, &at);
            prop_assert!(!bound.is_finite() || (read - value).abs() <= ROUNDING * bound, "{text}");
        }
    }
}
