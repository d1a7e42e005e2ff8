//! The records of one worker, and sums over them.

use super::record::{Detail, Evaluated, Failure, Kept, Paths, RecordResult, evaluate};
use super::report::Report;
use super::workshop::Workshop;
use crate::collocation::Settings;
use crate::error::Error;
use crate::estimate::{Estimate, Given, Start, resolved, spread};
use crate::experiment::Experiment;
use crate::index::VariableId;
use crate::interrupt::{Interrupt, current};
use crate::model::{Model, Parameter};
use crate::nlp::Nlp;
use crate::noise::NoiseModel;
use crate::problem::Transcribed;
use crate::threads::Threads;
use crate::threads::prelude::*;
use crate::transform::Transform;

/// A variable that all records share: a parameter of the model or of the noise, as the solver sees it.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct SharedVariable {
    /// Name: `Cmq`, `log k` where a transform was asked for, `1/sigma_q` for a standard deviation.
    pub name: String,
    /// Where it starts.
    pub start: f64,
    /// Lower and upper bound; equal where it is fixed.
    pub bounds: (f64, f64),
}

/// Sums over records at a trial.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Sums {
    /// Σ V_e, minus the log-likelihood and the logarithms of the priors of the records' own parameters.
    pub value: f64,
    /// Its gradient with respect to the shared variables.
    pub gradient: Vec<f64>,
    /// Its Hessian, row-major.
    pub hessian: Vec<f64>,
    /// Records in the sums.
    pub records: usize,
    /// Their samples.
    pub samples: usize,
    /// Factorisations that it took.
    pub factorizations: usize,
    /// Records that are not in the sums.
    pub failures: Vec<Failure>,
    /// Of each record in the sums, where they were asked for.
    pub results: Vec<RecordResult>,
}

/// What one worker has of an estimation: model, noise, and of each record the path of its states at the last trial.
pub struct Share {
    model: Model,
    noise: NoiseModel,
    settings: Settings,
    spreads: Option<Vec<f64>>,
    threads: Threads,
    /// The model's parameters with their priors.
    declared: Vec<Parameter>,
    /// Whether priors of shared parameters are counted here.
    counts_priors: bool,
    workshop: Option<Workshop>,
    variables: Vec<SharedVariable>,
    priors: Vec<Prior>,
    paths: Paths,
}

/// The prior of a shared parameter: mean and standard deviation of its value.
struct Prior {
    variable: usize,
    prior: (f64, f64),
    transform: Transform,
}

impl Share {
    /// Of a model, whose parameters are shared but those of each record its own, and of the noise.
    ///
    /// # Errors
    /// When the model is incomplete.
    pub fn new(model: &Model, noise: &NoiseModel) -> Result<Self, Error> {
        model.check()?;
        // Priors of shared parameters count once, not once a record: they are for whoever adds up.
        let without = |p: &Parameter| Parameter { prior: p.prior.filter(|_| p.local), ..p.clone() };
        let parameters = model.parameters.iter().map(without).collect();
        Ok(Share {
            model: Model { parameters, ..model.clone() },
            noise: noise.clone(),
            settings: Settings::default().threads(1),
            spreads: None,
            threads: Threads::new(0)?,
            counts_priors: false,
            declared: model.parameters.clone(),
            workshop: None,
            variables: Vec::new(),
            priors: Vec::new(),
            paths: Paths::new(),
        })
    }

    /// The transcription of each record; its threads evaluate records side by side.
    ///
    /// # Errors
    /// When there are no such threads.
    pub fn transcription(mut self, settings: Settings) -> Result<Self, Error> {
        self.threads = Threads::new(settings.threads)?;
        self.settings = settings.threads(1);
        Ok(self)
    }

    /// Standard deviations of the measurements of each output, in all records or in a part of them: unknown noise starts there
    /// and has its bounds from there. Those of the first record, unless said.
    pub fn spreads(mut self, spreads: Vec<f64>) -> Self {
        self.spreads = Some(spreads);
        self
    }

    /// Whether the sums contain the priors of shared parameters, which count once, and not once a record or a share. They do
    /// not, unless said.
    pub fn priors(mut self, count: bool) -> Self {
        self.counts_priors = count;
        self
    }

    /// The variables that the records share, which start as declared or at values given by name. Prepares for evaluations.
    ///
    /// # Errors
    /// When the record does not fit the model, or a start is none.
    pub fn variables(
        &mut self,
        record: &Experiment,
        start: &[(String, Start)],
    ) -> Result<Vec<SharedVariable>, Error> {
        let outputs: Vec<&str> = self.model.outputs.iter().map(|o| o.name.as_str()).collect();
        let spreads = match &self.spreads {
            Some(spreads) => spreads.clone(),
            None => record.outputs.iter().map(|z| spread(&[z])).collect(),
        };
        let given = Given { model: &self.model, values: start, earlier: None };
        let noise = resolved(&self.noise, &outputs, &spreads, &given)?;
        let values = given.parameters(None)?;
        let mut model = self.model.clone();
        model.parameters.iter_mut().zip(values).for_each(|(p, value)| p.start = value);
        let of_states =
            start.iter().filter(|s| model.states.iter().any(|x| x.name == s.0)).cloned().collect();
        let workshop = Workshop::new(model, (self.noise.clone(), noise), self.settings.clone(), of_states);
        let problem = workshop.take(record)?.problem;
        let (lower, upper) = problem.bounds();
        let variable = |&i| {
            let posed = problem.posed();
            let p = &posed.parameters[i];
            let is_noise = i.0 >= posed.n_model_parameters;
            let start = if is_noise { p.start } else { posed.estimands.transforms[i].inverse(p.start) };
            SharedVariable { name: posed.parameter_name(i), start, bounds: (lower[i.0], upper[i.0]) }
        };
        let shared = workshop.shared(&problem);
        self.variables = shared.iter().map(variable).collect();
        let with_prior = |(k, &i): (usize, &VariableId)| {
            let posed = problem.posed();
            let prior = self.declared.get(posed.estimands.parameter[i].0)?.prior?;
            (self.counts_priors).then(|| Prior {
                variable: k,
                prior,
                transform: posed.estimands.transforms[i],
            })
        };
        self.priors = shared.iter().enumerate().filter_map(with_prior).collect();
        self.workshop = Some(workshop);
        Ok(self.variables.clone())
    }

    /// Sums over records with the shared variables at these values. A record is known by its name: its path at the last trial
    /// is where it starts.
    ///
    /// # Panics
    /// Before [`Share::variables`], and for another number of values.
    pub fn evaluate(&mut self, records: &[Experiment], at: &[f64]) -> Sums {
        self.evaluate_with(records, at, Detail::default())
    }

    /// The same with more detail.
    ///
    /// # Panics
    /// As [`Share::evaluate`].
    pub fn evaluate_with(&mut self, records: &[Experiment], at: &[f64], detail: Detail) -> Sums {
        let workshop = self.workshop.as_ref().expect("`variables` comes first");
        assert_eq!(at.len(), self.variables.len(), "one value for each shared variable");
        let paths: Vec<Option<&Kept>> = records.iter().map(|r| self.paths.get(&r.name)).collect();
        let interrupt: Interrupt = current();
        let one = |(record, kept): (&Experiment, &Option<&Kept>)| {
            interrupt.run(|| evaluate(workshop, record, at, *kept, detail))
        };
        let found: Vec<Result<Evaluated, Failure>> =
            self.threads.install(|| records.par_iter().zip(&paths).map(one).collect());
        let k = at.len();
        let mut sums = Sums {
            value: 0.0,
            gradient: vec![0.0; k],
            hessian: vec![0.0; k * k],
            records: 0,
            samples: 0,
            factorizations: 0,
            failures: Vec::new(),
            results: Vec::new(),
        };
        for Prior { variable: i, prior: (mean, std), transform } in &self.priors {
            let [e, slope, bend] =
                [transform.value(at[*i]) - mean, transform.slope(at[*i]), transform.bend(at[*i])]
                    .map(|v| v / std);
            sums.value += 0.5 * e * e;
            sums.gradient[*i] += e * slope;
            sums.hessian[i * k + i] += slope * slope + e * bend;
        }
        // In the order of records, so that sums do not depend on threads.
        for (record, found) in records.iter().zip(found) {
            match found {
                Ok(Evaluated { schur, kept, factorizations, result }) => {
                    sums.value += schur.value;
                    sums.gradient.iter_mut().zip(schur.gradient).for_each(|(sum, g)| *sum += g);
                    sums.hessian.iter_mut().zip(schur.hessian).for_each(|(sum, h)| *sum += h);
                    sums.records += 1;
                    sums.samples += record.t.len();
                    sums.factorizations += factorizations;
                    sums.results.extend(result);
                    self.paths.insert(record.name.clone(), kept);
                }
                Err(failure) => sums.failures.push(failure),
            }
        }
        sums
    }

    /// Sets the prior of a parameter that each record has of its own, which is declared with one: mean and standard deviation of
    /// the population that the records' values are drawn from.
    ///
    /// # Errors
    /// For a name that is not that of such a parameter.
    ///
    /// # Panics
    /// Before [`Share::variables`].
    pub fn population(&mut self, name: &str, mean: f64, std: f64) -> Result<(), Error> {
        let declared = self.declared.iter().find(|p| p.name == name);
        if declared.is_none_or(|p| !p.local || p.prior.is_none()) {
            return Err(Error::model(format!(
                "population: '{name}' is not a parameter of each record's own that is declared with a prior"
            )));
        }
        let priors = &mut self.workshop.as_mut().expect("`variables` comes first").own_priors;
        priors.retain(|(other, _)| other != name);
        priors.push((name.to_owned(), (mean, std)));
        Ok(())
    }

    /// Bytes that the paths take.
    pub fn bytes(&self) -> usize {
        self.paths.values().map(Kept::bytes).sum()
    }

    /// The shared parameters and their covariance in the user's terms, row-major, from values and covariance of the variables.
    ///
    /// # Errors
    /// When the record does not fit the model.
    ///
    /// # Panics
    /// As [`Share::evaluate`].
    pub fn report(
        &self,
        record: &Experiment,
        at: &[f64],
        covariance: &[f64],
    ) -> Result<(Vec<Estimate>, Vec<f64>), Error> {
        let workshop = self.workshop.as_ref().expect("`variables` comes first");
        let problem = workshop.take(record)?.problem;
        let shared = workshop.shared(&problem);
        Ok(Report { model: &self.model, problem: &problem, shared: &shared, at }.with(covariance))
    }
}
