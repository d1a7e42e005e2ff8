"""Start values of an estimation: parameters as declared, states as measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .data.experiment import Experiment
from .errors import DataError, ModelError, finite
from .modelling.model import Model
from .modelling.noise import Noise, positive
from .transcription import records_of

__all__ = [
    "check_names",
    "measured_states",
    "parameter_start",
    "spread",
    "start_values",
    "state_start",
]

_Array = NDArray[np.float64]


def check_names(
    model: Model, start: Mapping[str, Any], experiments: Sequence[Experiment] = (), noise: Sequence[str] = ()
) -> None:
    """Raise ModelError for a start with a name that is not a parameter, sigma or state, and none of ``noise``."""
    _core.check_start(model._core, [str(name) for name in start], [e.name for e in experiments], list(noise))


def parameter_start(model: Model, start: Mapping[str, Any], experiment: str | None = None) -> dict[str, float]:
    """Return starting values of the model's parameters: as declared, or as given, those of one experiment included."""
    given = _parameters(model, start, [] if experiment is None else [experiment])
    return dict(zip(model.parameter_names, _core.parameter_start(model._core, given, experiment), strict=True))


def measured_states(model: Model, parameters: Mapping[str, float]) -> dict[str, tuple[str, float, float]]:
    """Return for each state that an output measures the output, offset and slope: z = offset + slope * x.

    An output measures a state where it depends on no other state, input or time, and on this one linearly
    (``q + bias``, ``scale*alpha``), with the parameters at their start.
    """
    found = model._core.measured_states([parameters[name] for name in model.parameter_names])
    return {state: (output, offset, slope) for state, output, offset, slope in found}


def state_start(
    model: Model,
    experiment: Experiment,
    times: _Array,
    parameters: Mapping[str, float],
    start: Mapping[str, Any],
) -> _Array:
    """Return starting states at mesh points, shape (n_x, points).

    In order of preference: given in ``start`` (a number, or an array over the samples); measured; as declared (`State`,
    `Model.initial`); zero. Within the bounds of the states.
    """
    (record,) = records_of(model, [experiment])
    given = _states(model, start, [experiment])
    return np.array(_core.state_start(model._core, record, times, list(parameters.values()), given))


def start_values(
    model: Model, start: Mapping[str, Any], experiments: Sequence[Experiment], noise: Noise
) -> list[tuple[str, float | list[_Array]]]:
    """Return what is given by name as the core takes it: numbers, and for states one value a sample.

    Raises ModelError for names that are none of the model, its noise and the experiments, and for what is not a number.
    """
    names = noise.names(model.output_names)
    check_names(model, start, experiments, names)
    given = [*_parameters(model, start, [e.name for e in experiments]), *_states(model, start, experiments)]
    taken = {name for name, _ in given}
    for name in (name for name in start if name not in taken):
        value = start[name]
        if name.startswith("sigma_") and not positive(value):
            raise ModelError(f"the start of {name} is a positive number, not {value!r}")
        if not isinstance(value, Real) or isinstance(value, bool) or not np.isfinite(float(value)):
            raise ModelError(f"the start of {name} is a number, not {value!r}")
        given.append((name, float(value)))
    return given


def _parameters(model: Model, start: Mapping[str, Any], experiments: Sequence[str]) -> list[tuple[str, float]]:
    """Return what is given for parameters; ModelError for what is not a finite number."""
    names = list(model.parameter_names)
    names += [f"{n}[{e}]" for n, p in model.declared_parameters.items() if p.per_experiment for e in experiments]
    given = []
    for name in names:
        if name in start:
            given.append((name, finite(f"start: '{name}'", start[name], ModelError)))
    return given


def _states(
    model: Model, start: Mapping[str, Any], experiments: Sequence[Experiment]
) -> list[tuple[str, float | list[_Array]]]:
    """Return what is given for states: a number, or one value a sample of each experiment.

    Raises DataError for anything else.
    """
    given: list[tuple[str, float | list[_Array]]] = []
    for name in model.state_names:
        if name not in start:
            continue
        value = start[name]
        try:
            array: Any = np.ascontiguousarray(value, dtype=np.float64) if np.ndim(value) else np.float64(value)
        except (TypeError, ValueError):
            raise DataError(f"start: state '{name}' is {value!r}, not a number or one value a sample") from None
        for experiment in experiments:
            if array.ndim and array.shape != (experiment.n,):
                raise DataError(
                    f"start: state '{name}' has shape {array.shape}; give a number or one value a sample "
                    f"({experiment.n})"
                )
            if not np.isfinite(array).all():
                i = int(np.flatnonzero(~np.isfinite(np.atleast_1d(array)))[0])
                raise DataError(
                    f"start: state '{name}' is {np.atleast_1d(array)[i]} at sample {i} (t = {experiment.t[i]})"
                )
        given.append((name, [array] * len(experiments) if array.ndim else float(array)))
    return given


def spread(experiments: Sequence[Experiment], output: str) -> float:
    """Return the standard deviation of the measurements of an output over all experiments, the scale of its noise."""
    values = np.concatenate([e.output(output) for e in experiments])
    values = values[np.isfinite(values)]
    return float(values.std()) or 1.0
