"""What an actuator of limited rate makes of an input."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError
from .grid import grid, number

__all__ = ["limited", "rate_limited"]

_Array = NDArray[np.float64]


def rate_limited(t: ArrayLike, u: ArrayLike, rate: float) -> _Array:
    """An input that follows ``u`` (N,) with no more than ``rate`` (its unit per s) up and down.

    It starts at u[0]. Raises OptionError where sizes differ or the rate is not positive.

    >>> rate_limited([0.0, 1.0, 2.0, 3.0], [0.0, 5.0, 5.0, 5.0], rate=2.0)
    array([0., 2., 4., 5.])
    """
    times = grid("rate_limited", t)
    values = np.array(u, dtype=np.float64)
    if values.shape != times.shape:
        raise OptionError(f"rate_limited: u has shape {values.shape}, but t {times.shape}")
    return limited(times, values, number("rate_limited", "rate", rate, positive=True))


def limited(t: _Array, u: _Array, rate: float) -> _Array:
    """The same, of what was checked."""
    out = u.copy()
    reach = rate * np.diff(t)
    for k in range(reach.size):
        out[k + 1] = out[k] + min(max(u[k + 1] - out[k], -reach[k]), reach[k])
    return out
