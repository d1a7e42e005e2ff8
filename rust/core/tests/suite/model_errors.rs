//! A model that is incomplete or contradicts itself says so in the user's names.

use phugoid::expr::Expr;
use phugoid::model::{Model, Parameter};
use phugoid::{Error, ErrorKind};

/// A complete model, to be spoilt.
fn sound() -> Model {
    let mut m = Model::new("spring");
    let (x, v) = (m.state("x", "m").unwrap(), m.state("v", "m/s").unwrap());
    let force = m.input("force", "N").unwrap();
    let stiffness = m.parameter(Parameter::new("stiffness", 2.0)).unwrap();
    let pull = m.written_at(Some("spring.py:5".into())).quantity("pull", &stiffness * &x).unwrap();
    m.equation("x", v.clone()).unwrap();
    m.written_at(Some("spring.py:7".into())).equation("v", force - pull).unwrap();
    m.output("x", x, "").unwrap();
    m
}

/// Asserts an [`ErrorKind::Model`] whose text holds all of some words.
fn names<T: std::fmt::Debug>(result: Result<T, Error>, words: &[&str]) {
    match result {
        Err(error) if error.kind() == ErrorKind::Model => {
            let text = error.to_string();
            for word in words {
                assert!(text.contains(word), "'{word}' is not in: {text}");
            }
        }
        other => panic!("expected an error that names {words:?}, got {other:?}"),
    }
}

#[test]
fn a_sound_model_is_accepted() {
    sound().check().unwrap();
    sound().compile().unwrap();
}

#[test]
fn an_undeclared_symbol() {
    let mut m = sound();
    m.written_at(Some("spring.py:9".into()))
        .output("energy", Expr::symbol("mass") * Expr::symbol("v"), "J")
        .unwrap();
    names(m.check(), &["spring", "energy", "spring.py:9", "'mass'", "not declared"]);
    names(m.compile(), &["'mass'"]);
}

#[test]
fn a_misspelt_symbol_is_recognised() {
    let mut m = sound();
    m.quantity("damping", Expr::symbol("Stifness") * 0.1).unwrap();
    names(m.check(), &["damping", "'Stifness'", "Did you mean 'stiffness'?"]);
    // Nothing like it: no guess.
    let mut m = sound();
    m.output("y", Expr::symbol("qqq"), "").unwrap();
    let text = m.check().unwrap_err().to_string();
    assert!(!text.contains("Did you mean"), "{text}");
}

#[test]
fn a_quantity_used_before_it_is_named() {
    let mut m = Model::new("order");
    let x = m.state("x", "").unwrap();
    m.quantity("first", Expr::symbol("second") + 1.0).unwrap();
    m.quantity("second", x.clone()).unwrap();
    m.equation("x", Expr::symbol("first")).unwrap();
    m.output("x", x, "").unwrap();
    names(m.check(), &["first", "'second'"]);
}

#[test]
fn a_state_without_equation() {
    let mut m = sound();
    m.state("heat", "J").unwrap();
    names(m.check(), &["'heat'", "no equation", "dynamics(heat=...)"]);
}

#[test]
fn an_equation_of_no_state() {
    let mut m = sound();
    names(
        m.written_at(Some("spring.py:11".into())).equation("V", Expr::symbol("x")),
        &["'V'", "spring.py:11", "'v'"],
    );
    names(m.equation("force", Expr::symbol("x")), &["'force'", "not a state"]);
}

#[test]
fn a_second_equation_of_a_state() {
    let mut m = sound();
    names(m.equation("v", Expr::symbol("x")), &["'v'", "already"]);
}

#[test]
fn a_parameter_that_is_not_used() {
    let mut m = sound();
    m.parameter(Parameter::new("friction", 0.0)).unwrap();
    names(m.check(), &["'friction'", "no equation"]);
}

/// A quantity that nothing uses does not make a parameter count.
#[test]
fn a_parameter_in_an_idle_quantity_is_not_used() {
    let mut m = sound();
    let friction = m.parameter(Parameter::new("friction", 0.0)).unwrap();
    let drag = m.quantity("drag", friction * Expr::symbol("v")).unwrap();
    names(m.check(), &["'friction'", "no equation"]);
    m.output("drag", drag, "N").unwrap();
    m.check().unwrap();
}

/// A parameter counts through any number of quantities.
#[test]
fn a_parameter_behind_several_quantities_is_used() {
    let mut m = sound();
    let friction = m.parameter(Parameter::new("friction", 0.0)).unwrap();
    let mut drag = friction * Expr::symbol("v");
    for name in ["first", "second", "third"] {
        drag = m.quantity(name, drag + 1.0).unwrap();
    }
    m.output("drag", drag, "N").unwrap();
    m.check().unwrap();
}

#[test]
fn names_are_taken_once() {
    for name in ["x", "force", "stiffness", "pull"] {
        names(sound().state(name, ""), &[&format!("'{name}'"), "already"]);
        names(sound().input(name, ""), &[&format!("'{name}'"), "already"]);
        names(sound().parameter(Parameter::new(name, 0.0)), &[&format!("'{name}'"), "already"]);
        names(sound().quantity(name, Expr::symbol("v")), &[&format!("'{name}'"), "already"]);
    }
    names(sound().output("x", Expr::symbol("v"), ""), &["'x'", "already"]);
}

#[test]
fn time_is_reserved() {
    names(sound().state("time", ""), &["state 'time'", "model.time"]);
    names(sound().input("time", ""), &["input 'time'"]);
    names(sound().parameter(Parameter::new("time", 0.0)), &["parameter 'time'"]);
    names(sound().quantity("time", Expr::symbol("x")), &["quantity 'time'"]);
}

#[test]
fn names_are_words() {
    for name in ["", "2x", "a b", "a-b", "a.b", "a*b"] {
        names(sound().state(name, ""), &[&format!("state '{name}'")]);
        names(sound().parameter(Parameter::new(name, 0.0)), &[&format!("parameter '{name}'")]);
    }
    for name in ["_x", "α", "CL_0", "naïve2"] {
        sound().state(name, "").unwrap();
    }
}

#[test]
fn bounds_and_starts_agree() {
    let with = |start: f64, lower: Option<f64>, upper: Option<f64>| {
        sound().parameter(Parameter::new("mass", start).lower(lower).upper(upper))
    };
    names(with(-1.0, Some(0.0), None), &["'mass'", "-1", "outside"]);
    names(with(3.0, Some(0.0), Some(2.0)), &["'mass'", "3", "(0, 2)"]);
    names(with(1.0, Some(2.0), Some(0.0)), &["'mass'", "(2, 0)", "bounds"]);
    names(with(f64::NAN, None, None), &["'mass'", "NaN"]);
    names(with(f64::INFINITY, None, None), &["'mass'", "inf"]);
    names(with(1.0, Some(f64::NAN), None), &["'mass'", "bounds"]);
    with(0.0, Some(0.0), Some(0.0)).unwrap();
}

#[test]
fn priors_have_a_positive_width() {
    for prior in [(0.0, 0.0), (0.0, -1.0), (0.0, f64::NAN), (f64::INFINITY, 1.0)] {
        let parameter = Parameter::new("mass", 1.0).prior(prior);
        names(sound().parameter(parameter), &["'mass'", "prior"]);
    }
}

#[test]
fn a_model_without_states_or_outputs() {
    names(Model::new("empty").check(), &["'empty'", "no states"]);
    let mut m = Model::new("blind");
    let x = m.state("x", "").unwrap();
    m.equation("x", x).unwrap();
    names(m.check(), &["'blind'", "no outputs"]);
}
