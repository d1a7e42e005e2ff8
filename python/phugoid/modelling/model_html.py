"""The HTML of a model in a notebook: its equations, and a table of its symbols."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .._core import Expr
from ..mathml import equation
from ..notebook import overview
from ..parameters import Parameter

__all__ = ["model_html"]

_CUT = 300  # characters of an equation


def model_html(
    name: str,
    note: str,
    equations: Sequence[tuple[str, str, Expr]],
    symbols: Mapping[str, Sequence[str]],
    units: Mapping[str, str],
    parameters: Mapping[str, Parameter],
) -> str:
    """Return the HTML of a model from its equations (kind, left side, right side) and its symbols by kind."""
    lines = [[kind, equation(left, right, rate=kind == "state", cut=_CUT)] for kind, left, right in equations]
    rows = [[symbol, kind, units.get(symbol, ""), "", ""] for kind, names in symbols.items() for symbol in names]
    for symbol, p in parameters.items():
        limited = any(abs(bound) != float("inf") for bound in p.bounds)
        remark = "fixed" if p.fixed else f"{p.bounds[0]:g} to {p.bounds[1]:g}" if limited else ""
        rows.append([symbol, "parameter", p.unit, f"{p.start:.6g}", remark])
    heads = ["symbol", "", "unit", "start", "bounds"]
    return overview(name, (["", "equation"], lines, "ll"), (heads, rows, "lllrl"), note=note)
