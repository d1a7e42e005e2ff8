"""Factors by which a state equation, a quantity or a parameter is larger, constant or by a variable."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...functions import exp, log
from ...modelling.model import Model
from ...sensitivities import Points
from .candidate import Candidate, Effect, ExtensionBuilder
from .channel_effects import Scale
from .scales import has_powers, of

__all__ = ["HOW", "EquationScale", "FactorExponent", "FactorLaw", "ParameterLaw", "SaturatingRate"]

_Array = NDArray[np.float64]

# Least and greatest factor by which a rate that depends on a variable may change over a record, and an inertia.
_FACTOR, _OF_INERTIA = (0.1, 10.0), (0.3, 3.0)
# Change of the exponent of a factor.
_EXPONENT = (-1.5, 3.0)
# Half-saturation constants, in parts of the greatest value of the variable: least, greatest, and number in a scan.
_HALF, _HALVES = (0.02, 5.0), 6

HOW = {"exponential": "exponentially", "linear": "along a straight line", "power": "by a power of it"}
"""Laws of factors in words."""


@dataclass(frozen=True, eq=False, repr=False)
class EquationScale(Scale):
    """All that stands in a state equation or a quantity becomes 1 + k times as large, by another mass, inertia or gear
    ratio where numbers that are taken as known stand there; or 1 + k (x - x0)^power times, where the mass, inertia or
    inductance depends on a state, the ``variables``' only one, in a device with a saturated core, say."""

    power: int = 0
    stage: int = 1  # of terms that were added, too

    @property
    def centred(self) -> bool:
        return self.power > 0

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        within = points.rates if self.place.kind == "equation" else points.values
        whole = of(within, self.place.name, points, self.place.kind)
        for name in self.variables:
            x = of(points.values, name, points, "state")
            whole = whole * (x - self.scales.centre(name)) ** self.power
        return whole[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        more = extension.parameter(self.coefficients[0]) * extension.at(self.place)
        for name in self.variables:
            centre = self.scales.centre(name)
            more = more * (Expr.symbol(name) - centre if centre else Expr.symbol(name)) ** self.power
        extension.add(self.place, more)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        if not self.power:
            return super().physical(points)
        peak = max(self.scales.peak(*self.variables) ** self.power, 1e-300)
        low, high = _OF_INERTIA
        return {self.coefficients[0]: ((low - 1.0) / peak, (high - 1.0 if self.power % 2 == 0 else 1.0 - low) / peak)}

    def has_reason(self, values: Mapping[str, float]) -> bool:
        return not self.power and super().has_reason(values)


@dataclass(frozen=True, eq=False, repr=False)
class FactorLaw(Effect):
    """A quantity that is a product becomes exp(k (x - x0)) times as large, as a rate of reaction with the temperature,
    or 1 + k (x - x0) times, as growth that a product inhibits, or (x / x0)^k times, as a heat transfer with a flow,
    where the ``variables``' only one stays positive."""

    law: Literal["exponential", "linear", "power"] = "exponential"
    stage: int = 1  # of terms that were added, too

    @property
    def centred(self) -> bool:
        return True

    def variants(self, points: Sequence[Points]) -> Sequence[Candidate]:
        """Return the power law."""
        (x,) = self.variables
        low, high = (f(float(f(of(p.values, x, p, "state, input or quantity"))) for p in points) for f in (min, max))
        return (self._by("power"),) if has_powers(low, high) and self.scales.centre(x) > 0.0 else ()

    @property
    def otherwise(self) -> Candidate | None:
        return self._by("linear") if self.law == "exponential" else None

    def _by(self, law: Literal["linear", "power"]) -> FactorLaw:
        return replace(self, law=law, explanation=self.explanation.replace(HOW[self.law], HOW[law]))

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        whole = of(points.values, self.place.name, points, self.place.kind)
        return (whole * self._change(points))[np.newaxis]

    def _change(self, points: Points) -> _Array:
        """Return (n,) the change of the factor for a small k, in parts of it."""
        (name,) = self.variables
        x, centre = of(points.values, name, points, "state, input or quantity"), self.scales.centre(name)
        return np.asarray(np.log(x / centre) if self.law == "power" else x - centre)

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        (name,) = self.variables
        x, centre, k = Expr.symbol(name), self.scales.centre(name), extension.parameter(self.coefficients[0])
        distance = x - centre if centre else x
        laws = {"exponential": exp(k * distance), "linear": 1 + k * distance}
        factor = exp(k * log(x / centre)) if self.law == "power" else laws[self.law]
        extension.put(self.place, extension.at(self.place) * factor)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        changes = np.concatenate([self._change(p) for p in points])
        largest = max(float(np.abs(changes).max()), 1e-300)
        low, high = _FACTOR
        if self.law == "linear":  # no negative factor
            most = [(low - 1.0) / c for c in (float(changes.max()), float(changes.min())) if c]
            return {
                self.coefficients[0]: (
                    max((m for m in most if m < 0.0), default=-np.inf),
                    min((m for m in most if m > 0.0), default=np.inf),
                )
            }
        return {self.coefficients[0]: (float(np.log(low)) / largest, float(np.log(high)) / largest)}


@dataclass(frozen=True, eq=False, repr=False)
class ParameterLaw(Effect):
    """The parameter p becomes p + d (x - x0) with a condition x, the ``variables``' only one: a derivative that changes
    with the Mach number, or a term with another exponent of the airspeed."""

    @property
    def centred(self) -> bool:
        return True

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        (name,) = self.variables
        return (points.values[name] - self.scales.centre(name))[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        (name,) = self.variables
        d, centre, p = extension.parameter(self.coefficients[0]), self.scales.centre(name), self.place.name
        extension.replace_parameter(p, Expr.symbol(p) + d * (Expr.symbol(name) - centre))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.coefficients[0]: (-np.inf, np.inf)}


@dataclass(frozen=True, eq=False, repr=False)
class FactorExponent(Effect):
    """The parameter p of a term p x becomes p (x / x0)^e, where x, the ``variables``' only one, stays positive: the
    term is in proportion to the power 1 + e of x, as a heat transfer does with a flow."""

    def worthwhile(self) -> bool:
        return super().worthwhile() and self.scales.stays_positive(*self.variables)

    @property
    def _reference(self) -> float:
        return float(f"{self.scales.peak(*self.variables):.2g}") or 1.0

    def _logarithm(self, points: Points) -> _Array:
        (name,) = self.variables
        x = of(points.values, name, points, "state, input or quantity") / self._reference
        return np.asarray(np.log(np.maximum(x, 1e-12)))

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return (points.parameters.get(self.place.name, 1.0) * self._logarithm(points))[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        (name,) = self.variables
        e, p = extension.parameter(self.coefficients[0], bounds=_EXPONENT), Expr.symbol(self.place.name)
        extension.replace_parameter(self.place.name, p * exp(e * log(Expr.symbol(name) / self._reference)))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        return {self.coefficients[0]: _EXPONENT}


@dataclass(frozen=True, eq=False, repr=False)
class SaturatingRate(Effect):
    """The parameter p of a rate p x becomes p + d K / (K + x), so that the rate is p x + d K x / (K + x): a part that
    saturates with x, the ``variables``' only one, beside one that does not (Michaelis and Menten, Monod, Holling's
    second type; Langmuir)."""

    def grid(self) -> Iterable[float]:
        low, high = _HALF
        return self._peak * np.geomspace(low, high, _HALVES)

    @property
    def _peak(self) -> float:
        return max(self.scales.peak(*self.variables), 1e-300)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        half, x = shape[self.shape_names[0]], np.maximum(points.values[self.variables[0]], 0.0)
        return (half / (half + x))[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        (name,), (shape,), units = self.variables, self.shape_names, model.variable_units
        d = extension.parameter(self.coefficients[0], unit=units.get(self.place.name, ""))
        bounds = tuple(f * self._peak for f in _HALF)
        half = extension.parameter(shape, self.shapes[_HALVES // 2][shape], bounds=bounds, unit=units.get(name, ""))
        extension.replace_parameter(
            self.place.name, Expr.symbol(self.place.name) + d * half / (half + Expr.symbol(name))
        )
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        low, high = _HALF
        return {self.coefficients[0]: (-np.inf, np.inf), self.shape_names[0]: (low * self._peak, high * self._peak)}
