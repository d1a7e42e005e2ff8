"""States that go no further than a limit: an overflow, an end stop."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...functions import smooth_abs, smooth_step
from ...modelling.model import Model
from ...sensitivities.trajectory import Points
from .candidate import Effect, ExtensionBuilder, largest_coefficient
from .scales import evaluated, of, rate_key

__all__ = ["EndStop", "StateLimit"]

_Array = NDArray[np.float64]

# A limit is rounded over this part of the range of the state, its rate over that of its rate.
_CORNER, _RATE = 0.004, 0.003
# Widths of the corner before the limit, at which a step is half done.
_CLOSED = 2.5
# Parts of the range, from either end, at which a limit is looked for, and how far outside of it it may be.
_PARTS, _BEYOND = np.array([0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4]), 0.02

# Part of a measured state's range in which samples crowd at a limit, part of all that are there, and times as many as
# next to it; of fewer samples nothing is said.
_CROWDED, _OFTEN, _MORE, _FEW = 0.04, 0.06, 1.5, 40


@dataclass(frozen=True, eq=False, repr=False)
class _StateEffect(Effect):
    """A state with a limit: an upper one where it lies above the median, else a lower."""

    stage: int = 5

    @property
    def several_starts(self) -> bool:
        return True

    @property
    def _x(self) -> str:
        return self.variables[0]

    def _span(self) -> tuple[float, float]:
        return self.scales.low.get(self._x, -0.5), self.scales.high.get(self._x, 0.5)

    def grid(self) -> Iterable[float]:
        low, high = self._span()
        centre = self.scales.centre(self._x)
        limits = [*(high - (high - low) * _PARTS), *(low + (high - low) * _PARTS)]
        return [x for i, x in enumerate(limits) if (x > centre) == (i < _PARTS.size)]

    def _side(self, limit: float) -> float:
        return 1.0 if limit > self.scales.centre(self._x) else -1.0

    @property
    def _corner(self) -> float:
        return _CORNER * self.scales.span(self._x)

    def _limit(self, extension: ExtensionBuilder) -> tuple[Expr, float]:
        """Declare the limit; and on which side of the motion it is."""
        (name,) = self.shape_names
        low, high = self._span()
        first = float(extension.start.get(name, self.shapes[0][name]))
        more = 0.2 * (high - low)
        unit = extension.old.units.get(self._x, "")
        limit = extension.parameter(name, first, bounds=(low - more, high + more), unit=unit)
        return limit, self._side(first)

    def reachable(self, states: Mapping[str, _Array], start: Mapping[str, float]) -> Mapping[str, _Array]:
        (name,) = self.shape_names
        if name not in start:
            return {}
        side = self._side(start[name])
        return {self._x: side * np.minimum(side * states[self._x], side * start[name])}

    def _reached(self, points: Sequence[Points]) -> tuple[float, float]:
        x = np.concatenate([of(p.values, self._x, p, "state") for p in points])
        more = _BEYOND * float(np.ptp(x))
        return float(x.min()) - more, float(x.max()) + more


@dataclass(frozen=True, eq=False, repr=False)
class StateLimit(_StateEffect):
    """A store that is full, or empty: beyond the limit its rate is 0 where it would go further (an overflow)."""

    def _change(self, rate: Expr, limit: Any, side: float) -> Expr:
        """Return what is added to the rate."""
        x = Expr.symbol(self._x)
        onward = side * rate
        outward = 0.5 * (onward + smooth_abs(onward, _RATE * self.scales.span(rate_key(self._x))))
        # It is full at the limit, not halfway.
        return Expr(-side * outward * smooth_step(side * (x - limit) + _CLOSED * self._corner, self._corner))

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        x, rate = (of(group, self._x, points, "state") for group in (points.values, points.rates))
        limit = shape[self.shape_names[0]]
        side = self._side(limit)
        return np.asarray(-rate * _full(points.t, side * x, side * rate, side * limit))[np.newaxis]

    def suggested(self, measured: Mapping[str, Sequence[_Array]]) -> Mapping[str, float] | None:
        """Return the upper or lower end of a measured state, where its samples crowd there."""
        for name, every in measured.items():
            if name != self._x:
                continue
            z = np.concatenate([y[np.isfinite(y)] for y in every])
            for side in (1.0, -1.0) if z.size > _FEW else ():
                end = float(np.quantile(side * z, 0.99))
                near, next_to = (
                    float(np.mean(np.abs(end - step * _CROWDED * np.ptp(z) - side * z) < 0.5 * _CROWDED * np.ptp(z)))
                    for step in (0.25, 1.25)
                )
                if near > max(_OFTEN, _MORE * next_to):
                    return {self.shape_names[0]: side * end}
        return None

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        limit, side = self._limit(extension)
        rate = extension.at(self.place)
        extension.put(self.place, rate + self._change(rate, limit, side))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.shape_names[0]: self._reached(points)}


def _full(t: _Array, x: _Array, rate: _Array, limit: float) -> _Array:
    """Return (n,) 1 where a store that fills at a rate is at its limit and would go on, 0 elsewhere."""
    full, now = np.zeros(t.size), min(float(x[0]), limit)
    for k, step in enumerate((np.diff(t) * 0.5 * (rate[1:] + rate[:-1])).tolist()):
        now += step
        if now >= limit:
            full[k + 1] = step > 0.0
            now = limit
    return full


@dataclass(frozen=True, eq=False, repr=False)
class EndStop(_StateEffect):
    """A position that meets a stop: beyond the limit a stiff spring acts on its rate, c (x - limit)."""

    def _beyond(self, limit: Any, side: float) -> Expr:
        distance = side * (Expr.symbol(self._x) - limit)
        return Expr(0.5 * (distance + smooth_abs(distance, self._corner)))

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        limit = shape[self.shape_names[0]]
        return -self._side(limit) * evaluated(self._beyond(limit, self._side(limit)), points)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        c = extension.parameter(self.coefficients[0])
        limit, side = self._limit(extension)
        extension.put(self.place, extension.at(self.place) - side * c * self._beyond(limit, side))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        largest = 50.0 * largest_coefficient(self, self.shapes[3], points)
        return {self.coefficients[0]: (0.0, largest), self.shape_names[0]: self._reached(points)}
