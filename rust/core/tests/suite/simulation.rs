//! [`Simulation`] against solutions in closed form.

use phugoid::Signal;
use phugoid::{ErrorKind, Estimation, Experiment, Interpolation, Model, Parameter, Simulation};

/// ẋ = (u − x)/τ, y = x + b.
fn lag() -> Model {
    let mut m = Model::new("lag");
    let (x, u) = (m.state("x", "m").unwrap(), m.input("u", "V").unwrap());
    let tau = m.parameter(Parameter::new("tau", 1.0)).unwrap();
    let b = m.parameter(Parameter::new("b", 0.0).local(true)).unwrap();
    m.equation("x", (u - &x) / tau).unwrap();
    m.output("y", x + b, "m").unwrap();
    m
}

fn times(n: usize, h: f64) -> Vec<f64> {
    (0..n).map(|k| h * k as f64).collect()
}

#[track_caller]
fn assert_near(found: &[f64], expected: impl Iterator<Item = f64>, tolerance: f64) {
    for (k, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() < tolerance, "sample {k}: {a}, not {b}");
    }
}

#[track_caller]
fn assert_error(simulation: Simulation<'_>, words: &[&str]) {
    let error = simulation.run().unwrap_err().to_string();
    words.iter().for_each(|word| assert!(error.contains(word), "no '{word}' in: {error}"));
}

#[test]
fn a_ramp_is_followed() {
    let model = lag();
    let t = times(21, 0.2);
    let run = Experiment::of_inputs(&model, "ramp", t.clone(), [("u", t.clone())]).unwrap();
    let path = Simulation::new(&model, &run)
        .parameter("tau", 0.7)
        .parameter("b", 0.1)
        .initial("x", 0.0)
        .run()
        .unwrap();
    let x = |t: &f64| t - 0.7 + 0.7 * (-t / 0.7).exp();
    assert_near(path.state("x").unwrap(), t.iter().map(x), 1e-9);
    assert_near(path.output("y").unwrap(), t.iter().map(|t| x(t) + 0.1), 1e-9);
    assert!(path.residual("y").unwrap().iter().all(|r| r.is_nan()));
    assert!(path.state("y").is_none() && path.output("x").is_none());
}

/// A step at 1.0 s of an input that has samples of its own, at no sample of the record.
#[test]
fn inputs_keep_their_own_samples() {
    let model = lag();
    let t = times(9, 0.3);
    let mut run = Experiment::of_inputs(&model, "step", t.clone(), [("u", vec![0.0; 9])]).unwrap();
    let signal = Signal {
        t: vec![0.0, 1.0, 1.000001, 3.0],
        values: vec![0.0, 0.0, 1.0, 1.0],
        delay: 0.0,
        derivative: 0,
        interpolation: None,
    };
    run.signals = vec![Some(signal)];
    let path = Simulation::new(&model, &run)
        .parameter("tau", 0.5)
        .parameter("b", 0.0)
        .initial("x", 0.0)
        .run()
        .unwrap();
    let x = |t: &f64| if *t < 1.0 { 0.0 } else { 1.0 - (-(t - 1.0) / 0.5).exp() };
    assert_near(path.state("x").unwrap(), t.iter().map(x), 2e-6);
}

/// ẋ = u(t − 0.25) with u = t², x measured 0.15 s late.
#[test]
fn inputs_and_sensors_are_late() {
    let mut m = Model::new("late");
    let (x, u) = (m.state("x", "").unwrap(), m.input("u", "").unwrap());
    let by = m.parameter(Parameter::new("by", 0.0)).unwrap();
    let slow = m.parameter(Parameter::new("slow", 0.0)).unwrap();
    let late = m.delay(&u, &by, "u_late").unwrap();
    m.equation("x", late).unwrap();
    m.output("now", x.clone(), "").unwrap();
    m.output("then", x, "").unwrap();
    m.sensor_delay("then", &slow).unwrap();

    let t = times(31, 0.1);
    let square: Vec<f64> = t.iter().map(|t| t * t).collect();
    let mut run = Experiment::of_inputs(&m, "run", t.clone(), [("u", square)]).unwrap();
    run.interpolation = Interpolation::Cubic; // which a parabola is to the bit
    let simulation =
        Simulation::new(&m, &run).parameter("by", 0.25).parameter("slow", 0.15).initial("x", 1.0);
    let path = simulation.run().unwrap();
    let x = |t: f64| 1.0 + (t - 0.25).max(0.0).powi(3) / 3.0;
    assert_near(path.output("now").unwrap(), t.iter().map(|t| x(*t)), 1e-9);
    let then = path.output("then").unwrap();
    assert!(then[0].is_nan() && then[1].is_nan());
    assert_near(&then[2..], t[2..].iter().map(|t| x(t - 0.15)), 1e-9);
    assert_eq!(path.state("x").unwrap(), path.output("now").unwrap());
}

/// Returns the parameters of a fit, that of the experiment where each has its own, and its initial states.
#[test]
fn a_fit_is_simulated() {
    let model = lag();
    let t = times(60, 0.1);
    let run = |name: &str, x0: f64, b: f64| {
        let y = t.iter().map(|t| 1.0 + (x0 - 1.0) * (-t / 0.8).exp() + b + 1e-3 * (1e4 * t).sin()).collect();
        Experiment::new(&model, name, t.clone(), [("u", vec![1.0; 60]), ("y", y)]).unwrap()
    };
    let runs = [run("one", 0.0, 0.1), run("two", 0.5, -0.2)];
    let fit = Estimation::new(&model, &runs).solve().unwrap();
    for (e, record) in runs.iter().enumerate() {
        let path = Simulation::new(&model, record).fit(&fit).run().unwrap();
        assert_near(path.output("y").unwrap(), fit.output(e, "y").unwrap().iter().copied(), 1e-7);
        assert_near(path.residual("y").unwrap(), fit.residual(e, "y").unwrap().iter().copied(), 1e-7);
    }
    let other = Simulation::new(&model, &runs[0]).fit(&fit).parameter("b[one]", 5.0).run().unwrap();
    assert!(other.output("y").unwrap()[10] > 5.0);
}

/// Not given, states begin as a condition says, else as measured.
#[test]
fn where_states_begin() {
    let mut model = lag();
    let y = vec![f64::NAN, 3.1, 3.0];
    let run = Experiment::new(&model, "run", times(3, 0.1), [("u", vec![0.0; 3]), ("y", y)]).unwrap();
    let first = |model: &Model| {
        let path = Simulation::new(model, &run).parameter("tau", 1.0).parameter("b", 0.1).run().unwrap();
        path.state("x").unwrap()[0]
    };
    assert_eq!(first(&model), 3.0);
    let tau = phugoid::Expr::symbol("tau");
    model.condition(phugoid::model::End::Initial, "x", 2.0 * tau + 0.5).unwrap();
    assert_eq!(first(&model), 2.5);
}

#[test]
fn what_cannot_be_simulated_is_named() {
    let model = lag();
    let run = Experiment::of_inputs(&model, "run", times(5, 1.0), [("u", vec![0.0; 5])]).unwrap();
    let with = |tau: f64| Simulation::new(&model, &run).parameter("tau", tau).parameter("b", 0.0);
    assert_error(Simulation::new(&model, &run), &["no value was given for tau, b"]);
    assert_error(with(1.0).parameter("tauu", 1.0), &["'tauu' is not a parameter", "Did you mean 'tau'"]);
    assert_error(with(f64::NAN), &["'tau' is NaN"]);
    assert_error(with(1.0).initial("z", 0.0), &["initial 'z' is not a state"]);
    assert_error(with(1.0).tolerance(0.0), &["tolerance 0"]);
    assert_error(with(0.0).initial("x", 1.0), &["x' is not finite", "'run'", "t = 0,", "u = 0"]);
    // Finite until it is no more: x grows by e^100 a second.
    assert_error(with(-0.01).initial("x", 1e300), &["'run'", "ends at t ="]);
    let mut rate = run.clone();
    let (t, values) = (run.t.clone(), vec![0.0; 5]);
    rate.signals = vec![Some(Signal { t, values, delay: 0.0, derivative: 1, interpolation: None })];
    assert_error(
        Simulation::new(&model, &rate).parameter("tau", 1.0).parameter("b", 0.0),
        &["'u' is a derivative"],
    );
    let missing = Experiment::of_inputs(&model, "run", times(5, 1.0), []).unwrap_err();
    assert!(missing.kind() == ErrorKind::Data && missing.to_string().contains("no channel 'u'"));
}
