"""Terms times a coefficient in a quantity, a state equation or an output: expressions, lagged and periodic ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr, lagged
from ...errors import joined
from ...functions import Table, cos, exp, sin, smooth_abs, smooth_sign, sqrt
from ...modelling.model import Model
from ...sensitivities import Place, Points
from .candidate import Candidate, Effect, ExtensionBuilder, largest_coefficient, place_range
from .scales import Scales, evaluated, frequency_grid, lag_bounds, lag_grid, longest_lag, of

__all__ = [
    "FORMS",
    "Decaying",
    "LaggedVariable",
    "Periodic",
    "Rate",
    "Ripple",
    "Term",
    "tabulated",
    "where",
]

_Array = NDArray[np.float64]

# Kinks and jumps are rounded over these parts of a variable's range. With the latter, friction that truly jumps comes
# out 0.5 to 1 % too large, with 0.02 in its place 4 %; with 0.002 Newton's method takes three times the steps where a
# servo sticks for a third of the time.
_KINK, _JUMP = 0.003, 0.005
# Periods over the range of a position, at most, and of a turn; and the part of a turn from which on there may be some.
_RIPPLES, _OF_TURN, _TURNS = 30, 48, 0.24
# Range of an angle from which on its sine is not just a straight line and a cube, rad.
_OF_SINES = 1.0
# Nodes beyond those of a table, after which it is the straight line that it is to go on with.
_BEYOND = 4


@dataclass(frozen=True)
class Form:
    """How a term is made of its factors.

    make    expression from (centred) factors and their ranges.
    what    how the canonical name is put together; ``{0}``, ``{1}`` stand for the factors.
    suffix  the same in the name of the coefficient.
    words   the same in the explanation.
    centred whether factors are taken from their trims.
    of_rate what it is called where the factor is a speed.
    """

    make: Callable[..., Expr]
    what: str
    suffix: str
    words: str
    centred: bool = True
    of_rate: str = ""


FORMS: Mapping[str, Form] = {
    "bias": Form(lambda: Expr(1.0), "bias", "bias", "has a constant part"),
    "linear": Form(lambda x, _: x, "{0}", "{0}", "contains a term proportional to {0}", centred=False),
    "square": Form(lambda x, _: x**2, "{0}^2", "{0}2", "contains a term proportional to the square of {0}"),
    "cube": Form(lambda x, _: x**3, "{0}^3", "{0}3", "contains a term proportional to the cube of {0}"),
    "product": Form(
        lambda x, _, y, __: x * y, "{0}*{1}", "{0}_{1}", "contains a term proportional to the product of {0} and {1}"
    ),
    "damping": Form(
        lambda x, _, v, __: x**2 * v,
        "{0}^2*{1}",
        "{0}2_{1}",
        "contains a damping by {1} proportional to the square of {0}",
    ),
    # The same where the rate is declared before: factors of a name stand in that order.
    "damping, rate first": Form(
        lambda v, _, x, __: v * x**2,
        "{0}*{1}^2",
        "{0}_{1}2",
        "contains a damping by {0} proportional to the square of {1}",
    ),
    "effectiveness": Form(
        lambda x, _, u, __: x**2 * u,
        "{0}^2*{1}",
        "{0}2_{1}",
        "contains an effect of {1} that changes with the square of {0}",
    ),
    # Distances and angles from where forces of rotation vanish, not from a trim.
    "rotation": Form(
        lambda x, _, w, __: x * w**2,
        "{0}*{1}^2",
        "{0}_{1}2",
        "contains a term proportional to {0} times the square of {1} (centrifugal force)",
        centred=False,
    ),
    "rotation, angle": Form(
        lambda x, _, w, __: sin(x) * w**2,
        "sin({0})*{1}^2",
        "sin_{0}_{1}2",
        "contains a term proportional to sin({0}) times the square of {1} (centrifugal force)",
        centred=False,
    ),
    "rotation, two rates": Form(
        lambda x, _, v, __, w, ___: x * v * w,
        "{0}*{1}*{2}",
        "{0}_{1}_{2}",
        "contains a term proportional to {0}, {1} and {2} (Coriolis force)",
        centred=False,
    ),
    "rotation, angle, two rates": Form(
        lambda x, _, v, __, w, ___: sin(x) * v * w,
        "sin({0})*{1}*{2}",
        "sin_{0}_{1}_{2}",
        "contains a term proportional to sin({0}), {1} and {2} (Coriolis force)",
        centred=False,
    ),
    # From where the angle is zero: weight, a magnet or a spring at a lever, the gradient of gravity.
    "sine": Form(lambda x, _: sin(x), "sin({0})", "sin_{0}", "contains a term proportional to sin({0})", centred=False),
    "sine, cosine": Form(
        lambda x, _: cos(x), "cos({0})", "cos_{0}", "contains a term proportional to cos({0})", centred=False
    ),
    "sine, twice": Form(
        lambda x, _: sin(2.0 * x),
        "sin(2*{0})",
        "sin_2_{0}",
        "contains a term proportional to sin(2 {0}) (two equal positions a turn)",
        centred=False,
    ),
    # Its slope has no jump, so nothing needs rounding.
    "quadratic": Form(
        lambda x, _: x * abs(x),
        "{0}|{0}|",
        "{0}_abs_{0}",
        "contains a term proportional to {0} times its magnitude",
        of_rate="quadratic damping",
    ),
    "absolute": Form(
        lambda x, span: smooth_abs(x, _KINK * span),
        "|{0}|",
        "abs_{0}",
        "contains a term proportional to the magnitude of {0}",
    ),
    # Flow through an orifice, by the head or pressure itself, not about a trim. Its slope is bounded at zero.
    "root": Form(
        lambda x, span: x / sqrt(smooth_abs(x, _KINK * span)),
        "sqrt({0})",
        "sqrt_{0}",
        "contains a term proportional to the square root of {0} (as a flow through an orifice)",
        centred=False,
    ),
    # Friction turns with the motion itself, not about a trim.
    "sign": Form(
        lambda x, span: smooth_sign(x, _JUMP * span),
        "sign({0})",
        "sign_{0}",
        "jumps with the sign of {0}",
        centred=False,
        of_rate="Coulomb friction",
    ),
    "drift": Form(lambda t: t, "drift", "drift", "drifts in proportion to time", centred=False),
}


def where(place: Place) -> str:
    """Return a place in words."""
    if place.kind == "output":
        return f"the measurement of {place.name}"
    return f"{place.name}'" if place.kind == "equation" else place.name


@dataclass(frozen=True, eq=False, repr=False)
class Term(Effect):
    """A coefficient times an expression: one of `FORMS` of its ``variables``, called as ``shown``, or ``given``.

    ``moving``: its variable is a speed.
    """

    form: str = ""
    shown: tuple[str, ...] = ()
    given: Expr | None = None
    unit: str = ""
    moving: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.form:  # in words with the centres of this record
            centres = [self._centre(name) for name in self.variables]
            names = [
                f"({n} {-c:+g})".replace("+", "+ ").replace("-", "- ") if c else n
                for n, c in zip(self.shown, centres, strict=True)
            ]
            form = FORMS[self.form]
            remark = f" ({form.of_rate})" if self.moving and form.of_rate else ""
            words = f"{where(self.place)} {form.words.format(*names)}{remark}"
            object.__setattr__(self, "explanation", words)

    @property
    def centred(self) -> bool:
        # Lever arms at sensors multiply rates as they are: outputs are not centred.
        return bool(self.form) and FORMS[self.form].centred and self.place.kind != "output"

    @property
    def _is_about_zero(self) -> bool:
        """Return whether it is the square of what is positive, such as a rate of reaction and a drag have: about a trim
        a constant would be needed beside it."""
        if self.form != "square" or not self.centred:
            return False
        (x,) = self.variables
        set_already = x in self.scales.given or x in self.scales.moved
        return not set_already and self.scales.is_positive(x) and self.scales.reaches_zero(x)

    def _centre(self, name: str) -> float:
        return self.scales.centre(name) if self.centred and not self._is_about_zero else 0.0

    def variants(self, points: Sequence[Points]) -> Sequence[Candidate]:
        return () if self._is_about_zero else super().variants(points)

    @property
    def expression(self) -> Expr:
        """What the coefficient multiplies."""
        if self.given is not None:
            return self.given
        form = FORMS[self.form]
        if self.form == "drift":  # zero at the first sample
            return Expr(form.make(_less(Expr.symbol("time"), self.scales.begin)))
        factors: list[object] = []
        for name in self.variables:
            factors += [_less(Expr.symbol(name), self._centre(name)), self.scales.span(name)]
        return Expr(form.make(*factors))

    def worthwhile(self) -> bool:
        if self.form == "root":
            (x,) = self.variables
            return super().worthwhile() and self.scales.is_positive(x) and self.scales.reaches_zero(x)
        if self.family == "sine":
            return super().worthwhile() and self.scales.span(*self.variables) >= _OF_SINES
        return super().worthwhile() and (self.form != "sign" or self.scales.nearly_crosses(self.variables[0]))

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return evaluated(self.expression, points)[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        c = extension.parameter(self.coefficients[0], unit=self.unit)
        e = self.expression
        term = c if e.constant == 1.0 else c * e
        extension.add(self.place, term)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        largest = largest_coefficient(self, {}, points)
        if self.family in ("bias", "drift"):  # an offset beyond the whole range would have been seen by eye
            largest /= 2.0
        return {self.coefficients[0]: (-largest, largest)}


def tabulated(place: Place, variables: Sequence[str], axes: Sequence[_Array], values: _Array, scales: Scales) -> Term:
    """Return a function of one or two variables by its values at equally spaced nodes, of as many dimensions as there
    are ``axes``, joined by a cubic spline.

    Beyond them it goes on with its mean slopes, which is what it makes up for in linear terms of the model.
    """
    name = f"{where(place)}:f({', '.join(variables)})"
    label = "".join(c if c.isalnum() else "_" for c in f"{place.name}_f_{'_'.join(variables)}")
    mesh = np.meshgrid(*axes, indexing="ij")
    plane = np.column_stack([np.ones(values.size), *(each.ravel() for each in mesh)])
    slopes = np.linalg.lstsq(plane, values.ravel(), rcond=None)[0][1:]
    wider, going_on = [], values
    for k, (nodes, slope) in enumerate(zip(axes, slopes.tolist(), strict=True)):
        beyond = float(nodes[1] - nodes[0]) * np.arange(1, _BEYOND + 1)
        axis = np.r_[nodes[0] - beyond[::-1], nodes, nodes[-1] + beyond]
        more = slope * (axis - np.clip(axis, nodes[0], nodes[-1]))
        going_on = np.pad(going_on, [(_BEYOND, _BEYOND) if i == k else (0, 0) for i in range(len(axes))], mode="edge")
        going_on = going_on + more.reshape([-1 if i == k else 1 for i in range(len(axes))])
        wider.append(axis)
    table = Table(label, wider if len(wider) > 1 else wider[0], going_on)
    curve = table(*(Expr.symbol(name) for name in variables))
    words = f"{where(place)} has a part that is a smooth function of {joined([*variables])}"
    return Term(name, place, words, "function", scales, (label,), variables=tuple(variables), given=Expr(curve))


def _less(x: Expr, centre: float) -> Expr:
    return x - centre if centre else x


@dataclass(frozen=True, eq=False, repr=False)
class Rate(Effect):
    """The derivative of a state in an output, by the right-hand side of its equation: a sensor off the centre of
    gravity sees the angular acceleration."""

    stage: int = 5  # after all that changes the equation

    @staticmethod
    def of(place: Place, shown: str, state: str, coefficient: str, scales: Scales) -> Rate:
        """Return the candidate for the output of that place, what to call it, and a state."""
        name, words = f"{shown}:{state}'", f"contains a term proportional to the derivative of {state} (a lever arm)"
        return Rate(name, place, f"{where(place)} {words}", "rate", scales, (coefficient,), variables=(state,))

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        return of(points.rates, self.variables[0], points, "rate of")[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        rate = extension.at(Place("equation", self.variables[0]))
        c = extension.parameter(self.coefficients[0])
        extension.add(self.place, c * rate)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        largest = largest_coefficient(self, {}, points)
        return {self.coefficients[0]: (-largest, largest)}


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
        extension = ExtensionBuilder(model, self, start)
        (tau_name,) = self.shape_names
        (variable,) = self.variables
        c = extension.parameter(self.coefficients[0])
        # An ever smaller time constant with an ever larger coefficient comes to a derivative, and steps in the constant
        # itself run away there; steps in its logarithm come back from twice as many starts.
        options = {**lag_bounds(self.scales, model.time_unit), "transform": "log"}
        tau = extension.parameter(tau_name, self.shapes[len(self.shapes) // 2][tau_name], **options)
        u = Expr.symbol(variable)
        lag = extension.state(f"{variable}_lag", model.variable_units.get(variable, ""), lambda z: (u - z) / tau, u)
        extension.add(self.place, c * lag)
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        # As a term whose signal is the variable itself: a lag only makes it smaller.
        shape = {self.shape_names[0]: 0.02 * self.scales.interval}
        largest = largest_coefficient(self, shape, points)
        return {self.coefficients[0]: (-largest, largest), self.shape_names[0]: (0.0, longest_lag(points))}


# Distances over which a force decays, in parts of the range of the position: least, greatest, and number in a scan.
_DECAY, _DECAYS = (0.03, 1.0), 6


@dataclass(frozen=True, eq=False, repr=False)
class Decaying(Effect):
    """c exp(-x / s) with a position x and a distance s: what acts near the ground, a wall or a magnet. With a second of
    the ``variables``, y, c y exp(-x / s): a thrust that is larger near the ground (Cheeseman and Bennett 1955)."""

    def worthwhile(self) -> bool:
        return super().worthwhile() and self.scales.is_a_distance(self.variables[0])

    @property
    def _origin(self) -> float:
        name = self.variables[0]
        return 0.0 if self.scales.reaches_zero(name) else float(f"{self.scales.low[name]:.3g}")

    def grid(self) -> Iterable[float]:
        low, high = _DECAY
        return np.asarray(self.scales.span(self.variables[0]) * np.geomspace(low, high, _DECAYS))

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        x, *factors = (of(points.values, name, points, "state or input") for name in self.variables)
        decay = np.exp(-(x - self._origin) / shape[self.shape_names[0]])
        return np.asarray(np.prod([decay, *factors], axis=0))[np.newaxis]

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        (variable, *factors), (name,) = self.variables, self.shape_names
        c = extension.parameter(self.coefficients[0])
        for factor in factors:
            c = c * Expr.symbol(factor)
        span, first = self.scales.span(variable), self.shapes[len(self.shapes) // 2][name]
        options = {
            "bounds": tuple(f * span for f in _DECAY),
            "transform": "log",
            "unit": model.variable_units.get(variable, ""),
        }
        s = extension.parameter(name, first, **options)
        extension.add(self.place, c * exp(-(Expr.symbol(variable) - self._origin) / s))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        (name,) = self.shape_names
        middle = self.shapes[len(self.shapes) // 2]
        largest = largest_coefficient(self, middle, points)
        shapes = [shape[name] for shape in self.shapes]
        return {self.coefficients[0]: (-largest, largest), name: (min(shapes), max(shapes))}


@dataclass(frozen=True, eq=False, repr=False)
class Periodic(Effect):
    """a sin(w (t - tm)) + b cos(w (t - tm)), with tm the middle of the record: there phase and frequency are estimated
    almost independently of each other."""

    transferable = False

    @property
    def has_phase(self) -> bool:
        return True

    def grid(self) -> Iterable[float]:
        return frequency_grid(self.scales)

    def _middle(self) -> float:
        return self.scales.begin + 0.5 * self.scales.duration

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        angle = shape[self.shape_names[0]] * (points.t - self._middle())
        return np.stack([np.sin(angle), np.cos(angle)])

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        a, b = (extension.parameter(name) for name in self.coefficients)
        (name,) = self.shape_names
        # Half a cycle a record is still a trend; near half the sampling rate slow disturbances look fast.
        bounds = (0.5 * np.pi / self.scales.duration, 0.7 * np.pi / self.scales.interval)
        w = extension.parameter(name, self.shapes[0][name], bounds=bounds, unit=model.time_unit.rate("rad"))
        angle = w * (Expr.symbol("time") - self._middle())
        extension.add(self.place, a * sin(angle) + b * cos(angle))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        # Amplitudes as those of a term: its peak to peak is twice the amplitude. With less than three cycles in a
        # record it is a trend, not an oscillation; faster than a quarter of the sampling rate no time history shows it.
        largest, scales = place_range(self.place, points), Scales.of(points)
        lowest, highest = 6.0 * np.pi / scales.duration, 0.5 * np.pi / scales.interval
        a, b = self.coefficients
        return {a: (-largest, largest), b: (-largest, largest), self.shape_names[0]: (lowest, highest)}


@dataclass(frozen=True, eq=False, repr=False)
class Ripple(Effect):
    """a sin(k (x - x0)) + b cos(k (x - x0)) of a position x: cogging and torque ripple of motors, teeth of gears, the
    pitch of a screw. About the middle x0 of its range phase and wave number are almost independent of each other.

    turn   a turn in the unit of the position, 0 where it is no angle. A motion over a small part of a turn does not
           show the effect, one over many turns determines it.
    """

    turn: float = 0.0

    @property
    def has_phase(self) -> bool:
        return True

    @property
    def begins_measured(self) -> bool:
        # Along a path that is a period off the measured one it is out of phase.
        return True

    def grid(self) -> Iterable[float]:
        span = self.scales.span(self.variables[0])
        # Two to a line width, so that no line falls between.
        periods = np.arange(2.0, 2.0 * _RIPPLES + 1.0) / 2.0
        if self.turn and span > self.turn:
            of_turn = np.arange(1.0, _OF_TURN + 1.0) * span / self.turn
            periods = np.concatenate([periods, of_turn[of_turn > _RIPPLES]])
        return np.asarray(2.0 * np.pi * periods / span)

    def _angle(self, wave_number: Any, x: Any) -> Any:
        return wave_number * (x - self.scales.centre(self.variables[0]))

    def worthwhile(self) -> bool:
        (x,) = self.variables
        return super().worthwhile() and (not self.turn or self.scales.span(x) > _TURNS * self.turn)

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        x = of(points.values, self.variables[0], points, "state")
        angle = self._angle(shape[self.shape_names[0]], x)
        return np.stack([np.sin(angle), np.cos(angle)])

    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        extension = ExtensionBuilder(model, self, start)
        a, b = (extension.parameter(name) for name in self.coefficients)
        (name,) = self.shape_names
        values = [shape[name] for shape in self.shapes]
        k = extension.parameter(name, values[0], bounds=(0.5 * min(values), 1.2 * max(values)))
        angle = Expr(self._angle(k, Expr.symbol(self.variables[0])))
        extension.add(self.place, a * sin(angle) + b * cos(angle))
        return extension.model()

    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        largest = place_range(self.place, points)
        a, b = self.coefficients
        waves = [shape[self.shape_names[0]] for shape in self.shapes]
        return {a: (-largest, largest), b: (-largest, largest), self.shape_names[0]: (min(waves), max(waves))}
