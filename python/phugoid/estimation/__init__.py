"""From a model and data to a fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from ..data.checked import moves
from ..data.experiment import Experiment, as_experiments, completed
from ..data.units import check_units
from ..errors import ModelError, OptionError, check_progress, joined
from ..filter_error import FilterError
from ..fit_result import FitResult
from ..initialisation import start_values
from ..modelling.model import Model
from ..modelling.noise import Noise, not_noise
from ..solvers import HINTS, Deadline, Iteration, interrupts
from ..solvers.newton import Newton
from ..time_unit import SECONDS
from ..transcription import Collocation, MultipleShooting, SingleShooting, Transcription
from .core import Earlier, estimated, make_fit

if TYPE_CHECKING:  # a first estimate needs neither
    from ..regression.equation_error import EquationError
    from ..solvers.ipopt import Ipopt

__all__ = [
    "estimate",
    "estimate_from_afar",
]


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
    """Estimate the parameters of a model from measured data by maximum likelihood: the output-error method.

    What `phugoid.estimate` does, whose options these are, but that output injection is not tried.
    """
    if isinstance(model, Model):
        model = model.copy()  # what is declared on the user's own afterwards is not a part of this fit
    return _estimate(model, data, transcription, noise, start, solver, progress, every_way=True)


def estimate_from_afar(
    model: Model,
    data: Experiment | Sequence[Experiment],
    *,
    transcription: Transcription | FilterError | None = None,
    noise: Noise | None = None,
    start: Mapping[str, Any] | FitResult | EquationError | None = None,
    solver: Newton | Ipopt | None = None,
    progress: bool | Callable[[Iteration], None] = False,
) -> FitResult:
    """Return the estimate as `estimate` does, also by output injection where a start leads to no or a poor optimum.

    This is what a user calls, whose start may be far from any optimum. Estimates that other functions make begin next
    to a fit: where these end at a poor optimum, the model misses the motion, and output injection would take long.
    """
    if isinstance(model, Model):
        model = model.copy()
    return _estimate(model, data, transcription, noise, start, solver, progress, every_way=True, from_afar=True)


def _estimate(
    model: Model,
    data: Experiment | Sequence[Experiment],
    transcription: Transcription | FilterError | None = None,
    noise: Noise | None = None,
    start: Mapping[str, Any] | FitResult | EquationError | None = None,
    solver: Newton | Ipopt | None = None,
    progress: bool | Callable[[Iteration], None] = False,
    every_way: bool = False,
    from_afar: bool = False,
) -> FitResult:
    """Return the estimate as `estimate` does; without ``every_way``, kinks of the model stay as they are, and a fit
    that does not converge is not tried again; output injection is tried ``from_afar`` only."""
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
    solver_given, solver = solver is not None, Newton() if solver is None else solver
    if not isinstance(solver, Newton) and not _is_ipopt(solver):
        raise OptionError(f"estimate: solver is Newton(...) or Ipopt(...), not {solver!r}")
    deadline = Deadline(solver.time_limit)
    collocated = isinstance(transcription, Collocation)
    if isinstance(solver, Newton) and solver.regression and not collocated:
        raise OptionError("estimate: a regression on states as measured makes sense with Collocation only")
    check_progress("estimate", progress)
    if not isinstance(start, (Mapping, FitResult, type(None))) and not _is_regression(start):
        raise OptionError(f"estimate: start holds values by name, or is a fit, not {start!r}")
    if model.delays and isinstance(transcription, FilterError):
        raise OptionError("FilterError: delays are not supported")

    moving = [_moving(e, model.output_names) for e in experiments]
    for i, experiment in enumerate(experiments):
        # An output that stands still in this experiment may move in another, which then gives its sigma.
        elsewhere = set().union(*moving[:i], *moving[i + 1 :])
        known_sigma = {*noise.known_sigmas(model.output_names), *noise.expressions, *elsewhere}
        experiment.check_for(model.input_names, model.output_names, known_sigma, conditions=model.condition_names)

    if isinstance(transcription, FilterError):
        if not isinstance(start, (Mapping, FitResult, type(None))):
            start = start.as_start()
        with Deadline(transcription.time_limit).in_force():
            return _filtered(model, experiments, transcription, noise, start, progress)

    earlier = None if isinstance(start, (Mapping, type(None))) else Earlier.of(start, noise)
    values = start_values(model, start if isinstance(start, Mapping) else {}, experiments, noise)
    ways = {
        "other_ways": every_way,
        "output_injection": from_afar,
        "smooth_kinks": every_way,
        "solver_given": solver_given,
        "moving_mesh": _may_move(transcription, start),
        "restarts": solver.restarts if isinstance(solver, Newton) else 0,
    }
    by = replace(solver, time_limit=deadline.left())
    with interrupts() as pressed:
        found = estimated(model, experiments, transcription, noise, values, earlier, by, progress, pressed, ways)
        fit = make_fit(model, experiments, noise, transcription, found)
        if pressed() and fit.status != "interrupted":  # whoever called is to know
            fit = replace(fit, status="interrupted", message=HINTS["interrupted"])
    if absent := [f"'{e.name}' without {', '.join(sorted(e._unmeasured))}" for e in experiments if e._unmeasured]:
        listed = "; ".join(absent[:5]) + ("; ..." if len(absent) > 5 else "")
        fit = replace(fit, warnings=(*fit.warnings, f"not every experiment measures all outputs: {listed}"))
    # Without parameters it is there to be looked at; one with parameters was meant to act.
    parameters = {*model.parameter_names}
    if unused := [n for n in model.unused_quantities if parameters.intersection(model.equations[n].symbols)]:
        text = f"no equation uses the quantity {', '.join(unused)}: write its symbol where it acts, or leave it out"
        fit = replace(fit, warnings=(*fit.warnings, text))
    if "time" not in (units := model.units):
        unit, rates = SECONDS.other(units)
        if unit:
            listed = joined(rates[:3])
            text = f"the time of the model is in s, but {listed} are per {unit}: Model(..., time_unit='{unit}')"
            fit = replace(fit, warnings=(*fit.warnings, text))
    if isinstance(start, FitResult) and (worse := _worse_than_start(fit, start)):
        fit = replace(fit, warnings=(worse, *fit.warnings))
    return fit


def _is_ipopt(solver: object) -> TypeGuard[Ipopt]:
    from ..solvers.ipopt import Ipopt

    return isinstance(solver, Ipopt)


def _is_regression(start: object) -> bool:
    if isinstance(start, (Mapping, FitResult, type(None))):
        return False
    from ..regression.equation_error import EquationError

    return isinstance(start, EquationError)


def _may_move(transcription: Transcription, start: object) -> bool:
    """Return whether the mesh may follow the motion: none was asked for, and no path of the states is known."""
    if not isinstance(transcription, Collocation) or _is_regression(start):
        return False
    return transcription.segments is None and transcription.substeps == 1


def _filtered(
    model: Model,
    experiments: Sequence[Experiment],
    transcription: FilterError,
    noise: Noise,
    start: Mapping[str, Any] | FitResult | None,
    progress: bool | Callable[[Iteration], None],
) -> FitResult:
    """Return the fit by the filter-error method, within the limit in force."""
    from .filter_fit import better, doubtful, filter_error
    from .filter_variables import split

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
    refined = fit.refinement is not None and len(fit.refinement.steps) > 1  # another mesh, another likelihood
    same = (
        not refined
        and not fit.smoothing
        and len(fit.records) == len(start.records)
        and all(
            a.measured.keys() == b.measured.keys()
            and all(np.array_equal(z, b.measured[name], equal_nan=True) for name, z in a.measured.items())
            for a, b in pairs
        )
    )
    lost = start.log_likelihood - fit.log_likelihood
    if not same or fit.noise != start.noise or not lost > _LESS:
        return ""
    return (
        f"the log-likelihood is {lost:.4g} below that of the fit it started from, on the same data: this is another, "
        "poorer optimum; start from elsewhere, or with fewer parameters free at once"
    )


def _moving(experiment: Experiment, outputs: Sequence[str]) -> set[str]:
    """Return the outputs that an experiment has and that are not constant there."""
    there = {*experiment.outputs, *experiment.channels}
    return {name for name in outputs if name in there and moves(experiment.output(name))}
