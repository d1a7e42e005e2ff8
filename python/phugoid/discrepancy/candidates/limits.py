"""Limits of states (an overflow, an end stop) and of forces, and actuators with backlash or a limited rate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr, play, rate_limited
from ...functions import smooth_abs, smooth_step, tanh
from ...modelling.model import Model
from ...sensitivities import Place, Points
from .candidate import Candidate, Effect, ExtensionBuilder
from .channel_effects import channel, cut_off
from .scales import evaluated, of, output_key, rate_key

__all__ = ["Backlash", "EndStop", "LimitedForce", "Overflow", "RateLimit", "StateLimit"]


_Array = NDArray[np.float64]

# A limit is rounded over this part of the range of the state, its rate over that of its rate.
_CORNER, _RATE = 0.004, 0.003
# Part of the peak of a force over which its limit is rounded.
_FORCE = 0.01
# Widths of the corner before the limit, at which a step is half done.
_CLOSED = 2.5
# Parts of the range, from either end, at which a limit is looked for, and how far outside of it it may be.
_PARTS, _BEYOND = np.array([0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4]), 0.02
# Parts of the range by which an estimate of a limit may be outside of it; and times the greatest value of a state that
# no output measures: what a model that lacks the limit says of its size may be far off.
_FARTHER, _UNMEASURED = 0.2, 20.0
# Radians of a contact's motion from one point of the mesh to the next, at most; and the part of that stiffness at which
# the search begins.
_QUICKEST, _SOFT = 0.5, 0.05
# By how many times a stop's force may rise at a speed of the whole range of speeds; the part of it at which the search
# begins; and the corner of what does not pull.
_LOSS, _LITTLE, _PUSH = 200.0, 0.002, 0.05

# Part of a measured state's range in which samples crowd at a limit, part of all that are there, and times as many as
# next to it; of fewer samples nothing is said. Oscillations crowd where they turn, but at both ends: times as many as
# at the other.
_CROWDED, _OFTEN, _MORE, _RESTS, _FEW = 0.04, 0.06, 1.5, 3.0, 40

# Part of an overflow that another store gets, at which the search begins, and at most: stores differ in their areas.
_PART, _MOST = 0.5, 5.0


@dataclass(frozen=True, eq=False, repr=False)
class _StateEffect(Effect):
    """A state with a limit: an upper one where it lies above the median, else a lower."""

    stage: int = 5

    @property
    def _one_sided(self) -> float:
        """Return how many times as many samples there are to be at a limit as at the other end of the range."""
        return 0.0

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
        name = self.shape_names[0]
        low, high = self._span()
        first = float(extension.start.get(name, self.shapes[0][name]))
        unit = extension.old.variable_units.get(self._x, "")
        more = _FARTHER * (high - low)
        if not self._is_measured(extension.old):
            more = _UNMEASURED * max(high - low, abs(low), abs(high))
        limit = extension.parameter(name, first, bounds=self._bounds(low, high, more), unit=unit)
        return limit, self._side(first)

    def _is_measured(self, model: Model) -> bool:
        """Return whether an output depends on the state, of the other variables on none."""
        outputs = [e for (kind, _), e in model._right_hand_sides().items() if kind == "output"]
        variables = {*model.state_names, *model.input_names, *model.quantity_names}
        return any(variables & {*e.symbols} == {self._x} for e in outputs)

    def _bounds(self, low: float, high: float, more: float) -> tuple[float, float]:
        """Return bounds of the limit of a state between two values, and by how much it may be beyond these."""
        return low - more, high + more

    def reachable(self, states: Mapping[str, _Array], start: Mapping[str, float]) -> Mapping[str, _Array]:
        name = self.shape_names[0]
        if name not in start:
            return {}
        side = self._side(start[name])
        return {self._x: side * np.minimum(side * states[self._x], side * start[name])}

    def suggested(self, measured: Mapping[str, Sequence[_Array]]) -> Mapping[str, float] | None:
        """Return the upper or lower end of a measured state, where its samples crowd there."""
        for name, every in measured.items():
            if name != self._x:
                continue
            z = np.concatenate([y[np.isfinite(y)] for y in every])
            if z.size <= _FEW:
                continue
            crowds = {side: _crowded(side * z) for side in (1.0, -1.0)}
            for side, (end, near, next_to) in crowds.items():
                if near > max(_OFTEN, _MORE * next_to, self._one_sided * crowds[-side][1]):
                    return {self.shape_names[0]: side * end}
        return None

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

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        limit, side = self._limit(extension)
        rate = extension.at(self.place)
        self._add(extension, self._change(rate, limit, side))
        return extension.model()

    def _add(self, extension: ExtensionBuilder, change: Expr) -> None:
        """Add the change of the rate to the equations."""
        extension.put(self.place, extension.at(self.place) + change)

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.shape_names[0]: self._reached(points)}


@dataclass(frozen=True, eq=False, repr=False)
class Overflow(StateLimit):
    """A store that is full, of which a part of what comes further flows into another store (the lower of two tanks).

    into  the state that gets that part, per unit of what the full store does not take.
    """

    into: str = ""

    def _add(self, extension: ExtensionBuilder, change: Expr) -> None:
        super()._add(extension, change)
        part = extension.parameter(self.shape_names[1], _PART, bounds=(0.0, _MOST))
        extension.add(Place("equation", self.into), -part * change)

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {**super().physical(points), self.shape_names[1]: (0.0, _MOST)}


@dataclass(frozen=True, eq=False, repr=False)
class LimitedForce(Effect):
    """A force, or a rate, that comes to no more than a limit either way: the current of a drive, the traction of a
    tyre, the thrust of a motor. Corners are rounded as those of an input that saturates."""

    stage: int = 5

    @property
    def _peak(self) -> float:
        low, high = (group.get(self._key, 1.0) for group in (self.scales.low, self.scales.high))
        return max(abs(low), abs(high)) or 1.0

    @property
    def _width(self) -> float:
        return _FORCE * self._peak

    @property
    def _key(self) -> str:
        return rate_key(self.place.name) if self.place.kind == "equation" else self.place.name

    def grid(self) -> Iterable[float]:
        return self._peak * np.array([0.95, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2])

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        group = points.rates if self.place.kind == "equation" else points.values
        force, limit = of(group, self.place.name, points, "rate or quantity"), shape[self.shape_names[0]]
        return np.asarray(cut_off(force, limit, self._width, np.hypot) - force)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        peak, unit = self._peak, model.variable_units.get(self.place.name, "") if self.place.kind == "quantity" else ""
        limit = extension.parameter(self.shape_names[0], 0.9 * peak, bounds=(0.0, 2.0 * peak), unit=unit)
        force = extension.at(self.place)
        extension.add(self.place, cut_off(force, limit, self._width) - force)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.shape_names[0]: (0.1 * self._peak, self._peak)}


def _crowded(z: _Array) -> tuple[float, float, float]:
    """Return the upper end of samples (n,), and the parts of them that are there and next to it."""
    end, width = float(np.quantile(z, 0.99)), _CROWDED * float(np.ptp(z))
    near, next_to = (float(np.mean(np.abs(end - step * width - z) < 0.5 * width)) for step in (0.25, 1.25))
    return end, near, next_to


def _full(t: _Array, x: _Array, rate: _Array, limit: float) -> _Array:
    """Return (n,) 1 where a store that fills at a rate is at its limit and would go on, 0 elsewhere."""
    full, now = np.zeros(t.size), min(float(x[0]), limit)
    for k, step in enumerate((np.diff(t) * 0.5 * (rate[1:] + rate[:-1])).tolist()):
        now += step
        if now >= limit:
            full[k + 1] = step > 0.0
            now = limit
    return full


# Least distance of two stops from the middle, as a part of how far the state goes.
_APART = 0.03


@dataclass(frozen=True, eq=False, repr=False)
class EndStop(_StateEffect):
    """A position that meets a stop: beyond the limit a stiff spring with losses acts on its rate, c d (1 + b d') with d
    = x - limit, which only pushes (Hunt and Crossley 1975, exponent 1). With great losses the position stays there.

    speed       the state that is the rate of the position.
    both_sides  whether there is another stop as far on the other side of zero.
    """

    speed: str = ""
    both_sides: bool = False

    def variants(self, points: Sequence[Points]) -> Sequence[Candidate]:
        return () if self.both_sides or not self.scales.crosses(self._x) else (replace(self, both_sides=True),)

    @property
    def lesser(self) -> Candidate | None:
        return replace(self, both_sides=False) if self.both_sides else None

    def grid(self) -> Iterable[float]:
        if not self.both_sides:
            return super().grid()
        return [float(x) for x in max(abs(x) for x in self._span()) * (1.0 - 2.0 * _PARTS)]

    def _side(self, limit: float) -> float:
        return 1.0 if self.both_sides else super()._side(limit)

    def _bounds(self, low: float, high: float, more: float) -> tuple[float, float]:
        if not self.both_sides:
            return super()._bounds(low, high, more)
        # Two stops that meet are a spring.
        far = max(abs(low), abs(high))
        return _APART * far, far + more

    def _reached(self, points: Sequence[Points]) -> tuple[float, float]:
        low, high = super()._reached(points)
        far = max(abs(low), abs(high))
        return (1.01 * _APART * far, far) if self.both_sides else (low, high)

    def reachable(self, states: Mapping[str, _Array], start: Mapping[str, float]) -> Mapping[str, _Array]:
        name = self.shape_names[0]
        if self.both_sides and name in start:
            return {self._x: np.clip(states[self._x], -abs(start[name]), abs(start[name]))}
        return super().reachable(states, start)

    def suggested(self, measured: Mapping[str, Sequence[_Array]]) -> Mapping[str, float] | None:
        return None if self.both_sides else super().suggested(measured)

    @property
    def begins_measured(self) -> bool:
        return True

    @property
    def _one_sided(self) -> float:
        return _RESTS

    def _force(self, limit: Any, side: float, loss: Any) -> Expr:
        """Return the force of springs of unit stiffness on the position."""
        upper = -side * self._push(limit, side, loss)
        return Expr(upper + self._push(-limit, -side, loss)) if self.both_sides else Expr(upper)

    def _push(self, limit: Any, side: float, loss: Any) -> Expr:
        """Return the force of a spring of unit stiffness, away from the stop."""
        distance = side * (Expr.symbol(self._x) - limit)
        beyond = 0.5 * (distance + smooth_abs(distance, self._corner))
        push = 1.0 + side * loss * Expr.symbol(self.speed)
        return Expr(beyond * 0.5 * (push + smooth_abs(push, _PUSH)))

    def _stiffest(self) -> float:
        """Return the stiffness of a contact that lasts for a few samples: the records do not
        determine a greater one, with which motions between the samples would be arbitrary."""
        s = self.scales
        gain = s.span(rate_key(self.speed)) / s.span(self.place.name) if self.place.kind == "quantity" else 1.0
        return (_QUICKEST / s.interval) ** 2 / max(gain, 1e-300)

    def _most_loss(self) -> float:
        return _LOSS / self.scales.span(rate_key(self._x))

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        limit, *more = (shape[n] for n in self.shape_names if n in shape)
        side = self._side(limit)
        return evaluated(self._force(limit, side, more[0] if more else 0.0), points)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        most = self._stiffest()
        # Of no stiffness the limit would do nothing, and of much it would have to be known.
        (name,) = self.coefficients
        first = max(extension.start.get(name, 0.0), _SOFT * most)
        extension.start[name] = first
        c = extension.parameter(name, bounds=(0.0, most))
        limit, side = self._limit(extension)
        loss = extension.parameter(self.shape_names[1], _LITTLE * self._most_loss(), bounds=(0.0, self._most_loss()))
        extension.add(self.place, c * self._force(limit, side, loss))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        limit, loss = self.shape_names
        most = 1.001 * self._stiffest()
        return {self.coefficients[0]: (0.0, most), limit: self._reached(points), loss: (0.0, 1.001 * self._most_loss())}


# The state that follows the command settles within so many intervals of the mesh: less would be stiff for it.
_SETTLES = 1.5
# Corners are rounded over this part of the range of the command, and of a play that is small beside it, but over the
# last part of that range at least.
_ROUNDED, _OF_PLAY, _SHARPEST = 0.003, 0.03, 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class _Follower(Effect):
    """A state z that follows an input or an output u with a short time constant, and takes its place."""

    stage: int = 3

    @property
    def jumps(self) -> bool:
        return True

    @property
    def begins_measured(self) -> bool:
        return True

    @property
    def several_starts(self) -> bool:
        return True

    @property
    def _tau(self) -> float:
        return _SETTLES * self.scales.interval

    @property
    def _state(self) -> str:
        return f"{self.place.name}_{self.family}"

    def path(self, t: _Array, u: _Array, size: float) -> _Array:
        """Return (n,) what acts for an input (n,) at times (n,), z = u at first."""
        raise NotImplementedError

    def slope(self, error: Expr, size: Expr, first: float) -> Expr:
        """Return z' for u - z; the size starts at ``first``."""
        raise NotImplementedError

    def acting(self, z: Expr, slope: Expr) -> Expr:
        """Return what acts on the vehicle."""
        return z

    def declared(self, model: Model) -> dict[str, Any]:
        """Return unit and bounds of the parameter."""
        raise NotImplementedError

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        u = channel(self, points)
        return (self.path(points.t, u, shape[self.shape_names[0]]) - u)[np.newaxis]

    def paths(self, points: Points, start: Mapping[str, float]) -> Mapping[str, _Array]:
        u, (name,) = channel(self, points), self.shape_names
        return {self._state: self.path(points.t, u, start[name])} if name in start else {}

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        (name,) = self.shape_names
        first = float(extension.start.get(name, self.shapes[len(self.shapes) // 2][name]))
        size = extension.parameter(name, first, **self.declared(model))
        of_output = self.place.kind == "output"
        u = extension.at(self.place) if of_output else Expr.symbol(self.place.name)
        unit = model.units.get(self.place.name, "")
        z = extension.state(self._state, unit, lambda z: self.slope(u - z, size, first), u)
        acting = self.acting(z, self.slope(u - z, size, first))
        if of_output:
            extension.put(self.place, acting)
        else:
            extension.replace_input(self.place.name, acting)
        return extension.model()


@dataclass(frozen=True, eq=False, repr=False)
class Backlash(_Follower):
    """The input has play: what acts stays where it is until the command has moved by the (half) width, and then follows
    at that distance (Tao and Kokotovic 1996, section 2.2). Of an output: what the sensor is driven by has play."""

    @property
    def _span(self) -> float:
        name = self.place.name
        return self.scales.span(output_key(name) if self.place.kind == "output" else name)

    def grid(self) -> Iterable[float]:
        parts = np.array([0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])
        # A position may go round many times, of which the play of its sensor is a small part.
        finer = [0.0005, 0.001, 0.002, 0.005, 0.01] if self.place.kind == "output" else []
        return 0.5 * self._span * np.concatenate([finer, parts])

    def path(self, t: _Array, u: _Array, size: float) -> _Array:
        return play(u, size)

    def slope(self, error: Expr, size: Expr, first: float) -> Expr:
        # Within the play nothing creeps but for exponentially little: records are many time constants long.
        width = max(min(_ROUNDED * self._span, _OF_PLAY * first), _SHARPEST * self._span)
        above, below = error - size, error + size
        return Expr((above * smooth_step(above, width) + below * smooth_step(-below, width)) / self._tau)

    def acting(self, z: Expr, slope: Expr) -> Expr:
        # The state settles a little late; where it will settle acts at once.
        return Expr(z + self._tau * slope)

    def declared(self, model: Model) -> dict[str, Any]:
        return {"bounds": (0.0, self._span), "unit": model.units.get(self.place.name, "")}

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.shape_names[0]: (0.0, 0.5 * self._span)}


@dataclass(frozen=True, eq=False, repr=False)
class RateLimit(_Follower):
    """Let what acts follow the command no faster than a greatest rate."""

    def grid(self) -> Iterable[float]:
        # From a travel over the whole range within two samples to one that takes a fifth of the record.
        quick, slow = 2.0 * self.scales.interval, 0.2 * self.scales.duration
        return self.scales.span(self.place.name) / np.geomspace(quick, max(slow, 2.0 * quick), 12)

    def path(self, t: _Array, u: _Array, size: float) -> _Array:
        return rate_limited(t, u, size)

    def slope(self, error: Expr, size: Expr, first: float) -> Expr:
        return Expr(size * tanh(error / (size * self._tau)))

    def declared(self, model: Model) -> dict[str, Any]:
        span, unit = self.scales.span(self.place.name), model.units.get(self.place.name, "")
        bounds = (0.1 * span / self.scales.duration, 10.0 * span / self.scales.interval)
        return {"bounds": bounds, "unit": model.time_unit.rate(unit) if unit else ""}

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        fastest = max(float(np.abs(np.diff(channel(self, p)) / np.diff(p.t)).max()) for p in points if p.n > 1)
        return {self.shape_names[0]: (self.scales.span(self.place.name) / self.scales.duration, fastest)}
