"""What is wrong in the same way with an input and with an output: scale, lag, delay."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from .along import lagged, of
from .effect import Effect, Extension
from .points import Points
from .timing import delay_bounds, delay_grid, lag_bounds, lag_grid, longest_delay, longest_lag

__all__ = ["Delay", "Lag", "Scale", "channel"]

_Array = NDArray[np.float64]

# A sensor or actuator whose scale is wrong by more was never calibrated.
_SCALE = 0.3


def channel(effect: Effect, points: Points) -> _Array:
    """(N,) the input or output that an effect acts on."""
    name, kind = effect.place.name, effect.place.kind
    return of(points.outputs if kind == "output" else points.values, name, points, kind)


@dataclass(frozen=True, eq=False, repr=False)
class Scale(Effect):
    """It becomes 1 + k times as large."""

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return channel(self, points)[np.newaxis]

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.coefficients[0]: (-_SCALE, _SCALE)}


@dataclass(frozen=True, eq=False, repr=False)
class Lag(Effect):
    """It is followed with a time constant, tau z' + z = it, from a steady start."""

    def grid(self) -> Iterable[float]:
        return lag_grid(self.scales)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        it = channel(self, points)
        return (lagged(points.t, it, shape[self.shape_names[0]]) - it)[np.newaxis]

    def follower(self, extension: Extension, name: str, it: Expr) -> Expr:
        """Declares tau and the state that follows."""
        (tau_name,) = self.shape_names
        tau = extension.parameter(tau_name, self.shapes[len(self.shapes) // 3][tau_name], **lag_bounds(self.scales))
        unit = extension.old.units.get(self.place.name, "")
        return extension.state(name, unit, lambda z: (it - z) / tau, it)

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.shape_names[0]: (0.0, longest_lag(points))}


@dataclass(frozen=True, eq=False, repr=False)
class Delay(Effect):
    """It is late."""

    def grid(self) -> Iterable[float]:
        return delay_grid(self.scales)

    def delay(self, extension: Extension) -> str:
        """Declares the delay, and gives its name."""
        (name,) = self.shape_names
        declared: dict[str, Any] = delay_bounds(self.scales)
        extension.parameter(name, **declared)
        return name

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.shape_names[0]: (0.0, longest_delay(points))}
