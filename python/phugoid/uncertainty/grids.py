"""Rows of residuals on even grids of time, so that lags can be counted whatever is missing."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..discrepancy.search.linearised import Linearised

__all__ = ["Grid", "grids_of"]

_Array: TypeAlias = NDArray[np.float64]
_Indices: TypeAlias = NDArray[np.intp]

# Part of the spacing by which a step may differ from whole ones and still tell what the spacing is.
_OFF = 0.1


@dataclass(frozen=True, eq=False)
class Grid:
    """One output's samples in one experiment.

    rows    where they are among the rows.
    places  (n,) of the nearest grid points, from 0, increasing. Where times are irregular, lags are known to about a
            step; of samples that are nearer to each other than that, later ones stand on the next places.
    size    number of grid points.
    step    s.
    """

    rows: slice
    places: _Indices
    size: int
    step: float

    def laid(self, values: _Array) -> _Array:
        """Values (n, ...) on the grid, (size, ...): 0 where there is no sample."""
        out = np.zeros((self.size, *values.shape[1:]))
        out[self.places] = values
        return out

    @property
    def runs(self) -> list[slice]:
        """Samples without a gap between them, counted from the first."""
        breaks = np.flatnonzero(np.diff(self.places) > 1) + 1
        edges = [0, *breaks.tolist(), self.places.size]
        return [slice(a, b) for a, b in pairwise(edges)]

    @property
    def mask(self) -> _Array:
        """(size,) 1 where there is a sample."""
        out = np.zeros(self.size)
        out[self.places] = 1.0
        return out


def grids_of(linear: Linearised) -> list[list[Grid]]:
    """grids[i][e] of output i in experiment e; outputs sampled alike have the same grid points."""
    steps = [_step([linear.times[rows] for rows in line if rows.stop > rows.start]) for line in linear.rows]
    # Steps that differ by rounding only are one.
    for i, step in enumerate(steps):
        same = [s for s in steps[:i] if abs(s - step) <= 1e-3 * step]
        steps[i] = same[0] if same else step
    found: list[list[Grid]] = []
    for line, step in zip(linear.rows, steps, strict=True):
        found.append([])
        for e, rows in enumerate(line):
            begin = min(linear.times[other[e].start] for other in linear.rows if other[e].stop > other[e].start)
            places = np.rint((linear.times[rows] - begin) / step).astype(np.intp)
            order = np.arange(places.size)
            places = np.maximum.accumulate(places - order) + order
            found[-1].append(Grid(rows, places, int(places[-1]) + 1 if places.size else 0, step))
    return found


def _step(times: list[_Array]) -> float:
    """The usual spacing: the mean of those steps that are nearly a whole number of median ones."""
    steps = np.concatenate([np.diff(t) for t in times]) if times else np.empty(0)
    if not steps.size:
        return 1.0
    usual = float(np.median(steps))
    numbers = np.rint(steps / usual)
    even = (np.abs(steps - numbers * usual) <= _OFF * usual) & (numbers >= 1.0)
    return float(steps[even].sum() / numbers[even].sum()) if even.any() else usual
