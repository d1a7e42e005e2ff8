//! Parts that occur more than once are printed once, by name, and chains of any length are walked without recursion.

use crate::common::{close, parse, values};
use phugoid::expr::{Expr, gt, select};
use phugoid::internals::graph::Graph;
use phugoid::model::{Model, Parameter};

/// e = e·e + e, so many times: the tree has 4ⁿ nodes.
fn doubled(levels: usize, start: &Expr) -> Expr {
    (0..levels).fold(start.clone(), |e, _| &e * &e + &e)
}

/// where(x > 0, 0·x, where(x > 1, 1·x, ...)).
fn chain(levels: usize) -> Expr {
    let x = Expr::symbol("x");
    (0..levels).fold(Expr::constant(7.0), |e, k| select(gt(&x, k as f64), k as f64 * &x, e))
}

#[test]
fn shared_parts_have_names() {
    let x = Expr::symbol("x");
    assert_eq!(doubled(1, &x).to_string(), "x*x + x");
    let text = doubled(18, &x).to_string();
    assert!(
        text.starts_with("a = x*x + x; b = a*a + a; c = b*b + b; ") && text.ends_with("; q*q + q"),
        "{text}"
    );
    let latex = doubled(18, &x).latex();
    assert!(latex.starts_with(r"a = x \, x + x;\quad b = a \, a + a;\quad"), "{latex}");
}

#[test]
fn names_are_none_of_the_users_symbols() {
    let user = ["a", "b", "c1", "z"].map(Expr::symbol);
    let start = user.iter().skip(1).fold(user[0].clone(), |e, s| e + s);
    let expr = doubled(40, &(0.01 * start));
    let text = expr.to_string();
    assert!(text.len() < 2000, "{text}");
    let at = values(&[("a", 1.0), ("b", -2.5), ("c1", 0.25), ("z", 1.0)]);
    assert!(close(parse::evaluate(&text, &at), expr.evaluate(&at).unwrap(), 1e-9), "{text}");
}

#[test]
fn a_message_holds_the_beginning_of_a_long_expression() {
    let mut model = Model::new("long");
    model.state("x", "").unwrap();
    let tau = model.parameter(Parameter::new("tau", 0.1)).unwrap();
    let long = (0..1000).fold(Expr::symbol("x"), |e, k| e + f64::from(k) * Expr::symbol("x"));
    let text = model.delay(&long, &tau, "late").unwrap_err().to_string();
    assert!(text.chars().count() < 2000 && text.contains("characters"), "{text}");

    let undeclared = Expr::symbol(&"y".repeat(5000));
    model.equation("x", -undeclared).unwrap();
    model.output("x", tau, "").unwrap();
    assert!(model.check().unwrap_err().to_string().chars().count() <= 2000);
}

#[test]
fn a_chain_of_cases_has_a_derivative_in_proportion_to_its_length() {
    let nodes = |levels: usize| {
        let slope = chain(levels).derivative("x");
        let mut count = 0;
        slope.visit(|_| count += 1);
        count
    };
    let (short, long) = (nodes(200), nodes(400));
    assert!(long < 3 * short, "{short} nodes for 200 cases, {long} for 400");
    let slope = chain(400).derivative("x");
    for x in [-1.0_f64, 0.5, 3.5, 398.5, 1000.0] {
        let k = x.ceil() - 1.0;
        let expected = if x < 0.0 { 0.0 } else { k.min(399.0) };
        assert_eq!(slope.evaluate(&values(&[("x", x)])).unwrap(), expected, "at {x}");
    }
}

#[test]
fn what_is_off_stays_off_in_a_chain() {
    // √(k x) is not differentiable at 0, where every case but the last is off.
    let x = Expr::symbol("x");
    let mut e = Expr::constant(0.0);
    for k in 1..20 {
        e = select(gt(&x, f64::from(k)), (f64::from(k) * &x).sqrt(), 2.0 * &e);
    }
    let mut graph = Graph::new();
    let root = graph.import(&e, &Default::default());
    let symbol = graph.symbol("x");
    let slope = graph.gradient(root, &[symbol])[0].unwrap();
    assert_eq!(graph.export(slope).evaluate(&values(&[("x", 0.0)])).unwrap(), 0.0);
    let at = values(&[("x", 10.5)]);
    let expected = 2f64.powi(9) * 0.5 * (10.0f64 / 10.5).sqrt();
    assert!(close(graph.export(slope).evaluate(&at).unwrap(), expected, 1e-12));
}

#[test]
fn long_chains_are_walked_on_a_small_stack() {
    let walk = || {
        let mut model = Model::new("chain");
        model.state("x", "").unwrap();
        model.equation("x", -chain(20_000)).unwrap();
        model.output("y", chain(20_000), "").unwrap();
        assert!(format!("{model:?}").len() > 20_000);
        let slope = (-chain(20_000)).derivative("x");
        assert_eq!(slope.evaluate(&values(&[("x", 3.5)])).unwrap(), -3.0);
        #[cfg(feature = "serde")]
        assert_eq!(Model::from_json(&model.to_json()).unwrap(), model);
        assert_eq!(model.compile().unwrap().outputs.len(), 1);
    };
    std::thread::Builder::new().stack_size(256 * 1024).spawn(walk).unwrap().join().unwrap();
}
