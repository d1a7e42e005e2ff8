//! [`Estimation`] on a first-order lag whose step response is known.

use crate::common::Random;
use phugoid::collocation::{self, Collocation};
use phugoid::estimate::Bound;
use phugoid::filter::{self, Filter};
use phugoid::nlp::{Nlp, PointId};
use phugoid::noise::Noise;
use phugoid::solver::{Control, Settings, Status};
use phugoid::{Error, Estimation, Experiment, Fit, Model, Parameter, Sigma};

const TAU: f64 = 0.8;
const GAIN: f64 = 2.0;
const SIGMA: f64 = 0.05;

/// ẋ = (gain u − x)/τ, measured as y = x.
fn lag(gain: Parameter) -> Model {
    let mut m = Model::new("lag");
    let (x, u) = (m.state("x", "m").unwrap(), m.input("u", "V").unwrap());
    let tau = Parameter::new("tau", 0.5).lower(0.01).unit("s");
    let (tau, gain) = (m.parameter(tau).unwrap(), m.parameter(gain).unwrap());
    m.equation("x", (gain * u - &x) / tau).unwrap();
    m.output("y", x, "m").unwrap();
    m
}

fn plain() -> Model {
    lag(Parameter::new("gain", 1.0))
}

/// The response to a step from x0, with uniform noise of standard deviation [`SIGMA`].
fn run(model: &Model, name: &str, x0: f64, seed: u64) -> Experiment {
    let mut random = Random(seed);
    let t: Vec<f64> = (0..80).map(|k| 0.05 * k as f64).collect();
    let noise = |random: &mut Random| SIGMA * 3f64.sqrt() * random.between(-1.0, 1.0);
    let y = t.iter().map(|t| GAIN + (x0 - GAIN) * (-t / TAU).exp() + noise(&mut random)).collect();
    Experiment::new(model, name, t.clone(), [("u", vec![1.0; t.len()]), ("y", y)]).unwrap()
}

#[track_caller]
fn assert_near(fit: &Fit, name: &str, truth: f64) {
    let found = &fit[name];
    assert!(found.std_error > 0.0 && found.std_error < 0.1, "{found:?}");
    assert!((found.value - truth).abs() < 4.0 * found.std_error, "{found:?}, in truth {truth}");
}

#[track_caller]
fn assert_error(result: Result<Fit, Error>, words: &[&str]) {
    let error = result.unwrap_err().to_string();
    words.iter().for_each(|word| assert!(error.contains(word), "no '{word}' in: {error}"));
}

#[test]
fn unknown_noise() {
    let model = plain();
    let runs = [run(&model, "run", 0.3, 1)];
    let fit = Estimation::new(&model, &runs).solve().unwrap();
    assert_eq!(fit.status, Status::Converged);
    assert!(fit.warnings.is_empty(), "{:?}", fit.warnings);
    assert_near(&fit, "tau", TAU);
    assert_near(&fit, "gain", GAIN);
    assert_near(&fit, "sigma_y", SIGMA);
    assert_eq!((fit["tau"].unit.as_str(), fit["sigma_y"].unit.as_str()), ("s", "m"));

    // At the optimum σ is the root mean square of the residuals, and −ℓ = N ln σ + N/2; σ² has variance 2σ⁴/N.
    let r = fit.residual(0, "y").unwrap();
    let (n, sigma) = (r.len() as f64, fit["sigma_y"].value);
    let rms = (r.iter().map(|r| r * r).sum::<f64>() / n).sqrt();
    assert!((rms / sigma - 1.0).abs() < 1e-7);
    assert!((fit.log_likelihood + n * (sigma.ln() + 0.5)).abs() < 1e-7 * n);
    assert!((fit["sigma_y"].std_error / (sigma / (2.0 * n).sqrt()) - 1.0).abs() < 1e-3);

    // Measured, less residual, is the output; the state is the output.
    let y = fit.output(0, "y").unwrap();
    assert!(y.iter().zip(r).zip(&runs[0].outputs[0]).all(|((y, r), z)| (y + r - z).abs() < 1e-14));
    assert_eq!(fit.state(0, "x").unwrap(), y);
    let first = &fit.records[0].initial[0];
    assert!((first.value - 0.3).abs() < 4.0 * first.std_error);

    // Covariance: symmetric, standard errors on its diagonal.
    let k = fit.parameters.len();
    for i in 0..k {
        assert!((fit.covariance[i * k + i].sqrt() / fit.parameters[i].std_error - 1.0).abs() < 1e-12);
        (0..k).for_each(|j| assert_eq!(fit.covariance[i * k + j], fit.covariance[j * k + i]));
    }
    let text = fit.to_string();
    for word in ["lag", "converged", "tau", "sigma_y", "RMS residual", "80 samples"] {
        assert!(text.contains(word), "no '{word}' in:\n{text}");
    }
    assert!(fit.parameter("sigma_x").is_none() && fit.state(1, "x").is_none() && fit.state(0, "y").is_none());
}

#[test]
fn two_experiments_share_parameters() {
    let model = plain();
    let both = [run(&model, "up", 0.3, 1), run(&model, "down", 3.0, 2)];
    let fit = Estimation::new(&model, &both).order(3).solve().unwrap();
    let alone = Estimation::new(&model, &both[..1]).order(3).solve().unwrap();
    assert_eq!(fit.status, Status::Converged);
    assert_near(&fit, "tau", TAU);
    assert_near(&fit, "gain", GAIN);
    assert!(fit["tau"].std_error < 0.9 * alone["tau"].std_error);
    assert_eq!(fit.records.iter().map(|r| r.name.as_str()).collect::<Vec<_>>(), ["up", "down"]);
    assert!((fit.records[1].initial[0].value - 3.0).abs() < 0.2);
    assert!(fit.to_string().contains("2 experiments, 160 samples"));
}

#[test]
fn a_known_sigma_scales_the_standard_errors() {
    let model = plain();
    let runs = [run(&model, "run", 0.3, 1)];
    let with = |sigma| Estimation::new(&model, &runs).noise("y", Sigma::Known(sigma)).solve().unwrap();
    let (fit, twice) = (with(SIGMA), with(2.0 * SIGMA));
    assert!(fit.parameter("sigma_y").is_none());
    for name in ["tau", "gain"] {
        assert!((fit[name].value - twice[name].value).abs() < 1e-7);
        // But for the curvature of the residuals.
        assert!((twice[name].std_error / fit[name].std_error - 2.0).abs() < 1e-3);
    }
}

#[test]
fn bounds_hold_and_are_reported() {
    let bounded = Parameter::new("gain", 1.0).upper(1.5);
    let fixed = Parameter::new("gain", 1.5).fixed(true);
    let fits = [(bounded, Bound::Upper), (fixed, Bound::Fixed)].map(|(gain, bound)| {
        let model = lag(gain);
        let fit = Estimation::new(&model, &[run(&model, "run", 0.3, 1)]).solve().unwrap();
        assert_eq!((fit.status, fit["gain"].value, fit["gain"].bound), (Status::Converged, 1.5, Some(bound)));
        assert!(fit["gain"].std_error.is_nan() && fit["tau"].std_error > 0.0 && fit["tau"].bound.is_none());
        assert!(fit.to_string().contains(&bound.to_string()));
        fit
    });
    assert!((fits[0]["tau"].value - fits[1]["tau"].value).abs() < 1e-6);

    let model = plain();
    let floor = Sigma::Unknown { start: 0.2, lower: 0.1, upper: 1.0 };
    let fit = Estimation::new(&model, &[run(&model, "run", 0.3, 1)]).noise("y", floor).solve().unwrap();
    assert_eq!(fit["sigma_y"].bound, Some(Bound::Lower));
    assert!((fit["sigma_y"].value - 0.1).abs() < 1e-12);
    assert!(fit.warnings[0].contains("sigma_y sits at its lower bound"));
}

#[test]
fn wrong_names_and_values_give_clear_errors() {
    let model = plain();
    let runs = [run(&model, "run", 0.3, 1)];
    let estimation = || Estimation::new(&model, &runs);
    assert_error(estimation().start("gian", 1.0).solve(), &["'gian'", "Did you mean 'gain'?"]);
    assert_error(estimation().noise("x", Sigma::Known(1.0)).solve(), &["noise: 'x' is not an output"]);
    assert_error(estimation().noise("y", Sigma::Known(-1.0)).solve(), &["output 'y'", "positive"]);
    assert_error(estimation().start("tau", -1.0).solve(), &["'tau' = -1.0 lies outside its bounds"]);
    assert_error(estimation().start("tau", f64::NAN).solve(), &["'tau' is NaN"]);
    assert_error(estimation().start("tau", vec![1.0]).solve(), &["'tau' is a parameter"]);
    assert_error(estimation().start("x", vec![1.0; 3]).solve(), &["state 'x'", "(80 for 'run')"]);
    assert_error(estimation().order(1).solve(), &["order 1"]);
    let known = estimation().noise("y", Sigma::Known(0.1)).start("sigma_y", 0.2);
    assert_error(known.solve(), &["sigma_y is known (0.1)"]);
    assert_error(Estimation::new(&model, &[]).solve(), &["no experiment"]);
    let settings = Settings::default().tolerance(2.0);
    assert_error(estimation().solver(settings).solve(), &["tolerance 2"]);

    let twice = [runs[0].clone(), runs[0].clone()];
    let message = &["two experiments are called 'run'"];
    assert_error(Estimation::new(&model, &twice).solve(), message);
    let known = || Noise::Gaussian(vec![Sigma::Known(0.1)]);
    let collocation = Collocation::new(&model, &twice, known(), &collocation::Settings::default());
    assert!(collocation.unwrap_err().to_string().contains(message[0]));
    let settings = filter::Settings { states: vec!["x".into()], substeps: 1, terms: 1, initial: vec![None] };
    let filter = Filter::new(&model, &twice, &known(), &settings);
    assert!(filter.unwrap_err().to_string().contains(message[0]));

    let mut still = runs.clone();
    still[0].outputs[0].fill(1.0);
    assert_error(
        Estimation::new(&model, &still).solve(),
        &["output 'y' is the same in all samples", "known"],
    );
    let mut incomplete = model.clone();
    incomplete.dynamics.clear();
    assert_error(Estimation::new(&incomplete, &runs).solve(), &["state 'x' has no equation"]);

    let wrong = |name| Experiment::new(&model, "run", vec![0.0, 1.0], [(name, vec![0.0; 2])]).unwrap_err();
    assert!(wrong("v").to_string().contains("no input or output 'v'"));
    assert!(wrong("u").to_string().contains("no channel 'y'"));
}

#[test]
fn a_model_that_is_not_finite_at_the_start_is_an_error() {
    let mut m = Model::new("root");
    let (x, a) = (m.state("x", "").unwrap(), m.parameter(Parameter::new("a", -1.0)).unwrap());
    m.equation("x", (&a * &x).sqrt()).unwrap();
    m.output("x", x, "").unwrap();
    let run = Experiment::new(&m, "run", vec![0.0, 0.1, 0.2], [("x", vec![1.0, 1.1, 1.2])]).unwrap();
    assert_error(
        Estimation::new(&m, &[run]).solve(),
        &["at the starting point", "x'", "sqrt", "t = 0", "'run'"],
    );
}

/// States start as measured, also through an output that is affine in one; else at 0, or as given.
#[test]
fn states_start_as_measured_or_given() {
    let mut m = Model::new("chain");
    let (a, b) = (m.state("a", "").unwrap(), m.state("b", "").unwrap());
    let bias = m.parameter(Parameter::new("bias", 0.5)).unwrap();
    m.equation("a", b.clone()).unwrap();
    m.equation("b", -&a).unwrap();
    m.output("a", 2.0 * &a + &bias, "").unwrap();
    m.output("product", &a * &b, "").unwrap();
    let z = [1.5, f64::NAN, 3.5];
    let run =
        Experiment::new(&m, "run", vec![0.0, 1.0, 2.0], [("a", z.to_vec()), ("product", vec![1., 2., 3.])]);
    let runs = [run.unwrap()];
    let states = |estimation: Estimation<'_>| {
        let (problem, xi) = estimation.order(2).transcribe().unwrap();
        xi[problem.layout.state(PointId(0)).0..].to_vec()
    };
    // A missing sample is bridged.
    assert_eq!(states(Estimation::new(&m, &runs)), [0.5, 0.0, 1.0, 0.0, 1.5, 0.0]);
    assert_eq!(states(Estimation::new(&m, &runs).start("bias", 1.5)), [0.0, 0.0, 0.5, 0.0, 1.0, 0.0]);
    let given = Estimation::new(&m, &runs).start("a", 7.0).start("b", vec![1.0, 2.0, 3.0]);
    assert_eq!(states(given), [7.0, 1.0, 7.0, 2.0, 7.0, 3.0]);
}

#[test]
fn a_run_goes_on_from_a_fit() {
    let model = plain();
    let runs = [run(&model, "run", 0.3, 1)];
    let mut seen = 0;
    let stopped = Estimation::new(&model, &runs)
        .regression(false)
        .solve_with(|_| {
            seen += 1;
            if seen == 3 { Control::Stop } else { Control::Continue }
        })
        .unwrap();
    assert_eq!((stopped.status, stopped.iterations, seen), (Status::Interrupted, 2, 3));
    let fit = Estimation::new(&model, &runs).start_from(&stopped).solve().unwrap();
    let again = Estimation::new(&model, &runs).start_from(&fit).solve().unwrap();
    assert_eq!((fit.status, again.status), (Status::Converged, Status::Converged));
    assert!(again.iterations <= 1, "{}", again.iterations);

    // Of another order, and of a model with a parameter more: by name.
    let finer = Estimation::new(&model, &runs).order(6).start_from(&fit);
    let (problem, xi) = finer.transcribe().unwrap();
    assert_eq!(&xi[..2], &[fit["tau"].value, fit["gain"].value]);
    assert!((xi[problem.layout.state(PointId(0))] - fit.state(0, "x").unwrap()[0]).abs() < 1e-15);
    assert!(finer.solve().unwrap().iterations <= 3);
    let mut extended = model.clone();
    let bias = extended.parameter(Parameter::new("bias", 0.0)).unwrap();
    extended.outputs[0].expr = &extended.outputs[0].expr + &bias;
    let fit = Estimation::new(&extended, &runs).start_from(&fit).solve().unwrap();
    // The bias trades off against the gain: nothing but their sum is measured.
    assert_eq!(fit.status, Status::Unidentifiable);
    assert!(fit.message.contains("gain") && fit.message.contains("bias"), "{}", fit.message);
    assert!(fit["bias"].std_error.is_nan() && fit["tau"].std_error > 0.0);
}

#[test]
fn a_prior_pulls_but_is_no_part_of_the_likelihood() {
    let tight = Parameter::new("gain", 1.0).prior((1.5, 1e-3));
    let model = lag(tight);
    let runs = [run(&model, "run", 0.3, 1)];
    let fit = Estimation::new(&model, &runs).solve().unwrap();
    assert!((fit["gain"].value - 1.5).abs() < 0.01 && fit["gain"].std_error < 1.1e-3);
    let (problem, _) = Estimation::new(&model, &runs).transcribe().unwrap();
    let prior = 0.5 * ((fit["gain"].value - 1.5) / 1e-3).powi(2);
    let objective = problem.objective(&fit.solution.xi).unwrap();
    assert!(prior > 1e-3 && (fit.log_likelihood - (prior - objective)).abs() < 1e-9);
}

/// A parameter of which only the sum with another acts: all is determined but for rounding, or nothing is.
#[test]
fn parameters_that_cannot_be_told_apart_are_named() {
    let mut model = plain();
    let other = model.parameter(Parameter::new("other", 1.0)).unwrap();
    model.dynamics[0].expr =
        &model.dynamics[0].expr + other * phugoid::Expr::symbol("u") / phugoid::Expr::symbol("tau");
    let runs = [run(&model, "run", 0.3, 1)];
    let fit = Estimation::new(&model, &runs).solve().unwrap();
    assert!(
        fit.warnings.iter().any(|w| w.starts_with("gain, other cannot be distinguished")),
        "{:?}",
        fit.warnings
    );
}
