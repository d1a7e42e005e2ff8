"""Meshes and state paths from a simulation at the starting parameters, moved along with the estimates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..data.experiment import Experiment
from ..errors import EvaluationError
from ..fit_result import FitResult
from ..modelling.model import Model
from ..transcription.collocation import Collocation, Record, Signal, records_of

__all__ = ["Motion", "on_moving_meshes", "simulated", "starts_known"]

_Array: TypeAlias = NDArray[np.float64]
Paths: TypeAlias = Sequence[tuple[_Array, dict[str, _Array]]]

# Tolerance of the integration whose steps become segments, most of these in a record, and most time for it, s.
_TOLERANCE, _MOST, _LONGEST = 1e-7, 2_000, 5.0
# Iterations on one mesh before it is moved, and how often it is. The last mesh has no limit of its own.
_ITERATIONS, _MOVES = 25, 8
# Each step is a segment; of low orders, and where that does not suit, it is divided into more.
_PARTS, _FINEST = {2: 8, 3: 2}, 64
# A mesh suits where outputs differ from those of an integration by less than this part of the residuals.
_SUITS = 0.01


@dataclass(frozen=True)
class Motion:
    """A simulation of one experiment: ends of its steps, times and states there and half-way, outputs at samples."""

    steps: _Array
    times: _Array
    states: list[_Array]
    outputs: list[_Array]


def starts_known(model: Model, given: Mapping[str, object]) -> bool:
    """Whether the parameters tell all states at the first sample."""
    said = {state for end, state, *_ in model._core.conditions if end == "initial"}
    return said.issuperset(model.state_names) and not any(n in given for n in model.state_names)


def simulated(model: Model, experiment: Experiment, values: Sequence[float], left: float | None) -> Motion | None:
    """Simulate from the model's initial conditions; None where the solution does not exist or takes too long.

    ``values`` of the parameters in the order of the model; ``left``: seconds that are left, None for no limit.
    """
    named = list(zip(model.parameter_names, values, strict=True))
    (record,) = records_of(model, [experiment])
    limit = _LONGEST if left is None else min(_LONGEST, left)
    try:
        _, outputs, steps = _core.simulate(model._core, model.delays.spec, record, named, [], "auto", _TOLERANCE, limit)
        if steps.size > _MOST:
            return None
        times = np.sort(np.concatenate([steps, 0.5 * (steps[1:] + steps[:-1])]))
        finer = _resampled(model, experiment, times)
        states, *_ = _core.simulate(model._core, model.delays.spec, finer, named, [], "auto", _TOLERANCE, limit)
    except EvaluationError:
        return None
    return Motion(steps, times, states, outputs)


def _resampled(model: Model, experiment: Experiment, times: _Array) -> Record:
    """The record at other times, its inputs as they are between samples."""
    ((name, t, inputs, outputs, kinds, signals),) = records_of(model, [experiment])
    own: list[Signal | None] = [s or (t, u, 0.0, 0) for s, u in zip(signals, inputs, strict=True)]
    missing: list[_Array] = [np.full(times.size, np.nan) for _ in outputs]
    return name, times, [np.zeros(times.size) for _ in inputs], missing, kinds, own


def on_moving_meshes(
    solve: Callable[[Collocation, Paths, Mapping[str, float], int | None], FitResult],
    model: Model,
    experiments: Sequence[Experiment],
    transcription: Collocation,
    values: Mapping[str, float],
    left: Callable[[], float | None],
) -> FitResult | None:
    """Estimate on meshes that follow the motion: the steps of an integration with the parameters as they are.

    ``solve`` estimates on a mesh, from state paths and parameters, with a limit of iterations. With few samples these
    say nothing of where a mesh must be fine, and a path that starts as a solution of the equations can be kept one.
    None where there is no simulation to begin with. ``values`` are the starting parameters, ``left`` tells the time.
    """
    fit: FitResult | None = None
    at = dict(values)
    iterations, time = 0, 0.0
    parts = _PARTS.get(transcription.order, 1)
    for move in range(_MOVES + 1):
        last = move == _MOVES
        found = [simulated(model, e, _values(model, at, e.name), left()) for e in experiments]
        runs = [each for each in found if each is not None]
        if len(runs) == len(found):
            if fit is not None and fit.status not in _UNFINISHED:
                if _suits(fit, runs) or parts > _FINEST:
                    break
                parts *= 2
            ends = [_divided(r.steps, parts) for r in runs]
            paths = [(r.times, dict(zip(model.state_names, r.states, strict=True))) for r in runs]
        elif fit is None:
            return None
        else:
            # No mesh to move to. A path across a pole of the solution is one of a mesh that is too coarse.
            assert isinstance(fit.transcription, Collocation)
            ends = [_divided(r.mesh_t[:: fit.transcription.order - 1], 2) for r in fit.records]
            paths = [(r.mesh_t, dict(r.mesh_states)) for r in fit.records]
            last = True
        mesh = replace(transcription, segments=tuple(tuple(e.tolist()) for e in ends), refine=False)
        fit = solve(mesh, paths, at, None if last else _ITERATIONS)
        iterations, time = iterations + fit.iterations, time + fit.time
        if last or fit.status in ("interrupted", "time limit"):
            break
        at = {n: e.value for n, e in fit.parameters.items()}
    return None if fit is None else replace(fit, iterations=iterations, time=time)


def _divided(ends: _Array, parts: int) -> _Array:
    """Segment ends with every segment divided into equal parts."""
    return np.interp(np.arange(parts * (ends.size - 1) + 1) / parts, np.arange(ends.size), ends)


_UNFINISHED = ("iteration limit", "infeasible", "diverging")


def _values(model: Model, at: Mapping[str, float], experiment: str) -> list[float]:
    """Values of the model's parameters in an experiment, fixed ones as declared."""
    declared = model.declared_parameters
    return [at.get(f"{n}[{experiment}]", at.get(n, declared[n].start)) for n in model.parameter_names]


def _suits(fit: FitResult, runs: Sequence[Motion]) -> bool:
    """Whether the outputs of a fit are those of the integration."""
    if not fit.feasible:
        return False
    for i, name in enumerate(fit.model.output_names):
        there = [np.isfinite(r.measured[name]) for r in fit.records]
        off = np.concatenate(
            [(r.outputs[name] - m.outputs[i])[k] for r, m, k in zip(fit.records, runs, there, strict=True)]
        )
        residual = np.concatenate([r.residuals[name][k] for r, k in zip(fit.records, there, strict=True)])
        if not np.sqrt(np.mean(off**2)) <= _SUITS * np.sqrt(np.mean(residual**2)):
            return False
    return True
