//! Noise as a model declares it: saved with it, and used unless an estimation says otherwise.

use phugoid::noise::{Custom, Joint, NoiseModel, Scale};
use phugoid::{Density, Dof, Estimation, Experiment, Expr, Fit, Model, Parameter, Sigma};

/// x = p, measured as y and z.
fn level() -> Model {
    let mut m = Model::new("level");
    let x = m.state("x", "m").unwrap();
    let rate = m.parameter(Parameter::new("rate", 0.0)).unwrap();
    m.equation("x", rate).unwrap();
    m.output("y", x.clone(), "").unwrap();
    m.output("z", 2.0 * x, "m").unwrap();
    m
}

fn runs(model: &Model) -> Vec<Experiment> {
    let run = |name: &str, factor: f64| {
        let t: Vec<f64> = (0..60).map(|k| 0.1 * k as f64).collect();
        let noise = |k: f64, t: f64| factor * 0.1 * (k * t).sin();
        let y = t.iter().map(|t| 1.0 + 0.3 * t + noise(1e4, *t)).collect();
        let z = t.iter().map(|t| 2.0 + 0.6 * t + noise(2e4, *t)).collect();
        Experiment::new(model, name, t, [("y", y), ("z", z)]).unwrap()
    };
    vec![run("one", 1.0), run("two", 3.0)]
}

fn names(fit: &Fit) -> Vec<&str> {
    fit.parameters.iter().map(|p| p.name.as_str()).collect()
}

fn custom() -> Density {
    let (r, sigma, share) = (Expr::symbol("residual"), Expr::symbol("sigma"), Expr::symbol("share"));
    let e = &r / &sigma;
    let good = (-0.5 * &e * &e).exp();
    let wide = (-0.5 * &e * &e / 100.0).exp() / 10.0;
    let log_density = ((1.0 - &share) * good + share * wide).log() - sigma.log();
    let share = Parameter::new("share", 0.05).lower(1e-3).upper(0.5);
    Density::Custom(Custom { log_density, parameters: vec![share] })
}

fn kinds() -> Vec<NoiseModel> {
    let new = NoiseModel::new;
    let open = Scale::Unknown { start: None, bounds: Some((1e-3, 1.0)) };
    vec![
        new(),
        new().scale("y", Sigma::Known(0.1)).scale("z", open),
        new().scale("y", Scale::Unknown { start: Some(0.2), bounds: None }),
        new().correlated(),
        new().covariance(vec![0.01, 1e-4, 1e-4, 0.02]),
        new().density("y", Density::StudentT(Dof::Unknown { start: 7.0, lower: 1.0, upper: 50.0 })),
        new()
            .density("y", Density::Huber(1.5))
            .density("z", Density::Laplace(0.2))
            .scale("z", Sigma::Known(0.2)),
        new().density("z", custom()),
        new().per_experiment(),
        new().density("z", Density::StudentT(Dof::Known(4.0))).per_experiment(),
    ]
}

#[cfg(feature = "serde")]
#[test]
fn noise_is_saved_with_the_model() {
    for noise in kinds() {
        let mut model = level();
        model.noise = noise;
        let again = Model::from_json(&model.to_json()).unwrap();
        assert_eq!(again, model);
        assert_eq!(model.to_json().contains("\"noise\""), model.noise != NoiseModel::new());
    }
}

/// The same as said to the estimation.
#[test]
fn declared_or_said_is_the_same() {
    for noise in kinds() {
        let mut model = level();
        let runs = runs(&model);
        let said = Estimation::new(&model, &runs).noise_model(noise.clone()).solve().unwrap();
        model.noise = noise;
        let declared = Estimation::new(&model, &runs).solve().unwrap();
        let told = |fit: &Fit| fit.parameters.iter().map(|p| format!("{p:?}")).collect::<Vec<String>>();
        assert_eq!(told(&said), told(&declared), "{:?}", model.noise); // NaN is NaN here
    }
}

#[test]
fn each_experiment_has_its_own() {
    let model = level();
    let runs = runs(&model);
    let fit =
        Estimation::new(&model, &runs).noise_per_experiment().noise("z", Sigma::Known(0.2)).solve().unwrap();
    assert_eq!(names(&fit), ["rate", "sigma_y[one]", "sigma_y[two]"]);
    let ratio = fit["sigma_y[two]"].value / fit["sigma_y[one]"].value;
    assert!((ratio - 3.0).abs() < 0.2, "{ratio}");
}

#[test]
fn contradictions_are_named() {
    let mut model = level();
    let runs = runs(&model);
    let refused = |estimation: Estimation<'_>, words: &[&str]| {
        let error = estimation.solve().unwrap_err().to_string();
        words.iter().for_each(|word| assert!(error.contains(word), "no '{word}' in: {error}"));
    };
    refused(
        Estimation::new(&model, &runs).correlated().density("y", Density::Huber(1.3)),
        &["Gaussian", "'y'"],
    );
    let known = || Estimation::new(&model, &runs).covariance(vec![1.0, 0.0, 0.0, 1.0]);
    refused(known().noise("y", Sigma::Known(1.0)), &["covariance is known", "sigma_y"]);
    refused(known().start("sigma_z", 1.0), &["covariance is known", "sigma_z"]);
    model.noise.scales.push(("zz".into(), Scale::Known(1.0)));
    refused(Estimation::new(&model, &runs), &["'zz' is not an output"]);
    assert_eq!(model.noise.joint, Joint::Independent);
}

#[cfg(feature = "serde")]
#[test]
fn damaged_noise_is_refused() {
    let text = level().to_json();
    let with = |noise: &str| {
        let damaged = format!("{},\"noise\":{noise}}}", &text[..text.len() - 1]);
        Model::from_json(&damaged).unwrap_err().to_string()
    };
    assert!(with(r#"{"kind":"cosmic","sigma":{}}"#).contains("'cosmic' is not known"));
    assert!(with(r#"{"kind":"huber","sigma":{}}"#).contains("no k"));
    assert!(with(r#"{"kind":"gaussian","sigma":{},"covariance":[[1.0]]}"#).contains("1 rows"));
    assert!(with(r#"{"kind":"gaussian","sigma":{},"covariance":{"q":{"q":1.0}}}"#).contains("'q'"));
}
