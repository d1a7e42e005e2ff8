//! What surrounds the solver of an estimation: a solver of one's own, interrupts, and passes over delays.

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::common::Random;
use phugoid::estimate::{Beginning, Bound, Problem, Solver};
use phugoid::internals::initial::{Initial, solve};
use phugoid::interrupt::Interrupt;
use phugoid::nlp::NotFinite;
use phugoid::solver::{Control, Iteration, Settings, Solution, Status};
use phugoid::{Estimation, Experiment, Fit, Model, Parameter, Simulation};

const TRUE: [f64; 3] = [2.0, 0.7, 0.237];
const SIGMA: f64 = 0.01;

/// An oscillator whose input acts late.
fn late(tau: Parameter) -> Model {
    let mut m = Model::new("late");
    let (x, v, u) = (m.state("x", "m").unwrap(), m.state("v", "m/s").unwrap(), m.input("u", "m").unwrap());
    let (k, c) =
        (m.parameter(Parameter::new("k", 1.0)).unwrap(), m.parameter(Parameter::new("c", 0.5)).unwrap());
    let tau = m.parameter(tau).unwrap();
    let then = m.delay(&u, &tau, "u_then").unwrap();
    m.equation("x", v.clone()).unwrap();
    m.equation("v", -k * (&x - then) - c * &v).unwrap();
    m.output("x", x, "m").unwrap();
    m.output("v", v, "m/s").unwrap();
    m
}

fn unbounded() -> Model {
    late(Parameter::new("tau", 0.0).lower(-0.5).upper(2.0))
}

fn record(model: &Model, seed: u64) -> Experiment {
    let mut random = Random(seed);
    let t: Vec<f64> = (0..150).map(|k| 0.1 * k as f64).collect();
    let u: Vec<f64> = t.iter().map(|t| (1.3 * t).sin() + 0.3 * (3.1 * t).sin()).collect();
    let nothing = vec![0.0; t.len()];
    let blank = [("u", u.clone()), ("x", nothing.clone()), ("v", nothing)];
    let run = Experiment::new(model, "run", t.clone(), blank).unwrap();
    let mut simulation = Simulation::new(model, &run).initial("x", 0.2).initial("v", 0.0);
    for (name, value) in ["k", "c", "tau"].into_iter().zip(TRUE) {
        simulation = simulation.parameter(name, value);
    }
    let path = simulation.run().unwrap();
    let mut noisy = |y: &Vec<f64>| -> Vec<f64> {
        y.iter().map(|y| y + SIGMA * 3f64.sqrt() * random.between(-1.0, 1.0)).collect()
    };
    let channels = [("u", u), ("x", noisy(&path.outputs[0])), ("v", noisy(&path.outputs[1]))];
    Experiment::new(model, "run", t, channels).unwrap()
}

#[test]
fn a_delay_is_estimated_with_the_fit_at_fixed_delays() {
    let model = unbounded();
    for seed in 1..6 {
        let fit = Estimation::new(&model, &[record(&model, seed)]).solve().unwrap();
        assert_eq!(fit.status, Status::Converged, "{}", fit.message);
        for (name, value) in ["k", "c", "tau"].into_iter().zip(TRUE) {
            assert!((fit[name].value - value).abs() < 5.0 * fit[name].std_error, "seed {seed}: {name}");
        }
        let moved = fit.moved.as_ref().unwrap();
        assert!(moved.fit.model.delays.is_empty());
        assert_eq!(moved.fit["tau"].value, fit["tau"].value);
        assert!((moved.base[0].1 - fit["tau"].value).abs() < 1e-3 * fit["tau"].std_error);
        assert_eq!(fit.records[0].t.len(), 150);
    }
}

#[test]
fn passes_over_delays_share_the_iterations() {
    let model = unbounded();
    let runs = [record(&model, 1)];
    let whole = Estimation::new(&model, &runs).solve().unwrap();
    let most = whole.iterations / 2;
    let settings = Settings::default().max_iterations(most);
    let fit = Estimation::new(&model, &runs).solver(settings).solve().unwrap();
    assert!(
        fit.iterations <= most && fit.status != Status::Converged
            || fit.warnings.iter().any(|w| w.contains("still move"))
    );
    // A pass that stopped at the reach of its base is at no bound of the model.
    let one = Estimation::new(&model, &runs).delay_passes(1e-4, 1).solve().unwrap();
    assert_eq!((one.status, one["tau"].bound), (Status::IterationLimit, None), "{}", one.message);
    assert!(one.message.contains("tau has not converged"), "{}", one.message);
}

#[test]
fn a_delay_at_its_bound_is_said_to_be_there() {
    let model = late(Parameter::new("tau", 0.05).lower(0.0).upper(0.1));
    let fit = Estimation::new(&model, &[record(&unbounded(), 1)]).solve().unwrap();
    assert_eq!((fit.status, fit["tau"].bound), (Status::Converged, Some(Bound::Upper)));
    assert_eq!(fit["tau"].bounds, (0.0, 0.1));
}

/// Newton's method, behind the seam, which counts its calls.
#[derive(Debug, Default)]
struct Counted(AtomicUsize);

impl Solver for Counted {
    fn solve(
        &self,
        problem: &Problem,
        from: &Beginning<'_>,
        watch: &mut dyn FnMut(&Iteration) -> Control,
    ) -> Result<Solution, NotFinite> {
        self.0.fetch_add(1, Ordering::Relaxed);
        let settings = Settings::default().max_iterations(from.max_iterations);
        let initial = if from.known && from.multipliers.is_none() { Initial::Places } else { Initial::Start };
        let multipliers = from.multipliers.map(|m| &m.constraints[..]);
        solve(problem.transcribed(), from.xi, multipliers, initial, &settings, watch)
    }
}

fn same(a: &Fit, b: &Fit) {
    let values = |f: &Fit| f.parameters.iter().map(|p| (p.value, p.std_error)).collect::<Vec<_>>();
    assert_eq!((a.status, a.iterations, values(a)), (b.status, b.iterations, values(b)));
}

#[test]
fn a_solver_of_ones_own_takes_every_pass() {
    let model = unbounded();
    let runs = [record(&model, 2)];
    let own = Counted::default();
    let fit = Estimation::new(&model, &runs).own_solver(&own).solve().unwrap();
    assert!(own.0.into_inner() > 1);
    // The first pass starts from measurements, others from the last: as Newton's method does.
    let expected = Estimation::new(&model, &runs).solve().unwrap();
    assert!((fit["tau"].value - expected["tau"].value).abs() < 1e-3 * expected["tau"].std_error);
    let fixed = model.at_delays(&[("tau", 0.2)].into(), 0.1);
    let own = Counted::default();
    let runs = &expected.moved.as_ref().unwrap().experiments[..];
    same(
        &Estimation::new(&fixed, runs).own_solver(&own).solve().unwrap(),
        &Estimation::new(&fixed, runs).solve().unwrap(),
    );
    assert_eq!(own.0.into_inner(), 1);
}

#[test]
fn an_interrupted_run_has_standard_errors_unless_these_are_stopped_too() {
    let model = unbounded();
    let runs = [record(&model, 3)];
    let whole = Estimation::new(&model, &runs).solve().unwrap();
    let (model, runs) =
        (&whole.moved.as_ref().unwrap().fit.model, &whole.moved.as_ref().unwrap().experiments[..]);
    let last = Estimation::new(model, runs).solve().unwrap().iterations;
    assert!(last > 2);
    let interrupted = |errors: Option<Interrupt>| {
        let limit = Interrupt::within(None);
        let mut estimation = Estimation::new(model, runs);
        if let Some(errors) = errors {
            estimation = estimation.stop_errors(errors);
        }
        let watch = |i: &Iteration| {
            if i.number == last - 1 {
                limit.stop();
            }
            Control::Continue
        };
        limit.run(|| estimation.solve_with(watch)).unwrap()
    };
    let fit = interrupted(None);
    assert_eq!(fit.status, Status::Interrupted);
    assert!(fit.feasible && fit["k"].std_error > 0.0);
    let stopped = Interrupt::within(None);
    stopped.stop();
    let fit = interrupted(Some(stopped));
    assert!(fit["k"].std_error.is_nan());
    assert!(fit.warnings[0].starts_with("interrupted: there are no standard errors"), "{:?}", fit.warnings);
}

#[path = "../../examples/own_solver.rs"]
#[allow(dead_code)]
mod example;

#[test]
fn the_example_agrees_with_the_solver_of_the_crate() {
    example::main().unwrap();
}
