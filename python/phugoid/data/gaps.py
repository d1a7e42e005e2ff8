"""Gaps in the sampling of a record, and the pieces between them."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..errors import OptionError

__all__ = ["checked_gaps", "gap_intervals", "pieces"]

_Array = NDArray[np.float64]


def checked_gaps(caller: str, gaps: Any) -> bool | float:
    """Return True (the automatic rule) or a positive length in s; raise OptionError for anything else."""
    if gaps is True:
        return True
    if isinstance(gaps, bool) or not isinstance(gaps, Real) or not 0 < float(gaps) < np.inf:
        raise OptionError(
            f"{caller}: gaps is the length in s beyond which an interval between samples is a gap, or True for ten "
            f"times the intervals beside it, not {gaps!r}"
        )
    return float(gaps)


def gap_intervals(t: _Array, gaps: bool | float) -> list[tuple[float, float]]:
    """Return begin and end (s) of the gaps between the sample times ``t`` (N,), s.

    True: intervals that are longer than ten times those beside them, see `Experiment.split`. A number: longer than so
    many s.
    """
    at = _core.gaps(t.tolist()) if gaps is True else np.flatnonzero(np.diff(t) > gaps).tolist()
    return [(float(t[i]), float(t[i + 1])) for i in at]


def pieces(t: _Array, intervals: Sequence[tuple[float, float]]) -> list[tuple[int, int]]:
    """Return the numbers of the first and last sample of each piece between gaps; samples within gaps are in none."""
    slack = 1e-9 * float(t[-1] - t[0])
    inside = np.zeros(t.size, dtype=bool)
    parts = np.zeros(t.size, dtype=int)
    for begin, end in intervals:
        inside |= (t > begin + slack) & (t < end - slack)
        parts += t > begin + slack
    left = np.flatnonzero(~inside)
    ends = np.flatnonzero(np.diff(parts[left])) if left.size else np.empty(0, dtype=int)
    firsts, lasts = [0, *(ends + 1).tolist()], [*ends.tolist(), left.size - 1]
    return [(int(left[a]), int(left[b])) for a, b in zip(firsts, lasts, strict=True) if b >= a]
