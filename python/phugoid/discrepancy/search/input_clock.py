"""Inputs that were recorded by another clock than the outputs: late by a constant time, and by more as time goes on.

Two recorders without a common time base differ by an offset and by a rate. An offset is a delay, which is among the
candidates; a rate is not, and looks like a delay, a lag, or an effectiveness that drifts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...data.filtering import interpolated
from ...sensitivities import Place
from ...sensitivities.whitened import Whitened
from .refit import Refit, fitted_to
from .scan import white_noise

__all__ = ["InputClock", "input_clock"]

_Array = NDArray[np.float64]

# Iterations of the estimate; the change of the delay that ends it, and the largest of one iteration, in samples.
_ITERATIONS, _ENOUGH, _FARTHEST = 10, 0.02, 40.0
# Part of the squares of the residuals that the first iteration must promise to take away.
_SHARE = 0.1
# A clock has a rate of its own where that moves the end of a record by more samples than this.
_LEAST = 1.0


@dataclass(frozen=True)
class InputClock:
    """A clock of recorded inputs: what happens at ``t`` is recorded as of ``t + late + rate (t - t0)``, with ``t0`` the
    first time of a record.

    names  of the inputs.
    late   s.
    rate   s per s; ``error``: its standard error.
    until  s, how late inputs are at the end of the longest record.
    """

    names: tuple[str, ...]
    late: float = 0.0
    rate: float = 0.0
    error: float = float("nan")
    until: float = 0.0

    def on(self, data: Sequence[Experiment]) -> list[Experiment]:
        """Return records with the inputs by the clock of the outputs; beyond their ends inputs keep their values."""
        return [self._on(e) for e in data]

    def _on(self, e: Experiment) -> Experiment:
        recorded, signals = self._recorded(e, e.t), dict(e._signals_of())
        moved = e.with_channels({n: _at(e, n, recorded) for n in self.names})
        if not signals.keys() & {*self.names}:
            return moved
        for name in signals.keys() & {*self.names}:
            t, _, delay, order = signals[name]
            at = np.union1d(t, e.t[[0, -1]])
            signals[name] = at, _at(e, name, self._recorded(e, at)), delay, order
        same = moved._stepped("inputs by the clock of the outputs", moved._columns_of(), signals)
        return same._sampled(signals, e.mesh_times)

    def _recorded(self, e: Experiment, t: _Array) -> _Array:
        """Return the times (N,) as of which is recorded what happens at ``t``."""
        return np.asarray(t + self.late + self.rate * (t - e.t[0]))


def _at(e: Experiment, name: str, t: _Array) -> _Array:
    """Return an input of a record at times (N,); beyond its ends the values there."""
    at, u = e.samples(name)
    return interpolated("hold" if e.interpolation_of(name) == "hold" else "linear", at, u, np.clip(t, at[0], at[-1]))


def input_clock(
    base: Refit, names: Sequence[str], data: Sequence[Experiment], least: float
) -> tuple[InputClock, Refit] | None:
    """Return the likeliest clock of some inputs, and the fit with them by the clock of the outputs; None where a
    constant delay does within ``least`` of it in log-likelihood, or such a model cannot be fitted."""
    both = _settled(base, InputClock(tuple(names)), data, least, True)
    if both is None or abs(both[0].rate) * _duration(data) < _LEAST * _interval(data):
        return None
    # From there the nearest constant delay: that of the middle of the record.
    middle = replace(both[0], late=both[0].late + 0.5 * both[0].rate * _duration(data), rate=0.0)
    delayed = _settled(base, middle, data, None, False)
    before = max(base.merit, delayed[1].merit if delayed is not None else -np.inf)
    clock, refit = both
    if refit.merit - before < least:
        return None
    step = _step(refit, refit.own, clock, data, True)
    error = step.error if step is not None else float("nan")
    return replace(clock, error=error, until=clock.late + clock.rate * _duration(data)), refit


def _duration(data: Sequence[Experiment]) -> float:
    return max(float(e.t[-1] - e.t[0]) for e in data)


def _interval(data: Sequence[Experiment]) -> float:
    return max(float(np.median(np.diff(e.t))) for e in data)


def _settled(
    base: Refit, clock: InputClock, data: Sequence[Experiment], least: float | None, rate: bool
) -> tuple[InputClock, Refit] | None:
    """Return a clock estimated by the Gauss-Newton method, about a new fit at each step, with a rate or without; None
    where a fit fails or the first step promises less than ``least`` in log-likelihood or next to nothing."""
    at, interval, duration = base, _interval(data), _duration(data)
    best: tuple[InputClock, Refit] | None = None
    for k in range(_ITERATIONS):
        step = _step(at, Whitened(at.linear, white_noise(at.linear)), clock, data, rate)
        if step is None or (k == 0 and least is not None and step.gain < max(least, 0.5 * _SHARE * at.linear.n_rows)):
            break
        farthest = _FARTHEST * interval
        late = float(np.clip(step.late, -farthest, farthest))
        more = float(np.clip(step.rate, -farthest / duration, farthest / duration))
        clock = replace(clock, late=clock.late + late, rate=clock.rate + more)
        found = fitted_to(base, clock.on(data), start=at.fit)
        if found is None:
            break
        at = found
        if best is None or found.merit > best[1].merit:
            best = clock, found
        if max(abs(late), abs(more) * duration) < _ENOUGH * interval:
            break
    return best


class _Step(NamedTuple):
    """A change of a clock, in s and s per s; the standard error of its rate; and the gain in log-likelihood."""

    late: float
    rate: float
    error: float
    gain: float


def _step(at: Refit, seen: Whitened, clock: InputClock, data: Sequence[Experiment], rate: bool) -> _Step | None:
    """Return by how much the delay (and the rate) of a clock are to change, to first order about a fit; None where that
    does nothing."""
    linear, interval, duration = at.linear, _interval(data), _duration(data)
    moved = [replace(clock, late=clock.late + interval)]
    if rate:
        moved.append(replace(clock, rate=clock.rate + interval / duration))
    before, after = clock.on(data), [c.on(data) for c in moved]
    columns = np.zeros((len(moved), linear.n_rows))
    for name in clock.names:
        signals = [
            np.stack([np.interp(p.t, e.t, other[k].input(name) - e.input(name)) for other in after])
            for k, (p, e) in enumerate(zip(linear.points, before, strict=True))
        ]
        columns += linear.answers(Place("input", name), signals)
    c = seen.filter(columns)
    c = c - (c @ seen.basis) @ seen.basis.T
    gram = c @ c.T
    if not np.all(np.isfinite(gram)) or np.linalg.matrix_rank(gram) < len(moved):
        return None
    along = c @ seen.errors
    by = np.linalg.solve(gram, along)
    unit = np.array([interval, interval / duration])[: len(moved)]
    error = float(np.sqrt(np.linalg.inv(gram)[-1, -1]) * unit[-1])
    late, more = np.append(by * unit, 0.0)[:2].tolist()
    return _Step(late, more, error, 0.5 * float(along @ by))
