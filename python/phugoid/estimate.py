"""From a model and data to a fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _core
from .errors import DataError, ModelError, OptionError
from .experiment import Experiment, moves
from .filter_error import FilterError
from .filter_fit import filter_error
from .filter_variables import split
from .guess import check_names, measured_states, parameter_start, spread, state_start
from .model import Model
from .noise import Gaussian
from .progress import Progress
from .result import Fit, make_fit
from .solvers import Ipopt, Iteration, Newton, Solution
from .transcription import Collocation

__all__ = ["estimate"]

_Array = NDArray[np.float64]


def estimate(
    model: Model,
    data: Experiment | Sequence[Experiment],
    *,
    transcription: Collocation | FilterError | None = None,
    noise: Gaussian | None = None,
    start: Mapping[str, Any] | Fit | None = None,
    solver: Newton | Ipopt | None = None,
    progress: bool | Callable[[Iteration], None] = False,
) -> Fit:
    """The maximum-likelihood estimate of a model's parameters from measured data (Eq. ml_loglike of the paper).

    ``data``: one experiment or several with shared parameters. Initial states are free.
    ``start``: values by name of parameters, of ``sigma_<output>`` and of states (a number or one value a sample),
    or a fit to go on from. Parameters not named start as declared, standard deviations at the spread of the
    measurements, states as measured where an output measures them and else at 0.
    ``transcription``: `Collocation`, or `FilterError` where there is process noise, such as turbulence; the latter
    has a solver of its own.
    ``noise``: instead of the model's own. ``solver``: `Newton` unless asked otherwise. ``progress``: True prints
    the iterations; a function is called with each.

    Ctrl-C ends the run and returns the best point so far, with status "interrupted".

    Raises ModelError, DataError or OptionError for what cannot be right, EvaluationError where the model is not
    finite at the start. Not to converge is a status of the fit, not an error.
    """
    experiments = _experiments(data)
    if not isinstance(model, Model):
        raise ModelError(f"estimate: the first argument is a Model, not a {type(model).__name__}")
    model.check()
    transcription = transcription or Collocation()
    noise = noise or model.noise_model
    options = {
        "transcription": (transcription, (Collocation, FilterError)),
        "noise": (noise, (Gaussian,)),
    }
    for what, (value, kinds) in options.items():
        if not isinstance(value, kinds):
            raise OptionError(f"estimate: {what} is a {' or a '.join(k.__name__ for k in kinds)}, not {value!r}")
    if isinstance(transcription, FilterError) and solver is not None:
        raise OptionError("estimate: FilterError has a solver of its own; leave out solver")
    solver = solver or Newton()
    if not isinstance(solver, (Newton, Ipopt)):
        raise OptionError(f"estimate: solver is Newton(...) or Ipopt(...), not {solver!r}")
    if not isinstance(progress, bool) and not callable(progress):
        raise OptionError(f"estimate: progress is True, False or a function, not {progress!r}")
    if not isinstance(start, (Mapping, Fit, type(None))):
        raise OptionError(f"estimate: start holds values by name, or is a fit, not {start!r}")

    moving = [_moving(e, model.output_names) for e in experiments]
    for i, experiment in enumerate(experiments):
        # An output that stands still in this experiment may move in another, which then gives its sigma.
        elsewhere = set().union(*moving[:i], *moving[i + 1 :])
        experiment.check_for(model.input_names, model.output_names, {*noise.known, *elsewhere})

    if isinstance(transcription, FilterError):
        if transcription.output_error and not isinstance(start, Fit):
            _, others = split(transcription, start or {})
            ordinary = estimate(model, experiments, noise=noise, start=others, progress=progress)
            return filter_error(model, experiments, transcription, noise, start, progress, ordinary)
        return filter_error(model, experiments, transcription, noise, start, progress)

    warm = start if isinstance(start, Fit) else None
    given: Mapping[str, Any] = warm.as_start() if warm else dict(start or {})  # type: ignore[arg-type]
    check_names(model, given)
    parameters = parameter_start(model, given)
    spreads = {name: spread(experiments, name) for name in model.output_names}
    sigmas = noise.resolve(model.output_names, spreads, given)

    problem = transcription.problem(model, experiments, sigmas)
    xi = starting_point(problem, model, experiments, parameters, sigmas, given, warm)
    known = {*measured_states(model, parameters), *given}.issuperset(model.state_names)
    with Progress.of(progress, model.name) as watch:
        solution = solver.solve(problem, xi, _warm(warm, problem, xi), watch, states_known=known)
    return make_fit(model, experiments, noise, transcription, problem, solution)


def starting_point(
    problem: _core.Collocation,
    model: Model,
    experiments: Sequence[Experiment],
    parameters: Mapping[str, float],
    sigmas: Sequence[tuple[bool, float, float, float]],
    given: Mapping[str, Any],
    warm: Fit | None = None,
) -> _Array:
    """The decision variables to start from: parameters, 1/sigma, states at all points."""
    roots = [1 / value for is_known, value, _, _ in sigmas if not is_known]
    parts = [np.array([*parameters.values(), *roots])]
    for i, experiment in enumerate(experiments):
        times = problem.point_times(i)
        states = state_start(model, experiment, times, parameters, given)
        if warm is not None and i < len(warm.records):
            record = warm.records[i]
            for k, name in enumerate(model.state_names):
                if name in record.mesh_states:
                    path = record.mesh_states[name]
                    states[k] = _core.interpolate("cubic", record.mesh_t.tolist(), path.tolist(), times.tolist())
        parts.append(states.T.ravel())
    return np.concatenate(parts)


def _warm(fit: Fit | None, problem: _core.Collocation, xi: _Array) -> Solution | None:
    """The solution of an earlier fit, where the problem has the same size: its multipliers serve again."""
    if fit is None or fit.solution is None or fit.solution.xi.size != xi.size:
        return None
    return fit.solution if fit.solution.multipliers.size == problem.m else None


def _moving(experiment: Experiment, outputs: Sequence[str]) -> set[str]:
    """The outputs that an experiment has and that are not constant there."""
    there = {*experiment.outputs, *experiment.channels}
    return {name for name in outputs if name in there and moves(experiment.output(name))}


def _experiments(data: Any) -> list[Experiment]:
    experiments = [data] if isinstance(data, Experiment) else list(data) if isinstance(data, (list, tuple)) else None
    if experiments is None or not all(isinstance(e, Experiment) for e in experiments):
        raise DataError("estimate: data is an Experiment or a list of them; make one with ph.read or ph.Experiment")
    if not experiments:
        raise DataError("estimate: the list of experiments is empty")
    names = [e.name for e in experiments]
    if len(set(names)) < len(names):
        twice = next(n for n in names if names.count(n) > 1)
        raise DataError(f"estimate: two experiments are called '{twice}'; give each a name of its own")
    return experiments
