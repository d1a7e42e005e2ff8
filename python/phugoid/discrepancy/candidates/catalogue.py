"""Candidates for each place of a model, from the catalogue of known forms and effects."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import partial
from itertools import combinations, combinations_with_replacement, permutations, product

from ..._core import Expr
from ...modelling.model import Model
from ...sensitivities import Place
from .candidate import Effect, taken_names, unused
from .channel_effects import (
    ClippedSensor,
    DeadBand,
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
from .factors import HOW, EquationScale, FactorExponent, FactorLaw, ParameterLaw, SaturatingRate
from .hysteresis import FlexibleMode, Hysteresis, Stall, Stribeck
from .limits import Backlash, EndStop, LimitedForce, Overflow, RateLimit, StateLimit
from .model_structure import ANGLES, LENGTHS, TURN, ModelStructure, Variable, motion_part
from .scales import Scales, output_key
from .terms import FORMS, Decaying, LaggedVariable, Periodic, Rate, Ripple, Term, where
from .variation import FallingMass, Jump, ParameterDrift, ParameterWithIntegral

__all__ = ["Catalogue", "Names", "stem"]

# Coordinates of a mechanism, at most, whose rotation may act on each other: the terms are the cube of that many.
_COORDINATES = 3
# Names of an angle of attack, by which alone it is known.
_ANGLES_OF_ATTACK = ("alpha", "aoa", "angle_of_attack", "\N{GREEK SMALL LETTER ALPHA}")
# Forms of an angle in its own equation of motion.
_SINES = ("sine", "sine, cosine", "sine, twice")
# What can be wrong with a condition, which is measured and not commanded: nothing that an actuator does.
_OF_CONDITIONS = ("scale", "bias", "delay")


class Names:
    """Names of new parameters: none twice, none of the model's."""

    def __init__(self, model: Model) -> None:
        self._taken = {*taken_names(model), *model.output_names, "time"}

    def __call__(self, wanted: str) -> str:
        return unused(re.sub(r"\W+", "_", wanted).strip("_"), self._taken)


def stem(place: Place) -> str:
    """Beginning of the names of coefficients there."""
    return {"equation": f"{place.name}_dot", "output": f"y_{place.name}"}.get(place.kind, place.name)


class Catalogue:
    """Makes the effects that a model may miss, with ``scales`` for a record and parameters called by ``names``."""

    def __init__(self, structure: ModelStructure, scales: Scales, names: Names) -> None:
        self.structure, self.scales, self.names = structure, scales, names

    def all(self) -> Iterator[Effect]:
        """Yield them, place by place."""
        model = self.structure.model
        for place in self.structure.places:
            if place.kind == "output":
                yield from self._in_output(place)
            else:
                yield from self._in_equation(place)
        for variable in self.structure.variables:
            if variable.kind == "input" and self.structure.used(variable.symbol):
                acts = not model.is_condition(variable.symbol)
                yield from (c for c in self._on_input(variable) if acts or c.family in _OF_CONDITIONS)
        yield from self._of_exact_quantities()
        yield from self._of_the_medium()
        yield from (self._term(place, "linear", v) for place, v in self.structure.direct_forces)
        yield from self._limits()
        conditions = [v for v in self.structure.variables if v.kind == "input" and model.is_condition(v.symbol)]
        for name, x in product(self.structure.acting, conditions):
            words, place = f"{name} changes with {x.shown}", Place("parameter", name)
            d = self.names(f"{name}_{x.shown}")
            yield ParameterLaw(f"{name}:{x.shown}", place, words, "dependence", self.scales, (d,), (), (x.symbol,))
        yield from (self._saturating(name, x) for name, x in self.structure.rates_of_stores)
        for name, x in self.structure.factors_of_parameters:
            words = f"the factor of {name} is proportional to another power of {x.shown} than the first"
            e, place = self.names(f"exponent_{name}_{x.shown}"), Place("parameter", name)
            title = f"{name}:exponent_{x.shown}"
            yield FactorExponent(title, place, words, "exponent", self.scales, (e,), (), (x.symbol,))
        used = [v for v in self.structure.variables if v.kind == "input" and self.structure.used(v.symbol)]
        # What is used up is an amount: a deflection is none.
        used = [v for v in used if v not in conditions and model.variable_units.get(v.symbol, "") not in ANGLES]
        for place, x in product([p for p in self.structure.places if p.kind == "equation"], used):
            yield self._falling_mass(place, x)
        for name, x in product(self.structure.acting, used):
            words = f"{name} changes with the integral of {x.shown} (fuel burnt, charge drawn, heat stored)"
            d = self.names(f"{name}_integral_{x.shown}")
            yield ParameterWithIntegral(
                f"{name}:integral_{x.shown}", Place("parameter", name), words, "integral", self.scales, (d,), (),
                (x.symbol,),
            )  # fmt: skip
        for name in self.structure.acting:
            words, place = f"{name} changes during the record", Place("parameter", name)
            yield ParameterDrift(
                f"{name}:drift", place, words, "variation", self.scales, (self.names(f"drift_{name}"),)
            )
        for name in self.structure.acting:
            words = f"{name} changes abruptly during the record (a load, a setting, a failure)"
            yield self._step(Place("parameter", name), words)
        for place in self.structure.places:
            if place.kind == "output":
                words = f"the zero of {place.name} jumps during the record (a sensor that is readjusted, or slips)"
                yield self._step(place, words)

    def _step(self, place: Place, words: str) -> Jump:
        title, base = f"{self.structure.shown(place)}:step", stem(place)
        size, time = self.names(f"step_{base}"), self.names(f"time_of_step_{base}")
        return Jump(title, place, words, "step", self.scales, (size,), (time,))

    def _of_exact_quantities(self) -> Iterator[Effect]:
        """Yield dead zones and limits of quantities that forces are functions of, such as the play of a gear in the
        difference of two angles."""
        for v in self.structure.exact_in_forces:
            place = Place("quantity", v.symbol)
            rate = self.structure.rate_of(v)
            for make, family, of in ((DeadBand, "deadband", rate), (Saturation, "saturation", "")):
                name, shape = f"{v.shown}:{family}", (self.names(f"{family}_{v.shown}"),)
                effect = make(name, place, "", family, self.scales, (), shape, variables=(v.symbol,), rate=of)
                yield effect.on(self.scales)  # with its words and its centre

    def _of_the_medium(self) -> Iterator[Effect]:
        """Yield constants in the kinematics of positions: a wind or a current, which carries the vehicle along."""
        model = self.structure.model
        for name, e in self.structure.dynamics.items():
            place = Place("equation", name)
            if (
                len({*e.symbols}) > 1
                and model.variable_units.get(name, "") in LENGTHS
                and place not in self.structure.places
            ):
                yield self._term(place, "bias")

    def _term(self, place: Place, form: str, *factors: Variable) -> Term:
        f, shown = FORMS[form], [v.shown for v in factors]
        coefficient = self.names(f"{stem(place)}_{f.suffix.format(*shown)}")
        name = f"{self.structure.shown(place)}:{f.what.format(*shown)}"
        symbols = tuple(v.symbol for v in factors)
        unit = self.structure.model.units.get(place.name, "") if place.kind == "output" else ""
        if form == "drift" and unit:
            unit = self.structure.model.time_unit.rate(unit)
        return Term(
            name,
            place,
            "",
            form.partition(",")[0],
            self.scales,
            (coefficient,),
            variables=symbols,
            form=form,
            shown=tuple(shown),
            unit=unit if form in ("bias", "drift") else "",
            moving=len(factors) == 1 and (factors[0].speed or factors[0].rate),
        )

    def _of_inertia(self, place: Place) -> list[tuple[Variable, int]]:
        """Return the states, with a power, that the inertia of a state equation may depend on: a position, whose rate
        it gives, and what stores energy there itself, as the current in an inductor."""
        if place.kind != "equation":
            return []
        own = [(v, 2) for v in self.structure.variables if v.kind == "state" and v.symbol == place.name]
        return own + [(x, k) for x, v in self.structure.coordinates if v.symbol == place.name for k in (1, 2)]

    def _law(self, place: Place, v: Variable) -> FactorLaw:
        words = f"{where(place)} is larger by a factor that changes with {v.shown}, {HOW['exponential']}"
        name, k = f"{self.structure.shown(place)}:scale*{v.shown}", self.names(f"k_{stem(place)}_{v.shown}")
        return FactorLaw(name, place, words, "law", self.scales, (k,), (), (v.symbol,))

    def _falling_mass(self, place: Place, x: Variable) -> FallingMass:
        shown = self.structure.shown(place)
        words = (
            f"the forces in {where(place)} act on a mass, an inertia or a capacity that falls with the integral of "
            f"{x.shown} (fuel burnt, stock used)"
        )
        part = self.names(f"part_of_{stem(place)}_by_{x.shown}")
        model = self.structure.model
        motion = motion_part(self.structure.dynamics[place.name], model.state_names)
        title = f"{shown}:scale*integral_{x.shown}"
        return FallingMass(title, place, words, "integral", self.scales, (part,), (), (x.symbol,), motion=motion)

    def _saturating(self, name: str, x: Variable) -> SaturatingRate:
        words = (
            f"the rate {name}*{x.shown} saturates as {x.shown} grows (Michaelis-Menten, Monod or Holling kinetics); "
            f"K_{name}_{x.shown} is the half-saturation constant"
        )
        d, half = self.names(f"d_{name}_{x.shown}"), self.names(f"K_{name}_{x.shown}")
        title, place = f"{name}:saturating_{x.shown}", Place("parameter", name)
        return SaturatingRate(title, place, words, "saturating", self.scales, (d,), (half,), (x.symbol,))

    def _in_equation(self, place: Place) -> Iterator[Effect]:
        variables = self.structure.variables

        term = partial(self._term, place)
        yield term("bias")
        words = f"{where(place)} is larger by a factor (another mass, inertia or gear ratio)"
        scale = self.names(f"k_{stem(place)}")
        yield EquationScale(f"{self.structure.shown(place)}:scale", place, words, "factor", self.scales, (scale,))
        for v, power in self._of_inertia(place):
            shown, suffix = (v.shown, v.shown) if power == 1 else (f"{v.shown}^{power}", f"{v.shown}{power}")
            words = f"{where(place)} is larger by a factor that changes with {shown} (mass, inertia, inductance)"
            name, scale = f"{self.structure.shown(place)}:scale*{shown}", self.names(f"k_{stem(place)}_{suffix}")
            yield EquationScale(name, place, words, "factor", self.scales, (scale,), (), (v.symbol,), power=power)
        if self.structure.is_product(place):
            yield from (self._law(place, v) for v in [*variables, *self.structure.declared_beside(place)])
        for form in ("linear", "square", "cube", "quadratic", "absolute"):
            yield from (term(form, v) for v in self.structure.declared_in(place))
        yield from (term("sign", v) for v in self.structure.declared_in(place) if v.speed)
        if place.kind == "quantity":
            for form in ("linear", "square", "quadratic"):
                yield from (term(form, v) for v in self.structure.declared_beside(place))
        for form in ("linear", "square"):
            yield from (term(form, v) for v in variables)
        yield from (term("product", v, w) for v, w in combinations(variables, 2))
        states = [v for v in variables if v.kind == "state"]
        yield from (term("damping", v, w) for v, w in combinations(states, 2) if w.rate)
        yield from (term("damping, rate first", v, w) for v, w in combinations(states, 2) if v.rate)
        inputs = [v for v in variables if v.kind == "input"]
        slow = [v for v in states if not v.rate]
        yield from (term("effectiveness", v, w) for v in slow for w in inputs)
        yield from (
            term("effectiveness", v, w)
            for v, w in permutations(slow, 2)
            if self.structure.interact(place, v, w) or self.structure.may_depend_on_position(place, v, w)
        )
        yield from (term(form, *factors) for form, factors in self._of_rotation(place))
        for form in ("cube", "quadratic", "absolute"):
            yield from (term(form, v) for v in variables)
        units = self.structure.model.variable_units
        angles = [x for x, _ in self._driven_at(place) if units.get(x.symbol, "") == "rad"]
        yield from (term(form, x) for x in angles for form in _SINES)
        yield from (term("root", v) for v in variables if self.structure.is_store(v))
        # A current that flows either way loses the voltage of a brush, a diode or a dead time whatever its size.
        own = [v for v in states if self.structure.is_store(v) and self.structure.force_on(v.symbol) == place]
        yield from (term("sign", v) for v in variables if v.speed or v.kind == "input" or v in own)
        shown, base, words = self.structure.shown(place), stem(place), where(place)
        yield from (self._lagged(place, v) for v in variables)
        yield from self._near_the_ground(place)
        yield from self._with_memory(place)
        coefficients = self.names(f"{base}_sin"), self.names(f"{base}_cos")
        yield Periodic(
            f"{shown}:periodic",
            place,
            f"a periodic disturbance acts on {words}",
            "periodic",
            self.scales,
            coefficients,
            (self.names(f"{base}_frequency"),),
        )

    def _driven_at(self, place: Place) -> list[tuple[Variable, Variable]]:
        """Return the positions, each with its rate, whose acceleration is given at a place."""
        return [(x, v) for x, v in self.structure.coordinates if self.structure.force_on(v.symbol) == place]

    def _of_rotation(self, place: Place) -> Iterator[tuple[str, tuple[Variable, ...]]]:
        """Yield the forms and factors of forces by the rotation of others: an equation of motion of one coordinate
        holds positions times products of rates, not both its own (Lagrange's equations with a mass matrix that depends
        on the position)."""
        coordinates = self.structure.coordinates
        own = next((v for _, v in self._driven_at(place)), None)
        if own is None or not 2 <= len(coordinates) <= _COORDINATES:
            return
        for x, _ in coordinates:
            form = "rotation, angle" if self.structure.turns_freely(x.symbol) else "rotation"
            for v, w in combinations_with_replacement([v for _, v in coordinates], 2):
                if v is not w:
                    yield f"{form}, two rates", (x, v, w)
                elif v is not own:
                    yield form, (x, v)

    def _lagged(self, place: Place, variable: Variable) -> LaggedVariable:
        shown, base = self.structure.shown(place), stem(place)
        return LaggedVariable(
            f"{shown}:lag_{variable.shown}",
            place,
            f"{where(place)} follows {variable.shown} with a lag (unsteady effect)",
            "lag",
            self.scales,
            (self.names(f"{base}_lag_{variable.shown}"),),
            (self.names(f"tau_{base}_{variable.shown}"),),
            variables=(variable.symbol,),
        )

    def _near_the_ground(self, place: Place) -> Iterator[Effect]:
        """Yield what decays with a position, unless that is an angle or the place is what its own rate is; alone, and
        in proportion to an input or a state that acts there, such as a thrust."""
        units = self.structure.model.variable_units
        symbols = {*self.structure.expression(place).symbols} - {place.name}
        acting = [w for w in self.structure.variables if w.symbol in symbols and self._is_force(w)]
        for v in self.structure.variables:
            if v.kind != "state" or not (self.structure.is_position(v) or units.get(v.symbol, "") in LENGTHS):
                continue
            if self.structure.is_angle(v) or place.name == v.symbol:
                continue
            decays = f"decays with {v.shown}"
            yield self._decaying(place, f"a part that {decays} (ground effect, a wall, a magnet)", v)
            for w in acting:
                part = f"a part in proportion to {w.shown} that {decays} (ground effect on a thrust, a magnet)"
                yield self._decaying(place, part, v, w)

    def _is_force(self, variable: Variable) -> bool:
        """Return whether a variable may be a force or what makes one: an input, or a state that is no motion."""
        moves = variable.rate or self.structure.is_position(variable) or self.structure.is_angle(variable)
        return variable.kind == "input" or (variable.kind == "state" and not moves)

    def _decaying(self, place: Place, part: str, position: Variable, *factors: Variable) -> Decaying:
        title = "*".join([*(w.shown for w in factors), f"exp(-{position.shown})"])
        base = "_".join([stem(place), *(w.shown for w in factors)])
        return Decaying(
            f"{self.structure.shown(place)}:{title}",
            place,
            f"{where(place)} contains {part}",
            "decay",
            self.scales,
            (self.names(f"{base}_near_{position.shown}"),),
            (self.names(f"distance_{base}_{position.shown}"),),
            variables=tuple(v.symbol for v in (position, *factors)),
        )

    def _with_memory(self, place: Place) -> Iterator[Effect]:
        """Friction that is larger at rest, hysteresis of what moves, and a mode."""
        shown, base, words = self.structure.shown(place), stem(place), where(place)
        for v in self.structure.variables:
            if v.kind == "state" and v.speed:
                yield Stribeck(
                    f"{shown}:stribeck_{v.shown}",
                    place,
                    f"{words} has dry friction that is larger where {v.shown} is small (Stribeck effect)",
                    "stribeck",
                    self.scales,
                    (self.names(f"{base}_stribeck_{v.shown}"),),
                    (self.names(f"speed_{base}_{v.shown}"),),
                    variables=(v.symbol,),
                    beside="" if self.structure.has_friction(place, v.symbol) else f"{shown}:sign({v.shown})",
                    direction=self.structure.direction(place, v.symbol),
                )
            moves = v.rate or self.structure.moves(v.symbol)
            if v.kind == "state" and v.symbol in self.structure.dynamics and not moves:
                yield Hysteresis(
                    f"{shown}:hysteresis_{v.shown}",
                    place,
                    f"{words} depends on the reversals of {v.shown} (hysteresis, or dry friction that yields)",
                    "hysteresis",
                    self.scales,
                    (self.names(f"{base}_hysteresis_{v.shown}"),),
                    (self.names(f"yield_{base}_{v.shown}"), self.names(f"turn_{base}_{v.shown}")),
                    variables=(v.symbol,),
                )
        for v in self.structure.variables:
            if v.symbol.lower() in _ANGLES_OF_ATTACK and v.symbol in self.structure.expression(place).symbols:
                yield Stall(
                    f"{shown}:stall",
                    place,
                    f"{words} loses a part where {v.shown} is large, with a lag (stall: flow that separates)",
                    "stall",
                    self.scales,
                    (self.names(f"{base}_stall"),),
                    tuple(self.names(f"{what}_{base}_stall") for what in ("angle", "width", "tau")),
                    variables=(v.symbol,),
                )
        for v in self.structure.variables:
            if self.structure.is_position(v):
                yield self._ripple(place, v, "cogging, ripple of a motor or a gear")
        if any(
            v.kind == "input" and v.symbol in self.structure.expression(place).symbols for v in self.structure.variables
        ):
            yield LimitedForce(
                f"{shown}:saturation",
                place,
                f"{words} is limited in both directions (saturation of a current, force or traction)",
                "saturation",
                self.scales,
                (),
                (self.names(f"saturation_{base}"),),
            )
        yield FlexibleMode(
            f"{shown}:mode",
            place,
            f"{words} excites a lightly damped mode that the model lacks",
            "mode",
            self.scales,
            (self.names(f"{base}_mode"),),
            (self.names(f"frequency_{base}_mode"), self.names(f"damping_{base}_mode")),
        )

    def _ripple(self, place: Place, variable: Variable, reason: str) -> Ripple:
        shown, base = variable.shown, stem(place)
        return Ripple(
            f"{self.structure.shown(place)}:periodic_{shown}",
            place,
            f"{where(place)} is periodic in {shown} ({reason})",
            "ripple",
            self.scales,
            (self.names(f"{base}_sin_{shown}"), self.names(f"{base}_cos_{shown}")),
            (self.names(f"wave_number_{base}_{shown}"),),
            variables=(variable.symbol,),
            turn=TURN.get(self.structure.model.variable_units.get(variable.symbol, ""), 0.0),
        )

    def _limits(self) -> Iterator[Effect]:
        """States that go no further: positions meet a stop, stores are full."""
        units = self.structure.model.variable_units
        for v in self.structure.variables:
            x = v.symbol
            if v.kind != "state" or x not in self.structure.dynamics or v.rate or self.structure.turns_freely(x):
                continue
            e, limit = self.structure.dynamics[x], self.names(f"limit_of_{x}")
            speed = next(
                (w.symbol for w in self.structure.variables if w.kind == "state" and e == Expr.symbol(w.symbol)), ""
            )
            at = self.structure.force_on(speed) if speed else None
            if at is not None:
                words = f"{x} meets an end stop, which acts on {speed} like a stiff spring"
                stiffness = self.names(f"stop_of_{x}")
                shape = limit, self.names(f"loss_of_{x}")
                yield EndStop(
                    f"{x}:limit", at, words, "limit", self.scales, (stiffness,), shape, variables=(x,), speed=speed
                )
            elif self.structure.is_modelled(x) and units.get(x, "") not in ANGLES and not self.structure.moves(x):
                words = f"{x} stops at a limit (overflow, a store that is full or empty)"
                at = Place("equation", x)
                yield StateLimit(f"{x}:limit", at, words, "limit", self.scales, (), (limit,), variables=(x,))
                for z in self.structure.fed_by(x):
                    words = f"{x} stops at a limit (a store that is full), and a part of the excess goes to {z}"
                    shape = self.names(f"level_of_{x}_over_{z}"), self.names(f"part_of_{x}_to_{z}")
                    name = f"{x}:overflow_{z}"
                    yield Overflow(name, at, words, "limit", self.scales, (), shape, variables=(x,), into=z)

    def _in_output(self, place: Place) -> Iterator[Effect]:
        shown, y = self.structure.shown(place), place.name
        rates = [v for v in self.structure.variables if v.rate]

        term = partial(self._term, place)
        yield term("bias")
        words = f"the measurement of {y} has a wrong scale factor"
        yield SensorScale(f"{shown}:scale", place, words, "scale", self.scales, (self.names(f"k_{y}"),))
        yield term("drift")
        yield from (term("linear", v) for v in self.structure.variables)
        yield from (term("square", v) for v in rates)
        yield from (term("product", v, w) for v, w in combinations(rates, 2))
        yield from (Rate.of(place, shown, v.symbol, self.names(f"y_{y}_{v.shown}_dot"), self.scales) for v in rates)
        for power, degree in ((2, "square"), (3, "cube")):
            if power == 3 or y not in {v.shown for v in rates}:  # of a rate there is its square already
                words = (
                    f"the measurement of {y} contains a term proportional to its {degree} (nonlinear characteristic)"
                )
                coefficients, key = (self.names(f"y_{y}_{y}{power}"),), (output_key(y),)
                name = f"{shown}:{y}^{power}"
                yield SensorCurve(name, place, words, "curve", self.scales, coefficients, variables=key, power=power)
        # Where an input acts on an output at once, a part of it may act through dynamics that the model has not.
        at_once = {*self.structure.expression(place).symbols}
        inputs = [v for v in self.structure.variables if v.kind == "input" and v.symbol in at_once]
        yield from (self._lagged(place, v) for v in inputs)
        # There the output is more than what a sensor shows: a voltage over a resistance that depends on the charge.
        states = [v for v in self.structure.variables if v.kind == "state" and not v.rate]
        through = [v for v in inputs if self.structure.is_weighed(place, v)]
        yield from (term("product", v, w) for v in states for w in through)
        yield from (term("square", v) for v in [*through, *(x for x in states if x.symbol in at_once and through)])
        yield from (term(form, v) for form in ("cube", "quadratic", "absolute") for v in through)
        for v in self.structure.variables:
            if v.kind == "state" and self.structure.is_angle(v):
                yield self._ripple(place, v, "an eccentric disc, wind against a heading")
        words = f"the measurement of {y} is clipped at a limit"
        yield ClippedSensor(
            f"{shown}:clipped",
            place,
            words,
            "clipped",
            self.scales,
            (),
            (self.names(f"limit_{y}"),),
            variables=(output_key(y),),
        )
        shows = [v for v in self.structure.variables if v.symbol in at_once]
        if any(self.structure.is_position(v) or (shows == [v] and self.structure.is_angle(v)) for v in shows):
            words = f"the sensor of {y} has backlash: after a reversal it stays within a play of ± the estimate"
            key = (output_key(y),)
            yield Backlash(
                f"{shown}:backlash",
                place,
                words,
                "backlash",
                self.scales,
                (),
                (self.names(f"backlash_{y}"),),
                variables=key,
            )
        words = f"the measurement of {y} follows with a lag (sensor or filter)"
        yield SensorLag(f"{shown}:lag", place, words, "lag", self.scales, (), (self.names(f"lag_{y}"),))
        if y not in self.structure.model.delays.outputs:
            yield SensorDelay(
                f"{shown}:delay",
                place,
                f"{y} is measured with a delay (negative: ahead of the other channels)",
                "delay",
                self.scales,
                (),
                (self.names(f"tau_{y}"),),
            )

    def _on_input(self, variable: Variable) -> Iterator[Effect]:
        u, symbol = variable.shown, variable.symbol
        place, variables = Place("input", symbol), (symbol,)
        yield InputScale(
            f"{u}:scale",
            place,
            f"{u} acts with another scale factor",
            "scale",
            self.scales,
            (self.names(f"k_{u}"),),
            variables=variables,
        )
        yield InputBias(
            f"{u}:bias",
            place,
            f"{u} acts with an offset",
            "bias",
            self.scales,
            (self.names(f"b_{u}"),),
            variables=variables,
        )
        shaped: list[tuple[Callable[..., Effect], str, str, str]] = [
            (DeadBand, "deadband", f"deadband_{u}", DeadBand.words.format(name=u, about="")),
            (Saturation, "saturation", f"saturation_{u}", Saturation.words.format(name=u, about="")),
            (
                Backlash,
                "backlash",
                f"backlash_{u}",
                f"{u} has backlash: after a reversal it has no effect within a play of ± the estimate",
            ),
            (RateLimit, "rate_limit", f"rate_limit_{u}", f"the rate of {u} is limited"),
            (InputLag, "lag", f"lag_{u}", f"{u} acts with a lag (first-order actuator)"),
        ]
        if symbol not in self.structure.model.delays.inputs:
            shaped.append(
                (InputDelay, "delay", f"tau_{u}", f"{u} acts with a transport delay (negative: its record is delayed)")
            )
        for make, family, parameter, words in shaped:
            yield make(
                f"{u}:{family}", place, words, family, self.scales, (), (self.names(parameter),), variables=variables
            )
