//! The variables that are no states: parameters, of which some have a value in each experiment.

use crate::experiment::Experiment;
use crate::index::{ExperimentId, IndexVec, ParameterId, VariableId};
use crate::model::Parameter;
use crate::transform::Transform;

/// The variable of each parameter in an experiment.
pub type ParameterMap = IndexVec<ParameterId, VariableId>;

/// Functions of a point see the parameters θ of the model and of the noise; the problem has a variable for
/// each, or one an experiment.
#[derive(Clone, Debug)]
pub struct Estimands {
    /// The parameter of each variable.
    pub parameter: IndexVec<VariableId, ParameterId>,
    /// The experiment that it belongs to; `None` for all.
    pub experiment: IndexVec<VariableId, Option<ExperimentId>>,
    /// The variable of each parameter in each experiment.
    pub maps: IndexVec<ExperimentId, ParameterMap>,
    /// The transforms from variables to parameters.
    pub transforms: IndexVec<VariableId, Transform>,
    any_local: bool,
}

impl Estimands {
    /// A variable for each parameter, and for local ones one an experiment; also the parameters of the
    /// variables, called `name[experiment]` where local.
    pub(crate) fn new(parameters: &[Parameter], experiments: &[Experiment]) -> (Self, Vec<Parameter>) {
        let mut found = Estimands {
            parameter: IndexVec::default(),
            experiment: IndexVec::default(),
            maps: experiments.iter().map(|_| ParameterMap::default()).collect(),
            transforms: IndexVec::default(),
            any_local: false,
        };
        let mut expanded = Vec::new();
        for (p, parameter) in parameters.iter().enumerate() {
            let local = parameter.local && experiments.len() > 1;
            found.any_local |= local;
            for (e, experiment) in experiments.iter().enumerate().map(|(e, x)| (ExperimentId(e), x)) {
                if local || e == ExperimentId(0) {
                    let of = if local { format!("[{}]", experiment.name) } else { String::new() };
                    expanded.push(Parameter { name: parameter.name.clone() + &of, ..parameter.clone() });
                    found.parameter.push(ParameterId(p));
                    found.experiment.push(local.then_some(e));
                    found.transforms.push(parameter.transform);
                }
                found.maps[e].push(VariableId(expanded.len() - 1));
            }
        }
        (found, expanded)
    }

    /// Whether experiments differ in parameters.
    pub fn any_local(&self) -> bool {
        self.any_local
    }

    /// θ as the functions of an experiment see it, of variables that stand first in ξ.
    pub fn theta(&self, experiment: ExperimentId, xi: &[f64], out: &mut Vec<f64>) {
        out.clear();
        out.extend(self.maps[experiment].iter().map(|&i| xi[i]));
    }

    /// The value of a parameter, from its variable.
    pub fn value(&self, variable: VariableId, xi: &[f64]) -> f64 {
        self.transforms[variable].value(xi[variable])
    }
}
