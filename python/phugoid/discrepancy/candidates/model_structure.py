"""The structure of a model: places at which a term may be missing, and variables that it may depend on."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..._core import Expr
from ...modelling.model import Model
from ...sensitivities import Place
from .shared_terms import is_shared_term

__all__ = ["ANGLES", "LENGTHS", "TURN", "ModelStructure", "Variable", "addends"]

TURN = {"rad": 2.0 * math.pi, "deg": 360.0, "°": 360.0}
"""Unit of an angle -> a turn in it."""

ANGLES = tuple(TURN)
"""Units of angles."""

# Quantities beside a place, at most, of which it may be a function.
_BESIDE = 6

# Functions of angles of attitudes; and those that jump, or are put for a jump.
_SINES, _JUMPS = ("sin", "cos", "tan"), ("sign", "tanh", "atan")

# Points within +-this at which a slope is tried: angles in rad, and whatever else.
_TRIED, _RANGE = 50, 3.0
# Expressions that differ by less at these points are the same.
_EQUAL = 1e-9

LENGTHS = ("m", "km", "ft", "nmi", "NM")
"""Units of positions."""


@dataclass(frozen=True)
class Variable:
    """A state, an input or a declared quantity: its symbol in the equations, and the name to show for it."""

    symbol: str
    shown: str
    kind: str  # "state", "input" or "quantity"
    rate: bool = False  # an angular rate, or the derivative of another state
    speed: bool = False  # what friction may turn with


class ModelStructure:
    """Variables and places of a model.

    A quantity is a place where parameters stand in it; others define something exactly. A state equation is one where
    parameters stand in it, and no quantity that is a place, other than those that several equations share: else its
    terms belong to the quantity. Equations without either are exact kinematics (theta' = q).

    Terms that were declared because equations share them (`with_shared_terms`) take no place from these.

    With ``every_equation`` all state equations are places that hold parameters or quantities that do. ``base`` is an
    earlier form of the model: states and quantities that it had not are nothing to doubt.
    """

    def __init__(self, model: Model, every_equation: bool = False, base: Model | None = None) -> None:
        self.model, right = model, model._right_hand_sides()
        self.quantities, self.dynamics, self.outputs = (
            {name: e for (kind, name), e in right.items() if kind == wanted}
            for wanted in ("quantity", "equation", "output")
        )
        self._parameters = {*model.parameter_names}
        first = base or model
        known = {*first.state_names, *first.quantity_names}.difference(model.unused_quantities)
        uncertain = {n for n, e in self.quantities.items() if self._parameters.intersection(e.symbols)}
        derived: set[str] = set()  # from parameters, by whatever way
        for name, e in self.quantities.items():
            if name in uncertain or derived.intersection(e.symbols):
                derived.add(name)
        ties = {name for name in uncertain if not self._varies(name)}
        equations = []
        for name, e in self.dynamics.items():
            own = bool(self._parameters.intersection(e.symbols))
            through = {n for n in {*e.symbols}.intersection(derived - ties) if not is_shared_term(n)}
            if own:  # a term of this equation alone is none of what others have, too
                through -= {n for n in through if sum(n in other.symbols for other in self.dynamics.values()) > 1}
            if (every_equation and (own or through)) or (own and not through):
                equations.append(name)
        self.places = [Place("quantity", name) for name in self.quantities if name in uncertain & known]
        self.places += [Place("equation", name) for name in equations if name in known]
        self.places += [Place("output", name) for name in self.outputs]
        self._defined = [n for n in self.quantities if n not in derived and self._varies(n)]
        self._exact = {
            n: e for n, e in self.dynamics.items() if not {*e.symbols}.intersection(self._parameters | derived)
        }
        rates = {name for name in model.state_names if self._is_rate(name)}
        units = model.variable_units
        self.variables = [
            Variable(
                name,
                name,
                "state",
                name in rates,
                # By its unit; where nothing is said of any, it might be.
                name in rates or self.moves(name) or not (rates or name in units),
            )
            for name in model.state_names
            if name in known
        ]
        self.variables += self._inputs()

    def declared_in(self, place: Place) -> list[Variable]:
        """Return the quantities that stand at a place and are defined exactly, without parameters: an angle of slip or
        a dynamic pressure, say, that forces are functions of."""
        symbols = {*self.expression(place).symbols}
        # The difference of two speeds is one: that of a damper or of a bearing.
        speeds = {v.symbol for v in self.variables if v.speed}
        return [
            Variable(n, n, "quantity", speed=speeds.issuperset(self.quantities[n].symbols))
            for n in self._defined
            if n in symbols
        ]

    def declared_beside(self, place: Place) -> list[Variable]:
        """Return the other quantities that are defined exactly from states and inputs: an angle of attack that a
        coefficient of drag does not have yet."""
        symbols = {*self.expression(place).symbols, place.name}
        of = {*self.model.state_names, *self.model.declared_inputs}
        exact = [n for n in self._defined if n not in symbols and of.issuperset(self.quantities[n].symbols)]
        return [Variable(n, n, "quantity") for n in exact] if len(exact) <= _BESIDE else []

    @property
    def exact_in_forces(self) -> list[Variable]:
        """The quantities that are defined exactly and stand in the forces alone, and in no output."""
        forces = [place for place in self.places if place.kind != "output"]
        found = {v.symbol: v for place in forces for v in self.declared_in(place)}
        return [v for n, v in found.items() if not any(n in e.symbols for e in self.outputs.values())]

    def rate_of(self, variable: Variable) -> str:
        """Return the name of the exact quantity that is the rate of another one, as the difference of two speeds is of
        that of the positions; "" for none."""
        e = Expr(self.quantities[variable.symbol].substitute(self.quantities))
        if any(n not in self._exact for n in e.symbols):
            return ""
        rate = Expr(0.0)
        for n in e.symbols:
            rate = Expr(rate + Expr(e.diff(n)) * self._exact[n])
        random = np.random.default_rng(0)
        for other in self.exact_in_forces:
            known = Expr(self.quantities[other.symbol].substitute(self.quantities))
            names = {*known.symbols, *rate.symbols}
            tried = [{n: random.uniform(-_RANGE, _RANGE) for n in names} for _ in range(_TRIED)]
            if all(abs(known.evaluate(at) - rate.evaluate(at)) < _EQUAL for at in tried):
                return other.symbol
        return ""

    def is_product(self, place: Place) -> bool:
        """Return whether a quantity is a product with a parameter, such as a rate of reaction or a flow of heat, and no
        sum of terms that each have their own."""
        if place.kind != "quantity":
            return False
        terms = addends(self.expression(place))
        return len(terms) == 1 and bool(self._parameters.intersection(terms[0].symbols))

    def is_store(self, variable: Variable) -> bool:
        """Return whether a variable may be what a store holds, as a level or a pressure: a state that is no angle, no
        rate and no position, which is a speed's integral."""
        unit = self.model.variable_units.get(variable.symbol, "")
        moves = variable.rate or self.moves(variable.symbol) or variable.symbol in self._exact
        return variable.kind == "state" and not moves and unit not in ANGLES

    def moves(self, name: str) -> bool:
        """Return whether the unit of a variable is one per unit of the model's time."""
        return self.model.time_unit.is_rate(self.model.variable_units.get(name, ""))

    @cached_property
    def coordinates(self) -> list[tuple[Variable, Variable]]:
        """The positions, each with the state that it is the integral of, and of nothing else."""
        states = [v for v in self.variables if v.kind == "state"]
        return [(x, v) for x in states for v in states if self.dynamics[x.symbol] == Expr.symbol(v.symbol)]

    def is_position(self, variable: Variable) -> bool:
        """Return whether a variable is the integral of a speed that is a state, and nothing else."""
        return any(x.symbol == variable.symbol for x, _ in self.coordinates)

    def is_angle(self, variable: Variable) -> bool:
        """Return whether a variable is a state that is an angle, such as one of the flow, which turns a vane."""
        return variable.kind == "state" and self.model.variable_units.get(variable.symbol, "") in ANGLES

    @property
    def acting(self) -> list[str]:
        """Names of the free parameters that act on states, alone or through quantities, or multiply what varies in an
        output, as a resistance does: a record of its own may have others of them."""
        by_name = {**self.quantities}
        inside: dict[str, set[str]] = {}
        for name, e in by_name.items():
            inside[name] = {*e.symbols}.union(*(inside[s] for s in e.symbols if s in inside))
        seen = {s for e in self.dynamics.values() for s in e.symbols}
        seen = seen.union(*(inside[s] for s in seen if s in inside))
        seen = seen.union(*({n for n in self._parameters if self._multiplies(n, e)} for e in self.outputs.values()))
        declared = self.model.declared_parameters
        return [
            n for n in self.model.parameter_names if n in seen and not (declared[n].fixed or declared[n].per_experiment)
        ]

    @property
    def direct_forces(self) -> list[tuple[Place, Variable]]:
        """The state equations whose forces stand in quantities times what varies, as a moment is a coefficient times
        the dynamic pressure, each with the inputs that act in other equations without them: a thrust, of which the
        line of action may be off the centre of gravity."""
        places = {p.name for p in self.places if p.kind == "quantity"}
        direct = {s for e in self.dynamics.values() for s in e.symbols}
        inputs = [v for v in self.variables if v.kind == "input" and v.symbol in direct]
        found = []
        for name, e in self.dynamics.items():
            through = places.intersection(e.symbols)
            if through and all(Expr(e.diff(q)).constant is None for q in through):
                found += [(Place("equation", name), v) for v in inputs if v.symbol not in e.symbols]
        return found

    @property
    def rates_of_stores(self) -> list[tuple[str, Variable]]:
        """The free parameters of the state equations, each with a store that all it multiplies vanishes without: the
        rate of a reaction, of an elimination or of growth with what there is of a substance."""
        stores = [v for v in self.variables if self.is_store(v)]
        return self._factors(stores, _vanishes_at_zero)

    @property
    def factors_of_parameters(self) -> list[tuple[str, Variable]]:
        """The free parameters, each with an input to which all that it multiplies is in proportion, and that is no
        angle. Of states there are powers and roots."""
        inputs = [v for v in self.variables if v.kind == "input"]
        amounts = [v for v in inputs if self.model.variable_units.get(v.symbol, "") not in ANGLES]
        return self._factors(amounts, lambda e, name: _vanishes_at_zero(e, name) and _is_linear(e, name))

    def _factors(
        self, among: Sequence[Variable], is_proportional: Callable[[Expr, str], bool]
    ) -> list[tuple[str, Variable]]:
        """Return the free parameters, each with a variable to which all that it multiplies is in proportion."""
        groups = [*self.quantities.values(), *self.dynamics.values()]
        found = []
        for name in self.acting:
            slopes = [Expr(e.diff(name)) for e in groups if name in e.symbols]
            found += [(name, v) for v in among if slopes and all(is_proportional(s, v.symbol) for s in slopes)]
        return found

    def force_on(self, speed: str) -> Place | None:
        """Return the place at which a force on a state acts: its equation, or a quantity that it increases with, as
        with a force over a mass, or with a torque on the same joint where several are coupled by a mass matrix, whose
        inverse is positive definite; None where no parameters stand there."""
        if Place("equation", speed) in self.places:
            return Place("equation", speed)
        quantities = (place for place in self.places if place.kind == "quantity")
        return next((place for place in quantities if self.direction(place, speed) > 0), None)

    def direction(self, place: Place, speed: str) -> int:
        """Return the sign of what a place adds to the rate of a speed, 1 or -1; 0 where that is not known. A quantity
        may be a force or, subtracted, a resistance."""
        if place == Place("equation", speed):
            return 1
        e = self.dynamics.get(speed)
        if place.kind != "quantity" or e is None or place.name not in e.symbols:
            return 0
        slope = Expr(e.diff(place.name))
        return 1 if self._increases(slope) else -1 if self._increases(Expr(-slope)) else 0

    def _increases(self, slope: Expr) -> bool:
        """Return whether a slope is positive, at random states and inputs if it is not constant."""
        if (constant := slope.constant) is not None:
            return bool(constant > 0.0)
        e = Expr(slope.substitute(self.quantities))
        random, declared = np.random.default_rng(0), self.model.declared_parameters
        start = {n: declared[n].start or 1.0 for n in e.symbols if n in declared}
        others = [n for n in e.symbols if n not in start]
        tried = [start | {n: random.uniform(-_RANGE, _RANGE) for n in others} for _ in range(_TRIED)]
        return all(e.evaluate(at) > 0.0 for at in tried)

    def is_modelled(self, name: str) -> bool:
        """Return whether a state equation, or a quantity in it, has parameters; that of a position, which is exact, has
        none."""
        return name not in self._exact

    def fed_by(self, name: str) -> list[str]:
        """Return the states that an equation of their own with parameters gives, and on which the state acts at once,
        as the flow out of a store does on the next one."""
        others = {x: e for x, e in self.dynamics.items() if self.is_modelled(x) and x != name}
        full = {x: Expr(e.substitute(self.quantities)) for x, e in others.items()}
        return [x for x, e in full.items() if name in e.symbols]

    def turns_freely(self, name: str) -> bool:
        """Return whether a state is an angle of which sines or cosines are taken, such as an attitude."""
        groups = (self.quantities, self.dynamics, self.outputs)
        return any(_is_within(e, name, _SINES) for group in groups for e in group.values() if name in e.symbols)

    def interact(self, place: Place, one: Variable, other: Variable) -> bool:
        """Return whether the effect of a variable at a place depends on another one, as in a reaction of two
        substances."""
        e = self.expression(place)
        if not {one.symbol, other.symbol} <= {*e.symbols}:
            return False
        mixed = Expr(Expr(e.diff(one.symbol)).diff(other.symbol)).constant
        return mixed is None or mixed != 0.0

    def may_depend_on_position(self, place: Place, position: Variable, other: Variable) -> bool:
        """Return whether the gain of a state at a place may change with a position, as the force of a current does with
        that of its coil in the magnet."""
        moves = self.is_position(position) and not self.turns_freely(position.symbol)
        return moves and self.is_weighed(place, other)

    def is_weighed(self, place: Place, variable: Variable) -> bool:
        """Return whether what a variable does at a place depends on a parameter that is estimated."""
        e = self.expression(place)
        slope = Expr(e.diff(variable.symbol)) if variable.symbol in e.symbols else Expr(0.0)
        return bool(self._parameters & {*slope.symbols})

    def has_friction(self, place: Place, name: str) -> bool:
        """Return whether a jump with the sign of a rate stands at a place already, sharp or rounded."""
        return _is_within(self.expression(place).simplify(), name, _JUMPS)

    def _multiplies(self, parameter: str, e: Expr) -> bool:
        """Return whether a parameter multiplies something that varies in an output."""
        slope = Expr(e.diff(parameter)) if parameter in e.symbols else Expr(0.0)
        return any(n in slope.symbols for n in (*self.model.state_names, *self.model.declared_inputs))

    def _varies(self, quantity: str) -> bool:
        names = {*self.model.state_names, *self.model.declared_inputs, "time"}
        symbols = {*self.quantities[quantity].symbols}
        return bool(symbols & names) or any(self._varies(n) for n in symbols.intersection(self.quantities))

    def _is_rate(self, name: str) -> bool:
        """Return whether a state is an angular rate by its unit, or another state's derivative by exact kinematics."""
        if self.model.variable_units.get(name, "") in self.model.time_unit.angular_rates:
            return True
        slopes = [Expr(e.diff(name)).constant for state, e in self._exact.items() if state != name]
        return any(slope for slope in slopes)

    def _inputs(self) -> list[Variable]:
        """Return inputs as they stand in the equations: a late one for the plain one where only that is used."""
        late = {name: of for name, (of, _) in self.model.delays.inputs.items()}
        found = []
        for name in self.model.declared_inputs:
            if name in late:
                shown = name if self.used(late[name]) else late[name]
                found.append(Variable(name, shown, "input"))
            elif self.used(name) or name not in late.values():
                found.append(Variable(name, name, "input"))
        return found

    def used(self, symbol: str) -> bool:
        """Return whether a symbol stands in any equation."""
        groups = (self.quantities, self.dynamics, self.outputs)
        return any(symbol in e.symbols for group in groups for e in group.values())

    def expression(self, place: Place) -> Expr:
        """Return what stands at a place."""
        groups = {"quantity": self.quantities, "equation": self.dynamics, "output": self.outputs}
        return groups[place.kind][place.name]

    def shown(self, place: Place) -> str:
        """First part of a candidate's name."""
        if place.kind == "equation":
            return f"{place.name}'"
        inputs = self.model.declared_inputs
        clash = place.kind == "output" and (place.name in self.quantities or place.name in inputs)
        return f"y:{place.name}" if clash else place.name


def addends(e: Expr) -> list[Expr]:
    """Return the terms of a sum or difference, whatever their signs; an expression that is none is its only one."""
    operation, arguments = e.operation
    if operation not in ("add", "sub", "neg"):
        return [e]
    return [term for a in arguments for term in addends(a)]


def motion_part(e: Expr, states: Collection[str]) -> Expr:
    """Return the terms of a sum or difference that hold no symbols but states and the time: the part of a state
    equation that is kinematics or gravity, and no force that a parameter or an input has a part in."""
    operation, arguments = e.operation
    if operation in ("add", "sub", "neg"):
        parts = [motion_part(a, states) for a in arguments]
        if operation == "neg":
            return Expr(-parts[0])
        return Expr(parts[0] + parts[1] if operation == "add" else parts[0] - parts[1])
    return e if {*states, "time"}.issuperset(e.symbols) else Expr(0.0)


def _is_linear(e: Expr, name: str) -> bool:
    """Return whether an expression is linear in a variable."""
    return name not in Expr(e.diff(name)).simplify().symbols


def _vanishes_at_zero(e: Expr, name: str) -> bool:
    """Return whether an expression is zero where a variable is, whatever the others."""
    return name in e.symbols and Expr(e.substitute({name: Expr(0.0)})).simplify().constant == 0.0


def _is_within(e: Expr, name: str, functions: Collection[str]) -> bool:
    """Return whether a symbol stands within one of some functions."""
    function, arguments = e.operation
    inside = [a for a in arguments if name in a.symbols]
    return bool(inside) and (function in functions or any(_is_within(a, name, functions) for a in inside))
