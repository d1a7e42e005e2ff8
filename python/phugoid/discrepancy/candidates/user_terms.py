"""Terms of the user's own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..._core import Expr
from ...errors import ModelError, did_you_mean
from ...modelling.model import Model
from .candidate import Place

__all__ = ["read_terms"]

_JUMPS = {
    "sign": "smooth_sign(x, width)",
    "lt": "smooth_step(x, width)",
    "le": "smooth_step(x, width)",
    "not": "smooth_step(x, width)",
    "and": "a product of smooth_step(x, width)",
    "or": "smooth_step(x, width)",
}


def read_terms(model: Model, terms: Mapping[str, Any]) -> Iterator[tuple[Place, str, Expr]]:
    """Place, name (second part) and expression of each of ``terms``, as `candidates` takes them.

    Raises ModelError for a place that is not there, and for an expression with unknown symbols, parameters, or jumps.
    """
    if not isinstance(terms, Mapping):
        raise ModelError(f"terms: give expressions by place, as in {{'Cm': [alpha*q**2]}}, not {terms!r}")
    for key, value in terms.items():
        place, what = _place(model, str(key))
        several = isinstance(value, Sequence) and not isinstance(value, str)
        expressions = list(value) if several else [value]
        if what and len(expressions) > 1:
            raise ModelError(f"terms: '{key}' names one term, but {len(expressions)} are given")
        for given in expressions:
            e = _checked(model, place, str(key), given)
            yield place, what or str(e).replace("**", "^").replace(" ", ""), e


def _place(model: Model, key: str) -> tuple[Place, str]:
    """Place and, where there is one, the user's name for the term: "Cm", "q'", "y:alpha", "Cm:my name"."""
    quantities = [name for name, *_ in model._core.quantities]
    head, _, what = key.partition(":")
    if head in quantities:
        return Place("quantity", head), what
    if head.endswith("'") and head[:-1] in model.state_names:
        return Place("equation", head[:-1]), what
    if head == "y":
        head, _, what = what.partition(":")
    if head in model.output_names:
        return Place("output", head), what
    known = [*quantities, *(f"{name}'" for name in model.state_names), *(f"y:{name}" for name in model.output_names)]
    raise ModelError(
        f"terms: '{key}' names no quantity, state equation (with a prime) or output."
        f"{did_you_mean(head, known)} There are: {', '.join(known)}."
    )


def _checked(model: Model, place: Place, key: str, given: Any) -> Expr:
    try:
        e = Expr(given)
    except TypeError:
        raise ModelError(f"terms: '{key}' holds {given!r}, not an expression") from None
    quantities = [n for n, *_ in model._core.quantities]
    if place.kind == "quantity":  # it may hold only those above it
        later = quantities[quantities.index(place.name) :]
        for name in {*later}.intersection(e.symbols):
            raise ModelError(f"terms: {e} in '{key}' holds '{name}', which stands below {place.name} in the model")
    known = {*model.state_names, "time", *(n for n, _ in model._core.inputs), *quantities}
    for name in e.symbols:
        if name in model.parameter_names:
            raise ModelError(
                f"terms: {e} in '{key}' holds the parameter '{name}'; its coefficient is added, give the rest alone"
            )
        if name not in known:
            raise ModelError(f"terms: {e} in '{key}' holds the unknown '{name}'.{did_you_mean(name, known)}")
    if not {*e.symbols}:
        raise ModelError(f"terms: {e} in '{key}' is a number; a constant part is called 'bias' and is there by itself")
    jump = _jump(e)
    if jump:
        raise ModelError(
            f"terms: {e} in '{key}' jumps, so that no Newton step sees its slope: use {_JUMPS[jump]} in place of {jump}"
        )
    return e


def _jump(e: Expr) -> str | None:
    """The first operation in an expression that jumps; conditions of ``where`` are the user's own affair."""
    operation, args = e.operation
    if operation in _JUMPS:
        return operation
    if operation == "where":
        args = args[1:]
    return next((found for a in args if (found := _jump(a))), None)
