"""Common checks of the input functions: the times, and numbers."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError

__all__ = ["grid", "number", "pair", "placed"]

_Array = NDArray[np.float64]


def grid(caller: str, t: ArrayLike) -> _Array:
    """Return times (N,), s, checked to increase."""
    try:
        times = np.asarray(t, dtype=np.float64)
    except (TypeError, ValueError):
        raise OptionError(f"{caller}: t holds the times of the samples in s, not {t!r}") from None
    if times.ndim != 1 or times.size < 2 or not np.isfinite(times).all() or not (np.diff(times) > 0.0).all():
        raise OptionError(f"{caller}: t holds at least 2 times in s that increase, as in numpy.arange(0, 20, 0.02)")
    return times


def number(caller: str, what: str, value: Any, positive: bool = False) -> float:
    """Return a finite number, above 0 where ``positive``; raise OptionError for anything else."""
    if not isinstance(value, (Real, np.generic)) or isinstance(value, bool) or not np.isfinite(float(value)):
        raise OptionError(f"{caller}: {what} is a number, not {value!r}")
    if positive and float(value) <= 0.0:
        raise OptionError(f"{caller}: {what} is a positive number, not {value!r}")
    return float(value)


def pair(caller: str, what: str, value: Any) -> tuple[float, float]:
    """Return two positive numbers, the lower one first; raise OptionError for anything else."""
    try:
        low, high = value
    except (TypeError, ValueError):
        raise OptionError(f"{caller}: {what} is a pair such as (0.1, 2.0), not {value!r}") from None
    first, last = (number(caller, f"{what}[{i}]", v, positive=True) for i, v in enumerate((low, high)))
    if not first < last:
        raise OptionError(f"{caller}: {what} is (lowest, highest), not ({first:g}, {last:g})")
    return first, last


def placed(caller: str, t: _Array, start: float | None, end: float | None) -> None:
    """Raise OptionError unless a manoeuvre lies within the grid."""
    slack = 1e-9 * (t[-1] - t[0])
    if start is not None and not t[0] - slack <= start < t[-1]:
        raise OptionError(f"{caller}: start is {start:g} s, but the times run from {t[0]:g} to {t[-1]:g} s")
    if end is not None and end > t[-1] + slack:
        raise OptionError(f"{caller}: it ends at {end:g} s, but the times only run to {t[-1]:g} s: give more of them")
