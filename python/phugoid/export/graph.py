"""Expressions as C statements: equal sub-expressions are computed once, what is used once is written in its place."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from .._core import Expr

__all__ = ["HELPERS", "Graph", "Table", "number"]

Table: TypeAlias = tuple[str, tuple[tuple[float, ...], ...], tuple[float, ...]]
"""Name, axes, values with the last axis running fastest."""
_Key: TypeAlias = tuple[Any, ...]

# Text is written in place of a value that is used once, as long as it is no longer.
_LONG = 100
_SUM, _PRODUCT, _ATOM = 1, 2, 3
_COMMUTATIVE = {"add", "mul"}

_INFIX = {"add": ("+", _SUM), "sub": ("-", _SUM), "mul": ("*", _PRODUCT), "div": ("/", _PRODUCT)}
_CALLS = {
    "abs": "fabs", "pow": "pow", "sqrt": "sqrt", "exp": "exp", "expm1": "expm1", "log": "log", "log1p": "log1p",
    "hypot": "hypot", "sin": "sin", "cos": "cos", "tan": "tan",
    "asin": "asin", "acos": "acos", "atan": "atan", "atan2": "atan2", "sinh": "sinh", "cosh": "cosh", "tanh": "tanh",
    "sign": "sign_of", "min": "lesser", "max": "greater", "powi": "whole_power",
}  # fmt: skip
_TESTS = {
    "lt": "({0} < {1} ? 1.0 : 0.0)",
    "le": "({0} <= {1} ? 1.0 : 0.0)",
    "and": "({0} != 0.0 && {1} != 0.0 ? 1.0 : 0.0)",
    "or": "({0} != 0.0 || {1} != 0.0 ? 1.0 : 0.0)",
    "not": "({0} == 0.0 ? 1.0 : 0.0)",
    "where": "({0} != 0.0 ? {1} : {2})",
}

HELPERS = {
    "sign_of": """/* -1, 0 or 1; NaN for NaN. */
static double sign_of(double a) {
    return a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a;
}""",
    "lesser": """/* The lesser of two; NaN where either is, as fmin has not. */
static double lesser(double a, double b) {
    return a != a || a < b ? a : b;
}""",
    "greater": """/* The greater of two; NaN where either is, as fmax has not. */
static double greater(double a, double b) {
    return a != a || a > b ? a : b;
}""",
    "whole_power": """/* A whole power, by repeated squaring. */
static double whole_power(double a, int n) {
    double power = 1.0;
    unsigned int left = n < 0 ? 0u - (unsigned int)n : (unsigned int)n;
    for (; left != 0u; left >>= 1) {
        if (left & 1u) power *= a;
        a *= a;
    }
    return n < 0 ? 1.0 / power : power;
}""",
}
"""Functions that C has not."""


@dataclass(frozen=True)
class _Text:
    text: str
    binds: int = _ATOM


class Graph:
    """Nodes of several expressions, equal ones stored once; arguments stand before what uses them."""

    def __init__(self) -> None:
        self._nodes: list[_Key] = []
        self._ids: dict[_Key, int] = {}
        self.tables: list[Table] = []
        self.used: set[str] = set()
        """Helpers, and tables as ``table <n>``, that statements written so far call."""

    def add(self, e: Expr) -> int:
        """Takes an expression in; returns its node."""
        saved: dict[str, Any] = json.loads(e.to_json())
        own: list[int] = []
        for node in saved["nodes"]:
            if "symbol" in node:
                key: _Key = ("symbol", node["symbol"])
            elif "value" in node:
                key = ("value", _value(node["value"]))
            elif "table" in node:
                table = saved["tables"][node["table"]]
                key = ("lookup", self._table(table), tuple(node["order"]), *(own[i] for i in node["args"]))
            else:
                key = self._operation(node["op"], [own[i] for i in node["args"]])
            own.append(self._id(key))
        root: int = saved["roots"][0]
        return own[root]

    def _id(self, key: _Key) -> int:
        # Written in the user's order, the same in either.
        same = (key[0], *sorted(key[1:])) if key[0] in _COMMUTATIVE else key
        if same not in self._ids:
            self._ids[same] = len(self._nodes)
            self._nodes.append(key)
        return self._ids[same]

    def _table(self, saved: Mapping[str, Any]) -> int:
        table = saved["name"], tuple(tuple(axis) for axis in saved["axes"]), tuple(saved["values"])
        if table not in self.tables:
            self.tables.append(table)
        return self.tables.index(table)

    def _operation(self, op: str, args: list[int]) -> _Key:
        if op == "pow" and self._nodes[args[1]][0] == "value":
            exponent = self._nodes[args[1]][1]
            if exponent == math.trunc(exponent) and abs(exponent) < 2**31:
                return ("powi", args[0], int(exponent))
        return (op, *args)

    def _arguments(self, node: int) -> tuple[int, ...]:
        key = self._nodes[node]
        if key[0] in ("symbol", "value"):
            return ()
        return (key[1],) if key[0] == "powi" else key[3:] if key[0] == "lookup" else key[1:]

    def symbols(self, roots: Iterable[int]) -> set[str]:
        """Names of the symbols that the roots depend on."""
        return {str(self._nodes[k][1]) for k in self._reached(roots) if self._nodes[k][0] == "symbol"}

    def _reached(self, roots: Iterable[int]) -> list[int]:
        found: set[int] = set()
        stack = list(roots)
        while stack:
            node = stack.pop()
            if node not in found:
                found.add(node)
                stack += self._arguments(node)
        return sorted(found)

    def statements(
        self, roots: Sequence[tuple[str, int]], symbols: Mapping[str, str], names: Mapping[int, str]
    ) -> list[str]:
        """Statements that assign each root to its place, as ``dx[0]``.

        ``symbols`` has the C text of each symbol, ``names`` what to call nodes that have a name: the quantities.
        """
        reached = self._reached(node for _, node in roots)
        uses = dict.fromkeys(reached, 0)
        for node in reached:
            for argument in self._arguments(node):
                uses[argument] += 1
        texts: dict[int, _Text] = {}
        lines = []
        count = 0
        for node in reached:
            text = self._text(node, texts, symbols)
            plain = self._nodes[node][0] in ("symbol", "value")
            if not plain and (uses[node] > 1 or node in names or len(text.text) > _LONG) and uses[node] > 0:
                count += node not in names
                name = names.get(node, f"v{count}")
                lines.append(f"const double {name} = {text.text};")
                text = _Text(name)
            texts[node] = text
        return lines + [f"{place} = {texts[node].text};" for place, node in roots]

    def _text(self, node: int, texts: Mapping[int, _Text], symbols: Mapping[str, str]) -> _Text:
        op, *rest = self._nodes[node]
        if op == "symbol":
            return _Text(symbols[rest[0]])
        if op == "value":
            return _Text(number(rest[0]), _ATOM if rest[0] >= 0 else 0)
        of = [texts[i] for i in self._arguments(node)]
        if op in _INFIX:
            sign, binds = _INFIX[op]
            # C takes equal ranks from the left, so only there they need no parentheses.
            return _Text(f"{_fenced(of[0], binds)} {sign} {_fenced(of[1], binds + 1)}", binds)
        if op == "neg":
            return _Text(f"-{_fenced(of[0], _ATOM)}", 0)
        if op == "recip":
            return _Text(f"1.0 / {_fenced(of[0], _ATOM)}", _PRODUCT)
        if op in _TESTS:
            return _Text(_TESTS[op].format(*(_fenced(each, _ATOM) for each in of)))
        if op == "lookup":
            self.used.add(f"table {rest[0]}")
            order, arguments = rest[1], ", ".join(each.text for each in of)
            orders = ", ".join(str(k) for k in order[: len(of)])
            return _Text(f"table_{rest[0]}({orders}, {arguments})")
        if op == "powi" and rest[1] in (2, 3) and of[0].text.isidentifier():
            return _Text(" * ".join([of[0].text] * rest[1]), _PRODUCT)
        call = _CALLS[op]
        self.used.add(call)
        more = f", {rest[1]}" if op == "powi" else ""
        return _Text(f"{call}({', '.join(each.text for each in of)}{more})")


def number(value: float) -> str:
    """A constant in C, exact to the bit."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))


def _value(saved: Any) -> float:
    return math.nan if saved is None else float(saved)


def _fenced(text: _Text, least: int) -> str:
    return text.text if text.binds >= least else f"({text.text})"
