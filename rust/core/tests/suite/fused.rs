//! Products fused with sums, operands in lanes or the same on all, against plain arithmetic.
#![allow(clippy::needless_range_loop)] // one index into several columns

use crate::common::{Random, Run};
use phugoid::expr::Graph;
use phugoid::internals::graph::Id;
use phugoid::internals::tape::{Inputs, Tape};

const N: usize = 64;

type Combine = (fn(&mut Graph, Id, Id) -> Id, fn(f64, f64) -> f64, &'static str);

const FORMS: [Combine; 4] = [
    (|g, p, c| g.add(p, c), |p, c| p + c, "a b + c"),
    (|g, p, c| g.add(c, p), |p, c| p + c, "c + a b"),
    (|g, p, c| g.sub(p, c), |p, c| p - c, "a b - c"),
    (|g, p, c| g.sub(c, p), |p, c| c - p, "c - a b"),
];

fn check(product_is_used_again: bool) {
    let mut random = Random(5);
    let columns: Vec<Vec<f64>> =
        (0..3).map(|_| (0..N).map(|_| random.between(-2.0, 2.0)).collect()).collect();
    for (combine, value, name) in FORMS {
        for uniform in 0..8usize {
            let mut graph = Graph::new();
            let symbols = ["a", "b", "c"].map(|n| graph.symbol(n));
            let product = graph.mul(symbols[0], symbols[1]);
            let root = combine(&mut graph, product, symbols[2]);
            let is_uniform = |i: usize| uniform >> i & 1 == 1;
            let choose = |wanted: bool| (0..3).filter(move |&i| is_uniform(i) == wanted);
            let run = Run {
                lanes: choose(false).map(|i| (symbols[i], &columns[i][..])).collect(),
                uniforms: choose(true).map(|i| (symbols[i], columns[i][0])).collect(),
            };
            let outputs = if product_is_used_again { vec![root, product] } else { vec![root] };
            let inputs = Inputs { lanes: symbols.to_vec(), uniforms: vec![] };
            assert_eq!(
                Tape::compile(&graph, &inputs, &outputs).unwrap().instructions(),
                outputs.len(),
                "{name}"
            );
            let found = run.evaluate(&graph, &outputs, N);
            for l in 0..N {
                let [a, b, c] = [0, 1, 2].map(|i| columns[i][if is_uniform(i) { 0 } else { l }]);
                let size = (a * b).abs() + c.abs();
                let error = (found[0][l] - value(a * b, c)).abs();
                assert!(
                    error <= 2.0 * f64::EPSILON * size,
                    "{name}, uniform {uniform:03b}, lane {l}: {error:e}"
                );
                if product_is_used_again {
                    assert_eq!(found[1][l], a * b, "{name}, uniform {uniform:03b}, lane {l}");
                }
            }
        }
    }
}

#[test]
fn a_product_used_once_is_fused_to_the_same_value() {
    check(false);
}

#[test]
fn a_product_used_again_keeps_its_own_value() {
    check(true);
}

#[test]
fn a_sum_of_two_products_holds_both() {
    let mut random = Random(6);
    let columns: Vec<Vec<f64>> =
        (0..4).map(|_| (0..N).map(|_| random.between(-2.0, 2.0)).collect()).collect();
    let mut graph = Graph::new();
    let s = ["a", "b", "c", "d"].map(|n| graph.symbol(n));
    let (ab, cd) = (graph.mul(s[0], s[1]), graph.mul(s[2], s[3]));
    let (sum, difference) = (graph.add(ab, cd), graph.sub(ab, cd));
    for root in [sum, difference] {
        let lanes = s.iter().zip(&columns).map(|(&id, c)| (id, &c[..])).collect();
        let found = &Run { lanes, uniforms: vec![] }.evaluate(&graph, &[root], N)[0];
        for l in 0..N {
            let (p, q) = (columns[0][l] * columns[1][l], columns[2][l] * columns[3][l]);
            let expected = if root == sum { p + q } else { p - q };
            assert!((found[l] - expected).abs() <= 2.0 * f64::EPSILON * (p.abs() + q.abs()));
        }
    }
}

#[test]
fn sine_and_cosine_of_one_angle_share_an_instruction() {
    use phugoid::expr::Op;
    let mut graph = Graph::new();
    let x = graph.symbol("x");
    let (sin, cos) = (graph.unary(Op::Sin, x), graph.unary(Op::Cos, x));
    let inputs = Inputs { lanes: vec![x], uniforms: vec![] };
    assert_eq!(Tape::compile(&graph, &inputs, &[sin, cos]).unwrap().instructions(), 1);
    let column: Vec<f64> = (0..N).map(|l| l as f64 * 0.37 - 9.0).collect();
    for outputs in [[sin, cos], [cos, sin]] {
        let found = Run { lanes: vec![(x, &column)], uniforms: vec![] }.evaluate(&graph, &outputs, N);
        for (&output, found) in outputs.iter().zip(&found) {
            for (x, found) in column.iter().zip(found) {
                assert_eq!(
                    *found,
                    if output == sin {
                        (Op::Sin.entry().value)(&[*x])
                    } else {
                        (Op::Cos.entry().value)(&[*x])
                    }
                );
            }
        }
    }
}
