//! What an estimation does beyond one mesh: refinement, smoothed kinks, meshes that follow the motion.

use std::time::Duration;

use crate::common::Random;
use phugoid::estimate::{Beginning, Problem, Solver, Transcription};
use phugoid::model::{End, Transform};
use phugoid::nlp::NotFinite;
use phugoid::solver::{Control, Iteration, Settings, Solution, Status, solve};
use phugoid::{Estimation, Experiment, Fit, Grid, Model, Parameter, Sigma, Simulation};

/// Van der Pol's oscillator, both states measured.
fn oscillator() -> (Model, Experiment) {
    let mut m = Model::new("van der Pol");
    let (x, v) = (m.state("x", "m").unwrap(), m.state("v", "m/s").unwrap());
    let mu = m.parameter(Parameter::new("mu", 0.1)).unwrap();
    let k = m.parameter(Parameter::new("k", 1.0)).unwrap();
    m.equation("x", v.clone()).unwrap();
    m.equation("v", mu * (1.0 - &x * &x) * &v - k * &x).unwrap();
    m.output("x", x, "m").unwrap();
    m.output("v", v, "m/s").unwrap();
    let t: Vec<f64> = (0..101).map(|i| 0.1 * f64::from(i)).collect();
    let blank = Experiment::of_inputs(&m, "run", t.clone(), []).unwrap();
    let path = Simulation::new(&m, &blank).parameter("mu", 0.8).parameter("k", 1.5).initial("x", 0.4);
    let path = path.initial("v", 0.0).run().unwrap();
    let mut random = Random(7);
    let mut noisy = |y: &[f64]| y.iter().map(|y| y + 0.01 * random.between(-1.7, 1.7)).collect();
    let (x, v) = (noisy(path.output("x").unwrap()), noisy(path.output("v").unwrap()));
    let run = Experiment::new(&m, "run", t, [("x", x), ("v", v)]).unwrap();
    (m, run)
}

#[test]
fn a_coarse_mesh_is_refined_to_the_estimates_of_a_fine_one() {
    let (m, run) = oscillator();
    let runs = [run];
    let coarse = Estimation::new(&m, &runs).order(2).grid(Grid::Uniform(25));
    let fine = Estimation::new(&m, &runs).order(5).solve().unwrap();
    let fit = coarse.clone().refine(1e-4).solve().unwrap();
    let report = fit.refinement.as_ref().unwrap();
    assert!(report.met() && report.steps.len() > 1 && fit.status == Status::Converged);
    let worst = fit.integration_error(&runs).unwrap()[0].worst();
    assert!(worst.iter().all(|w| *w <= 1e-4));
    let first = coarse.solve().unwrap();
    for name in ["mu", "k"] {
        let (found, exact) = (&fit[name], &fine[name]);
        assert!((found.value - exact.value).abs() < 0.02 * found.std_error);
        let before = report.first.iter().find(|e| e.name == name).unwrap();
        assert_eq!(before.value, first[name].value);
    }
    // Without refinement the mesh is told to be coarse.
    assert!(first.warnings.iter().any(|w| w.contains("the mesh is coarse")), "{:?}", first.warnings);
    assert!(!fit.warnings.iter().any(|w| w.contains("the mesh is coarse")));
}

/// Newton's method, which goes on beyond the time limit.
#[derive(Debug)]
struct Late;

impl Solver for Late {
    fn solve(
        &self,
        problem: &Problem,
        from: &Beginning<'_>,
        watch: &mut dyn FnMut(&Iteration) -> Control,
    ) -> Result<Solution, NotFinite> {
        let found = solve(problem.transcribed(), from.xi, None, &Settings::default(), watch);
        std::thread::sleep(Duration::from_millis(1500));
        found
    }
}

/// A fit that converges as its time ends has the status of what was asked for, a mesh that is fine enough.
#[test]
fn a_mesh_that_was_not_checked_is_no_refined_one() {
    let (m, run) = oscillator();
    let runs = [run];
    let settings = Settings::default().time_limit(Some(Duration::from_millis(1400)));
    let estimation = Estimation::new(&m, &runs).solver(settings).own_solver(&Late).refine(0.5);
    let ended = estimation.solve().unwrap();
    assert_eq!(ended.status, Status::TimeLimit);
    assert!(ended.message.contains("fine enough") && ended.refinement.is_none(), "{}", ended.message);
    let settings = Settings::default();
    assert_eq!(estimation.solver(settings).own_solver(&Late).solve().unwrap().status, Status::Converged);
}

/// A mass with Coulomb friction that slides and stops, in short steps.
fn friction() -> (Model, Experiment) {
    let mut m = Model::new("friction");
    let (x, v) = (m.state("x", "m").unwrap(), m.state("v", "m/s").unwrap());
    let z = m.parameter(Parameter::new("z", 1.0)).unwrap();
    let c = m.parameter(Parameter::new("c", 0.1)).unwrap();
    m.equation("x", v.clone()).unwrap();
    m.equation("v", -4.0 * &x - z * &v - c * v.sign()).unwrap();
    m.output("x", x, "m").unwrap();
    let t: Vec<f64> = (0..201).map(|i| 0.05 * f64::from(i)).collect();
    let (mut x, mut v, mut path) = (2.0, 0.0_f64, vec![2.0]);
    let h: f64 = 0.05 / 200.0;
    let mut random = Random(3);
    for k in 1..=200 * 200 {
        let rest = -4.0 * x;
        if v != 0.0 || f64::abs(rest) > 0.8 {
            let sign = if v == 0.0 { f64::signum(rest) } else { v.signum() };
            let next = v + h * (rest - 0.3 * v - 0.8 * sign);
            v = if v != 0.0 && next * v < 0.0 { 0.0 } else { next };
            x += h * v;
        }
        if k % 200 == 0 {
            path.push(x);
        }
    }
    let noisy = path.iter().map(|x| x + 0.005 * random.between(-1.7, 1.7)).collect();
    let run = Experiment::new(&m, "run", t, [("x", noisy)]).unwrap();
    (m, run)
}

#[test]
fn kinks_are_smoothed_and_what_that_leaves_in_error_is_told() {
    let (m, run) = friction();
    let runs = [run];
    let fit = Estimation::new(&m, &runs).solve().unwrap();
    let smoothing = fit.smoothing.as_ref().unwrap();
    assert_eq!(smoothing.widths[0].kink, "sign(v) in v'");
    assert_eq!(smoothing.widths[0].unit, "m/s");
    assert!(fit.message.contains("kinks of the state equations were smoothed"), "{}", fit.message);
    assert!((fit["c"].value - 0.8).abs() < 0.03, "{}", fit["c"].value);
    assert_eq!(fit.model.kinks().len(), 1); // the model as it was given

    let early = Estimation::new(&m, &runs).smoothing_passes(1).solve().unwrap();
    assert!(early.warnings[0].contains("kinks of the state equations were smoothed"), "{:?}", early.warnings);
    let rough = Estimation::new(&m, &runs).smooth_kinks(false).solve().unwrap();
    assert!(rough.smoothing.is_none());
}

/// A fast transient, then a slow motion, measured at few times.
fn fast(measured_late: bool) -> (Model, Experiment) {
    let mut m = Model::new("fast");
    let (x, y) = (m.state("x", "").unwrap(), m.state("y", "").unwrap());
    let log = |name: &str, start| Parameter::new(name, start).transform(Transform::Log);
    let (a, b) = (m.parameter(log("a", 1.0)).unwrap(), m.parameter(log("b", 1.0)).unwrap());
    m.equation("x", -(a * (&x * &x - &y))).unwrap();
    m.equation("y", -(b * &y)).unwrap();
    m.condition(End::Initial, "x", phugoid::Expr::from(3.0)).unwrap();
    m.condition(End::Initial, "y", phugoid::Expr::from(1.0)).unwrap();
    m.output("x", x, "").unwrap();
    if measured_late {
        let late = m.parameter(Parameter::new("late", 0.01).fixed(true)).unwrap();
        m.sensor_delay("x", &late).unwrap();
    }
    let t = vec![0.0, 0.02, 0.05, 0.5, 1.0, 2.0, 4.0, 6.0, 10.0];
    let blank = Experiment::of_inputs(&m, "run", t.clone(), []).unwrap();
    let mut path = Simulation::new(&m, &blank).parameter("a", 10.0).parameter("b", 0.2);
    if measured_late {
        path = path.parameter("late", 0.01);
    }
    let mut random = Random(5);
    let y = path
        .run()
        .unwrap()
        .output("x")
        .unwrap()
        .iter()
        .map(|y| y + 0.01 * random.between(-1.7, 1.7))
        .collect();
    let run = Experiment::new(&m, "run", t, [("x", y)]).unwrap();
    (m, run)
}

fn is_found(fit: &Fit, m: &Model, run: &Experiment) {
    for (name, truth) in [("a", 10.0), ("b", 0.2)] {
        let e = &fit[name];
        assert!((e.value - truth).abs() < 4.0 * e.std_error, "{e:?}");
    }
    // The path is that of an integration with these parameters.
    let again = Simulation::new(m, run).fit(fit).run().unwrap();
    for (y, other) in again.output("x").unwrap().iter().zip(fit.output(0, "x").unwrap()) {
        assert!(y.is_nan() && other.is_nan() || (y - other).abs() < 5e-4, "{y} {other}");
    }
}

#[test]
fn a_mesh_follows_the_motion_where_samples_are_few() {
    let (m, run) = fast(false);
    let runs = [run];
    let estimation =
        Estimation::new(&m, &runs).noise("x", Sigma::Known(0.01)).start("a", 0.3).start("b", 0.5);
    let fit = estimation.clone().solve().unwrap();
    assert_eq!(fit.status, Status::Converged);
    is_found(&fit, &m, &runs[0]);
    let Transcription::Collocation(mesh) = &fit.transcription else { panic!("no collocation") };
    assert!(matches!(mesh.grid[0], Grid::Edges(_)));
    // The same start, the same random numbers.
    assert_eq!(estimation.clone().solve().unwrap().solution.xi, fit.solution.xi);
    let fixed = estimation.moving_mesh(false).solve().unwrap();
    assert_eq!(fixed.records[0].mesh_t.len(), 8 * 3 + 1);
}

#[test]
fn a_mesh_follows_the_motion_that_a_sensor_shows_late() {
    let (m, run) = fast(true);
    let runs = [run];
    let estimation =
        Estimation::new(&m, &runs).noise("x", Sigma::Known(0.01)).start("a", 0.3).start("b", 0.5);
    is_found(&estimation.solve().unwrap(), &m, &runs[0]);
}
