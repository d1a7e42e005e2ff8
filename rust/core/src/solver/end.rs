//! Where a run ends: at an optimum, in a valley, far out, or where no step helps.

use super::iteration::Iteration;
use super::status::Status;
use super::step::{GREATEST_SHIFT, Promise, rounded};
use super::{DAMPED, Run};

/// Multiple of its size at which an unknown has grown without limit.
const ENDLESS: f64 = 1e15;
/// An end that meets this instead of the tolerance is acceptable, again a distance in standard errors.
const CLOSE: f64 = 1e-3;
/// Steps that need damping, among so many, and together gain less than this in log-likelihood: a valley without
/// an end in sight.
const VALLEY: (usize, usize, f64) = (10, 40, 0.1);

impl Run<'_> {
    /// Whether a parameter has grown without limit.
    pub(super) fn grown(&mut self) -> bool {
        let border = self.nlp.chains().map_or(self.here.xi.len(), |c| c.border);
        let own = self.nlp.profiled();
        // What has had no influence yet has not moved either.
        let size =
            |i: usize| self.sizes.get(i).map_or(1.0, |size| if *size > 0.0 { *size } else { f64::INFINITY });
        let far = (0..border).find(|&i| !own.contains(&i) && self.here.xi[i].abs() > ENDLESS * size(i));
        if let Some(i) = far {
            self.detail = format!("{} = {:.1e}", self.nlp.variable_name(i), self.here.xi[i]);
        }
        far.is_some()
    }

    pub(super) fn take_last_step(&mut self) {
        self.trial.step(&self.here.xi, 1.0, &self.d, &self.bounds);
        if self.trial.evaluate(self.nlp, &self.units, &mut self.count).is_ok()
            && self.trial.objective <= self.here.objective + 1e-6
        {
            self.here.copy(&self.trial);
            self.lambda.copy_from_slice(&self.next_lambda);
        }
    }

    /// Nothing is left to gain: is it an optimum?
    pub(super) fn verdict(&mut self) -> Status {
        if self.shift > 0.0 {
            let found = self.kkt.finish(self.active.held(), 0.0);
            if !found.is_positive() {
                self.detail = self.weak_names();
                // Curvature that rounding alone makes negative is none.
                let ridge = found.negative > 0 && !rounded(self.shift);
                return if ridge { Status::Failed } else { Status::Unidentifiable };
            }
        }
        Status::Converged
    }

    /// Whether steps have become short because the likelihood hardly tells where to go.
    pub(super) fn crawls(&self) -> bool {
        // Steps on trust may come between.
        let (count, among, least) = VALLEY;
        let damped = |line: &Iteration| line.shift > DAMPED && line.step > 0.0;
        let mut recent = self.history.iter().enumerate().rev().take(among).filter(|(_, line)| damped(line));
        let before = recent.nth(count - 1).and_then(|(first, _)| first.checked_sub(1));
        before.is_some_and(|k| (self.history[k].objective - self.here.objective).abs() < least)
    }

    /// Names of the parameters that the step changes most.
    pub(super) fn farthest_names(&self) -> String {
        let border = self.nlp.chains().map_or(0, |c| c.border);
        let size = |i: usize| self.here.xi[i].abs().max(1e-3 * self.sizes[i]).max(f64::MIN_POSITIVE);
        let part = |i: &usize| self.d[*i].abs() / size(*i);
        let mut order: Vec<usize> = (0..border).collect();
        order.sort_by(|a, b| part(b).total_cmp(&part(a)));
        let names: Vec<String> = order.iter().take(6).map(|&i| self.nlp.variable_name(i)).collect();
        format!("the data hardly determine {}", names.join(", "))
    }

    /// Names of the variables in directions without curvature.
    fn weak_names(&self) -> String {
        let name = |direction: &Vec<(usize, f64)>| {
            let most = direction.first().map_or(0.0, |x| x.1.abs());
            let mut part: Vec<usize> =
                direction.iter().filter(|x| x.1.abs() > 0.1 * most).map(|x| x.0).collect();
            part.sort_unstable();
            part.iter().take(6).map(|&i| self.nlp.variable_name(i)).collect::<Vec<_>>().join(", ")
        };
        self.kkt.weak_directions().iter().map(name).collect::<Vec<_>>().join("; ")
    }

    /// No step helped: try a shorter, safer direction; give up when these are spent.
    pub(super) fn stuck(&mut self, promise: &Promise) -> Option<Status> {
        if promise.gain <= CLOSE.powi(2) + promise.floor {
            return Some(if self.shift == 0.0 { Status::Acceptable } else { self.verdict() });
        }
        if self.near && self.settings.gauss_newton {
            self.near = false;
            return None;
        }
        self.shift = (self.shift * 100.0).max(1e-4);
        if self.shift > GREATEST_SHIFT {
            let infeasible = self.here.worst > 1e-6;
            return Some(if infeasible { Status::Infeasible } else { Status::Failed });
        }
        None
    }
}
