"""Sensors that stay at their last value for a while: samples that are exactly the same, one after the other, of a
sensor whose noise does not let so many be the same by chance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...estimation import estimate
from ...fit_result import ENDED_WELL, FitResult, dataset
from ...residual_noise import resolution_of
from .recorded_input import noise_of

__all__ = ["StuckSensor", "stuck_sensors", "without_stuck"]

_Array = NDArray[np.float64]

# The number of runs of the same value, as long as the least, that chance may be expected to give in a record. Shorter
# ones count where there are so many, and times as many as chance gives, as where a radio link repeats what it lost.
_BY_CHANCE, _MANY, _MORE = 1e-4, 8, 10.0
# A sensor of which more than this part of the samples repeats the one before is recorded faster than it measures.
_HELD = 0.3


@dataclass(frozen=True, eq=False)
class StuckSensor:
    """A sensor that stayed at a value.

    name   of the output.
    spans  record, first and last time of each span, s.
    part   of the squares of the output's residuals that lie in these spans.
    """

    name: str
    spans: tuple[tuple[str, float, float], ...]
    part: float

    @property
    def cause(self) -> str:
        """Canonical name."""
        return f"{self.name}:stuck"


def stuck_sensors(fit: FitResult) -> tuple[list[StuckSensor], FitResult]:
    """Return sensors that stay at a value, and the fit to the records without these samples; none, and the fit as it
    is, where there is no such sensor or no such fit."""
    data = dataset(fit)
    found = []
    for name in fit.model.output_names:
        spans: list[tuple[str, float, float]] = []
        inside = whole = 0.0
        for e, r in zip(data, fit.records, strict=True):
            squares = np.nan_to_num(r.residuals[name]) ** 2
            whole += float(squares.sum())
            for first, last in _runs(e.output(name)):
                a, b = float(e.t[first]), float(e.t[last])
                spans.append((e.name, a, b))
                inside += float(squares[(r.t > a) & (r.t <= b)].sum())
        if spans:
            found.append(StuckSensor(name, tuple(spans), inside / whole if whole > 0.0 else 0.0))
    if not found:
        return [], fit
    try:
        mended = estimate(
            fit.model, without_stuck(data, found), transcription=fit.transcription, noise=fit.noise, start=fit
        )
    except (PhugoidError, np.linalg.LinAlgError):
        return [], fit
    if mended.status == "interrupted":
        raise KeyboardInterrupt
    return (found, mended) if mended.status in ENDED_WELL else ([], fit)


def without_stuck(data: Sequence[Experiment], sensors: Sequence[StuckSensor]) -> list[Experiment]:
    """Return records in which what repeats a value of these sensors is missing; the first sample of a span is kept."""
    mended = []
    for e in data:
        changed = {}
        for sensor in sensors:
            y = e.output(sensor.name).copy()
            runs = _runs(y)
            for first, last in runs:
                y[first + 1 : last + 1] = np.nan
            if runs:
                changed[sensor.name] = y
        mended.append(e.with_channels(changed) if changed else e)
    return mended


def _runs(y: _Array) -> list[tuple[int, int]]:
    """Return first and last samples of runs of the same value, longer than noise lets them be."""
    known = np.flatnonzero(np.isfinite(y))
    z = y[known]
    changes = np.abs(np.diff(z))
    # At the ends of its range a sensor is clipped.
    inside = (z > z.min()) & (z < z.max())
    same = np.concatenate([[False], (changes == 0.0) & inside[1:], [False]])
    if not same.any() or same.mean() > _HELD:
        return []
    # Digits of a file are steps, too.
    noise, step = noise_of(z), max(resolution_of([z]), float(changes[changes > 0.0].min()))
    if noise <= step:  # a rounded sensor at rest does the same
        return []
    # Chance that noise and rounding give the same value twice.
    twice = step / (2.0 * math.sqrt(math.pi) * noise)
    many = same.sum() > max(_MANY, _MORE * twice * z.size)
    least = 1 if many else math.ceil(math.log(_BY_CHANCE / z.size) / math.log(twice))
    change = np.flatnonzero(np.diff(same.astype(int)))
    return [(int(known[a]), int(known[b])) for a, b in zip(change[::2], change[1::2], strict=True) if b - a >= least]
