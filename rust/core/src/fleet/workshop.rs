//! What the evaluation of one record leaves to that of the next: compiled functions, and plans of elimination.

use std::sync::{Arc, Mutex, PoisonError};

use crate::collocation::{Collocation, Settings};
use crate::diagnosis::information;
use crate::error::Error;
use crate::estimate::{Estimation, Given, Start, point};
use crate::experiment::Experiment;
use crate::index::VariableId;
use crate::linalg::{KktChoice, KktSolver};
use crate::model::Model;
use crate::nlp::Nlp;
use crate::noise::{Noise, NoiseModel};
use crate::problem::Transcribed;
use crate::solver::Solution;

/// Most sets of functions, which differ in the outputs of which samples are missing, and most factorisations that are kept.
const MOST: usize = 16;

/// A factorisation and the problem that it was planned for.
struct Planned {
    of: Arc<Collocation>,
    kkt: Box<dyn KktSolver>,
}

/// A problem, and the factorisation of its Newton systems.
pub(super) struct Tools {
    pub problem: Arc<Collocation>,
    pub kkt: KktChoice,
}

/// Makes the problems of records. To compile a model takes as long as several iterations, and to plan an elimination as
/// long as two, so both serve all records to which they apply.
pub(super) struct Workshop {
    pub model: Model,
    noise_model: NoiseModel,
    noise: Noise,
    settings: Settings,
    start: Vec<(String, Start)>,
    /// Priors of parameters that each record has of its own, by name: mean and standard deviation.
    pub own_priors: Vec<(String, (f64, f64))>,
    functions: Mutex<Vec<Arc<Collocation>>>,
    planned: Mutex<Vec<Planned>>,
}

impl Workshop {
    pub fn new(
        model: Model,
        (noise_model, noise): (NoiseModel, Noise),
        settings: Settings,
        start: Vec<(String, Start)>,
    ) -> Self {
        let settings = Settings { noise_per_experiment: noise_model.per_experiment, ..settings };
        let (functions, planned) = (Mutex::default(), Mutex::default());
        let own_priors = Vec::new();
        Workshop { model, noise_model, noise, settings, start, own_priors, functions, planned }
    }

    /// Makes the problem of a record.
    pub fn take(&self, experiment: &Experiment) -> Result<Tools, Error> {
        let mut problem = self.problem(experiment)?;
        for i in (0..problem.posed.n_model_parameters).map(VariableId) {
            let p = &mut problem.posed.parameters[i];
            if let Some((_, prior)) = self.own_priors.iter().find(|(name, _)| *name == p.name) {
                p.prior = Some(*prior);
            }
        }
        let problem = Arc::new(problem);
        let mut planned = self.planned.lock().unwrap_or_else(PoisonError::into_inner);
        let same = planned.iter().position(|p| of_one_structure(&p.of, &problem));
        let kkt = match same.map(|k| planned.swap_remove(k).kkt) {
            Some(kkt) => KktChoice::default().with_made(kkt),
            None => KktChoice::default(),
        };
        Ok(Tools { problem, kkt })
    }

    /// Takes back the factorisation of a problem.
    pub fn put_back(&self, of: Arc<Collocation>, kkt: Box<dyn KktSolver>) {
        let mut planned = self.planned.lock().unwrap_or_else(PoisonError::into_inner);
        if planned.len() == MOST {
            planned.remove(0);
        }
        planned.push(Planned { of, kkt });
    }

    fn problem(&self, experiment: &Experiment) -> Result<Collocation, Error> {
        let known = self.functions.lock().unwrap_or_else(PoisonError::into_inner).clone();
        for of in &known {
            if let Some(problem) = of.of_another(experiment, &self.settings)? {
                return Ok(problem);
            }
        }
        let one = std::slice::from_ref(experiment);
        let make = || Collocation::new(&self.model, one, self.noise.clone(), &self.settings);
        let problem = make()?;
        let mut functions = self.functions.lock().unwrap_or_else(PoisonError::into_inner);
        if functions.len() < MOST {
            functions.push(Arc::new(make()?));
        }
        Ok(problem)
    }

    /// The variables that all records share: parameters of the model and of the noise.
    pub fn shared(&self, problem: &Collocation) -> Vec<VariableId> {
        let posed = problem.posed();
        let of_model = posed.n_model_parameters;
        let is_shared = |&i: &VariableId| match i.0 < of_model {
            true => !posed.parameters[i].local,
            false => !self.noise_model.per_experiment,
        };
        posed.parameters.numbered().map(|(i, _)| i).filter(is_shared).collect()
    }

    /// The parameters of the model that each record has of its own.
    pub fn own(&self, problem: &Collocation) -> Vec<VariableId> {
        let posed = problem.posed();
        let of_model = posed.parameters.numbered().take(posed.n_model_parameters);
        of_model.filter(|(_, p)| p.local).map(|(i, _)| i).collect()
    }

    /// The parameters of the model as they are with the shared variables at `at`, others as declared.
    fn parameters(&self, problem: &Collocation, at: &[f64]) -> Vec<f64> {
        let posed = problem.posed();
        let mut values: Vec<f64> = self.model.parameters.iter().map(|p| p.start).collect();
        let shared = self.shared(problem);
        for (&i, at) in shared.iter().zip(at).filter(|(i, _)| i.0 < posed.n_model_parameters) {
            values[posed.estimands.parameter[i].0] = posed.estimands.transforms[i].value(*at);
        }
        values
    }

    /// Where a record of which nothing is known starts: states as measured, else as declared.
    pub fn start(
        &self,
        problem: &Collocation,
        experiment: &Experiment,
        at: &[f64],
    ) -> Result<Vec<f64>, Error> {
        let given = Given { model: &self.model, values: &self.start, earlier: None };
        let values = self.parameters(problem, at);
        let own = [values.clone()];
        point(problem, &values, &own, |_, times| given.states(0, experiment, times, &values))
    }

    /// Where an estimation of the record's own parameters by all ways that there are ends, the shared parameters of the model
    /// fixed; `None` where it finds no path.
    pub fn start_by_estimation(
        &self,
        problem: &Collocation,
        experiment: &Experiment,
        at: &[f64],
    ) -> Option<Vec<f64>> {
        let mut model = self.model.clone();
        let values = self.parameters(problem, at);
        for (p, value) in model.parameters.iter_mut().zip(values).filter(|(p, _)| !p.local) {
            (p.start, p.fixed, p.lower, p.upper) = (value, true, None, None);
        }
        let one = std::slice::from_ref(experiment);
        let estimation = Estimation::new(&model, one)
            .transcription(self.settings.clone())
            .noise_model(self.noise_model.clone())
            .moving_mesh(false);
        let found = estimation.solve().ok()?.solution;
        (found.xi.len() == problem.n()).then_some(found.xi)
    }

    /// Standard errors of the record's own parameters at a solution, the shared ones taken as known.
    pub fn own_errors(&self, problem: &Collocation, solution: &Solution) -> Vec<f64> {
        let (own, shared) = (self.own(problem), self.shared(problem));
        let k = own.len();
        if k == 0 {
            return Vec::new();
        }
        let (xi, lambda) = (&solution.xi, &solution.multipliers);
        match information(problem, xi, lambda, &own, &shared, &solution.kkt) {
            Ok(found) => {
                let slope = |i: VariableId| problem.posed().estimands.transforms[i].slope(xi[i.0]).abs();
                let error = |(a, &i): (usize, &VariableId)| found.covariance[a * k + a].sqrt() * slope(i);
                own.iter().enumerate().map(error).collect()
            }
            Err(_) => vec![f64::NAN; k],
        }
    }
}

/// Whether a factorisation that was planned for a problem serves another.
fn of_one_structure(a: &Collocation, b: &Collocation) -> bool {
    (a.n(), a.m()) == (b.n(), b.m())
        && a.hessian_structure() == b.hessian_structure()
        && a.jacobian_structure() == b.jacobian_structure()
}
