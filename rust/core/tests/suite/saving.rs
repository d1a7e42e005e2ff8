//! Saved expressions and models come back exactly; damaged text is an error.

#![cfg(feature = "serde")]

use crate::common::models::{self, lift_table, lookup, moment_table};
use crate::common::{Random, trees};
use phugoid::ErrorKind;
use phugoid::expr::Expr;
use phugoid::internals::pool::Pool;
use phugoid::model::{Model, Parameter};
use proptest::prelude::*;

fn round_trip(exprs: &[Expr]) -> Vec<Expr> {
    let text = Pool::new(exprs).to_json().unwrap();
    Pool::from_json(&text).unwrap().expressions().unwrap()
}

proptest! {
    #[test]
    fn expressions_come_back_equal(
        exprs in proptest::collection::vec(trees::any(), 1..6),
        with_tables: bool,
    ) {
        let mut exprs = exprs;
        if with_tables {
            let (first, last) = (exprs[0].clone(), exprs[exprs.len() - 1].clone());
            exprs.push(lookup(&lift_table(), &[&first]) * lookup(&moment_table(), &[&first, &last]).sin());
            exprs.push(lookup(&lift_table(), &[&last]).derivative("a"));
        }
        prop_assert_eq!(round_trip(&exprs), exprs);
    }

    #[test]
    fn numbers_come_back_to_the_bit(bits: u64) {
        let number = f64::from_bits(bits);
        prop_assume!(number.is_finite());
        let back = round_trip(&[Expr::constant(number)])[0].as_constant().unwrap();
        prop_assert_eq!(back.to_bits(), number.to_bits());
    }

    #[test]
    fn named_constants_come_back_beside_equal_numbers(expr in trees::any(), bits: u64) {
        let number = f64::from_bits(bits);
        prop_assume!(number.is_finite());
        let exprs = [Expr::named("S", number) * &expr, number * &expr, Expr::named("T", number) + expr];
        prop_assert_eq!(round_trip(&exprs), exprs);
    }

    #[test]
    fn damaged_text_never_panics(seed: u64) {
        let mut random = Random(seed);
        let text = models::nonlinear().to_json();
        let mut bytes = text.into_bytes();
        for _ in 0..1 + random.bits() % 4 {
            let at = (random.bits() % bytes.len() as u64) as usize;
            match random.bits() % 4 {
                0 => bytes[at] = (random.bits() % 128) as u8,
                1 => bytes[at] = b"0123456789-.e[]{},:\"n"[(random.bits() % 21) as usize],
                2 => { bytes.remove(at); }
                _ => bytes.truncate(at.max(10)),
            }
        }
        let damaged = String::from_utf8_lossy(&bytes);
        if let Ok(model) = Model::from_json(&damaged) {
            // What can still be read can be used, or says why not.
            if let Ok(compiled) = model.compile() {
                let mut graph = compiled.graph;
                graph.jacobian(&compiled.dynamics, &compiled.states);
            }
        }
    }
}

#[test]
fn a_part_used_twice_is_saved_once() {
    let a = Expr::symbol("a");
    let part = (&a + 1.0).sin();
    let text = Pool::new(&[&part * &part, part.exp()]).to_json().unwrap();
    assert_eq!(text.matches("\"sin\"").count(), 1, "{text}");
    let table = lift_table();
    let text = Pool::new(&[lookup(&table, &[&a]), lookup(&lift_table(), &[&part])]).to_json().unwrap();
    assert_eq!(text.matches("CLtab").count(), 1, "{text}");
}

#[test]
fn models_come_back_equal() {
    for model in [models::linear(), models::nonlinear(), models::scalar()] {
        let text = model.to_json();
        let back = Model::from_json(&text).unwrap();
        assert_eq!(back, model);
        assert_eq!(back.to_json(), text);
    }
}

#[test]
fn a_loaded_model_gives_the_same_numbers() {
    use phugoid::collocation::{Collocation, Settings};
    use phugoid::nlp::Nlp;
    let model = models::nonlinear();
    let loaded = Model::from_json(&model.to_json()).unwrap();
    let record = models::record(&model, "run", 30, true, 1);
    let build = |m: &Model| {
        Collocation::new(m, std::slice::from_ref(&record), models::mixed_noise(m), &Settings::default())
            .unwrap()
    };
    let (one, two) = (build(&model), build(&loaded));
    let xi = models::guess(&one, 2);
    assert_eq!(one.objective(&xi).unwrap().to_bits(), two.objective(&xi).unwrap().to_bits());
    let lambda: Vec<f64> = (0..one.m()).map(|i| (i as f64).sin()).collect();
    let all = |p: &Collocation| {
        let mut out = [
            vec![0.0; p.n()],
            vec![0.0; p.m()],
            vec![0.0; p.jacobian_structure().len()],
            vec![0.0; p.hessian_structure().len()],
        ];
        p.gradient(&xi, &mut out[0]).unwrap();
        p.constraints(&xi, &mut out[1]).unwrap();
        p.jacobian(&xi, &mut out[2]).unwrap();
        p.hessian(&xi, 0.7, &lambda, &mut out[3]).unwrap();
        out
    };
    assert_eq!(all(&one), all(&two));
}

/// The error of a text in which `what` was replaced.
fn error(what: &str, by: &str) -> String {
    let text = models::nonlinear().to_json();
    assert!(text.contains(what), "no {what} in {text}");
    match Model::from_json(&text.replacen(what, by, 1)) {
        Err(error) if error.kind() == ErrorKind::Model => error.to_string(),
        Err(other) => panic!("{other:?}"),
        Ok(_) => panic!("'{what}' for '{by}' was read without an error"),
    }
}

#[test]
fn damage_is_named() {
    for (what, by, named) in [
        ("phugoid-model", "other-model", "other-model"),
        ("\"version\":1", "\"version\":7", "version 7"),
        ("\"op\":\"sin\"", "\"op\":\"sine\"", "sine"),
        ("\"op\":\"sin\"", "\"op\":\"add\"", "add takes 2"),
        ("\"table\":0", "\"table\":5", "no table 5"),
        ("\"start\":0.3", "\"start\":null", "null"),
        ("\"start\":1.7", "\"start\":17.0", "CLa"),
        ("\"name\":\"alpha\"", "\"name\":\"V\"", "'V'"),
        ("\"name\":\"alpha\"", "\"name\":\"time\"", "time"),
        ("\"name\":\"alpha\"", "\"name\":\"al pha\"", "al pha"),
        ("\"roots\":[", "\"roots\":[0,", "equations"),
        ("\"roots\":[", "\"roots\":[99999,", "99999"),
    ] {
        let text = error(what, by);
        assert!(text.contains(named), "'{named}' is not in: {text}");
    }
    for text in ["", "{}", "[1, 2]", "null", "{\"format\":\"phugoid-model\"}"] {
        assert!(matches!(Model::from_json(text), Err(e) if e.kind() == ErrorKind::Model), "{text}");
    }
}

#[test]
fn damaged_pools_are_errors() {
    for (nodes, roots, named) in [
        (r#"[{"op":"sin","args":[0]}]"#, "[0]", "before"),
        (r#"[{"symbol":"a"},{"op":"sin","args":[2]},{"symbol":"b"}]"#, "[1]", "before"),
        (r#"[{"symbol":"a"}]"#, "[1]", "1"),
        (r#"[{"symbol":"a"},{"op":"add","args":[0]}]"#, "[1]", "add"),
        (r#"[{"symbol":"a"},{"table":0,"order":[0,0],"args":[0]}]"#, "[1]", "table"),
    ] {
        let text = format!(r#"{{"nodes":{nodes},"roots":{roots}}}"#);
        let error = Pool::from_json(&text).unwrap().expressions().unwrap_err();
        assert!(error.contains(named), "{error}");
    }
    for nodes in [r#"[{"value":null}]"#, r#"[{"symbol":3}]"#, "[7]", r#"[{"op":"sin","args":[-1]}]"#] {
        assert!(Pool::from_json(&format!(r#"{{"nodes":{nodes},"roots":[0]}}"#)).is_err(), "{nodes}");
    }
}

/// A derivative of absurd order is zero, and so are its own.
#[test]
fn a_damaged_order_of_differentiation_is_harmless() {
    let text = Pool::new(&[lookup(&lift_table(), &[&Expr::symbol("a")])]).to_json().unwrap();
    assert!(text.contains("\"order\":[0,0]"));
    let pool = Pool::from_json(&text.replace("\"order\":[0,0]", "\"order\":[255,255]")).unwrap();
    for expr in pool.expressions().unwrap() {
        let slope = expr.derivative("a");
        assert_eq!(slope.evaluate(&crate::common::values(&[("a", 0.3)])), Ok(0.0));
    }
}

#[test]
fn a_number_that_json_cannot_hold_is_refused() {
    let a = Expr::symbol("a");
    for number in [f64::NAN, f64::INFINITY] {
        assert!(Pool::new(&[&a + number]).to_json().is_err());
        let mut model = Model::new("broken");
        let x = model.state("x", "").unwrap();
        model.equation("x", &x * number).unwrap();
        model.output("x", x, "").unwrap();
        let error = model.check().unwrap_err().to_string();
        assert!(error.contains("x'") && error.contains(&number.to_string()), "{error}");
    }
    assert!(Model::new("").parameter(Parameter::new("p", f64::NAN)).is_err());
}
