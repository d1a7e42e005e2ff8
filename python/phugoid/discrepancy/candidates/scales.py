"""Time histories along a fitted path, where candidates act, and the scales they show: trims, ranges, delays, lags."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...errors import DataError
from ...modelling.compiled import CompiledExpressions
from ...sensitivities import Points

__all__ = [
    "Scales",
    "delay_bounds",
    "delay_grid",
    "evaluated",
    "frequency_grid",
    "lag_bounds",
    "lag_grid",
    "late",
    "late_smooth",
    "levels_of",
    "longest_delay",
    "longest_lag",
    "mode_grid",
    "of",
    "output_key",
    "rate_key",
    "second_order",
    "trim_of",
]

_Array = NDArray[np.float64]


# A variable hovers about zero where its median is less than this part of its standard deviation.
_HOVERS = 0.3
# Of the ranges of a variable; below that it does not vary.
_CONSTANT = 1e-9
# A variable has values well on both sides of one where each side has this part of its range; and it changes sign where
# each side of zero has the other one: a wheel may run backwards for short times only.
_INSIDE, _CROSSES = 0.05, 0.02
# A variable stays well above zero where its least value is above this part of the greatest.
_ABOVE = 0.05


def trim_of(points: Sequence[Points]) -> dict[str, float]:
    """Return where to centre powers of each state, input and quantity: its median over all records, or 0 where it
    hovers about zero. Rounded to a tenth of the leading digit of its standard deviation, so that equations can be
    read."""
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


def output_key(name: str) -> str:
    """Return the name of an output among scales: states may have the same names."""
    return f"y:{name}"


def rate_key(name: str) -> str:
    """Return the name of the rate of a state or an input among scales."""
    return f"{name}'"


@dataclass(frozen=True, eq=False)
class Scales:
    """Trims, least and greatest values by name (states, inputs, quantities; outputs by `output_key`, rates by
    `rate_key`), numbers of levels of what takes a few values only, and of time (s): first, longest record, interval.

    ``integrals`` are those of inputs over a record, the largest of all records, of inputs that add up to something and
    not in proportion to time.
    Of names in ``given`` the user gave the trim, of those in ``moved`` a candidate has one of its own.

    What is not known is taken as centred at 0, with a range of 1, over 20 s at 50 Hz: a library without data.
    """

    trim: Mapping[str, float] = field(default_factory=dict)
    low: Mapping[str, float] = field(default_factory=dict)
    high: Mapping[str, float] = field(default_factory=dict)
    levels: Mapping[str, int] = field(default_factory=dict)
    begin: float = 0.0
    duration: float = 20.0
    interval: float = 0.02
    given: frozenset[str] = frozenset()
    moved: frozenset[str] = frozenset()
    integrals: Mapping[str, float] = field(default_factory=dict)

    @staticmethod
    def of(points: Sequence[Points], trim: Mapping[str, float] | None = None) -> Scales:
        """Scales over some records; trims as given, others by `trim_of`."""
        names = _names(points)
        of_outputs = {output_key(n): np.concatenate([p.outputs[n] for p in points]) for n in points[0].outputs}
        shared = [n for n in points[0].rates if all(n in p.rates for p in points)]
        of_others = of_outputs | {rate_key(n): np.concatenate([p.rates[n] for p in points]) for n in shared}
        medians = {key: float(np.median(y)) for key, y in of_outputs.items()}
        return Scales(
            trim={**medians, **trim_of(points), **(trim or {})},
            low={name: min(float(p.values[name].min()) for p in points) for name in names}
            | {key: float(y.min()) for key, y in of_others.items()},
            high={name: max(float(p.values[name].max()) for p in points) for name in names}
            | {key: float(y.max()) for key, y in of_others.items()},
            levels={n: k for n in names if (k := levels_of(np.concatenate([p.values[n] for p in points])))},
            begin=min(float(p.t[0]) for p in points),
            duration=max(float(p.t[-1] - p.t[0]) for p in points),
            interval=min(float(np.median(np.diff(p.t))) for p in points),
            given=frozenset(trim or ()),
            integrals={n: largest for n in names if (largest := largest_integral(n, points))},
        )

    def centre(self, name: str) -> float:
        """Return where powers of a variable are centred."""
        return self.trim.get(name, 0.0)

    def is_near(self, name: str, value: float) -> bool:
        """Return whether a value is no further from those of a variable than these are apart."""
        span = self.span(name)
        return self.low.get(name, 0.0) - span <= value <= self.high.get(name, 0.0) + span

    def is_inside(self, name: str, value: float) -> bool:
        """Return whether a variable has values well on both sides of one, as far as is known."""
        if name not in self.low:
            return True
        edge = _INSIDE * self.span(name)
        return self.low[name] + edge < value < self.high[name] - edge

    def span(self, name: str) -> float:
        """Peak to peak; 1 where it is not known or nothing."""
        return self.high[name] - self.low[name] if name in self.low and self.varies(name) else 1.0

    def peak(self, name: str) -> float:
        """Greatest distance from the centre."""
        if name not in self.low or not self.varies(name):
            return 1.0
        return max(self.high[name] - self.centre(name), self.centre(name) - self.low[name])

    def varies(self, name: str) -> bool:
        """Return whether a variable varies, as far as is known."""
        if name not in self.low:
            return True
        low, high = self.low[name], self.high[name]
        return high - low > _CONSTANT * max(abs(low), abs(high))

    def distinguishes(self, name: str, family: str) -> bool:
        """Return whether a variable takes enough values to distinguish a function of it, of one of the families, from a
        constant and a linear part: any function of two levels is such a sum, and any odd function of three that lie
        evenly."""
        levels = self.levels.get(name, 0)
        return not levels or levels > 3 or (levels == 3 and family in ("square", "absolute"))

    def crosses(self, name: str) -> bool:
        """Return whether a variable changes sign, as far as is known."""
        if name not in self.low:
            return True
        return min(self.high[name], -self.low[name]) > _CROSSES * (self.high[name] - self.low[name])

    def nearly_crosses(self, name: str) -> bool:
        """Return whether a variable changes sign or comes so near to it that it may where the model is right."""
        return self.crosses(name) or min(abs(self.low[name]), abs(self.high[name])) < _CROSSES * self.span(name)

    def reaches_zero(self, name: str) -> bool:
        """Return whether zero is no further from the values of a variable than these vary: a power of flows, levels and
        speeds is one of the variable itself, and no constant and linear part make up for the distance to a trim."""
        if name not in self.low:
            return True
        low, high = self.low[name], self.high[name]
        return max(low, -high) <= high - low

    def stays_positive(self, name: str) -> bool:
        """Return whether a variable stays well above zero, so that any power of it is defined."""
        return name not in self.low or has_powers(self.low[name], self.high[name])

    def is_positive(self, name: str) -> bool:
        """Return whether a variable is above zero but for little, as far as is known."""
        return name not in self.low or (self.low[name] + self.high[name] > 0.0 and not self.crosses(name))

    def is_a_distance(self, name: str) -> bool:
        """Return whether a position may be a distance from a place on one side: that of a fit which does not know what
        acts there may go a little beyond it."""
        return name not in self.low or self.low[name] > -_BEYOND * self.high[name]


def has_powers(low: float, high: float) -> bool:
    """Return whether values between two stay well above zero, so that any power of them is defined."""
    return low > _ABOVE * high


# Part of the greatest distance by which a path may go beyond where it begins.
_BEYOND = 0.2

# Part of the integral of an input's size that it adds up to, from which on it is an amount that is used; and the part
# of it by which that departs from a straight line, below which it says no more than the time does.
_ADDS_UP, _BENT = 0.5, 0.03


def integral(t: _Array, u: _Array) -> _Array:
    """Return (n,) the integral of u since the first of the (n,) times, by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (u[1:] + u[:-1]) * np.diff(t))])


def largest_integral(name: str, points: Sequence[Points]) -> float:
    """Return the integral of a variable over the record in which it is largest, to two digits; 0 where it does not add
    up, or does so in proportion to time in all records."""
    largest, size, bent = 0.0, 0.0, 0.0
    for p in points:
        u = p.values[name]
        z = integral(p.t, u)
        if abs(z[-1]) >= abs(largest):
            largest = float(z[-1])
            size = float(integral(p.t, np.abs(u))[-1])
            bent = float(np.max(np.abs(z - z[-1] * (p.t - p.t[0]) / (p.t[-1] - p.t[0]))))
    if abs(largest) <= _ADDS_UP * size or bent < _BENT * abs(largest):
        return 0.0
    return float(f"{largest:.2g}")


def levels_of(values: _Array) -> int:
    """Return the number of levels of what switches between a few, as a relay does; 0 for what takes other values more
    often than in passing."""
    span = float(np.ptp(values))
    if not span > 0.0:
        return 0
    counts = np.unique(np.round((values - values.min()) / (_SAME * span)), return_counts=True)[1]
    # Most of the time an input may rest at its trim: the other samples show which levels it has beside that.
    others = np.sort(counts)[:-1]
    beside, often = others.sum(), others[others > _OFTEN * others.sum()]
    few = beside - often.sum() < min(_PASSING * values.size, _BESIDE * beside)
    return 1 + int(often.size) if few else 0


# Of a variable's range: values nearer to each other are one level. Of the samples beside the most frequent level: what
# a level has. Of all samples, and of those: what lies between levels, at most.
_SAME, _OFTEN, _PASSING, _BESIDE = 1e-3, 0.1, 0.1, 0.5

# Transport delays of actuators, air data and telemetry; slower ones would have been noticed.
_DELAY = 0.3
_FREQUENCIES = 200
# Part of a record that a delay may last where that is longer: transport along pipes, wind from a mast to a rotor.
_SLOW = 0.02


def _longest_delay(duration: float, interval: float) -> float:
    """Return the longest delay that is looked for. A record shorter than 20 of them does not determine it; a sampling
    so slow that 0.3 s is less than three intervals belongs to a slower system."""
    return min(max(_DELAY, 3.0 * interval), duration / 20.0)


def longest_delay(points: Sequence[Points]) -> float:
    """Return the longest physical delay, s: in long records of slow systems, longer than is looked for."""
    scales = Scales.of(points)
    return max(_longest_delay(scales.duration, scales.interval), _SLOW * scales.duration)


def longest_lag(points: Sequence[Points]) -> float:
    """Return the longest physical time constant, s: a slower lag does not settle within the record, it is a drift."""
    return Scales.of(points).duration / 5.0


def delay_grid(scales: Scales) -> _Array:
    """Return delays from a quarter of an interval to a little beyond what is physical, so that surrogates are seen as
    such."""
    longest = 1.5 * _longest_delay(scales.duration, scales.interval)
    return np.geomspace(min(0.25 * scales.interval, 0.5 * longest), longest, 8)


def delay_bounds(scales: Scales, unit: str) -> dict[str, Any]:
    """Return the declaration of a delay: wide, a lead is no delay but may be what fits best; some of the record must be
    left."""
    return {"bounds": (-0.25 * scales.duration, 0.25 * scales.duration), "unit": unit}


def lag_grid(scales: Scales) -> _Array:
    """Return time constants from half an interval to a fifth of the record, but no more than 5 s, by factors of 2 or
    less."""
    longest = min(scales.duration / 5.0, max(5.0, 20.0 * scales.interval))
    shortest = min(0.5 * scales.interval, 0.1 * longest)
    return np.geomspace(shortest, longest, int(np.ceil(np.log(longest / shortest) / np.log(2.0))) + 1)


def lag_bounds(scales: Scales, unit: str) -> dict[str, Any]:
    """Return the declaration of a time constant. Its bounds keep the equation from dividing by zero, and are else wide:
    whether a value is physical is another question."""
    return {"bounds": (0.05 * scales.interval, 2.0 * scales.duration), "unit": unit}


def frequency_grid(scales: Scales) -> _Array:
    """Return frequencies from one cycle a record to a quarter of the sampling rate, rad/s, in steps of pi/T, two a line
    width, so that no line falls between; no more than some 200 of them, the lowest."""
    step = np.pi / scales.duration
    count = int(0.5 * np.pi / scales.interval / step) - 1
    return np.asarray(step * np.arange(2, 2 + min(max(count, 1), _FREQUENCIES)))


def mode_grid(scales: Scales) -> _Array:
    """Frequencies of a mode, rad/s: from four cycles a record to a third of the sampling rate, by factors of 1.2."""
    low, high = 8.0 * np.pi / scales.duration, 2.0 * np.pi / (3.0 * scales.interval)
    return np.geomspace(low, max(high, 2.0 * low), max(int(np.ceil(np.log(high / low) / np.log(1.2))), 4) + 1)


def of(group: Mapping[str, _Array], name: str, points: Points, what: str) -> _Array:
    """Return a time history by name; DataError where the points have none."""
    try:
        return group[name]
    except KeyError:
        raise DataError(f"experiment '{points.experiment}': the points have no {what} '{name}'") from None


def evaluated(e: Expr, points: Points) -> _Array:
    """Return (n,) values of an expression in states, inputs, quantities and time."""
    names = [name for name in e.symbols if name != "time"]
    columns = [points.t, *(of(points.values, name, points, "state, input or quantity") for name in names)]
    return np.asarray(CompiledExpressions([e], inputs=names)(np.zeros(0), np.vstack(columns))[0])


def second_order(t: _Array, u: _Array, w: float, damping: float) -> tuple[_Array, _Array]:
    """Return (n,) solution z of z'' = w^2 (u - z) - 2 damping w z', at rest at first, and z'; exact for u linear
    between its times and a damping below 1, by the complex pole p: z = w^2 / Im(p) Im(y) with y' = p y + u."""
    from scipy.linalg import solve_banded

    pole = w * complex(-damping, np.sqrt(1.0 - damping * damping))
    step = pole * np.diff(t)
    grown = np.expm1(step)
    band = np.ones((2, t.size), dtype=complex)
    band[1, :-1] = -(1.0 + grown)
    right = np.zeros(t.size, dtype=complex)
    right[1:] = (u[:-1] * grown + np.diff(u) * (grown - step) / step) / pole
    y = solve_banded((1, 0), band, right, overwrite_b=True, check_finite=False)
    scale = w * w / pole.imag
    return scale * y.imag, scale * (pole * y).imag


def late(t: _Array, u: _Array, tau: float) -> _Array:
    """Return (n,) u(t - tau) for u linear between its times and constant beyond them."""
    return np.interp(t - tau, t, u)


def late_smooth(t: _Array, y: _Array, rate: _Array, tau: float) -> _Array:
    """Return (n,) y(t - tau) by cubic Hermite interpolation; NaN where that lies outside the record."""
    from scipy.interpolate import CubicHermiteSpline

    return np.asarray(CubicHermiteSpline(t, y, rate, extrapolate=False)(t - tau))
