"""A quantity that follows a variable with a lag: unsteady aerodynamics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...modelling.model import Model
from .along import lagged, of
from .effect import Effect, Extension, largest_coefficient
from .points import Points
from .timing import lag_bounds, lag_grid, longest_lag

__all__ = ["LaggedVariable"]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class LaggedVariable(Effect):
    """c z with tau z' + z = variable, from a steady start.

    While c is 0 nothing depends on tau: an estimation is to start from values for both, such as a scan gives.
    """

    def grid(self) -> Iterable[float]:
        return lag_grid(self.scales)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        u = of(points.values, self.variables[0], points, "state or input")
        return lagged(points.t, u, shape[self.shape_names[0]])[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = Extension(model, self, start)
        (tau_name,) = self.shape_names
        (variable,) = self.variables
        c = extension.parameter(self.coefficients[0])
        # An ever smaller time constant with an ever larger coefficient comes to a derivative, and steps in the constant
        # itself run away there; steps in its logarithm come back from twice as many starts.
        options = {**lag_bounds(self.scales), "transform": "log"}
        tau = extension.parameter(tau_name, self.shapes[len(self.shapes) // 2][tau_name], **options)
        u = Expr.symbol(variable)
        lag = extension.state(f"{variable}_lag", model.units.get(variable, ""), lambda z: (u - z) / tau, u)
        extension.put(self.place, extension.at(self.place) + c * lag)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        # As a term whose signal is the variable itself: a lag only makes it smaller.
        shape = {self.shape_names[0]: 0.02 * self.scales.interval}
        largest = largest_coefficient(self, shape, points)
        return {self.coefficients[0]: (-largest, largest), self.shape_names[0]: (0.0, longest_lag(points))}
