"""Formulas of SBML and PEtab as expressions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

from .._core import Expr
from ..errors import MissingDependency, ModelError
from ..functions import from_sympy

__all__ = ["TIME", "Formulas", "Switch", "petab_library", "substituted"]

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

    kind  "positive" where it is ``difference`` > 0, "equal" and "unequal" where it compares ``difference`` with 0.
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
