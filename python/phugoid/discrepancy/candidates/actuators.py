"""Actuators whose answer depends on the past of their command: backlash and a limited rate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...functions import smooth_step, tanh
from ...modelling.model import Model
from ...sensitivities.trajectory import Points
from ..misfit.phrases import per_second
from .candidate import Effect, ExtensionBuilder
from .channel_effects import channel

__all__ = ["Backlash", "RateLimit"]

_Array = NDArray[np.float64]

# The state that follows the command settles within so many intervals of the mesh: less would be stiff for it.
_SETTLES = 1.5
# Corners are rounded over this part of the range of the command, and of a play that is small beside it, but over the
# last part of that range at least.
_CORNER, _OF_PLAY, _SHARPEST = 0.003, 0.1, 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class _Follower(Effect):
    """A state z that follows the input u with a short time constant, and acts in its place."""

    stage: int = 3

    @property
    def jumps(self) -> bool:
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
        u = Expr.symbol(self.place.name)
        unit = model.units.get(self.place.name, "")
        z = extension.state(self._state, unit, lambda z: self.slope(u - z, size, first), u)
        extension.replace_input(self.place.name, self.acting(z, self.slope(u - z, size, first)))
        return extension.model()


@dataclass(frozen=True, eq=False, repr=False)
class Backlash(_Follower):
    """The input has play: what acts stays where it is until the command has moved by the (half) width, and then follows
    at that distance (Tao and Kokotovic 1996, section 2.2)."""

    def grid(self) -> Iterable[float]:
        return 0.5 * self.scales.span(self.place.name) * np.array([0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])

    def path(self, t: _Array, u: _Array, size: float) -> _Array:
        z, now = np.empty(u.size), float(u[0])
        for k, (low, high) in enumerate(zip((u - size).tolist(), (u + size).tolist(), strict=True)):
            now = min(max(now, low), high)
            z[k] = now
        return z

    def slope(self, error: Expr, size: Expr, first: float) -> Expr:
        # Within the play nothing creeps but for exponentially little: records are many time constants long.
        span = self.scales.span(self.place.name)
        width = max(min(_CORNER * span, _OF_PLAY * first), _SHARPEST * span)
        above, below = error - size, error + size
        return Expr((above * smooth_step(above, width) + below * smooth_step(-below, width)) / self._tau)

    def acting(self, z: Expr, slope: Expr) -> Expr:
        # The state settles a little late; where it will settle acts at once.
        return Expr(z + self._tau * slope)

    def declared(self, model: Model) -> dict[str, Any]:
        return {"bounds": (0.0, self.scales.span(self.place.name)), "unit": model.units.get(self.place.name, "")}

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.shape_names[0]: (0.0, 0.5 * self.scales.span(self.place.name))}


@dataclass(frozen=True, eq=False, repr=False)
class RateLimit(_Follower):
    """What acts follows the command no faster than a greatest rate."""

    def grid(self) -> Iterable[float]:
        # From a travel over the whole range within two samples to one that takes a fifth of the record.
        quick, slow = 2.0 * self.scales.interval, 0.2 * self.scales.duration
        return self.scales.span(self.place.name) / np.geomspace(quick, max(slow, 2.0 * quick), 12)

    def path(self, t: _Array, u: _Array, size: float) -> _Array:
        z, now = np.empty(u.size), float(u[0])
        most = size * np.diff(t, prepend=t[0])
        for k, (target, step) in enumerate(zip(u.tolist(), most.tolist(), strict=True)):
            now += min(max(target - now, -step), step)
            z[k] = now
        return z

    def slope(self, error: Expr, size: Expr, first: float) -> Expr:
        return Expr(size * tanh(error / (size * self._tau)))

    def declared(self, model: Model) -> dict[str, Any]:
        span, unit = self.scales.span(self.place.name), model.units.get(self.place.name, "")
        bounds = (0.1 * span / self.scales.duration, 10.0 * span / self.scales.interval)
        return {"bounds": bounds, "unit": per_second(unit) if unit else ""}

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        fastest = max(float(np.abs(np.diff(channel(self, p)) / np.diff(p.t)).max()) for p in points if p.n > 1)
        return {self.shape_names[0]: (self.scales.span(self.place.name) / self.scales.duration, fastest)}
