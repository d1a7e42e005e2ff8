"""What a record says of scales: trims, ranges, length, sampling."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...errors import DataError
from .points import Points

__all__ = ["Scales", "trim_of"]

# A variable hovers about zero where its median is less than this part of its standard deviation.
_HOVERS = 0.3
# Of the ranges of a variable; below that it does not vary.
_CONSTANT = 1e-9
# A variable changes sign where each side of zero has this part of its range.
_CROSSES = 0.05


def trim_of(points: Sequence[Points]) -> dict[str, float]:
    """Where to centre powers of each state, input and quantity: its median over all records, or 0 where it hovers
    about zero. Rounded to a tenth of the leading digit of its standard deviation, so that equations can be read."""
    found = {}
    for name in _names(points):
        values = np.concatenate([p.values[name] for p in points])
        median, spread = float(np.median(values)), float(values.std())
        if abs(median) < _HOVERS * spread:
            median = 0.0
        elif spread > _CONSTANT * abs(median):
            median = round(median, 1 - math.floor(math.log10(spread)))
        found[name] = median
    return found


def _names(points: Sequence[Points]) -> list[str]:
    if not points:
        raise DataError("candidates: there are no points")
    return [name for name in points[0].values if all(name in p.values for p in points)]


@dataclass(frozen=True, eq=False)
class Scales:
    """Trims, least and greatest values by name (states, inputs, quantities), and of time (s): first, longest record,
    sample interval.

    What is not known is taken as centred at 0, with a range of 1, over 20 s at 50 Hz: a library without data.
    """

    trim: Mapping[str, float] = field(default_factory=dict)
    low: Mapping[str, float] = field(default_factory=dict)
    high: Mapping[str, float] = field(default_factory=dict)
    begin: float = 0.0
    duration: float = 20.0
    interval: float = 0.02

    @staticmethod
    def of(points: Sequence[Points], trim: Mapping[str, float] | None = None) -> Scales:
        """Scales over some records; trims as given, others by `trim_of`."""
        names = _names(points)
        return Scales(
            trim={**trim_of(points), **(trim or {})},
            low={name: min(float(p.values[name].min()) for p in points) for name in names},
            high={name: max(float(p.values[name].max()) for p in points) for name in names},
            begin=min(float(p.t[0]) for p in points),
            duration=max(float(p.t[-1] - p.t[0]) for p in points),
            interval=min(float(np.median(np.diff(p.t))) for p in points),
        )

    def centre(self, name: str) -> float:
        """Where powers of a variable are centred."""
        return self.trim.get(name, 0.0)

    def span(self, name: str) -> float:
        """Peak to peak; 1 where it is not known or nothing."""
        return self.high[name] - self.low[name] if name in self.low and self.varies(name) else 1.0

    def peak(self, name: str) -> float:
        """Greatest distance from the centre."""
        if name not in self.low or not self.varies(name):
            return 1.0
        return max(self.high[name] - self.centre(name), self.centre(name) - self.low[name])

    def varies(self, name: str) -> bool:
        """Whether a variable varies, as far as is known."""
        if name not in self.low:
            return True
        low, high = self.low[name], self.high[name]
        return high - low > _CONSTANT * max(abs(low), abs(high))

    def crosses(self, name: str) -> bool:
        """Whether a variable changes sign, as far as is known."""
        if name not in self.low:
            return True
        return min(self.high[name], -self.low[name]) > _CROSSES * (self.high[name] - self.low[name])
