//! The filter-error method: output error with process noise, by the Laplace approximation.
//!
//! ```text
//!   ẋ   = f(x, u, θ) + diag(q) w(t),   w white noise of unit intensity
//!   z_k = g(x_k, u_k, θ) + v_k,        v_k as in the output-error method
//! ```
//!
//! q_i is the *intensity* of the process noise of a state, unit/√s. Within the interval between two samples w is a sum of
//! orthonormal polynomials with coefficients ε_k ~ N(0, I) ([`noises`]), and x_{k+1} = Φ_k(x_k, ε_k, θ, q) solves the state
//! equations with them: two terms bring into other states what the noise of one does there between samples, where noise
//! that enters at samples alone is wrong by the first order of h.
//!
//! The noises are no parameters: they are integrated out. With J the minus logarithm of
//! the density of data and noises together, and H its Hessian in the noises at the most probable path,
//!
//! ```text
//!   ln p(z | θ) = −J* − ½ ln det H
//! ```
//!
//! is exact for systems linear in x (it is then what a Kalman filter computes), and the Laplace approximation
//! otherwise. The noise is described by ε and not by x_{k+1} − Φ(x_k, 0): a state without process noise is then a
//! constraint like any other, no noise at all (q = 0) is the output-error method, and nothing is singular there.
//!
//! Initial states are integrated out like the noises, over a prior that may be flat, or maximised over like θ, as the
//! output-error method does. The latter makes the likelihood grow without bound where process noise explains
//! an output by itself and its σ goes to 0: the first sample is then fitted exactly at no cost.
//!
//! Sources: R. V. Jategaonkar, *Flight Vehicle System Identification*, 2nd edition (AIAA, 2015), chapter 5; R. E. Maine
//! and K. W. Iliff, *Formulation and implementation of a practical algorithm for parameter estimation with process and
//! measurement noise* (SIAM J. Appl. Math. 41, 1981); K. Kristensen et al., *TMB: Automatic Differentiation and Laplace
//! Approximation* (J. Stat. Softw. 70, 2016) for the gradient.
//!
//! # The gradient
//!
//! By the envelope theorem J* changes with θ only directly. Of ½ ln det H, with W the covariances of the path, the
//! derivative by the Hessian's blocks is ½ W; by the path and the multipliers λ, which move with θ, it is ℓ_v,
//! and one more solution ν of the Newton system, K ν = ℓ_v, gives what their motion contributes, −νᵀ ∂K/∂θ-residual.
//! All derivatives are exact, up to the third of f and g ([`jet`], [`sample`]): a gradient costs about three times
//! the value, whatever the number of parameters.

mod block;
mod chain;
mod flow;
mod innovations;
mod jet;
mod noises;
mod path;
mod sample;
mod settings;
mod smoothed;

use std::cell::RefCell;

use crate::error::Error;
use crate::experiment::Experiment;
use crate::integrate::Integrator;
use crate::interrupt::current;
use crate::model::Model;
use crate::noise::Noise;

use crate::dense::add_transposed_product;
use flow::{Beside, Flow};
pub use innovations::Innovations;
use jet::{Gradients, Jets};
use noises::{Driven, intervals};
pub use path::Lost;
use path::{At, Found, Path, Run};
use sample::Samples;
pub use settings::Settings;
pub use smoothed::Smoothed;

/// The marginal likelihood of a model's parameters. See the [module](self).
///
/// Its parameters θ are the model's, then 1/σ of each output whose σ is unknown, then q of each noisy state.
///
/// ```
/// use phugoid::filter::{Filter, Settings};
/// use phugoid::noise::Noise;
/// use phugoid::{Experiment, Model, Parameter, Sigma};
///
/// let mut m = Model::new("random walk with drift");
/// let (x, slope) = (m.state("x", "m")?, m.parameter(Parameter::new("slope", 0.0))?);
/// m.equation("x", slope)?;
/// m.output("x", x, "m")?;
/// let run = Experiment::new(&m, "run", vec![0.0, 1.0], [("x", vec![1.0, 3.0])])?;
///
/// let initial = vec![Some((1.0, 0.5))];
/// let settings = Settings { states: vec!["x".into()], substeps: 1, terms: 1, initial };
/// let filter = Filter::new(&m, &[run], &Noise::Gaussian(vec![Sigma::Known(0.1)]), &settings)?;
/// assert_eq!(filter.parameters, ["slope", "q_x"]);
/// let found = filter.evaluate(&[1.0, 0.3], &filter.start(&[1.0, 3.0]), true).unwrap();
///
/// // z is Gaussian: mean (1, 2), variances 0.5² + 0.1² and 0.5² + 0.3² + 0.1², covariance 0.5².
/// let (a, b, c) = (0.26, 0.35, 0.25);
/// let det: f64 = a * b - c * c;
/// let exact = -0.5 * det.ln() - 0.5 * a / det; // the residuals are (0, 1)
/// assert!((found.log_likelihood - exact).abs() < 1e-12);
/// assert!((found.gradient[0] - a / det).abs() < 1e-9); // by the slope
/// # Ok::<(), phugoid::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Filter {
    /// Names of the parameters.
    pub parameters: Vec<String>,
    /// Number of model parameters.
    pub n_model: usize,
    /// Number of noises of an interval.
    m: usize,
    initial: Vec<Option<(f64, f64)>>,
    state_names: Vec<String>,
    n_noise: usize,
    n_data: usize,
    flow: Flow,
    jets: Jets,
    samples: Samples,
    runs: Vec<Run>,
}

/// The marginal likelihood at a point.
#[derive(Clone, Debug)]
pub struct Marginal {
    /// ln p(z | θ), without the constant −(N n_y/2) ln 2π.
    pub log_likelihood: f64,
    /// Its gradient, where asked for.
    pub gradient: Vec<f64>,
    /// The most probable path, to start from at a point near by.
    pub path: Vec<f64>,
    /// Newton iterations that it took.
    pub iterations: usize,
}

impl Filter {
    /// Compiles a problem.
    ///
    /// # Errors
    /// When the model is incomplete, the data do not fit it, or an option is out of range.
    pub fn new(
        model: &Model,
        experiments: &[Experiment],
        noise: &Noise,
        settings: &Settings,
    ) -> Result<Self, Error> {
        if let Some(late) = model.delays.parameters().first() {
            return Err(Error::model(format!(
                "the model '{}' has delays ({late}), which the filter-error method cannot estimate",
                model.name
            ))
            .about(&model.name));
        }
        let compiled = model.compile()?;
        let outputs: Vec<&str> = model.outputs.iter().map(|o| o.name.as_str()).collect();
        let inputs: Vec<&str> = model.inputs.iter().map(|o| o.name.as_str()).collect();
        if experiments.is_empty() {
            return Err(Error::data("no experiment was given; at least one is needed".into()));
        }
        Experiment::check_all(experiments, &inputs, &outputs)?;
        noise.check(&outputs)?;
        if !matches!(noise, Noise::Gaussian(_)) {
            return Err(Error::option("the filter-error method takes independent Gaussian noise".into()));
        }
        let state_names: Vec<String> = model.states.iter().map(|s| s.name.clone()).collect();
        let noisy = settings.noisy(&state_names)?;
        let noise_parameters = noise.parameters(&outputs);
        let mut parameters: Vec<String> = model.parameters.iter().map(|p| p.name.clone()).collect();
        parameters.extend(noise_parameters.iter().map(|p| p.name.clone()));
        parameters.extend(settings.states.iter().map(|s| format!("q_{s}")));
        let samples = Samples::new(&compiled, &outputs, noise, experiments)?;
        let driven = Driven::new(&compiled, &noisy, settings.terms);
        let tableau = Integrator::Rk4.tableau();
        let run = |e: &Experiment| Run {
            intervals: intervals(e, settings.substeps, settings.terms, &tableau),
            data: samples.data(e),
        };
        Ok(Filter {
            parameters,
            n_model: model.parameters.len(),
            m: noisy.len() * settings.terms,
            initial: settings.initial.clone(),
            state_names,
            n_noise: noise_parameters.len(),
            n_data: compiled.data.len(),
            flow: Flow::new(&driven, model.parameters.len(), tableau.clone())?,
            jets: Jets::new(&driven, tableau.clone())?,
            runs: experiments.iter().map(run).collect(),
            samples,
        })
    }

    fn n(&self) -> usize {
        self.initial.len()
    }

    /// Number of parameters.
    pub fn n_theta(&self) -> usize {
        self.parameters.len()
    }

    /// Samples of each record.
    pub fn lengths(&self) -> Vec<usize> {
        self.runs.iter().map(Run::samples).collect()
    }

    /// A path to start from: states as given (for each record rows of n, one a sample), no noise.
    ///
    /// # Panics
    /// When there are not as many states as the records have.
    pub fn start(&self, states: &[f64]) -> Vec<f64> {
        let (n, m) = (self.n(), self.m);
        let mut out = Vec::new();
        let mut rest = states;
        for samples in self.lengths() {
            let (these, after) = rest.split_at(samples * n);
            out.extend_from_slice(these);
            out.resize(out.len() + (samples - 1) * (m + n), 0.0);
            rest = after;
        }
        assert!(rest.is_empty(), "more states than the records have samples");
        out
    }

    /// The states of a path, as [`Filter::start`] takes them.
    ///
    /// # Panics
    /// When the path's length is wrong.
    pub fn states(&self, path: &[f64]) -> Vec<f64> {
        assert_eq!(path.len(), self.path_length());
        self.paths(path).into_iter().flat_map(|p| p.x).collect()
    }

    /// Length of a path.
    pub fn path_length(&self) -> usize {
        let (n, m) = (self.n(), self.m);
        self.lengths().iter().map(|samples| samples * n + (samples - 1) * (n + m)).sum()
    }

    fn paths(&self, path: &[f64]) -> Vec<Path> {
        let (n, m) = (self.n(), self.m);
        let mut rest = path;
        let mut take = |count: usize| {
            let (taken, after) = rest.split_at(count);
            rest = after;
            taken.to_vec()
        };
        self.lengths()
            .into_iter()
            .map(|s| Path { x: take(s * n), e: take((s - 1) * m), lambda: take((s - 1) * n) })
            .collect()
    }

    fn at<'a>(&'a self, theta: &'a [f64], run: &'a Run) -> At<'a> {
        let (theta, q) = theta.split_at(self.n_model + self.n_noise);
        At {
            flow: &self.flow,
            samples: &self.samples,
            theta,
            driving: [&theta[..self.n_model], q].concat(),
            m: self.m,
            initial: &self.initial,
            run,
            memory: RefCell::default(),
        }
    }

    /// Explains why there is no marginal likelihood, in the user's names.
    pub fn explain(&self, lost: Lost) -> String {
        match lost {
            Lost::NotFinite => "an equation is not finite in the search for the most probable path".into(),
            Lost::First(state) => format!(
                "the data do not determine the initial value of state '{0}': give initial={{'{0}': (mean, std)}}",
                self.state_names[state]
            ),
            Lost::Curvature => "the most probable path is not a strict maximum of its density".into(),
            Lost::Stuck => "the most probable path was not found".into(),
            Lost::Stopped => "the search for the most probable path was stopped".into(),
        }
    }

    /// The marginal log-likelihood at parameters `theta`, with its gradient if asked for; `path` is where the search for
    /// the most probable path starts, from [`Filter::start`] or from an evaluation near by.
    ///
    /// # Errors
    /// Where there is none; see [`Filter::explain`].
    ///
    /// # Panics
    /// When lengths are wrong.
    pub fn evaluate(&self, theta: &[f64], path: &[f64], with_gradient: bool) -> Result<Marginal, Lost> {
        assert_eq!(theta.len(), self.n_theta());
        assert_eq!(path.len(), self.path_length());
        let mut out = Marginal { log_likelihood: 0.0, gradient: Vec::new(), path: Vec::new(), iterations: 0 };
        let mut gradient = vec![0.0; theta.len()];
        for (run, start) in self.runs.iter().zip(self.paths(path)) {
            let at = self.at(theta, run);
            let found = at.path(start)?;
            out.log_likelihood -= found.cost + 0.5 * found.chain.log_det(&found.factor)?;
            if with_gradient {
                if current().stops() {
                    return Err(Lost::Stopped);
                }
                self.add_gradient(&at, &found, &mut gradient)?;
            }
            out.path.extend(found.path.x);
            out.path.extend(found.path.e);
            out.path.extend(found.path.lambda);
            out.iterations = out.iterations.max(found.iterations);
        }
        let finite = out.log_likelihood.is_finite() && gradient.iter().all(|g| g.is_finite());
        if with_gradient {
            out.gradient = gradient.into_iter().map(|g| -g).collect();
        }
        if finite { Ok(out) } else { Err(Lost::NotFinite) }
    }

    /// Adds the gradient of J* + ½ ln det H of a record.
    fn add_gradient(&self, at: &At<'_>, found: &Found, gradient: &mut [f64]) -> Result<(), Lost> {
        let (n, run) = (self.n(), at.run);
        let width = n + self.m;
        let (chain, factor, path) = (&found.chain, &found.factor, &found.path);
        let w = chain.random_covariances(factor)?;
        let half: Vec<f64> = w.x.iter().map(|w| 0.5 * w).collect();
        let mut by_b = chain.passage_slopes(factor, &w)?;
        let half_lambda: Vec<f64> = path.lambda.iter().map(|l| 0.5 * l).collect();

        // How ½ ln det changes with states, noises and multipliers, and what their motion brings.
        let interrupt = current();
        let jets = self.jets.run(&at.driving, &run.intervals, &path.x, &path.e, &w.z);
        let (points, s) = jets.ok_or_else(|| Lost::without(&interrupt))?;
        let (mut by_x, mut by_e) = (vec![0.0; path.x.len()], vec![0.0; path.e.len()]);
        let mut unused = vec![0.0; gradient.len()];
        let none = vec![0.0; path.x.len()];
        let weights = jet::Weights { end: &none[n..], b: &by_b, s: &half_lambda };
        let mut to = Gradients { x: &mut by_x, e: &mut by_e, theta: &mut unused };
        let done = self.jets.pull_back(&at.driving, &run.intervals, &points, &weights, &mut to);
        done.ok_or(Lost::Stopped)?;
        let weights = sample::Weights { cost: 0.0, slope: &none, curvature: &half };
        self.samples.pull_back(at.theta, &run.data, &path.x, &weights, &mut by_x, &mut unused);
        let minus = |v: &[f64]| -> Vec<f64> { v.iter().map(|v| -v).collect() };
        let gaps: Vec<f64> = s.iter().map(|s| -0.5 * s).collect();
        let nu = chain.solve(factor, &minus(&by_x), &minus(&by_e), &gaps)?;

        // The parameters themselves.
        for (k, by_b) in by_b.chunks_exact_mut(n * width).enumerate() {
            let z = nu.x[k * n..(k + 1) * n].iter().chain(&nu.e[k * self.m..(k + 1) * self.m]);
            for (j, nu) in z.enumerate() {
                (0..n).for_each(|i| by_b[i * width + j] -= path.lambda[k * n + i] * nu);
            }
        }
        let end: Vec<f64> = path.lambda.iter().zip(&nu.lambda).map(|(l, v)| l - v).collect();
        let weights = jet::Weights { end: &end, b: &by_b, s: &half_lambda };
        let mut by_driving = vec![0.0; at.driving.len()];
        let mut to = Gradients { x: &mut by_x, e: &mut by_e, theta: &mut by_driving };
        let done = self.jets.pull_back(&at.driving, &run.intervals, &points, &weights, &mut to);
        done.ok_or(Lost::Stopped)?;
        let weights = sample::Weights { cost: 1.0, slope: &minus(&nu.x), curvature: &half };
        self.samples.pull_back(at.theta, &run.data, &path.x, &weights, &mut by_x, gradient);
        let (of_model, of_q) = by_driving.split_at(self.n_model);
        let places = (0..self.n_model).chain(self.n_model + self.n_noise..gradient.len());
        places.zip(of_model.iter().chain(of_q)).for_each(|(i, v)| gradient[i] += v);
        Ok(())
    }

    /// The expected information of the model's parameters, (p, p), with path and noises eliminated and σ and q
    /// known: the curvature of −ln p without that of the residuals and of ln det.
    ///
    /// # Errors
    /// As [`Filter::evaluate`].
    pub fn information(&self, theta: &[f64], path: &[f64]) -> Result<Vec<f64>, Lost> {
        let mut sum = vec![0.0; self.n_model * self.n_model];
        for (run, start) in self.runs.iter().zip(self.paths(path)) {
            let at = self.at(theta, run);
            let found = at.path(start)?;
            let (information, _) = self.border(&at, &found)?;
            sum.iter_mut().zip(information).for_each(|(s, v)| *s += v);
        }
        Ok(sum)
    }

    fn border(&self, at: &At<'_>, found: &Found) -> Result<(Vec<f64>, Vec<f64>), Lost> {
        let (n, p) = (self.n(), self.n_model);
        let columns = n + p;
        let x = &found.path.x;
        let linear = at.linearise(&found.path, &Beside::Parameters)?;
        let slopes = self.samples.residual_slopes(at.theta, &at.run.data, x, p);
        let each = slopes.len() / at.run.samples();
        let (mut cross, mut own) = (Vec::new(), vec![0.0; p * p]);
        let mut square = vec![0.0; columns * columns];
        for j in slopes.chunks_exact(each) {
            square.fill(0.0);
            add_transposed_product(&mut square, j, j, [columns, each / columns, columns]);
            for r in 0..n {
                cross.extend_from_slice(&square[r * columns + n..(r + 1) * columns]);
            }
            for r in 0..p {
                for c in 0..p {
                    own[r * p + c] += square[(n + r) * columns + n + c];
                }
            }
        }
        Ok(found.chain.border(&found.factor, &linear.by_p, &cross, &own, p)?)
    }
}
