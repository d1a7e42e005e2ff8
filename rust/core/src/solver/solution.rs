//! What a run hands over.

use std::time::Duration;

use super::Run;
use super::iteration::Iteration;
use super::point::Evaluations;
use super::status::Status;

/// Where a run ended.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Variables.
    pub xi: Vec<f64>,
    /// Multipliers of the constraints.
    pub multipliers: Vec<f64>,
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
}

impl Run<'_> {
    /// The point to end at, and what is to be told of it.
    pub(super) fn finish(mut self, status: Status) -> Solution {
        if status.unfinished() || status == Status::Acceptable {
            // The best point so far, not the last that was tried on trust.
            self.go_back_if_better();
        }
        let mut message = status.hint().to_owned();
        if matches!(status, Status::Infeasible | Status::Failed) && self.detail.is_empty() {
            self.detail = self.worst_defect();
        }
        if !self.detail.is_empty() {
            message = format!("{message} ({})", self.detail);
        }
        Solution {
            iterations: self.history.last().map_or(0, |l| l.number),
            flops: self.kkt.flops(),
            xi: self.here.xi,
            multipliers: self.lambda,
            status,
            message,
            objective: self.here.objective,
            defect: self.here.worst,
            evaluations: self.count,
            time: self.began.elapsed(),
            units: self.units.states,
            history: self.history,
        }
    }

    fn worst_defect(&self) -> String {
        let worst = self.here.c.iter().zip(self.units.each()).map(|(c, u)| c.abs() / u).enumerate();
        let Some((i, _)) = worst.max_by(|a, b| a.1.total_cmp(&b.1)) else { return String::new() };
        format!("the largest is the {}: {:.2e}", self.nlp.constraint_name(i), self.here.c[i])
    }
}
