//! Integration by shooting: orders of convergence, ends of solutions, fits.

use std::time::Duration;

use crate::common::flights;
use crate::common::models::linear;
use phugoid::Grid;
use phugoid::internals::problem::Transcribed;
use phugoid::interrupt::Interrupt;
use phugoid::nlp::{ExperimentId, Nlp};
use phugoid::noise::{Noise, Sigma};
use phugoid::shooting::{Integrator, Steps};
use phugoid::shooting::{Shooting, Shots};
use phugoid::solver::Status;
use phugoid::{Estimation, Experiment, Model, Parameter};

/// ẋ = −2 t x² from x(0) = 1 has the solution 1/(1 + t²): nonlinear, and depends on time.
fn bell() -> Model {
    let mut m = Model::new("bell");
    let (x, time) = (m.state("x", "").unwrap(), m.time());
    let a = m.parameter(Parameter::new("a", -2.0)).unwrap();
    m.equation("x", a * &time * &x * &x).unwrap();
    m.output("y", x, "").unwrap();
    m
}

/// Greatest error at the samples that lie within steps, and that at the end.
fn errors(integrator: Integrator, segments: usize, steps: usize) -> (f64, f64) {
    let model = bell();
    // Many, in all places of a step.
    let t: Vec<f64> = (0..=300).map(|k| 2.0 * (f64::from(k) / 300.0).powf(1.1)).collect();
    let x: Vec<f64> = t.iter().map(|t| 1.0 / (1.0 + t * t)).collect();
    let run = Experiment::new(&model, "run", t, [("y", x.clone())]).unwrap();
    let settings = Shots::default()
        .grid(vec![Grid::Uniform(segments)])
        .integrator(integrator)
        .steps(Steps::Number(steps / segments))
        .threads(1);
    let noise = Noise::Gaussian(vec![Sigma::Known(1.0)]);
    let problem = Shooting::new(&model, std::slice::from_ref(&run), noise, &settings).unwrap();
    // Nodes on the path that the integration gives: each segment starts where the one before it ended.
    let mut xi = vec![-2.0];
    xi.resize(problem.n(), 1.0);
    for _ in 0..segments {
        let mut defects = vec![0.0; problem.m()];
        problem.constraints(&xi, &mut defects).unwrap();
        xi[2..].iter_mut().zip(&defects).for_each(|(x, d)| *x -= d);
    }
    let found = &problem.states_at_samples(&xi, ExperimentId(0))[0];
    let error: Vec<f64> = found.iter().zip(&x).map(|(a, b)| (a - b).abs()).collect();
    let (end, within) = error.split_last().unwrap();
    (within.iter().copied().fold(0.0, f64::max), *end)
}

/// The error at the end falls with the order of the method, that within steps with no more than that of the cubic, 4.
#[test]
fn threads_are_kept_whatever_is_said_first() {
    let model = crate::common::models::linear();
    let estimation = Estimation::new(&model, &[]);
    let (first, last) = (estimation.clone().threads(3), estimation.shooting(Shots::default()));
    assert_eq!(format!("{:?}", first.shooting(Shots::default())), format!("{:?}", last.threads(3)));
}

#[test]
fn integrators_converge_with_their_order() {
    for integrator in Integrator::ALL {
        for segments in [1, 4] {
            let (steps, order) = (64, integrator.order() as f64);
            let (coarse, fine) =
                (errors(integrator, segments, steps), errors(integrator, segments, 2 * steps));
            let measured = ((coarse.0 / fine.0).log2(), (coarse.1 / fine.1).log2());
            println!(
                "{integrator:?}, {segments} segments: at the end {:.2}, within {:.2}",
                measured.1, measured.0
            );
            assert!((measured.1 - order).abs() < 0.35, "{integrator:?}: {measured:?} {coarse:?} {fine:?}");
            assert!(
                (measured.0 - order.min(4.0)).abs() < 0.5,
                "{integrator:?}: {measured:?} {coarse:?} {fine:?}"
            );
        }
    }
}

/// Where the solution ceases to exist, when and why is said.
#[test]
fn a_solution_that_ceases_to_exist() {
    let mut m = Model::new("escape");
    let x = m.state("x", "").unwrap();
    let a = m.parameter(Parameter::new("a", 1.0)).unwrap();
    m.equation("x", a * &x * &x * &x).unwrap();
    m.output("x", x, "").unwrap();
    let t: Vec<f64> = (0..200).map(|k| 0.1 * f64::from(k)).collect();
    let z = t.iter().map(|t| 1.0 + 0.01 * t.sin()).collect();
    let runs = [Experiment::new(&m, "run", t, [("x", z)]).unwrap()];
    let error = Estimation::new(&m, &runs).shooting(Shots::default()).solve().unwrap_err().to_string();
    assert!(error.contains("the solution of 'run' that starts at t = 0 ceases to exist at t = "), "{error}");
    let time: f64 =
        error.split("at t = ").nth(2).unwrap().split(&[' ', ':']).next().unwrap().parse().unwrap();
    // It leaves to infinity at 0.5 s; fixed steps follow a little longer.
    assert!((0.5..2.0).contains(&time), "{error}");
    // Segments shorter than that are no trouble.
    let shots = Shots::default().grid(vec![Grid::Uniform(100)]);
    let fit = Estimation::new(&m, &runs).shooting(shots).solve().unwrap();
    assert_eq!(fit.status, Status::Converged);
}

#[test]
fn a_slope_that_is_not_finite_is_named() {
    let mut m = Model::new("tank");
    let h = m.state("h", "m").unwrap();
    let c = m.parameter(Parameter::new("c", 1.0)).unwrap();
    m.equation("h", -c * h.sqrt()).unwrap();
    m.output("h", h, "").unwrap();
    let t: Vec<f64> = (0..40).map(|k| 0.2 * f64::from(k)).collect();
    let z = t.iter().map(|t| (1.0 - 0.1 * t).powi(2)).collect();
    let runs = [Experiment::new(&m, "run", t, [("h", z)]).unwrap()];
    let error = Estimation::new(&m, &runs).shooting(Shots::default()).solve().unwrap_err().to_string();
    for words in ["ceases to exist", "the equation of h' is not finite", "sqrt(h)"] {
        assert!(error.contains(words), "{error}");
    }
}

/// Collocation and multiple shooting find the same optimum of an unstable aircraft.
#[test]
fn fits_agree_with_collocation() {
    let model = linear();
    let run = [flights::record(301, 5)];
    let reference = Estimation::new(&model, &run).order(6).solve().unwrap();
    for (segments, steps) in [(30, Steps::Samples(4)), (7, Steps::Length(0.0025)), (1, Steps::Samples(4))] {
        let grid = vec![Grid::Uniform(segments)];
        let shots =
            Shots::default().grid(grid).steps(steps.clone()).integrator(Integrator::DormandPrince).threads(1);
        let warm = Estimation::new(&model, &run).shooting(shots.clone()).start_from(&reference);
        let cold = Estimation::new(&model, &run).shooting(shots);
        for (how, fit) in [("warm", warm.solve().unwrap()), ("cold", cold.solve().unwrap())] {
            if segments == 1 && how == "cold" {
                continue; // single shooting of an unstable system promises nothing from zeros
            }
            assert_eq!(fit.status, Status::Converged, "{segments} segments, {steps:?}, {how}");
            for p in &reference.parameters {
                let off = (fit[p.name.as_str()].value - p.value).abs() / p.std_error;
                assert!(off < 1e-4, "{segments} segments, {how}: {} is {off} standard errors off", p.name);
                let ratio = fit[p.name.as_str()].std_error / p.std_error;
                assert!((ratio - 1.0).abs() < 1e-4, "{}: {ratio}", p.name);
            }
        }
    }
}

#[test]
fn wrong_options() {
    let model = bell();
    let t = vec![0.0, 1.0, 2.0];
    let run = |k: usize| {
        Experiment::new(&model, &format!("run {k}"), t.clone(), [("y", vec![1.0, 0.5, 0.2])]).unwrap()
    };
    let build = |settings: Shots, runs: usize| {
        let noise = Noise::Gaussian(vec![Sigma::Known(1.0)]);
        let runs: Vec<Experiment> = (0..runs).map(run).collect();
        Shooting::new(&model, &runs, noise, &settings).map(|_| ()).unwrap_err().to_string()
    };
    for steps in [Steps::Samples(0), Steps::Number(0), Steps::Length(0.0), Steps::Length(f64::NAN)] {
        let error = build(Shots::default().steps(steps), 1);
        assert!(error.contains("at least one step of positive length"), "{error}");
    }
    let grid = vec![Grid::Uniform(1); 2];
    assert!(build(Shots::default().grid(grid), 3).contains("2 grids for 3 experiments"));
    let grid = vec![Grid::Edges(vec![0.0, 1.5])];
    assert!(build(Shots::default().grid(grid), 1).contains("end at the last"));
}

/// An evaluation asks the interrupt in force, however short its segments are.
#[test]
fn an_evaluation_that_is_stopped_ends() {
    let model = bell();
    let t: Vec<f64> = (0..=40).map(|k| 0.05 * f64::from(k)).collect();
    let y = t.iter().map(|t| 1.0 / (1.0 + t * t)).collect();
    let run = Experiment::new(&model, "run", t, [("y", y)]).unwrap();
    let settings = Shots::default().grid(vec![Grid::Uniform(10)]).threads(1);
    let noise = Noise::Gaussian(vec![Sigma::Known(1.0)]);
    let problem = Shooting::new(&model, std::slice::from_ref(&run), noise, &settings).unwrap();
    let mut xi = vec![-2.0];
    xi.resize(problem.n(), 1.0);
    let mut jacobian = vec![0.0; problem.jacobian_structure().len()];
    assert!(problem.jacobian(&xi, &mut jacobian).is_ok());
    let limit = Interrupt::within(Some(Duration::ZERO));
    assert!(limit.run(|| problem.jacobian(&xi, &mut jacobian)).is_err());
}

/// A single segment with steps from sample to sample is read from the states at the samples; any other path is integrated.
#[test]
fn the_path_passes_through_the_states_at_the_samples() {
    let model = bell();
    let t: Vec<f64> = (0..=40).map(|k| 0.05 * f64::from(k)).collect();
    let y = t.iter().map(|t| 1.0 / (1.0 + t * t)).collect();
    let run = Experiment::new(&model, "run", t.clone(), [("y", y)]).unwrap();
    for (steps, segments) in [(Steps::Samples(1), 1), (Steps::Samples(3), 1), (Steps::Samples(1), 4)] {
        let settings = Shots::default().grid(vec![Grid::Uniform(segments)]).steps(steps).threads(1);
        let noise = Noise::Gaussian(vec![Sigma::Known(1.0)]);
        let problem = Shooting::new(&model, std::slice::from_ref(&run), noise, &settings).unwrap();
        let mut xi = vec![-2.0];
        xi.resize(problem.n(), 1.0);
        let (times, path) = problem.path(&xi, ExperimentId(0));
        let states = problem.states_at_samples(&xi, ExperimentId(0));
        for (sample, time) in t.iter().enumerate() {
            let at = times.iter().position(|s| (s - time).abs() < 1e-12).unwrap();
            assert!((path[0][at] - states[0][sample]).abs() < 1e-12, "{time} s");
        }
    }
}
