"""Expressions from Python: operators, functions, numpy, tables, printing, pickling, derivatives, SymPy."""

from __future__ import annotations

import copy
import math
import multiprocessing
import operator
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

import phugoid as ph
from phugoid import Expr, ModelError, Table, _core

x, y, z = (Expr.symbol(name) for name in "xyz")
AT = {"x": 0.6, "y": -1.7, "z": 2.3}

# Name, value of the standard library, an argument.
FUNCTIONS: list[tuple[str, Callable[[float], float], float]] = [
    ("sin", math.sin, 0.6),
    ("cos", math.cos, 0.6),
    ("tan", math.tan, 0.6),
    ("asin", math.asin, 0.6),
    ("acos", math.acos, 0.6),
    ("atan", math.atan, -1.7),
    ("sinh", math.sinh, -1.7),
    ("cosh", math.cosh, -1.7),
    ("tanh", math.tanh, 0.6),
    ("exp", math.exp, -1.7),
    ("log", math.log, 2.3),
    ("sqrt", math.sqrt, 2.3),
    ("sign", lambda v: math.copysign(1.0, v), -1.7),
]
NAMES = [name for name, *_ in FUNCTIONS]


def value(expression: Any) -> float:
    return expression.evaluate({name: AT[name] for name in expression.symbols})


# ---------------------------------------------------------------- functions


@pytest.mark.parametrize(("name", "reference", "at"), FUNCTIONS, ids=NAMES)
def test_function_of_a_number_is_a_number(name: str, reference: Callable[[float], float], at: float) -> None:
    result = getattr(ph, name)(at)
    assert type(result) is float
    assert result == pytest.approx(reference(at), rel=1e-15)


@pytest.mark.parametrize(("name", "reference", "at"), FUNCTIONS, ids=NAMES)
def test_function_of_an_expression_is_an_expression(name: str, reference: Callable[[float], float], at: float) -> None:
    expression = getattr(ph, name)(x)
    assert isinstance(expression, Expr)
    assert str(expression) == f"{name}(x)"
    assert expression.evaluate(x=at) == getattr(ph, name)(at)


@pytest.mark.parametrize("name", NAMES)
def test_function_of_an_array_works_element_by_element(name: str) -> None:
    function = getattr(ph, name)
    result = function(np.array([x, 0.5], dtype=object))
    assert result.shape == (2,)
    assert result[0] == function(x)
    assert result[1] == function(0.5)


def test_functions_take_lists_beside_expressions() -> None:
    assert [str(e) for e in ph.where(x > 0, [x, y], 0)] == ["where(0 < x, x, 0)", "where(0 < x, y, 0)"]
    assert [str(e) for e in ph.maximum(x, [0, 1])] == ["max(x, 0)", "max(x, 1)"]


@pytest.mark.parametrize("bad", ["x", None, 1j, object()])
def test_function_refuses_what_is_no_number(bad: Any) -> None:
    with pytest.raises(TypeError, match="neither an expression nor a number"):
        ph.sin(bad)


@pytest.mark.parametrize(("function", "outside"), [(ph.asin, 2.0), (ph.acos, -1.5), (ph.log, -1.0), (ph.sqrt, -1.0)])
def test_number_outside_the_domain_is_refused(function: Callable[[float], float], outside: float) -> None:
    with pytest.raises(ModelError, match=r"outside the domain of \w+"):
        function(outside)


def test_atan2_takes_y_first() -> None:
    assert ph.atan2(y, x).evaluate(AT) == pytest.approx(math.atan2(AT["y"], AT["x"]), rel=1e-15)
    assert ph.atan2(1.0, -1.0) == pytest.approx(0.75 * math.pi, rel=1e-15)


def test_minimum_and_maximum() -> None:
    assert value(ph.minimum(x, y)) == AT["y"]
    assert value(ph.maximum(x, y)) == AT["x"]
    assert (ph.minimum(1, 2), ph.maximum(1, 2)) == (1.0, 2.0)


def test_every_operation_of_the_table_can_be_applied() -> None:
    for name, arity, domain in _core.operations():
        numbers = [max(low, -1.0) + 0.5 for low, _ in domain]
        symbols = [x, y, z][:arity]
        expression = _core.apply(name, *symbols)
        result = _core.apply(name, *numbers).constant
        assert expression.evaluate(dict(zip("xyz", numbers, strict=False))) == result, name


def test_operation_with_wrong_number_of_arguments_is_refused() -> None:
    with pytest.raises(TypeError, match="atan2 takes 2 arguments, 1 were given"):
        _core.apply("atan2", x)


# ---------------------------------------------------------------- smooth variants


def test_smooth_variants_approach_their_sharp_kin() -> None:
    width = 1e-9
    for v in (-0.7, 0.4):
        assert ph.smooth_abs(v, width) == pytest.approx(abs(v), abs=1e-15)
        assert ph.smooth_sign(v, width) == math.copysign(1.0, v)
        assert ph.smooth_step(v, width) == (v > 0)
        assert ph.smooth_max(v, 0.1, width) == pytest.approx(max(v, 0.1), abs=1e-15)
        assert ph.smooth_min(v, 0.1, width) == pytest.approx(min(v, 0.1), abs=1e-15)


@pytest.mark.parametrize(
    ("expression", "slope"),
    [
        (ph.smooth_abs(x, 0.5), 0.0),
        (ph.smooth_sign(x, 0.5), 2.0),
        (ph.smooth_step(x, 0.5), 1.0),
        (ph.smooth_max(x, 0, 0.5), 0.5),
        (ph.smooth_min(x, 0, 0.5), 0.5),
    ],
)
def test_smooth_variants_have_a_slope_where_their_kin_have_a_kink(expression: Expr, slope: float) -> None:
    assert expression.diff(x).evaluate(x=0.0) == slope


# ---------------------------------------------------------------- operators

OPERATORS = [operator.add, operator.sub, operator.mul, operator.truediv, operator.pow]


@pytest.mark.parametrize("op", OPERATORS)
def test_binary_operator_with_expression_and_number_on_either_side(op: Callable[[Any, Any], Any]) -> None:
    assert value(op(x, z)) == pytest.approx(op(AT["x"], AT["z"]), rel=1e-15)
    assert value(op(x, 3)) == pytest.approx(op(AT["x"], 3), rel=1e-15)
    assert value(op(3, x)) == pytest.approx(op(3, AT["x"]), rel=1e-15)


@pytest.mark.parametrize("op", OPERATORS)
def test_numpy_scalar_on_either_side(op: Callable[[Any, Any], Any]) -> None:
    two = np.float64(2.0)
    assert op(x, two) == op(x, 2.0)
    assert op(two, x) == op(2.0, x)
    assert isinstance(op(two, x), Expr)


def test_unary_operators() -> None:
    assert value(-x) == -0.6
    assert +x == x
    assert value(abs(y)) == 1.7


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        (x > 0, True),
        (x >= 0.6, True),
        (x < 0.6, False),
        (x <= 0.6, True),
        (x < 0.6, False),
        ((x > 0) & (y > 0), False),
        ((x > 0) | (y > 0), True),
        (~(x > 0), False),
    ],
)
def test_conditions(condition: Expr, holds: bool) -> None:
    assert value(condition) == float(holds)
    assert value(ph.where(condition, 10, 20)) == (10 if holds else 20)


def test_where_takes_the_branch_that_is_defined() -> None:
    safe = ph.where(y > 0, ph.sqrt(y), 0)
    assert safe.evaluate(y=-1.0) == 0.0
    assert safe.diff(y).evaluate(y=-1.0) == 0.0
    assert safe.diff(y).evaluate(y=4.0) == 0.25


@pytest.mark.parametrize("bad", [float("nan"), math.inf, -math.inf, np.float64("nan")])
def test_number_that_is_not_finite_is_refused(bad: float) -> None:
    with pytest.raises(ModelError, match="not finite"):
        x + bad
    with pytest.raises(ModelError, match="not finite"):
        bad * x
    with pytest.raises(ModelError, match="not finite"):
        x < bad  # noqa: B015


def test_division_by_the_number_zero_is_refused() -> None:
    with pytest.raises(ModelError, match=r"division of x \+ y by zero"):
        (x + y) / 0


@pytest.mark.parametrize("bad", ["a", None, 1j, [1, 2]])
def test_operator_refuses_what_is_no_number(bad: Any) -> None:
    with pytest.raises(TypeError):
        x + bad


def test_pow_refuses_a_modulus() -> None:
    with pytest.raises(TypeError, match="no modulus"):
        pow(x, 2, 5)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "ask",
    [
        lambda: 1 if x > 0 else 2,
        lambda: x > 0 and y > 0,
        lambda: not x,
        lambda: 0 < x < 1,
        lambda: bool(x),
        lambda: np.where(x > 0, x, y),
    ],
)
def test_truth_of_an_expression_points_to_where(ask: Callable[[], Any]) -> None:
    with pytest.raises(TypeError, match=r"no truth value .* write phugoid\.where\(condition, yes, no\) for 'if'"):
        ask()


@pytest.mark.parametrize("ask", [lambda: max(x, 0), lambda: min(x, y), lambda: np.max(np.array([x, y]))])
def test_builtin_max_and_min_point_to_maximum_and_minimum(ask: Callable[[], Any]) -> None:
    with pytest.raises(TypeError, match=r"phugoid\.minimum and phugoid\.maximum for 'min' and 'max'"):
        ask()


def test_math_functions_point_to_those_of_phugoid() -> None:
    with pytest.raises(TypeError, match=r"'x' is not a number: .* phugoid and numpy, not of math"):
        math.sin(x)


def test_expression_without_symbols_is_a_number() -> None:
    assert float(Expr(3) + 2) == 5.0


def test_an_expression_is_no_sequence() -> None:
    with pytest.raises(TypeError):
        iter(x)  # type: ignore[call-overload]


# ---------------------------------------------------------------- numpy

UFUNCS: list[tuple[Any, Callable[[float], float], float]] = [
    (np.negative, operator.neg, 0.6),
    (np.positive, operator.pos, 0.6),
    (np.reciprocal, lambda v: 1 / v, 0.6),
    (np.square, lambda v: v * v, 0.6),
    (np.absolute, abs, -1.7),
    (np.fabs, abs, -1.7),
    (np.sign, lambda v: math.copysign(1, v), -1.7),
    (np.sqrt, math.sqrt, 2.3),
    (np.exp, math.exp, 0.6),
    (np.exp2, lambda v: 2**v, 0.6),
    (np.expm1, math.expm1, 0.6),
    (np.log, math.log, 2.3),
    (np.log2, math.log2, 2.3),
    (np.log10, math.log10, 2.3),
    (np.log1p, math.log1p, 2.3),
    (np.sin, math.sin, 0.6),
    (np.cos, math.cos, 0.6),
    (np.tan, math.tan, 0.6),
    (np.arcsin, math.asin, 0.6),
    (np.arccos, math.acos, 0.6),
    (np.arctan, math.atan, 0.6),
    (np.sinh, math.sinh, 0.6),
    (np.cosh, math.cosh, 0.6),
    (np.tanh, math.tanh, 0.6),
    (np.deg2rad, math.radians, 0.6),
    (np.radians, math.radians, 0.6),
    (np.rad2deg, math.degrees, 0.6),
    (np.degrees, math.degrees, 0.6),
]


@pytest.mark.parametrize(("ufunc", "reference", "at"), UFUNCS, ids=[u.__name__ for u, *_ in UFUNCS])
def test_ufunc_of_an_expression(ufunc: Any, reference: Callable[[float], float], at: float) -> None:
    result = ufunc(x)
    assert isinstance(result, Expr)
    assert result.evaluate(x=at) == pytest.approx(reference(at), rel=1e-14)


# numpy calls methods of the elements for these; it compares objects for a sign.
ON_ARRAYS = [u for u in UFUNCS if u[0] not in (np.exp2, np.expm1, np.log2, np.log1p, np.sign)]


@pytest.mark.parametrize(("ufunc", "reference", "at"), ON_ARRAYS, ids=[u.__name__ for u, *_ in ON_ARRAYS])
def test_ufunc_of_an_array_of_expressions(ufunc: Any, reference: Callable[[float], float], at: float) -> None:
    result = ufunc(np.array([x, 2 * y]))
    assert result[0].evaluate(x=at) == pytest.approx(reference(at), rel=1e-14)


@pytest.mark.parametrize(
    ("made", "text"),
    [
        (lambda: np.add(x, y), "x + y"),
        (lambda: np.subtract(2.0, y), "2 - y"),
        (lambda: np.multiply(x, 2.0), "x*2"),
        (lambda: np.divide(x, y), "x/y"),
        (lambda: np.power(x, 2), "x**2"),
        (lambda: np.float_power(x, 2), "x**2"),
        (lambda: np.arctan2(x, 1.0), "atan2(x, 1)"),
        (lambda: np.arctan2(1.0, x), "atan2(1, x)"),
        (lambda: np.hypot(x, y), "hypot(x, y)"),
        (lambda: np.minimum(x, 0.0), "min(x, 0)"),
        (lambda: np.maximum(0.0, x), "max(0, x)"),
        (lambda: np.fmin(x, y), "min(x, y)"),
        (lambda: np.fmax(x, y), "max(x, y)"),
        (lambda: np.clip(x, -1.0, 1.0), "min(max(x, -1), 1)"),
        (lambda: np.less(x, y), "x < y"),
        (lambda: np.greater_equal(x, y), "y <= x"),
        (lambda: np.logical_and(x > 0, y > 0), "and(0 < x, 0 < y)"),
        (lambda: np.logical_or(x > 0, y > 0), "or(0 < x, 0 < y)"),
        (lambda: np.logical_not(x > 0), "not(0 < x)"),
    ],
)
def test_binary_ufunc(made: Callable[[], Expr], text: str) -> None:
    assert str(made()) == text


def test_array_times_expression_is_an_array_of_expressions() -> None:
    left, right = np.array([1.0, 2.0]) * x, x * np.array([1.0, 2.0])
    assert [str(e) for e in left] == ["1*x", "2*x"]
    assert [str(e) for e in right] == ["x*1", "x*2"]
    assert [str(e) for e in np.array([1.0, 2.0]) - x] == ["1 - x", "2 - x"]


@pytest.mark.parametrize("product", [lambda a, v: a @ v, np.dot, np.matmul])
def test_matrix_times_vector_of_expressions(product: Callable[[Any, Any], Any]) -> None:
    w, q = Expr.symbol("w"), Expr.symbol("q")
    result = product(np.array([[-1.0, 44.0], [0.2, -0.7]]), np.array([w, q]))
    assert [str(e) for e in result] == ["-1*w + 44*q", "0.2*w + (-0.7*q)"]


def test_inner_product_and_norm() -> None:
    v = np.array([x, y])
    assert str(v @ v) == "x*x + y*y"
    assert str(np.linalg.norm(v)) == "sqrt(x*x + y*y)"


def test_sums_over_arrays_of_expressions() -> None:
    assert str(np.sum([x, y, z])) == "x + y + z"
    assert str(np.array([x, y]).mean()) == "(x + y)/2"


def test_matmul_with_a_single_expression_says_what_to_write() -> None:
    with pytest.raises(TypeError, match=r"write \* for the product"):
        np.eye(2) @ x


@pytest.mark.parametrize(
    ("ufunc", "hint"), [(np.arcsinh, "'arcsin'"), (np.cbrt, ""), (np.isnan, ""), (np.heaviside, "")]
)
def test_unknown_ufunc_names_the_nearest(ufunc: Any, hint: str) -> None:
    with pytest.raises(TypeError, match=rf"numpy\.{ufunc.__name__} has no form for expressions") as caught:
        ufunc(*[x] * ufunc.nin)
    assert hint in str(caught.value)


def test_ufunc_options_are_refused() -> None:
    with pytest.raises(TypeError, match=r"numpy\.add\.__call__ with options"):
        np.add(x, y, where=True)


# ---------------------------------------------------------------- tables

ALPHA = np.array([-0.2, -0.05, 0.0, 0.1, 0.25])


def test_table_passes_through_its_points() -> None:
    values = np.array([-0.9, -0.2, 0.1, 0.6, 0.9])
    lift = Table("CL", ALPHA, values)
    np.testing.assert_allclose([lift(a) for a in ALPHA], values, rtol=0, atol=1e-15)


def test_table_goes_on_linearly_beyond_its_axis() -> None:
    lift = Table("CL", ALPHA, ALPHA**2)
    slope = lift(x).diff(x)
    assert lift(0.45) - lift(0.35) == pytest.approx(0.1 * slope.evaluate(x=0.25), rel=1e-12)
    assert slope.diff(x).evaluate(x=0.4) == 0.0


def test_table_has_continuous_first_and_second_derivative() -> None:
    lift = Table("CL", ALPHA, np.sin(5 * ALPHA))(x)
    for derivative in (lift.diff(x), lift.diff(x).diff(x)):
        for knot in ALPHA[1:-1]:
            below, above = (derivative.evaluate(x=knot + step) for step in (-1e-9, 1e-9))
            assert below == pytest.approx(above, abs=2e-6)


def test_table_derivative_is_that_of_its_value() -> None:
    lift = Table("CL", ALPHA, np.sin(5 * ALPHA))
    h = 1e-5
    difference = (lift(0.03 + h) - lift(0.03 - h)) / (2 * h)
    assert lift(x).diff(x).evaluate(x=0.03) == pytest.approx(difference, rel=1e-8)


def test_table_of_two_axes() -> None:
    mach = np.array([0.2, 0.5, 0.8])
    values = np.add.outer(ALPHA, 2 * mach)  # a plane, which splines reproduce
    moment = Table("Cm", (ALPHA, mach), values)
    assert moment(0.1, 0.5) == pytest.approx(1.1, rel=1e-14)
    assert moment(0.07, 0.33) == pytest.approx(0.73, rel=1e-14)
    e = moment(x, y)
    assert e.symbols == ["x", "y"]
    assert e.diff(x).evaluate(x=0.07, y=0.33) == pytest.approx(1.0, rel=1e-13)
    assert e.diff(y).evaluate(x=0.07, y=0.33) == pytest.approx(2.0, rel=1e-13)


def test_table_of_an_inner_expression_follows_the_chain_rule() -> None:
    square = Table("s", np.linspace(-2, 2, 41), np.linspace(-2, 2, 41) ** 2)
    e = square(ph.sin(x))
    assert e.diff(x).evaluate(x=0.5) == pytest.approx(math.sin(1.0), rel=1e-5)


def test_table_of_an_array() -> None:
    lift = Table("CL", [0.0, 1.0], [0.0, 2.0])
    assert list(lift(np.array([0.25, 0.5]))) == [0.5, 1.0]
    assert [str(e) for e in lift([x, y])] == ["CL(x)", "CL(y)"]


@pytest.mark.parametrize(
    ("axes", "values", "words"),
    [
        ([0, 0, 1], [1, 2, 3], r"axis must increase strictly"),
        ([0, 1], [1, 2, 3], r"values have shape \(3,\), the axes ask for \(2,\)"),
        (([0, 1], [0, 1, 2]), [[1, 2], [3, 4]], r"shape \(2, 2\), the axes ask for \(2, 3\)"),
        ([0], [1], r"at least 2"),
        ([0, 1], [1, float("nan")], r"NaN"),
        ([0, 1], [1, "high"], r"arrays of numbers"),
        (([0, 1], [0, 1]), [[1, 2], [3]], r"arrays of numbers"),
    ],
)
def test_table_refuses(axes: Any, values: Any, words: str) -> None:
    with pytest.raises(ModelError, match=words) as caught:
        Table("CL", axes, values)
    assert "CL" in str(caught.value)


def test_table_refuses_the_wrong_number_of_arguments() -> None:
    with pytest.raises(TypeError, match="table 'CL' takes 1 arguments, 2 were given"):
        Table("CL", [0, 1], [0, 1])(x, y)


# ---------------------------------------------------------------- printing


@pytest.mark.parametrize(
    ("expression", "text"),
    [
        (x - (y - 1), "x - (y - 1)"),
        (x - y - 1, "x - y - 1"),
        (x / (y * 2), "x/(y*2)"),
        (x / y * 2, "x/y*2"),
        ((-x) ** 2, "(-x)**2"),
        (-(x**2), "-x**2"),
        ((x + 1) * (y - 1), "(x + 1)*(y - 1)"),
        (x * -2, "x*(-2)"),
        (2 ** (x + 1), "2**(x + 1)"),
        (1e-9 * x, "1e-9*x"),
        (ph.where((x > 0) & ~(y <= 1), x, -y), "where(and(0 < x, not(y <= 1)), x, -y)"),
    ],
)
def test_infix_reads_back_as_the_same_expression(expression: Expr, text: str) -> None:
    assert str(expression) == text
    names = {"x": x, "y": y, "where": ph.where, "and": operator.and_}
    if "and(" not in text:
        assert eval(text, names) == expression


@pytest.mark.parametrize(
    ("expression", "latex"),
    [
        (x / (y + 1), r"\frac{x}{y + 1}"),
        (ph.sqrt(x**2 + 1), r"\sqrt{{x}^{2} + 1}"),
        (Expr.symbol("alpha") * x, r"\alpha \, x"),
        (Expr.symbol("CL_alpha") + 0, r"\mathrm{CL}_{\alpha} + 0"),
        (ph.exp(-x), r"e^{-x}"),
        (x * (y - 1), r"x \, \left(y - 1\right)"),
        (abs(x), r"\left|x\right|"),
        (ph.where(x > 0, x, y), r"\begin{cases} x & 0 < x \\ y & \text{otherwise} \end{cases}"),
        (2.5e-9 * x, r"2.5 \cdot 10^{-9} \, x"),
    ],
)
def test_latex(expression: Expr, latex: str) -> None:
    assert expression.latex() == latex
    assert expression._repr_latex_() == f"${latex}$"


# ---------------------------------------------------------------- identity, evaluation, substitution


def test_equality_is_that_of_structure() -> None:
    assert x + y == Expr.symbol("x") + Expr.symbol("y")
    assert x + y != y + x
    assert (x == 1) is False
    assert Expr(1) == 1
    assert (x == "x") is False


def test_expressions_serve_as_keys() -> None:
    table = {x + y: "sum", x * y: "product"}
    assert table[Expr.symbol("x") * Expr.symbol("y")] == "product"
    assert len({x, Expr.symbol("x"), y}) == 2
    assert x in [y, x]


def test_symbols_name_constant_and_operation_take_an_expression_apart() -> None:
    e = ph.sin(y) + 2 * x
    assert e.symbols == ["x", "y"]
    assert (x.name, e.name) == ("x", None)
    assert (Expr(2.5).constant, e.constant) == (2.5, None)
    assert e.operation == ("add", [ph.sin(y), 2 * x])


def test_evaluate_takes_a_mapping_and_keywords() -> None:
    assert (x + y).evaluate({"x": 1.0}, y=2.0) == 3.0


def test_evaluate_names_the_symbol_without_a_value() -> None:
    with pytest.raises(ModelError, match="no value was given for symbol 'y'"):
        (x + y).evaluate(x=1.0)


def test_substitute_takes_expressions_and_numbers_at_once() -> None:
    swapped = (x - y * z).substitute({"x": y, "y": x, "z": 3.0})
    assert swapped == y - x * 3.0


def test_simplify_folds_constants() -> None:
    assert str((x * 0 + y * 1 + ph.cos(Expr(0))).simplify()) in ("y + 1", "1 + y")


# ---------------------------------------------------------------- derivatives


@pytest.mark.parametrize(
    ("expression", "derivative"),
    [
        (x * y, lambda x, y: y),
        (x / y, lambda x, y: 1 / y),
        (x**3, lambda x, y: 3 * x**2),
        (x**2.5, lambda x, y: 2.5 * x**1.5),
        (2**x, lambda x, y: math.log(2) * 2**x),
        (x**x, lambda x, y: x**x * (math.log(x) + 1)),
        (ph.sin(x * y), lambda x, y: y * math.cos(x * y)),
        (ph.atan2(y, x), lambda x, y: -y / (x * x + y * y)),
        (abs(x), lambda x, y: 1.0),
        (ph.sign(x), lambda x, y: 0.0),
        (ph.maximum(x, y), lambda x, y: 1.0),
        (ph.minimum(x, y), lambda x, y: 0.0),
        (ph.where(x > 0, x**2, y), lambda x, y: 2 * x),
        (y**2, lambda x, y: 0.0),
    ],
)
def test_derivative_is_exact(expression: Expr, derivative: Callable[[float, float], float]) -> None:
    at = {"x": 0.6, "y": -1.7}
    assert expression.diff("x").evaluate(at) == pytest.approx(derivative(**at), rel=4e-16, abs=0)
    assert expression.diff(x) == expression.diff("x")


def test_whole_power_of_a_negative_base_can_be_differentiated() -> None:
    assert (x**3).diff(x).evaluate(x=-2.0) == 12.0


def test_second_derivative() -> None:
    assert (ph.exp(x * y)).diff(x).diff(y).evaluate(x=1.0, y=0.0) == 1.0


def test_derivative_with_respect_to_no_symbol_is_refused() -> None:
    with pytest.raises(TypeError, match=r"'x\*y' is not a symbol"):
        (x * y).diff(x * y)


# ---------------------------------------------------------------- random expressions

Tree = Any  # ("x",), ("y",), a number, or (operation, tree, ...)

# Operations that are smooth and of bounded growth, each for expressions and for complex numbers alike.
SMOOTH: dict[str, tuple[int, Callable[..., Any]]] = {
    "add": (2, operator.add),
    "sub": (2, operator.sub),
    "mul": (2, operator.mul),
    "div": (2, lambda a, b: a / (2 + np.cos(b))),
    "neg": (1, operator.neg),
    "square": (1, lambda a: a**2),
    "cube": (1, lambda a: np.sin(a) ** 3),
    "sin": (1, np.sin),
    "cos": (1, np.cos),
    "tanh": (1, np.tanh),
    "arctan": (1, lambda a: np.arctan(np.tanh(a))),
    "exp": (1, lambda a: np.exp(np.sin(a))),
    "log": (1, lambda a: np.log(2 + np.sin(a))),
    "sqrt": (1, lambda a: np.sqrt(2 + np.sin(a))),
}


def trees(operations: dict[str, Any]) -> st.SearchStrategy[Tree]:
    numbers = st.floats(-2, 2, allow_subnormal=False).map(float)
    leaves = st.one_of(st.sampled_from([("x",), ("y",)]), numbers)

    def grown(smaller: st.SearchStrategy[Tree]) -> st.SearchStrategy[Tree]:
        return st.one_of(*(st.tuples(st.just(name), *[smaller] * arity) for name, (arity, _) in operations.items()))

    return st.recursive(leaves, grown, max_leaves=8)


def build(tree: Tree, operations: dict[str, Any], symbols: dict[str, Any]) -> Any:
    if not isinstance(tree, tuple):
        return tree
    if len(tree) == 1:
        return symbols[tree[0]]
    return operations[tree[0]][1](*(build(part, operations, symbols) for part in tree[1:]))


ARITHMETIC = {name: SMOOTH[name] for name in ("add", "sub", "mul", "neg")} | {"div": (2, operator.truediv)}
point = st.fixed_dictionaries({"x": st.floats(-2, 2), "y": st.floats(-2, 2)})


@given(tree=trees(ARITHMETIC), at=point)
@settings(deadline=None, max_examples=300)
def test_arithmetic_has_the_bits_of_python(tree: Tree, at: dict[str, float]) -> None:
    try:
        expected = build(tree, ARITHMETIC, at)
    except ZeroDivisionError:
        return
    try:
        expression = Expr(0) + build(tree, ARITHMETIC, {"x": x, "y": y})
    except ZeroDivisionError:  # among numbers alone
        return
    except ph.ModelError as error:  # numbers alone that overflow are refused
        assert "is not finite" in str(error)
        return
    assert expression.evaluate(at) == expected or math.isnan(expected)


@given(tree=trees(SMOOTH), at=point)
@settings(deadline=None, max_examples=300)
def test_derivative_matches_the_complex_step(tree: Tree, at: dict[str, float]) -> None:
    expression = Expr(0) + build(tree, SMOOTH, {"x": x, "y": y})
    step = 1e-30
    for name in at:
        moved: dict[str, Any] = {**at, name: at[name] + 1j * step}
        exact = complex(build(tree, SMOOTH, moved)).imag / step
        size = abs(complex(build(tree, SMOOTH, dict(at)))) + abs(exact)
        assert expression.diff(name).evaluate(at) == pytest.approx(exact, rel=1e-12, abs=1e-11 * (1 + size))


@given(tree=trees(SMOOTH), at=point)
@settings(deadline=None, max_examples=100)
def test_order_of_differentiation_does_not_matter(tree: Tree, at: dict[str, float]) -> None:
    expression = Expr(0) + build(tree, SMOOTH, {"x": x, "y": y})
    xy, yx = expression.diff("x").diff("y").evaluate(at), expression.diff("y").diff("x").evaluate(at)
    assert xy == pytest.approx(yx, rel=1e-11, abs=1e-9)


# ---------------------------------------------------------------- pickling

SAMPLE = ph.where(x > 0, ph.sin(x) * Table("CL", [0.0, 0.5, 1.0], [0.0, 0.4, 0.5])(x), y**2) / 3


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_expression_survives_pickling(protocol: int) -> None:
    again = pickle.loads(pickle.dumps(SAMPLE, protocol))
    assert again == SAMPLE
    assert hash(again) == hash(SAMPLE)
    assert value(again) == value(SAMPLE)


def test_expression_survives_deepcopy() -> None:
    assert copy.deepcopy(SAMPLE) == SAMPLE


def test_expression_goes_to_another_process_and_back() -> None:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(operator.mul, SAMPLE, 2).result(timeout=60) == SAMPLE * 2


def test_table_survives_pickling() -> None:
    table = Table("Cm", ([0.0, 1.0, 2.0], [0.0, 1.0]), [[0.0, 1.0], [2.0, 5.0], [3.0, 3.0]])
    again = pickle.loads(pickle.dumps(table))
    assert (again.name, again(0.3, 0.7)) == ("Cm", table(0.3, 0.7))


def test_damaged_saved_expression_is_refused() -> None:
    with pytest.raises(ValueError):
        _core.load_expression(SAMPLE.to_json()[:-5])


# ---------------------------------------------------------------- SymPy

X, Y = sympy.symbols("x y", real=True)


@pytest.mark.parametrize(
    "expression",
    [
        X + 2 * Y - 3,
        X * Y / (1 + X**2),
        sympy.sqrt(1 + X**2) ** 3,
        sympy.Rational(1, 3) * X,
        sympy.pi * X + sympy.E,
        sympy.exp(X) * sympy.log(2 + Y**2),
        sympy.sin(X) * sympy.cos(Y) + sympy.tan(X),
        sympy.cot(X) + sympy.sec(X) + sympy.csc(X),
        sympy.asin(X / 2) + sympy.acos(X / 2) + sympy.atan(Y),
        sympy.atan2(Y, X),
        sympy.sinh(X) + sympy.cosh(Y) + sympy.tanh(X),
        sympy.Abs(Y) * sympy.sign(Y),
        sympy.Min(X, Y, 1) + sympy.Max(X, Y, -2),
        X ** (2 * Y),
        sympy.Piecewise((X, X > 1), (X**2, X > 0), (Y, True)),
        sympy.Piecewise((X, (X > 0) & (Y < 0)), (Y, True)),
        sympy.Piecewise((X, (X < 0) | sympy.Not(Y > 1)), (Y, True)),
        sympy.sin(X * Y).diff(X, Y),
    ],
)
def test_sympy_expression_keeps_its_value(expression: Any) -> None:
    at = {"x": 0.6, "y": -1.7}
    expected = float(expression.subs({X: at["x"], Y: at["y"]}))
    assert ph.from_sympy(expression).evaluate(at) == pytest.approx(expected, rel=1e-14)


def test_sympy_number_becomes_a_number() -> None:
    assert ph.from_sympy(sympy.pi) == math.pi
    assert ph.from_sympy(sympy.Rational(1, 4)) == 0.25


def test_sympy_symbols_can_be_mapped_to_expressions() -> None:
    assert ph.from_sympy(X + 1, {"x": ph.sin(z)}).evaluate(z=0.0) == 1.0


def test_sympy_matrix_becomes_an_array() -> None:
    array = ph.from_sympy(sympy.Matrix([[X, 1], [Y, X * Y]]))
    assert array.shape == (2, 2)
    assert (array[0, 0], array[1, 0]) == (x, y)


@pytest.mark.parametrize(
    ("expression", "words"),
    [
        (sympy.gamma(X), "SymPy's gamma has no counterpart"),
        (sympy.asinh(X), "SymPy's asinh .* Did you mean 'sinh'"),
        (sympy.Function("thrust")(X), "SymPy's thrust has no counterpart"),
        (sympy.Function("f")(X).diff(X), "SymPy's Derivative"),
        (sympy.Piecewise((X, X > 0)), "no value outside its pieces; add a last one with True"),
        (sympy.I * X, "holds I, which is not a finite real number"),
        (sympy.oo, "is not a finite real number"),
        (3, "3 is a int, not a SymPy expression"),
        ("x + 1", "is a str, not a SymPy expression"),
    ],
)
def test_sympy_refuses(expression: Any, words: str) -> None:
    with pytest.raises(ModelError, match=words):
        ph.from_sympy(expression)
