//! Where the loop ends: at an optimum, in a valley, far out, or where no step helps.

use super::damping::damps;
use super::iterate::Iterate;
use super::iteration::Iteration;
use super::newton_system::{Factored, NoStep};
use super::point::Point;
use super::program::Program;
use super::status::Status;
use super::step::Step;
use crate::index::{ConstraintId, VariableId};
use crate::linalg::{Direction, KktError};

/// Multiple of its size at which an unknown has grown without limit.
const ENDLESS: f64 = 1e15;
/// Steps that need damping, among so many, and together gain less than this in log-likelihood: a valley without
/// an end in sight.
const VALLEY: (usize, usize, f64) = (10, 40, 0.1);
/// So many steps in a row, none of which is longer than this part of a full one: the merit function has led the path to where
/// its linearisation holds no farther, and hundreds of such steps would lead nowhere.
const STALLED: (usize, f64) = (10, 1e-3);

/// Largest defect, in units of its state, of a path that satisfies the equations but for the last steps.
const FEASIBLE: f64 = 1e-6;

/// How a run ends, with what there is to say of it.
#[derive(Debug)]
pub(crate) struct Ending {
    pub status: Status,
    pub detail: String,
}

impl From<Status> for Ending {
    fn from(status: Status) -> Ending {
        Ending { status, detail: String::new() }
    }
}

impl Ending {
    pub fn new(status: Status, detail: String) -> Ending {
        Ending { status, detail }
    }

    /// Where there is no step from a point.
    pub(super) fn without_step(reason: NoStep, program: &Program<'_>, xi: &[f64]) -> Ending {
        match reason {
            NoStep::NotPositive => Status::Failed.into(),
            NoStep::NotFinite => {
                let what = program.nlp.explain(xi);
                Ending::new(Status::Failed, what.unwrap_or_else(|| "a derivative is not finite".into()))
            }
            NoStep::Singular(KktError::Dependent { row }) => {
                let name = program.nlp.constraint_name(row);
                Ending::new(Status::Infeasible, format!("the {name} depends linearly on others"))
            }
            NoStep::Singular(error @ KktError::Boundary) => {
                Ending::new(Status::Infeasible, error.to_string())
            }
            NoStep::Singular(error) => Ending::new(Status::Failed, error.to_string()),
        }
    }

    /// The end where steps have become so short that the path no longer moves.
    pub(super) fn stalled(history: &[Iteration], point: &Point) -> Option<Ending> {
        let (count, longest) = STALLED;
        // The first line is the start, which no step led to.
        let recent = history.len().checked_sub(count).filter(|first| *first > 0)?;
        let short = history[recent..].iter().all(|line| line.step < longest);
        short.then(|| Ending::without_progress(point))
    }

    /// Where no step helps.
    pub(super) fn without_progress(point: &Point) -> Ending {
        if point.worst > FEASIBLE { Status::Infeasible } else { Status::Failed }.into()
    }

    /// Where nothing is left to gain: is it an optimum?
    pub(super) fn at_optimum(program: &Program<'_>, system: &mut Factored<'_>) -> Ending {
        if system.damping.shift() == 0.0 {
            return Status::Converged.into();
        }
        // Curvature that rounding alone makes negative is none.
        let rounding = system.damping.is_rounding();
        let (found, directions) = system.unshifted();
        if found.is_positive() {
            return Status::Converged.into();
        }
        let ridge = found.negative > 0 && !rounding;
        let status = if ridge { Status::Failed } else { Status::Unidentifiable };
        let names = |direction: &Direction| {
            let most = direction.first().map_or(0.0, |x| x.1.abs());
            let mut part: Vec<VariableId> =
                direction.iter().filter(|x| x.1.abs() > 0.1 * most).map(|x| x.0).collect();
            part.sort_unstable();
            part.iter().take(6).map(|&i| program.nlp.variable_name(i)).collect::<Vec<_>>().join(", ")
        };
        Ending::new(status, directions.iter().map(names).collect::<Vec<_>>().join("; "))
    }

    /// The status's hint, with the detail; where no step helped and nothing is known of it, with the greatest defect.
    pub fn message(mut self, program: &Program<'_>, point: &Point) -> String {
        let hint = self.status.hint();
        if matches!(self.status, Status::Infeasible | Status::Failed) && self.detail.is_empty() {
            let sizes = point.c.iter().zip(program.units.each()).map(|(c, u)| c.abs() / u).enumerate();
            if let Some((i, _)) = sizes.max_by(|a, b| a.1.total_cmp(&b.1)) {
                let name = program.nlp.constraint_name(ConstraintId(i));
                self.detail = format!("the largest is the {name}: {:.2e}", point.c[i]);
            }
        }
        if self.detail.is_empty() { hint.to_owned() } else { format!("{hint} ({})", self.detail) }
    }
}

/// Sizes of the border variables at the first point at which each has influence; before, 0. Of a program without
/// chains those of all variables.
pub(super) struct Sizes(Vec<f64>);

impl Sizes {
    pub fn new(program: &Program<'_>, xi: &[f64]) -> Sizes {
        Sizes(program.units.first_sizes(program.nlp, xi))
    }

    /// Sets those that are not known yet.
    pub fn measure(&mut self, program: &Program<'_>, iterate: &Iterate) {
        let derivatives = (&*iterate.jacobian, &*iterate.hessian);
        program.units.size_border(program.nlp, &iterate.point.xi, derivatives, &mut self.0);
    }

    /// The end at a point where a parameter has grown without limit.
    pub fn diverging(&self, program: &Program<'_>, point: &Point) -> Option<Ending> {
        let border = program.nlp.chains().map_or(point.xi.len(), |c| c.border);
        let own = program.nlp.profiled();
        // What has had no influence yet has not moved either.
        let size =
            |i: usize| self.0.get(i).map_or(1.0, |size| if *size > 0.0 { *size } else { f64::INFINITY });
        let far = (0..border).find(|&i| !own.contains(&i) && point.xi[i].abs() > ENDLESS * size(i))?;
        let detail = format!("{} = {:.1e}", program.nlp.variable_name(VariableId(far)), point.xi[far]);
        Some(Ending::new(Status::Diverging, detail))
    }

    /// The end where steps have become short because the likelihood hardly tells where to go: with the names of the
    /// parameters that the step changes most.
    pub fn crawling(
        &self,
        history: &[Iteration],
        program: &Program<'_>,
        point: &Point,
        step: &Step,
    ) -> Option<Ending> {
        // Steps on trust may come between.
        let (count, among, least) = VALLEY;
        let damped = |line: &Iteration| damps(line.shift) && line.step > 0.0;
        let mut recent = history.iter().enumerate().rev().take(among).filter(|(_, line)| damped(line));
        let before = recent.nth(count - 1).and_then(|(first, _)| first.checked_sub(1))?;
        if (history[before].objective - point.objective).abs() >= least {
            return None;
        }
        let size = |i: usize| point.xi[i].abs().max(1e-3 * self.0[i]).max(f64::MIN_POSITIVE);
        let part = |i: &usize| step.d[*i].abs() / size(*i);
        let mut order: Vec<usize> = (0..program.border()).collect();
        order.sort_by(|a, b| part(b).total_cmp(&part(a)));
        let names: Vec<String> =
            order.into_iter().take(6).map(|i| program.nlp.variable_name(VariableId(i))).collect();
        let detail = format!("the data hardly determine {}", names.join(", "));
        Some(Ending::new(Status::Acceptable, detail))
    }
}
