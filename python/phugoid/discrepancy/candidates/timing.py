"""Which delays, time constants and frequencies to try, and which are physical."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .points import Points
from .scales import Scales

__all__ = [
    "delay_bounds",
    "delay_grid",
    "frequency_grid",
    "lag_bounds",
    "lag_grid",
    "longest_delay",
    "longest_lag",
]

_Array = NDArray[np.float64]

# Transport delays of actuators, air data and telemetry; slower ones would have been noticed.
_DELAY = 0.3
_FREQUENCIES = 200


def _longest_delay(duration: float, interval: float) -> float:
    """A record shorter than 20 of them tells a delay from nothing; a sampling so slow that 0.3 s is less than three
    intervals belongs to a slower system."""
    return min(max(_DELAY, 3.0 * interval), duration / 20.0)


def longest_delay(points: Sequence[Points]) -> float:
    """The longest physical delay, s."""
    scales = Scales.of(points)
    return _longest_delay(scales.duration, scales.interval)


def longest_lag(points: Sequence[Points]) -> float:
    """The longest physical time constant, s: a slower lag does not settle within the record, it is a drift."""
    return Scales.of(points).duration / 5.0


def delay_grid(scales: Scales) -> _Array:
    """From a quarter of an interval to a little beyond what is physical, so that surrogates are seen as such."""
    longest = 1.5 * _longest_delay(scales.duration, scales.interval)
    return np.geomspace(min(0.25 * scales.interval, 0.5 * longest), longest, 8)


def delay_bounds(scales: Scales) -> dict[str, Any]:
    """Declaration of a delay: wide, a lead is no delay but may be what fits best; some of the record must be left."""
    return {"bounds": (-0.25 * scales.duration, 0.25 * scales.duration), "unit": "s"}


def lag_grid(scales: Scales) -> _Array:
    """From half an interval to a fifth of the record, but no more than 5 s, by factors of 2 or less."""
    longest = min(scales.duration / 5.0, max(5.0, 20.0 * scales.interval))
    shortest = min(0.5 * scales.interval, 0.1 * longest)
    return np.geomspace(shortest, longest, int(np.ceil(np.log(longest / shortest) / np.log(2.0))) + 1)


def lag_bounds(scales: Scales) -> dict[str, Any]:
    """Declaration of a time constant. Its bounds keep the equation from dividing by zero, and are else wide: whether
    a value is physical is another question."""
    return {"bounds": (0.05 * scales.interval, 2.0 * scales.duration), "unit": "s"}


def frequency_grid(scales: Scales) -> _Array:
    """From one cycle a record to a quarter of the sampling rate, rad/s, in steps of pi/T, two a line width, so that no
    line falls between; no more than some 200 of them, the lowest."""
    step = np.pi / scales.duration
    count = int(0.5 * np.pi / scales.interval / step) - 1
    return np.asarray(step * np.arange(2, 2 + min(max(count, 1), _FREQUENCIES)))
