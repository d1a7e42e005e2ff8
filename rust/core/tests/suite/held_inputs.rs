//! Inputs that are held between their samples, against the exact solution over each interval.

use crate::common::newton::solve_defects;
use nalgebra::{DMatrix, DVector};
use phugoid::collocation::{Collocation, Settings};
use phugoid::internals::interpolate::{derivative, interpolate};
use phugoid::nlp::check::check_derivatives;
use phugoid::nlp::{ExperimentId, Nlp, PointId, VariableId};
use phugoid::noise::Noise;
use phugoid::shooting::Shots;
use phugoid::shooting::Steps;
use phugoid::{Estimation, Experiment, Grid, Interpolation, Model, Parameter, Sigma, Simulation};

/// A lightly damped oscillator, x″ = −a x − b x′ + c u, whose acceleration is measured too: it jumps with u.
fn oscillator() -> Model {
    let mut m = Model::new("oscillator");
    let (x, v) = (m.state("x", "m").unwrap(), m.state("v", "m/s").unwrap());
    let u = m.input("u", "N").unwrap();
    let [a, b, c] = ["a", "b", "c"].map(|name| m.parameter(Parameter::new(name, 1.0)).unwrap());
    let force = c * u - a * &x - b * &v;
    m.equation("x", v).unwrap();
    m.equation("v", force.clone()).unwrap();
    m.output("x", x, "m").unwrap();
    m.output("acceleration", force, "m/s^2").unwrap();
    m
}

const TRUTH: [f64; 3] = [4.0, 0.6, 2.0];

/// x and v over an interval of length h with a constant input, by the matrix exponential.
fn over(x: &DVector<f64>, u: f64, h: f64) -> DVector<f64> {
    let [a, b, c] = TRUTH;
    let whole = DMatrix::from_row_slice(3, 3, &[0.0, 1.0, 0.0, -a, -b, c, 0.0, 0.0, 0.0]) * h;
    let with_input = DVector::from_vec(vec![x[0], x[1], u]);
    (exponential(&whole) * with_input).rows(0, 2).into_owned()
}

/// The matrix exponential, by the series for a part of the matrix, and squares.
fn exponential(a: &DMatrix<f64>) -> DMatrix<f64> {
    let part = a / 1024.0;
    let mut sum = DMatrix::identity(a.nrows(), a.nrows());
    let mut term = sum.clone();
    for k in 1..12 {
        term = &term * &part / f64::from(k);
        sum += &term;
    }
    (0..10).fold(sum, |e, _| &e * &e)
}

/// States and outputs at the samples, for an input that takes values from times on.
fn exact(t: &[f64], jumps: &[(f64, f64)]) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
    let value = |at: f64| jumps.iter().rev().find(|j| j.0 <= at + 1e-9).map_or(jumps[0].1, |j| j.1);
    let mut times: Vec<f64> = t.iter().copied().chain(jumps.iter().map(|j| j.0)).collect();
    times.retain(|s| (t[0]..=t[t.len() - 1]).contains(s));
    times.sort_by(f64::total_cmp);
    times.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    let (mut x, mut states) = (DVector::from_vec(vec![0.3, -0.2]), vec![Vec::new(); 2]);
    let mut outputs = vec![Vec::new(); 2];
    for (k, &now) in times.iter().enumerate() {
        if k > 0 {
            x = over(&x, value(times[k - 1]), now - times[k - 1]);
        }
        if t.iter().any(|s| (s - now).abs() < 1e-9) {
            (0..2).for_each(|i| states[i].push(x[i]));
            outputs[0].push(x[0]);
            outputs[1].push(TRUTH[2] * value(now) - TRUTH[0] * x[0] - TRUTH[1] * x[1]);
        }
    }
    (states, outputs)
}

fn steps(n: usize) -> Vec<f64> {
    (0..n).map(|k| ((k * k * 7 + 3 * k) % 11) as f64 / 5.0 - 1.0).collect()
}

/// A record in which the input jumps at each sample.
fn record(n: usize) -> (Experiment, Vec<Vec<f64>>) {
    let t: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let u = steps(n);
    let jumps: Vec<(f64, f64)> = t.iter().copied().zip(u.iter().copied()).collect();
    let (states, outputs) = exact(&t, &jumps);
    let channels = [("u", u), ("x", outputs[0].clone()), ("acceleration", outputs[1].clone())];
    let run = Experiment::new(&oscillator(), "steps", t, channels).unwrap();
    (run.with_interpolation(&oscillator(), "u", Interpolation::Hold).unwrap(), states)
}

/// A record whose input has jumps of its own between the samples.
fn record_of_own_jumps() -> (Experiment, Vec<Vec<f64>>) {
    let (mut run, _) = record(60);
    let own: Vec<f64> = (0..24).map(|k| 0.03 + 0.237 * k as f64).collect();
    let jumps: Vec<(f64, f64)> = own.iter().copied().zip(steps(24)).collect();
    let (states, outputs) = exact(&run.t, &jumps);
    let mut signal = run.signals[0].clone().unwrap();
    (signal.t, signal.values) = jumps.into_iter().unzip();
    (run.signals, run.outputs) = (vec![Some(signal)], outputs);
    (run, states)
}

fn assert_near(found: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(found.len(), expected.len());
    let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst <= tolerance, "{what}: {worst:e}");
}

#[test]
fn a_sample_is_held_until_the_next() {
    let (t, u) = ([0.0, 0.1, 0.2, 0.3], [1.0, 3.0, 3.0, -1.0]);
    let at = [-1.0, 0.0, 0.0999, 0.1, 0.15, 0.2, 0.29, 0.3, 5.0];
    let expected = [1.0, 1.0, 1.0, 3.0, 3.0, 3.0, 3.0, -1.0, -1.0];
    assert_eq!(interpolate(Interpolation::Hold, &t, &u, &at), expected);
    // Times that were meant to be those of samples.
    assert_eq!(interpolate(Interpolation::Hold, &t, &u, &[0.35 - 0.25, 0.3 - 1e-13]), [3.0, -1.0]);
    // The impulse of each jump, one half in each interval beside it.
    let slopes = derivative(Interpolation::Hold, &t, &u, &[0.05, 0.15, 0.25, 0.4], 1);
    assert_near(&slopes, &[10.0, 10.0, -20.0, 0.0], 1e-12, "slopes");
}

#[test]
fn simulations_are_exact() {
    for (run, states) in [record(80), record_of_own_jumps()] {
        let model = oscillator();
        let mut simulation = Simulation::new(&model, &run).tolerance(1e-13);
        for (name, value) in ["a", "b", "c"].iter().zip(TRUTH) {
            simulation = simulation.parameter(name, value);
        }
        let path = simulation.initial("x", 0.3).initial("v", -0.2).run().unwrap();
        assert_near(path.state("x").unwrap(), &states[0], 1e-10, "x");
        assert_near(path.state("v").unwrap(), &states[1], 1e-10, "v");
        assert_near(path.output("acceleration").unwrap(), &run.outputs[1], 1e-9, "acceleration");
    }
}

/// Collocation at the true parameters, on segments that end at the samples, between them, and far apart.
#[test]
fn collocation_is_exact() {
    let model = oscillator();
    let noise = || Noise::Gaussian(vec![Sigma::Known(1.0); 2]);
    for (run, states) in [record(80), record_of_own_jumps()] {
        for grid in [Grid::Samples(1), Grid::Samples(2), Grid::Uniform(7)] {
            let settings = Settings::default().order(9).grid(vec![grid.clone()]);
            let problem = Collocation::new(&model, std::slice::from_ref(&run), noise(), &settings).unwrap();
            let mut xi = vec![0.0; problem.n()];
            xi[..3].copy_from_slice(&TRUTH);
            let first = problem.layout.state(PointId(0)).0;
            (xi[first], xi[first + 1]) = (0.3, -0.2);
            solve_defects(&problem, &mut xi);
            let what = format!("{grid:?}");
            let at = |i: usize| -> Vec<f64> {
                let points = problem.meshes[ExperimentId(0)].sample_points.iter();
                points.map(|&p| xi[problem.layout.state(PointId(p)) + i]).collect()
            };
            assert_near(&at(0), &states[0], 1e-10, &what);
            assert_near(&at(1), &states[1], 1e-10, &what);
            assert_near(&problem.outputs_at_samples(&xi, ExperimentId(0))[1], &run.outputs[1], 1e-9, &what);
        }
    }
}

#[test]
fn estimates_of_exact_data_are_exact() {
    let model = oscillator();
    let fine = Shots::default().steps(Steps::Samples(20));
    let single = Shots::default().grid(vec![Grid::Uniform(1)]).steps(Steps::Length(0.006));
    let several = Shots::default().grid(vec![Grid::Uniform(9)]).steps(Steps::Number(150));
    for (run, _) in [record(80), record_of_own_jumps()] {
        let estimation = || {
            let estimation = Estimation::new(&model, std::slice::from_ref(&run));
            estimation.noise("x", Sigma::Known(0.01)).noise("acceleration", Sigma::Known(0.01))
        };
        let mut fits = vec![estimation().order(8).solve().unwrap()];
        for shots in [&fine, &single, &several] {
            fits.push(estimation().shooting(shots.clone()).solve().unwrap());
        }
        for (fit, tolerance) in fits.iter().zip([1e-9, 1e-7, 1e-7, 1e-7]) {
            let found: Vec<f64> = ["a", "b", "c"].iter().map(|n| fit[*n].value).collect();
            assert_near(&found, &TRUTH, tolerance, "estimates");
        }
    }
}

/// Chunks of segments that share no lane: a nonlinear equation, several chunks, samples between mesh points.
#[test]
fn derivatives_are_those_of_differences() {
    let mut m = Model::new("pendulum");
    let (x, v, u) = (m.state("x", "").unwrap(), m.state("v", "").unwrap(), m.input("u", "").unwrap());
    let [a, b] = ["a", "b"].map(|name| m.parameter(Parameter::new(name, 1.3)).unwrap());
    m.equation("x", v.clone()).unwrap();
    m.equation("v", -a * x.clone().sin() * (1.0 + 0.2 * &u) - &b * &v * &v + u).unwrap();
    m.output("x", &x * &x + b, "").unwrap();
    let n = 70;
    let t: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let run = Experiment::new(&m, "run", t, [("u", steps(n)), ("x", vec![0.4; n])]).unwrap();
    let run = run.with_interpolation(&m, "u", Interpolation::Hold).unwrap();
    for grid in [Grid::Samples(1), Grid::Uniform(31)] {
        let settings = Settings::default().order(3).grid(vec![grid]).threads(1);
        let noise = Noise::Gaussian(vec![Sigma::Known(0.1)]);
        let problem = Collocation::new(&m, std::slice::from_ref(&run), noise, &settings).unwrap();
        let wave = |i: usize, s: f64| (s * (i as f64 + 1.0)).sin();
        let xi: Vec<f64> = (0..problem.n()).map(|i| 0.5 + 0.3 * wave(i, 1.7)).collect();
        let lambda: Vec<f64> = (0..problem.m()).map(|i| wave(i, 0.9)).collect();
        let columns: Vec<VariableId> = (0..problem.n()).map(VariableId).collect();
        let wrong = check_derivatives(&problem, &xi, &lambda, &columns, 1e-5).unwrap();
        assert!(wrong.is_empty(), "{:?}", &wrong[..wrong.len().min(5)]);
    }
}

#[test]
fn an_input_must_be_there_to_be_held() {
    let (run, _) = record(5);
    let error = run.with_interpolation(&oscillator(), "w", Interpolation::Hold).unwrap_err();
    assert_eq!(error.to_string(), "experiment 'steps': it has no input 'w'.");
}
