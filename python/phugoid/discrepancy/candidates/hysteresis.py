"""Terms that depend on the past of the motion: hysteresis, friction at rest, stall, a mode that the model lacks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr, bouc_wen, lagged
from ...functions import exp, smooth_abs, smooth_sign, sqrt, tanh
from ...modelling.model import Model
from ...sensitivities import Place, Points
from .candidate import Candidate, Effect, ExtensionBuilder, largest_coefficient
from .scales import evaluated, lag_bounds, lag_grid, longest_lag, mode_grid, of, rate_key, second_order

__all__ = ["FlexibleMode", "Hysteresis", "Stall", "Stribeck"]

_Array = NDArray[np.float64]

# Kinks are rounded over this part of the range of a rate, or of 1.
_KINK = 0.01
# How a hysteresis turns: sharply, and what a scan tries; the least that is looked for, and the standard deviation of
# the prior about a sharp turn.
_SHARP, _TURNS, _LEAST_TURN, _TURN_DEVIATION = 1.0, (1.0, -1.2), -3.0, 1.5
# The jump of dry friction is rounded over this part of a velocity's range, as that of Coulomb friction is.
_JUMP = 0.005
# Of stall what a scan tries: the angle at which half of the flow is separated, above the least in parts of the range of
# the angle of attack, the half width of the transition in the same, and the place of the time constant among those of
# lags. And the part of the chord that is attached below which its root is rounded.
_BREAKS, _WIDTHS, _LATE, _ATTACHED = (0.45, 0.6, 0.75, 0.9), (0.06, 0.15), (2, 5), 1e-3
# Damping ratio of a mode that is looked for, and those that it may have.
_DAMPING, _DAMPINGS = 0.05, (0.0005, 0.5)


@dataclass(frozen=True, eq=False, repr=False)
class Hysteresis(Effect):
    """A force c z that follows the motion x elastically until it yields, and remembers where it turned (Bouc 1967, Wen
    1976, with exponent 1): d z' = x' - (|x'| z + s x' |z|) / 2, z = 0 at first.

    With s = 1 it returns as stiff as it began: with a small yield displacement d it is dry friction with presliding
    (Dahl 1968), with a large one a spring. With s = 0 it returns along a smooth loop, and with s below -1 it hardens
    and does not yield. s has a Gaussian prior, for a motion with turns all alike determines it poorly.
    """

    stage: int = 5  # after all that changes the equation of the motion

    def __post_init__(self) -> None:
        super().__post_init__()
        size, turn = self.shape_names
        shapes = [{**shape, turn: s} for s in _TURNS for shape in self.shapes if size in shape]
        object.__setattr__(self, "shapes", tuple(shapes))

    @property
    def several_starts(self) -> bool:
        return True

    def grid(self) -> Iterable[float]:
        return self.scales.span(self.variables[0]) * np.array([0.01, 0.02, 0.04, 0.08, 0.15, 0.3, 0.6])

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        x = of(points.values, self.variables[0], points, "state")
        size, turn = self.shape_names
        return bouc_wen(x, shape[size], shape.get(turn, _SHARP))[np.newaxis]

    @property
    def _state(self) -> str:
        return f"{self.place.name}_hysteresis"

    def paths(self, points: Points, start: Mapping[str, float]) -> Mapping[str, _Array]:
        size, turn = self.shape_names
        x = of(points.values, self.variables[0], points, "state")
        return {self._state: bouc_wen(x, start[size], start.get(turn, _SHARP))} if size in start else {}

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        (name, turn), (x,) = self.shape_names, self.variables
        span, unit = self.scales.span(x), model.variable_units.get(x, "")
        c = extension.parameter(self.coefficients[0])
        bounds = (1e-3 * span, 10.0 * span)
        d = extension.parameter(name, self.shapes[2][name], bounds=bounds, unit=unit, transform="log")
        s = extension.parameter(turn, _SHARP, bounds=(_LEAST_TURN, _SHARP), prior=(_SHARP, _TURN_DEVIATION))
        rate = extension.at(Place("equation", x))
        size = smooth_abs(rate, _KINK * self.scales.span(rate_key(x)))
        z = extension.state(
            self._state, "", lambda z: (rate - 0.5 * (size * z + s * rate * smooth_abs(z, _KINK))) / d, 0.0
        )
        extension.add(self.place, c * z)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        name, turn = self.shape_names
        largest = largest_coefficient(self, self.shapes[2], points)
        span = self.scales.span(self.variables[0])
        return {self.coefficients[0]: (-largest, largest), name: (0.002 * span, span), turn: (_LEAST_TURN, _SHARP)}


@dataclass(frozen=True, eq=False, repr=False)
class Stribeck(Effect):
    """Dry friction that is larger at rest: c sign(v) exp(-(v / v_s)^2), beside Coulomb friction (Armstrong-Helouvry,
    Dupont and Canudas de Wit 1994, eq. 5): a candidate where that is there, since a wide one is nearly the same.

    ``direction``: the sign with which the place adds to the rate of v, 0 where it is not known.
    """

    direction: int = 1

    @property
    def several_starts(self) -> bool:
        return True

    @property
    def jumps(self) -> bool:
        return True

    def grid(self) -> Iterable[float]:
        return self.scales.peak(self.variables[0]) * np.array([0.02, 0.04, 0.08, 0.15, 0.3])

    def _shape(self, size: Any) -> Expr:
        v = Expr.symbol(self.variables[0])
        return Expr(smooth_sign(v, _JUMP * self.scales.span(self.variables[0])) * exp(-((v / size) ** 2)))

    def worthwhile(self) -> bool:
        return super().worthwhile() and self.scales.crosses(self.variables[0])

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return evaluated(self._shape(shape[self.shape_names[0]]), points)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        (name,), (v,) = self.shape_names, self.variables
        peak = self.scales.peak(v)
        c = extension.parameter(self.coefficients[0])
        size = extension.parameter(
            name,
            self.shapes[2][name],
            bounds=(2e-3 * peak, 5.0 * peak),
            unit=model.variable_units.get(v, ""),
            transform="log",
        )
        extension.add(self.place, c * self._shape(size))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        largest = largest_coefficient(self, self.shapes[2], points)
        peak = self.scales.peak(self.variables[0])
        # Friction is no less at rest than in motion, and beyond half the greatest speed it is no effect of low ones.
        least, most = (0.0 if self.direction < 0 else -largest), (0.0 if self.direction > 0 else largest)
        return {self.coefficients[0]: (least, most), self.shape_names[0]: (0.005 * peak, 0.5 * peak)}


@dataclass(frozen=True, eq=False, repr=False)
class Stall(Effect):
    """Loss of lift by flow that separates from the trailing edge: c a (1 - ((1 + sqrt(X)) / 2)^2) with the angle of
    attack a and the attached part X of the chord, tau X' = (1 - tanh((a - a_s) / w)) / 2 - X (Kirchhoff's theory;
    Jategaonkar 2015, section 12.3; Fischenberg 1995).

    At a_s half of the chord is separated in steady flow; w is the half width of the transition, 1 / a_1 there.
    """

    stage: int = 5

    @property
    def several_starts(self) -> bool:
        return True

    def __post_init__(self) -> None:
        super().__post_init__()
        _, width, tau = self.shape_names
        span, lags = self.scales.span(*self.variables), np.asarray(lag_grid(self.scales))
        late = lags[np.minimum(_LATE, lags.size - 1)].tolist()
        shapes = [{**s, width: w * span, tau: x} for s in self.shapes for w in _WIDTHS for x in late]
        object.__setattr__(self, "shapes", tuple(shapes))

    def grid(self) -> Iterable[float]:
        low, high = self._range
        return low + (high - low) * np.array(_BREAKS)

    @property
    def _range(self) -> tuple[float, float]:
        (name,) = self.variables
        low = self.scales.low.get(name, 0.0)
        return low, low + self.scales.span(name)

    @property
    def _state(self) -> str:
        return f"{self.place.name}_attached"

    def _attached(self, points: Points, shape: Mapping[str, float]) -> tuple[_Array, _Array]:
        """Return the angle of attack and the attached part of the chord (n,) along a path."""
        at, width, tau = (shape[n] for n in self.shape_names)
        a = of(points.values, self.variables[0], points, "state or input")
        return a, lagged(points.t, 0.5 * (1.0 - np.tanh((a - at) / width)), tau)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        a, x = self._attached(points, shape)
        return np.asarray(a * (1.0 - 0.25 * (1.0 + np.sqrt(np.hypot(x, _ATTACHED))) ** 2))[np.newaxis]

    def paths(self, points: Points, start: Mapping[str, float]) -> Mapping[str, _Array]:
        if not all(n in start for n in self.shape_names):
            return {}
        return {self._state: self._attached(points, start)[1]}

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        (name,), (low, high) = self.variables, self._range
        span, unit, a = high - low, model.variable_units.get(name, ""), Expr.symbol(name)
        middle = self.shapes[len(self.shapes) // 2]
        at_name, width_name, tau_name = self.shape_names
        c = extension.parameter(self.coefficients[0])
        at = extension.parameter(at_name, middle[at_name], bounds=(low, high + span), unit=unit)
        widths = (0.005 * span, 2.0 * span)
        w = extension.parameter(width_name, middle[width_name], bounds=widths, unit=unit, transform="log")
        options = {**lag_bounds(self.scales, model.time_unit), "transform": "log"}
        tau = extension.parameter(tau_name, middle[tau_name], **options)
        steady = Expr(0.5 * (1 - tanh((a - at) / w)))
        x = extension.state(self._state, "", lambda x: (steady - x) / tau, steady)
        extension.add(self.place, c * a * (1 - 0.25 * (1 + sqrt(smooth_abs(x, _ATTACHED))) ** 2))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        largest = largest_coefficient(self, self.shapes[len(self.shapes) // 2], points)
        (low, high), (at, width, tau) = self._range, self.shape_names
        span = high - low
        return {
            self.coefficients[0]: (-largest, largest),
            at: (low, high + 0.5 * span),
            width: (0.01 * span, span),
            tau: (0.0, longest_lag(points)),
        }


# Times of the largest force on a mode that its amplitude may be when a record begins.
_BEGUN = 3.0


@dataclass(frozen=True, eq=False, repr=False)
class FlexibleMode(Effect):
    """A lightly damped mode that what stands at the place excites, and that acts there: it becomes it + c z with
    z'' = w^2 (it - z) - 2 zeta w z', and at rest at first, with z as large as it is, or in motion."""

    stage: int = 5
    steady: bool = True

    @property
    def unsteady(self) -> Candidate | None:
        return replace(self, steady=False) if self.steady else None

    def begins_within(self, states: Mapping[str, _Array], points: Points, shape: Mapping[str, float]) -> bool:
        """Return whether it begins with no more than a few times the motion that it is excited to."""
        largest = _BEGUN * float(np.abs(self._it(points)).max())
        z, rate = (states[name][0] for name in self._states)
        return bool(np.hypot(z, rate / shape[self.shape_names[0]]) < largest)

    @property
    def several_starts(self) -> bool:
        return True

    def grid(self) -> Iterable[float]:
        return mode_grid(self.scales)

    @property
    def _states(self) -> tuple[str, str]:
        return f"{self.place.name}_resonance", f"{self.place.name}_resonance_rate"

    def _it(self, points: Points) -> _Array:
        group = points.values if self.place.kind == "quantity" else points.rates
        return of(group, self.place.name, points, self.place.kind)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return self._moved(points, shape[self.shape_names[0]])[:1]

    def _moved(self, points: Points, frequency: float) -> _Array:
        """Return (2, n) z and its rate."""
        it = self._it(points)
        z, rate = second_order(points.t, it - it[0], frequency, _DAMPING)
        return np.stack([it[0] + z, rate])

    def paths(self, points: Points, start: Mapping[str, float]) -> Mapping[str, _Array]:
        name, _ = self.shape_names
        if name not in start:
            return {}
        return dict(zip(self._states, self._moved(points, start[name]), strict=True))

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        frequency, damping = self.shape_names
        low, high = self.shapes[0][frequency], self.shapes[-1][frequency]
        c = extension.parameter(self.coefficients[0])
        bounds, unit = (0.5 * low, 2.0 * high), model.time_unit.rate("rad")
        w = extension.parameter(frequency, low, bounds=bounds, unit=unit, transform="log")
        zeta = extension.parameter(damping, _DAMPING, bounds=_DAMPINGS, transform="log")
        it = extension.at(self.place)

        def right(z: Expr, rate: Expr) -> tuple[Any, Any]:
            return rate, w**2 * (it - z) - 2 * zeta * w * rate

        z, _ = extension.states(self._states, right, (it, 0.0) if self.steady else (None, None))
        extension.add(self.place, c * z)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        frequency, damping = self.shape_names
        low, high = self.shapes[0][frequency], self.shapes[-1][frequency]
        return {self.coefficients[0]: (-2.0, 2.0), frequency: (low, high), damping: (0.001, 0.3)}
