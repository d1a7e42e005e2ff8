"""Functions on expressions, and the mapping of numpy's and SymPy's functions to the operation table of the core."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

import phugoid._core as _core

from ._core import Expr
from .errors import ModelError, did_you_mean

__all__ = [
    "Table",
    "acos",
    "asin",
    "atan",
    "atan2",
    "cos",
    "cosh",
    "exp",
    "expm1",
    "from_sympy",
    "hypot",
    "log",
    "log1p",
    "maximum",
    "minimum",
    "sign",
    "sin",
    "sinh",
    "smooth_abs",
    "smooth_max",
    "smooth_min",
    "smooth_sign",
    "smooth_step",
    "sqrt",
    "tan",
    "tanh",
    "where",
]


def _call(name: str, *args: Any) -> Any:
    """Apply an operation of the table to expressions, numbers, or arrays of them (element by element).

    Numbers alone give a number.
    """
    if any(isinstance(a, (np.ndarray, list, tuple)) for a in args):
        return np.frompyfunc(lambda *each: _call(name, *each), len(args), 1)(*map(_boxed, args))
    result = _core.apply(name, *args)
    return result.constant if result.constant is not None else result


def _function(name: str, doc: str) -> Callable[[Any], Any]:
    def function(x: Any) -> Any:
        return _call(name, x)

    function.__name__ = function.__qualname__ = name
    function.__doc__ = doc
    return function


sin = _function("sin", "Sine of an expression, number or array, rad.")
cos = _function("cos", "Cosine of an expression, number or array, rad.")
tan = _function("tan", "Tangent of an expression, number or array, rad.")
asin = _function("asin", "Arc sine, rad, of -1 to 1.")
acos = _function("acos", "Arc cosine, rad, of -1 to 1.")
atan = _function("atan", "Arc tangent, rad.")
sinh = _function("sinh", "Hyperbolic sine.")
cosh = _function("cosh", "Hyperbolic cosine.")
tanh = _function("tanh", "Hyperbolic tangent.")
exp = _function("exp", "Exponential.")
expm1 = _function("expm1", "Exponential less 1, accurate near 0.")
log = _function("log", "Natural logarithm of a positive argument.")
log1p = _function("log1p", "Natural logarithm of 1 + x, x > -1, accurate near 0.")
sqrt = _function("sqrt", "Square root of an argument >= 0 (its derivative needs > 0).")
sign = _function("sign", "Sign: -1, 0 or 1; derivative 0. `smooth_sign` has no jump.")
abs = _function("abs", "Absolute value. `smooth_abs` has no kink.")


def atan2(y: Any, x: Any) -> Any:
    """Return the angle of the point (x, y), rad, in (-pi, pi]."""
    return _call("atan2", y, x)


def hypot(x: Any, y: Any) -> Any:
    """Return sqrt(x**2 + y**2), without overflow on the way; its derivative needs a value > 0."""
    return _call("hypot", x, y)


def minimum(a: Any, b: Any) -> Any:
    """Return the smaller of two. `smooth_min` has no kink."""
    return _call("min", a, b)


def maximum(a: Any, b: Any) -> Any:
    """Return the larger of two. `smooth_max` has no kink."""
    return _call("max", a, b)


def where(condition: Any, yes: Any, no: Any) -> Any:
    """Return ``yes`` where the condition holds, ``no`` elsewhere: the ``if`` of a model.

    Conditions are written with ``< <= > >=`` and joined with ``& | ~``. Derivatives are those of the branch
    taken; what the other branch would give (NaN, say) does not enter.
    """
    return _call("where", condition, yes, no)


def smooth_abs(x: Any, width: Any) -> Any:
    """Return |x| with the kink rounded over ``width``: sqrt(x**2 + width**2)."""
    return sqrt(x * x + width * width)


def smooth_sign(x: Any, width: Any) -> Any:
    """Return sign(x) with the jump spread over ``width``: tanh(x/width)."""
    return tanh(x / width)


def smooth_step(x: Any, width: Any) -> Any:
    """Return 0 for x << -width, 1 for x >> width: (1 + tanh(x/width))/2."""
    return 0.5 * (1 + tanh(x / width))


def smooth_max(a: Any, b: Any, width: Any) -> Any:
    """Return max(a, b) with the kink rounded over ``width``."""
    return 0.5 * (a + b + smooth_abs(a - b, width))


def smooth_min(a: Any, b: Any, width: Any) -> Any:
    """Return min(a, b) with the kink rounded over ``width``."""
    return 0.5 * (a + b - smooth_abs(a - b, width))


class Table:
    """An interpolation table for aerodynamic data, twice continuously differentiable.

    ``Table("CL", alpha, CL)`` is a function of one expression, ``Table("Cm", (alpha, mach), Cm)`` with values of
    shape (len(alpha), len(mach)) of two. Between grid points it is a cubic spline, beyond the grid it goes on
    linearly. Raises ModelError for axes that do not increase or values that do not fit.

    >>> lift = Table("CL", [0.0, 0.1, 0.2], [0.2, 0.7, 1.1])
    >>> lift(0.1)
    0.7
    """

    def __init__(self, name: str, axes: Any, values: Any) -> None:
        try:
            array = np.array(values, dtype=np.float64)
            grid = [np.array(axis, dtype=np.float64) for axis in (axes if array.ndim == 2 else [axes])]
        except (TypeError, ValueError) as error:
            raise ModelError(f"table '{name}': axes and values are arrays of numbers ({error})") from None
        expected = tuple(a.size for a in grid)
        if array.shape != expected or len(grid) > 2:
            raise ModelError(f"table '{name}': values have shape {array.shape}, the axes ask for {expected}")
        second = grid[1].tolist() if len(grid) == 2 else None
        self._core = _core.Table(name, grid[0].tolist(), array.ravel().tolist(), second)
        self._saved = (name, grid if second else grid[0], array)
        self.name = name

    def __reduce__(self) -> Any:
        return Table, self._saved

    def __call__(self, *args: Any) -> Any:
        if any(isinstance(a, (np.ndarray, list, tuple)) for a in args):
            return np.frompyfunc(self, len(args), 1)(*map(_boxed, args))
        result = self._core(*args)
        if result.symbols:
            return result
        return result.evaluate()

    def __repr__(self) -> str:
        return f"Table({self.name!r})"


# numpy's names of the operations of the table, and of functions made of these.
_UFUNCS: dict[str, Callable[..., Any]] = {
    **{
        f.__name__: f
        for f in (sign, sqrt, exp, log, sin, cos, tan, sinh, cosh, tanh, minimum, maximum, hypot, log1p, expm1)
    },
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "true_divide": lambda a, b: a / b,
    "power": lambda a, b: a**b,
    "float_power": lambda a, b: a**b,
    "negative": lambda a: -a,
    "positive": lambda a: a,
    "reciprocal": lambda a: 1 / a,
    "square": lambda a: a * a,
    "absolute": abs,
    "fabs": abs,
    "arcsin": asin,
    "arccos": acos,
    "arctan": atan,
    "arctan2": atan2,
    "fmin": minimum,
    "fmax": maximum,
    "clip": lambda x, low, high: minimum(maximum(x, low), high),
    "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b,
    "greater": lambda a, b: a > b,
    "greater_equal": lambda a, b: a >= b,
    "equal": lambda a, b: a == b,
    "not_equal": lambda a, b: a != b,
    "logical_and": lambda a, b: _call("and", a, b),
    "logical_or": lambda a, b: _call("or", a, b),
    "logical_not": lambda a: _call("not", a),
    "log10": lambda a: log(a) / math.log(10),
    "log2": lambda a: log(a) / math.log(2),
    "exp2": lambda a: exp(a * math.log(2)),
    "deg2rad": lambda a: a * (math.pi / 180),
    "radians": lambda a: a * (math.pi / 180),
    "rad2deg": lambda a: a * (180 / math.pi),
    "degrees": lambda a: a * (180 / math.pi),
}


def apply_ufunc(ufunc: Any, method: str, inputs: Sequence[Any], options: Mapping[str, Any] | None) -> Any:
    """Apply a ufunc of numpy to arguments that include an expression: the operation, element by element.

    Raises TypeError, with the nearest name that is known, for a ufunc that the table does not have.
    """
    if ufunc.__name__ == "matmul" and method == "__call__":
        raise TypeError("@ needs arrays; write * for the product with a single expression")
    function = _UFUNCS.get(ufunc.__name__)
    if function is None or method != "__call__" or options:
        what = ufunc.__name__ if function is None else f"{ufunc.__name__}.{method} with options"
        hint = did_you_mean(ufunc.__name__, _UFUNCS) if function is None else ""
        raise TypeError(f"numpy.{what} has no form for expressions.{hint}")
    return np.frompyfunc(function, len(inputs), 1)(*(_boxed(x) for x in inputs))


def _boxed(x: Any) -> Any:
    """Return an expression as a 0-d array, so that numpy does not call back here; it is unpacked on the way out."""
    if not isinstance(x, Expr):
        return x
    box = np.empty((), dtype=object)
    box[()] = x
    return box


def from_sympy(expression: Any, names: Mapping[str, Any] | None = None) -> Any:
    """Convert a SymPy expression to one of phugoid; a SymPy matrix to an array of them.

    ``names`` maps SymPy symbol names to expressions; others become symbols of the same name. Raises ModelError
    for a function that has no counterpart.
    """
    given = dict(names or {})

    done: dict[Any, Any] = {}  # a repeated sub-expression is shared, as SymPy shares it

    def convert(e: Any) -> Any:
        if e not in done:
            done[e] = converted(e)
        return done[e]

    def converted(e: Any) -> Any:
        if e.is_Symbol:
            return given.get(e.name, Expr.symbol(e.name))
        name = type(e).__name__
        if getattr(e, "is_number", False) and not e.args:
            if not (e.is_real and e.is_finite):
                raise ModelError(f"the SymPy expression {expression} holds {e}, which is not a finite real number")
            return float(e)
        if name == "Piecewise":
            return _piecewise(e, convert)
        combine = _SYMPY_CHAINS.get(name)
        if combine is not None:
            return functools.reduce(combine, map(convert, e.args))
        function = _SYMPY.get(name)
        if function is None:
            known = [*_SYMPY, *_SYMPY_CHAINS]
            raise ModelError(f"SymPy's {name} has no counterpart in phugoid (in {e}).{did_you_mean(name, known)}")
        return function(*map(convert, e.args))

    if hasattr(expression, "tolist"):
        rows = [[convert(e) for e in row] for row in expression.tolist()]
        return np.array(rows, dtype=object)
    if not hasattr(expression, "is_Symbol"):
        raise ModelError(f"from_sympy: {expression!r} is a {type(expression).__name__}, not a SymPy expression")
    return convert(expression)


def _piecewise(e: Any, convert: Callable[[Any], Any]) -> Any:
    pieces = list(e.args)
    if str(pieces[-1][1]) != "True":
        raise ModelError(f"the SymPy expression {e} has no value outside its pieces; add a last one with True")
    result = convert(pieces[-1][0])
    for value, condition in reversed(pieces[:-1]):
        result = where(convert(condition), convert(value), result)
    return result


# Operations of any number of arguments.
_SYMPY_CHAINS: dict[str, Callable[[Any, Any], Any]] = {
    "Add": lambda a, b: a + b,
    "Mul": lambda a, b: a * b,
    "Min": minimum,
    "Max": maximum,
    "And": lambda a, b: a & b,
    "Or": lambda a, b: a | b,
}

_SYMPY: dict[str, Callable[..., Any]] = {
    **{f.__name__: f for f in (sin, cos, tan, asin, acos, atan, atan2, sinh, cosh, tanh, exp, log, sign)},
    "Pow": lambda a, b: a**b,
    "cot": lambda a: 1 / tan(a),
    "sec": lambda a: 1 / cos(a),
    "csc": lambda a: 1 / sin(a),
    "Abs": abs,
    "StrictLessThan": lambda a, b: a < b,
    "LessThan": lambda a, b: a <= b,
    "StrictGreaterThan": lambda a, b: a > b,
    "GreaterThan": lambda a, b: a >= b,
    "Not": lambda a: ~a,
}
