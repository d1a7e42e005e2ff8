"""Strands: samples of a channel that stand on a common grid of time, with gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

__all__ = ["Strand", "strands_of"]

_Array = NDArray[np.float64]

# Part of the spacing by which a sample may be off its place.
_OFF = 0.1


@dataclass(frozen=True, eq=False)
class Strand:
    """Samples of a channel, equally spaced but for those that are missing.

    rows    where they are among the rows.
    places  (n,) their numbers on the grid, increasing from 0: more than 1 between two is a gap.
    """

    rows: slice
    places: NDArray[np.intp]

    @property
    def runs(self) -> list[slice]:
        """Runs without a gap, of its own samples."""
        breaks = np.flatnonzero(np.diff(self.places) > 1) + 1
        return [slice(a, b) for a, b in pairwise([0, *breaks.tolist(), self.places.size])]

    def from_row(self, first: int) -> Strand:
        """The same where rows are counted from another."""
        return Strand(slice(self.rows.start + first, self.rows.stop + first), self.places)


def strands_of(times: _Array) -> Sequence[Strand]:
    """The strands of increasing times (n,): where a step is no multiple of the usual one, another begins.

    The usual step is the median; where more samples are missing than that tells, a lesser one that leaves fewer
    strands.
    """
    if times.size < 2:
        return [Strand(slice(0, 1), np.zeros(1, dtype=np.intp))] if times.size else []
    steps = np.diff(times)
    # Steps that there are: of two that alternate the median is the mean.
    typical = np.quantile(steps, [0.5, 0.1], method="lower")
    return min((_strands(steps, float(step)) for step in typical), key=len)


def _strands(steps: _Array, usual: float) -> list[Strand]:
    usual = float(np.median(steps[np.abs(steps - usual) <= 2.0 * _OFF * usual]))  # where times are rounded
    numbers = np.maximum(np.rint(steps / usual), 1.0)
    # After a long gap a part of a step does not matter.
    breaks = np.flatnonzero(np.abs(steps / numbers - usual) > _OFF * usual) + 1
    places = np.r_[0, np.cumsum(numbers)].astype(np.intp)
    edges = [0, *breaks.tolist(), places.size]
    return [Strand(slice(a, b), places[a:b] - places[a]) for a, b in pairwise(edges)]
