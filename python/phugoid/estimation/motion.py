"""Meshes and state paths from a simulation at the starting parameters, moved along with the estimates, and restarts
from other parameters: where samples are few, the likelihood has many maxima."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..data.experiment import Experiment
from ..errors import EvaluationError
from ..fit_result import FitResult
from ..modelling.model import Model
from ..parameters import Parameter
from ..transcription.collocation import Collocation, Record, Signal, records_of

__all__ = ["Motion", "RestartSearch", "simulated", "starts_known"]

_Array: TypeAlias = NDArray[np.float64]
Paths: TypeAlias = Sequence[tuple[_Array, dict[str, _Array]]]

# Tolerances of the integration whose steps become segments: of the search, and of the last run.
_COARSE, _FINE = 1e-6, 1e-7
# Most steps in a record, and most time of an integration, s.
_MOST, _LONGEST = 2_000, 5.0
# Steps shorter than this part of a record are none.
_APART = 1e-12
# Iterations on one mesh before it is moved, and how often it is. The last mesh has no limit of its own.
_ITERATIONS, _MOVES = 25, 8
# Each step is a segment; of low orders, and where that does not suit, it is divided into more.
_PARTS, _FINEST = {2: 8, 3: 2}, 64
# A mesh suits where outputs differ from those of an integration by less than this part of the residuals.
_SUITS = 0.01
# How often a mesh is divided, at most, where the model cannot be simulated with what it led to.
_DIVISIONS = 3
# Restarts in a row that bring no more than this in log-likelihood, before one for each parameter is added.
_RESTARTS, _GAIN = 10, 1e-3
# Ends of runs that differ by less than this are the same optimum.
_SAME = 0.1
_ONCE = "none of the last {} restarts ended at this optimum again: there may be better ones, which `multistart` seeks"
# A run behind the best goes on where a mesh brings this part of what is missing.
_RATE = 0.1
# What part of the parameters is drawn anew, and of those of which the data say nothing; in decades: how far those
# without bounds go, and how far all move.
_SHARE, _MOST_OF_THEM, _DECADES, _MOVE = 0.3, 0.8, 3.0, 0.5
# Most draws for parameters at which the model can be simulated, and its outputs are others.
_DRAWS = 30


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


def simulated(
    model: Model, experiment: Experiment, values: Sequence[float], left: float | None, tolerance: float = _FINE
) -> Motion | None:
    """Simulate from the model's initial conditions; None where the solution does not exist or takes too long.

    ``values`` of the parameters in the order of the model; ``left``: seconds that are left, None for no limit.
    """
    named = list(zip(model.parameter_names, values, strict=True))
    (record,) = records_of(model, [experiment])
    limit = _LONGEST if left is None else min(_LONGEST, left)
    try:
        _, outputs, steps = _core.simulate(model._core, model.delays.spec, record, named, [], "auto", tolerance, limit)
        if steps.size > _MOST:
            return None
        steps = _apart(steps)
        times = np.unique(np.concatenate([steps, 0.5 * (steps[1:] + steps[:-1])]))
        finer = _resampled(model, experiment, times)
        states, *_ = _core.simulate(model._core, model.delays.spec, finer, named, [], "auto", tolerance, limit)
    except EvaluationError:
        return None
    return Motion(steps, times, states, outputs)


def _apart(steps: _Array) -> _Array:
    """The ends of steps without those that rounding would put into one place."""
    least = _APART * (steps[-1] - steps[0])
    inner = steps[1:-1]
    inner = inner[(np.diff(steps[:-1]) > least) & (steps[-1] - inner > least)]
    return np.concatenate([steps[:1], inner, steps[-1:]])


def _resampled(model: Model, experiment: Experiment, times: _Array) -> Record:
    """The record at other times, its inputs as they are between samples."""
    ((name, t, inputs, outputs, kinds, signals),) = records_of(model, [experiment])
    own: list[Signal | None] = [s or (t, u, 0.0, 0) for s, u in zip(signals, inputs, strict=True)]
    missing: list[_Array] = [np.full(times.size, np.nan) for _ in outputs]
    return name, times, [np.zeros(times.size) for _ in inputs], missing, kinds, own


Solve: TypeAlias = Callable[[Collocation, Paths, Mapping[str, float], int | None], FitResult]


@dataclass(frozen=True)
class RestartSearch:
    """Estimation where samples are few: on meshes that follow the motion, from several parameters.

    ``solve`` estimates on a mesh, from state paths and parameters, with a limit of iterations. ``left`` tells the time.
    """

    solve: Solve
    model: Model
    experiments: Sequence[Experiment]
    transcription: Collocation
    left: Callable[[], float | None]

    def best(self, values: Mapping[str, float], restarts: int | None) -> FitResult | None:
        """Return the best end of a run from ``values`` and of so many restarts from other parameters.

        It is an iterated local search (Lourenço, Martin and Stützle 2003): a restart begins at the best end so far,
        with some of the parameters drawn anew. It ends after so many restarts in a row without a gain: by default ten,
        and one for each parameter. Where the model cannot be simulated at ``values``, parameters are sought where it
        can. None where there are none.
        """
        free = {n: p for n, p in self.model.declared_parameters.items() if not p.fixed and not p.per_experiment}
        # Another start draws other numbers, the same start the same.
        random = np.random.default_rng(zlib.crc32(repr(sorted(values.items())).encode()))
        if restarts is None:
            restarts = _RESTARTS + len(free)
        tolerance = _COARSE if restarts and free else _FINE
        fit = self._from(values, -math.inf, tolerance)
        for draw in range(_DRAWS if fit is None and restarts and free else 0):
            fit = self._from(_elsewhere(draw, values, free, random), -math.inf, tolerance)
            if fit is not None:
                break
        if fit is None:
            return None
        likelihood = self._likelihood(fit)
        iterations, time, without, again = fit.iterations, fit.time, 0, 0
        while without < restarts and free and fit.status not in _STOPPED and self.left() != 0.0:
            at = {n: fit.parameters[n].value if n in fit.parameters else v for n, v in values.items()}
            undetermined = _undetermined(fit)
            for _ in range(_DRAWS):
                others = _elsewhere(without, at, free, random, undetermined)
                runs = self._simulated(others, tolerance)
                # What changes nothing leads back.
                if runs is not None and not _suits(fit, runs):
                    break
            without += 1
            if (other := self._from(others, likelihood, tolerance)) is None:
                continue
            iterations, time = iterations + other.iterations, time + other.time
            if other.status == "interrupted":
                fit = replace(fit, status=other.status, message=other.message)
            elif (reached := self._likelihood(other)) > likelihood + _GAIN:
                again = int(reached - likelihood < _SAME)
                fit, likelihood, without = other, reached, 0
            else:
                again += reached > likelihood - _SAME
        if tolerance > _FINE and fit.status not in _STOPPED and self.left() != 0.0:
            at = {n: e.value for n, e in fit.parameters.items()}
            if (last := self._from(at, -math.inf, _FINE)) is not None and last.status != "time limit":
                fit, iterations, time = last, iterations + last.iterations, time + last.time
        if restarts and not again and fit.feasible:
            fit = replace(fit, warnings=(*fit.warnings, _ONCE.format(without)))
        return replace(fit, iterations=iterations, time=time)

    def _likelihood(self, fit: FitResult) -> float:
        """Return the log-likelihood of an end, where the equations have a solution with its parameters.

        A path on a mesh that is too coarse may cross a pole of the solution; then it is -inf, as without a path.
        """
        at = {n: e.value for n, e in fit.parameters.items()}
        known = fit.feasible and self._simulated(at, _COARSE) is not None
        return fit.log_likelihood if known else -math.inf

    def _simulated(self, values: Mapping[str, float], tolerance: float) -> list[Motion] | None:
        """Simulate all experiments; None where one of them has no solution."""
        found = []
        for e in self.experiments:
            run = simulated(self.model, e, _values(self.model, values, e.name), self.left(), tolerance)
            if run is None:
                return None
            found.append(run)
        return found

    def _from(self, values: Mapping[str, float], best: float, tolerance: float) -> FitResult | None:
        """Estimate on meshes that follow the motion: the steps of an integration with the parameters as they are.

        With few samples these say nothing of where a mesh must be fine, and a path that starts as a solution of the
        equations can be kept one. A run that is behind the ``best`` log-likelihood and does not gain on it from one
        mesh to the next ends early. None where the model cannot be simulated at the starting parameters, or has no
        finite derivatives there.
        """
        model, at = self.model, dict(values)
        fit: FitResult | None = None
        iterations, time, divisions = 0, 0.0, 0
        parts = _PARTS.get(self.transcription.order, 1)
        for move in range(_MOVES + 1):
            last = move == _MOVES
            if (runs := self._simulated(at, tolerance)) is not None:
                if fit is not None and fit.status not in _UNFINISHED:
                    if _suits(fit, runs) or parts > _FINEST:
                        break
                    parts *= 2
                ends = [_divided(r.steps, parts) for r in runs]
                paths = [(r.times, dict(zip(model.state_names, r.states, strict=True))) for r in runs]
            else:
                # No mesh to move to. A path across a pole of the solution is one of a mesh that is too coarse.
                divisions += 1
                if fit is None or divisions > _DIVISIONS or not fit.feasible:
                    break
                assert isinstance(fit.transcription, Collocation)
                ends = [_divided(r.mesh_t[:: fit.transcription.order - 1], 2) for r in fit.records]
                paths = [(r.mesh_t, dict(r.mesh_states)) for r in fit.records]
            mesh = replace(self.transcription, segments=tuple(tuple(e.tolist()) for e in ends), refine=False)
            before = fit
            try:
                fit = self.solve(mesh, paths, at, None if last else _ITERATIONS)
            except EvaluationError:
                break
            iterations, time = iterations + fit.iterations, time + fit.time
            if last or fit.status in _STOPPED:
                break
            if before is not None and math.isfinite(best):
                gain = fit.log_likelihood - before.log_likelihood
                if not gain > _RATE * (best - fit.log_likelihood):
                    break
            at = {n: e.value for n, e in fit.parameters.items()}
        return None if fit is None else replace(fit, iterations=iterations, time=time)


def _undetermined(fit: FitResult) -> set[str]:
    """Names of the parameters of which the data say nothing at an end, or no more than how large they are."""
    return {n for n, e in fit.parameters.items() if not e.std_error < abs(e.value)}


def _elsewhere(
    number: int,
    values: Mapping[str, float],
    free: Mapping[str, Parameter],
    random: np.random.Generator,
    undetermined: Collection[str] = (),
) -> dict[str, float]:
    """Draw other parameters, in one of three ways in turn: some of them anew; most of the undetermined ones anew, which
    where they are have no influence, and few others; all of them moved."""
    kind = number % 3
    if kind == 2:
        return _spread_out(values, free, random)
    others, undetermined_ones = (_SHARE, _SHARE) if kind == 0 or not undetermined else (0.5 * _SHARE, _MOST_OF_THEM)
    return _redrawn(values, free, random, {n: undetermined_ones if n in undetermined else others for n in free})


def _redrawn(
    values: Mapping[str, float],
    free: Mapping[str, Parameter],
    random: np.random.Generator,
    shares: Mapping[str, float],
) -> dict[str, float]:
    """Draw parameters anew within their bounds, each with its probability; one at least."""
    names = list(free)
    chosen = random.random(len(names)) < [shares[n] for n in names]
    chosen[random.integers(len(names))] = True
    found = dict(values)
    for name in (n for n, c in zip(names, chosen, strict=True) if c):
        scale = _DrawingScale.of(free[name], values[name])
        low, high = scale.range
        found[name] = scale.value(random.uniform(low, high))
    return found


def _spread_out(
    values: Mapping[str, float], free: Mapping[str, Parameter], random: np.random.Generator
) -> dict[str, float]:
    """Move all parameters, most of them a little and some of them far: by a Cauchy distribution."""
    found = dict(values)
    for name, parameter in free.items():
        scale = _DrawingScale.of(parameter, values[name])
        found[name] = scale.value(scale.at + scale.unit * random.standard_cauchy())
    return found


@dataclass(frozen=True)
class _DrawingScale:
    """The scale on which a parameter is drawn, logarithmic where that is declared: value, range, and the unit of
    its moves."""

    logarithmic: bool
    at: float
    range: tuple[float, float]
    unit: float

    @classmethod
    def of(cls, parameter: Parameter, value: float) -> _DrawingScale:
        logarithmic = parameter.transform == "log" and value > 0.0
        low, high = parameter.bounds
        if logarithmic:
            value = math.log10(value)
            low = math.log10(low) if low > 0.0 else value - _DECADES
            high = math.log10(high) if math.isfinite(high) else value + _DECADES
            return cls(True, value, (low, high), _MOVE)
        size = abs(value) or 1.0
        unit = 0.1 * (high - low) if math.isfinite(high - low) else size
        low, high = (v if math.isfinite(v) else value + s * size for v, s in ((low, -3.0), (high, 3.0)))
        return cls(False, value, (low, high), unit)

    def value(self, x: float) -> float:
        """Return the value of the parameter at x, which is reflected into the range."""
        low, high = self.range
        if not low < high:
            return 10.0**self.at if self.logarithmic else self.at
        x = (x - low) % (2.0 * (high - low))
        x = low + min(x, 2.0 * (high - low) - x)
        return float(10.0**x) if self.logarithmic else float(x)


def _divided(ends: _Array, parts: int) -> _Array:
    """Segment ends with every segment divided into equal parts."""
    return np.interp(np.arange(parts * (ends.size - 1) + 1) / parts, np.arange(ends.size), ends)


_UNFINISHED = ("iteration limit", "infeasible", "diverging")
_STOPPED = ("interrupted", "time limit")


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
        if not np.linalg.norm(off) <= _SUITS * np.linalg.norm(residual):
            return False
    return True
