"""Interpolation tables as C: the natural cubic spline of each cell, and the function that looks it up.

A table is a natural cubic spline, continued by straight lines beyond its grid; in two dimensions the tensor product of
two of them (de Boor, A Practical Guide to Splines, 1978).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .graph import Table, number

__all__ = ["LOOKUP", "definition"]

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
    """The data of a table, and the function ``table_<index>``: orders of the derivatives, then the arguments."""
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
    """(n + 1, 4, ...) coefficients of each cell about its lower corner, the lowest power first; ``values`` (n, ...)."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(x, values, axis=0, bc_type="natural")
    n = x.size
    found = np.zeros((n + 1, 4, *values.shape[1:]))
    found[1:n] = np.moveaxis(spline.c[::-1], 0, 1)
    for cell, end in ((0, 0), (n, n - 1)):
        found[cell, 0], found[cell, 1] = values[end], spline(x[end], 1)
    return found


def _cells_of_two(x: _Array, y: _Array, values: _Array) -> _Array:
    """(n_x + 1, n_y + 1, 4 powers of x, 4 powers of y)."""
    along_y = _cells(y, values.T)  # (n_y + 1, 4, n_x)
    along_x = _cells(x, np.moveaxis(along_y, 2, 0))  # (n_x + 1, 4, n_y + 1, 4)
    return np.asarray(np.moveaxis(along_x, 1, 2))


def _rows(values: _Array, braces: bool = False) -> str:
    rows = (", ".join(number(float(v)) for v in row) for row in values)
    return ",\n".join(f"    {{{row}}}" if braces else f"    {row}" for row in rows)


def _comment(text: str) -> str:
    return text.replace("*/", "* /").replace("\n", " ")
