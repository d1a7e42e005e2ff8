"""Inputs or outputs that were recorded with another clock than the rest: with an offset of time that changes during the
record.

Two recorders without a common time base differ by an offset and by a rate. An offset is a delay, which is among the
candidates; a rate is not, and looks like a delay, a lag, or an effectiveness that drifts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...data.filtering import interpolated
from ...sensitivities import Place
from ...sensitivities.whitened import Whitened
from .refit import Refit, fitted_to
from .scan import white_noise

__all__ = ["Clock", "alike", "other_clock"]

_Array = NDArray[np.float64]

# Iterations of the estimate; the change of the delay that ends it, and the largest of one iteration, in samples.
_ITERATIONS, _ENOUGH, _FARTHEST = 10, 0.02, 40.0
# Part of the squares of the residuals that the first iteration must promise to take away.
_SHARE = 0.1
# A clock has a rate of its own where that moves the end of a record by more samples than this.
_LEAST = 1.0
# Samples on either side from which the slope of an output is estimated.
_NEAR = 3
# Standard errors by which a rate differs from zero, or two from each other.
_SURE = 3.0


@dataclass(frozen=True)
class Clock:
    """A clock of recorded channels: what happens at ``t`` is recorded as of ``t + late + rate (t - t0)``, with ``t0``
    the first time of a record.

    kind   of the channels.
    names  theirs.
    late   s.
    rate   s per s; ``error``: its standard error.
    until  s, how late they are at the end of the longest record.
    """

    kind: Literal["input", "output"]
    names: tuple[str, ...]
    late: float = 0.0
    rate: float = 0.0
    error: float = float("nan")
    until: float = 0.0

    def on(self, data: Sequence[Experiment]) -> list[Experiment]:
        """Return records with these channels by the clock of the others; beyond their ends inputs keep their values,
        and outputs have none."""
        return [self._outputs_on(e) if self.kind == "output" else self._on(e) for e in data]

    def known(self, data: Sequence[Experiment]) -> list[Experiment]:
        """Return the records as they are, without the samples of outputs that those by the clock of the others lack."""
        if self.kind == "input":
            return list(data)
        lacking = [
            (e, {n: np.isnan(moved.output(n)) for n in self.names})
            for e, moved in zip(data, self.on(data), strict=True)
        ]
        return [
            e.with_channels({n: np.where(out, np.nan, e.output(n)) for n, out in each.items()}) for e, each in lacking
        ]

    def _outputs_on(self, e: Experiment) -> Experiment:
        """Return a record with outputs by the clock of the others."""
        at = self._recorded(e, e.t)
        there = (at >= e.t[0] - 0.5 * (e.t[1] - e.t[0])) & (at <= e.t[-1] + 0.5 * (e.t[-1] - e.t[-2]))
        place = np.interp(at, e.t, np.arange(e.n))
        return e.with_channels({n: np.where(there, _moved(e.output(n), place), np.nan) for n in self.names})

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


def _moved(y: _Array, place: _Array) -> _Array:
    """Return samples (N,) at places between them: the nearest, moved along a line through its neighbours, since a
    mean of two samples would have less noise than one."""
    nearest = np.rint(place).astype(np.intp)
    padded = np.pad(y, _NEAR, mode="edge")
    slopes = sum(k * (padded[_NEAR + k :][: y.size] - padded[_NEAR - k :][: y.size]) for k in range(1, _NEAR + 1))
    slopes = np.nan_to_num(slopes / (2.0 * sum(k * k for k in range(1, _NEAR + 1))))
    return np.asarray(y[nearest] + (place - nearest) * slopes[nearest])


def _at(e: Experiment, name: str, t: _Array) -> _Array:
    """Return an input of a record at times (N,); beyond its ends the values there."""
    at, u = e.samples(name)
    return interpolated("hold" if e.interpolation_of(name) == "hold" else "linear", at, u, np.clip(t, at[0], at[-1]))


def alike(base: Refit, names: Sequence[str], data: Sequence[Experiment]) -> list[str]:
    """Return the outputs that seem to have been recorded by the clock of that which gains most by one of its own, to
    first order; empty where none or all seem so."""
    steps = {}
    for name in names:
        step = _step(base, Whitened(base.linear, white_noise(base.linear)), Clock("output", (name,)), data, True)
        if step is not None and abs(step.rate) > _SURE * step.error:
            steps[name] = step
    if not steps:
        return []
    first = max(steps.values(), key=lambda s: s.gain)
    same = [n for n, s in steps.items() if abs(s.rate - first.rate) < _SURE * np.hypot(s.error, first.error)]
    return same if len(same) < len(names) else []


def other_clock(base: Refit, of: Clock, data: Sequence[Experiment], least: float) -> tuple[Clock, Refit, float] | None:
    """Return the likeliest clock of the channels of another one, the fit with them by the clock of the others, and its
    gain in log-likelihood; None where a constant delay does within ``least`` of it, or no such model can be fitted."""
    both = _settled(base, of, data, least, True)
    if both is None or abs(both[0].rate) * _duration(data) < _LEAST * _interval(data):
        return None
    # From there the nearest constant delay: that of the middle of the record.
    middle = replace(both[0], late=both[0].late + 0.5 * both[0].rate * _duration(data), rate=0.0)
    delayed = _settled(base, middle, data, None, False)
    gain = _gain(base, both, data)
    if gain - max(_gain(base, delayed, data) if delayed is not None else 0.0, 0.0) < least:
        return None
    clock, refit = both
    step = _step(refit, refit.own, clock, data, True)
    error = step.error if step is not None else float("nan")
    return replace(clock, error=error, until=clock.late + clock.rate * _duration(data)), refit, gain


def _gain(base: Refit, found: tuple[Clock, Refit], data: Sequence[Experiment]) -> float:
    """Return the gain in log-likelihood by a clock, on the samples that records have with it and without."""
    clock, refit = found
    same = base if clock.kind == "input" else fitted_to(base, clock.known(data))
    return refit.merit - same.merit if same is not None else -np.inf


def _duration(data: Sequence[Experiment]) -> float:
    return max(float(e.t[-1] - e.t[0]) for e in data)


def _interval(data: Sequence[Experiment]) -> float:
    return max(float(np.median(np.diff(e.t))) for e in data)


def _settled(
    base: Refit, clock: Clock, data: Sequence[Experiment], least: float | None, rate: bool
) -> tuple[Clock, Refit] | None:
    """Return a clock estimated by the Gauss-Newton method, about a new fit at each step, with a rate or without; None
    where a fit fails or the first step promises less than ``least`` in log-likelihood or next to nothing."""
    at, interval, duration = base, _interval(data), _duration(data)
    best: tuple[Clock, Refit] | None = None
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


def _step(at: Refit, seen: Whitened, clock: Clock, data: Sequence[Experiment], rate: bool) -> _Step | None:
    """Return by how much the delay (and the rate) of a clock are to change, to first order about a fit; None where that
    does nothing."""
    linear, interval, duration = at.linear, _interval(data), _duration(data)
    columns = np.zeros((2 if rate else 1, linear.n_rows))
    for name, signals in _signals(at, clock, data, rate).items():
        columns += linear.answers(Place(clock.kind, name), signals)
    c = seen.filter(columns)
    c = c - (c @ seen.basis) @ seen.basis.T
    gram = c @ c.T
    if not np.all(np.isfinite(gram)) or np.linalg.matrix_rank(gram) < len(gram):
        return None
    along = c @ seen.errors
    by = np.linalg.solve(gram, along)
    unit = np.array([interval, interval / duration])[: len(gram)]
    error = float(np.sqrt(np.linalg.inv(gram)[-1, -1]) * unit[-1])
    late, more = np.append(by * unit, 0.0)[:2].tolist()
    return _Step(late, more, error, 0.5 * float(along @ by))


def _signals(at: Refit, clock: Clock, data: Sequence[Experiment], rate: bool) -> dict[str, list[_Array]]:
    """Return for each channel, and each record, what changes in it with a delay by one interval, and with a rate that
    makes so much of the whole duration, (2, points); without ``rate`` the first alone."""
    interval, duration, points = _interval(data), _duration(data), at.linear.points
    if clock.kind == "output":
        # By the path of the model: the samples have noise.
        found = {}
        for name in clock.names:
            slopes = [
                np.gradient(np.interp(p.t, r.t, r.outputs[name]), p.t)
                for p, r in zip(points, at.fit.records, strict=True)
            ]
            shares = [np.stack([np.ones(p.n), (p.t - p.t[0]) / duration]) for p in points]
            found[name] = [-interval * (share * slope)[: 1 + rate] for share, slope in zip(shares, slopes, strict=True)]
        return found
    moved = [replace(clock, late=clock.late + interval)]
    if rate:
        moved.append(replace(clock, rate=clock.rate + interval / duration))
    before, after = clock.on(data), [c.on(data) for c in moved]
    return {
        name: [
            np.stack([np.interp(p.t, e.t, other[k].input(name) - e.input(name)) for other in after])
            for k, (p, e) in enumerate(zip(points, before, strict=True))
        ]
        for name in clock.names
    }
