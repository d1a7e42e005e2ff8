//! Noise other than independent Gaussian, from Rust: what it recovers, reports and refuses.

use crate::common::Random;
use phugoid::noise::{Covariance, Custom};
use phugoid::solver::Status;
use phugoid::{Density, Dof, Estimation, Experiment, Expr, Model, Noise, Parameter, Sigma};

const N: usize = 400;

/// Two levels, measured.
fn levels() -> Model {
    let mut m = Model::new("levels");
    for name in ["a", "b"] {
        let x = m.state(&format!("x_{name}"), "").unwrap();
        let slope = m.parameter(Parameter::new(&format!("slope_{name}"), 0.0)).unwrap();
        m.equation(&format!("x_{name}"), slope).unwrap();
        m.output(name, x, "m").unwrap();
    }
    m
}

/// Slopes 1 and 2, with noise of each sample.
fn run(m: &Model, noise: impl Fn(&mut Random) -> [f64; 2]) -> [Experiment; 1] {
    let mut random = Random(7);
    let t: Vec<f64> = (0..N).map(|k| 0.01 * k as f64).collect();
    let (a, b) = t
        .iter()
        .map(|t| {
            let e = noise(&mut random);
            (t + e[0], 2.0 * t + e[1])
        })
        .unzip();
    [Experiment::new(m, "run", t, [("a", a), ("b", b)]).unwrap()]
}

/// Standard normal, as good as (Irwin and Hall).
fn normal(random: &mut Random) -> f64 {
    (0..12).map(|_| random.between(-0.5, 0.5)).sum()
}

#[test]
fn a_full_covariance_is_that_of_the_residuals() {
    let m = levels();
    let runs = run(&m, |r| {
        let (x, y) = (normal(r), normal(r));
        [0.1 * x, 0.2 * (0.6 * x + 0.8 * y)]
    });
    let fit = Estimation::new(&m, &runs).correlated().solve().unwrap();
    assert_eq!(fit.status, Status::Converged);
    let names: Vec<&str> = fit.parameters.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names, ["slope_a", "slope_b", "sigma_a", "sigma_b", "corr_a_b"]);
    let r = &fit.records[0].residuals;
    let mean = |i: usize, j: usize| r[i].iter().zip(&r[j]).map(|(x, y)| x * y).sum::<f64>() / N as f64;
    let (sa, sb) = (mean(0, 0).sqrt(), mean(1, 1).sqrt());
    let correlation = mean(0, 1) / (sa * sb);
    for (name, expected) in [("sigma_a", sa), ("sigma_b", sb), ("corr_a_b", correlation)] {
        assert!(
            (fit[name].value / expected - 1.0).abs() < 1e-7,
            "{name}: {} for {expected}",
            fit[name].value
        );
    }
    let error = (1.0 - correlation * correlation) / (N as f64).sqrt();
    assert!((fit["corr_a_b"].std_error / error - 1.0).abs() < 0.01);
    assert!((fit["corr_a_b"].value - 0.6).abs() < 4.0 * error);
    assert_eq!((fit["sigma_a"].unit.as_str(), fit["corr_a_b"].unit.as_str()), ("m", ""));

    let again = Estimation::new(&m, &runs).correlated().start_from(&fit).solve().unwrap();
    assert!(again.iterations <= 1);
    let known = Estimation::new(&m, &runs).covariance(vec![mean(0, 0), mean(0, 1), mean(0, 1), mean(1, 1)]);
    let known = known.solve().unwrap();
    assert!((known.log_likelihood - fit.log_likelihood).abs() < 1e-7 * fit.log_likelihood.abs());
    assert_eq!(known.parameters.len(), 2);
}

#[test]
fn robust_densities_withstand_outliers() {
    let m = levels();
    let runs =
        run(&m, |r| [0.05 * normal(r) + if r.between(0.0, 1.0) < 0.1 { 3.0 } else { 0.0 }, 0.1 * normal(r)]);
    let gaussian = Estimation::new(&m, &runs).solve().unwrap();
    assert!(gaussian["sigma_a"].value > 0.5);
    let (r, sigma) = (Expr::symbol("residual"), Expr::symbol("sigma"));
    let e = &r / &sigma;
    let cauchy = -(1.0 + &e * &e).log() - sigma.log();
    let dof = Dof::Unknown { start: 5.0, lower: 1.0, upper: 50.0 };
    for density in [
        Density::StudentT(Dof::Known(3.0)),
        Density::StudentT(dof),
        Density::Custom(Custom { log_density: cauchy, parameters: Vec::new() }),
    ] {
        let fit = Estimation::new(&m, &runs).density("a", density.clone()).solve().unwrap();
        assert_eq!(fit.status, Status::Converged);
        assert!((fit["slope_a"].value - 1.0).abs() < 0.02, "{density:?}: {:?}", fit["slope_a"]);
        assert!(fit["sigma_a"].value < 0.1, "{density:?}: {:?}", fit["sigma_a"]);
        let estimated = density == Density::StudentT(dof);
        assert_eq!(fit.parameter("dof_a").is_some(), estimated);
    }
}

#[test]
fn what_is_no_noise_is_refused() {
    let m = levels();
    let runs = run(&m, |r| [normal(r), normal(r)]);
    let of = || Estimation::new(&m, &runs);
    for (estimation, words) in [
        (of().density("c", Density::Huber(1.0)), "'c' is not an output"),
        (of().density("a", Density::Huber(-1.0)), "Huber's k is -1"),
        (of().density("a", Density::StudentT(Dof::Known(0.0))), "0 degrees of freedom"),
        (of().covariance(vec![1.0]), "a covariance of 2 outputs has 2² entries, not 1"),
        (of().covariance(vec![1.0, 2.0, 2.0, 1.0]), "not positive definite"),
        (of().correlated().noise("a", Sigma::Known(0.1)), "all standard deviations are known, or none"),
        (of().start("corr_a_b", 0.1), "'corr_a_b' is not a parameter"),
        (of().correlated().start("corr_a_b", 2.0), "outside its bounds"),
    ] {
        let error = estimation.solve().unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

/// Gradients of what is reported against differences.
#[test]
fn gradients_of_what_is_reported() {
    let sigma = Sigma::Unknown { start: 0.5, lower: 1e-3, upper: 1e3 };
    let correlation = [1.0, 0.3, -0.2, 0.3, 1.0, 0.5, -0.2, 0.5, 1.0];
    let noise = Noise::Correlated(Covariance::unknown(vec![sigma; 3]).starting_at(&correlation));
    let outputs = ["a", "b", "c"];
    noise.check(&outputs).unwrap();
    let at: Vec<f64> = noise.parameters(&outputs).iter().map(|p| p.start).collect();
    let found = noise.report(&outputs, &at);
    let expected =
        [("sigma_a", 0.5), ("sigma_b", 0.5), ("sigma_c", 0.5), ("corr_a_b", 0.3), ("corr_a_c", -0.2)];
    for (r, (name, value)) in found.iter().zip(expected) {
        assert!(r.name == name && (r.value - value).abs() < 1e-14, "{r:?}");
    }
    for k in 0..at.len() {
        let moved = |d: f64| {
            let mut x = at.clone();
            x[k] += d;
            noise.report(&outputs, &x)
        };
        for ((r, high), low) in found.iter().zip(moved(1e-6)).zip(moved(-1e-6)) {
            let slope = (high.value - low.value) / 2e-6;
            assert!((r.gradient[k] - slope).abs() < 1e-8, "{}: {} for {slope}", r.name, r.gradient[k]);
        }
    }
    assert_eq!((noise.n_scales(), noise.precision_roots()), (6, vec![0, 3, 5]));
}
