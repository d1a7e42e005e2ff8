//! Estimation with kinks in the state equations: smoothed, over widths that are reduced from pass to pass.

use std::time::{Duration, Instant};

use super::fit::{Bound, Estimate, Fit, Moved, Record};
use super::integration::deviation;
use super::print::short;
use super::refine::order_of;
use super::run::Watch;
use super::{Estimation, Transcription};
use crate::error::Error;
use crate::evaluator::at_points;
use crate::experiment::Experiment;
use crate::interrupt::current;
use crate::mesh::Grid;
use crate::model::{Kink, Model};
use crate::solver::Status;
use crate::tape::{Inputs, Tape};

/// A segment over whose kink integration is wrong by more than this part of the noise does not resolve it.
const COARSE: f64 = 0.1;
/// The first width as a part of the standard deviation of the kink's argument, and the one that is tried after it.
const FIRST: f64 = 0.1;
const WIDER: f64 = 1.0;
/// Each width is the last over this. Crossings of a kink move with the width, and the mesh must still resolve them.
const RATIO: f64 = 2.0;
/// Widths are narrow enough where the error left is below this part of every standard error and, root mean square, of the
/// residuals. In a validation there are no standard errors.
const SETTLED: f64 = 0.25;
const OF_RESIDUALS: f64 = 0.1;
/// Of the integration error of a segment, in units of the noise. With ten times more, standard errors are wrong: errors that
/// change with where a kink is crossed between points bend the likelihood.
const TOLERANCE: f64 = 1e-3;
/// Times the widths of an earlier fit, from which they are reduced again where these at once do not do.
const NARROWING: [f64; 4] = [64.0, 16.0, 4.0, 1.0];
/// Spreads below this part of the size of an argument are rounding.
const STILL: f64 = 1e-9;

/// One pass over a smoothed model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SmoothingStep {
    /// Width of each kink as a part of the standard deviation of its argument over the path.
    pub part: f64,
    /// Segments of the mesh, in all experiments.
    pub segments: usize,
    /// Iterations of the solver.
    pub iterations: usize,
    /// At the end.
    pub log_likelihood: f64,
}

/// The width over which a kink is smoothed.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct KinkWidth {
    /// The kink in words.
    pub kink: String,
    /// The width.
    pub width: f64,
    /// Its unit, empty where it is not known.
    pub unit: String,
}

/// The part of a parameter that smoothing leaves in error.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LeftInError {
    /// The parameter.
    pub name: String,
    /// Its change with widths of zero, extrapolated from the last two passes in proportion to the width; NaN after a single
    /// pass.
    pub change: f64,
    /// Its standard error.
    pub std_error: f64,
}

/// How kinks and jumps of the state equations were smoothed, pass after pass over narrower widths.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Smoothing {
    /// The width of each kink in the last pass.
    pub widths: Vec<KinkWidth>,
    /// The passes, the last the one that the fit holds.
    pub steps: Vec<SmoothingStep>,
    /// The error that is left of each parameter.
    pub left: Vec<LeftInError>,
}

impl Smoothing {
    /// Returns the parameters whose remaining error exceeds so many standard errors, and its size in these.
    pub fn beyond(&self, errors: f64) -> Vec<(&str, f64)> {
        let parts = self.left.iter().filter(|l| l.std_error > 0.0);
        let parts = parts.map(|l| (&*l.name, l.change / l.std_error));
        parts.filter(|p| p.1.is_nan() || p.1.abs() > errors).collect()
    }

    /// Returns the widths in words.
    pub fn description(&self) -> String {
        let one = |KinkWidth { kink, width, unit }: &KinkWidth| {
            format!("{kink} over {} {unit}", short(*width, 2)).trim_end().to_owned()
        };
        self.widths.iter().map(one).collect::<Vec<_>>().join(", ")
    }
}

/// A fit of the model smoothed over widths of some part of the spreads.
type Pass = (f64, Fit);

/// Returns whether a pass converged on a mesh that resolves its motion.
fn good(fit: &Fit) -> bool {
    fit.status == Status::Converged && fit.refinement.as_ref().is_some_and(|r| r.met())
}

impl Estimation<'_> {
    /// Returns the estimate of a model with kinks by passes over smooth models, each from the last, or `rough`, the fit
    /// without smoothing, where these do not converge either. Widths are halved until what they leave in error is small
    /// beside the standard errors, or the mesh cannot be made to resolve narrower ones.
    pub(super) fn smoothed(&self, rough: Fit, watch: &mut Watch<'_>) -> Result<Fit, Error> {
        let began = Instant::now();
        let spreads = rough.spreads(self.experiments)?;
        let asked = rough.refinement.as_ref().map(|r| r.tolerance);
        let tolerance = asked.map_or(TOLERANCE, |t| t.min(TOLERANCE));
        let mut narrowed = |part: f64, before: Option<&Fit>| -> Result<Fit, Error> {
            let on = before.or_else(|| Some(&rough).filter(|_| asked.is_none()));
            self.pass(&spreads, part, tolerance, on, before, watch)
        };
        let mut part = FIRST;
        let mut fit = narrowed(part, None)?;
        if !good(&fit) && !fit.status.was_stopped() {
            part = WIDER;
            fit = narrowed(part, None)?;
        }
        if !good(&fit) {
            let stopped = fit.status.was_stopped();
            let (status, message) =
                if stopped { (fit.status, fit.message) } else { (rough.status, rough.message.clone()) };
            return Ok(Fit { status, message, ..rough });
        }
        let mut passes: Vec<Pass> = vec![(part, fit)];
        let (mut ratio, mut stopped) = (RATIO, None);
        while passes.len() < self.smoothing_passes && !settled(&passes) {
            let (part, last) = &passes[passes.len() - 1];
            let part = part / ratio;
            let fit = narrowed(part, Some(last))?;
            if good(&fit) {
                passes.push((part, fit));
                ratio = RATIO;
            } else if fit.status.was_stopped() {
                stopped = Some((fit.status, fit.message));
                break;
            } else if ratio < RATIO || current().stops() {
                break;
            } else {
                ratio = RATIO.sqrt();
            }
        }
        let (part, left) = (passes[passes.len() - 1].0, left_in_error(&passes));
        let widths: Vec<f64> = spreads.iter().map(|s| part * s).collect();
        let time = rough.solution.time + began.elapsed();
        let mut fit = self.reported(passes, &widths, left, rough.iterations, time);
        if let Some(stopped) = stopped {
            (fit.status, fit.message) = stopped;
        }
        Ok(fit)
    }

    /// Returns the estimate of a model whose kinks are those of an earlier fit, smoothed as in the last pass of that: in one
    /// pass on its mesh, or after passes over wider kinks. None where there is no such fit, or where these do not come to an
    /// end.
    pub(super) fn smoothed_as_before(&self, watch: &mut Watch<'_>) -> Result<Option<Fit>, Error> {
        let before = self.earlier.as_ref().and_then(|e| e.smoothed.as_ref());
        let Some(before) = before.filter(|_| self.smooth_kinks) else {
            return Ok(None);
        };
        let Some(widths) = before.widths_of(&self.model.kinks()).filter(|w| !w.is_empty()) else {
            return Ok(None);
        };
        if !self.transcription.is_collocation() || self.smoothing_passes == 0 {
            return Ok(None);
        }
        let began = Instant::now();
        let mut found = None;
        if before.is_of(self.experiments) {
            let mesh = before.edges.iter().cloned().map(Grid::Edges).collect();
            let same = Estimation { regression: Some(false), ..self.clone() }.on_grid(before.order, mesh);
            found = same.over(&widths, &[1.0], watch)?;
        }
        if found.is_none() && !current().stops() {
            found = self.over(&widths, &NARROWING, watch)?;
        }
        let Some(fit) = found else { return Ok(None) };
        let spreads = Fit { model: self.model.clone(), ..fit.clone() }.spreads(self.experiments)?;
        let part = widths.iter().zip(&spreads).map(|(w, s)| w / s).fold(0.0, f64::max);
        let known = |e: &Estimate| {
            let (_, change) = before.left.iter().find(|l| l.0 == e.name)?;
            Some(LeftInError { name: e.name.clone(), change: *change, std_error: e.std_error })
        };
        let left =
            fit.parameters.iter().filter(|e| e.bound != Some(Bound::Fixed)).filter_map(known).collect();
        Ok(Some(self.reported(vec![(part, fit)], &widths, left, 0, began.elapsed())))
    }

    /// Returns the fit of the model smoothed over these widths, after passes over multiples of them, each from the last;
    /// None where one does not come to an end on a mesh that is fine enough.
    fn over(&self, widths: &[f64], factors: &[f64], watch: &mut Watch<'_>) -> Result<Option<Fit>, Error> {
        let tolerance = self.refine.map_or(TOLERANCE, |t| t.min(TOLERANCE));
        let mut last: Option<Fit> = None;
        for factor in factors {
            let before = last.as_ref();
            last = Some(self.pass(widths, *factor, tolerance, before, before, watch)?).filter(good);
            if last.is_none() {
                break;
            }
        }
        Ok(last)
    }

    /// Returns the fit of the model smoothed over a part of some widths, on the mesh of one fit and from the end of another.
    fn pass(
        &self,
        widths: &[f64],
        part: f64,
        tolerance: f64,
        on: Option<&Fit>,
        before: Option<&Fit>,
        watch: &mut Watch<'_>,
    ) -> Result<Fit, Error> {
        let smooth = self.model.smoothed(&widths.iter().map(|w| part * w).collect::<Vec<_>>())?;
        let mut pass = Estimation { model: &smooth, refine: Some(tolerance), ..self.clone() };
        if let Some(Transcription::Collocation(mesh)) = on.map(|fit| &fit.transcription) {
            pass = pass.on_grid(mesh.order, mesh.grid.clone());
        }
        before.map_or_else(|| pass.clone(), |fit| pass.going_on_from(fit)).solve_refined(watch)
    }

    /// Returns the last pass as a fit of the model with kinks, which says how these were smoothed, and how many iterations went before.
    fn reported(
        &self,
        passes: Vec<Pass>,
        widths: &[f64],
        left: Vec<LeftInError>,
        before: usize,
        time: Duration,
    ) -> Fit {
        let step = |(part, fit): &Pass| SmoothingStep {
            part: *part,
            segments: fit.refinement.as_ref().and_then(|r| r.steps.last()).map_or(0, |s| s.segments),
            iterations: iterations(fit),
            log_likelihood: fit.log_likelihood,
        };
        let steps: Vec<SmoothingStep> = passes.iter().map(step).collect();
        let (_, last) = passes.into_iter().next_back().expect("there is a pass");
        let width = |(kink, width): (Kink, &f64)| KinkWidth {
            kink: kink.label(),
            width: *width,
            unit: kink.unit(self.model),
        };
        let widths = self.model.kinks().into_iter().zip(widths).map(width).collect();
        let smoothing = Smoothing { widths, steps, left };
        let mut warnings = last.warnings.clone();
        let beyond = smoothing.beyond(1.0);
        if !beyond.is_empty() {
            let each = beyond.iter().map(|(name, by)| match by.is_finite() {
                true => format!("{name} by {by:+.1}"),
                false => (*name).to_owned(),
            });
            // After that on residuals that are not those of the noise.
            warnings.insert(usize::from(last.unlike_noise), format!(
                "kinks of the state equations were smoothed, and over narrower widths than these the fit did not converge: \
                 with widths of zero, parameters would change, in standard errors: {}; give more samples or a finer mesh",
                each.collect::<Vec<_>>().join(", ")
            ));
        }
        let moved = last.moved.clone().unwrap_or_else(|| {
            let fit = last.clone();
            let (experiments, base) = (self.experiments.to_vec(), Vec::new());
            Box::new(Moved { fit, experiments, base, reach: f64::INFINITY })
        });
        let mut fit = Fit {
            model: self.model.clone(),
            message: format!(
                "{}; kinks of the state equations were smoothed: {}",
                last.message,
                smoothing.description()
            ),
            warnings,
            iterations: before + smoothing.steps.iter().map(|s| s.iterations).sum::<usize>(),
            moved: Some(moved),
            smoothing: Some(smoothing),
            ..last
        };
        fit.solution.time = time;
        fit
    }
}

/// What smoothing leaves in error: by how much estimates change as widths go to zero, and standard errors.
fn left_in_error(passes: &[Pass]) -> Vec<LeftInError> {
    let (part, last) = &passes[passes.len() - 1];
    let before = passes.len().checked_sub(2).map(|k| &passes[k]);
    let free = last.parameters.iter().filter(|e| e.bound != Some(Bound::Fixed));
    free.map(|e| {
        let earlier = before.and_then(|(wider, fit)| Some((wider, fit.parameter(&e.name)?.value)));
        let change = earlier.map_or(f64::NAN, |(wider, value)| (e.value - value) * part / (wider - part));
        LeftInError { name: e.name.clone(), change, std_error: e.std_error }
    })
    .collect()
}

/// Whether the error left is small beside every standard error, and was nearly so a pass before, and what it is in the outputs
/// is small beside the residuals.
fn settled(passes: &[Pass]) -> bool {
    if passes.len() < 3 || !alike(&passes[passes.len() - 2..]) {
        return false;
    }
    let (now, before) = (left_in_error(passes), left_in_error(&passes[..passes.len() - 1]));
    let mut known = now.iter().filter(|l| l.std_error > 0.0 && l.change.is_finite());
    known.all(|l| {
        let earlier = before.iter().find(|b| b.name == l.name);
        l.change.abs() <= SETTLED * l.std_error
            && earlier.is_none_or(|b| b.change.abs() <= RATIO * SETTLED * b.std_error)
    })
}

/// Whether what smoothing leaves in error of each output is small beside its residuals.
fn alike(passes: &[Pass]) -> bool {
    let [(before, earlier), (part, last)] = passes else { return false };
    earlier.records.iter().zip(&last.records).all(|(then, now)| {
        (0..now.outputs.len()).all(|c| {
            let (mut left, mut residual) = (0.0, 0.0);
            for ((y, was), r) in now.outputs[c].iter().zip(&then.outputs[c]).zip(&now.residuals[c]) {
                if r.is_finite() {
                    left += ((y - was) * part / (before - part)).powi(2);
                    residual += r * r;
                }
            }
            left <= OF_RESIDUALS * OF_RESIDUALS * residual
        })
    })
}

fn iterations(fit: &Fit) -> usize {
    fit.refinement.as_ref().map_or(fit.iterations, |r| r.steps.iter().map(|s| s.iterations).sum())
}

impl Fit {
    /// Whether the model has kinks that may be why a fit by collocation is none, or a wrong one: it did not converge, or a kink
    /// is crossed within a segment that is too coarse for it.
    pub(super) fn kinks_matter(&self, experiments: &[Experiment]) -> bool {
        if !matches!(self.transcription, Transcription::Collocation(_)) || self.status.was_stopped() {
            return false;
        }
        if self.model.kinks().is_empty() {
            return false;
        }
        if self.status != Status::Converged {
            return true;
        }
        let (Ok(errors), Ok(paths)) = (self.integration_error(experiments), self.kink_arguments(experiments))
        else {
            return false;
        };
        let order = order_of(self);
        errors.iter().zip(&paths).any(|(error, paths)| {
            error.worst().into_iter().enumerate().any(|(s, worst)| {
                let crossed = |path: &Vec<f64>| {
                    let points = &path[s * (order - 1)..=(s + 1) * (order - 1)];
                    points.iter().any(|a| *a > 0.0) && !points.iter().all(|a| *a > 0.0)
                };
                worst > COARSE && paths.iter().any(crossed)
            })
        })
    }

    /// The standard deviation of the argument of each kink along the path; its size, or 1, where it stands still or is not
    /// finite.
    fn spreads(&self, experiments: &[Experiment]) -> Result<Vec<f64>, Error> {
        let paths = self.kink_arguments(experiments)?;
        let one = |k: usize| {
            let finite = |a: &f64| if a.is_finite() { *a } else { 0.0 };
            let all: Vec<f64> = paths.iter().flat_map(|p| p[k].iter().map(finite)).collect();
            let (spread, size) = (deviation(&all), all.iter().fold(0.0, |s: f64, a| s.max(a.abs())));
            let spread = if spread > STILL * size { spread } else { size };
            if spread > 0.0 && spread.is_finite() { spread } else { 1.0 }
        };
        Ok((0..self.model.kinks().len()).map(one).collect())
    }

    /// What is zero at each kink along the path, for each experiment and each kink one value a point of the mesh.
    fn kink_arguments(&self, experiments: &[Experiment]) -> Result<Vec<Vec<Vec<f64>>>, Error> {
        let model = &self.model;
        let mut c = model.compile()?;
        let none = std::collections::HashMap::new();
        let roots: Vec<_> = model.kinks().iter().map(|k| c.graph.import(&k.argument, &none)).collect();
        let lanes = c.data.iter().chain(&c.states).copied().collect();
        let tape = Tape::compile(&c.graph, &Inputs { lanes, uniforms: c.parameters }, &roots)?;
        let names = model.input_names();
        let one = |(record, run): (&Record, &Experiment)| {
            // How late an input is does not matter for how far an argument moves.
            let input = |name: &str| {
                let of = model.delays.input(name).map_or(name, |late| &late.of);
                let place = names.iter().position(|n| *n == of).expect("a late input is one of the model's");
                run.input(place, &record.mesh_t)
            };
            let inputs: Vec<Vec<f64>> = model.inputs.iter().map(|v| input(&v.name)).collect();
            let columns = std::iter::once(&record.mesh_t).chain(&inputs).chain(&record.mesh_states);
            let columns: Vec<&[f64]> = columns.map(Vec::as_slice).collect();
            at_points(&tape, &self.numbers_of(&record.name).0, &columns)
        };
        Ok(self.records.iter().zip(experiments).map(one).collect())
    }
}

impl Kink {
    /// Returns the operation and its equation in words, as in "sign(v) in v'".
    pub fn label(&self) -> String {
        const LONG: usize = 60;
        let text = match self.text.chars().count() {
            0..=LONG => self.text.clone(),
            _ => format!("{}(...)", self.name),
        };
        format!("{text} in {}", self.place)
    }

    /// Returns the unit of the argument: that of a state in which it has the slope 1 or -1; empty for others.
    pub fn unit(&self, model: &Model) -> String {
        let symbols = self.argument.symbols();
        let of_state = |s: &&crate::model::Variable| {
            symbols.iter().any(|n| **n == *s.name)
                && self.argument.derivative(&s.name).as_constant().is_some_and(|c| c.abs() == 1.0)
        };
        model.states.iter().find(of_state).map_or_else(String::new, |s| s.unit.clone())
    }
}
