//! A scale that no output can tell is held and named, and an unmeasured state under a root starts elsewhere than at 0.

use crate::common::Random;
use phugoid::model::Variable;
use phugoid::nlp::PointId;
use phugoid::shooting::Shots;
use phugoid::solver::Status;
use phugoid::{Estimation, Experiment, Grid, Model, Parameter, Simulation};

const TRUE: [(&str, f64); 4] = [("k1", 0.5), ("k2", 0.4), ("k3", 0.6), ("k4", 0.8)];

/// Two tanks of which the lower is measured.
fn tanks(start: impl Fn(&str, f64) -> Parameter, upper: Variable) -> Model {
    let mut m = Model::new("two tanks");
    let (x1, x2) = (m.state_within(upper).unwrap(), m.state("x2", "m").unwrap());
    let u = m.input("u", "V").unwrap();
    let [k1, k2, k3, k4] = TRUE.map(|(name, value)| m.parameter(start(name, value)).unwrap());
    m.equation("x1", -k1 * x1.clone().sqrt() + k4 * u).unwrap();
    m.equation("x2", k2 * x1.sqrt() - k3 * x2.clone().sqrt()).unwrap();
    m.output("x2", x2, "").unwrap();
    m
}

/// Levels of the lower tank with 1 % noise.
fn record(model: &Model) -> Experiment {
    let mut random = Random(3);
    let t: Vec<f64> = (0..201).map(|k| 0.2 * f64::from(k)).collect();
    let u: Vec<f64> =
        t.iter().map(|t| if ((t / 6.5) as usize).is_multiple_of(2) { 1.7 } else { 0.3 }).collect();
    let run = Experiment::of_inputs(model, "run", t.clone(), [("u", u.clone())]).unwrap();
    let simulation = TRUE.iter().fold(Simulation::new(model, &run), |s, (n, v)| s.parameter(n, *v));
    let path = simulation.initial("x1", 4.0).initial("x2", 0.2).run().unwrap();
    let noisy = path.output("x2").unwrap().iter().map(|x| x + 0.02 * random.between(-1.0, 1.0)).collect();
    Experiment::new(model, "run", t, [("u", u), ("x2", noisy)]).unwrap()
}

fn level() -> Variable {
    Variable::new("x1", "m")
}

#[test]
fn a_free_scale_is_named_with_what_to_fix() {
    let model = tanks(|name, value| Parameter::new(name, 1.4 * value), level());
    let runs = [record(&model)];
    let shots = Shots::default().grid(vec![Grid::Uniform(20)]);
    for estimation in [Estimation::new(&model, &runs), Estimation::new(&model, &runs).shooting(shots)] {
        let fit = estimation.solve().unwrap();
        assert_eq!(fit.status, Status::Unidentifiable, "{fit}");
        assert!(fit.message.contains("x1, k1, k2, k4: one scale is free"), "{}", fit.message);
        let advice = "x1*s, k1*s**0.5, k2*s**(-0.5), k4*s for every s > 0";
        assert!(fit.warnings.iter().any(|w| w.contains(advice)), "{:?}", fit.warnings);
        assert!(["k1", "k2", "k4"].iter().all(|k| fit[k].std_error.is_nan() && fit[k].value.abs() < 1e3));
        assert!((fit["k3"].value - 0.6).abs() < 3.0 * fit["k3"].std_error, "{fit}");
        assert!(fit.records[0].initial[0].std_error.is_nan());
        assert!(!fit.model.parameters.iter().any(|p| p.fixed), "the fit is of the model as it was given");
    }
}

#[test]
fn with_the_scale_fixed_it_converges_to_the_truth() {
    let start = |name: &str, value: f64| {
        Parameter::new(name, if name == "k4" { value } else { 1.4 * value }).fixed(name == "k4")
    };
    let model = tanks(start, level());
    let fit = Estimation::new(&model, &[record(&model)]).solve().unwrap();
    assert_eq!(fit.status, Status::Converged, "{fit}");
    for (name, value) in &TRUE[..3] {
        assert!((fit[name].value - value).abs() < 3.0 * fit[name].std_error, "{fit}");
    }
}

#[test]
fn a_state_starts_as_declared_and_within_its_bounds() {
    let start = |name: &str, value: f64| Parameter::new(name, value).fixed(true);
    for (declared, expected) in [(Some(2.5), 2.5), (None, 0.1)] {
        let upper = Variable { start: declared, lower: Some(0.1), upper: Some(9.0), ..level() };
        let model = tanks(start, upper);
        let (problem, xi) = Estimation::new(&model, &[record(&model)]).transcribe().unwrap();
        let first = problem.layout.state(PointId(0)).0;
        assert!(xi[first..].iter().step_by(2).all(|x| *x == expected), "{:?}", &xi[first..first + 4]);
    }
}
