//! Estimation while data arrive.

use phugoid::online::{Arrival, Cause, Detect, Estimate, Forgetting, Online, OnlineError, Settings};
use phugoid::{Estimation, Experiment, Fit, Model, NoiseModel, Parameter, Sigma};

use crate::common::{Random, flights, models};

/// Normal numbers by Box and Muller.
fn normal(random: &mut Random) -> f64 {
    let (a, b) = (random.between(0.0, 1.0), random.between(0.0, 1.0));
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

/// x' = a (u − x), y = x + b u.
fn lag() -> Model {
    let mut m = Model::new("lag");
    let (x, u) = (m.state("x", "").unwrap(), m.input("u", "").unwrap());
    let a = m.parameter(Parameter::new("a", 1.0)).unwrap();
    let b = m.parameter(Parameter::new("b", 0.0)).unwrap();
    m.equation("x", a * (&u - &x)).unwrap();
    m.output("y", x + b * u, "").unwrap();
    m
}

/// A record of N samples at 10 Hz: x' = a(t) (u − x), b = 0.5, noise σ = 0.05.
fn record(n: usize, a: impl Fn(f64) -> f64, random: &mut Random) -> [Vec<f64>; 3] {
    let (mut x, mut out) = (0.0, [Vec::new(), Vec::new(), Vec::new()]);
    for k in 0..n {
        let t = 0.1 * k as f64;
        let u = f64::from(u8::from((t / 2.3).sin() > 0.0));
        for (column, value) in out.iter_mut().zip([t, u, x + 0.5 * u + 0.05 * normal(random)]) {
            column.push(value);
        }
        x = u + (x - u) * (-0.1 * a(t)).exp();
    }
    out
}

fn settings() -> Settings {
    // Inputs are held: the record's are.
    Settings::default()
        .interpolation(phugoid::Interpolation::Hold)
        .sigma("y", 0.05)
        .parameter("a", 1.0)
        .parameter("b", 1.0)
}

fn stream<'a>(online: &'a mut Online, [t, u, y]: &[Vec<f64>; 3]) -> &'a Estimate {
    for ((t, u), y) in t.iter().zip(u).zip(y) {
        online.push(*t, &[*u], &[*y]).unwrap();
    }
    online.estimate()
}

fn batch(model: &Model, [t, u, y]: &[Vec<f64>; 3]) -> Fit {
    let mut run = Experiment::new(model, "run", t.clone(), [("u", u.clone()), ("y", y.clone())]).unwrap();
    run.interpolation = phugoid::Interpolation::Hold;
    let noise = NoiseModel::new().scale("y", Sigma::Known(0.05));
    Estimation::new(model, &[run]).noise_model(noise).solve().unwrap()
}

/// Distance of the parameters from those of a fit, in its standard errors.
fn distance(estimate: &Estimate, fit: &Fit, names: &[&str]) -> f64 {
    let one =
        |(k, name): (usize, &&str)| (estimate.parameters[k] - fit[*name].value).abs() / fit[*name].std_error;
    names.iter().enumerate().map(one).fold(0.0, f64::max)
}

#[test]
fn a_record_streamed_gives_the_estimate_of_the_batch() {
    let model = lag();
    let data = record(400, |_| 0.8, &mut Random(1));
    let fit = batch(&model, &data);
    for (window, first) in [(1, 100), (2, 100), (20, 100), (50, 0)] {
        let mut online = Online::new(&model, settings().window(window).first_window(first)).unwrap();
        let estimate = stream(&mut online, &data);
        let distance = distance(estimate, &fit, &["a", "b"]);
        assert!(distance < 0.15, "window {window}: {distance} {estimate:?}");
        for (k, name) in ["a", "b"].into_iter().enumerate() {
            let ratio = estimate.parameter_errors[k] / fit[name].std_error;
            assert!((ratio - 1.0).abs() < 0.02, "window {window}: {name} {ratio}");
        }
    }
}

#[test]
fn a_window_of_the_whole_record_is_the_batch_itself() {
    let model = lag();
    let data = record(60, |_| 0.8, &mut Random(2));
    let fit = batch(&model, &data);
    let mut online = Online::new(&model, settings().window(60).iterations(10).tolerance(1e-8)).unwrap();
    let estimate = stream(&mut online, &data);
    // The prior is all that differs.
    assert!(distance(estimate, &fit, &["a", "b"]) < 0.02, "{estimate:?}");
}

#[test]
fn missing_and_late_samples_end_where_samples_in_order_do() {
    let model = lag();
    let [t, u, y] = record(200, |_| 0.8, &mut Random(3));
    let mut online = Online::new(&model, settings().window(20)).unwrap();
    let mut late = Online::new(&model, settings().window(20)).unwrap();
    let mut missing = Online::new(&model, settings().window(20)).unwrap();
    for k in 0..t.len() {
        online.push(t[k], &[u[k]], &[y[k]]).unwrap();
        let hidden = k % 7 == 3;
        let now = if hidden { f64::NAN } else { y[k] };
        late.push(t[k], &[u[k]], &[now]).unwrap();
        missing.push(t[k], &[u[k]], &[now]).unwrap();
        if k >= 2 && (k - 2) % 7 == 3 {
            let estimate = late.push(t[k - 2], &[f64::NAN], &[y[k - 2]]).unwrap();
            assert_eq!(estimate.arrival, Arrival::Late);
        }
    }
    let (all, late, missing) = (online.estimate(), late.estimate(), missing.estimate());
    for k in 0..2 {
        let error = all.parameter_errors[k];
        let distance = (all.parameters[k] - late.parameters[k]).abs() / error;
        assert!(distance < 0.1, "{k}: {distance}");
        assert!((error - late.parameter_errors[k]).abs() < 0.01 * error);
        assert!(missing.parameter_errors[k] > 1.03 * error);
    }
}

#[test]
fn an_output_between_two_samples_is_put_in() {
    let model = lag();
    let mut online = Online::new(&model, settings().window(10)).unwrap();
    let [t, u, y] = record(50, |_| 0.8, &mut Random(4));
    for k in 0..50 {
        online.push(t[k], &[u[k]], &[y[k]]).unwrap();
    }
    let before = online.estimate().clone();
    let estimate = online.push(4.75, &[f64::NAN], &[y[47]]).unwrap();
    assert_eq!((estimate.arrival, estimate.t), (Arrival::Late, t[49]));
    assert!(estimate.state_errors[0] < before.state_errors[0]);
    let now = estimate.clone();
    let estimate = online.push(1.0, &[0.0], &[9.0]).unwrap();
    assert_eq!(estimate.arrival, Arrival::TooLate);
    assert_eq!(estimate.parameters, now.parameters);
}

#[test]
fn what_a_stream_does_wrong_is_named_and_nothing_lost() {
    let model = lag();
    let mut online = Online::new(&model, settings().window(3).max_gap(1.0)).unwrap();
    let [t, u, y] = record(20, |_| 0.8, &mut Random(5));
    stream(&mut online, &[t.clone(), u.clone(), y.clone()]);
    let before = online.estimate().clone();
    let wrong = [
        (online.push(f64::NAN, &[0.0], &[0.0]).unwrap_err(), "the time of the sample is NaN"),
        (online.push(2.0, &[f64::NAN], &[0.0]).unwrap_err(), "channel 'u' is NaN at t = 2 s"),
        (online.push(2.0, &[0.0], &[f64::INFINITY]).unwrap_err(), "channel 'y' is inf at t = 2 s"),
        (online.push(2.0, &[0.0, 1.0], &[0.0]).unwrap_err(), "the sample has 2 inputs, the model 1"),
        (online.push(t[19], &[0.0], &[0.0]).unwrap_err(), "there is a sample of t = 1.9"),
        (online.push(0.1, &[0.0], &[0.0]).unwrap_err(), "time jumps back from 1.9"),
        (online.push(4.0, &[0.0], &[0.0]).unwrap_err(), "longer than max_gap = 1 s"),
        (online.push(2.0, &[1e308], &[0.0]).unwrap_err(), "is not finite at t = 2 s"),
    ];
    for (error, text) in wrong {
        assert!(error.to_string().contains(text), "{error}");
    }
    assert_eq!(*online.estimate(), before);
    let mut other = Online::new(&model, settings().window(3).max_gap(1.0)).unwrap();
    stream(&mut other, &[t, u, y]);
    online.push(2.0, &[0.0], &[0.3]).unwrap();
    other.push(2.0, &[0.0], &[0.3]).unwrap();
    assert_eq!(online.estimate(), other.estimate());
}

#[test]
fn a_second_record_adds_to_the_parameters_of_the_first() {
    let model = lag();
    let (first, second) = (record(150, |_| 0.8, &mut Random(6)), record(150, |_| 0.8, &mut Random(7)));
    let mut online = Online::new(&model, settings().window(20)).unwrap();
    let one = stream(&mut online, &first).clone();
    online.restart();
    let two = stream(&mut online, &second).clone();
    let run = |[t, u, y]: &[Vec<f64>; 3], name| {
        let channels = [("u", u.clone()), ("y", y.clone())];
        let mut run = Experiment::new(&model, name, t.clone(), channels).unwrap();
        run.interpolation = phugoid::Interpolation::Hold;
        run
    };
    let noise = NoiseModel::new().scale("y", Sigma::Known(0.05));
    let both = [run(&first, "first"), run(&second, "second")];
    let fit = Estimation::new(&model, &both).noise_model(noise).solve().unwrap();
    assert!(distance(&two, &fit, &["a", "b"]) < 0.1);
    assert!(two.parameter_errors[0] < 0.8 * one.parameter_errors[0]);
}

#[test]
fn estimates_stay_within_bounds() {
    let mut model = lag();
    model.parameters[0].lower = Some(1.0);
    model.parameters[0].upper = Some(1.5);
    let data = record(200, |_| 0.8, &mut Random(8));
    let mut online = Online::new(&model, settings().window(5)).unwrap();
    let [t, u, y] = &data;
    for k in 0..t.len() {
        let estimate = online.push(t[k], &[u[k]], &[y[k]]).unwrap();
        assert!((1.0..=1.5).contains(&estimate.parameters[0]), "{estimate:?}");
    }
    let estimate = online.estimate();
    assert_eq!((estimate.parameters[0], estimate.at_bound[0]), (1.0, true));
    // The other parameter is the best one for the bound.
    model.parameters[0].lower = None;
    model.parameters[0].upper = None;
    model.parameters[0].fixed = true;
    let mut own = settings();
    own.parameters.retain(|p| p.0 != "a");
    let mut fixed = Online::new(&model, own.window(5)).unwrap();
    let fixed = stream(&mut fixed, &data);
    assert!((fixed.parameters[1] - estimate.parameters[1]).abs() < 0.1 * fixed.parameter_errors[1]);
}

#[test]
fn forgetting_follows_a_parameter_that_changes() {
    let data = record(800, |t| if t < 40.0 { 0.8 } else { 1.1 }, &mut Random(9));
    let last = |forgetting| {
        let mut online = Online::new(&lag(), settings().window(3).forgetting(forgetting)).unwrap();
        stream(&mut online, &data).clone()
    };
    let [none, exponential, directional] =
        [Forgetting::None, Forgetting::Exponential(8.0), Forgetting::Directional(8.0)].map(last);
    assert!(none.parameters[0] < 1.0, "{none:?}");
    for e in [exponential, directional] {
        assert!((e.parameters[0] - 1.1).abs() < 4.0 * e.parameter_errors[0], "{e:?}");
        assert!(e.parameter_errors[0] > 1.5 * none.parameter_errors[0]);
    }
}

#[test]
fn directional_forgetting_keeps_what_is_not_excited() {
    let [t, mut u, mut y] = record(1200, |_| 0.8, &mut Random(10));
    // From 20 s on nothing happens.
    let mut random = Random(11);
    for k in 200..1200 {
        (u[k], y[k]) = (0.0, 0.05 * normal(&mut random));
    }
    let error = |forgetting| {
        let mut online = Online::new(&lag(), settings().forgetting(forgetting)).unwrap();
        stream(&mut online, &[t.clone(), u.clone(), y.clone()]).parameter_errors[1]
    };
    let (none, directional) = (error(Forgetting::None), error(Forgetting::Directional(5.0)));
    let exponential = error(Forgetting::Exponential(5.0));
    assert!(directional < 5.0 * none, "{none} {directional} {exponential}");
    assert!(exponential > 100.0 * directional, "{none} {directional} {exponential}");
}

#[test]
fn the_noise_is_estimated() {
    let data = record(2000, |_| 0.8, &mut Random(12));
    let wrong = Settings::default().interpolation(phugoid::Interpolation::Hold).sigma("y", 0.5);
    let mut online = Online::new(&lag(), wrong.estimate_noise(true)).unwrap();
    let estimate = stream(&mut online, &data);
    // The given one, ten times too large, counts for 20 of 2,000 samples.
    let expected = ((20.0 * 0.25 + 2000.0 * 0.0025) / 2020.0_f64).sqrt();
    assert!((estimate.sigma[0] - expected).abs() < 0.1 * expected, "{estimate:?}");
}

#[test]
fn normalised_innovations_are_white_with_unit_variance() {
    let data = record(3000, |_| 0.8, &mut Random(13));
    let mut online = Online::new(&lag(), settings()).unwrap();
    let [t, u, y] = &data;
    let mut seen = Vec::new();
    for k in 0..t.len() {
        seen.push(online.push(t[k], &[u[k]], &[y[k]]).unwrap().normalised[0]);
    }
    let own = &seen[100..];
    let n = own.len() as f64;
    let variance = own.iter().map(|v| v * v).sum::<f64>() / n;
    let lagged = own.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / n;
    assert!((variance - 1.0).abs() < 4.0 * (2.0 / n).sqrt(), "{variance}");
    assert!(lagged.abs() < 4.0 / n.sqrt(), "{lagged}");
}

#[test]
fn process_noise_is_that_of_a_kalman_filter() {
    // A random walk measured at 1 Hz: the stationary variance of the Riccati equation.
    let mut m = Model::new("walk");
    let x = m.state("x", "").unwrap();
    let (q, r): (f64, f64) = (0.3, 1.0);
    m.equation("x", 0.0 * &x).unwrap();
    m.output("y", x, "").unwrap();
    for window in [1, 8] {
        let settings = Settings::default().sigma("y", r).process_noise("x", q).window(window);
        let mut online = Online::new(&m, settings).unwrap();
        let (mut random, mut kalman, mut p) = (Random(14), 0.0, 1e8);
        for k in 0..100 {
            let y = normal(&mut random);
            online.push(k as f64, &[], &[y]).unwrap();
            let gain = p / (p + r * r);
            kalman += gain * (y - kalman);
            p = p * (1.0 - gain) + q * q;
        }
        let estimate = online.estimate();
        assert!((estimate.states[0] - kalman).abs() < 1e-6, "{window}: {estimate:?} {kalman}");
        assert!((estimate.state_errors[0].powi(2) - (p - q * q)).abs() < 1e-6, "{window}: {estimate:?}");
    }
}

#[test]
fn work_is_bounded_before() {
    for (window, detect) in [(1, None), (12, None), (12, Some(Detect::new(1e6).watch("a").onsets(7)))] {
        let mut settings = settings().window(window).iterations(4).tolerance(1e-300);
        settings = settings.forgetting(Forgetting::Directional(5.0)).process_noise("x", 0.01).detect(detect);
        let mut model = lag();
        model.parameters[0].lower = Some(0.0);
        let mut online = Online::new(&model, settings).unwrap();
        let ([t, u, y], mut most) = (record(100, |_| 0.8, &mut Random(15)), 0);
        for k in 0..100 {
            let before = online.worked();
            online.push(t[k], &[u[k]], &[y[k]]).unwrap();
            most = most.max(online.worked() - before);
        }
        let bound = online.work();
        assert!(most <= bound && bound < 3 * most, "window {window}: {most} of {bound}");
    }
}

#[test]
fn a_deadline_ends_the_iterations() {
    let data = record(30, |_| 0.8, &mut Random(16));
    let own = settings().window(10).iterations(500).tolerance(1e-300);
    let mut online = Online::new(&lag(), own.clone().deadline(std::time::Duration::ZERO)).unwrap();
    let estimate = stream(&mut online, &data);
    assert_eq!((estimate.iterations, estimate.in_time), (1, false));
    let mut online = Online::new(&lag(), own.iterations(5)).unwrap();
    let estimate = stream(&mut online, &data);
    assert_eq!((estimate.iterations, estimate.in_time), (5, true));
}

/// Samples until a false alarm, from so many on.
fn until_alarm(detect: &Detect, most: usize, seed: u64) -> usize {
    let mut online = Online::new(&lag(), settings().iterations(1).detect(detect.clone())).unwrap();
    let [t, u, y] = record(most + 100, |_| 0.8, &mut Random(seed));
    let alarmed = (0..t.len()).find(|k| online.push(t[*k], &[u[*k]], &[y[*k]]).unwrap().alarm.is_some());
    alarmed.map_or(most, |k| k - 99)
}

#[test]
fn false_alarms_are_as_rare_as_asked() {
    for watch in [&[][..], &["a", "b"]] {
        let asked = 200.0;
        let detect = Detect::new(asked).after(10.0);
        let detect = watch.iter().fold(detect, |d, name| d.watch(name));
        let runs = 60;
        let lengths: Vec<f64> = (0..runs).map(|k| until_alarm(&detect, 4000, 100 + k) as f64).collect();
        let mean = lengths.iter().sum::<f64>() / runs as f64;
        // Run lengths are nearly exponential: their mean has an error of 1/√60. No more than some times what was asked for.
        assert!(mean > asked * (1.0 - 2.5 / 60_f64.sqrt()) && mean < 6.0 * asked, "{watch:?}: {mean}");
    }
}

#[test]
fn a_change_is_noticed_and_named() {
    let detect = Detect::new(1e5).after(20.0).watch("a").watch("b");
    let mut online = Online::new(&lag(), settings().window(3).detect(detect)).unwrap();
    let data = record(900, |t| if t < 60.0 { 0.8 } else { 1.1 }, &mut Random(17));
    let alarm = stream(&mut online, &data).alarm.clone().expect("an alarm");
    assert!(alarm.noticed > 60.0 && alarm.noticed < 75.0 && (alarm.since - 60.0).abs() < 6.0, "{alarm:?}");
    let Cause::Parameter { name, before, change, error, .. } = alarm.cause.clone() else {
        panic!("{alarm:?}")
    };
    assert_eq!(&*name, "a");
    assert!((before + change - 1.1).abs() < 4.0 * error + 0.1, "{alarm:?}");
    assert!(alarm.share > 0.9);
    online.acknowledge();
    assert_eq!(online.estimate().alarm, None);
}

#[test]
fn a_stuck_sensor_is_named() {
    let detect = Detect::new(1e5).after(10.0);
    let model = models::linear();
    let sigma = |s: Settings, (name, v): (&str, f64)| s.sigma(name, v);
    let settings = [("w", 0.2), ("q", 0.01), ("az", 0.5)].into_iter().fold(Settings::default(), sigma);
    let settings =
        ["Zw", "Zq", "Zde", "Mw", "Mq", "Mde"].into_iter().fold(settings, |s, n| s.parameter(n, 1.0));
    let mut online = Online::new(&model, settings.detect(detect)).unwrap();
    let flight = flights::record(900, 3);
    let mut stuck = f64::NAN;
    for k in 0..900 {
        let mut outputs = flight.outputs.iter().map(|c| c[k]).collect::<Vec<f64>>();
        stuck = if k == 600 { outputs[1] } else { stuck };
        outputs[1] = if k > 600 { stuck } else { outputs[1] };
        online.push(flight.t[k], &[flight.inputs[0][k]], &outputs).unwrap();
    }
    let alarm = online.estimate().alarm.clone().expect("an alarm");
    assert!(alarm.since >= flight.t[590], "{alarm:?}");
    assert_eq!(alarm.cause, Cause::Output { name: "q".into() }, "{alarm:?}");
}

#[test]
fn wrong_options_are_named() {
    let new = |settings: Settings| Online::new(&lag(), settings).err().unwrap().to_string();
    for (settings, text) in [
        (Settings::default(), "give the standard deviation of the noise of output 'y'"),
        (settings().window(0), "window is 0"),
        (settings().sigma("z", 1.0), "the model has no output 'z'"),
        (settings().parameter("c", 1.0), "the model has no parameter 'c'"),
        (settings().process_noise("x", -1.0), "the process noise of 'x' is -1"),
        (settings().initial("v", 0.0, 1.0), "the model has no state 'v'"),
        (settings().interpolation(phugoid::Interpolation::Cubic), "inputs cannot be cubic"),
        (settings().forgetting(Forgetting::Exponential(0.0)), "forgetting is 0"),
        (settings().detect(Detect::new(1e4).watch("c")), "the model has no parameter 'c'"),
        (settings().detect(Detect::new(f64::NAN)), "mean_samples is NaN"),
    ] {
        assert!(new(settings).contains(text));
    }
    assert!(matches!(
        Online::new(&lag(), settings()).unwrap().push(0.0, &[], &[0.0]),
        Err(OnlineError::Length { what: "inputs", .. })
    ));
}

#[test]
fn a_long_record_of_a_stable_model_stays_sound() {
    // Without process noise, information on the state for given parameters grows by exp(0.8 · 3000).
    let data = record(30_000, |_| 0.8, &mut Random(18));
    let mut online = Online::new(&lag(), settings().first_window(50)).unwrap();
    let estimate = stream(&mut online, &data);
    for (k, truth) in [0.8, 0.5].into_iter().enumerate() {
        let error = estimate.parameter_errors[k];
        assert!(error > 1e-5 && error < 2e-3, "{estimate:?}");
        assert!((estimate.parameters[k] - truth).abs() < 5.0 * error, "{estimate:?}");
    }
}
