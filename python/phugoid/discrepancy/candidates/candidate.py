"""A candidate for what a model may be missing: the base class."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...errors import ModelError, did_you_mean
from ...modelling.declared import Key
from ...modelling.model import Model
from ...parameters import Parameter
from ...sensitivities import Place, Points, shown_by_outputs
from .scales import Scales, of

__all__ = [
    "Candidate",
    "Effect",
    "ExtensionBuilder",
    "added_by_centre",
    "has_unknown_centre",
    "is_function",
    "largest_coefficient",
    "place_range",
    "taken_names",
    "unused",
    "with_variants",
]

_Array = NDArray[np.float64]


class Candidate(ABC):
    """An effect at one place, with unknown coefficients.

    To first order the effect adds ``sum_k c_k signal_k(t)`` to its place; ``signals`` gives these signals along a
    fitted path for one *shape*, that is for given values of the unknowns that enter nonlinearly (a time constant, a
    frequency, a dead-band's width). ``extended`` adds the effect to a model exactly.

    name         canonical, ``where:what``: ``Cm:alpha*q``.
    place        what the signals are added to.
    explanation  one plain sentence for an engineer.
    coefficients names of the parameters that `extended` adds and that multiply the signals; where ``unit_amplitude``
                 holds there are none, for the signal at a shape is the whole effect (a delayed minus the plain input).
    shape_names  names of the other parameters that `extended` adds.
    shapes       values of those to try in a scan, a mapping each (one empty mapping where there are none).
    transferable whether its parameters are those of the vehicle, so the same in another record: the phase of a
                 disturbance is not.
    beside       name of the candidate that must be there already, for this one refines it; "" for none.
    stage        terms (0) are added before inputs are transformed: dead-band (1), saturation (2), lag (3), delay (4).
    """

    name: str
    place: Place
    explanation: str
    coefficients: tuple[str, ...]
    shape_names: tuple[str, ...] = ()
    shapes: Sequence[Mapping[str, float]] = ({},)
    unit_amplitude: bool = False
    transferable: bool = True
    beside: str = ""
    stage: int = 0

    @property
    def several_starts(self) -> bool:
        """Whether a fit of its one shape may end at one of several optima."""
        return False

    @property
    def is_profiled(self) -> bool:
        """Return whether fits with its one shape held at several values are to say where to begin: the likelihood along
        it has several maxima, over which steps of an estimation go."""
        return False

    @property
    def jumps(self) -> bool:
        """Return whether it jumps along the motion, for which a fit takes many iterations."""
        return False

    @property
    def has_phase(self) -> bool:
        """Return whether its two coefficients are those of a sine and a cosine, which depend on the phase reference."""
        return False

    @property
    def otherwise(self) -> Candidate | None:
        """Return the same by another law, alike to first order; None where there is none."""
        return None

    @property
    def unsteady(self) -> Candidate | None:
        """Return the same with states of its own that begin anywhere, where they begin as in a steady motion; None
        where they do not."""
        return None

    def begins_within(self, states: Mapping[str, _Array], points: Points, shape: Mapping[str, float]) -> bool:
        """Return whether its own states (n,) along a record begin within what is physical."""
        return True

    @property
    def begins_measured(self) -> bool:
        """Return whether a fit may begin at the measured motion: the one without the candidate goes where it cannot."""
        return False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all parameters that `extended` adds."""
        return (*self.coefficients, *self.shape_names)

    @abstractmethod
    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        """Return (k, n) signals at the points; k is the number of coefficients, or 1 with unit amplitude."""

    def paths(self, points: Points, start: Mapping[str, float]) -> Mapping[str, _Array]:
        """Return (n,) at the points of each state that `extended` adds, for parameters that start there; nothing where
        a fit finds them from any start."""
        return {}

    def reachable(self, states: Mapping[str, _Array], start: Mapping[str, float]) -> Mapping[str, _Array]:
        """Return those of a fitted path's states (n,) that the effect does not let be, as it lets them be."""
        return {}

    @abstractmethod
    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        """Return the model with this effect; its parameters start at the values given by name (coefficients else at
        0)."""

    def suggested(self, measured: Mapping[str, Sequence[_Array]]) -> Mapping[str, float] | None:
        """Values of the shape that measurements themselves suggest, whatever the model: output -> samples of each
        experiment. None where they suggest nothing."""
        return None

    def has_reason(self, values: Mapping[str, float]) -> bool:
        """Return whether values of its parameters that are outside of what is physical have a reason, such as a wrong
        sign."""
        return False

    def variants(self, points: Sequence[Points]) -> Sequence[Candidate]:
        """Return the same effect, by the same name, about other centres or with other sides, of which a record does not
        say which is right: the scan does."""
        return ()

    @property
    def lesser(self) -> Candidate | None:
        """The variant that says less, such as a limit on one side alone; None where there is none."""
        return None

    @abstractmethod
    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        """Range of each of its parameters, in its unit, outside of which it is not a physical explanation."""


_Self = TypeVar("_Self", bound="Effect")

# Centres of powers differ when they are further apart than this part of a variable's range.
_NEAR = 0.05
# Families that are functions of the present value of one variable, other than constants and linear ones.
_SHAPED = ("square", "cube", "quadratic", "absolute", "root", "sign", "deadband", "saturation")
# What a function about a trim has in addition about another one; a linear term, which models mostly have, aside.
_ADDED = {"square": "bias", "cube": "square", "quadratic": "absolute", "absolute": "sign"}
# Families with a kink, or a jump of the curvature, at the centre.
_KINKED = ("quadratic", "absolute")
# A centre is zero within this part of a variable's range.
_ZERO = 0.02


@dataclass(frozen=True, eq=False, repr=False)
class Effect(Candidate):
    """A candidate that knows the scales of the record.

    family     "square", "delay", ...: what kind of effect it is.
    variables  symbols of which each must vary, or there is nothing to find.
    """

    name: str
    place: Place
    explanation: str
    family: str
    scales: Scales
    coefficients: tuple[str, ...] = ()
    shape_names: tuple[str, ...] = ()
    variables: tuple[str, ...] = ()
    beside: str = ""
    shapes: Sequence[Mapping[str, float]] = field(init=False, default=({},))
    unit_amplitude: bool = field(init=False, default=False)

    @property
    def centred(self) -> bool:
        """Whether it acts about the trims of its variables."""
        return False

    def __post_init__(self) -> None:
        if self.shape_names:
            object.__setattr__(self, "shapes", tuple({self.shape_names[0]: float(x)} for x in self.grid()))
        object.__setattr__(self, "unit_amplitude", not self.coefficients)

    def grid(self) -> Iterable[float]:
        """Values of the shape to try."""
        return ()

    def on(self: _Self, scales: Scales) -> _Self:
        """Return the same effect, with centres, widths and grids for a record."""
        return replace(self, scales=scales)

    def worthwhile(self) -> bool:
        """Return whether the record can say anything of it at all."""
        if not all(self.scales.varies(name) for name in self.variables):
            return False
        return (
            len(self.variables) != 1
            or self.family not in _SHAPED
            or self.scales.distinguishes(*self.variables, self.family)
        )

    def variants(self, points: Sequence[Points]) -> Sequence[Candidate]:
        """Return, of one that is centred at a trim, those about zero, where that is no further from the record's values
        than these vary, and about the first values."""
        found: list[Candidate] = []
        if not self.centred:
            return found
        scales, names = self.scales, self.variables
        tried = [[scales.centre(n) for n in names]]
        zero = [0.0 if scales.reaches_zero(n) else scales.centre(n) for n in names]
        first = [float(np.mean([of(p.values, n, p, "state, input or quantity")[0] for p in points])) for n in names]
        for centres in (zero, first):
            if centres is first and self.family in _KINKED and not all(map(scales.is_inside, names, first)):
                continue  # as it is without the kink
            far = [
                any(abs(a - b) > _NEAR * scales.span(n) for a, b, n in zip(centres, t, names, strict=True))
                for t in tried
            ]
            if all(far):
                tried.append(centres)
                found.append(self._about(dict(zip(names, centres, strict=True))))
        return found

    def moved(self: _Self, by: float) -> _Self:
        """Return the same effect about another centre of its variable, rounded so that equations can be read."""
        (name,) = self.variables
        span, centre = self.scales.span(name), self.scales.centre(name) + by
        centre = 0.0 if abs(centre) < _ZERO * span else round(centre, 3 - math.floor(math.log10(span)))
        return self._about({name: centre})

    @property
    def is_apt(self) -> bool:
        """Return whether the variable has values about the centre: on one side of a kink the effect is another one."""
        if self.family not in _KINKED:
            return all(self.scales.is_near(name, self.scales.centre(name)) for name in self.variables)
        return all(self.scales.is_inside(name, self.scales.centre(name)) for name in self.variables)

    def _about(self: _Self, centres: Mapping[str, float]) -> _Self:
        scales = self.scales
        return self.on(replace(scales, trim={**scales.trim, **centres}, moved=scales.moved | centres.keys()))

    def __repr__(self) -> str:
        return f"<{self.name}: {self.explanation}>"


def has_unknown_centre(candidate: Candidate) -> bool:
    """Return whether a candidate is a function of one variable about a trim that is not given."""
    return isinstance(candidate, Effect) and candidate.family in _ADDED and _is_centred_anywhere(candidate)


def is_limit(candidate: Candidate) -> bool:
    """Return whether a candidate is a limit of an input on either side of a centre that is not given."""
    return isinstance(candidate, Effect) and candidate.place.kind == "input" and _is_centred_anywhere(candidate)


def _is_centred_anywhere(effect: Effect) -> bool:
    """Return whether an effect of one variable has a centre that is not given."""
    return effect.centred and len(effect.variables) == 1 and effect.variables[0] not in effect.scales.given


def added_by_centre(function: Candidate, other: Candidate) -> bool:
    """Return whether a term is what a function of a variable has in addition about another centre."""
    if not has_unknown_centre(function) or not isinstance(function, Effect) or not isinstance(other, Effect):
        return False
    if other.family != _ADDED[function.family]:
        return False
    # A constant elsewhere may do the same: the bias of a sensor behind a linear equation.
    return other.family == "bias" or (other.place == function.place and other.variables == function.variables)


def is_function(candidate: Candidate, variable: str = "") -> bool:
    """Return whether a candidate is a function of the present value of one variable (that which is named, or any), and
    neither constant nor linear."""
    if not isinstance(candidate, Effect) or len(candidate.variables) != 1 or candidate.family not in _SHAPED:
        return False
    return not variable or candidate.variables == (variable,)


class ExtensionBuilder:
    """A model under extension: what is declared and changed is put together by `model`."""

    def __init__(self, model: Model, effect: Candidate, start: Mapping[str, float] | None) -> None:
        if not isinstance(model, Model):
            raise ModelError(f"{effect.name}: extends a Model, not a {type(model).__name__}")
        self.old, self.effect, self.start = model, effect, dict(start or {})
        self.equations: dict[Key, Expr] = model._right_hand_sides()
        self.delays = model.delays
        self._taken = taken_names(model)
        own = effect.parameters
        for name in self.start:
            if name not in own:
                raise ModelError(f"{effect.name}: start names '{name}', but its parameters are {', '.join(own)}")
        for name in own:
            if name in self._taken:
                raise ModelError(
                    f"{effect.name}: '{name}' is in the model already; was the model extended by this candidate before?"
                )
        self._parameters: dict[str, Parameter] = {}
        self._states: dict[str, tuple[str, Expr, Expr | None]] = {}
        self._inputs: dict[str, str] = {}

    def parameter(self, name: str, start: float = 0.0, **declared: Any) -> Expr:
        """Return one more parameter; a start that was given counts, moved into the bounds."""
        low, high = declared.get("bounds", (-np.inf, np.inf))
        value = min(max(float(self.start.get(name, start)), low), high)
        self._parameters[name] = Parameter(value, **declared)
        return Expr.symbol(name)

    def state(self, wanted: str, unit: str, right: Callable[[Expr], Any], initial: Any) -> Expr:
        """Return one more state with its equation, right-hand side by its symbol, and its value at the first sample,
        None for any."""
        (symbol,) = self.states([wanted], lambda z: [right(z)], [initial], unit)
        return symbol

    def states(
        self, wanted: Sequence[str], right: Callable[..., Sequence[Any]], initial: Sequence[Any], unit: str = ""
    ) -> list[Expr]:
        """Return several more states that depend on each other: right-hand sides by their symbols, and their values at
        the first sample, None for any."""
        known: dict[str, Any] = {}  # at the ends of a record quantities have no name
        for quantity in self.old.quantity_names:
            known[quantity] = self.equations["quantity", quantity].substitute(known)
        names = [self._unused(name) for name in wanted]
        symbols = [Expr.symbol(name) for name in names]
        for name, e, first in zip(names, right(*symbols), initial, strict=True):
            begun = None if first is None else Expr(Expr(first).substitute(known))
            self._states[name] = (unit, Expr(e), begun)
        return symbols

    def late_input(self, of: str, tau: str) -> Expr:
        """Return the symbol of an input that is late by a parameter."""
        if of in self.delays.inputs:
            raise ModelError(f"{self.effect.name}: the input is delayed already, by '{self.delays.inputs[of][1]}'")
        name = self._unused(f"{of}_delayed")
        self._inputs[name] = self.old.variable_units.get(of, "")
        self.delays = self.delays.with_input(name, of, tau)
        return Expr.symbol(name)

    def late_output(self, output: str, tau: str) -> None:
        """Says that an output is late by a parameter."""
        if output in self.delays.outputs:
            raise ModelError(f"{self.effect.name}: the output is delayed already, by '{self.delays.outputs[output]}'")
        self.delays = self.delays.with_output(output, tau)

    def at(self, place: Place) -> Expr:
        """Return the expression at a place; ModelError where the model has no such place."""
        key = (place.kind, place.name)
        if key not in self.equations:
            known = [name for kind, name in self.equations if kind == place.kind]
            hint = did_you_mean(place.name, known)
            raise ModelError(f"{self.effect.name}: the model has no {place.kind} '{place.name}'.{hint}")
        return self.equations[key]

    def put(self, place: Place, e: Any) -> None:
        """Another expression at a place."""
        self.at(place)
        self.equations[place.kind, place.name] = Expr(e)

    def add(self, place: Place, e: Any) -> None:
        """Add an expression at a place; what an equation gets is in outputs that show its rate, too, if it is shown."""
        seen = place.kind == "equation" and place.shown
        shown = shown_by_outputs(self.equations, self.old.parameter_names) if seen else {}
        for output, multiple in shown.get(place.name, {}).items():
            key = ("output", output)
            self.equations[key] = self.equations[key] + (e if multiple == 1.0 else multiple * e)
        self.put(place, self.at(place) + e)

    def replace_input(self, name: str, by: Any) -> None:
        """Put an expression for an input wherever it stands."""
        if name not in self.old.declared_inputs:
            hint = did_you_mean(name, self.old.input_names)
            raise ModelError(f"{self.effect.name}: the model has no input '{name}'.{hint}")
        if not any(name in e.symbols for e in self.equations.values()):
            raise ModelError(
                f"{self.effect.name}: '{name}' is in no equation; extend inputs in order of stage, delays last"
            )
        self.equations = {key: Expr(e.substitute({name: by})) for key, e in self.equations.items()}

    def replace_parameter(self, name: str, by: Any) -> None:
        """Put an expression for a parameter wherever it stands."""
        if not any(name in e.symbols for e in self.equations.values()):
            raise ModelError(f"{self.effect.name}: '{name}' is in no equation")
        self.equations = {key: Expr(e.substitute({name: by})) for key, e in self.equations.items()}

    def model(self) -> Model:
        """Return the model as extended."""
        return self.old._changed(
            parameters=self._parameters,
            equations=self.equations,
            inputs=self._inputs,
            states=self._states,
            delays=self.delays,
        )

    def _unused(self, wanted: str) -> str:
        return unused(wanted, self._taken)


def taken_names(model: Model) -> set[str]:
    """Return the names that equations of a model use: a new state, parameter or quantity has none of them."""
    names = {*model.state_names, *model.declared_inputs, *model.parameter_names}
    return names | {*model.constant_names, *model.quantity_names}


def unused(wanted: str, taken: set[str]) -> str:
    """Return the name, or with a number that makes it none of those taken; it is taken then."""
    name, number = wanted, 1
    while name in taken:
        number += 1
        name = f"{wanted}_{number}"
    taken.add(name)
    return name


def place_range(place: Place, points: Sequence[Points]) -> float:
    """Peak to peak of what stands at a place, over all records; infinite where it does not vary."""
    groups = {"quantity": "values", "input": "values", "equation": "rates", "output": "outputs"}
    values = np.concatenate([getattr(p, groups[place.kind])[place.name] for p in points])
    span = float(np.ptp(values))
    return span if span > 0 else np.inf


def largest_coefficient(effect: Effect, shape: Mapping[str, float], points: Sequence[Points]) -> float:
    """Return the coefficient at which a term's varying part is twice as large as all that stands at its place varies:
    parts of that size could only be there by cancelling others."""
    signal = np.concatenate([effect.signals(p, shape) for p in points], axis=1)
    span = float(np.ptp(signal, axis=1).max())
    if span <= 1e-12 * float(np.abs(signal).max()):
        span = float(np.abs(signal).max())  # a constant
    return 2.0 * place_range(effect.place, points) / span if span > 0 else np.inf


def with_variants(candidates: Sequence[Candidate], points: Sequence[Points], model: Model) -> list[Candidate]:
    """Return candidates, each followed by its variants (`Candidate.variants`), and those in equations of which outputs
    show the rates once more as what these do not show."""
    shown = shown_by_outputs(model._right_hand_sides(), model.parameter_names)
    found = [v for c in candidates for v in (c, *c.variants(points))]
    inner = [c for c in found if isinstance(c, Effect) and c.place.kind == "equation" and c.place.name in shown]
    return [*found, *(replace(c, place=replace(c.place, shown=False)) for c in inner)]
