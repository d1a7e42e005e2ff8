"""A periodic disturbance of unknown frequency."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...modelling.model import Model
from ...symbols import cos, sin
from .effect import Effect, Extension, place_range
from .points import Points
from .scales import Scales
from .timing import frequency_grid

__all__ = ["Periodic"]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Periodic(Effect):
    """a sin(w (t - tm)) + b cos(w (t - tm)), with tm the middle of the record: there phase and frequency are estimated
    almost independently of each other."""

    transferable = False

    def grid(self) -> Iterable[float]:
        return frequency_grid(self.scales)

    def _middle(self) -> float:
        return self.scales.begin + 0.5 * self.scales.duration

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        angle = shape[self.shape_names[0]] * (points.t - self._middle())
        return np.stack([np.sin(angle), np.cos(angle)])

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = Extension(model, self, start)
        a, b = (extension.parameter(name) for name in self.coefficients)
        (name,) = self.shape_names
        # Half a cycle a record is still a trend; near half the sampling rate slow disturbances look fast.
        bounds = (0.5 * np.pi / self.scales.duration, 0.7 * np.pi / self.scales.interval)
        w = extension.parameter(name, self.shapes[0][name], bounds=bounds, unit="rad/s")
        angle = w * (Expr.symbol("time") - self._middle())
        extension.put(self.place, extension.at(self.place) + a * sin(angle) + b * cos(angle))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        # Amplitudes as those of a term: its peak to peak is twice the amplitude. With less than three cycles in a
        # record it is a trend, not an oscillation; faster than a quarter of the sampling rate no time history shows it.
        largest, scales = place_range(self.place, points), Scales.of(points)
        lowest, highest = 6.0 * np.pi / scales.duration, 0.5 * np.pi / scales.interval
        a, b = self.coefficients
        return {a: (-largest, largest), b: (-largest, largest), self.shape_names[0]: (lowest, highest)}
