"""Evenly sampled segments of a record: samples and their places on an even grid of time, whatever is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["UniformSegment", "output_segments", "sampled_segment", "uniform_segments"]

_Array: TypeAlias = NDArray[np.float64]
_Indices: TypeAlias = NDArray[np.intp]

# Part of the spacing by which a step may differ from whole ones and still tell what the spacing is.
_OFF = 0.1
# A gap counts at most so many steps where samples are placed one after the other: no noise is correlated across more.
_LONGEST_GAP = 64


@dataclass(frozen=True, eq=False)
class UniformSegment:
    """Samples on an even grid of time.

    rows    where they are among the rows of residuals.
    places  (n,) of the grid points, increasing from 0: more than 1 between two is a gap.
    step    between grid points, s.
    """

    rows: slice
    places: _Indices
    step: float = 1.0

    @property
    def size(self) -> int:
        """Number of grid points, up to the last sample."""
        return int(self.places[-1]) + 1 if self.places.size else 0

    @property
    def runs(self) -> list[slice]:
        """Samples without a gap between them, counted from the first."""
        breaks = np.flatnonzero(np.diff(self.places) > 1) + 1
        return [slice(a, b) for a, b in pairwise([0, *breaks.tolist(), self.places.size])]

    @property
    def mask(self) -> _Array:
        """(size,) 1 where there is a sample, else 0."""
        return self.on_grid(np.ones(self.places.size), 0.0)

    def on_grid(self, values: _Array, missing: float = np.nan) -> _Array:
        """Values at the samples (n, ...) on the grid, (size, ...), ``missing`` where there is no sample."""
        grid = np.full((self.size, *values.shape[1:]), missing)
        grid[self.places] = values
        return grid

    def from_row(self, first: int) -> UniformSegment:
        """Return the same segment where rows are counted from another one."""
        return UniformSegment(slice(self.rows.start + first, self.rows.stop + first), self.places, self.step)


def uniform_segments(times: _Array) -> Sequence[UniformSegment]:
    """Return the segments of increasing times (n,): where a step is no multiple of the usual one, another begins.

    The usual step is the median; where more samples are missing than that tells, a lesser one that leaves fewer
    segments.
    """
    if times.size < 2:
        return [UniformSegment(slice(0, 1), np.zeros(1, dtype=np.intp))] if times.size else []
    steps = np.diff(times)
    # Steps that there are: of two that alternate the median is the mean.
    typical = np.quantile(steps, [0.5, 0.1], method="lower")
    return min((_split(steps, float(step)) for step in typical), key=len)


def _split(steps: _Array, usual: float) -> list[UniformSegment]:
    usual = float(np.median(steps[np.abs(steps - usual) <= 2.0 * _OFF * usual]))  # where times are rounded
    numbers = np.maximum(np.rint(steps / usual), 1.0)
    # After a long gap a part of a step does not matter.
    breaks = np.flatnonzero(np.abs(steps / numbers - usual) > _OFF * usual) + 1
    places = np.r_[0, np.cumsum(numbers)].astype(np.intp)
    edges = [0, *breaks.tolist(), places.size]
    return [UniformSegment(slice(a, b), places[a:b] - places[a], usual) for a, b in pairwise(edges)]


def sampled_segment(times: _Array) -> UniformSegment:
    """Return one segment of all times (n,), two or more: each sample follows the one before after so many median steps,
    whatever the jitter of its time."""
    steps = np.diff(times)
    step = float(np.median(steps))
    numbers = np.clip(np.rint(steps / step), 1, _LONGEST_GAP).astype(np.intp)
    return UniformSegment(slice(0, times.size), np.r_[0, np.cumsum(numbers)].astype(np.intp), step)


def output_segments(times: _Array, rows: Sequence[Sequence[slice]]) -> list[list[UniformSegment]]:
    """Return segments[i][e] of output i in experiment e, whose samples at ``times`` are ``rows[i][e]``.

    A sample stands on the nearest grid point; of samples that are nearer to each other than a step, later ones stand
    on the next. Outputs that are sampled alike have the same grid points.
    """
    steps = [_usual_step([times[own] for own in line if own.stop > own.start]) for line in rows]
    # Steps that differ by rounding only are one.
    for i, step in enumerate(steps):
        same = [s for s in steps[:i] if abs(s - step) <= 1e-3 * step]
        steps[i] = same[0] if same else step
    found: list[list[UniformSegment]] = []
    for line, step in zip(rows, steps, strict=True):
        found.append([])
        for e, own in enumerate(line):
            begin = min(times[other[e].start] for other in rows if other[e].stop > other[e].start)
            places = np.rint((times[own] - begin) / step).astype(np.intp)
            order = np.arange(places.size)
            places = np.maximum.accumulate(places - order) + order
            found[-1].append(UniformSegment(own, places, step))
    return found


def _usual_step(times: list[_Array]) -> float:
    """Return the usual spacing: the mean of those steps that are nearly a whole number of median ones."""
    steps = np.concatenate([np.diff(t) for t in times]) if times else np.empty(0)
    if not steps.size:
        return 1.0
    usual = float(np.median(steps))
    numbers = np.rint(steps / usual)
    even = (np.abs(steps - numbers * usual) <= _OFF * usual) & (numbers >= 1.0)
    return float(steps[even].sum() / numbers[even].sum()) if even.any() else usual
