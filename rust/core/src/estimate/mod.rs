//! From a model and records to a fit: the problem put together, solved, and told in the user's names.

mod fit;
mod judge;
mod late;
mod make;
mod measured;
mod print;
mod start;

pub use fit::{Bound, Estimate, Fit, Record};
pub use make::{Assessment, End};
pub use measured::Measured;
pub use start::{Given, Start, point};

use std::time::Duration;

use crate::collocation::{self, Collocation};
use crate::error::{Error, did_you_mean};
use crate::experiment::Experiment;
use crate::initial::{Initial, solve};
use crate::interrupt::{Interrupt, current};
use crate::mesh::Grid;
use crate::model::{Model, Scaling};
use crate::noise::{Density, Noise, NoiseModel, Scale};
use crate::problem::Transcribed;
use crate::shooting::{Shooting, Shots};
use crate::solver::{Control, Iteration, Settings, Solution, Status};

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
/// m.equation("x", -(&rate * &x), None)?;
/// m.output("x", x, "", None)?;
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
/// assert_eq!(error.to_string(), "start: 'rat' is no parameter, sigma or state. Did you mean 'rate'?");
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Estimation<'a> {
    model: &'a Model,
    experiments: &'a [Experiment],
    transcription: collocation::Settings,
    shots: Option<Shots>,
    solver: Settings,
    regression: Option<bool>,
    noise: NoiseModel,
    start: Vec<(String, Start)>,
    warm: Option<&'a Fit>,
    /// Whether samples stand elsewhere than in the fit to start from, as a delay has moved.
    moved: bool,
}

impl<'a> Estimation<'a> {
    /// Of the parameters that the experiments share; initial states are free.
    pub fn new(model: &'a Model, experiments: &'a [Experiment]) -> Self {
        Estimation {
            model,
            experiments,
            transcription: collocation::Settings::default(),
            shots: None,
            solver: Settings::default(),
            regression: None,
            noise: model.noise.clone(),
            start: Vec::new(),
            warm: None,
            moved: false,
        }
    }

    /// Points of a segment: 2 is the trapezoid, 4 the default.
    pub fn order(mut self, order: usize) -> Self {
        self.transcription.order = order;
        self
    }

    /// Division of every experiment into segments: one between samples unless said.
    pub fn grid(mut self, grid: Grid) -> Self {
        self.transcription.grid = vec![grid];
        self
    }

    /// Division of each experiment into segments, as many divisions as experiments.
    pub fn grids(mut self, grids: Vec<Grid>) -> Self {
        self.transcription.grid = grids;
        self
    }

    /// Single or multiple shooting in place of collocation. No regression precedes it unless asked for: between
    /// nodes far apart, the states as measured say little.
    pub fn shooting(mut self, settings: Shots) -> Self {
        self.shots = Some(settings);
        self
    }

    /// Threads; as many as there are cores unless said.
    pub fn threads(mut self, threads: usize) -> Self {
        self.transcription.threads = threads;
        if let Some(shots) = &mut self.shots {
            shots.threads = threads;
        }
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
    pub fn start_from(mut self, fit: &'a Fit) -> Self {
        self.warm = Some(fit);
        self
    }

    /// Options of the solver.
    pub fn solver(mut self, settings: Settings) -> Self {
        self.solver = settings;
        self
    }

    /// Whether a regression on the states as they start goes before the first step: where all of them are
    /// measured or given, unless said.
    pub fn regression(mut self, regression: bool) -> Self {
        self.regression = Some(regression);
        self
    }

    /// Solves the problem. Not to converge is a status of the fit, no error.
    ///
    /// # Errors
    /// For what cannot be right in the model, the data or an option, and for a model that is not finite
    /// at the start.
    pub fn solve(&self) -> Result<Fit, Error> {
        self.solve_with(|_| Control::Continue)
    }

    /// As [`Estimation::solve`]; `watch` sees each iteration and may end the run.
    ///
    /// # Errors
    /// As [`Estimation::solve`].
    pub fn solve_with(&self, mut watch: impl FnMut(&Iteration) -> Control) -> Result<Fit, Error> {
        self.solver.check()?;
        // All passes share the time, and standard errors are computed if some is left.
        Interrupt::within(self.solver.time_limit).run(|| {
            if self.model.delays.is_empty() {
                self.solve_now(&mut watch)
            } else {
                self.solve_late(&mut watch)
            }
        })
    }

    /// The estimate of a model in which nothing is late.
    fn solve_now(&self, watch: &mut dyn FnMut(&Iteration) -> Control) -> Result<Fit, Error> {
        self.model.check()?;
        let scalings = self.model.scalings(&self.parameters()?)?;
        if scalings.is_empty() {
            return self.solve_scaled(&[], watch);
        }
        // A scale that no output can tell would let the solver drift without end.
        let mut model = self.model.clone();
        for p in &mut model.parameters {
            if let Some(scaling) = scalings.iter().find(|s| s.held == p.name) {
                (p.start, p.fixed) = (scaling.at, true);
            }
        }
        let is_held = |name: &str| scalings.iter().any(|s| s.held == name.split('[').next().unwrap_or(name));
        let start = self.start.iter().filter(|s| !is_held(&s.0)).cloned().collect();
        let fit = Estimation { model: &model, start, ..self.clone() }.solve_scaled(&scalings, watch)?;
        Ok(Fit { model: self.model.clone(), ..fit })
    }

    /// The same with these scalings held.
    fn solve_scaled(
        &self,
        scalings: &[Scaling],
        watch: &mut dyn FnMut(&Iteration) -> Control,
    ) -> Result<Fit, Error> {
        let (problem, xi): (Box<dyn Transcribed>, Vec<f64>) = match &self.shots {
            None => self.transcribe().map(|(p, xi)| (Box::new(p) as _, xi))?,
            Some(shots) => self.transcribe_shooting(shots).map(|(p, xi)| (Box::new(p) as _, xi))?,
        };
        let problem = &*problem;
        let further = match self.warm {
            Some(_) => Vec::new(),
            None => self.given().elsewhere(problem, &xi, &self.parameters()?),
        };
        if !further.is_empty() && self.shots.is_some() {
            // A path that follows the measurements is found by collocation; an integration from poor values is none.
            let first = Estimation { shots: None, regression: None, ..self.clone() };
            let first = first.solve_scaled(scalings, watch)?;
            if first.status.is_end() {
                let mut fit = Estimation { warm: Some(&first), start: Vec::new(), ..self.clone() }
                    .solve_scaled(scalings, watch)?;
                fit.iterations += first.iterations;
                fit.solution.time += first.solution.time;
                return Ok(fit);
            }
        }
        let known = self
            .regression
            .unwrap_or_else(|| self.warm.is_none() && self.shots.is_none() && self.states_known());
        let solution = if further.is_empty() {
            self.solve_from(problem, &xi, known, watch)?
        } else {
            self.best_of(problem, &further, watch)?
        };
        Ok(Fit::new(self.model, self.experiments, problem, solution, scalings, &current()))
    }

    fn solve_from(
        &self,
        problem: &dyn Transcribed,
        xi: &[f64],
        regression: bool,
        watch: &mut dyn FnMut(&Iteration) -> Control,
    ) -> Result<Solution, Error> {
        let multipliers = self.same(problem).map(|fit| &fit.solution.multipliers[..]);
        let initial = if regression { Initial::Places } else { Initial::Start };
        solve(problem, xi, multipliers, initial, &self.solver, watch).map_err(|_| {
            let what = problem.explain(xi).map_or_else(
                || "near the starting point, a derivative of the model is not finite".into(),
                |what| format!("at the starting point, {what}"),
            );
            Error::Evaluation(format!(
                "{what}; give other start values, or bounds that keep functions finite"
            ))
        })
    }

    /// The best of the solutions from several points: at an end if possible, and of the greatest likelihood. Where none of
    /// them is at an end, a regression on the states as they start goes before each.
    fn best_of(
        &self,
        problem: &dyn Transcribed,
        starts: &[Vec<f64>],
        watch: &mut dyn FnMut(&Iteration) -> Control,
    ) -> Result<Solution, Error> {
        let (mut best, mut iterations, mut time): (Option<Solution>, _, _) = (None, 0, Duration::ZERO);
        let mut error = None;
        for regression in [false, true] {
            for xi in starts {
                let found = match self.solve_from(problem, xi, regression, watch) {
                    Ok(found) => found,
                    Err(e) => {
                        error = Some(e);
                        continue;
                    }
                };
                iterations += found.iterations;
                time += found.time;
                let (status, message) = (found.status, found.message.clone());
                let rank = |s: &Solution| (!s.status.is_end(), s.objective);
                if best.as_ref().is_none_or(|b| rank(&found) < rank(b)) {
                    best = Some(found);
                }
                if let Some(best) = best.as_mut().filter(|_| status == Status::Interrupted) {
                    (best.status, best.message) = (status, message);
                    break;
                }
            }
            if best.as_ref().is_some_and(|b| b.status.is_end() || b.status == Status::Interrupted) {
                break;
            }
        }
        let Some(best) = best else { return Err(error.expect("without a solution there was an error")) };
        Ok(Solution { iterations, time, ..best })
    }

    /// The nonlinear program of collocation and the point to start from: for a solver of one's own.
    ///
    /// # Errors
    /// As [`Estimation::solve`].
    pub fn transcribe(&self) -> Result<(Collocation, Vec<f64>), Error> {
        let noise = self.checked_noise()?;
        let noise_per_experiment = self.noise.per_experiment;
        let settings = collocation::Settings { noise_per_experiment, ..self.transcription.clone() };
        let problem = Collocation::new(self.model, self.experiments, noise, &settings)?;
        let xi = self.first_point(&problem)?;
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
        let xi = self.first_point(&problem)?;
        Ok((problem, xi))
    }

    fn checked_noise(&self) -> Result<Noise, Error> {
        self.model.check()?;
        let inputs = self.model.input_names();
        let outputs: Vec<&str> = self.model.outputs.iter().map(|o| o.name.as_str()).collect();
        Experiment::check_all(self.experiments, &inputs, &outputs)?;
        self.check_names(&outputs)?;
        self.noise.check()?;
        self.resolve_noise(&outputs)
    }

    fn first_point(&self, problem: &dyn Transcribed) -> Result<Vec<f64>, Error> {
        match self.same(problem) {
            Some(fit) if !self.moved => Ok(fit.solution.xi.clone()),
            _ => self.starting_point(problem),
        }
    }

    fn check_names(&self, outputs: &[&str]) -> Result<(), Error> {
        for name in self.noise.scales.iter().map(|n| &n.0).chain(self.noise.densities.iter().map(|d| &d.0)) {
            if !outputs.contains(&name.as_str()) {
                let hint = did_you_mean(name, outputs.iter().copied());
                return Err(Error::Option(format!("noise: '{name}' is not an output.{hint}")));
            }
        }
        self.given().check(self.experiments.iter().map(|e| e.name.as_str()), &self.names_of_noise(outputs))
    }

    /// The fit to go on from, where it is of this problem and nothing else is asked for.
    fn same(&self, problem: &dyn Transcribed) -> Option<&'a Fit> {
        let fit = self.warm.filter(|_| self.start.is_empty())?;
        let sizes = (fit.solution.xi.len(), fit.solution.multipliers.len()) == (problem.n(), problem.m());
        let of_model =
            problem.posed().parameters[..problem.posed().n_model_parameters].iter().map(|p| p.name.clone());
        let of_noise = || problem.posed().noise_report(&fit.solution.xi).into_iter().map(|r| r.name);
        let names = sizes && of_model.chain(of_noise()).eq(fit.parameters.iter().map(|p| p.name.clone()));
        (names && fit.model.states == self.model.states).then_some(fit)
    }
}
