"""Faults of an input or an output: scale, bias, dead-band, saturation, lag, delay."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr, lagged
from ...functions import smooth_abs
from ...modelling.model import Model
from ...sensitivities import Place, Points
from .candidate import Candidate, Effect, ExtensionBuilder, largest_coefficient, place_range
from .scales import (
    Scales,
    delay_bounds,
    delay_grid,
    evaluated,
    lag_bounds,
    lag_grid,
    late,
    late_smooth,
    longest_delay,
    longest_lag,
    of,
    output_key,
)

__all__ = [
    "ClippedSensor",
    "DeadBand",
    "InputBias",
    "InputDelay",
    "InputLag",
    "InputScale",
    "Saturation",
    "Scale",
    "SensorCurve",
    "SensorDelay",
    "SensorLag",
    "SensorScale",
]

_Array = NDArray[np.float64]

# A sensor or actuator whose scale is wrong by more was never calibrated.
_SCALE = 0.3
# A wrong sign, and units that are taken for others: degrees and radians, g and m/s², feet, knots and km/h and metres,
# thousandths; and how near a scale must be to one of these.
_UNITS = (180.0 / np.pi, 9.80665, 1.0 / 0.3048, 3.6 / 1.852, 3.6, 1000.0)
_FACTORS = (-1.0, *(s * f for f in _UNITS for s in (1.0, -1.0)), *(s / f for f in _UNITS for s in (1.0, -1.0)))
_LIKE = 0.03


def cut_off(x: Any, limit: Any, width: float, size: Callable[[Any, float], Any] = smooth_abs) -> Any:
    """Return x, cut off at a limit on either side, corners rounded over a width; of arrays with `numpy.hypot` as the
    rounded ``size``."""
    return 0.5 * (size(x + limit, width) - size(x - limit, width))


def channel(effect: Effect, points: Points) -> _Array:
    """Return the input or output (N,) that an effect acts on."""
    name, kind = effect.place.name, effect.place.kind
    return of(points.outputs if kind == "output" else points.values, name, points, kind)


@dataclass(frozen=True, eq=False, repr=False)
class Scale(Effect):
    """It becomes 1 + k times as large."""

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return channel(self, points)[np.newaxis]

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.coefficients[0]: (-_SCALE, _SCALE)}

    def has_reason(self, values: Mapping[str, float]) -> bool:
        scale = 1.0 + values.get(self.coefficients[0], 0.0)
        return any(abs(scale - factor) < _LIKE * abs(factor) for factor in _FACTORS)


@dataclass(frozen=True, eq=False, repr=False)
class Lag(Effect):
    """It is followed with a time constant, tau z' + z = it, from a steady start or from any."""

    steady: bool = True

    @property
    def unsteady(self) -> Candidate | None:
        return replace(self, steady=False) if self.steady else None

    @property
    def state(self) -> str:
        """Name of the state that follows."""
        return f"{self.place.name}_{'sensor' if self.place.kind == 'output' else 'lag'}"

    def begins_within(self, states: Mapping[str, _Array], points: Points, shape: Mapping[str, float]) -> bool:
        """Return whether what follows begins in the range of what is followed, and goes on from there for a sample or
        more: else it would be an impulse at the beginning, which may be anything."""
        it = channel(self, points)
        begun = self.state in states and bool(it.min() <= states[self.state][0] <= it.max())
        return begun and shape[self.shape_names[0]] > 0.5 * self.scales.interval

    def grid(self) -> Iterable[float]:
        return lag_grid(self.scales)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        it = channel(self, points)
        return (lagged(points.t, it, shape[self.shape_names[0]]) - it)[np.newaxis]

    def follower(self, extension: ExtensionBuilder, it: Expr) -> Expr:
        """Declare tau and the state that follows."""
        (tau_name,) = self.shape_names
        declared = lag_bounds(self.scales, extension.old.time_unit)
        tau = extension.parameter(tau_name, self.shapes[len(self.shapes) // 3][tau_name], **declared)
        unit = extension.old.units.get(self.place.name, "")
        return extension.state(self.state, unit, lambda z: (it - z) / tau, it if self.steady else None)

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.shape_names[0]: (0.0, longest_lag(points))}


@dataclass(frozen=True, eq=False, repr=False)
class Delay(Effect):
    """It is late."""

    def grid(self) -> Iterable[float]:
        return delay_grid(self.scales)

    def delay(self, extension: ExtensionBuilder) -> str:
        """Declare the delay, and return its name."""
        (name,) = self.shape_names
        declared: dict[str, Any] = delay_bounds(self.scales, extension.old.time_unit)
        extension.parameter(name, **declared)
        return name

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        # Of two clocks either may be late.
        longest = longest_delay(points)
        return {self.shape_names[0]: (-longest, longest)}


@dataclass(frozen=True, eq=False, repr=False)
class SensorScale(Scale):
    """y becomes (1 + k) y."""

    stage: int = 6  # of all that the sensor sees, lever arms included

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        k = extension.parameter(self.coefficients[0])
        extension.put(self.place, (1 + k) * extension.at(self.place))
        return extension.model()


@dataclass(frozen=True, eq=False, repr=False)
class SensorCurve(Effect):
    """y becomes y + c (y - y0)^power: a characteristic that is no straight line."""

    power: int = 2
    stage: int = 6

    @property
    def _centre(self) -> float:
        key = output_key(self.place.name)
        return 0.0 if self.scales.reaches_zero(key) else self.scales.centre(key)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return ((channel(self, points) - self._centre) ** self.power)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        c, y, centre = extension.parameter(self.coefficients[0]), extension.at(self.place), self._centre
        extension.put(self.place, y + c * (y - centre if centre else y) ** self.power)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        largest = largest_coefficient(self, {}, points) / 2.0  # a sensor that is bent by half its range is none
        return {self.coefficients[0]: (-largest, largest)}


@dataclass(frozen=True, eq=False, repr=False)
class SensorLag(Lag):
    """The output follows with a time constant: tau y' + y = what it was."""

    stage: int = 7

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        y = self.follower(extension, extension.at(self.place))
        extension.put(self.place, y)
        return extension.model()


@dataclass(frozen=True, eq=False, repr=False)
class SensorDelay(Delay):
    """The output is measured late. Where that reaches back before the record there is no sample, and no effect."""

    stage: int = 8

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        y = channel(self, points)
        rate = of(points.output_rates, self.place.name, points, "rate of output")
        late = late_smooth(points.t, y, rate, shape[self.shape_names[0]])
        return np.where(np.isfinite(late), late - y, 0.0)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        extension.at(self.place)
        extension.late_output(self.place.name, self.delay(extension))
        return extension.model()


# Corners are rounded over this part of a channel's range: less than the narrowest dead-band that is tried.
_CORNER = 0.003
# Part of the samples that follow another with the same extreme value, from which on a limit is suspected: an encoder
# at rest at the end of its travel does that for once, too, and the refit decides.
_PILED = 0.01
# Of an output's range, by which a limit may lie outside of it.
_BEYOND = 0.02


@dataclass(frozen=True, eq=False, repr=False)
class ClippedSensor(Effect):
    """The output goes no further than a limit: an upper one where it lies above the output's median, else a lower; or,
    on both sides, than as far from zero either way."""

    both_sides: bool = False
    stage: int = 7

    @property
    def _key(self) -> str:
        return output_key(self.place.name)

    def grid(self) -> Iterable[float]:
        low, high = self.scales.low.get(self._key, -0.5), self.scales.high.get(self._key, 0.5)
        parts = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4])
        if self.both_sides:
            return [float(x) for x in max(high, -low) * (1.0 - 2.0 * parts)]
        limits = [*(high - (high - low) * parts), *(low + (high - low) * parts)]
        centre = self.scales.centre(self._key)
        # Beyond the median most of the record would stand still.
        return [x for i, x in enumerate(limits) if (x > centre) == (i < parts.size)]

    def variants(self, points: Sequence[Points]) -> Sequence[Candidate]:
        return () if self.both_sides or not self.scales.crosses(self._key) else (replace(self, both_sides=True),)

    @property
    def lesser(self) -> Candidate | None:
        return replace(self, both_sides=False) if self.both_sides else None

    @property
    def _corner(self) -> float:
        return _CORNER * self.scales.span(self._key)

    def _above(self, limit: float) -> bool:
        return limit > self.scales.centre(self._key)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        y, limit = channel(self, points), shape[self.shape_names[0]]
        if self.both_sides:
            return np.asarray(cut_off(y, limit, self._corner, np.hypot) - y)[np.newaxis]
        distance = np.hypot(y - limit, self._corner)
        return np.asarray(0.5 * (limit - y + (-distance if self._above(limit) else distance)))[np.newaxis]

    def suggested(self, measured: Mapping[str, Sequence[_Array]]) -> Mapping[str, float] | None:
        """Return the greatest or least value, where samples in a row have it again and again."""
        every = [z[np.isfinite(z)] for z in measured[self.place.name]]
        whole = np.concatenate(every)
        if not whole.size or np.ptp(whole) == 0.0:
            return None
        ends = [
            float(limit)
            for limit in (whole.max(), whole.min())
            if sum(int(((z[1:] == limit) & (z[:-1] == limit)).sum()) for z in every) > max(_PILED * whole.size, 5)
        ]
        alike = len(ends) == 2 and abs(ends[0] + ends[1]) < _BEYOND * (ends[0] - ends[1])
        if not ends or alike != self.both_sides:
            return None
        return {self.shape_names[0]: ends[0]}

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        (name,) = self.shape_names
        first = float(extension.start.get(name, next(iter(self.grid()), 0.0)))
        bounds = (0.0 if self.both_sides else -np.inf, np.inf)  # a negative one would turn the sign round
        limit = extension.parameter(name, first, bounds=bounds, unit=model.units.get(self.place.name, ""))
        y = extension.at(self.place)
        if self.both_sides:
            extension.put(self.place, cut_off(y, limit, self._corner))
        else:
            distance = smooth_abs(y - limit, self._corner)
            extension.put(self.place, 0.5 * (y + limit - distance if self._above(first) else y + limit + distance))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        # A limit that the output does not reach does nothing; one that it does reach is the end of its range.
        y = np.concatenate([channel(self, p) for p in points])
        more = _BEYOND * float(np.ptp(y))
        low, high = float(y.min()), float(y.max())
        return {self.shape_names[0]: (0.0 if self.both_sides else low - more, max(high, -low) + more)}


@dataclass(frozen=True, eq=False, repr=False)
class InputScale(Scale):
    """u becomes (1 + k) u."""

    stage: int = 1

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        k = extension.parameter(self.coefficients[0])
        extension.replace_input(self.place.name, (1 + k) * Expr.symbol(self.place.name))
        return extension.model()


@dataclass(frozen=True, eq=False, repr=False)
class InputBias(Effect):
    """u becomes u + b."""

    stage: int = 1

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return np.ones((1, points.n))

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        b = extension.parameter(self.coefficients[0], unit=model.units.get(self.place.name, ""))
        extension.replace_input(self.place.name, Expr.symbol(self.place.name) + b)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        largest = place_range(self.place, points)  # an offset beyond the whole range would have been seen by eye
        return {self.coefficients[0]: (-largest, largest)}


@dataclass(frozen=True, eq=False, repr=False)
class _Limited(Effect):
    """An input, or a quantity that is defined exactly, of which the part within a limit about its trim matters.

    rate  the quantity that is the rate of the deflection, "" for none: a gear within its play transmits no damping.
    """

    rate: str = ""

    @property
    def centred(self) -> bool:
        return True

    least = 0.0  # physical limit, of the greatest deflection
    words = ""  # with places for the input, and for the centre where that is another than its trim

    def on(self, scales: Scales) -> _Limited:
        name = self.place.name
        about = f" from {scales.centre(name):g}" if name in scales.moved else ""
        if self.place.kind == "quantity" and scales.reaches_zero(name) and name not in scales.given | scales.moved:
            # A difference that is sometimes zero is mostly measured from there, such as the twist of a shaft.
            scales = replace(scales, trim={**scales.trim, name: 0.0})
        return replace(self, scales=scales, explanation=self.words.format(name=name, about=about))

    def variants(self, points: Sequence[Points]) -> Sequence[Candidate]:
        """Return those about the first values, about zero and about the middle of the range, where both sides meet the
        limit."""
        scales, name = self.scales, self.place.name
        tried, found = [scales.centre(name)], list[Candidate]()
        first = float(np.mean([p.values[name][0] for p in points]))
        middle = 0.5 * (scales.low.get(name, 0.0) + scales.high.get(name, 0.0))
        for centre in (first, 0.0 if scales.reaches_zero(name) else first, middle):
            if name not in scales.given and min(abs(centre - t) for t in tried) > _CORNER * scales.span(name):
                tried.append(centre)
                found.append(self.moved(centre - scales.centre(name)))
        return found

    def _within(self, limit: Any) -> Any:
        """Return the distance from the trim, cut off at the limit on either side; corners rounded."""
        x = self._distance()
        width = _CORNER * self.scales.span(self.place.name)
        return cut_off(x, limit, width)

    def _distance(self) -> Expr:
        centre = self.scales.centre(self.place.name)
        u = Expr.symbol(self.place.name)
        return u - centre if centre else u

    def change(self, limit: Any) -> Any:
        """Return what is added to the input."""
        raise NotImplementedError

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return evaluated(Expr(self.change(shape[self.shape_names[0]])), points)[np.newaxis]

    def _extended(self, model: Model, start: Mapping[str, float] | None, first: float) -> Model:
        extension = ExtensionBuilder(model, self, start)
        peak, unit = self.scales.peak(self.place.name), model.units.get(self.place.name, "")
        limit = extension.parameter(self.shape_names[0], first * peak, bounds=(0.0, 2.0 * peak), unit=unit)
        name, change = self.place.name, self.change(limit)
        if self.place.kind == "quantity":
            whole = extension.at(self.place)
            extension.put(self.place, whole + Expr(Expr(change).substitute({name: whole})))
            if self.rate:
                slope = Expr((Expr.symbol(name) + Expr(change)).diff(name)).substitute({name: whole})
                place = Place("quantity", self.rate)
                extension.put(place, Expr(slope) * extension.at(place))
        else:
            extension.replace_input(name, Expr.symbol(name) + change)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        # Beyond the greatest deflection a saturation does nothing, and a dead-band leaves nothing. A saturation at next
        # to nothing would be an input that does not act.
        centre = self.scales.centre(self.place.name)
        peak = max(float(np.abs(p.values[self.place.name] - centre).max()) for p in points)
        return {self.shape_names[0]: (self.least * peak, peak)}


@dataclass(frozen=True, eq=False, repr=False)
class DeadBand(_Limited):
    """Deflections within the (half) width about the trim do nothing, larger ones are less by it."""

    stage: int = 1

    @property
    def is_profiled(self) -> bool:
        return True

    @property
    def jumps(self) -> bool:
        return bool(self.rate)

    words = "small deflections of {name}{about} have no effect (dead-band)"

    def grid(self) -> Iterable[float]:
        return self.scales.peak(self.place.name) * np.array([0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65])

    def change(self, limit: Any) -> Any:
        return -self._within(limit)

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        return self._extended(model, start, first=0.1)


@dataclass(frozen=True, eq=False, repr=False)
class Saturation(_Limited):
    """Deflections beyond the limit about the trim do no more than the limit."""

    stage: int = 2
    least = 0.1
    words = "large deflections of {name}{about} are cut off (saturation)"

    @property
    def is_profiled(self) -> bool:
        return True

    def grid(self) -> Iterable[float]:
        return self.scales.peak(self.place.name) * np.array([0.95, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2])

    def change(self, limit: Any) -> Any:
        return self._within(limit) - self._distance()

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        return self._extended(model, start, first=0.9)


@dataclass(frozen=True, eq=False, repr=False)
class InputLag(Lag):
    """A first-order actuator: tau z' + z = u, and z acts."""

    stage: int = 3

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        name = self.place.name
        extension.replace_input(name, self.follower(extension, Expr.symbol(name)))
        return extension.model()


@dataclass(frozen=True, eq=False, repr=False)
class InputDelay(Delay):
    """The input acts late; before its first sample it is taken as constant."""

    stage: int = 4

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        u = channel(self, points)
        return (late(points.t, u, shape[self.shape_names[0]]) - u)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        name = self.place.name
        extension.replace_input(name, extension.late_input(name, self.delay(extension)))
        return extension.model()
