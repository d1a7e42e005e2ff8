"""From a model and data to a fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..data.checked import moves
from ..data.experiment import Experiment, as_experiments, completed
from ..data.units import check_units
from ..errors import ModelError, OptionError
from ..fit_result import FitResult
from ..guess import parameter_start, spread, start_values
from ..integration import coarse_mesh_warning
from ..modelling.model import Model
from ..noise.noise import Gaussian, Noise, not_noise
from ..process_noise.fit import better, doubtful, filter_error
from ..process_noise.variables import split
from ..regression.equation_error import EquationError
from ..solvers import HINTS, Ipopt, Iteration, Newton
from ..solvers.limits import Deadline, interrupts
from ..transcription.collocation import Collocation
from ..transcription.filter_error import FilterError
from ..transcription.shooting import MultipleShooting, SingleShooting, Transcription
from .core import Earlier, estimated
from .fitted import make_fit
from .motion import Paths, RestartSearch, starts_known
from .refine import refined
from .smooth import kinks_matter, smoothed_fit

__all__ = ["estimate"]

# How a run ends at an optimum.
_ENDS = ("converged", "acceptable", "unidentifiable")


def estimate(
    model: Model,
    data: Experiment | Sequence[Experiment],
    *,
    transcription: Transcription | FilterError | None = None,
    noise: Noise | None = None,
    start: Mapping[str, Any] | FitResult | EquationError | None = None,
    solver: Newton | Ipopt | None = None,
    progress: bool | Callable[[Iteration], None] = False,
) -> FitResult:
    """The maximum-likelihood estimate of a model's parameters from measured data (Eq. ml_loglike of the paper).

    ``data``: one experiment or several with shared parameters. Initial states are free.
    ``start``: values by name of parameters, of ``sigma_<output>`` (and what else the noise has) and of states (a number
    or one value a sample), or a fit to go on from, or the result of `equation_error`. Parameters not named start as
    declared, standard deviations at the spread of the measurements, states as measured where an output measures them,
    else as declared (`State`, `Model.initial`), else at 0, or at 1 where the model has no finite derivative at 0.
    ``transcription``: `Collocation`, `MultipleShooting` or `SingleShooting`, or `FilterError` where there is process
    noise, such as turbulence; the latter has a solver of its own.
    ``noise``: `Gaussian`, `StudentT`, `Huber`, `Laplace`, `Density` or `PerOutput`, or `PerExperiment` of these,
    instead of the model's own.
    ``solver``: `Newton` unless asked otherwise.
    ``progress``: True prints the iterations; a function is called with each.

    Where jumps or kinks of the state equations (`sign`, `abs`, `where`, ...) keep a fit by `Collocation` from
    converging, or are crossed where its mesh is too coarse for them, they are smoothed, over widths that are reduced
    from fit to fit until what they leave in error is small beside the standard errors. `Fit.smoothing` and the message
    say so.

    A fit without ``solver`` and ``start`` that does not converge is tried once more with the noise held at the spread
    of the measurements first; a warning says where the likelihood was higher before.

    Ctrl-C ends the run and returns the best point so far, with status "interrupted". Pressed once more, while its
    standard errors are computed, it leaves these out (NaN, and a warning); a third is as ever.

    Raises ModelError, DataError or OptionError for what cannot be right, EvaluationError where the model is not
    finite at the start. Not to converge is a status of the fit, not an error.
    """
    deadline = Deadline(solver.time_limit if isinstance(solver, (Newton, Ipopt)) else None)
    if isinstance(model, Model):
        model = model.copy()  # what is declared on the user's own afterwards is no part of this fit
    fit = _estimate(model, data, transcription, noise, start, solver, progress)
    if fit.status == "iteration limit" and solver is None and start is None:
        fit = _with_noise_last(fit, model, data, transcription, noise, progress)
    if deadline.passed() or not kinks_matter(fit):
        return fit

    def solve(smooth: Model, mesh: Collocation, before: FitResult | None) -> FitResult:
        by = replace(solver or Newton(), time_limit=deadline.left())
        if before is not None and isinstance(by, Newton):
            by = replace(by, regression=False)
        return _estimate(smooth, data, mesh, noise, start if before is None else before, by, progress)

    return smoothed_fit(solve, fit)


def _estimate(
    model: Model,
    data: Experiment | Sequence[Experiment],
    transcription: Transcription | FilterError | None = None,
    noise: Noise | None = None,
    start: Mapping[str, Any] | FitResult | EquationError | None = None,
    solver: Newton | Ipopt | None = None,
    progress: bool | Callable[[Iteration], None] = False,
    paths: Paths | None = None,
) -> FitResult:
    """Return the estimate with the kinks of the model as they are.

    ``paths``: where the states start, for each experiment times and values of each state.
    """
    deadline = Deadline(solver.time_limit if isinstance(solver, (Newton, Ipopt)) else None)
    experiments = as_experiments(data, "estimate")
    if not isinstance(model, Model):
        raise ModelError(f"estimate: the first argument is a Model, not a {type(model).__name__}")
    model.check()
    experiments = completed(experiments, model.output_names)
    check_units(model, experiments, "estimate")
    transcription = transcription or Collocation()
    noise = noise or model.noise_model
    if not isinstance(transcription, (Collocation, FilterError, MultipleShooting, SingleShooting)):
        raise OptionError(
            "estimate: transcription is a Collocation, FilterError, MultipleShooting or SingleShooting, "
            f"not {transcription!r}"
        )
    if not isinstance(noise, Noise):
        raise OptionError(f"estimate: {not_noise(noise)}")
    if noise.expressions and noise is not model.noise_model:
        model = model.with_noise(noise)
    if isinstance(transcription, FilterError) and solver is not None:
        raise OptionError("estimate: FilterError has a solver of its own; leave out solver")
    solver = solver or Newton()
    if not isinstance(solver, (Newton, Ipopt)):
        raise OptionError(f"estimate: solver is Newton(...) or Ipopt(...), not {solver!r}")
    collocated = isinstance(transcription, Collocation)
    if isinstance(solver, Newton) and solver.regression and not collocated:
        raise OptionError("estimate: a regression on states as measured makes sense with Collocation only")
    if not isinstance(progress, bool) and not callable(progress):
        raise OptionError(f"estimate: progress is True, False or a function, not {progress!r}")
    if not isinstance(start, (Mapping, FitResult, EquationError, type(None))):
        raise OptionError(f"estimate: start holds values by name, or is a fit, not {start!r}")
    if isinstance(transcription, Collocation) and transcription.refine:
        # A mesh that is only finer needs no regression: the path is there.
        again = replace(solver, regression=False) if isinstance(solver, Newton) else solver

        def fit_on(mesh: Collocation, fit: FitResult | None) -> FitResult:
            # The likelihood on another mesh is none to compare with.
            begin, by = (replace(fit, log_likelihood=np.nan), again) if fit else (start, solver)
            by = replace(by, time_limit=deadline.left())
            return _estimate(model, data, transcription=mesh, noise=noise, start=begin, solver=by, progress=progress)

        return refined(fit_on, transcription, deadline.passed)

    if model.delays and isinstance(transcription, FilterError):
        raise OptionError("FilterError: delays are not supported")

    moving = [_moving(e, model.output_names) for e in experiments]
    for i, experiment in enumerate(experiments):
        # An output that stands still in this experiment may move in another, which then gives its sigma.
        elsewhere = set().union(*moving[:i], *moving[i + 1 :])
        known_sigma = {*noise.known_sigmas(model.output_names), *noise.expressions, *elsewhere}
        experiment.check_for(model.input_names, model.output_names, known_sigma, conditions=model.condition_names)

    if isinstance(transcription, FilterError):
        if isinstance(start, EquationError):
            start = start.as_start()
        with Deadline(transcription.time_limit).in_force():
            return _filtered(model, experiments, transcription, noise, start, progress)

    earlier = Earlier({}, paths) if paths is not None else None
    given: Mapping[str, Any] = start if isinstance(start, Mapping) else {}
    if isinstance(start, (FitResult, EquationError)):
        earlier = Earlier.of(start, noise)
    values = start_values(model, given, experiments, noise)
    follows = paths is None and not model.delays and not isinstance(start, EquationError)
    if follows and _follows_motion(model, experiments, transcription, given):
        given = start.as_start(noise) if isinstance(start, FitResult) else given

        def on_mesh(mesh: Collocation, paths: Paths, at: Mapping[str, float], most: int | None) -> FitResult:
            most = solver.max_iterations if most is None else min(most, solver.max_iterations)
            by = replace(solver, time_limit=deadline.left(), max_iterations=most)
            return _estimate(model, data, mesh, noise, {**given, **at}, by, progress, paths)

        assert isinstance(transcription, Collocation)
        parameters = parameter_start(model, given)
        restarts = solver.restarts if isinstance(solver, Newton) else 0
        restarts = 0 if isinstance(start, FitResult) else restarts
        moved = RestartSearch(on_mesh, model, experiments, transcription, deadline.left).best(parameters, restarts)
        if moved is not None:
            return moved
    by = replace(solver, time_limit=deadline.left())
    with interrupts() as pressed:
        found = estimated(model, experiments, transcription, noise, values, earlier, by, progress, pressed)
        fit = make_fit(model, experiments, noise, transcription, found)
        if pressed() and fit.status != "interrupted":  # whoever called is to know
            fit = replace(fit, status="interrupted", message=HINTS["interrupted"])
    if absent := [f"'{e.name}' without {', '.join(sorted(e._unmeasured))}" for e in experiments if e._unmeasured]:
        listed = "; ".join(absent[:5]) + ("; ..." if len(absent) > 5 else "")
        fit = replace(fit, warnings=(*fit.warnings, f"not every experiment measures all outputs: {listed}"))
    if isinstance(start, FitResult) and (worse := _worse_than_start(fit, start)):
        fit = replace(fit, warnings=(worse, *fit.warnings))
    unfinished = fit.status in ("interrupted", "time limit") or deadline.passed()
    if isinstance(transcription, Collocation) and fit.feasible and not unfinished:
        fit = replace(fit, warnings=(*fit.warnings, *filter(None, [coarse_mesh_warning(fit)])))
    return fit


def _with_noise_last(
    fit: FitResult,
    model: Model,
    data: Experiment | Sequence[Experiment],
    transcription: Transcription | FilterError | None,
    noise: Noise | None,
    progress: bool | Callable[[Iteration], None],
) -> FitResult:
    """Return the fit with the noise free from where one with known noise ends, where both converge.

    Where a model misses much, the likelihood has ridges along which the noise of one output falls while that of others
    grows. With standard deviations held at the spread of the measurements it has none. Output-error programs keep the
    noise as it is for their first iterations for the same reason (Jategaonkar 2015, ch. 4).
    """
    if not isinstance(fit.transcription, Collocation) or fit.noise.known_sigmas(model.output_names):
        return fit
    spreads = {name: spread(as_experiments(data, "estimate"), name) for name in model.output_names}
    if not all(np.isfinite(s) and s > 0.0 for s in spreads.values()):
        return fit
    with_known = _estimate(model, data, transcription, Gaussian(spreads), progress=progress)
    if with_known.status not in _ENDS:
        return fit
    found = _estimate(model, data, transcription, noise, with_known, progress=progress)
    if found.status not in _ENDS:
        return fit
    lost, more = fit.log_likelihood - found.log_likelihood, []
    if fit.feasible and lost > _LESS:
        more = [
            f"a run that did not converge has a log-likelihood higher by {lost:.4g}: `multistart` seeks other optima"
        ]
    iterations = fit.iterations + with_known.iterations + found.iterations
    time = fit.time + with_known.time + found.time
    return replace(found, iterations=iterations, time=time, warnings=(*found.warnings, *more))


def _follows_motion(
    model: Model, experiments: Sequence[Experiment], transcription: Transcription, given: Mapping[str, Any]
) -> bool:
    """Whether the mesh is to follow the motion: samples are few, and the parameters tell where it begins."""
    if not isinstance(transcription, Collocation) or transcription.segments is not None or transcription.substeps != 1:
        return False
    return starts_known(model, given) and _few_samples(experiments, model)


# With fewer measured values for each parameter, data do not keep the path of states that are not measured in place.
_FEW = 20


def _few_samples(experiments: Sequence[Experiment], model: Model) -> bool:
    """Whether there are few measured values for the parameters of a model."""
    free = sum(not p.fixed for p in model.declared_parameters.values())
    values = sum(int(np.isfinite(e.output(n)).sum()) for e in experiments for n in model.output_names)
    return values <= _FEW * free


def _filtered(
    model: Model,
    experiments: Sequence[Experiment],
    transcription: FilterError,
    noise: Noise,
    start: Mapping[str, Any] | FitResult | None,
    progress: bool | Callable[[Iteration], None],
) -> FitResult:
    """Return the fit by the filter-error method, within the limit in force."""
    # Of parameters that each experiment has its own, states are measured with biases: their path is a fit's.
    local = len(experiments) > 1 and any(p.per_experiment for p in model.declared_parameters.values())
    if isinstance(start, FitResult):
        fit = filter_error(model, experiments, transcription, noise, start, progress)
        return replace(fit, experiments=tuple(experiments))

    def begun() -> FitResult:
        _, others = split(transcription, start or {})
        return _estimate(model, experiments, noise=noise, start=others, progress=progress)

    early = begun() if transcription.output_error or local else None
    fit = filter_error(model, experiments, transcription, noise, start, progress, early)
    if early is None and doubtful(fit, transcription):
        fit = better(fit, lambda: filter_error(model, experiments, transcription, noise, start, progress, begun()))
    return replace(fit, experiments=tuple(experiments))


# An end that is less likely than the start by more than this is another optimum, not rounding.
_LESS = 1e-2


def _worse_than_start(fit: FitResult, start: FitResult) -> str:
    """Return a sentence where a fit is less likely than the one that it started from, on the same data, else ""."""
    pairs = list(zip(fit.records, start.records, strict=False))
    same = len(fit.records) == len(start.records) and all(
        a.measured.keys() == b.measured.keys()
        and all(np.array_equal(z, b.measured[name], equal_nan=True) for name, z in a.measured.items())
        for a, b in pairs
    )
    lost = start.log_likelihood - fit.log_likelihood
    if not same or fit.noise != start.noise or not lost > _LESS:
        return ""
    return (
        f"the log-likelihood is {lost:.4g} below that of the fit it started from, on the same data: this is another, "
        "poorer optimum; start from elsewhere, or with fewer parameters free at once"
    )


def _moving(experiment: Experiment, outputs: Sequence[str]) -> set[str]:
    """The outputs that an experiment has and that are not constant there."""
    there = {*experiment.outputs, *experiment.channels}
    return {name for name in outputs if name in there and moves(experiment.output(name))}
