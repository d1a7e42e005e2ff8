"""The ODE of an SBML model (Hucka et al. 2003), and its formulas as expressions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

from .._core import Expr
from ..errors import MissingDependency, ModelError
from ..functions import from_sympy

__all__ = ["TIME", "Formulas", "SbmlModel", "Switch", "petab_library", "substituted"]

TIME = "time"


def petab_library() -> tuple[ModuleType, ModuleType]:
    """Return the modules ``petab.v1`` and ``libsbml``; raises MissingDependency where they are not installed."""
    try:
        import libsbml
        import petab.v1
        import petab.v1.math
    except ImportError as error:
        raise MissingDependency(
            f"PEtab problems need the packages petab and python-libsbml ({error}): pip install phugoid[petab]"
        ) from error
    return petab.v1, libsbml


@dataclass(frozen=True)
class Switch:
    """A condition on time and on numbers known before the estimation.

    kind  "positive" where it is ``difference`` > 0, "equal" and "unequal" where it compares ``difference`` with 0, and
          "event" where it is positive and a state jumps when it becomes so, also at time 0 after a steady state.
    """

    name: str
    difference: Expr
    kind: str = "positive"


@dataclass
class Formulas:
    """Reads formulas, and replaces conditions on time by switches: input signals that are 0 or 1.

    constants  names on which the time of a switch may depend.
    switches   those found so far, by the text of their condition.
    """

    constants: set[str] = field(default_factory=set)
    switches: dict[str, Switch] = field(default_factory=dict)

    def read(self, text: str, place: str) -> Expr:
        """Read a formula in the syntax of PEtab; raises ModelError that names the ``place`` where it cannot be read."""
        library, _ = petab_library()
        try:
            expression = library.math.sympify_petab(text)
        except Exception as error:  # of the parser, of its many kinds
            raise ModelError(f"{place}: the formula {text!r} cannot be read ({error})") from error
        return self._expression(expression, place)

    def from_sbml(self, node: Any, place: str) -> Expr:
        """Read the mathematics of an SBML element, whose functions have been expanded."""
        _, libsbml = petab_library()
        if node is None:
            raise ModelError(f"{place}: there is no formula")
        if name := unsupported(node, libsbml):
            raise ModelError(f"{place}: {name} is not supported")
        return self.read(libsbml.formulaToL3String(node), place)

    def _expression(self, expression: Any, place: str) -> Expr:
        def switched(relation: Any) -> Any:
            return _symbol(self._switch(relation, place))

        def on_time(e: Any) -> bool:
            if not getattr(e, "is_Relational", False):
                return False
            names = {s.name for s in e.free_symbols}
            known = names - {TIME} <= self.constants
            return known and (TIME in names or type(e).__name__ in _KINDS)

        try:
            return Expr(from_sympy(expression.replace(on_time, switched)))
        except ModelError as error:
            raise ModelError(f"{place}: {error}") from None

    def _switch(self, relation: Any, place: str) -> str:
        kind = _KINDS.get(type(relation).__name__, "positive")
        names = {s.name for s in relation.free_symbols}
        if kind != "positive" and TIME in names:
            raise ModelError(f"{place}: a condition that holds at one time only ({relation}) is not supported")
        left, right = (relation.gts, relation.lts) if kind == "positive" else (relation.lhs, relation.rhs)
        text = f"{left - right} {kind}"
        if text not in self.switches:
            self.switches[text] = Switch(f"switch_{len(self.switches) + 1}", Expr(from_sympy(left - right)), kind)
        return self.switches[text].name

    def event(self, trigger: Switch) -> Switch:
        """Return the switch of an event that makes states jump when a trigger becomes true."""
        name = f"event_of_{trigger.name}"
        return self.switches.setdefault(name, Switch(name, trigger.difference, "event"))


# Comparisons that are no question of time.
_KINDS = {"Equality": "equal", "Unequality": "unequal"}


def _symbol(name: str) -> Any:
    import sympy

    return sympy.Symbol(name)


def unsupported(node: Any, libsbml: ModuleType) -> str | None:
    """Return the first function in the mathematics of an SBML element that has no counterpart."""
    names = {
        libsbml.AST_FUNCTION_DELAY: "a delay",
        libsbml.AST_FUNCTION_FACTORIAL: "a factorial",
        libsbml.AST_FUNCTION_FLOOR: "floor",
        libsbml.AST_FUNCTION_CEILING: "ceiling",
        libsbml.AST_FUNCTION_RATE_OF: "rateOf",
        libsbml.AST_FUNCTION: f"the function {node.getName()}",
    }
    if node.getType() in names:
        return names[node.getType()]
    found = (unsupported(node.getChild(i), libsbml) for i in range(node.getNumChildren()))
    return next(filter(None, found), None)


def substituted(expression: Expr, values: Mapping[str, Any]) -> Expr:
    """Return the expression with values put in for those of its symbols that have one."""
    known = {name: values[name] for name in expression.symbols if name in values}
    return Expr(expression.substitute(known)) if known else expression


@dataclass
class SbmlModel:
    """What an SBML model says.

    slopes      right-hand sides by state: species in the unit of their symbol (a concentration, unless
                ``hasOnlySubstanceUnits``), and parameters with a rate rule.
    initial     values at the beginning, by state and for constants: expressions in other names, or numbers.
    rules       what assignment rules say, in an order in which each needs those before it only.
    constants   names of what does not change while a record lasts, unless an event at a given time changes it.
    jumping     states that events set: each has a rule in others, which are continuous.
    """

    name: str
    slopes: dict[str, Expr] = field(default_factory=dict)
    initial: dict[str, Expr] = field(default_factory=dict)
    rules: dict[str, Expr] = field(default_factory=dict)
    constants: set[str] = field(default_factory=set)
    jumping: set[str] = field(default_factory=set)
    time_unit: str = "s"

    @classmethod
    def read(cls, document: Any, formulas: Formulas, overridden: Iterable[str]) -> SbmlModel:
        """Read a document of libsbml.

        ``overridden``: names whose values the tables of the PEtab problem give, before the model's own.
        Raises ModelError that names all that is not supported.
        """
        _, libsbml = petab_library()
        document = document.clone()
        for option in ("expandFunctionDefinitions", "promoteLocalParameters"):
            properties = libsbml.ConversionProperties()
            properties.addOption(option, True)
            if document.convert(properties) != libsbml.LIBSBML_OPERATION_SUCCESS:
                raise ModelError(f"SBML: {option} failed: {document.getErrorLog().toString().strip() or 'no reason'}")
        model = document.getModel()
        if model is None:
            raise ModelError("SBML: the document holds no model")
        found = cls(model.getId() or "sbml")
        if problems := list(_unsupported(model)):
            raise ModelError("SBML: not supported: " + "; ".join(problems))
        found._constants_of(model)
        formulas.constants |= found.constants
        found._rules_of(model, formulas)
        found._slopes_of(model, formulas)
        found._initial_of(model, formulas, set(overridden))
        found._events_of(model, formulas)
        found._sort_rules()
        found.time_unit = _time_unit(model)
        return found

    def _constants_of(self, model: Any) -> None:
        ruled = {rule.getVariable() for rule in model.getListOfRules()}
        for element in (*model.getListOfParameters(), *model.getListOfCompartments()):
            if element.getId() not in ruled:
                self.constants.add(element.getId())
        moved = set(_stoichiometry(model))
        for species in model.getListOfSpecies():
            if species.getId() not in moved | ruled:
                self.constants.add(species.getId())

    def _rules_of(self, model: Any, formulas: Formulas) -> None:
        self.rules = {
            rule.getVariable(): formulas.from_sbml(rule.getMath(), f"SBML rule of {rule.getVariable()}")
            for rule in model.getListOfRules()
            if rule.isAssignment()
        }

    def _sort_rules(self) -> None:
        left, self.rules = self.rules, {}
        while left:
            ready = [n for n, e in left.items() if not left.keys() & set(e.symbols)]
            if not ready:
                raise ModelError(f"SBML: the assignment rules of {', '.join(sorted(left))} depend on each other")
            self.rules |= {n: left.pop(n) for n in ready}

    def _slopes_of(self, model: Any, formulas: Formulas) -> None:
        rates = {}
        for reaction in model.getListOfReactions():
            law, place = reaction.getKineticLaw(), f"SBML reaction {reaction.getId()}"
            if law is None:
                raise ModelError(f"{place}: it has no kinetic law")
            rates[reaction.getId()] = formulas.from_sbml(law.getMath(), place)
        for species, terms in _stoichiometry(model).items():
            total = Expr(0.0)
            for reaction, number in terms:
                total = Expr(total + number * rates[reaction])
            element = model.getSpecies(species)
            if not element.getHasOnlySubstanceUnits():
                total = Expr(total / Expr.symbol(element.getCompartment()))
            self.slopes[species] = total
        for rule in model.getListOfRules():
            if rule.isRate():
                name = rule.getVariable()
                self.slopes[name] = formulas.from_sbml(rule.getMath(), f"SBML rate rule of {name}")

    def _initial_of(self, model: Any, formulas: Formulas, overridden: set[str]) -> None:
        for parameter in model.getListOfParameters():
            if parameter.isSetValue():
                self.initial[parameter.getId()] = Expr(parameter.getValue())
        for compartment in model.getListOfCompartments():
            self.initial[compartment.getId()] = Expr(compartment.getSize() if compartment.isSetSize() else 1.0)
        for species in model.getListOfSpecies():
            volume = Expr.symbol(species.getCompartment())
            amounts = species.getHasOnlySubstanceUnits()
            if species.isSetInitialConcentration():
                value = Expr(species.getInitialConcentration())
                value = Expr(value * volume) if amounts else value
            elif species.isSetInitialAmount():
                value = Expr(species.getInitialAmount())
                value = value if amounts else Expr(value / volume)
            else:
                continue
            self.initial[species.getId()] = value
        for assignment in model.getListOfInitialAssignments():
            name = assignment.getSymbol()
            if name not in overridden:
                self.initial[name] = formulas.from_sbml(assignment.getMath(), f"SBML initial assignment of {name}")

    def _events_of(self, model: Any, formulas: Formulas) -> None:
        """Read events at given times: constants step from one value to another, states jump."""
        jumps: dict[str, list[_Jump]] = {}
        for event in model.getListOfEvents():
            place = f"SBML event {event.getId()}"
            trigger = formulas.from_sbml(event.getTrigger().getMath(), place)
            switches = {s.name: s for s in formulas.switches.values()}
            switch = switches.get(trigger.name or "")
            slope = None if switch is None else switch.difference.diff(TIME).constant
            if switch is None or slope is None or slope <= 0.0:
                raise ModelError(f"{place}: not supported: its trigger is not that a known time is reached")
            for assignment in event.getListOfEventAssignments():
                name = assignment.getVariable()
                value = formulas.from_sbml(assignment.getMath(), place)
                if name in self.slopes:
                    jump = _Jump.of(place, name, formulas.event(switch), value, self.constants)
                    jumps.setdefault(name, []).append(jump)
                    continue
                if name not in self.constants:
                    raise ModelError(f"{place}: not supported: it sets {name}, which is neither a constant nor a state")
                if TIME in value.symbols or set(value.symbols) - self.constants:
                    raise ModelError(f"{place}: not supported: the value of {name} depends on what changes in time")
                before = self.rules.pop(name, Expr.symbol(f"{name}_before"))
                self.initial.setdefault(f"{name}_before", self.initial.pop(name, Expr(0.0)))
                self.constants.add(f"{name}_before")
                self.rules[name] = Expr(trigger * substituted(value, {name: before}) + (1.0 - trigger) * before)
        for name, own in jumps.items():
            self._jump(name, _in_order(name, own))

    def set_after_rest(self, name: str, value: Expr, formulas: Formulas) -> None:
        """Set a state to a value at time 0, after a steady state.

        Raises ModelError where events set it, too.
        """
        if name in self.jumping:
            raise ModelError(f"PEtab: not supported: both events and conditions after a steady state set {name}")
        switch = formulas.event(Switch("the_beginning", Expr.symbol(TIME)))
        self._jump(name, [_Jump(switch, Expr(0.0), value)])

    def _jump(self, name: str, jumps: list[_Jump]) -> None:
        """Write a state that jumps as a sum c1 x1 + c2 x2 + ... + b of states that do not, x1' = w1 x' and so on.

        A jump to a x + b with a other than 0 is a change of scale and origin; one to b alone ends the motion of the
        states so far, and another one begins.
        """
        one, slope = Expr(1.0), self.slopes.pop(name)
        parts, origin = [(one, one)], Expr(0.0)
        for jump in jumps:
            on = Expr.symbol(jump.switch.name)
            off = Expr(1.0 - on)
            if jump.factor.constant == 0.0:
                parts = [(Expr(c * off), Expr(w * off)) for c, w in parts] + [(on, on)]
                origin = Expr(origin * off + jump.offset * on)
                continue
            scale = Expr(1.0 + (jump.factor - 1.0) * on)
            parts = [(Expr(c * scale), Expr(w / scale)) for c, w in parts]
            origin = Expr(origin * scale + jump.offset * on)
        total = origin
        for k, (factor, weight) in enumerate(parts, 1):
            state = f"{name}_continuous_{k}"
            self.slopes[state] = Expr(weight * slope)
            self.initial[state] = Expr.symbol(name) if k == 1 else Expr(0.0)
            total = Expr(total + factor * Expr.symbol(state))
        self.rules[name] = total
        self.jumping.add(name)


@dataclass(frozen=True)
class _Jump:
    """An event that sets a state x to factor x + offset."""

    switch: Switch
    factor: Expr
    offset: Expr

    @classmethod
    def of(cls, place: str, name: str, switch: Switch, value: Expr, constants: set[str]) -> _Jump:
        factor = Expr(value.diff(name))
        offset = substituted(value, {name: Expr(0.0)})
        if others := (set(factor.symbols) | set(offset.symbols)) - constants:
            raise ModelError(
                f"{place}: not supported: the value of {name} depends on {', '.join(sorted(others))}, other than "
                f"linearly in {name} itself"
            )
        return cls(switch, factor, offset)


def _in_order(name: str, jumps: list[_Jump]) -> list[_Jump]:
    """Sort jumps by their times; the order does not matter where each one adds a constant."""
    if len(jumps) == 1 or all(j.factor.constant == 1.0 for j in jumps):
        return jumps
    if any(set(j.switch.difference.symbols) != {TIME} for j in jumps):
        raise ModelError(f"SBML: not supported: several events that set {name}, at times that are not numbers")

    def time(jump: _Jump) -> float:
        at = [float(jump.switch.difference.evaluate({TIME: t})) for t in (0.0, 1.0)]
        return -at[0] / (at[1] - at[0])

    return sorted(jumps, key=time)


def _stoichiometry(model: Any) -> dict[str, list[tuple[str, float]]]:
    """Reactions and numbers by species that they change."""
    found: dict[str, list[tuple[str, float]]] = {}
    for reaction in model.getListOfReactions():
        for sign, references in ((-1.0, reaction.getListOfReactants()), (1.0, reaction.getListOfProducts())):
            for reference in references:
                species = model.getSpecies(reference.getSpecies())
                if not (species.getBoundaryCondition() or species.getConstant()):
                    number = reference.getStoichiometry() if reference.isSetStoichiometry() else 1.0
                    found.setdefault(species.getId(), []).append((reaction.getId(), sign * number))
    return found


# Seconds of the units of time that models of cells and of populations use.
_TIME_UNITS = {1.0: "s", 1e-3: "ms", 60.0: "min", 3600.0: "h", 86400.0: "day"}


def _time_unit(model: Any) -> str:
    """Return the unit of time of an SBML model: s where it gives none, and the name of its unit where that is not a
    usual one."""
    name = model.getTimeUnits() or "time"  # "time" is what level 2 redefines
    defined = model.getUnitDefinition(name)
    if defined is None or defined.getNumUnits() != 1:
        return "s" if name in ("time", "second", "dimensionless") else str(name)
    unit = defined.getUnit(0)
    seconds = unit.getMultiplier() * 10.0 ** unit.getScale()
    return next((text for size, text in _TIME_UNITS.items() if abs(seconds / size - 1.0) < 1e-9), str(name))


def _unsupported(model: Any) -> Iterator[str]:
    """Yield the elements of the model that this reader does not support, in words."""
    compartments = {c.getId() for c in model.getListOfCompartments()}
    for rule in model.getListOfRules():
        if rule.isAlgebraic():
            yield "an algebraic rule"
        elif rule.getVariable() in compartments:
            yield f"the compartment {rule.getVariable()}, whose size changes"
    for reaction in model.getListOfReactions():
        if reaction.isSetFast() and reaction.getFast():
            yield f"the fast reaction {reaction.getId()}"
        for reference in (*reaction.getListOfReactants(), *reaction.getListOfProducts()):
            if reference.isSetStoichiometryMath():
                yield f"the stoichiometry of {reference.getSpecies()} in {reaction.getId()}, which is a formula"
    for species in model.getListOfSpecies():
        if species.isSetConversionFactor():
            yield f"the conversion factor of {species.getId()}"
    for event in model.getListOfEvents():
        if event.isSetDelay():
            yield f"the delay of the event {event.getId()}"
    for constraint in model.getListOfConstraints():
        yield f"the constraint {constraint.getId() or constraint.getMetaId()}"
