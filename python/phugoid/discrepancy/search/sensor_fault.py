"""Faults of sensors and of their recording that the samples themselves show: a sensor that stays at its last value for
a while, one that is renewed at a lower rate than it is recorded at, an angle that jumps by a turn, and a sensor that
measures a magnitude without its sign."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...estimation import estimate
from ...fit_result import ENDED_WELL, FitResult, dataset, mean_square
from ...functions import smooth_abs
from ...residual_noise import resolution_of
from .recorded_input import noise_of

__all__ = ["SensorFault", "UnsignedSensor", "sensor_faults", "unsigned_sensor", "without_faults"]

_Array = NDArray[np.float64]

# The number of runs of the same value, as long as the least, that chance may be expected to give in a record. Shorter
# ones count where there are so many, and times as many as chance gives, as where a radio link repeats what it lost.
_BY_CHANCE, _MANY, _MORE = 1e-4, 8, 10.0
# Samples from which noise is estimated.
_FEWEST = 12
# A sensor of which more than this part of the samples repeats the one before is not stuck. It is renewed at a lower
# rate where it changes at least so often, and but for this part of the changes within a sample of multiples of an
# interval.
_REPEATED, _RENEWED, _REGULAR = 0.3, 12, 0.05
# Mean product of the signs of neighbouring second differences, -2/3 for their correlation in white noise, below which a
# sensor has noise from sample to sample; and the part of the residuals' mean square that is worth a word.
_ALTERNATING, _LITTLE = -0.2, 0.05
# An angle wraps where it jumps by a turn, within a part of it, and hardly elsewhere.
_TURNS, _WITHIN, _STEP = (2.0 * math.pi, 360.0), 0.1, 0.2
# A sensor that may give no sign: no value below zero by more than so many times its noise, and dips to near zero, of
# which each side rises again to a part of the largest values.
_BELOW, _NEAR_ZERO, _RISES, _DIPS = 5.0, 0.1, 0.3, 2
# Part of the mean square of an output's residuals that a model of its size may leave.
_LEFT_BY_SIZE = 0.25
# Rounding of the size at zero, as a part of its largest values, beside the sensor's noise.
_ROUNDED_SIZE = 0.002


@dataclass(frozen=True)
class SensorFault:
    """A fault of an output's samples.

    name   of the output.
    kind   "stuck": it stays at a value; "held": each value is repeated until the next; "wrapped": it jumps by a turn.
    spans  record, first and last time of each span of a sensor that is stuck, each jump of one that wraps, in s.
    size   a turn in the output's unit; the interval at which it is renewed, s.
    part   of the squares of the output's residuals that are gone without the fault.
    """

    name: str
    kind: Literal["stuck", "held", "wrapped"]
    spans: tuple[tuple[str, float, float], ...] = ()
    size: float = 0.0
    part: float = 0.0

    @property
    def cause(self) -> str:
        """Canonical name."""
        return f"{self.name}:{self.kind}"

    def mended(self, y: _Array) -> _Array:
        """Return the samples (N,) of a record without the fault: those that only repeat others are NaN."""
        y = y.copy()
        if self.kind == "wrapped":
            known = np.isfinite(y)
            y[known] = np.unwrap(y[known], period=self.size)
            return y
        for first, last in _runs(y) if self.kind == "stuck" else _repeats(y):
            y[first + 1 : last + 1] = np.nan
        return y


def sensor_faults(fit: FitResult) -> tuple[list[SensorFault], FitResult]:
    """Return faults that the samples of the outputs show, and the fit to the records without them; none, and the fit as
    it is, where there are none or no such fit."""
    data = dataset(fit)
    found = [fault for name in fit.model.output_names if (fault := _fault(data, name)) is not None]
    if not found:
        return [], fit
    try:
        start = fit if all(f.kind == "stuck" for f in found) else None  # the path of the others is another
        records = without_faults(data, found)
        mended = estimate(fit.model, records, transcription=fit.transcription, noise=fit.noise, start=start)
    except (PhugoidError, np.linalg.LinAlgError):
        return [], fit
    if mended.status == "interrupted":
        raise KeyboardInterrupt
    if mended.status not in ENDED_WELL:
        return [], fit
    reported = [replace(f, part=_part(fit, mended, f.name)) for f in found]
    reported = [f for f in reported if f.part > _LITTLE]
    return (reported, mended) if reported else ([], fit)


def without_faults(data: Sequence[Experiment], faults: Sequence[SensorFault]) -> list[Experiment]:
    """Return records without the faults."""
    return [e.with_channels({f.name: f.mended(e.output(f.name)) for f in faults}) for e in data]


def _part(before: FitResult, after: FitResult, name: str) -> float:
    """Return the part of the mean square of an output's residuals that is gone."""
    squares = [mean_square(f, name) if f.feasible else math.nan for f in (before, after)]
    return max(1.0 - squares[1] / squares[0], 0.0) if squares[0] > 0.0 and np.isfinite(squares).all() else 1.0


def _fault(data: Sequence[Experiment], name: str) -> SensorFault | None:
    for turn in _TURNS:
        jumps = [(e.name, float(e.t[k]), float(e.t[k])) for e in data for k in _jumps(e.output(name), turn)]
        if jumps:
            return SensorFault(name, "wrapped", tuple(jumps), turn)
    held = [e for e in data if _repeats(e.output(name))]
    if len(held) == len(data):
        renewed = np.concatenate([np.diff(e.t[_changes(e.output(name))]) for e in held])
        # Where the new value is the old one, two intervals are one.
        return SensorFault(name, "held", size=float(np.mean(renewed[renewed < 1.5 * np.median(renewed)])))
    spans = [(e.name, float(e.t[a]), float(e.t[b])) for e in data for a, b in _runs(e.output(name))]
    return SensorFault(name, "stuck", tuple(spans)) if spans else None


def _jumps(y: _Array, turn: float) -> list[int]:
    """Return the samples after which an angle (N,) jumps by a turn; none where its values go beyond one."""
    known = np.flatnonzero(np.isfinite(y))
    z = y[known]
    if z.size < 2 or np.ptp(z) > (1.0 + _WITHIN) * turn:
        return []
    steps = np.abs(np.diff(z))
    far = np.abs(steps - turn) < _WITHIN * turn
    rest = steps[~far]
    if not far.any() or not rest.size or float(rest.max()) > _STEP * turn:
        return []
    return [int(known[k]) for k in np.flatnonzero(far)]


def _changes(y: _Array) -> NDArray[np.intp]:
    """Return the samples at which a record (N,) has another value than before, without those that are missing."""
    known = np.flatnonzero(np.isfinite(y))
    return np.asarray(known[1:][np.diff(y[known]) != 0.0])


def _repeats(y: _Array) -> list[tuple[int, int]]:
    """Return first and last samples of what is repeated, where a record (N,) is renewed at regular intervals of several
    samples."""
    at = _changes(y)
    if at.size < _RENEWED or not np.isfinite(y).all():
        return []
    sizes = np.abs(y[at] - y[at - 1])
    if float(np.mean(sizes < 1.5 * sizes.min())) > 0.5:  # an encoder that turns evenly does the same
        return []
    steps = np.diff(at)
    every = int(np.median(steps))
    near = np.abs(steps - every) <= 1
    if every < 2 or float(np.mean(near)) < 0.5:
        return []
    # The interval need be no multiple of that between samples. A longer step is one at which the new value is the old
    # one.
    number = np.cumsum(np.rint(steps / float(np.mean(steps[near]))))
    off = at[1:] - np.polyval(np.polyfit(number, at[1:], 1), number)
    if float(np.mean(np.abs(off) > 1.0)) > _REGULAR:
        return []
    begins = np.r_[int(at[0]) - every if at[0] > every + 1 else 0, at]
    ends = np.append(begins[1:] - 1, y.size - 1)
    return [(int(a), int(b)) for a, b in zip(begins, ends, strict=True)]


def _runs(y: _Array) -> list[tuple[int, int]]:
    """Return first and last samples of runs of the same value, longer than noise lets them be."""
    known = np.flatnonzero(np.isfinite(y))
    z = y[known]
    if z.size < _FEWEST:
        return []
    changes = np.abs(np.diff(z))
    # At the ends of its range a sensor is clipped.
    inside = (z > z.min()) & (z < z.max())
    same = np.concatenate([[False], (changes == 0.0) & inside[1:], [False]])
    if not same.any() or same.mean() > _REPEATED:
        return []
    # Digits of a file are steps, too.
    noise, step = noise_of(z), max(resolution_of([z]), float(changes[changes > 0.0].min()))
    signs = np.sign(np.diff(z, 2))
    if noise <= step or float(np.mean(signs[1:] * signs[:-1])) > _ALTERNATING:  # a sensor without noise does so at rest
        return []
    # Chance that noise and rounding give the same value twice.
    twice = step / (2.0 * math.sqrt(math.pi) * noise)
    many = same.sum() > max(_MANY, _MORE * twice * z.size)
    least = 1 if many else math.ceil(math.log(_BY_CHANCE / z.size) / math.log(twice))
    change = np.flatnonzero(np.diff(same.astype(int)))
    return [(int(known[a]), int(known[b])) for a, b in zip(change[::2], change[1::2], strict=True) if b - a >= least]


@dataclass(frozen=True, eq=False)
class UnsignedSensor:
    """An output that gives the size of what it measures, without its sign.

    name  of the output.
    fit   of the model whose output is that size.
    part  of the mean square of the output's residuals that this explains, in the records of the fit.
    """

    name: str
    fit: FitResult
    part: float

    @property
    def cause(self) -> str:
        """Canonical name."""
        return f"{self.name}:unsigned"


def unsigned_sensor(fit: FitResult) -> UnsignedSensor | None:
    """Return the output whose values can only be the size of what the model has for it; None where there is none.

    A model that is far from such a record says nothing of its motion: the estimation restarts from the model's start
    values.
    """
    data, model = dataset(fit), fit.model
    for name in model.output_names:
        measured = [y[np.isfinite(y)] for y in (e.output(name) for e in data)]
        measured = [y for y in measured if y.size]
        if not _may_be_size(measured):
            continue
        values = np.concatenate(measured)
        # A path that ended infeasible has no residuals.
        before = mean_square(fit, name) if fit.feasible else float(np.var(values))
        if before < _LEFT_BY_SIZE * float(np.var(values)):  # the model follows it as it is
            continue
        width = max(*map(noise_of, measured), _ROUNDED_SIZE * float(values.max()))
        equations = model._right_hand_sides()
        equations["output", name] = Expr(smooth_abs(equations["output", name], width))
        try:
            found = estimate(model._changed(equations=equations), data, noise=fit.noise)
        except (PhugoidError, np.linalg.LinAlgError):
            continue
        if found.status == "interrupted":
            raise KeyboardInterrupt
        if found.status in ENDED_WELL and (after := mean_square(found, name)) < _LEFT_BY_SIZE * before:
            return UnsignedSensor(name, found, 1.0 - after / before)
    return None


def _may_be_size(records: Sequence[NDArray[np.float64]]) -> bool:
    """Return whether values are never negative but for noise, and often near zero between larger ones."""
    largest = max((float(y.max()) for y in records), default=0.0)
    if largest <= 0.0 or any(float(y.min()) < -_BELOW * noise_of(y) for y in records):
        return False
    dips = 0
    for y in records:
        level = np.where(y < _NEAR_ZERO * largest, -1, np.where(y > _RISES * largest, 1, 0))
        level = level[level != 0]
        turns = np.flatnonzero(np.diff(level))
        dips += int(np.sum(level[turns[:-1]] > 0)) if turns.size > 1 else 0
    return dips >= _DIPS
