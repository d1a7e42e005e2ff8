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


def test_a_power_of_zero_with_a_variable_exponent_has_finite_derivatives() -> None:
    """Hill's equation of a state that begins at zero, with an exponent that is estimated."""
    n = Expr.symbol("n")
    power = X**n
    for exponent in (0.6, 1.0, 1.5, 2.0, 3.0):
        at = {"x": 0.0, "n": exponent}
        assert power.diff("n").evaluate(**at) == 0.0
        for first in ("x", "n"):
            for second in ("x", "n"):
                assert math.isfinite(power.diff(first).diff(second).evaluate(**at)), (first, second, exponent)
        if exponent >= 1.0:
            assert power.diff("x").evaluate(**at) == (1.0 if exponent == 1.0 else 0.0)
    away = {"x": 1.3, "n": 2.5}
    assert power.diff("x").evaluate(**away) == pytest.approx(2.5 * 1.3**1.5, rel=1e-14)
    assert power.diff("n").evaluate(**away) == pytest.approx(1.3**2.5 * math.log(1.3), rel=1e-14)
    assert power.diff("n").diff("x").evaluate(**away) == pytest.approx(
        2.5 * 1.3**1.5 * math.log(1.3) + 1.3**1.5, rel=1e-14
    )


def test_a_hill_equation_is_fitted_from_a_state_that_begins_at_zero() -> None:
    m = ph.Model("expression")
    p, g = m.states(p="nM", g="nM")
    a, k, n = m.parameters(a=1.0, K=4.0, n=1.0)
    m.dynamics(p=a - 0.25 * p, g=p**n / (k**n + p**n) - 0.25 * g)
    m.outputs(p=p, g=g)
    m.initial(p=0.0, g=0.0)
    t = np.linspace(0.0, 20.0, 41)
    run = ph.Experiment(t, {}, {"p": t, "g": t})
    y = ph.simulate(m, {"a": 1.5, "K": 2.5, "n": 2.2}, run).outputs
    rng = np.random.default_rng(1)
    run = run.with_outputs({name: y[name] + 0.002 * rng.standard_normal(t.size) for name in ("p", "g")})
    for begin in (0.6, 1.0, 2.5, 3.0):
        fit = ph.estimate(m, run, start={"n": begin})
        assert fit.status == "converged"
        assert fit.parameters["n"].value == pytest.approx(2.2, abs=5.0 * fit.parameters["n"].std_error)
