"""The library of candidates: what a model may be missing, made from the model itself."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, combinations_with_replacement, permutations
from typing import Any, Literal

from ..._core import Expr
from ...errors import ModelError, OptionError, did_you_mean
from ...modelling.model import Model
from ...sensitivities import Place, Points
from ..misfit.phrases import per_second
from .candidate import Effect, unused
from .channel_effects import (
    ClippedSensor,
    DeadBand,
    EquationScale,
    InputBias,
    InputDelay,
    InputLag,
    InputScale,
    Saturation,
    SensorCurve,
    SensorDelay,
    SensorLag,
    SensorScale,
)
from .collection import Candidates, Directions, read_terms
from .hysteresis import FlexibleMode, Hysteresis, Stribeck
from .limits import Backlash, EndStop, LimitedForce, RateLimit, StateLimit
from .model_structure import ANGLES, LENGTHS, TURN, ModelStructure, Variable
from .scales import Scales, output_key, trim_of
from .terms import FORMS, LaggedVariable, ParameterDrift, ParameterStep, Periodic, Rate, Ripple, Term, where

__all__ = ["FAMILIES", "Candidates", "candidates", "trim_of"]

# In the order in which duplicates count: the first stays.
FAMILIES = (
    "own",
    "bias",
    "scale",
    "drift",
    "linear",
    "square",
    "product",
    "cube",
    "damping",
    "rotation",
    "effectiveness",
    "quadratic",
    "absolute",
    "root",
    "sign",
    "rate",
    "curve",
    "factor",
    "lag",
    "delay",
    "deadband",
    "saturation",
    "backlash",
    "rate_limit",
    "clipped",
    "variation",
    "step",
    "stribeck",
    "limit",
    "hysteresis",
    "mode",
    "ripple",
    "periodic",
)
# Those with a signal that depends on no shape: only they can be seen to be the same at single points.
_STATIC = FAMILIES[: FAMILIES.index("lag")]
# Coordinates of a mechanism, at most, whose rotation may act on each other: the terms are the cube of that many.
_COORDINATES = 3
# What can be wrong with a condition, which is measured and not commanded: nothing that an actuator does.
_OF_CONDITIONS = ("scale", "bias", "delay")


def candidates(
    model: Model,
    *,
    points: Sequence[Points] | None = None,
    trim: Mapping[str, float] | None = None,
    terms: Mapping[str, Any] | None = None,
    leave_out: Collection[str] = (),
    equations: Literal["own", "all"] = "own",
    base: Model | None = None,
) -> Candidates:
    """Everything that the library can think of that the model may be missing, with canonical names.

    In quantities, and in state equations that hold parameters but no such quantity: constant and linear terms,
    squares, products and cubes of states and inputs, linear terms, squares and cubes of declared quantities that stand
    there and hold no parameters (an angle of slip), x^2 v for rates v, x^2 u for inputs u, centrifugal and Coriolis
    forces where two or three positions and their rates are states, x|x|, |x|, sign(x), square roots of what can be
    stored (a level, a pressure), first-order lags, friction that is larger at rest, hysteresis, a lightly damped mode,
    what is periodic in a position, a periodic disturbance, a limit of the whole where an input stands in it. States
    that go no further than a limit. In outputs: bias, scale, a characteristic that is not straight, drift, delay, lag,
    clipping, play of a position's sensor, linear terms, squares and products of rates, derivatives of rates, lags of
    inputs that act at once. On inputs: scale, bias, dead-band, saturation, backlash, limited rate, lag, delay; of
    conditions (`Model.conditions`) scale, bias and delay.
    Parameters of the state equations may change in the course of a record. What the model's parameters can do already
    is left out, and so is what another candidate says too: names of `FAMILIES` that stand first win.

    points     paths that the scales are taken from: centres of powers, widths of rounded corners, grids of time
               constants and frequencies. Without, those of `Scales`; ``library.on(points)`` does it later.
    trim       name -> value at which powers of a state or an input are centred.
    terms      terms of your own by place, ``{"Cm": [alpha*q**2], "q'": ..., "y:alpha": ..., "Cm:my name": ...}``.
    leave_out  families to leave out, such as "periodic" or "cube".
    equations  "all" offers terms in every state equation, also where they would only rename a quantity's.
    base       an earlier form of the model: what its extensions added is not doubted in turn.

    Raises ModelError for terms that cannot be, that the model has already or that are there twice; OptionError for
    unknown families and trims.

    >>> from phugoid import Model
    >>> m = Model("servo")
    >>> w, = m.states(w="rad/s")
    >>> u, = m.inputs(u="V")
    >>> c, k = m.parameters("c k")
    >>> m.dynamics(w=-c*w + k*u)
    >>> m.outputs(w=w)
    >>> candidates(m, leave_out=("lag", "cube", "periodic", "delay")).names[:4]
    ("w':bias", "w':w^2", "w':u^2", "w':w*u")
    """
    _check(model, trim, leave_out, equations, base)
    model.check()
    trim = dict(trim or {})
    trim |= {late: trim[of] for late, (of, _) in model.delays.inputs.items() if of in trim}
    scales = Scales.of(points, trim) if points is not None else Scales(trim=trim)
    structure = ModelStructure(model, equations == "all", base)
    names = _Names(model)
    own = list(_own(model, structure, scales, terms or {}, names))
    made = [c for c in _library(structure, scales, names) if c.family not in leave_out]
    kept = _distinct(own, made, Directions(model, scales))
    return Candidates(c for c in kept if points is None or c.worthwhile())


def _check(model: Any, trim: Any, leave_out: Any, equations: Any, base: Any) -> None:
    for m in (model, base):
        if not (isinstance(m, Model) or (m is None and model is not None)):
            raise ModelError(f"candidates: give a Model, not a {type(m).__name__}")
    if equations not in ("own", "all"):
        raise OptionError(f'candidates: equations is "own" or "all", not {equations!r}')
    for name in trim or {}:
        known = [*model.state_names, *model.declared_inputs]
        if name not in known:
            raise OptionError(f"candidates: trim names '{name}', no state or input.{did_you_mean(name, known)}")
    if isinstance(leave_out, str):
        raise OptionError(f"candidates: leave_out is several families, as in leave_out=({leave_out!r},)")
    for family in leave_out:
        if family not in FAMILIES:
            hint = did_you_mean(str(family), FAMILIES)
            raise OptionError(f"candidates: there is no family '{family}'.{hint} There are: {', '.join(FAMILIES)}.")


class _Names:
    """Names of new parameters: none twice, none of the model's."""

    def __init__(self, model: Model) -> None:
        self._taken = {*model.state_names, *model.parameter_names, *model.output_names, "time"}
        self._taken |= {*model.quantity_names, *model.declared_inputs}

    def __call__(self, wanted: str) -> str:
        return unused(re.sub(r"\W+", "_", wanted).strip("_"), self._taken)


def _own(
    model: Model, structure: ModelStructure, scales: Scales, terms: Mapping[str, Any], names: _Names
) -> Iterator[Effect]:
    for place, what, e in read_terms(model, terms):
        name = f"{structure.shown(place)}:{what}"
        words = f"{where(place)} contains a term proportional to {str(e).replace('**', '^')}"
        coefficient = names(f"{_stem(place)}_{what}")
        yield Term(name, place, words, "own", scales, (coefficient,), variables=tuple(e.symbols), given=e)


def _stem(place: Place) -> str:
    """Beginning of the names of coefficients there."""
    return {"equation": f"{place.name}_dot", "output": f"y_{place.name}"}.get(place.kind, place.name)


def _library(structure: ModelStructure, scales: Scales, names: _Names) -> Iterator[Effect]:
    model = structure.model
    for place in structure.places:
        if place.kind == "output":
            yield from _in_output(structure, place, scales, names)
        else:
            yield from _in_equation(structure, place, scales, names)
    for variable in structure.variables:
        if variable.kind == "input" and structure.used(variable.symbol):
            of = _OF_CONDITIONS if model.is_condition(variable.symbol) else FAMILIES
            yield from (c for c in _on_input(structure, variable, scales, names) if c.family in of)
    yield from _of_the_medium(structure, scales, names)
    yield from _limits(structure, scales, names)
    for name in structure.acting:
        words, place = f"{name} changes during the record", Place("parameter", name)
        yield ParameterDrift(f"{name}:drift", place, words, "variation", scales, (names(f"drift_{name}"),))
    for name in structure.acting:
        words, place = (
            f"{name} changes abruptly during the record (a load, a setting, a failure)",
            Place("parameter", name),
        )
        shape = (names(f"time_of_step_{name}"),)
        yield ParameterStep(f"{name}:step", place, words, "step", scales, (names(f"step_{name}"),), shape)


def _of_the_medium(structure: ModelStructure, scales: Scales, names: _Names) -> Iterator[Effect]:
    """Yield constants in the kinematics of positions: a wind or a current, which carries the vehicle along."""
    model = structure.model
    for name, e in structure.dynamics.items():
        place = Place("equation", name)
        if len({*e.symbols}) > 1 and model.units.get(name, "") in LENGTHS and place not in structure.places:
            yield _term(structure, place, "bias", (), scales, names)


def _term(
    structure: ModelStructure, place: Place, form: str, factors: Sequence[Variable], scales: Scales, names: _Names
) -> Term:
    f, shown = FORMS[form], [v.shown for v in factors]
    coefficient = names(f"{_stem(place)}_{f.suffix.format(*shown)}")
    name = f"{structure.shown(place)}:{f.what.format(*shown)}"
    symbols = tuple(v.symbol for v in factors)
    unit = structure.model.units.get(place.name, "") if place.kind == "output" else ""
    if form == "drift" and unit:
        unit = per_second(unit)
    return Term(
        name,
        place,
        "",
        form.partition(",")[0],
        scales,
        (coefficient,),
        variables=symbols,
        form=form,
        shown=tuple(shown),
        unit=unit if form in ("bias", "drift") else "",
        moving=len(factors) == 1 and (factors[0].speed or factors[0].rate),
    )


def _of_inertia(structure: ModelStructure, place: Place) -> list[tuple[Variable, int]]:
    """Return the states, with a power, that the inertia of a state equation may depend on: a position, whose rate it
    gives, and what stores energy there itself, as the current in an inductor."""
    if place.kind != "equation":
        return []
    own = [(v, 2) for v in structure.variables if v.kind == "state" and v.symbol == place.name]
    return own + [(x, k) for x, v in structure.coordinates if v.symbol == place.name for k in (1, 2)]


def _in_equation(structure: ModelStructure, place: Place, scales: Scales, names: _Names) -> Iterator[Effect]:
    variables = structure.variables

    def term(form: str, *factors: Variable) -> Term:
        return _term(structure, place, form, factors, scales, names)

    yield term("bias")
    words = f"{where(place)} is larger by a factor (another mass, inertia or gear ratio)"
    scale = names(f"k_{_stem(place)}")
    yield EquationScale(f"{structure.shown(place)}:scale", place, words, "factor", scales, (scale,))
    for v, power in _of_inertia(structure, place):
        shown, suffix = (v.shown, v.shown) if power == 1 else (f"{v.shown}^{power}", f"{v.shown}{power}")
        words = (
            f"{where(place)} is larger by a factor that changes with {shown} (mass, inertia or inductance that does)"
        )
        name, scale = f"{structure.shown(place)}:scale*{shown}", names(f"k_{_stem(place)}_{suffix}")
        yield EquationScale(name, place, words, "factor", scales, (scale,), (), (v.symbol,), power=power)
    for form in ("linear", "square", "cube", "quadratic"):
        yield from (term(form, v) for v in structure.declared_in(place))
    if place.kind == "quantity":
        for form in ("linear", "square", "quadratic"):
            yield from (term(form, v) for v in structure.declared_beside(place))
    for form in ("linear", "square"):
        yield from (term(form, v) for v in variables)
    yield from (term("product", v, w) for v, w in combinations(variables, 2))
    states = [v for v in variables if v.kind == "state"]
    yield from (term("damping", v, w) for v, w in combinations(states, 2) if w.rate)
    yield from (term("damping, rate first", v, w) for v, w in combinations(states, 2) if v.rate)
    inputs = [v for v in variables if v.kind == "input"]
    yield from (term("effectiveness", v, w) for v in states if not v.rate for w in inputs)
    slow = [v for v in states if not v.rate]
    yield from (term("effectiveness", v, w) for v, w in permutations(slow, 2) if structure.interact(place, v, w))
    yield from (term(form, *factors) for form, factors in _of_rotation(structure, place))
    for form in ("cube", "quadratic", "absolute"):
        yield from (term(form, v) for v in variables)
    yield from (term("root", v) for v in variables if structure.is_store(v))
    yield from (term("sign", v) for v in variables if v.speed or v.kind == "input")
    shown, stem, words = structure.shown(place), _stem(place), where(place)
    yield from (_lagged(structure, place, v, scales, names) for v in variables)
    yield from _with_memory(structure, place, scales, names)
    coefficients = names(f"{stem}_sin"), names(f"{stem}_cos")
    yield Periodic(
        f"{shown}:periodic",
        place,
        f"a periodic disturbance acts on {words}",
        "periodic",
        scales,
        coefficients,
        (names(f"{stem}_frequency"),),
    )


def _of_rotation(structure: ModelStructure, place: Place) -> Iterator[tuple[str, tuple[Variable, ...]]]:
    """Yield the forms and factors of forces by the rotation of others: an equation of motion of one coordinate holds
    positions times products of rates, not both its own (Lagrange's equations with a mass matrix that depends on the
    position)."""
    coordinates = structure.coordinates
    own = next((v for _, v in coordinates if structure.force_on(v.symbol) == place), None)
    if own is None or not 2 <= len(coordinates) <= _COORDINATES:
        return
    for x, _ in coordinates:
        form = "rotation, angle" if structure.turns_freely(x.symbol) else "rotation"
        for v, w in combinations_with_replacement([v for _, v in coordinates], 2):
            if v is not w:
                yield f"{form}, two rates", (x, v, w)
            elif v is not own:
                yield form, (x, v)


def _lagged(
    structure: ModelStructure, place: Place, variable: Variable, scales: Scales, names: _Names
) -> LaggedVariable:
    shown, stem = structure.shown(place), _stem(place)
    return LaggedVariable(
        f"{shown}:lag_{variable.shown}",
        place,
        f"{where(place)} follows {variable.shown} with a lag (unsteady effect)",
        "lag",
        scales,
        (names(f"{stem}_lag_{variable.shown}"),),
        (names(f"tau_{stem}_{variable.shown}"),),
        variables=(variable.symbol,),
    )


def _with_memory(structure: ModelStructure, place: Place, scales: Scales, names: _Names) -> Iterator[Effect]:
    """Friction that is larger at rest, hysteresis of what moves, and a mode."""
    shown, stem, words = structure.shown(place), _stem(place), where(place)
    for v in structure.variables:
        if v.kind == "state" and v.speed:
            yield Stribeck(
                f"{shown}:stribeck_{v.shown}",
                place,
                f"{words} has dry friction that is larger where {v.shown} is small (Stribeck effect)",
                "stribeck",
                scales,
                (names(f"{stem}_stribeck_{v.shown}"),),
                (names(f"speed_{stem}_{v.shown}"),),
                variables=(v.symbol,),
                beside="" if structure.has_friction(place, v.symbol) else f"{shown}:sign({v.shown})",
            )
        moves = v.rate or structure.model.units.get(v.symbol, "").endswith("/s")
        if v.kind == "state" and v.symbol in structure.dynamics and not moves:
            yield Hysteresis(
                f"{shown}:hysteresis_{v.shown}",
                place,
                f"{words} depends on the reversals of {v.shown} (hysteresis, or dry friction that yields)",
                "hysteresis",
                scales,
                (names(f"{stem}_hysteresis_{v.shown}"),),
                (names(f"yield_{stem}_{v.shown}"), names(f"turn_{stem}_{v.shown}")),
                variables=(v.symbol,),
            )
    for v in structure.variables:
        if structure.is_position(v):
            yield _ripple(structure, place, v, "cogging, ripple of a motor or a gear", scales, names)
    if any(v.kind == "input" and v.symbol in structure.expression(place).symbols for v in structure.variables):
        yield LimitedForce(
            f"{shown}:saturation",
            place,
            f"{words} is limited in both directions (saturation of a current, force or traction)",
            "saturation",
            scales,
            (),
            (names(f"saturation_{stem}"),),
        )
    yield FlexibleMode(
        f"{shown}:mode",
        place,
        f"{words} excites a lightly damped mode that the model lacks",
        "mode",
        scales,
        (names(f"{stem}_mode"),),
        (names(f"frequency_{stem}_mode"), names(f"damping_{stem}_mode")),
    )


def _ripple(
    structure: ModelStructure, place: Place, variable: Variable, reason: str, scales: Scales, names: _Names
) -> Ripple:
    shown, stem = variable.shown, _stem(place)
    return Ripple(
        f"{structure.shown(place)}:periodic_{shown}",
        place,
        f"{where(place)} is periodic in {shown} ({reason})",
        "ripple",
        scales,
        (names(f"{stem}_sin_{shown}"), names(f"{stem}_cos_{shown}")),
        (names(f"wave_number_{stem}_{shown}"),),
        variables=(variable.symbol,),
        turn=TURN.get(structure.model.units.get(variable.symbol, ""), 0.0),
    )


def _limits(structure: ModelStructure, scales: Scales, names: _Names) -> Iterator[Effect]:
    """States that go no further: positions meet a stop, stores are full."""
    places = {place.name for place in structure.places if place.kind == "equation"}
    units = structure.model.units
    for v in structure.variables:
        x = v.symbol
        if v.kind != "state" or x not in structure.dynamics or v.rate or structure.turns_freely(x):
            continue
        e, limit = structure.dynamics[x], names(f"limit_of_{x}")
        speed = next((w.symbol for w in structure.variables if w.kind == "state" and e == Expr.symbol(w.symbol)), "")
        at = structure.force_on(speed) if speed else None
        if at is not None:
            words = f"{x} meets an end stop, which acts on {speed} like a stiff spring"
            stiffness = names(f"stop_of_{x}")
            shape = limit, names(f"loss_of_{x}")
            yield EndStop(f"{x}:limit", at, words, "limit", scales, (stiffness,), shape, variables=(x,), speed=speed)
        elif x in places and units.get(x, "") not in ANGLES and not units.get(x, "").endswith("/s"):
            words = f"{x} stops at a limit (overflow, a store that is full or empty)"
            yield StateLimit(f"{x}:limit", Place("equation", x), words, "limit", scales, (), (limit,), variables=(x,))


def _in_output(structure: ModelStructure, place: Place, scales: Scales, names: _Names) -> Iterator[Effect]:
    shown, y = structure.shown(place), place.name
    rates = [v for v in structure.variables if v.rate]

    def term(form: str, *factors: Variable) -> Term:
        return _term(structure, place, form, factors, scales, names)

    yield term("bias")
    words = f"the measurement of {y} has a wrong scale factor"
    yield SensorScale(f"{shown}:scale", place, words, "scale", scales, (names(f"k_{y}"),))
    yield term("drift")
    yield from (term("linear", v) for v in structure.variables)
    yield from (term("square", v) for v in rates)
    yield from (term("product", v, w) for v, w in combinations(rates, 2))
    yield from (Rate.of(place, shown, v.symbol, names(f"y_{y}_{v.shown}_dot"), scales) for v in rates)
    for power, degree in ((2, "square"), (3, "cube")):
        if power == 3 or y not in {v.shown for v in rates}:  # of a rate there is its square already
            words = f"the measurement of {y} contains a term proportional to its {degree} (nonlinear characteristic)"
            coefficients, key = (names(f"y_{y}_{y}{power}"),), (output_key(y),)
            name = f"{shown}:{y}^{power}"
            yield SensorCurve(name, place, words, "curve", scales, coefficients, variables=key, power=power)
    # Where an input acts on an output at once, a part of it may act through dynamics that the model has not.
    at_once = {*structure.expression(place).symbols}
    inputs = [v for v in structure.variables if v.kind == "input" and v.symbol in at_once]
    yield from (_lagged(structure, place, v, scales, names) for v in inputs)
    # There the output is more than what a sensor shows: a voltage over a resistance that depends on the charge.
    states = [v for v in structure.variables if v.kind == "state" and not v.rate]
    yield from (term("product", v, w) for v in states for w in inputs)
    yield from (term("square", v) for v in [*inputs, *(x for x in states if x.symbol in at_once and inputs)])
    for v in structure.variables:
        if v.kind == "state" and structure.is_angle(v):
            yield _ripple(structure, place, v, "an eccentric disc, wind against a heading", scales, names)
    words = f"the measurement of {y} is clipped at a limit"
    yield ClippedSensor(
        f"{shown}:clipped", place, words, "clipped", scales, (), (names(f"limit_{y}"),), variables=(output_key(y),)
    )
    shows = [v for v in structure.variables if v.symbol in at_once]
    if any(structure.is_position(v) or (shows == [v] and structure.is_angle(v)) for v in shows):
        words = f"the sensor of {y} has backlash: after a reversal it stays until the motion exceeds twice the estimate"
        key = (output_key(y),)
        yield Backlash(
            f"{shown}:backlash", place, words, "backlash", scales, (), (names(f"backlash_{y}"),), variables=key
        )
    words = f"the measurement of {y} follows with a lag (sensor or filter)"
    yield SensorLag(f"{shown}:lag", place, words, "lag", scales, (), (names(f"lag_{y}"),))
    if y not in structure.model.delays.outputs:
        yield SensorDelay(
            f"{shown}:delay",
            place,
            f"{y} is measured with a delay (negative: ahead of the other channels)",
            "delay",
            scales,
            (),
            (names(f"tau_{y}"),),
        )


def _on_input(structure: ModelStructure, variable: Variable, scales: Scales, names: _Names) -> Iterator[Effect]:
    u, symbol = variable.shown, variable.symbol
    place, variables = Place("input", symbol), (symbol,)
    yield InputScale(
        f"{u}:scale",
        place,
        f"{u} acts with another scale factor",
        "scale",
        scales,
        (names(f"k_{u}"),),
        variables=variables,
    )
    yield InputBias(
        f"{u}:bias", place, f"{u} acts with an offset", "bias", scales, (names(f"b_{u}"),), variables=variables
    )
    shaped: list[tuple[Callable[..., Effect], str, str, str]] = [
        (DeadBand, "deadband", f"deadband_{u}", f"small deflections of {u} have no effect (dead-band)"),
        (Saturation, "saturation", f"saturation_{u}", f"large deflections of {u} are cut off (saturation)"),
        (
            Backlash,
            "backlash",
            f"backlash_{u}",
            f"{u} has backlash: after a reversal it has no effect until its motion exceeds twice the estimate",
        ),
        (RateLimit, "rate_limit", f"rate_limit_{u}", f"the rate of {u} is limited"),
        (InputLag, "lag", f"lag_{u}", f"{u} acts with a lag (first-order actuator)"),
    ]
    if symbol not in structure.model.delays.inputs:
        shaped.append(
            (InputDelay, "delay", f"tau_{u}", f"{u} acts with a transport delay (negative: its record is delayed)")
        )
    for make, family, parameter, words in shaped:
        yield make(f"{u}:{family}", place, words, family, scales, (), (names(parameter),), variables=variables)


def _distinct(own: Sequence[Effect], made: Sequence[Effect], directions: Directions) -> list[Effect]:
    """Return those that say something new, in the order made, the user's own last; of the user's all must be new."""
    ranked = [*own, *sorted(made, key=lambda c: FAMILIES.index(c.family))]
    ranked = [c for c in ranked if c.family in _STATIC]
    dropped: set[int] = set()
    for c, verdict in zip(ranked, directions.verdicts(ranked), strict=True):
        if c.family == "own" and verdict.spanned:
            raise ModelError(
                f"terms: {c.name}: the model has this already, its parameters change the equations in just that way"
            )
        if c.family == "own" and verdict.twin is not None:
            twin = ranked[verdict.twin].name
            raise ModelError(f"terms: {c.name} and {twin} are the same but for a factor and what the model has")
        if verdict.spanned or verdict.twin is not None:
            dropped.add(id(c))
    kept = [c for c in (*made, *own) if id(c) not in dropped]
    there = {c.name for c in kept}
    # What the model has already need not be found first.
    return [c if not c.beside or c.beside in there else replace(c, beside="") for c in kept]
