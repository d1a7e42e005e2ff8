//! A model saved by Python evaluates to the same bits here. The file is made by tools/saved_model.py, and
//! tests/test_saved_model.py sees to it that it is what Python makes today.

#![cfg(feature = "serde")]

use phugoid::collocation::{Collocation, Settings};
use phugoid::internals::evaluator::Evaluator;
use phugoid::nlp::Nlp;
use phugoid::noise::Noise;
use phugoid::{Experiment, Grid, Interpolation, Model, Sigma};
use serde_json::Value;

fn saved() -> Value {
    serde_json::from_str(include_str!("data/saved_model.json")).unwrap()
}

fn model(saved: &Value) -> Model {
    Model::from_json(&saved["model"].to_string()).unwrap()
}

/// Numbers from the 16 hexadecimal digits of their bits, in lines.
fn numbers(lines: &Value) -> Vec<f64> {
    let text: String = lines.as_array().unwrap().iter().map(|line| line.as_str().unwrap()).collect();
    let number = |i: usize| f64::from_bits(u64::from_str_radix(&text[i..i + 16], 16).unwrap());
    (0..text.len()).step_by(16).map(number).collect()
}

fn many(list: &Value) -> Vec<Vec<f64>> {
    list.as_array().unwrap().iter().map(numbers).collect()
}

#[track_caller]
fn assert_same_bits(what: &str, found: &[f64], expected: &Value) {
    let expected = numbers(expected);
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (a, b)) in found.iter().zip(&expected).enumerate() {
        assert_eq!(a.to_bits(), b.to_bits(), "{what}[{i}]: {a:e}, in Python {b:e}");
    }
}

fn problem(saved: &Value) -> Collocation {
    let mut grid = Vec::new();
    let mut experiment = |e: &Value| {
        grid.push(Grid::Edges(numbers(&e["edges"])));
        let cubic = e["cubic"].as_bool().unwrap();
        Experiment {
            name: e["name"].as_str().unwrap().into(),
            t: numbers(&e["t"]),
            inputs: many(&e["inputs"]),
            outputs: many(&e["outputs"]),
            interpolation: if cubic { Interpolation::Cubic } else { Interpolation::Linear },
            signals: Vec::new(),
        }
    };
    let experiments: Vec<Experiment> =
        saved["experiments"].as_array().unwrap().iter().map(&mut experiment).collect();
    let sigma = |s: &Value| match numbers(&s["value, lower, upper"])[..] {
        [value, ..] if s["known"].as_bool().unwrap() => Sigma::Known(value),
        [start, lower, upper] => Sigma::Unknown { start, lower, upper },
        _ => panic!("{s}"),
    };
    let noise = Noise::Gaussian(saved["sigmas"].as_array().unwrap().iter().map(sigma).collect());
    let order = saved["order"].as_u64().unwrap() as usize;
    Collocation::new(
        &model(saved),
        &experiments,
        noise,
        &Settings::default().order(order).grid(grid).threads(0),
    )
    .unwrap()
}

#[test]
fn state_equations_and_outputs_at_points() {
    let saved = saved();
    let (evaluator, points) = (Evaluator::new(&model(&saved)).unwrap(), &saved["evaluator"]);
    let (parameters, columns) = (numbers(&points["parameters"]), many(&points["columns"]));
    let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    for (what, found) in [
        ("dynamics", evaluator.dynamics(&parameters, &columns).unwrap()),
        ("outputs", evaluator.outputs(&parameters, &columns).unwrap()),
    ] {
        let expected = points[what].as_array().unwrap();
        assert_eq!(found.len(), expected.len());
        found.iter().zip(expected).for_each(|(found, expected)| assert_same_bits(what, found, expected));
    }
}

#[test]
fn callbacks_of_the_collocation_problem() {
    let saved = saved();
    let problem = problem(&saved);
    let (xi, multipliers) = (numbers(&saved["xi"]), numbers(&saved["multipliers"]));
    let factor = numbers(&saved["factor"])[0];
    assert_same_bits("objective", &[problem.objective(&xi).unwrap()], &saved["objective"]);

    let mut out = vec![f64::NAN; problem.n()];
    problem.gradient(&xi, &mut out).unwrap();
    assert_same_bits("gradient", &out, &saved["gradient"]);

    let mut out = vec![f64::NAN; problem.m()];
    problem.constraints(&xi, &mut out).unwrap();
    assert_same_bits("constraints", &out, &saved["constraints"]);

    let mut out = vec![f64::NAN; problem.jacobian_structure().len()];
    problem.jacobian(&xi, &mut out).unwrap();
    assert_same_bits("jacobian", &out, &saved["jacobian"]);

    let mut out = vec![f64::NAN; problem.hessian_structure().len()];
    problem.hessian(&xi, factor, &multipliers, &mut out).unwrap();
    assert_same_bits("hessian", &out, &saved["hessian"]);
    problem.gauss_newton(&xi, factor, &mut out).unwrap();
    assert_same_bits("gauss_newton", &out, &saved["gauss_newton"]);
}

/// What is read and saved again is the same model.
#[test]
fn reading_and_saving_changes_nothing() {
    let model = model(&saved());
    assert_eq!(Model::from_json(&model.to_json()).unwrap(), model);
    assert_eq!(model.parameters[0].start, 0.1 + 0.2);
}
