//! Numbers and names that public fields allow but that cannot be are errors, which say where and what.

use phugoid::Signal;
use phugoid::expr::Expr;
use phugoid::internals::evaluator::Evaluator;
use phugoid::model::Transform;
use phugoid::model::{LateInput, LateOutput};
use phugoid::noise::{Scale, Sigma};
use phugoid::{ErrorKind, Estimation, Experiment, Grid, Model, Parameter, Simulation};

fn model() -> Model {
    let mut m = Model::new("lag");
    let (x, u) = (m.state("x", "").unwrap(), m.input("u", "").unwrap());
    let [rate, tau] = ["rate", "tau"].map(|name| m.parameter(Parameter::new(name, 0.5)).unwrap());
    let late = m.delay(&u, &tau, "late").unwrap();
    m.equation("x", rate * (late - &x) + u).unwrap();
    m.output("y", x, "").unwrap();
    m
}

fn record(model: &Model) -> Experiment {
    let t: Vec<f64> = (0..20).map(|k| 0.1 * f64::from(k)).collect();
    let y = t.iter().map(|t| t.sin()).collect();
    Experiment::new(model, "run", t.clone(), [("u", t), ("y", y)]).unwrap()
}

type Change = fn(&mut Parameter);

fn refused(change: impl FnOnce(&mut Model), expected: &str) {
    let mut m = model();
    let run = record(&m);
    change(&mut m);
    let text = m.check().unwrap_err().to_string();
    assert!(text.contains(expected), "{text}");
    assert_eq!(Estimation::new(&m, std::slice::from_ref(&run)).solve().unwrap_err().to_string(), text);
    let simulated = Simulation::new(&m, &run).parameter("rate", 1.0).parameter("tau", 0.1).run();
    assert_eq!(simulated.unwrap_err().to_string(), text);
}

#[test]
fn parameters() {
    let cases: [(Change, &str); 8] = [
        (|p| p.start = f64::NAN, "not a finite number"),
        (|p| (p.lower, p.upper) = (Some(1.0), Some(-1.0)), "not a lower and an upper bound"),
        (|p| p.upper = Some(f64::NAN), "not a lower and an upper bound"),
        (|p| p.lower = Some(2.0), "outside its bounds"),
        (|p| p.prior = Some((0.0, 0.0)), "not a mean and a positive standard deviation"),
        (|p| p.transform = Transform::Scale(0.0), "not a positive number"),
        (|p| (p.transform, p.start) = (Transform::Log, -1.0), "no logarithm"),
        (|p| p.name = "two words".into(), "letters, digits and underscores"),
    ];
    for (change, expected) in cases {
        refused(|m| change(&mut m.parameters[0]), expected);
    }
}

#[test]
fn names_and_equations() {
    refused(|m| m.parameters[0].name = "x".into(), "already in use");
    refused(|m| m.outputs.push(m.outputs[0].clone()), "declared twice");
    refused(|m| m.dynamics.push(m.dynamics[0].clone()), "already has an equation");
    refused(
        |m| m.dynamics.push(phugoid::model::Equation { name: "z".into(), ..m.dynamics[0].clone() }),
        "not a state",
    );
}

#[test]
fn noise() {
    for (scale, expected) in [
        (Scale::Known(0.0), "0 is not a positive number"),
        (Scale::Unknown { start: Some(-1.0), bounds: None }, "starts at -1"),
        (Scale::Unknown { start: None, bounds: Some((2.0, 1.0)) }, "not a lower and an upper bound"),
        (Scale::Unknown { start: Some(3.0), bounds: Some((1.0, 2.0)) }, "outside its bounds"),
        (Scale::from(Sigma::Known(f64::NAN)), "NaN is not a positive number"),
    ] {
        refused(|m| m.noise = std::mem::take(&mut m.noise).scale("y", scale.clone()), "noise of output 'y'");
        refused(|m| m.noise = std::mem::take(&mut m.noise).scale("y", scale), expected);
    }
}

#[test]
fn delays_of_delays_and_cycles() {
    let late = |name: &str, of: &str| LateInput { name: name.into(), of: of.into(), by: "tau".into() };
    refused(|m| m.delays.inputs[0].of = "late".into(), "'late' is a delayed input itself");
    refused(
        |m| {
            m.delays.inputs.push(late("u", "late"));
        },
        "delayed input itself",
    );
    refused(|m| m.delays.inputs.push(late("nothing", "u")), "not one of the model's inputs");
    refused(|m| m.delays.inputs[0].by = "x".into(), "one of its parameters");
    let sensor = LateOutput { output: "z".into(), by: "tau".into() };
    refused(|m| m.delays.outputs.push(sensor), "not one of the model's outputs");
}

#[cfg(feature = "serde")]
#[test]
fn delays_of_saved_models() {
    let saved = model().to_json();
    let damaged = saved.replace(r#"["u","tau"]"#, r#"["late","tau"]"#);
    assert_ne!(saved, damaged);
    let text = Model::from_json(&damaged).unwrap_err().to_string();
    assert!(text.contains("delayed input itself"), "{text}");
}

#[test]
fn records() {
    let m = model();
    let t = vec![0.0, 1.0];
    let twice = [("u", vec![0.0; 2]), ("y", vec![1.0; 2]), ("u", vec![2.0; 2])];
    let text = Experiment::new(&m, "run", t, twice).unwrap_err().to_string();
    assert_eq!(text, "experiment 'run': channel 'u' is given twice");
    for wrong in [f64::NAN, f64::INFINITY] {
        let mut run = record(&m);
        run.signals = vec![Some(Signal {
            t: vec![wrong],
            values: vec![1.0],
            delay: 0.0,
            derivative: 0,
            interpolation: None,
        })];
        let text = Estimation::new(&m, &[run]).solve().unwrap_err().to_string();
        assert!(text.contains("finite, increasing times"), "{text}");
    }
}

#[test]
fn points() {
    let m = model();
    let evaluator = Evaluator::new(&m).unwrap();
    let one = [1.0];
    for columns in [&[][..], &[&one[..]], &[&one, &one, &one, &[1.0, 2.0]]] {
        let error = evaluator.dynamics(&[1.0, 0.1], columns).unwrap_err();
        assert!(error.kind() == ErrorKind::Data && error.to_string().starts_with("points: "), "{error}");
        assert_eq!(evaluator.outputs(&[1.0, 0.1], columns).unwrap_err(), error);
    }
    assert!(evaluator.dynamics(&[1.0], &[&one[..]; 4]).is_err());
    assert_eq!(evaluator.dynamics(&[1.0, 0.1], &[&[0.0], &[1.0], &[2.0], &[3.0]]).unwrap(), [[0.0]]);
}

#[test]
fn grids_and_threads() {
    let mut m = model();
    m.delays = Default::default();
    m.parameters.pop();
    let x = Expr::symbol("x");
    m.dynamics[0].expr = Expr::symbol("rate") * (Expr::symbol("u") - x);
    m.inputs.pop();
    let runs = [record(&m)];
    let fails = |e: Estimation<'_>, expected: &str| {
        let text = e.solve().unwrap_err().to_string();
        assert!(text.contains(expected), "{text}");
    };
    let estimation = || Estimation::new(&m, &runs);
    for n in [usize::MAX, 20_000_000] {
        fails(estimation().grid(Grid::Uniform(n)), "at most 10000000 segments");
        fails(estimation().grid(Grid::Samples(n)), "at most 10000000 segments");
    }
    fails(estimation().grid(Grid::Uniform(1_000_000)).order(60), "order 60");
    fails(estimation().threads(100_000), "threads = 100000");
    fails(estimation().threads(usize::MAX), "threads = ");
    use phugoid::shooting::Shots;
    use phugoid::shooting::Steps;
    for steps in [Steps::Samples(usize::MAX), Steps::Number(usize::MAX), Steps::Length(1e-300)] {
        fails(estimation().shooting(Shots::default().steps(steps)), "at most 10000000");
    }
}
