"""A parameter that changes in the course of a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...modelling.model import Model
from ...sensitivities.trajectory import Points
from .candidate import Effect, ExtensionBuilder

__all__ = ["ParameterDrift"]


@dataclass(frozen=True, eq=False, repr=False)
class ParameterDrift(Effect):
    """The parameter p becomes p + d (t - tm) / T, with the middle tm of the record and its length T: d is its change
    over the record. That is another in another record."""

    transferable = False

    def _share(self, t: Expr) -> Expr:
        return Expr((t - (self.scales.begin + 0.5 * self.scales.duration)) / self.scales.duration)

    def signals(self, points: Points, shape: Mapping[str, float]) -> NDArray[np.float64]:
        middle = self.scales.begin + 0.5 * self.scales.duration
        return ((points.t - middle) / self.scales.duration)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        d = extension.parameter(self.coefficients[0], unit=model.units.get(self.place.name, ""))
        extension.replace_parameter(
            self.place.name, Expr.symbol(self.place.name) + d * self._share(Expr.symbol("time"))
        )
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.coefficients[0]: (-np.inf, np.inf)}
