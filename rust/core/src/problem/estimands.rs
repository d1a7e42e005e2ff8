//! The variables that are no states: parameters, of which some have a value in each experiment.

use crate::experiment::Experiment;
use crate::model::Parameter;
use crate::transform::Transform;

/// Functions of a point see the parameters θ of the model and of the noise; the problem has a variable for
/// each, or one an experiment.
#[derive(Clone, Debug)]
pub struct Estimands {
    /// For each variable its parameter, counted as functions see them.
    pub parameter: Vec<usize>,
    /// The experiment that it belongs to; `None` for all.
    pub experiment: Vec<Option<usize>>,
    /// `maps[experiment][parameter]`: the variable.
    pub maps: Vec<Vec<usize>>,
    /// The transforms from variables to parameters.
    pub transforms: Vec<Transform>,
    any_local: bool,
}

impl Estimands {
    /// A variable for each parameter, and for local ones one an experiment; also the parameters of the
    /// variables, called `name[experiment]` where local.
    pub(crate) fn new(parameters: &[Parameter], experiments: &[Experiment]) -> (Self, Vec<Parameter>) {
        let mut found = Estimands {
            parameter: Vec::new(),
            experiment: Vec::new(),
            maps: vec![Vec::new(); experiments.len()],
            transforms: Vec::new(),
            any_local: false,
        };
        let mut expanded = Vec::new();
        for (p, parameter) in parameters.iter().enumerate() {
            let local = parameter.local && experiments.len() > 1;
            found.any_local |= local;
            for (e, experiment) in experiments.iter().enumerate() {
                if local || e == 0 {
                    let of = if local { format!("[{}]", experiment.name) } else { String::new() };
                    expanded.push(Parameter { name: parameter.name.clone() + &of, ..parameter.clone() });
                    found.parameter.push(p);
                    found.experiment.push(local.then_some(e));
                    found.transforms.push(parameter.transform);
                }
                found.maps[e].push(expanded.len() - 1);
            }
        }
        (found, expanded)
    }

    /// Whether experiments differ in parameters.
    pub fn any_local(&self) -> bool {
        self.any_local
    }

    /// θ as the functions of an experiment see it, of variables that stand first in ξ.
    pub fn theta(&self, experiment: usize, xi: &[f64], out: &mut Vec<f64>) {
        out.clear();
        out.extend(self.maps[experiment].iter().map(|&i| xi[i]));
    }

    /// The value of a parameter, from its variable.
    pub fn value(&self, variable: usize, xi: &[f64]) -> f64 {
        self.transforms[variable].value(xi[variable])
    }
}
