"""log1p, expm1 and hypot keep their digits near 0 and do not overflow on the way."""

from __future__ import annotations

import math

import numpy as np
import pytest

import phugoid as ph
from phugoid._core import Expr

X = Expr.symbol("x")
FUNCTIONS = [(ph.log1p, np.log1p, math.log1p), (ph.expm1, np.expm1, math.expm1)]


@pytest.mark.parametrize(("ours", "ufunc", "exact"), FUNCTIONS)
@pytest.mark.parametrize("x", [1e-300, 1e-20, -1e-9, 0.3, -0.7, 5e-324, 30.0])
def test_values_near_zero(ours, ufunc, exact, x: float) -> None:  # type: ignore[no-untyped-def]
    for value in (ours(x), ours(X).evaluate(x=x), ufunc(X).evaluate(x=x), ufunc(np.array([X]))[0].evaluate(x=x)):
        assert value == pytest.approx(exact(x), rel=1e-15, abs=0)


@pytest.mark.parametrize("x", [1e155, 1e-200, 1e308, 2.0])
def test_hypot_does_not_overflow(x: float) -> None:
    y = Expr.symbol("y")
    for form in (ph.hypot(X, y), np.hypot(X, y), np.hypot(np.array([X]), y)[0], X.hypot(y)):
        assert form.evaluate(x=x, y=0.75 * x) == pytest.approx(1.25 * x, rel=1e-15)
        assert form.diff("x").evaluate(x=x, y=0.75 * x) == pytest.approx(0.8, rel=1e-14)
        assert form.diff("y").evaluate(x=x, y=0.75 * x) == pytest.approx(0.6, rel=1e-14)


def test_derivatives_are_exact() -> None:
    assert ph.log1p(X).diff("x").evaluate(x=0.25) == 0.8
    assert ph.expm1(X).diff("x").evaluate(x=0.25) == pytest.approx(math.exp(0.25), rel=1e-15)
