//! From a model and records to a fit: the problem put together, solved, and told in the user's names.

mod accuracy;
mod delays;
mod draws;
mod earlier;
mod fit;
mod injection;
mod integrated;
mod integration;
mod judge;
mod make;
mod motion;
mod moving_mesh;
mod noise;
mod outside;
mod print;
mod refine;
mod restarts;
mod retries;
mod run;
mod search;
mod segments;
mod smoothing;
mod start;
mod transcription;
mod unmeasured;

pub use crate::measured::Measured;
pub use earlier::{Earlier, Multipliers, Path, Smoothed};
pub use fit::{Bound, Estimate, Fit, Moved, Record};
pub use integration::{CollocatedPath, IntegrationError};
pub use judge::unlike_noise;
pub(crate) use make::noise_covariance;
pub use noise::resolved;
pub(crate) use noise::spread;
pub use outside::{Beginning, Solver};
pub use refine::{Refinement, RefinementStep};
pub use smoothing::{KinkWidth, LeftInError, Smoothing, SmoothingStep};
pub use start::{Given, Start, point};
pub use transcription::{Problem, Transcription};

use std::sync::Arc;
use std::time::Duration;

use crate::collocation::{self, Collocation};
use crate::error::Error;
use crate::experiment::Experiment;
use crate::interrupt::Interrupt;
use crate::mesh::Grid;
use crate::model::Model;
use crate::noise::{Density, Noise, NoiseModel, Scale};
use crate::problem::Transcribed;
use crate::shooting::{Shooting, Shots};
use crate::solver::Settings;

/// The maximum-likelihood estimate of a model's parameters from records (Eq. ml_loglike), as it is put
/// together: what is not said has a default.
///
/// Parameters start as declared, standard deviations at the spread of the measurements, states as measured where an
/// output measures them, else as declared, else at 0, or at other values where the model has no finite derivative at 0. Nothing is checked before [`Estimation::solve`].
///
/// ```
/// use phugoid::{Estimation, Experiment, Model, Parameter, Sigma};
///
/// let mut m = Model::new("decay");
/// let x = m.state("x", "m")?;
/// let rate = m.parameter(Parameter::new("rate", 0.1))?;
/// m.equation("x", -(&rate * &x))?;
/// m.output("x", x, "")?;
///
/// // Two runs from different initial states, measured to 1 mm.
/// let run = |name, x0: f64| {
///     let t: Vec<f64> = (0..50).map(|k| 0.1 * k as f64).collect();
///     let x = t.iter().map(|t| x0 * (-0.7 * t).exp() + 1e-3 * (1e4 * t).sin()).collect();
///     Experiment::new(&m, name, t, [("x", x)])
/// };
/// let fit = Estimation::new(&m, &[run("one", 1.0)?, run("two", -2.0)?])
///     .noise("x", Sigma::Known(1e-3))
///     .start("rate", 0.5)
///     .solve()?;
/// assert!((fit["rate"].value - 0.7).abs() < 4.0 * fit["rate"].std_error);
///
/// // Misspelt names are errors.
/// let error = Estimation::new(&m, &[run("one", 1.0)?]).start("rat", 0.5).solve().unwrap_err();
/// assert_eq!(error.to_string(), "start: 'rat' is not a parameter, sigma or state. Did you mean 'rate'?");
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Estimation<'a> {
    model: &'a Model,
    experiments: &'a [Experiment],
    transcription: Transcription,
    solver: Settings,
    own_solver: Option<&'a dyn Solver>,
    regression: Option<bool>,
    paths: Option<bool>,
    noise: NoiseModel,
    start: Vec<(String, Start)>,
    earlier: Option<Arc<Earlier>>,
    /// Of passes over delays: the part of a standard error by which these may still move, and most passes.
    settled: f64,
    passes: usize,
    /// The tolerance of a mesh refinement.
    refine: Option<f64>,
    moving_mesh: Option<bool>,
    restarts: Option<usize>,
    other_ways: bool,
    output_injection: bool,
    smooth_kinks: bool,
    smoothing_passes: usize,
    /// Whether options of a solver were given.
    solver_given: bool,
    /// What stops all work but that of standard errors of a run that was interrupted.
    outside: Interrupt,
    /// What stops that.
    afterwards: Interrupt,
}

impl<'a> Estimation<'a> {
    /// Of the parameters that the experiments share; initial states are free.
    pub fn new(model: &'a Model, experiments: &'a [Experiment]) -> Self {
        Estimation {
            model,
            experiments,
            transcription: Transcription::default(),
            solver: Settings::default(),
            own_solver: None,
            regression: None,
            paths: None,
            noise: model.noise.clone(),
            start: Vec::new(),
            earlier: None,
            settled: 1e-4,
            passes: 30,
            refine: None,
            moving_mesh: None,
            restarts: None,
            other_ways: true,
            output_injection: true,
            smooth_kinks: true,
            smoothing_passes: 30,
            solver_given: false,
            outside: Interrupt::default(),
            afterwards: Interrupt::default(),
        }
    }

    /// The nonlinear program that the estimation becomes: collocation of order 4 with one segment between samples, unless said.
    pub fn transcription(mut self, transcription: impl Into<Transcription>) -> Self {
        self.transcription = transcription.into();
        self
    }

    /// Points of a segment of collocation: 2 is the trapezoid, 4 the default. Shooting has none.
    pub fn order(mut self, order: usize) -> Self {
        if let Transcription::Collocation(settings) = &mut self.transcription {
            settings.order = order;
        }
        self
    }

    /// Division of every experiment into segments: by collocation one between samples, by shooting a single one, unless said.
    pub fn grid(self, grid: Grid) -> Self {
        self.grids(vec![grid])
    }

    /// Division of each experiment into segments, as many divisions as experiments.
    pub fn grids(mut self, grids: Vec<Grid>) -> Self {
        *self.transcription.grids_mut() = grids;
        self
    }

    /// Single or multiple shooting in place of collocation. No regression precedes it unless asked for: between
    /// nodes far apart, the states as measured say little.
    pub fn shooting(self, settings: Shots) -> Self {
        let threads = if settings.threads == 0 { self.transcription.threads() } else { settings.threads };
        self.transcription(settings.threads(threads))
    }

    /// Threads; as many as there are cores unless said.
    pub fn threads(mut self, threads: usize) -> Self {
        *self.transcription.threads_mut() = threads;
        self
    }

    /// The standard deviation of an output's noise: unknown, from 1e-9 to 1e6 times the spread of the
    /// measurements, unless said.
    pub fn noise(mut self, output: &str, sigma: impl Into<Scale>) -> Self {
        self.noise = self.noise.scale(output, sigma);
        self
    }

    /// All that is said of the noise, instead of the model's own ([`Model::noise`]).
    pub fn noise_model(mut self, noise: NoiseModel) -> Self {
        self.noise = noise;
        self
    }

    /// Scales, correlations and other parameters of the noise are of each experiment its own:
    /// `sigma_<output>[<experiment>]`. Known ones are the same everywhere.
    pub fn noise_per_experiment(mut self) -> Self {
        self.noise = self.noise.per_experiment();
        self
    }

    /// The density of an output's noise, whose scale [`Estimation::noise`] says: Gaussian, unless said.
    pub fn density(mut self, output: &str, density: Density) -> Self {
        self.noise = self.noise.density(output, density);
        self
    }

    /// Gaussian noise that is correlated between outputs, with an unknown covariance: `sigma_<output>` and
    /// `corr_<output>_<output>`. All standard deviations are unknown then.
    pub fn correlated(mut self) -> Self {
        self.noise = self.noise.correlated();
        self
    }

    /// Gaussian noise of this covariance matrix, n_y × n_y in the order of the model's outputs, row by row.
    pub fn covariance(mut self, matrix: Vec<f64>) -> Self {
        self.noise = self.noise.covariance(matrix);
        self
    }

    /// Where a parameter, a standard deviation (`sigma_<output>`) or a state starts: a number, or for a
    /// state a path, one value a sample. See [`Start`].
    pub fn start(mut self, name: &str, start: impl Into<Start>) -> Self {
        self.start.push((name.to_owned(), start.into()));
        self
    }

    /// Starts where a fit ended, as far as it has the same names; [`Estimation::start`] goes before. A fit
    /// of the same problem gives its multipliers as well, so that a run is gone on with.
    pub fn start_from(mut self, fit: impl Into<Earlier>) -> Self {
        self.earlier = Some(Arc::new(fit.into()));
        self
    }

    /// Options of the solver.
    pub fn solver(mut self, settings: Settings) -> Self {
        (self.solver, self.solver_given) = (settings, true);
        self
    }

    /// The time that all of the estimation may take.
    pub fn time_limit(mut self, limit: impl Into<Option<Duration>>) -> Self {
        self.solver.time_limit = limit.into();
        self
    }

    /// A solver of one's own. Of [`Estimation::solver`] it takes the number of iterations and the time.
    pub fn own_solver(mut self, solver: &'a dyn Solver) -> Self {
        (self.own_solver, self.solver_given) = (Some(solver), true);
        self
    }

    /// Divides segments whose integration error is above this part of the noise, or raises the order, and estimates again,
    /// until it is below in all. [`Fit::refinement`] reports the passes.
    pub fn refine(mut self, tolerance: f64) -> Self {
        self.refine = Some(tolerance);
        self
    }

    /// Whether the mesh follows the motion, as a simulation with the estimates shows it: unless said, where it has one segment
    /// between samples, samples are few, and the parameters tell all initial states.
    pub fn moving_mesh(mut self, moving: bool) -> Self {
        self.moving_mesh = Some(moving);
        self
    }

    /// With a mesh that follows the motion: restarts from other parameters without a gain until the search for better optima
    /// ends; twenty, and two for each parameter, or eight that end at the same optimum, unless said. On any other mesh: most
    /// restarts from start values multiplied by random factors, where no other way ends at an optimum that matches the outputs
    /// well; none, unless said.
    pub fn restarts(mut self, restarts: usize) -> Self {
        self.restarts = Some(restarts);
        self
    }

    /// Whether other ways from the start are tried where a run ends without an optimum, or at one at which no output is matched
    /// well: estimates with output injection whose gain falls to zero, a regression, steps along consistent paths, the exact
    /// Hessian, restarts where they are asked for, and, where neither a start nor a solver is given, a run with the noise held
    /// first. They are, unless said.
    pub fn other_ways(mut self, try_them: bool) -> Self {
        self.other_ways = try_them;
        self
    }

    /// Sets whether estimates with output injection are one of the other ways. They are, unless said: a start next to the optimum
    /// has no need of them, and where it ends at a poor one, the model is what misses the motion.
    pub fn output_injection(mut self, try_it: bool) -> Self {
        self.output_injection = try_it;
        self
    }

    /// Whether kinks and jumps of the state equations are smoothed where they keep a fit by collocation from converging, or are
    /// crossed where its mesh is too coarse for them; they are, unless said. [`Fit::smoothing`] reports the passes.
    pub fn smooth_kinks(mut self, smooth: bool) -> Self {
        self.smooth_kinks = smooth;
        self
    }

    /// Most passes over narrower widths of smoothed kinks, 30 unless said.
    pub fn smoothing_passes(mut self, passes: usize) -> Self {
        self.smoothing_passes = passes;
        self
    }

    /// Whether steps along paths that satisfy the equations go first: where states are neither measured nor given and
    /// samples are few, unless said. From the fit of another model they follow where the loop is not near an optimum soon.
    pub fn consistent_paths(mut self, paths: bool) -> Self {
        self.paths = Some(paths);
        self
    }

    /// Passes over the delays end where these move by less than this part of their standard errors, 1e-4 unless said, or
    /// after so many passes, 30 unless said.
    pub fn delay_passes(mut self, settled: f64, passes: usize) -> Self {
        (self.settled, self.passes) = (settled, passes);
        self
    }

    /// What stops the standard errors of a run that was interrupted: an interrupt ends a run with the best point so far,
    /// whose standard errors are computed all the same.
    pub fn stop_errors(mut self, interrupt: Interrupt) -> Self {
        self.afterwards = interrupt;
        self
    }

    /// Whether a regression on the initial paths of the states goes before the first step: where all of them are
    /// measured or given, unless said.
    pub fn regression(mut self, regression: bool) -> Self {
        self.regression = Some(regression);
        self
    }

    /// The nonlinear program of collocation and the point to start from: for a solver of one's own.
    ///
    /// # Errors
    /// As [`Estimation::solve`].
    pub fn transcribe(&self) -> Result<(Collocation, Vec<f64>), Error> {
        let noise = self.checked_noise()?;
        let noise_per_experiment = self.noise.per_experiment;
        let settings = collocation::Settings { noise_per_experiment, ..self.transcription.collocation() };
        let problem = Collocation::new(self.model, self.experiments, noise, &settings)?;
        let xi = self.starting_point(&problem)?;
        Ok((problem, xi))
    }

    /// That of shooting, alike.
    ///
    /// # Errors
    /// As [`Estimation::solve`].
    pub fn transcribe_shooting(&self, settings: &Shots) -> Result<(Shooting, Vec<f64>), Error> {
        let noise = self.checked_noise()?;
        let noise_per_experiment = settings.noise_per_experiment || self.noise.per_experiment;
        let settings = Shots { noise_per_experiment, ..settings.clone() };
        let problem = Shooting::new(self.model, self.experiments, noise, &settings)?;
        let xi = self.starting_point(&problem)?;
        Ok((problem, xi))
    }

    fn checked_noise(&self) -> Result<Noise, Error> {
        self.model.check()?;
        let inputs = self.model.input_names();
        let outputs: Vec<&str> = self.model.outputs.iter().map(|o| o.name.as_str()).collect();
        Experiment::check_all(self.experiments, &inputs, &outputs)?;
        self.resolve_noise(&outputs)
    }

    /// The multipliers to go on from, where they are of a problem of this size and nothing else is asked for.
    fn multipliers(&self, problem: &dyn Transcribed) -> Option<&Multipliers> {
        let found = self.earlier.as_ref().filter(|_| self.start.is_empty())?.multipliers.as_ref()?;
        let same = (found.n, found.constraints.len()) == (problem.n(), problem.m());
        (same && found.shooting != self.transcription.is_collocation()).then_some(found)
    }
}
