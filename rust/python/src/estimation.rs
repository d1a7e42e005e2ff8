//! Estimations.

use std::fmt;
use std::sync::{Arc, Mutex};

use numpy::{PyArray1, PyReadonlyArray1};
use phugoid::Estimation;
use phugoid::collocation;
use phugoid::estimate::{Beginning, Earlier, Multipliers, Path, Problem, Smoothed, Solver};
use phugoid::interrupt::{Interrupt, current};
use phugoid::nlp::NotFinite;
use phugoid::noise::NoiseModel;
use phugoid::shooting::Integrator;
use phugoid::shooting::Shots;
use phugoid::solver::{Control, Evaluations, Iteration, Settings, Solution, Status};
use pyo3::exceptions::{PyKeyboardInterrupt, PyValueError};
use pyo3::prelude::*;

use crate::errors::raise;
use crate::fit::PyFit;
use crate::interrupt::{Caller, seconds, watched_twice};
use crate::model::{DelaySpec, PyModel};
use crate::newton::line;
use crate::problem::{GridSpec, Kept, PyProblem, Record, Transcription, experiment, grids};
use crate::shooting::{StepSpec, core_steps};
use crate::start::{StartSpec, starts};

type Array<'py> = PyReadonlyArray1<'py, f64>;
type Pair<'py> = (Array<'py>, Array<'py>);

/// Options of an estimation.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Options<'py> {
    order: usize,
    grids: Vec<GridSpec>,
    threads: usize,
    /// Runge-Kutta method and steps, where it is shooting.
    shooting: Option<(String, StepSpec)>,
    /// As it is saved.
    noise: String,
    start: Vec<(String, StartSpec<'py>)>,
    earlier: Option<EarlierSpec<'py>>,
    max_iterations: usize,
    tolerance: f64,
    time_limit: Option<f64>,
    gauss_newton: bool,
    regression: Option<bool>,
    paths: Option<bool>,
    /// When passes over delays end.
    delays: (f64, usize),
    /// Tolerance of a mesh refinement.
    refine: Option<f64>,
    moving_mesh: Option<bool>,
    restarts: Option<usize>,
    other_ways: bool,
    output_injection: bool,
    smooth_kinks: bool,
    /// Whether the user gave options of a solver.
    solver_given: bool,
}

/// An earlier fit.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct EarlierSpec<'py> {
    values: Vec<(String, f64)>,
    paths: Vec<(Array<'py>, Vec<(String, Array<'py>)>)>,
    /// Number of variables, multipliers of the constraints and of the bounds, whether of shooting.
    multipliers: Option<(usize, Array<'py>, Option<Pair<'py>>, bool)>,
    near: bool,
    smoothed: Option<SmoothedSpec>,
}

/// Widths of kinks, points of a segment, ends of segments for each experiment, and what was left in error.
type SmoothedSpec = (Vec<(String, f64)>, usize, Vec<Vec<f64>>, Vec<(String, f64)>);

impl From<EarlierSpec<'_>> for Earlier {
    fn from(spec: EarlierSpec<'_>) -> Self {
        let vector = |a: &Array<'_>| a.as_array().to_vec();
        let path = |(t, states): &(Array<'_>, Vec<(String, Array<'_>)>)| Path {
            t: vector(t),
            states: states.iter().map(|(name, x)| (name.clone(), vector(x))).collect(),
        };
        let multipliers = spec.multipliers.map(|(n, constraints, bounds, shooting)| Multipliers {
            n,
            constraints: vector(&constraints),
            bounds: bounds.map(|(l, u)| (vector(&l), vector(&u))),
            shooting,
        });
        Earlier {
            values: spec.values,
            paths: spec.paths.iter().map(path).collect(),
            multipliers,
            near: spec.near,
            smoothed: spec.smoothed.map(|(widths, order, edges, left)| Smoothed {
                widths,
                order,
                edges,
                left,
            }),
        }
    }
}

/// A solution of a solver in Python: variables, multipliers of constraints and of bounds, status, message, iterations,
/// seconds, lines of the table, counted evaluations, operations of a factorisation.
type Solved<'py> = (
    Array<'py>,
    Array<'py>,
    Pair<'py>,
    (String, String, usize, f64),
    Vec<(usize, f64, f64, f64, f64, usize)>,
    Vec<usize>,
    u64,
);

/// A function in Python that solves a problem from a point. It is called with the problem, variables, multipliers of
/// constraints and of bounds, whether states are known, near, sparse, most iterations and the seconds left; it gives None where a function
/// is not finite at the start.
struct OwnSolver<'c, 'a> {
    caller: &'c Caller<'a>,
    solve: &'a Py<PyAny>,
}

impl fmt::Debug for OwnSolver<'_, '_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a solver in Python")
    }
}

impl Solver for OwnSolver<'_, '_> {
    fn solve(
        &self,
        problem: &Problem,
        from: &Beginning<'_>,
        _watch: &mut dyn FnMut(&Iteration) -> Control,
    ) -> Result<Solution, NotFinite> {
        let found = Arc::new(Mutex::new(None));
        let (slot, solve) = (found.clone(), self.solve);
        let posed = match problem {
            Problem::Collocation(p) => Transcription::Collocation(p.clone(), Kept::default()),
            Problem::Shooting(p) => Transcription::Shooting(p.clone()),
        };
        let (xi, m) = (from.xi.to_vec(), from.multipliers.cloned());
        let left = current().left().map(|left| left.as_secs_f64());
        let how = (from.known, from.near, from.sparse, from.max_iterations, left);
        self.caller.call(move |py| {
            let array = |v: Vec<f64>| PyArray1::from_vec(py, v);
            let multipliers = m.map(|m| {
                let zeros = || vec![0.0; xi.len()];
                let (low, high) = m.bounds.unwrap_or_else(|| (zeros(), zeros()));
                (array(m.constraints), array(low), array(high))
            });
            let problem = Bound::new(py, PyProblem(posed))?;
            let given = solve.bind(py).call1((problem, array(xi), multipliers, how))?;
            let solved = given.extract::<Option<Solved<'_>>>()?.map(solution).transpose()?;
            *slot.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = solved;
            Ok(())
        });
        let found = found.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
        let mut found = found.ok_or(NotFinite)?;
        found.objective = problem.transcribed().objective(&found.xi).unwrap_or(f64::NAN);
        Ok(found)
    }
}

fn solution(solved: Solved<'_>) -> PyResult<Solution> {
    let (xi, multipliers, (low, high), (status, message, iterations, time), history, counts, flops) = solved;
    let vector = |a: Array<'_>| a.as_array().to_vec();
    let known = Status::ALL.into_iter().find(|s| s.to_string() == status);
    let one = |(number, value, defect, promise, step, trials): (usize, f64, f64, f64, f64, usize)| {
        Iteration { number, objective: -value, defect, promise, step, trials, shift: 0.0, exact: true }
    };
    let count = |i: usize| counts.get(i).copied().unwrap_or_default();
    let status = known.ok_or_else(|| PyValueError::new_err(format!("unknown status '{status}'")))?;
    let mut found = Solution::new(vector(xi), vector(multipliers), status);
    found.bound_multipliers = Some((vector(low), vector(high)));
    (found.message, found.iterations, found.flops) = (message, iterations, flops);
    found.evaluations = Evaluations {
        objective: count(0),
        gradient: count(1),
        constraints: count(2),
        jacobian: count(3),
        hessian: count(4),
        gauss_newton: count(5),
        factorizations: count(6),
        solutions: count(7),
    };
    found.time = seconds(Some(time)).unwrap_or_default();
    found.history = history.into_iter().map(one).collect();
    Ok(found)
}

/// Estimates the parameters of a model from records, without the interpreter lock. `watch` is called with each line of the
/// table. `stop` tells how often the user asked for an end: once ends the run with the best point so far, twice leaves out
/// its standard errors; a KeyboardInterrupt from `watch` or from Ctrl-C counts likewise. `solver` solves in place of
/// Newton's method (see `OwnSolver`).
#[pyfunction]
#[allow(clippy::too_many_arguments, clippy::needless_pass_by_value)] // from one call in Python
pub fn estimate(
    py: Python<'_>,
    model: &PyModel,
    delays: DelaySpec,
    records: Vec<Record<'_>>,
    options: Options<'_>,
    solver: Option<Py<PyAny>>,
    watch: Option<Py<PyAny>>,
    stop: Option<Py<PyAny>>,
) -> PyResult<PyFit> {
    let model = model.late(delays);
    let runs: Vec<_> = records.into_iter().map(experiment).collect::<PyResult<_>>()?;
    let outputs: Vec<&str> = model.outputs.iter().map(|o| o.name.as_str()).collect();
    let noise = NoiseModel::from_json(&options.noise, &outputs).map_err(raise)?;
    let grid = grids(options.grids)?;
    let transcription: phugoid::estimate::Transcription = match &options.shooting {
        None => collocation::Settings::default().order(options.order).grid(grid).into(),
        Some((integrator, steps)) => {
            let unknown = || PyValueError::new_err("unknown integrator");
            let integrator = Integrator::from_name(integrator).ok_or_else(unknown)?;
            Shots::default().grid(grid).integrator(integrator).steps(core_steps(steps)?).into()
        }
    };
    let mut estimation = Estimation::new(&model, &runs)
        .transcription(transcription)
        .threads(options.threads)
        .noise_model(noise)
        .other_ways(options.other_ways)
        .output_injection(options.output_injection)
        .smooth_kinks(options.smooth_kinks);
    if options.solver_given {
        estimation = estimation.solver(
            Settings::default()
                .max_iterations(options.max_iterations)
                .tolerance(options.tolerance)
                .gauss_newton(options.gauss_newton),
        );
    }
    estimation = estimation.time_limit(seconds(options.time_limit));
    if let Some(tolerance) = options.refine {
        estimation = estimation.refine(tolerance);
    }
    if let Some(moving) = options.moving_mesh {
        estimation = estimation.moving_mesh(moving);
    }
    if let Some(restarts) = options.restarts {
        estimation = estimation.restarts(restarts);
    }
    for (name, start) in starts(options.start) {
        estimation = estimation.start(&name, start);
    }
    if let Some(earlier) = options.earlier {
        estimation = estimation.start_from(Earlier::from(earlier));
    }
    if let Some(regression) = options.regression {
        estimation = estimation.regression(regression);
    }
    if let Some(paths) = options.paths {
        estimation = estimation.consistent_paths(paths);
    }
    estimation = estimation.delay_passes(options.delays.0, options.delays.1);
    let errors = Interrupt::within(None);
    let estimation = estimation.stop_errors(errors.clone());
    let (watch, solver) = (watch.as_ref(), solver.as_ref());
    let (found, error) = watched_twice(py, stop.as_ref(), &errors, |caller| {
        let each = |i: &Iteration| {
            let line = line(i);
            let Some(watch) = watch else { return Control::Continue };
            let go_on = caller.call(move |py| watch.call1(py, line).map(|_| ()));
            if go_on { Control::Continue } else { Control::Stop }
        };
        match solver {
            Some(solve) => estimation.clone().own_solver(&OwnSolver { caller, solve }).solve_with(each),
            None => estimation.solve_with(each),
        }
    });
    match error.filter(|e| !e.is_instance_of::<PyKeyboardInterrupt>(py)) {
        Some(error) => Err(error),
        None => found.map(PyFit).map_err(raise),
    }
}

/// A sentence where a sum of squared residuals, over the variance of the noise, is not that of noise; else nothing.
#[pyfunction]
pub fn unlike_noise(total: f64, degrees: usize) -> String {
    phugoid::estimate::unlike_noise(total, degrees).unwrap_or_default()
}
