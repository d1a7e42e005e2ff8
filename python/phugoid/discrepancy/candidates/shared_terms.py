"""Terms that several equations share, such as the force of a spring between two masses or the side force of a tyre,
declared as quantities, so that a candidate acts on all of them at once."""

from __future__ import annotations

from collections.abc import Collection, Set
from dataclasses import dataclass
from functools import reduce

from ..._core import Expr
from ...modelling.model import Model
from .candidate import taken_names, unused

__all__ = ["is_shared_term", "with_shared_terms"]

# How the name of a term ends that is declared here, after that of its parameter; and that of a difference or a sum,
# which the parameter multiplies.
_TERM, _ARGUMENT = "_term", "_argument"
# Quantities that are declared, at most: each is a place and a variable for candidates.
_MOST = 8


def is_shared_term(name: str) -> bool:
    """Return whether a quantity may be one that was declared here: equations with parameters besides stay places."""
    return name.endswith(_TERM)


def with_shared_terms(model: Model) -> Model:
    """Return the model with quantities for what its equations share; the same model where they share nothing.

    A term p X, with a parameter p and a factor X of states and inputs, is declared where two or more state equations
    contain it, each times a factor of its own without states and inputs; and X where it is a difference or a sum of
    several, the twist of a shaft or an angle of slip, in however many equations.
    """
    right = model._right_hand_sides()
    equations = {key: e for key, e in right.items() if key[0] in ("equation", "output")}
    # What conditions at the ends of a record hold stays where it is.
    declared = {s for (kind, _), e in right.items() if kind not in ("equation", "output") for s in e.symbols}
    parameters, taken = {*model.parameter_names}, {*taken_names(model), *model.output_names}
    quantities: dict[str, Expr] = {}
    for p in model.parameter_names:
        if p in declared or len(quantities) + 2 > _MOST:
            continue
        splits = {key: _split(e, p, parameters) for key, e in equations.items() if p in e.symbols}
        found = [s for s in splits.values() if s is not None]
        if len(found) < len(splits) or not found or any(s.factors != found[0].factors for s in found):
            continue
        x = _product(found[0].factors)
        exact = len(found[0].factors) == 1 and _is_sum(x) and not parameters.intersection(x.symbols)
        shared = sum(kind == "equation" for kind, _ in splits) > 1
        if not found[0].factors or not (exact or shared):
            continue
        if exact:
            x = _declared(quantities, x, unused(_name_of(x, p), taken))
        term = Expr.symbol(p) * x
        if shared:
            term = _declared(quantities, Expr(term), unused(f"{p}{_TERM}", taken))
        for key, s in splits.items():
            assert s is not None
            equations[key] = Expr(s.rest + s.multiple * term).simplify()
    return model._changed(equations=equations, quantities=quantities) if quantities else model


def _declared(quantities: dict[str, Expr], e: Expr, name: str) -> Expr:
    """Return the symbol of a quantity, by that name unless it is there already."""
    there = next((n for n, other in quantities.items() if other == e), None)
    if there is None:
        quantities[name] = e
    return Expr.symbol(there or name)


def _name_of(e: Expr, parameter: str) -> str:
    """Return a name for a sum: that of a difference of two symbols says what it is."""
    operation, arguments = e.operation
    if operation == "sub" and all(a.operation[0] == "symbol" for a in arguments):
        return "_minus_".join(str(a) for a in arguments)
    return f"{parameter}{_ARGUMENT}"


@dataclass(frozen=True)
class _Split:
    """An expression as ``rest + multiple * p * product(factors)``; no state and no input is in the multiple."""

    rest: Expr
    multiple: Expr
    factors: tuple[Expr, ...]


def _split(e: Expr, p: str, parameters: Set[str]) -> _Split | None:
    """Return an expression divided at a parameter; None where that is not in one product alone."""
    operation, arguments = e.operation
    if operation == "symbol":
        return _Split(Expr(0.0), Expr(1.0), ())
    within = [i for i, a in enumerate(arguments) if p in a.symbols]
    if len(within) != 1:
        return None
    (i,) = within
    inner = _split(arguments[i], p, parameters) if operation in ("add", "sub", "neg", "mul", "div") else None
    if inner is None or (operation == "div" and i == 1):
        return None
    others = [a for k, a in enumerate(arguments) if k != i]
    if operation == "neg":
        return _Split(-inner.rest, -inner.multiple, inner.factors)
    (other,) = others
    if operation == "add":
        return _Split(inner.rest + other, inner.multiple, inner.factors)
    if operation == "sub":
        sign = -1.0 if i else 1.0
        return _Split(sign * (inner.rest - other), sign * inner.multiple, inner.factors)
    varies = not parameters >= {*other.symbols}
    if operation == "div":
        if varies:
            return _Split(inner.rest / other, inner.multiple, (*inner.factors, 1.0 / other))
        return _Split(inner.rest / other, inner.multiple / other, inner.factors)
    if varies:
        return _Split(inner.rest * other, inner.multiple, (*inner.factors, other))
    return _Split(inner.rest * other, inner.multiple * other, inner.factors)


def _product(factors: Collection[Expr]) -> Expr:
    """Return the product."""
    return reduce(lambda product, f: Expr(product * f), factors) if factors else Expr(1.0)


def _is_sum(e: Expr) -> bool:
    """Return whether an expression is a sum or a difference of several states and inputs, or a multiple of one."""
    operation, arguments = e.operation
    if operation in ("neg", "mul", "div"):
        inner = [a for a in arguments if a.symbols]
        return len(inner) == 1 and _is_sum(inner[0])
    return operation in ("add", "sub") and len({*e.symbols}) > 1
