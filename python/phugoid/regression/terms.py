"""Candidate terms of a regression: monomials of measured variables, added to a model with a parameter each."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations_with_replacement
from typing import Any

from .._core import Expr
from ..checks import is_whole
from ..errors import ModelError, OptionError, listing
from ..modelling.model import Model

__all__ = ["monomials", "with_candidates", "without"]


def monomials(*variables: Expr, degree: int = 2, orders: Sequence[int] | None = None) -> list[Expr]:
    """Return all products of powers of the variables up to a total ``degree``, the lowest first, without the constant.

    ``orders``: the greatest power of each variable; None: ``degree``. They are the candidates of
    ``equation_error(..., terms=...)``, as in E. A. Morelli, J. Aircraft 32(2), 1995.

    Raises OptionError for a degree or orders that are no whole numbers, or no symbols.

    >>> import phugoid as ph
    >>> a, q = ph.Model("Cm").inputs(alpha="rad", q="rad/s")
    >>> [str(term) for term in ph.monomials(a, q, degree=2)]
    ['alpha', 'q', 'alpha**2', 'alpha*q', 'q**2']
    """
    if not variables or not all(isinstance(v, Expr) for v in variables):
        raise OptionError("monomials: the variables are expressions of a model, as in monomials(alpha, q, degree=3)")
    if not is_whole(degree) or degree < 1:
        raise OptionError(f"monomials: degree is a whole number from 1, not {degree!r}")
    most = [degree] * len(variables) if orders is None else list(orders)
    if len(most) != len(variables) or not all(is_whole(k) and k >= 0 for k in most):
        raise OptionError(f"monomials: orders holds a whole number from 0 for each of the {len(variables)} variables")
    found = []
    for total in range(1, degree + 1):
        for powers in combinations_with_replacement(range(len(variables)), total):
            counts = [powers.count(k) for k in range(len(variables))]
            if all(count <= limit for count, limit in zip(counts, most, strict=True)):
                factors = [v**c if c > 1 else v for v, c in zip(variables, counts, strict=True) if c]
                product = factors[0]
                for factor in factors[1:]:
                    product = product * factor
                found.append(product)
    return found


def with_candidates(model: Model, terms: Mapping[str, Any]) -> tuple[Model, list[str]]:
    """Return the model with terms added to its equations, each with a parameter of its own, and their names.

    ``terms``: what they are added to (a quantity or an output, ``"Cm"``; a state equation, ``"q'"``) -> expressions in
    a list, whose parameters are called ``Cm_alpha2``, ``Cm_alpha_q``, ..., or by the names that they are to have.
    Raises ModelError for an unknown equation or name, OptionError for no expressions.
    """
    if not isinstance(terms, Mapping):
        raise OptionError(f"equation_error: terms holds expressions by equation, as in {{'Cm': [a**2]}}, not {terms!r}")
    keys = {**{f"y:{n}": n for n in model.output_names}, **{n: n for n in model.quantity_names}}
    keys |= {f"{n}'": f"{n}_dot" for n in model.state_names}
    taken = set(model.parameter_names)
    added: list[str] = []
    sums: dict[str, Any] = {}
    for place, given in terms.items():
        key = place if place in keys else f"y:{place}"
        if key not in keys:
            raise ModelError(f"equation_error: terms: '{place}' is no equation.{listing(str(place), list(keys))}")
        named = given if isinstance(given, Mapping) else None
        if named is None and not isinstance(given, (list, tuple)):
            raise OptionError(f"equation_error: terms of '{place}' are a list of expressions, not {given!r}")
        expressions = list(named.values()) if named is not None else list(given)
        for i, e in enumerate(expressions):
            if not isinstance(e, Expr):
                raise OptionError(f"equation_error: terms of '{place}': {e!r} is no expression of the model's symbols")
            name = list(named)[i] if named is not None else _called(keys[key], str(e))
            if name in taken:
                raise ModelError(f"equation_error: terms of '{place}': there is a parameter '{name}' already")
            taken.add(name)
            added.append(name)
            sums[key] = sums.get(key, 0.0) + Expr.symbol(name) * e
    return model.with_terms(sums, dict.fromkeys(added, 0.0)), added


def without(model: Model, names: Sequence[str]) -> Model:
    """Return the model with parameters fixed at 0, whatever their declared bounds."""
    unbounded = (-math.inf, math.inf)
    declared = model.declared_parameters
    return model.with_parameters(
        {n: replace(declared[n], start=0.0, bounds=unbounded, prior=None, transform=None, fixed=True) for n in names}
    )


def _called(stem: str, term: str) -> str:
    """Return the name of the parameter of a term.

    >>> _called("Cm", "alpha**2*q")
    'Cm_alpha2_q'
    """
    text = re.sub(r"\W+", "_", term.replace("**", "")).strip("_")
    return f"{stem}_{text}"
