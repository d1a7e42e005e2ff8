//! An earlier fit as the start of an estimation.

use super::fit::Fit;
use super::transcription::Transcription;

/// What is known of an earlier fit, of this model or of a similar one: by name, as far as both have the same names.
#[derive(Clone, Debug, Default)]
pub struct Earlier {
    /// Parameters and standard deviations.
    pub values: Vec<(String, f64)>,
    /// Paths of states, one an experiment.
    pub paths: Vec<Path>,
    /// Where the solver ended.
    pub multipliers: Option<Multipliers>,
    /// Whether values and paths are those of a fit, so that there is no need to look elsewhere.
    pub near: bool,
}

/// Paths of the states in one experiment.
#[derive(Clone, Debug, Default)]
pub struct Path {
    /// Times, s.
    pub t: Vec<f64>,
    /// States by name, each of one value a time.
    pub states: Vec<(String, Vec<f64>)>,
}

/// Multipliers of a problem, which serve again where a problem has the same size.
#[derive(Clone, Debug)]
pub struct Multipliers {
    /// Number of variables.
    pub n: usize,
    /// Those of the constraints.
    pub constraints: Vec<f64>,
    /// Those of lower and upper bounds, from a solver that has them.
    pub bounds: Option<(Vec<f64>, Vec<f64>)>,
    /// Whether the problem was one of shooting.
    pub shooting: bool,
}

impl Earlier {
    /// The value of a parameter or standard deviation.
    pub fn value(&self, name: &str) -> Option<f64> {
        self.values.iter().find(|v| v.0 == name).map(|v| v.1)
    }

    /// Times and values of a state in an experiment.
    pub fn path(&self, experiment: usize, name: &str) -> Option<(&[f64], &[f64])> {
        let path = self.paths.get(experiment)?;
        path.states.iter().find(|s| s.0 == name).map(|s| (&path.t[..], &s.1[..]))
    }
}

impl From<&Fit> for Earlier {
    fn from(fit: &Fit) -> Self {
        let paths = fit.records.iter().map(|r| Path {
            t: r.mesh_t.clone(),
            states: fit
                .model
                .states
                .iter()
                .map(|s| s.name.clone())
                .zip(r.mesh_states.iter().cloned())
                .collect(),
        });
        Earlier {
            values: fit.parameters.iter().map(|e| (e.name.clone(), e.value)).collect(),
            paths: paths.collect(),
            multipliers: Some(Multipliers {
                n: fit.solution.xi.len(),
                constraints: fit.solution.multipliers.clone(),
                bounds: fit.solution.bound_multipliers.clone(),
                shooting: matches!(fit.transcription, Transcription::Shooting(_)),
            }),
            near: true,
        }
    }
}
