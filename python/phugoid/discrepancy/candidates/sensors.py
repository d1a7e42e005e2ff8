"""What a sensor does to an output as a whole: scale, delay, lag. (Bias and drift are terms.)"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...modelling.model import Model
from .along import late_smooth, of
from .channel_effects import Delay, Lag, Scale, channel
from .effect import Extension
from .points import Points

__all__ = ["SensorDelay", "SensorLag", "SensorScale"]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class SensorScale(Scale):
    """y becomes (1 + k) y."""

    stage: int = 6  # of all that the sensor sees, lever arms included

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = Extension(model, self, start)
        k = extension.parameter(self.coefficients[0])
        extension.put(self.place, (1 + k) * extension.at(self.place))
        return extension.model()


@dataclass(frozen=True, eq=False, repr=False)
class SensorLag(Lag):
    """The output follows with a time constant: tau y' + y = what it was, from a steady start."""

    stage: int = 7

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = Extension(model, self, start)
        y = self.follower(extension, f"{self.place.name}_sensor", extension.at(self.place))
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
        extension = Extension(model, self, start)
        extension.at(self.place)
        extension.late_output(self.place.name, self.delay(extension))
        return extension.model()
