//! Constants: printed by name, compiled as numbers, saved, and refused where they are wrong.

use phugoid::expr::Expr;
use phugoid::model::Model;
use phugoid::{Constant, ErrorKind};

/// A fall with drag; the constants as numbers unless named.
fn fall(named: bool) -> Model {
    let mut m = Model::new("fall");
    let v = m.state("v", "m/s").unwrap();
    let k = m.parameter(phugoid::Parameter::new("k", 0.1)).unwrap();
    let [g, area] = [("g", 9.80665), ("S", 30.1)].map(|(name, value)| match named {
        true => m.constant(Constant::new(name, value).unit("m²").meaning("it")).unwrap(),
        false => Expr::constant(value),
    });
    m.equation("v", -&g - 0.5 * &area * (k / &g) * &v * &v).unwrap();
    m.output("v", v * (&area / 2.0).sqrt(), "m/s").unwrap();
    m
}

#[test]
fn equations_are_printed_with_names() {
    assert_eq!(fall(true).dynamics[0].expr.to_string(), "-g - 0.5*S*k/g*v*v");
    assert!(fall(true).outputs[0].expr.latex().contains(r"\frac{S}{2}"));
    let minus = Expr::symbol("x") - Expr::named("a", -2.0);
    assert_eq!(minus.to_string(), "x - a"); // no brackets: the sign does not show
}

#[test]
fn graphs_are_the_same_as_with_numbers() {
    let [named, plain] = [true, false].map(|named| fall(named).compile().unwrap());
    let text =
        |c: &phugoid::model::Compiled| [c.dynamics[0], c.outputs[0]].map(|id| c.graph.export(id).to_string());
    assert_eq!(text(&named), text(&plain));
    assert_eq!(named.dynamics, plain.dynamics);
}

#[cfg(feature = "serde")]
#[test]
fn saved_models_keep_them() {
    let m = fall(true);
    let text = m.to_json();
    assert_eq!(Model::from_json(&text).unwrap(), m);
    // Without the names, as an older release reads it, the numbers are the same.
    let mut saved: serde_json::Value = serde_json::from_str(&text).unwrap();
    saved.as_object_mut().unwrap().remove("constants");
    for node in saved["expressions"]["nodes"].as_array_mut().unwrap() {
        if node.get("value").is_some() {
            node.as_object_mut().unwrap().remove("name");
        }
    }
    assert_eq!(Model::from_json(&saved.to_string()).unwrap().expanded(), fall(false).expanded());
    let damaged = text.replace("\"value\":9.80665,\"unit\"", "\"value\":1e999,\"unit\"");
    assert!(damaged != text && Model::from_json(&damaged).is_err());
}

#[test]
fn wrong_ones_are_errors_that_name_them() {
    let mut m = fall(true);
    for (constant, text) in [
        (Constant::new("v", 1.0), "constant 'v': there is a state of this name already"),
        (Constant::new("g", 1.0), "constant 'g': there is a constant of this name already"),
        (Constant::new("c", f64::NAN), "constant 'c': its value NaN is not a finite number"),
        (Constant::new("1c", 1.0), "constant '1c': a name starts with a letter"),
    ] {
        let error = m.constant(constant).unwrap_err();
        assert!(error.to_string().contains(text), "{error}");
        assert_eq!(error.kind(), ErrorKind::Model);
    }
    m.constants[0].value = f64::INFINITY;
    assert!(
        m.check().unwrap_err().to_string().contains("constant 'g': its value inf is not a finite number")
    );
    m.constants[0].value = 9.81;
    let text = "constant 'g' is 9.80665 here, but was declared as 9.81 in this model";
    assert!(m.check().unwrap_err().to_string().contains(text));
    m.constants.remove(0);
    assert!(m.check().unwrap_err().to_string().contains("constant 'g' is not declared in this model"));
}
