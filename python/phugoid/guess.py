"""Where an estimation starts: parameters as declared, states as measured."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _core
from ._core import Expr
from .data.experiment import Experiment
from .errors import DataError, ModelError, did_you_mean
from .modelling.model import Model

__all__ = ["check_names", "declared_paths", "further_starts", "measured_states", "parameter_start", "state_start"]

_Array = NDArray[np.float64]

# Where states are tried of which nothing is known, if the model has no finite derivatives at 0.
_ELSEWHERE = (1.0, 10.0, 0.1, -1.0)


def check_names(
    model: Model, start: Mapping[str, Any], experiments: Sequence[Experiment] = (), noise: Sequence[str] = ()
) -> None:
    """Raises ModelError for a start that names nothing: not a parameter, a sigma or a state; nor one of ``noise``."""
    known = [*model.parameter_names, *(f"sigma_{n}" for n in model.output_names), *noise, *model.state_names]
    local = [name for name, p in model.declared_parameters.items() if p.per_experiment]
    known += [f"{name}[{e.name}]" for name in local for e in experiments]
    for name in start:
        if name not in known:
            raise ModelError(f"start: '{name}' is no parameter, sigma or state.{did_you_mean(name, known)}")


def parameter_start(model: Model, start: Mapping[str, Any], experiment: str | None = None) -> dict[str, float]:
    """Starting values of the model's parameters: as declared, or as given, if need be for this experiment alone."""
    values: dict[str, float] = {}
    for name, p in model.declared_parameters.items():
        given = start.get(name, p.start)
        if p.per_experiment:
            given = start.get(f"{name}[{experiment}]", given)
        try:
            value = float(given)
        except (TypeError, ValueError):
            value = float("nan")
        if not np.isfinite(value):
            raise ModelError(f"start: '{name}' is {given!r}, not a finite number")
        if not p.bounds[0] <= value <= p.bounds[1]:
            raise ModelError(f"start: '{name}' = {value} lies outside its bounds {p.bounds}; move one of them")
        if p.fixed and value != p.start:
            raise ModelError(f"start: '{name}' is fixed at {p.start} and cannot start at {value}")
        values[name] = value
    return values


def measured_states(model: Model, parameters: Mapping[str, float]) -> dict[str, tuple[str, float, float]]:
    """For each state that an output measures: the output, offset and slope, z = offset + slope * x.

    An output measures a state where it depends on no other state, input or time, and on this one linearly
    (``q + bias``, ``scale*alpha``), with the parameters at their start.
    """
    found: dict[str, tuple[str, float, float]] = {}
    varying = {*model.state_names, *model.input_names, "time"}
    for output, expression in model.output_expressions().items():
        e = Expr(expression)
        names = varying.intersection(e.symbols)
        if len(names) != 1:
            continue
        (state,) = names
        if state not in model.state_names or state in found:
            continue
        slope = e.diff(state)
        if varying.intersection(slope.symbols):
            continue
        numbers = {**parameters, state: 0.0}
        b = slope.evaluate({n: numbers[n] for n in slope.symbols})
        a = e.evaluate({n: numbers[n] for n in e.symbols})
        if np.isfinite(a) and np.isfinite(b) and b != 0:
            found[state] = (output, a, b)
    return found


def state_start(
    model: Model,
    experiment: Experiment,
    times: _Array,
    parameters: Mapping[str, float],
    start: Mapping[str, Any],
) -> _Array:
    """Starting states at mesh points, shape (n_x, points).

    In order of preference: given in ``start`` (a number, or an array over the samples); measured; as declared (`State`,
    `Model.initial`); zero. Within the bounds of the states.
    """
    measured, declared = measured_states(model, parameters), declared_paths(model, parameters)
    states = np.zeros((len(model.state_names), times.size))
    for i, (name, state) in enumerate(model.declared_states.items()):
        states[i] = declared.get(name, 0.0)
        if name in start:
            states[i] = _given(name, start[name], experiment, times)
        elif name in measured:
            output, a, b = measured[name]
            z = experiment.output(output)
            present = np.isfinite(z)
            values = (z[present] - a) / b
            states[i] = _core.interpolate("linear", experiment.t[present].tolist(), values.tolist(), times.tolist())
        states[i] = np.clip(states[i], *state.bounds)
    return states


def declared_paths(model: Model, parameters: Mapping[str, float]) -> dict[str, float]:
    """Where states start whose start is declared, or whose initial value follows from the parameters alone."""
    found: dict[str, float] = {}
    for end, name, e, _ in model._core.conditions:
        if end == "initial" and set(e.symbols) <= set(parameters):
            value = e.evaluate({n: parameters[n] for n in e.symbols})
            if np.isfinite(value):
                found[name] = value
    return found | {name: s.start for name, s in model.declared_states.items() if s.start is not None}


def further_starts(
    model: Model, problem: _core.Problem, xi: _Array, parameters: Mapping[str, float], given: Collection[str]
) -> list[_Array]:
    """The points to start from instead of ``xi``, where that makes no sense.

    States that are neither given nor measured nor declared start at 0, where a square root has no derivative, and which
    may be outside their bounds. Here they start at each of a few values at which all is finite. Empty where ``xi``
    does, or where nothing helps.
    """
    known = {*given, *measured_states(model, parameters), *declared_paths(model, parameters)}
    unknown = [i for i, name in enumerate(model.state_names) if name not in known]
    bounds = list(model.declared_states.values())
    inside = all(bounds[i].bounds[0] < 0 < bounds[i].bounds[1] for i in unknown)
    if not unknown or (inside and _finite(problem, xi)):
        return []
    found: list[_Array] = []
    for value in _ELSEWHERE:
        trial = xi.copy()
        for i in unknown:
            trial[problem.n_theta + i :: len(bounds)] = np.clip(value, *bounds[i].bounds)
        if _finite(problem, trial) and not any(np.array_equal(trial, other) for other in found):
            found.append(trial)
    return found


def _finite(problem: _core.Problem, xi: _Array) -> bool:
    finite = np.isfinite(problem.objective(xi)) and problem.constraints(xi) is not None
    return bool(finite and problem.jacobian(xi) is not None and problem.gradient(xi) is not None)


def _given(name: str, value: Any, experiment: Experiment, times: _Array) -> _Array:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise DataError(f"start: state '{name}' is {value!r}, not a number or one value a sample") from None
    if array.ndim == 0:
        array = np.full(experiment.n, float(array))
    if array.shape != (experiment.n,):
        raise DataError(
            f"start: state '{name}' has shape {array.shape}; give a number or one value a sample ({experiment.n})"
        )
    if not np.isfinite(array).all():
        i = int(np.flatnonzero(~np.isfinite(array))[0])
        raise DataError(f"start: state '{name}' is {array[i]} at sample {i} (t = {experiment.t[i]} s)")
    return np.array(_core.interpolate("linear", experiment.t.tolist(), array.tolist(), times.tolist()))


def spread(experiments: Sequence[Experiment], output: str) -> float:
    """Standard deviation of the measurements of an output over all experiments: the scale of its noise."""
    values = np.concatenate([e.output(output) for e in experiments])
    values = values[np.isfinite(values)]
    return float(values.std()) or 1.0
