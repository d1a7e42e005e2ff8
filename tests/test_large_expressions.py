"""Expressions with shared parts and long chains are printed, differentiated, converted and named in short texts."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import phugoid as ph
from phugoid._core import Expr


def doubled(levels: int, e: Expr) -> Expr:
    for _ in range(levels):
        e = e * e + e
    return e


def test_shared_parts_are_printed_once_by_a_name_that_is_no_symbol() -> None:
    text = repr(doubled(18, Expr.symbol("a")))
    assert text.startswith("b = a*a + a; c = b*b + b; ")
    assert len(text) < 500
    assert len(doubled(18, Expr.symbol("a"))._repr_latex_()) < 1500


def test_errors_are_short() -> None:
    e = doubled(18, Expr.symbol("a"))
    for _ in range(200):
        e = e + Expr.symbol("a") * 1.2345
    with pytest.raises(TypeError) as caught:
        bool(e)
    assert len(str(caught.value)) < 2000
    with pytest.raises(TypeError) as caught:
        float(e)
    assert len(str(caught.value)) < 2000
    with pytest.raises(ph.ModelError) as error:
        e / 0
    assert len(str(error.value)) < 2000
    with pytest.raises(TypeError) as caught:
        Expr.symbol("a").diff(e)
    assert len(str(caught.value)) < 2000
    for kind in (ph.ModelError, ph.DataError, ph.OptionError, ph.EvaluationError, ph.errors.UnknownName):
        copy = pickle.loads(pickle.dumps(kind("x" * 10_000)))
        assert 1000 < len(str(copy)) <= 2000 and "(10000 characters)" in str(copy)


def test_a_long_chain_of_cases_is_handled() -> None:
    x = Expr.symbol("x")
    e: Expr = 7.0 * x
    for k in range(3000):
        e = ph.where(x > k, k * x, e)
    slope = e.diff("x")
    assert slope.evaluate(x=1500.5) == 1500.0
    assert slope.evaluate(x=-1.0) == 7.0
    assert pickle.loads(pickle.dumps(e)) == e
    assert e.latex() and repr(e) and repr(slope)

    m = ph.Model("chain")
    (state,) = m.states(x="")
    m.dynamics(x=-e)
    m.outputs(y=state)
    assert repr(m)
    assert ph.Model.from_json(m.to_json()).check() is None if hasattr(m, "to_json") else True


def test_sympy_shares_what_it_shares() -> None:
    sympy = pytest.importorskip("sympy")
    e = sympy.Symbol("a")
    for _ in range(18):
        e = sympy.sin(e) * sympy.cos(e)
    converted = ph.from_sympy(e)
    value = 0.7
    for _ in range(18):
        value = np.sin(value) * np.cos(value)
    assert converted.evaluate(a=0.7) == pytest.approx(value)
