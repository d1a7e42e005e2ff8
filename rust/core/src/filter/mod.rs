//! The filter-error method: output error with process noise, by the Laplace approximation.
//!
//! ```text
//!   x_{k+1} = Φ_k(x_k, θ) + G_k ε_k,    G_k = √h_k diag(q),    ε_k ~ N(0, I)
//!   z_k     = g(x_k, u_k, θ) + v_k,     v_k as in the output-error method
//! ```
//!
//! Φ_k solves the state equations over the interval h_k between two samples; q_i is the *intensity* of the process
//! noise of a state, unit/√s. The noises are no parameters: they are integrated out. With J the minus logarithm of
//! the density of data and noises together, and H its Hessian in the noises at the most probable path,
//!
//! ```text
//!   ln p(z | θ) = −J* − ½ ln det H
//! ```
//!
//! is exact for systems linear in x (it is then what a Kalman filter computes), and the Laplace approximation
//! otherwise. The noise is described by ε and not by x_{k+1} − Φ: a state without process noise is then a
//! constraint like any other, no noise at all (q = 0) is the output-error method, and nothing is singular there.
//!
//! First states are integrated out like the noises, over a prior that may be flat, or maximised over like θ, as the
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
mod dense;
mod flow;
mod innovations;
mod jet;
mod path;
mod sample;
mod steps;

use crate::error::Error;
use crate::experiment::Experiment;
use crate::model::Model;
use crate::noise::Noise;

use dense::{add_transposed_product, product};
use flow::Flow;
pub use innovations::Innovations;
use jet::Jets;
pub use path::Lost;
use path::{At, Found, Path, Run};
use sample::Samples;

/// What is assumed of the process noise.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Names of the states that have it.
    pub states: Vec<String>,
    /// Runge-Kutta steps between samples.
    pub substeps: usize,
    /// Whether intervals come in pairs, and the noise of a pair enters in its middle, not at the end of each. With
    /// a point added in the middle of all intervals (no sample there), the covariance of the noise that gathers over an
    /// interval is that of continuous noise to second order, ∫ Φ Q Φᵀ by the midpoint rule.
    pub halves: bool,
    /// For each state of the model, mean and standard deviation of its first value, infinite for a flat prior of
    /// density 1; or `None` to maximise over it.
    pub initial: Vec<Option<(f64, f64)>>,
}

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
/// m.equation("x", slope, None)?;
/// m.output("x", x, "m", None)?;
/// let run = Experiment::new(&m, "run", vec![0.0, 1.0], [("x", vec![1.0, 3.0])])?;
///
/// let initial = vec![Some((1.0, 0.5))];
/// let settings = Settings { states: vec!["x".into()], substeps: 1, halves: false, initial };
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
    /// The noisy states.
    pub noisy: Vec<usize>,
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

/// The states of one record given all data and the parameters.
#[derive(Clone, Debug, Default)]
pub struct Smoothed {
    /// n columns of N.
    pub states: Vec<Vec<f64>>,
    /// Their standard deviations, for parameters known.
    pub deviations: Vec<Vec<f64>>,
    /// Outputs there, n_y columns of N.
    pub outputs: Vec<Vec<f64>>,
    /// What a filter predicts of each sample from those before it.
    pub innovations: Innovations,
    /// Covariance of the first state, (n, n), for parameters known, and how it follows the model's parameters, (n, p).
    pub first_covariance: Vec<f64>,
    /// How the first state follows the model's parameters, (n, p).
    pub first_follows: Vec<f64>,
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
        let compiled = model.compile()?;
        let outputs: Vec<&str> = model.outputs.iter().map(|o| o.name.as_str()).collect();
        let inputs: Vec<&str> = model.inputs.iter().map(|o| o.name.as_str()).collect();
        if experiments.is_empty() {
            return Err(Error::Data("no experiment was given; at least one is needed".into()));
        }
        experiments.iter().try_for_each(|e| e.check(&inputs, &outputs))?;
        noise.check(&outputs)?;
        if !matches!(noise, Noise::Gaussian(_)) {
            return Err(Error::Option("the filter-error method takes independent Gaussian noise".into()));
        }
        if let Some(e) = experiments.iter().find(|e| settings.halves && e.t.len() % 2 == 0) {
            let text = format!("experiment '{}': an even number of points has no pairs of intervals", e.name);
            return Err(Error::Data(text));
        }
        let state_names: Vec<String> = model.states.iter().map(|s| s.name.clone()).collect();
        let noisy = settings.noisy(&state_names)?;
        let noise_parameters = noise.parameters(&outputs);
        let mut parameters: Vec<String> = model.parameters.iter().map(|p| p.name.clone()).collect();
        parameters.extend(noise_parameters.iter().map(|p| p.name.clone()));
        parameters.extend(settings.states.iter().map(|s| format!("q_{s}")));
        let samples = Samples::new(&compiled, &outputs, noise, experiments);
        Ok(Filter {
            parameters,
            n_model: model.parameters.len(),
            noisy,
            initial: settings.initial.clone(),
            state_names,
            n_noise: noise_parameters.len(),
            n_data: compiled.data.len(),
            flow: Flow::new(&compiled),
            jets: Jets::new(&compiled),
            runs: experiments
                .iter()
                .map(|e| Run::new(&samples, e, settings.substeps, settings.halves))
                .collect(),
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
        let (n, m) = (self.n(), self.noisy.len());
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

    /// Length of a path.
    pub fn path_length(&self) -> usize {
        let (n, m) = (self.n(), self.noisy.len());
        self.lengths().iter().map(|samples| samples * n + (samples - 1) * (n + m)).sum()
    }

    fn paths(&self, path: &[f64]) -> Vec<Path> {
        let (n, m) = (self.n(), self.noisy.len());
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
            n_model: self.n_model,
            q,
            noisy: &self.noisy,
            initial: &self.initial,
            run,
        }
    }

    /// Why there is no marginal likelihood, in the user's names.
    pub fn explain(&self, lost: Lost) -> String {
        match lost {
            Lost::NotFinite => "an equation is not finite on the way to the most probable path".into(),
            Lost::First(state) => format!(
                "the data do not determine the first value of state '{0}': give initial={{'{0}': (mean, std)}}",
                self.state_names[state]
            ),
            Lost::Curvature => "the most probable path is no proper maximum of its density".into(),
            Lost::Stuck => "the most probable path was not found".into(),
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
        let (n, m, run) = (self.n(), self.noisy.len(), at.run);
        let nn = n * n;
        let (chain, factor, path) = (&found.chain, &found.factor, &found.path);
        let intervals = run.samples() - 1;
        let w = chain.random_covariances(factor)?;
        let half: Vec<f64> = w.iter().map(|w| 0.5 * w).collect();
        // ½ ln det changes by M A W with Φ_x.
        let mut by_a = vec![0.0; intervals * nn];
        let mut aw = vec![0.0; nn];
        for (k, by_a) in by_a.chunks_exact_mut(nn).enumerate() {
            product(&mut aw, &chain.a[k * nn..(k + 1) * nn], &w[k * nn..(k + 1) * nn], [n, n, n]);
            product(by_a, &factor.m[k * nn..(k + 1) * nn], &aw, [n, n, n]);
        }
        let half_lambda: Vec<f64> = path.lambda.iter().map(|l| 0.5 * l).collect();

        // How ½ ln det changes with states and multipliers, and what their motion brings.
        let model = at.theta_model();
        let (jets, s) = self.jets.run(model, &run.intervals, &path.x, &w);
        let (mut by_x, mut unused) = (vec![0.0; run.samples() * n], vec![0.0; gradient.len()]);
        let none = vec![0.0; run.samples() * n];
        let weights = jet::Weights { end: &none[n..], a: &by_a, s: &half_lambda };
        self.jets.pull_back(model, &run.intervals, &jets, &weights, &mut by_x, &mut unused);
        let weights = sample::Weights { cost: 0.0, slope: &none, curvature: &half };
        self.samples.pull_back(at.theta, &run.data, &path.x, &weights, &mut by_x, &mut unused);
        let minus: Vec<f64> = by_x.iter().map(|v| -v).collect();
        let gaps: Vec<f64> = s.iter().map(|s| -0.5 * s).collect();
        let nu = chain.solve(factor, &minus, &vec![0.0; intervals * m], &gaps);

        // The parameters themselves.
        for k in 0..intervals {
            for i in 0..n {
                for j in 0..n {
                    by_a[(k * n + i) * n + j] -= path.lambda[k * n + i] * nu.x[k * n + j];
                }
            }
        }
        let end: Vec<f64> = path.lambda.iter().zip(&nu.lambda).map(|(l, v)| l - v).collect();
        let weights = jet::Weights { end: &end, a: &by_a, s: &half_lambda };
        self.jets.pull_back(model, &run.intervals, &jets, &weights, &mut by_x, gradient);
        let slope: Vec<f64> = nu.x.iter().map(|v| -v).collect();
        let weights = sample::Weights { cost: 1.0, slope: &slope, curvature: &half };
        self.samples.pull_back(at.theta, &run.data, &path.x, &weights, &mut by_x, gradient);

        // The intensities: they stand in G alone.
        let slopes = chain.noise_slopes(factor, &w);
        let of_q = &mut gradient[self.n_model + self.n_noise..];
        for (k, h) in run.gathered.iter().enumerate() {
            for (i, &state) in self.noisy.iter().enumerate() {
                let (lambda, along) = (path.lambda[k * n + state], nu.lambda[k * n + state]);
                let (e, moved) = (path.e[k * m + i], nu.e[k * m + i]);
                of_q[i] += h.sqrt() * (lambda * e + slopes[k * m + i] - moved * lambda - along * e);
            }
        }
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
            let (information, _) = self.border(&at, &found);
            sum.iter_mut().zip(information).for_each(|(s, v)| *s += v);
        }
        Ok(sum)
    }

    fn border(&self, at: &At<'_>, found: &Found) -> (Vec<f64>, Vec<f64>) {
        let (n, p) = (self.n(), self.n_model);
        let columns = n + p;
        let x = &found.path.x;
        let linear = self.flow.linearise(at.theta_model(), &at.run.intervals, x, None, true);
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
        found.chain.border(&found.factor, &linear.b, &cross, &own, p)
    }

    /// States, outputs and innovations of each record at given parameters.
    ///
    /// # Errors
    /// As [`Filter::evaluate`].
    pub fn smooth(&self, theta: &[f64], path: &[f64]) -> Result<Vec<Smoothed>, Lost> {
        let n = self.n();
        let mut out = Vec::new();
        for (run, start) in self.runs.iter().zip(self.paths(path)) {
            let at = self.at(theta, run);
            let found = at.path(start)?;
            let x = &found.path.x;
            let w = found.chain.covariances(&found.factor);
            let column = |i: usize| x.iter().skip(i).step_by(n).copied().collect();
            let deviation = |i: usize| w.iter().skip(i * n + i).step_by(n * n).map(|v| v.sqrt()).collect();
            out.push(Smoothed {
                states: (0..n).map(column).collect(),
                deviations: (0..n).map(deviation).collect(),
                outputs: self.samples.outputs(at.theta_model(), &run.data, self.n_data, x),
                innovations: innovations::innovations(&at, &found),
                first_covariance: w[..n * n].to_vec(),
                first_follows: self.border(&at, &found).1,
            });
        }
        Ok(out)
    }
}

impl Settings {
    fn noisy(&self, states: &[String]) -> Result<Vec<usize>, Error> {
        let fail = |text: String| Err(Error::Option(format!("FilterError: {text}")));
        if self.states.is_empty() {
            return fail("states names no state; name those that process noise drives".into());
        }
        if self.substeps == 0 {
            return fail("substeps is at least 1".into());
        }
        if self.initial.len() != states.len() {
            return fail(format!("initial holds {} states, the model {}", self.initial.len(), states.len()));
        }
        let mut found = Vec::new();
        for name in &self.states {
            let Some(i) = states.iter().position(|s| s == name) else {
                let hint = crate::error::did_you_mean(name, states.iter().map(String::as_str));
                return fail(format!("'{name}' is not a state.{hint}"));
            };
            if found.contains(&i) {
                return fail(format!("state '{name}' is named twice"));
            }
            found.push(i);
        }
        for (name, prior) in states.iter().zip(&self.initial) {
            let sound = |&(mean, std): &(f64, f64)| mean.is_finite() && std > 0.0;
            if prior.is_some() && !prior.as_ref().is_some_and(sound) {
                return fail(format!("initial '{name}' is not a mean and a positive standard deviation"));
            }
        }
        Ok(found)
    }
}
