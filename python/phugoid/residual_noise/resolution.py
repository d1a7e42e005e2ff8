"""The resolution of an encoder or a converter, as its samples show it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["ROUNDED", "WITHIN", "resolution_of"]

_Array = NDArray[np.float64]

ROUNDED = 1.0 / 12.0
"""Variance of what rounding takes away, in squares of the resolution (Widrow and Kollar 2008, chapter 1)."""

WITHIN = 0.5
"""Residuals of this many steps, RMS, or less are within the resolution: rounding alone gives 0.29, and a sensor has
some noise of its own."""

# Samples that there are to be for each value that occurs, and part of a step by which values may lie off the grid.
_REPEATED, _OFF = 3.0, 1e-3


def resolution_of(samples: Sequence[_Array]) -> float:
    """Return the step of the grid on which all samples of some records (n,) lie; 0 where there is none.

    A grid is told from fine digits of a text file by its values: there are few, and they come again and again.

    >>> resolution_of([np.array([0.0, 0.5, 0.5, 1.0, 0.5, 0.0, 0.0, 0.5, 1.0, 1.5, 1.0, 1.0])])
    0.5
    """
    every = np.concatenate([np.zeros(0), *(z[np.isfinite(z)] for z in samples)])
    values = np.unique(every)
    if values.size < 2 or every.size < _REPEATED * values.size:
        return 0.0
    gaps = np.diff(values)
    step = float(gaps[gaps > _OFF * float(np.median(gaps))].min())
    steps = (values - values[0]) / step
    return step if float(np.abs(steps - np.round(steps)).max()) < _OFF * max(1.0, float(steps[-1]) * 1e-3) else 0.0
