//! Sums of 100,000 terms are deep trees: nothing that walks them may exhaust the stack.

use std::collections::HashMap;

use crate::common::values;
use phugoid::expr::{Expr, Graph};
#[cfg(feature = "serde")]
use phugoid::internals::pool::Pool;
#[cfg(feature = "serde")]
use phugoid::model::Model;

const TERMS: usize = 100_000;

/// Runs a test on a stack on which a recursion of 100,000 levels has no room.
fn on_a_small_stack(test: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new().stack_size(256 * 1024).spawn(test).unwrap().join().unwrap();
}

/// x sin(x) + x + ... + x, from the left or from the right.
fn deep(from_left: bool) -> Expr {
    let x = Expr::symbol("x");
    let mut sum = &x * x.sin();
    for _ in 1..TERMS {
        sum = if from_left { sum + &x } else { &x + sum };
    }
    sum
}

#[test]
fn dropping() {
    on_a_small_stack(|| {
        for from_left in [true, false] {
            drop(deep(from_left));
        }
        let kept = deep(true);
        let copy = kept.clone();
        std::thread::spawn(move || drop(copy)).join().unwrap();
        drop(kept);
    });
}

#[test]
fn evaluating_and_comparing() {
    on_a_small_stack(|| {
        let (left, right) = (deep(true), deep(false));
        let at = values(&[("x", 0.5)]);
        let expected = 0.5 * 0.5f64.sin() + 0.5 * (TERMS - 1) as f64;
        for sum in [&left, &right] {
            assert!((sum.evaluate(&at).unwrap() - expected).abs() < 1e-9 * expected);
            assert_eq!(sum.symbols().len(), 1);
        }
        assert!(left == deep(true) && left != right);
        let y = left.substitute(&HashMap::from([("x".into(), Expr::symbol("y"))]));
        assert!(y.symbols().contains("y") && !y.symbols().contains("x"));
    });
}

#[test]
fn importing_and_differentiating() {
    on_a_small_stack(|| {
        for from_left in [true, false] {
            let sum = deep(from_left);
            let mut graph = Graph::new();
            let root = graph.import(&sum, &HashMap::new());
            let x = graph.symbol("x");
            let slope = graph.gradient(root, &[x])[0].unwrap();
            let found = graph.export(slope).evaluate(&values(&[("x", 0.5)])).unwrap();
            let expected = 0.5f64.sin() + 0.5 * 0.5f64.cos() + (TERMS - 1) as f64;
            assert!((found - expected).abs() < 1e-9 * expected);
        }
    });
}

#[test]
fn printing() {
    on_a_small_stack(|| {
        let left = deep(true).to_string();
        assert!(left.starts_with("x*sin(x) + x + x + ") && left.len() < 5 * TERMS);
        let right = deep(false).to_string();
        assert!(right.starts_with("x + x + ") && right.ends_with(" + x*sin(x)"), "{}", &right[..40]);
        assert!(deep(true).latex().len() < 5 * TERMS);
    });
}

#[cfg(feature = "serde")]
#[test]
fn saving_and_loading() {
    on_a_small_stack(|| {
        for from_left in [true, false] {
            let sum = deep(from_left);
            let text = Pool::new([&sum]).to_json().unwrap();
            assert!(Pool::from_json(&text).unwrap().expressions().unwrap()[0] == sum);
        }
        let mut model = Model::new("deep");
        model.state("x", "").unwrap();
        model.equation("x", deep(true)).unwrap();
        model.output("y", deep(false), "").unwrap();
        assert!(Model::from_json(&model.to_json()).unwrap() == model);
        assert_eq!(model.compile().unwrap().dynamics.len(), 1);
    });
}
