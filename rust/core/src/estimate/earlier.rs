//! An earlier fit as the start of an estimation.

use super::fit::Fit;
use super::transcription::Transcription;
use crate::experiment::Experiment;
use crate::mesh::Grid;
use crate::model::Kink;

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
    /// How its kinks were smoothed.
    pub smoothed: Option<Smoothed>,
}

/// How the kinks of an earlier fit were smoothed in its last pass: a model with the same kinks has no need of wider ones first.
#[derive(Clone, Debug)]
pub struct Smoothed {
    /// Kinks in words, and widths.
    pub widths: Vec<(String, f64)>,
    /// Points of a segment.
    pub order: usize,
    /// Ends of the segments of the mesh, for each experiment, s.
    pub edges: Vec<Vec<f64>>,
    /// What smoothing left in error, by parameter.
    pub left: Vec<(String, f64)>,
}

impl Smoothed {
    /// Returns the widths of a model's kinks; None where it has others, or two that have the same words.
    pub(super) fn widths_of(&self, kinks: &[Kink]) -> Option<Vec<f64>> {
        let labels: Vec<String> = kinks.iter().map(Kink::label).collect();
        let width = |label: &String| {
            let same = labels.iter().filter(|l| *l == label).count();
            self.widths.iter().find(|w| w.0 == *label).filter(|_| same == 1).map(|w| w.1)
        };
        labels.iter().map(width).collect()
    }

    /// Returns whether the mesh is one of these experiments.
    pub(super) fn is_of(&self, experiments: &[Experiment]) -> bool {
        let same = |(e, edges): (&Experiment, &Vec<f64>)| {
            let (Some(first), Some(last)) = (edges.first(), edges.last()) else { return false };
            *first == e.t[0] && *last == e.t[e.t.len() - 1]
        };
        self.edges.len() == experiments.len() && experiments.iter().zip(&self.edges).all(same)
    }
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
            smoothed: fit.smoothed(),
        }
    }
}

impl Fit {
    /// Returns how kinks were smoothed, for a fit that goes on from this one.
    fn smoothed(&self) -> Option<Smoothed> {
        let (smoothing, Transcription::Collocation(mesh)) = (self.smoothing.as_ref()?, &self.transcription)
        else {
            return None;
        };
        let edges = mesh.grid.iter().map(|grid| match grid {
            Grid::Edges(edges) => Some(edges.clone()),
            Grid::Samples(_) | Grid::Uniform(_) => None,
        });
        Some(Smoothed {
            widths: smoothing.widths.iter().map(|w| (w.kink.clone(), w.width)).collect(),
            order: mesh.order,
            edges: edges.collect::<Option<_>>()?,
            left: smoothing.left.iter().map(|l| (l.name.clone(), l.change)).collect(),
        })
    }
}
