//! What a run hands over.

use std::time::Duration;

use super::iteration::Iteration;
use super::point::Point;
use super::program::Evaluations;
use super::program::Program;
use super::status::Status;
use super::units::Units;
use crate::interrupt::current;
use crate::linalg::KktChoice;
use crate::nlp::Nlp;

/// Where a run ended.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Solution {
    /// Variables.
    pub xi: Vec<f64>,
    /// Multipliers of the constraints.
    pub multipliers: Vec<f64>,
    /// Multipliers of lower and upper bounds, of a solver that keeps away from bounds, as an interior-point method does.
    pub bound_multipliers: Option<(Vec<f64>, Vec<f64>)>,
    /// How it ended.
    pub status: Status,
    /// The status's hint, with names.
    pub message: String,
    /// φ there.
    pub objective: f64,
    /// Largest defect in units of its state.
    pub defect: f64,
    /// Number of iterations.
    pub iterations: usize,
    /// How often what was evaluated.
    pub evaluations: Evaluations,
    /// Counted floating-point operations of one factorisation.
    pub flops: u64,
    /// Time spent.
    pub time: Duration,
    /// Units of the states.
    pub units: Vec<f64>,
    /// The table.
    pub history: Vec<Iteration>,
    /// The factorisation of Newton systems, for the covariance as well.
    pub kkt: KktChoice,
}

impl Solution {
    /// A point with its multipliers, as a solver of one's own gives it; what else there is to say is put into the fields.
    pub fn new(xi: Vec<f64>, multipliers: Vec<f64>, status: Status) -> Solution {
        Solution {
            xi,
            multipliers,
            bound_multipliers: None,
            status,
            message: status.hint().to_owned(),
            objective: f64::NAN,
            defect: f64::NAN,
            iterations: 0,
            evaluations: Evaluations::default(),
            flops: 0,
            time: Duration::ZERO,
            units: Vec::new(),
            history: Vec::new(),
            kkt: KktChoice::default(),
        }
    }

    /// The start, within bounds, of a run that was stopped before its first evaluation; `None` where it was not.
    pub(crate) fn without_a_run(
        nlp: &dyn Nlp,
        start: &[f64],
        multipliers: Option<&[f64]>,
    ) -> Option<Solution> {
        let status = Status::stopped(&current())?;
        let (lower, upper) = nlp.bounds();
        let xi = start.iter().zip(lower.iter().zip(&upper)).map(|(x, (l, u))| x.clamp(*l, *u)).collect();
        Some(Solution::stopped(nlp, xi, multipliers, status, Units::new(nlp, start).states))
    }

    /// An evaluated start, of a run that was stopped before its first step; `None` where it was not.
    pub(crate) fn before_a_step(
        program: &Program<'_>,
        point: &Point,
        multipliers: Option<&[f64]>,
    ) -> Option<Solution> {
        let status = Status::stopped(&current())?;
        let (xi, units) = (point.xi.clone(), program.units.states.clone());
        Some(Solution {
            objective: point.objective,
            defect: point.worst,
            evaluations: program.evaluations(),
            ..Solution::stopped(program.nlp, xi, multipliers, status, units)
        })
    }

    /// A point at which nothing was evaluated.
    fn stopped(
        nlp: &dyn Nlp,
        xi: Vec<f64>,
        multipliers: Option<&[f64]>,
        status: Status,
        units: Vec<f64>,
    ) -> Solution {
        let multipliers = multipliers.map_or_else(|| vec![0.0; nlp.m()], <[f64]>::to_vec);
        Solution { units, ..Solution::new(xi, multipliers, status) }
    }
}
