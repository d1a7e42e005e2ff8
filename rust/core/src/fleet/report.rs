//! Shared parameters in the user's terms.

use crate::collocation::Collocation;
use crate::estimate::{Bound, Estimate, noise_covariance};
use crate::index::VariableId;
use crate::model::Model;
use crate::nlp::Nlp;
use crate::problem::Transcribed;

/// Values of the variables that records share, in the problem of one of them.
pub(super) struct Report<'a> {
    pub model: &'a Model,
    pub problem: &'a Collocation,
    pub shared: &'a [VariableId],
    pub at: &'a [f64],
}

impl Report<'_> {
    /// Estimates and their covariance, row-major, from that of the variables.
    pub fn with(&self, covariance: &[f64]) -> (Vec<Estimate>, Vec<f64>) {
        let Report { model, problem, shared, at } = self;
        let posed = problem.posed();
        let (n_model, n_theta) = (posed.n_model_parameters, problem.layout().n_theta);
        let mut xi = vec![0.0; problem.n()];
        posed.parameters.numbered().for_each(|(i, p)| xi[i.0] = p.start);
        shared.iter().zip(*at).for_each(|(i, at)| xi[i.0] = *at);
        let slope = |i: VariableId| posed.estimands.transforms.get(i).map_or(1.0, |t| t.slope(xi[i.0]));
        // With the records' own parameters between, whose entries stay undefined.
        let k = shared.len();
        let mut whole = vec![f64::NAN; n_theta * n_theta];
        for (a, &i) in shared.iter().enumerate() {
            for (b, &j) in shared.iter().enumerate() {
                whole[i.0 * n_theta + j.0] = covariance[a * k + b] * slope(i) * slope(j);
            }
        }
        let noise_is_shared = shared.iter().any(|i| i.0 >= n_model);
        let reported = if noise_is_shared { posed.noise_report(&xi) } else { Vec::new() };
        noise_covariance(&reported, n_model, n_theta, &mut whole);
        let (lower, upper) = problem.bounds();
        let estimate = |&i: &VariableId| {
            let error = whole[i.0 * n_theta + i.0].sqrt();
            if i.0 >= n_model {
                let r = &reported[i.0 - n_model];
                let unit = r.output.map_or_else(String::new, |c| model.outputs[c].unit.clone());
                return Estimate {
                    name: r.name.clone(),
                    unit,
                    value: r.value,
                    std_error: error,
                    bounds: r.bounds,
                    bound: None,
                };
            }
            let p = &posed.parameters[i];
            let x = xi[i.0];
            let bound = match (lower[i.0], upper[i.0]) {
                (low, high) if low == high => Some(Bound::Fixed),
                (low, _) if x <= low => Some(Bound::Lower),
                (_, high) if x >= high => Some(Bound::Upper),
                _ => None,
            };
            Estimate {
                name: p.name.clone(),
                unit: p.unit.clone(),
                value: posed.estimands.value(i, &xi),
                std_error: if bound.is_some() { f64::NAN } else { error },
                bounds: (p.lower.unwrap_or(f64::NEG_INFINITY), p.upper.unwrap_or(f64::INFINITY)),
                bound,
            }
        };
        let estimates = shared.iter().map(estimate).collect();
        let pairs = shared.iter().flat_map(|i| shared.iter().map(move |j| i.0 * n_theta + j.0));
        (estimates, pairs.map(|entry| whole[entry]).collect())
    }
}
