"""Simulations that are stiff, that jump, or that take long: right answers, or the true reason why there is none."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import phugoid as ph

T = np.linspace(0.0, 4.0, 41)


def scalar(f: Callable[..., Any], a: float, t: np.ndarray = T, x0: float = 1.0, **options: Any) -> np.ndarray:
    """x of x' = f(x, a, t)."""
    m = ph.Model("scalar")
    (x,) = m.states("x")
    (p,) = m.parameters("a")
    m.dynamics(x=f(x, p, m.time))
    m.outputs(x=x)
    return ph.simulate(m, {"a": a}, ph.Experiment(t, name="run"), initial={"x": x0}, **options).states["x"]


def robertson(t: np.ndarray, **options: Any) -> ph.results.Record:
    m = ph.Model("Robertson")
    a, b, c = m.states("a b c")
    m.dynamics(a=-0.04 * a + 1e4 * b * c, b=0.04 * a - 1e4 * b * c - 3e7 * b**2, c=3e7 * b**2)
    m.outputs(a=a)
    return ph.simulate(m, {}, ph.Experiment(t), initial={"a": 1.0, "b": 0.0, "c": 0.0}, **options)


def test_a_state_is_as_exact_at_the_start_of_a_long_record() -> None:
    """b and c start at 0: how large they are must not be told from how far they would go in all that time."""
    decades = np.r_[0.0, 0.4 * 10.0 ** np.arange(12)]
    long, short = robertson(decades), robertson(decades[:4])
    rough = robertson(decades, rtol=1e-6)
    for name in "abc":
        np.testing.assert_allclose(long.states[name][:4], short.states[name], rtol=1e-9)
        np.testing.assert_allclose(rough.states[name][:8], long.states[name][:8], rtol=1e-5)


def test_robertson() -> None:
    r = robertson(np.array([0.0, 0.4, 4.0, 40.0, 400.0, 4000.0, 4e4]))
    # Hindmarsh, ODEPACK: the output of the example of LSODE, confirmed by Radau at a tolerance of 1e-11.
    known = {
        "a": [9.851721e-01, 9.055187e-01, 7.158271e-01, 4.505187e-01, 1.832023e-01, 3.898338e-02],
        "b": [3.386395e-05, 2.240476e-05, 9.185535e-06, 3.222901e-06, 8.942371e-07, 1.621768e-07],
    }
    for name, values in known.items():
        np.testing.assert_allclose(r.states[name][1:], values, rtol=1e-6)


@pytest.mark.parametrize("rate", [1e6, 1e12, 1e18])
def test_fast_decay(rate: float) -> None:
    x = scalar(lambda x, a, t: -a * (x - ph.cos(t)), rate)
    slow = rate**2 / (1 + rate**2) * np.cos(T[1:]) + rate / (1 + rate**2) * np.sin(T[1:])
    np.testing.assert_allclose(x[1:], slow, rtol=0, atol=1e-8)


def test_both_methods_agree_where_it_is_not_stiff() -> None:
    f = lambda x, a, t: -a * ph.sin(x) + ph.cos(3 * t)  # noqa: E731
    explicit, implicit, either = (scalar(f, 2.0, method=m) for m in ("DOP853", "Radau", "auto"))
    np.testing.assert_allclose(implicit, explicit, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(either, explicit)


def test_a_relay_that_is_passed() -> None:
    m = ph.Model("bang-bang")
    x, v = m.states("x v")
    m.dynamics(x=v, v=ph.where(x > 0, -1.0, 1.0))
    m.outputs(x=x)
    quarter = np.sqrt(2.0)
    r = ph.simulate(m, {}, ph.Experiment(quarter * np.arange(9)), initial={"x": 1.0, "v": 0.0})
    np.testing.assert_allclose(r.states["x"], [1, 0, -1, 0, 1, 0, -1, 0, 1], rtol=0, atol=1e-7)


@pytest.mark.parametrize("push", [0.0, 0.3])
def test_a_relay_that_slides_is_named(push: float) -> None:
    with pytest.raises(ph.EvaluationError, match=r"ends at t = 1(\.\d*)? of 4: the equation of x' jumps back and"):
        scalar(lambda x, a, t: a * ph.where(x > 0, -1.0, 1.0) + push * ph.sin(t), 1.0)


def test_growth_without_limit_is_named() -> None:
    with pytest.raises(ph.EvaluationError, match=r"ends at t = 1 of 4: the solution grows without limit"):
        scalar(lambda x, a, t: a * x**2, 1.0)


def test_a_time_limit() -> None:
    t = np.arange(200_001) * 0.01
    began = time.monotonic()
    with pytest.raises(ph.EvaluationError, match="the time limit was reached"):
        scalar(lambda x, a, t: a * ph.cos(50 * t), 1.0, t, time_limit=0.05)
    assert time.monotonic() - began < 0.6


@pytest.mark.parametrize("limit", [-1.0, float("nan"), "1 min"])
def test_what_is_no_time(limit: object) -> None:
    with pytest.raises(ph.OptionError, match="time_limit is a number of seconds from 0"):
        scalar(lambda x, a, t: -a * x, 1.0, time_limit=limit)


@pytest.mark.skipif(sys.platform == "win32", reason="signals as POSIX has them")
def test_ctrl_c() -> None:
    t = np.arange(2_000_001) * 0.01
    timer = threading.Timer(0.7, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        scalar(lambda x, a, t: a * ph.cos(50 * t), 1.0, t)
    timer.join()
    assert time.monotonic() - began < 1.5
