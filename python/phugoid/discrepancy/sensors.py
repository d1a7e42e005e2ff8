"""What a sensor does to an output as a whole: scale, delay, lag. (Bias and drift are terms.)"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model import Model
from .along import lagged, late_smooth, of
from .effect import Effect, Extension
from .points import Points
from .timing import delay_bounds, delay_grid, lag_bounds, lag_grid, longest_delay, longest_lag

__all__ = ["SensorDelay", "SensorLag", "SensorScale"]

_Array = NDArray[np.float64]

# A sensor or actuator whose scale is wrong by more was never calibrated.
SCALE = 0.3


@dataclass(frozen=True, eq=False, repr=False)
class SensorScale(Effect):
    """y becomes (1 + k) y."""

    stage: int = 6  # of all that the sensor sees, lever arms included

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return of(points.outputs, self.place.name, points, "output")[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = Extension(model, self, start)
        k = extension.parameter(self.coefficients[0])
        extension.put(self.place, (1 + k) * extension.at(self.place))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.coefficients[0]: (-SCALE, SCALE)}


@dataclass(frozen=True, eq=False, repr=False)
class SensorLag(Effect):
    """The output follows with a time constant: tau y' + y = what it was, from a steady start."""

    stage: int = 7

    def grid(self) -> Iterable[float]:
        return lag_grid(self.scales)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        y = of(points.outputs, self.place.name, points, "output")
        return (lagged(points.t, y, shape[self.shape_names[0]]) - y)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = Extension(model, self, start)
        tau = extension.parameter(
            self.shape_names[0], self.shapes[len(self.shapes) // 3][self.shape_names[0]], **lag_bounds(self.scales)
        )
        y = extension.at(self.place)
        unit = model.units.get(self.place.name, "")
        extension.put(self.place, extension.state(f"{self.place.name}_sensor", unit, lambda z: (y - z) / tau, y))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.shape_names[0]: (0.0, longest_lag(points))}


@dataclass(frozen=True, eq=False, repr=False)
class SensorDelay(Effect):
    """The output is measured late. Where that reaches back before the record there is no sample, and no effect."""

    stage: int = 8

    def grid(self) -> Iterable[float]:
        return delay_grid(self.scales)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        y = of(points.outputs, self.place.name, points, "output")
        rate = of(points.output_rates, self.place.name, points, "rate of output")
        late = late_smooth(points.t, y, rate, shape[self.shape_names[0]])
        return np.where(np.isfinite(late), late - y, 0.0)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = Extension(model, self, start)
        extension.at(self.place)
        extension.parameter(self.shape_names[0], **delay_bounds(self.scales))
        extension.late_output(self.place.name, self.shape_names[0])
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.shape_names[0]: (0.0, longest_delay(points))}
