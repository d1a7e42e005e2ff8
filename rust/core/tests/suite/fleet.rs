//! Sums over records with the shared variables held: derivatives, and the estimate that they lead to.

use phugoid::collocation::Settings;
use phugoid::fleet::{Detail, Share, SharedVariable};
use phugoid::{Estimation, Experiment, Model, NoiseModel, Parameter, Sigma};

/// A damped oscillator whose position is measured with a bias of each record's own.
fn model() -> Model {
    let mut m = Model::new("oscillator");
    let (x, v, u) = (m.state("x", "m").unwrap(), m.state("v", "m/s").unwrap(), m.input("u", "N").unwrap());
    let k = m.parameter(Parameter::new("k", 1.0).lower(0.0).prior((4.0, 0.5))).unwrap();
    let c = m.parameter(Parameter::new("c", 0.1)).unwrap();
    let cubic = m.parameter(Parameter::new("cubic", 0.0)).unwrap();
    let bias = m.parameter(Parameter::new("bias", 0.0).local(true)).unwrap();
    m.equation("x", v.clone()).unwrap();
    m.equation("v", u - k * &x - c * &v - cubic * x.pow(3.0)).unwrap();
    m.output("x", x + bias, "m").unwrap();
    m.output("v", v, "m/s").unwrap();
    m
}

/// Records of different lengths, one with missing samples, from a simulation by small steps.
fn records(m: &Model, count: usize) -> Vec<Experiment> {
    let record = |e: usize| {
        let n = 120 + 15 * (e % 2);
        let t: Vec<f64> = (0..n).map(|i| 0.1 * i as f64).collect();
        let u: Vec<f64> = t.iter().map(|t| (0.7 * t + e as f64).sin()).collect();
        let (mut x, mut v) = (1.0 + 0.2 * e as f64, -0.3 * e as f64);
        let (mut xs, mut vs) = (Vec::new(), Vec::new());
        let mut random = fastrand::Rng::with_seed(e as u64);
        let mut noise = || (0..12).map(|_| random.f64()).sum::<f64>() - 6.0;
        let bias = 0.05 * e as f64 - 0.1;
        for i in 0..n {
            xs.push(x + bias + 0.02 * noise());
            vs.push(v + 0.03 * noise());
            let next = u[(i + 1).min(n - 1)];
            for s in 0..50 {
                let now = u[i] + (next - u[i]) * (f64::from(s) + 0.5) / 50.0;
                let a = now - 4.0 * x - 0.3 * v - 0.4 * x.powi(3);
                (x, v) = (x + 0.002 * v + 0.5 * 4e-6 * a, v + 0.002 * a);
            }
        }
        if e == 2 {
            vs[40..60].fill(f64::NAN);
        }
        let channels = [("u", u), ("x", xs), ("v", vs)];
        Experiment::new(m, &format!("record {e}"), t, channels).unwrap()
    };
    (0..count).map(record).collect()
}

fn share(m: &Model, records: &[Experiment], start: &[(&str, f64)]) -> (Share, Vec<SharedVariable>) {
    let mut share = Share::new(m, &NoiseModel::new())
        .unwrap()
        .transcription(Settings::default().order(4).threads(2))
        .unwrap()
        .spreads(vec![1.0, 1.0])
        .priors(true);
    let start: Vec<_> = start.iter().map(|(name, value)| ((*name).to_owned(), (*value).into())).collect();
    let variables = share.variables(&records[0], &start).unwrap();
    (share, variables)
}

const NEAR: [(&str, f64); 5] =
    [("k", 3.9), ("c", 0.31), ("cubic", 0.42), ("sigma_x", 0.021), ("sigma_v", 0.03)];

#[test]
fn derivatives_of_the_sums_are_those_of_the_value() {
    let m = model();
    let records = records(&m, 4);
    let (mut share, variables) = share(&m, &records, &NEAR);
    let names: Vec<&str> = variables.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["k", "c", "cubic", "1/sigma_x", "1/sigma_v"]);
    let at: Vec<f64> = variables.iter().map(|v| v.start).collect();
    // Twice, so that the Hessian is that at the path, and not a step before.
    share.evaluate(&records, &at);
    let found = share.evaluate(&records, &at);
    assert_eq!((found.records, found.failures.len()), (4, 0));
    let n = at.len();
    for i in 0..n {
        let h = 1e-4 * at[i];
        let mut side = |sign: f64| {
            let mut moved = at.clone();
            moved[i] += sign * h;
            share.evaluate(&records, &moved);
            share.evaluate(&records, &moved)
        };
        let (above, below) = (side(1.0), side(-1.0));
        let slope = (above.value - below.value) / (2.0 * h);
        let size = (found.hessian[i * n + i]).sqrt();
        assert!((slope - found.gradient[i]).abs() < 1e-5 * size.max(found.gradient[i].abs()), "{i}: {slope}");
        for j in 0..n {
            let curvature = (above.gradient[j] - below.gradient[j]) / (2.0 * h);
            let scale = (found.hessian[i * n + i] * found.hessian[j * n + j]).sqrt();
            assert!((curvature - found.hessian[i * n + j]).abs() < 1e-4 * scale, "{i} {j}");
        }
    }
}

#[test]
fn newton_on_the_sums_ends_at_the_estimate_from_all_records_together() {
    let m = model();
    let records = records(&m, 5);
    let fit = Estimation::new(&m, &records).order(4).solve().unwrap();
    let aside: Vec<(&str, f64)> = NEAR.map(|(name, _)| (name, fit[name].value + fit[name].std_error)).into();
    let (mut share, variables) = share(&m, &records, &aside);
    let mut at: Vec<f64> = variables.iter().map(|v| v.start).collect();
    let n = at.len();
    let mut last = nalgebra::DMatrix::zeros(n, n);
    for _ in 0..8 {
        let found = share.evaluate(&records, &at);
        let gradient = nalgebra::DVector::from_row_slice(&found.gradient);
        let hessian = nalgebra::DMatrix::from_row_slice(n, n, &found.hessian);
        let step = hessian.clone().lu().solve(&gradient).unwrap();
        at.iter_mut().zip(step.iter()).for_each(|(x, s)| *x -= s);
        last = hessian;
    }
    let covariance = last.try_inverse().unwrap();
    let (estimates, covariance) = share.report(&records[0], &at, covariance.as_slice()).unwrap();
    assert_eq!(estimates.len(), 5);
    for (i, e) in estimates.iter().enumerate() {
        let whole = fit.parameter(&e.name).unwrap();
        assert!(
            (e.value - whole.value).abs() < 1e-5 * whole.std_error,
            "{}: {} {}",
            e.name,
            e.value,
            whole.value
        );
        assert!((e.std_error / whole.std_error - 1.0).abs() < 1e-5, "{}", e.name);
        assert!((covariance[i * n + i].sqrt() / e.std_error - 1.0).abs() < 1e-12);
    }
    let described = share.evaluate_with(&records, &at, Detail::default().described(true)).results;
    assert_eq!(described.len(), 5);
    for (e, result) in described.iter().enumerate() {
        let bias = fit.parameter(&format!("bias[record {e}]")).unwrap();
        assert!((result.own[0] - bias.value).abs() < 1e-5 * bias.std_error);
        assert!(result.own_errors[0] > 0.0 && result.own_errors[0] < 1.001 * bias.std_error);
        let initial = &fit.records[e].initial;
        assert!((result.initial[0] - initial[0].value).abs() < 1e-5 * initial[0].std_error);
    }
}

#[test]
fn a_record_that_is_lost_is_named_and_the_others_count() {
    let m = model();
    let mut records = records(&m, 3);
    let (mut share, variables) = share(&m, &records, &NEAR);
    let at: Vec<f64> = variables.iter().map(|v| v.start).collect();
    let all = share.evaluate(&records, &at);
    records[1].t[5] = records[1].t[4];
    let found = share.evaluate(&records, &at);
    assert_eq!((all.records, found.records), (3, 2));
    let failure = &found.failures[0];
    assert!(failure.record == "record 1" && failure.of_data, "{failure:?}");
}

#[test]
fn one_factorisation_a_record_is_enough_once_the_path_is_known() {
    let m = model();
    let records = records(&m, 3);
    let (mut share, variables) = share(&m, &records, &NEAR);
    let mut at: Vec<f64> = variables.iter().map(|v| v.start).collect();
    share.evaluate(&records, &at);
    at[0] += 1e-4;
    assert_eq!(share.evaluate(&records, &at).factorizations, 3);
}

#[test]
fn bounds_on_states_are_met_by_the_sparse_factorisation() {
    let mut m = Model::new("tank");
    let level = m.state("level", "m").unwrap();
    (m.states[0].lower, m.states[0].upper) = (Some(0.0), Some(10.0));
    let k = m.parameter(Parameter::new("k", 0.3)).unwrap();
    m.equation("level", -(k * &level)).unwrap();
    m.output("level", level, "m").unwrap();
    let t: Vec<f64> = (0..50).map(|i| 0.1 * i as f64).collect();
    let z = t.iter().map(|t| 2.0 * (-0.5 * t).exp() + 0.01 * (1e4 * t).sin()).collect();
    let record = Experiment::new(&m, "run", t, [("level", z)]).unwrap();
    let noise = NoiseModel::new().scale("level", Sigma::Known(0.01));
    let mut share = Share::new(&m, &noise).unwrap();
    let mut at = share.variables(&record, &[]).unwrap()[0].start;
    for _ in 0..10 {
        let found = share.evaluate(std::slice::from_ref(&record), &[at]);
        at -= found.gradient[0] / found.hessian[0];
    }
    let fit = Estimation::new(&m, &[record]).noise("level", Sigma::Known(0.01)).solve().unwrap();
    assert!((at - fit["k"].value).abs() < 1e-5 * fit["k"].std_error, "{at} {}", fit["k"].value);
}
