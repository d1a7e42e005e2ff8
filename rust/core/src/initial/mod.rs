//! What goes before the loop of the solver, and around it: a regression of the parameters on the states as they are, other
//! places to start from, and which of the ends is the best.
//!
//! A model that is linear in its parameters needs no more than the regression. Of another the likelihood may have several
//! maxima, so that a few other places are looked at before the first step, and more of them after a run that led nowhere.

mod normal;
mod products;
mod regression;
mod separable;

use crate::interrupt::{Interrupt, current};
use crate::nlp::{NotFinite, Separable};
use crate::solver::{
    Approach, Control, Ending, Iteration, Newton, Point, Program, Settings, Solution, Status,
};
use regression::Regression;

/// What goes before the first step of the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Initial {
    /// Nothing: the loop begins at the start.
    #[default]
    Start,
    /// A regression of the parameters on the states as they are: for states that are measured, and a start that is
    /// known to be near.
    Regression,
    /// The same, which looks elsewhere, too, where the model is not linear in its parameters.
    Places,
    /// Steps along paths that satisfy the equations, as far as they lead: for states that are not measured, and few samples.
    Paths,
    /// Nothing, or a regression, where the start is another model's fit. Where the loop is not near an optimum soon, the path that
    /// it has torn is given up for steps along paths that satisfy the equations.
    Nearby {
        /// Whether a regression goes first.
        regression: bool,
    },
}

impl Initial {
    fn regresses(self) -> bool {
        matches!(self, Initial::Regression | Initial::Places | Initial::Nearby { regression: true })
    }
}

type Watch<'w> = dyn FnMut(&Iteration) -> Control + 'w;

/// Minimises from `start`, or from what a regression makes of it, as [`crate::solver::solve`] does.
///
/// # Errors
/// [`NotFinite`] when a function is not finite at the start; everything else is a [`Status`].
pub fn solve(
    nlp: &dyn Separable,
    start: &[f64],
    multipliers: Option<&[f64]>,
    initial: Initial,
    settings: &Settings,
    watch: &mut Watch<'_>,
) -> Result<Solution, NotFinite> {
    Interrupt::within(settings.time_limit).run(|| {
        if let Some(solution) = Solution::without_a_run(nlp, start, multipliers) {
            return Ok(solution);
        }
        best(nlp, start, multipliers, initial, settings, watch)
    })
}

/// How the best of the runs ended.
fn best(
    nlp: &dyn Separable,
    start: &[f64],
    multipliers: Option<&[f64]>,
    initial: Initial,
    settings: &Settings,
    watch: &mut Watch<'_>,
) -> Result<Solution, NotFinite> {
    let program = Program::new(nlp, start);
    let point = Point::first(&program, start)?;
    if initial == Initial::Paths {
        let newton = Newton::new(program, point, None, settings);
        let Along { mut newton, ending } = along_paths(newton, settings, watch)?;
        let ending = match ending {
            Some(ending) => {
                // A path that leaves the equations may find a way where a consistent one has none, as from one period of an
                // oscillation to another. Not long, where it leads nowhere.
                let most = settings.max_iterations.min(newton.iterations() + LOOSE);
                let capped = settings.clone().max_iterations(most);
                challenge(nlp, &mut newton, ending, start, &capped, watch)?
            }
            None => newton.minimise(watch)?,
        };
        return Ok(newton.finish(ending));
    }
    let (point, alternative) = begin(nlp, &program, point, initial);
    // What a run allocates takes its time, too.
    if let Some(solution) = Solution::before_a_step(&program, &point, multipliers) {
        return Ok(solution);
    }
    if let Initial::Nearby { .. } = initial {
        return nearby(nlp, start, Newton::new(program, point, multipliers, settings), watch);
    }
    let mut newton = Newton::new(program, point, multipliers, settings);
    let mut ending = newton.minimise(watch)?;
    if let Some(alternative) = alternative {
        // Not long, where it leads nowhere.
        let most = settings.max_iterations.min(3 * newton.iterations() + 10);
        let capped = settings.clone().max_iterations(most);
        ending = challenge(nlp, &mut newton, ending, &alternative.xi, &capped, watch)?;
    }
    if initial == Initial::Places && is_doubtful(nlp, &newton, ending.status) {
        for place in further_places(nlp, start)? {
            ending = challenge(nlp, &mut newton, ending, &place.xi, settings, watch)?;
            if !is_doubtful(nlp, &newton, ending.status) {
                break;
            }
        }
    }
    if initial.regresses() && ending.status.lost() && !current().stops() {
        // A regression may lead astray, as where parameters are in exponents. Once more without.
        let program = Program::new(nlp, start);
        let point = Point::first(&program, start)?;
        let mut again = Newton::new(program, point, multipliers, settings);
        again.take_over(&mut newton);
        ending = again.minimise(watch)?;
        newton = again;
    }
    Ok(newton.finish(ending))
}

/// Iterations after which a loop from a start nearby should be near an optimum, and most that follow along consistent paths.
const SOON: usize = 20;
const ALONG: usize = 60;

/// How a run from a start nearby ended: the loop from `newton`, and where that is not near an optimum soon, steps along paths that
/// satisfy the equations, from the start.
fn nearby<'a>(
    nlp: &'a dyn Separable,
    start: &[f64],
    mut newton: Newton<'a>,
    watch: &mut Watch<'_>,
) -> Result<Solution, NotFinite> {
    let most = newton.settings().max_iterations;
    newton.limit_iterations(most.min(SOON));
    let mut ending = newton.minimise(watch)?;
    let spent = ending.status == Status::IterationLimit && newton.iterations() < most;
    newton.limit_iterations(most);
    if spent && newton.is_near() {
        ending = newton.minimise(watch)?;
    } else if spent || ending.status.lost() && !current().stops() {
        let program = Program::new(nlp, start);
        let point = Point::first(&program, start)?;
        let settings = newton.settings().clone().max_iterations(most.min(newton.iterations() + ALONG));
        let mut other = Newton::new(program, point, None, &settings);
        other.take_over(&mut newton);
        let Along { newton: mut other, ending: end } = along_paths(other, &settings, watch)?;
        let end = match end {
            Some(end) if end.status == Status::Converged || end.status.was_stopped() => {
                return Ok(other.finish(end));
            }
            end => end,
        };
        // A path that leaves the equations may find a way where a consistent one has none.
        newton.take_over(&mut other);
        if spent && newton.program().stopped().is_none() {
            ending = newton.minimise(watch)?;
        }
        if let Some(end) = end.filter(|end| rank(end.status, &other) < rank(ending.status, &newton)) {
            other.take_over(&mut newton);
            return Ok(other.finish(end));
        }
    }
    Ok(newton.finish(ending))
}

/// Ends that are better come first: an optimum, and a greater likelihood.
fn rank(status: Status, run: &Newton<'_>) -> (bool, f64) {
    (status.lost() || status.unfinished(), run.point().objective)
}

/// Most steps from the end of an approach to that of the loop.
const LAST: usize = 8;
/// Most steps of the loop from the start itself.
const LOOSE: usize = 60;
/// Most restarts from the other side of bounds.
const RESTARTS: usize = 8;
/// Where a parameter at a bound starts again: so far from its other bound, as a part of its range.
const OPPOSITE: f64 = 0.3;
/// A run that is not better by more than this is no other optimum.
const BETTER: f64 = 1e-3;

/// A run along paths that satisfy the equations.
struct Along<'a> {
    newton: Newton<'a>,
    /// `None` where there is no consistent path to begin with: then the run stands at its start.
    ending: Option<Ending>,
}

/// The run from where steps along paths that satisfy the equations lead. Where parameters end at bounds, as rates do that are
/// fast enough, the likelihood is flat there and says nothing of what lies beyond: each is started once more from the other
/// half of its range.
fn along_paths<'a>(
    mut newton: Newton<'a>,
    settings: &Settings,
    watch: &mut Watch<'_>,
) -> Result<Along<'a>, NotFinite> {
    let nlp = newton.program().nlp;
    let Some(mut ending) = approached(nlp, &mut newton, settings, watch)? else {
        return Ok(Along { newton, ending: None });
    };
    let mut tried: Vec<usize> = Vec::new();
    for _ in 0..RESTARTS {
        if ending.status.unfinished() || newton.program().stopped().is_some() {
            break;
        }
        let (xi, program) = (&newton.point().xi, newton.program());
        let at_bound = |&i: &usize| {
            let (low, high) = (program.lower[i], program.upper[i]);
            let slack = 1e-9 * (high - low);
            high.is_finite()
                && low.is_finite()
                && low < high
                && (xi[i] <= low + slack || xi[i] >= high - slack)
        };
        let own = nlp.profiled();
        let mut candidates = (0..program.border()).filter(|i| !own.contains(i) && !tried.contains(i));
        let Some(i) = candidates.find(at_bound) else { break };
        tried.push(i);
        let mut place = xi.clone();
        let (low, high) = (program.lower[i], program.upper[i]);
        let part = if xi[i] < 0.5 * (low + high) { 1.0 - OPPOSITE } else { OPPOSITE };
        place[i] = low + part * (high - low);
        let program = Program::new(nlp, &place);
        let Ok(point) = Point::first(&program, &place) else { continue };
        let mut other = Newton::new(program, point, None, settings);
        other.take_over(&mut newton);
        let found = approached(nlp, &mut other, settings, watch)?;
        match found {
            Some(end) if other.point().objective < newton.point().objective - BETTER => {
                newton = other;
                ending = end;
                tried = vec![i]; // from here the others may lead on
            }
            _ => newton.take_over(&mut other),
        }
    }
    Ok(Along { newton, ending: Some(ending) })
}

/// The end of an approach, and of the loop from there where it led to an optimum; back there, where it leads nowhere from there.
/// `None` where there is no path to begin with.
fn approached<'a>(
    nlp: &'a dyn crate::nlp::Nlp,
    newton: &mut Newton<'a>,
    settings: &Settings,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, NotFinite> {
    match newton.approach(watch) {
        Approach::Ended(ending) => return Ok(Some(ending)),
        Approach::None => return Ok(None),
        // Where no step helps far from an optimum, the path is as lost as a torn one.
        Approach::Taken(false) if !newton.is_near() => return Ok(Some(Status::Failed.into())),
        Approach::Taken(false) => return Ok(Some(Status::Acceptable.into())),
        Approach::Taken(true) => {}
    }
    // Its units are those of this path.
    let reached = newton.point().xi.clone();
    let program = Program::new(nlp, &reached);
    let point = Point::first(&program, &reached)?;
    let best = point.objective;
    let most = newton.iterations() + LAST;
    let capped = settings.clone().max_iterations(most.min(settings.max_iterations));
    let mut last = Newton::new(program, point, None, &capped);
    last.take_over(newton);
    let ending = last.minimise(watch)?;
    let fine = ending.status.is_end() && last.point().objective < best + BETTER;
    if fine || matches!(ending.status, Status::Interrupted | Status::TimeLimit) {
        *newton = last;
        return Ok(Some(ending));
    }
    newton.take_over(&mut last);
    Ok(Some(Status::Acceptable.into()))
}

/// Where the loop begins; where another place than that of the regression from the start was chosen, that one, too.
fn begin<'a>(
    nlp: &'a dyn Separable,
    program: &Program<'a>,
    point: Point,
    initial: Initial,
) -> (Point, Option<Point>) {
    if !initial.regresses() {
        return (point, None);
    }
    let Some(mut regression) = Regression::new(nlp, program, point.clone()) else { return (point, None) };
    let mut alternative = None;
    if initial == Initial::Places && regression.is_separable() {
        alternative = regression.regress_separably();
    } else {
        regression.regress();
    }
    // Stopped, it was left half way.
    if current().stops() { (point, None) } else { (regression.here, alternative) }
}

/// Other places to start from, after a run that led nowhere.
fn further_places(nlp: &dyn Separable, start: &[f64]) -> Result<Vec<Point>, NotFinite> {
    if current().stops() {
        return Ok(Vec::new());
    }
    let program = Program::new(nlp, start);
    let point = Point::first(&program, start)?;
    let regression = Regression::new(nlp, &program, point).filter(Regression::is_separable);
    Ok(regression.map_or_else(Vec::new, |mut regression| regression.further_places(start)))
}

/// Whether another place should be tried.
fn is_doubtful(nlp: &dyn Separable, newton: &Newton<'_>, status: Status) -> bool {
    // Whether a parameter in which the model is not linear stands at a bound.
    let at_bound = || {
        let (xi, program) = (&newton.point().xi, newton.program());
        let (lower, upper) = (&program.lower, &program.upper);
        nlp.nonlinear().into_iter().any(|i| lower[i] < upper[i] && (xi[i] <= lower[i] || xi[i] >= upper[i]))
    };
    status.lost() || status == Status::Unidentifiable || (!status.unfinished() && at_bound())
}

/// Runs from another place, and takes that run where it ends better: with a greater likelihood, and at an end.
fn challenge<'a>(
    nlp: &'a dyn Separable,
    newton: &mut Newton<'a>,
    ending: Ending,
    place: &[f64],
    settings: &Settings,
    watch: &mut Watch<'_>,
) -> Result<Ending, NotFinite> {
    if let Some(status) = newton.program().stopped() {
        return Ok(status.into());
    }
    if ending.status.unfinished() {
        return Ok(ending);
    }
    let program = Program::new(nlp, place);
    let point = Point::first(&program, place)?;
    let mut other = Newton::new(program, point, None, settings);
    other.take_over(newton);
    let end = other.minimise(watch)?;
    if rank(end.status, &other) < rank(ending.status, newton) {
        *newton = other;
        return Ok(end);
    }
    newton.take_over(&mut other);
    Ok(if end.status == Status::Interrupted { end } else { ending })
}
