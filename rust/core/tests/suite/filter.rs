//! The marginal likelihood of the filter-error method against difference quotients and quadrature.

use crate::common::{Random, models, slope};
use phugoid::Experiment;
use phugoid::Interpolation;
use phugoid::filter::{Filter, Lost, Settings};
use phugoid::model::{Model, Parameter};
use phugoid::noise::{Noise, Sigma};

/// A record of smooth inputs and outputs near given values, some missing.
fn record(model: &Model, name: &str, n: usize, near: &[f64], seed: u64) -> Experiment {
    let mut random = Random(seed);
    let mut t = vec![0.3];
    (1..n).for_each(|k| t.push(t[k - 1] + random.between(0.02, 0.08)));
    let wave = |k: usize| t.iter().map(|t| 0.5 + 0.2 * ((1.0 + k as f64) * t).sin()).collect();
    let inputs: Vec<Vec<f64>> = (0..model.inputs.len()).map(wave).collect();
    let mut outputs = Vec::new();
    for (c, near) in near.iter().enumerate() {
        let mut z: Vec<f64> = (0..n).map(|_| near + random.between(-0.05, 0.05)).collect();
        z[(3 * c + 2) % n] = f64::NAN;
        outputs.push(z);
    }
    Experiment {
        name: name.into(),
        t,
        inputs,
        outputs,
        interpolation: Interpolation::Cubic,
        signals: Vec::new(),
    }
}

fn unknown(n: usize) -> Noise {
    Noise::Gaussian(vec![Sigma::Unknown { start: 0.1, lower: 0.0, upper: 1e3 }; n])
}

/// Largest error of the gradient, each entry relative to its size or to 1.
fn gradient_error(filter: &Filter, theta: &[f64], path: &[f64]) -> f64 {
    let found = filter.evaluate(theta, path, true).unwrap();
    let value = |i: usize, v: f64| {
        let mut there = theta.to_vec();
        there[i] = v;
        filter.evaluate(&there, &found.path, false).unwrap().log_likelihood
    };
    let error = |(i, g): (usize, &f64)| {
        let quotient = slope(|v| value(i, v), theta[i], 0.02 * theta[i].abs().max(0.02));
        (g - quotient).abs() / g.abs().max(1.0)
    };
    found.gradient.iter().enumerate().map(error).fold(0.0, f64::max)
}

#[test]
fn gradient_with_products_tables_and_switches() {
    let model = models::nonlinear();
    // V, alpha, q and az. A precise alpha keeps the path far from the kink of the switch at 0.25.
    let near = [1.1, 0.6, 0.2, 0.9];
    let runs = [record(&model, "one", 25, &near, 1), record(&model, "two", 13, &near, 2)];
    let states: Vec<f64> = (0..38).flat_map(|_| [1.1, 0.6, 0.2]).collect();
    let mut theta: Vec<f64> = model.parameters.iter().map(|p| p.start).collect();
    theta.extend([10.0, 100.0, 15.0, 9.0, 0.3]);
    for (noisy, initial) in [
        (vec!["alpha"], vec![None; 3]),
        (vec!["q", "V", "alpha"], vec![Some((1.1, 0.05)), None, Some((0.0, f64::INFINITY))]),
    ] {
        for (substeps, terms) in [(1, 1), (3, 2)] {
            let names = noisy.iter().map(|s| s.to_string()).collect();
            let settings = Settings { states: names, substeps, terms, initial: initial.clone() };
            let filter = Filter::new(&model, &runs, &unknown(4), &settings).unwrap();
            let mut theta = theta.clone();
            theta.resize(filter.n_theta(), 0.2);
            let error = gradient_error(&filter, &theta, &filter.start(&states));
            assert!(error < 1e-6, "{noisy:?}, {substeps} steps, {terms} terms: {error:e}");
        }
    }
}

/// ẋ = −x³ with noise, √(1 + x²) measured at two times; the initial state known to `spread`.
fn two_samples(scale: f64) -> Filter {
    let mut m = Model::new("cubic");
    let x = m.state("x", "").unwrap();
    let a = m.parameter(Parameter::new("a", 1.0)).unwrap();
    m.equation("x", -(a * &x * &x * &x)).unwrap();
    m.output("y", (1.0 + &x * &x).sqrt(), "").unwrap();
    let z = [1.3, 1.2].map(|z: f64| z + scale * 0.3).to_vec();
    let run = Experiment::new(&m, "run", vec![0.0, 0.1], [("y", z)]).unwrap();
    let settings =
        Settings { states: vec!["x".into()], substeps: 1, terms: 1, initial: vec![Some((0.8, scale))] };
    Filter::new(&m, &[run], &Noise::Gaussian(vec![Sigma::Known(scale)]), &settings).unwrap()
}

/// One Runge-Kutta step of 0.1 s, with a noise that adds so much to the slope.
fn step(x: f64, noise: f64) -> f64 {
    let (f, h) = (|x: f64| noise - x.powi(3), 0.1);
    let a = f(x);
    let b = f(x + 0.5 * h * a);
    let c = f(x + 0.5 * h * b);
    x + h / 6.0 * (a + 2.0 * b + 2.0 * c + f(x + h * c))
}

/// ln p(z) by the rule of rectangles over first state and noise, in their standard deviations.
fn integral(scale: f64) -> f64 {
    let z = [1.3 + 0.3 * scale, 1.2 + 0.3 * scale];
    let g = |x: f64| (1.0 + x * x).sqrt();
    let width = 0.05;
    let points = || (-160..=160).map(|i| f64::from(i) * width);
    let mut sum = 0.0;
    for a in points() {
        for e in points() {
            let first = 0.8 + scale * a;
            let second = step(first, scale * e / 0.1);
            let (r, s) = ((z[0] - g(first)) / scale, (z[1] - g(second)) / scale);
            sum += (-0.5 * (a * a + e * e + r * r + s * s)).exp();
        }
    }
    (sum * width * width / (2.0 * std::f64::consts::PI)).ln() - 2.0 * scale.ln()
}

/// The error of the Laplace approximation falls with the square of the noise; with the curvature of the
/// residuals left out of the Hessian it would fall with the first power.
#[test]
fn laplace_approximation_of_a_curved_system() {
    let error = |scale: f64| {
        let filter = two_samples(scale);
        let q = scale / 0.1f64.sqrt();
        let found = filter.evaluate(&[1.0, q], &filter.start(&[0.8, 0.75]), false).unwrap();
        found.log_likelihood - integral(scale)
    };
    let (large, small) = (error(0.1), error(0.05));
    assert!(large.abs() > 1e-5 && large.abs() < 0.1, "{large:e}");
    let ratio = large / small;
    assert!((3.0..5.5).contains(&ratio), "{large:e}, {small:e}");
}

#[test]
fn what_has_no_path_is_said() {
    let mut m = Model::new("unseen");
    let (x, y) = (m.state("x", "").unwrap(), m.state("y", "").unwrap());
    let a = m.parameter(Parameter::new("a", -1.0)).unwrap();
    m.equation("x", a * &x).unwrap();
    m.equation("y", y.sqrt() - &x).unwrap();
    m.output("x", x, "").unwrap();
    let run = Experiment::new(&m, "run", vec![0.0, 1.0, 2.0], [("x", vec![1.0, 0.5, 0.2])]).unwrap();
    let settings = Settings { states: vec!["x".into()], substeps: 1, terms: 1, initial: vec![None; 2] };
    let filter = Filter::new(&m, std::slice::from_ref(&run), &unknown(1), &settings).unwrap();
    let theta = [-1.0, 10.0, 0.1];
    let unseen = filter.evaluate(&theta, &filter.start(&[1.0, 4.0, 0.5, 4.0, 0.2, 4.0]), false).unwrap_err();
    assert_eq!(unseen, Lost::First(1));
    assert!(filter.explain(unseen).contains("initial value of state 'y'"));
    let wrong = filter.evaluate(&theta, &filter.start(&[1.0, -4.0, 0.5, 4.0, 0.2, 4.0]), false);
    assert_eq!(wrong.unwrap_err(), Lost::NotFinite);

    let fails = |states: &[&str], substeps: usize| {
        let states = states.iter().map(|s| s.to_string()).collect();
        let settings = Settings { states, substeps, terms: 1, initial: vec![None; 2] };
        Filter::new(&m, std::slice::from_ref(&run), &unknown(1), &settings).unwrap_err().to_string()
    };
    assert!(fails(&["X"], 1).contains("'X' is not a state. Did you mean 'x'?"));
    assert!(fails(&["x", "x"], 1).contains("named twice"));
    assert!(fails(&[], 1).contains("states is empty"));
    assert!(fails(&["x"], 0).contains("substeps"));
}
