"""C code of expressions and interpolation tables: equal sub-expressions are computed once, single uses are inlined."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .._core import Expr

__all__ = ["HELPERS", "LOOKUP", "Graph", "definition", "number"]

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
    """A graph of the nodes of several expressions, equal ones stored once; arguments precede the nodes that use
    them."""

    def __init__(self) -> None:
        self._nodes: list[_Key] = []
        self._ids: dict[_Key, int] = {}
        self.tables: list[Table] = []
        self.used: set[str] = set()
        """Helpers, and tables as ``table <n>``, that statements written so far call."""

    def add(self, e: Expr) -> int:
        """Add an expression; return its node."""
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
        """Return the names of the symbols that the roots depend on."""
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
        """Return statements that assign each root to its target, such as ``dx[0]``.

        ``symbols`` has the C text of each symbol, ``names`` the variable names of nodes that have one: the quantities.
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
    """Return a constant in C, exact to the bit."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))


def _value(saved: Any) -> float:
    return math.nan if saved is None else float(saved)


def _fenced(text: _Text, least: int) -> str:
    return text.text if text.binds >= least else f"({text.text})"


_Array: TypeAlias = NDArray[np.float64]

LOOKUP = """/* The derivative of an order of the cubic with coefficients c, lowest power first, at d. */
static double cubic(int order, const double c[4], double d) {
    switch (order) {
    case 0: return c[0] + d * (c[1] + d * (c[2] + d * c[3]));
    case 1: return c[1] + d * (2.0 * c[2] + d * (3.0 * c[3]));
    case 2: return 2.0 * c[2] + d * (6.0 * c[3]);
    case 3: return 6.0 * c[3] + 0.0 * d;
    default: return 0.0 * d + 0.0 * c[0];
    }
}

/* The cell of a point along an axis of n points: 0 below the first, n from the last on. */
static int cell_of(const double *axis, int n, double a) {
    int low = 0, high = n;
    while (low < high) {
        const int middle = (low + high) / 2;
        if (axis[middle] <= a) low = middle + 1; else high = middle;
    }
    return low;
}"""
"""What all tables share."""


def definition(index: int, table: Table) -> str:
    """Return the data of a table, and the function ``table_<index>``: orders of the derivatives, then the arguments."""
    name, axes, values = table
    prefix = f"table_{index}"
    grids = [np.array(axis) for axis in axes]
    lines = [f"/* Table {_comment(name)}: {' by '.join(str(g.size) for g in grids)} points. */"]
    for k, grid in enumerate(grids):
        lines.append(f"static const double {prefix}_axis_{k}[{grid.size}] = {{\n{_rows(grid[None])}\n}};")
    if len(grids) == 1:
        cells = _cells(grids[0], np.array(values))
        lines.append(f"static const double {prefix}_cells[{len(cells)}][4] = {{\n{_rows(cells, braces=True)}\n}};")
        lines.append(
            f"static double {prefix}(int order, double a) {{\n"
            f"    const int i = cell_of({prefix}_axis_0, {grids[0].size}, a);\n"
            f"    return cubic(order, {prefix}_cells[i], a - {prefix}_axis_0[i > 0 ? i - 1 : 0]);\n"
            "}"
        )
        return "\n".join(lines)
    both = _cells_of_two(grids[0], grids[1], np.array(values).reshape(grids[0].size, grids[1].size))
    flat = both.reshape(-1, 4)  # cell in x, cell in y, power in x; power in y
    columns = grids[1].size + 1
    lines.append(f"static const double {prefix}_cells[{len(flat)}][4] = {{\n{_rows(flat, braces=True)}\n}};")
    lines.append(
        f"static double {prefix}(int order_a, int order_b, double a, double b) {{\n"
        f"    const int i = cell_of({prefix}_axis_0, {grids[0].size}, a);\n"
        f"    const int j = cell_of({prefix}_axis_1, {grids[1].size}, b);\n"
        f"    const double d = b - {prefix}_axis_1[j > 0 ? j - 1 : 0];\n"
        "    double c[4];\n"
        "    int k;\n"
        "    for (k = 0; k < 4; ++k) {\n"
        f"        c[k] = cubic(order_b, {prefix}_cells[4 * (i * {columns} + j) + k], d);\n"
        "    }\n"
        f"    return cubic(order_a, c, a - {prefix}_axis_0[i > 0 ? i - 1 : 0]);\n"
        "}"
    )
    return "\n".join(lines)


def _cells(x: _Array, values: _Array) -> _Array:
    """Return (n + 1, 4, ...) coefficients of each cell about its lower corner, lowest power first; ``values``
    (n, ...)."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(x, values, axis=0, bc_type="natural")
    n = x.size
    found = np.zeros((n + 1, 4, *values.shape[1:]))
    found[1:n] = np.moveaxis(spline.c[::-1], 0, 1)
    for cell, end in ((0, 0), (n, n - 1)):
        found[cell, 0], found[cell, 1] = values[end], spline(x[end], 1)
    return found


def _cells_of_two(x: _Array, y: _Array, values: _Array) -> _Array:
    """Return (n_x + 1, n_y + 1, 4 powers of x, 4 powers of y) coefficients of each cell."""
    along_y = _cells(y, values.T)  # (n_y + 1, 4, n_x)
    along_x = _cells(x, np.moveaxis(along_y, 2, 0))  # (n_x + 1, 4, n_y + 1, 4)
    return np.asarray(np.moveaxis(along_x, 1, 2))


def _rows(values: _Array, braces: bool = False) -> str:
    rows = (", ".join(number(float(v)) for v in row) for row in values)
    return ",\n".join(f"    {{{row}}}" if braces else f"    {row}" for row in rows)


def _comment(text: str) -> str:
    return text.replace("*/", "* /").replace("\n", " ")
