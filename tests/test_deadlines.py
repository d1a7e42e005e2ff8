"""A time limit holds everywhere: whatever a fit does when it passes, it ends soon, with the best point so far."""

from __future__ import annotations

import math
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

# On a machine that others share, the wall clock goes on while this process waits: what is told of a deadline by the
# wall alone fails by chance. So the overshoot is the lesser of wall and processor time that went by after the limit,
# and may be so much (s); what a result needs of a long record is within it, and without a limit many parameters take
# minutes. The wall alone tells of a run that hangs.
_SLACK, _HANGS = 1.0, 30.0


def oscillator(n: int) -> tuple[ph.Model, ph.Experiment]:
    m = ph.Model("oscillator")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    k, d, b = m.parameters(k=2.0, d=0.3, b=1.0)
    m.dynamics(x=v, v=-k * x - d * v + b * u + 0.1 * k * x**3)
    m.outputs(x=x, v=v)
    t = np.arange(n) * 0.01
    noise = 0.01 * np.random.default_rng(0).standard_normal((2, n))
    outputs = {"x": np.sin(t) + noise[0], "v": np.cos(t) + noise[1]}
    return m, ph.Experiment(t, {"u": np.sin(t) * np.sign(np.sin(0.37 * t))}, outputs, name="long")


def many_parameters(p: int, n: int) -> tuple[ph.Model, ph.Experiment]:
    m = ph.Model("many")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    rhs = -x
    for i, a in enumerate(m.parameters(**{f"p{i}": 0.0 for i in range(p)})):
        rhs = rhs + a * ph.sin((i + 1) * 0.01 * u)
    m.dynamics(x=rhs)
    m.outputs(x=x)
    rng = np.random.default_rng(0)
    t = np.arange(n) * 0.01
    return m, ph.Experiment(t, {"u": rng.standard_normal(n)}, {"x": rng.standard_normal(n)}, name="wide")


def overshoot(limit: float, work: Callable[[], Any]) -> tuple[Any, float]:
    """Return what work gives, and the seconds that it went on after the limit."""
    at_limit: list[float] = []
    timer = threading.Timer(min(limit, threading.TIMEOUT_MAX), lambda: at_limit.append(time.process_time()))
    began = time.monotonic()
    timer.start()
    found = work()
    wall, processor = time.monotonic() - began, time.process_time()
    timer.cancel()
    timer.join()
    assert wall < limit + _HANGS
    return found, min(wall - limit, processor - (at_limit or [processor])[0])


def timed(model: ph.Model, data: ph.Experiment, limit: float, **options: Any) -> tuple[ph.results.Fit, float]:
    return overshoot(limit, lambda: ph.estimate(model, data, solver=ph.Newton(time_limit=limit), **options))


def test_no_time_gives_the_start() -> None:
    model, data = oscillator(60_001)
    fit, seconds = timed(model, data, 0.0)
    assert fit.status == "time limit" and fit.iterations == 0
    assert {n: fit.parameters[n].value for n in "kdb"} == {"k": 2.0, "d": 0.3, "b": 1.0}
    # The path passes through the measurements and satisfies no equation: it has no likelihood.
    assert not fit.feasible and math.isnan(fit.log_likelihood)
    assert "do not satisfy the equations" in fit.warnings[0]
    # What a result needs of a long record: the problem, and its outputs there.
    assert seconds < _SLACK and fit.solution is not None
    counts = fit.solution.evaluations
    assert set(counts.values()) == {0}


@pytest.mark.parametrize("limit", [0.3, 1.0])
def test_many_parameters_end_in_time(limit: float) -> None:
    model, data = many_parameters(500, 1001)
    fit, seconds = timed(model, data, limit)
    assert fit.status == "time limit" and seconds < _SLACK
    assert all(math.isfinite(e.value) for e in fit.parameters.values())


def test_mesh_refinement_and_delays_share_the_time() -> None:
    model, data = oscillator(60_001)
    fit, seconds = timed(model, data, 0.25, transcription=ph.Collocation(refine=True, tolerance=1e-9))
    assert fit.status == "time limit" and seconds < _SLACK
    m = ph.Model("late")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, tau = m.parameters(a=-1.0, tau=0.05)
    m.dynamics(x=a * x + m.delay(u, tau))
    m.outputs(x=x)
    late = ph.Experiment(data.t, {"u": data.input("u")}, {"x": data.output("x")}, name="late")
    fit, seconds = timed(m, late, 0.25)
    assert fit.status == "time limit" and seconds < _SLACK


def test_shooting_ends_in_time() -> None:
    model, data = oscillator(60_001)
    fit, seconds = timed(model, data, 0.3, transcription=ph.SingleShooting())
    assert fit.status == "time limit" and seconds < _SLACK


@pytest.mark.parametrize("limit", [0.0, 0.3])
def test_process_noise_ends_in_time(limit: float) -> None:
    model, data = oscillator(60_001)
    method = ph.FilterError(("x", "v"), time_limit=limit)
    fit, seconds = overshoot(limit, lambda: ph.estimate(model, data, transcription=method))
    assert fit.status == "time limit" and fit.iterations == 0 and seconds < _SLACK
    assert {n: fit.parameters[n].value for n in "kdb"} == {"k": 2.0, "d": 0.3, "b": 1.0}
    assert all(math.isnan(e.std_error) for e in fit.parameters.values())
    if math.isnan(fit.log_likelihood):  # nothing was evaluated: the states are as measured
        assert not fit.feasible and "do not satisfy the equations" in fit.warnings[0]
        np.testing.assert_array_equal(fit.states["x"], data.output("x"))


def test_ipopt_ends_in_time() -> None:
    pytest.importorskip("cyipopt")
    model, data = oscillator(2_001)
    for limit in (0.0, 0.2):
        solver = ph.Ipopt(time_limit=limit)
        fit, seconds = overshoot(limit, lambda by=solver: ph.estimate(model, data, solver=by))
        assert fit.status == "time limit" or fit.converged
        assert seconds < _SLACK


@pytest.mark.parametrize("limit", [1e20, math.inf])
def test_more_time_than_a_clock_can_tell_is_no_limit(limit: float) -> None:
    model, data = oscillator(101)
    assert timed(model, data, limit)[0].status == ph.estimate(model, data).status
    assert ph.simulate(model, {"k": 2.0, "d": 0.3, "b": 1.0}, data, time_limit=limit).n == 101


@pytest.mark.parametrize("limit", [-1.0, math.nan, "1 min", True])
@pytest.mark.parametrize("solver", [ph.Newton, ph.Ipopt])
def test_what_is_no_time(limit: object, solver: Callable[..., object]) -> None:
    with pytest.raises(ph.OptionError, match="time_limit is a number of seconds from 0"):
        solver(time_limit=limit)


def press_after(seconds: float, done: threading.Event) -> threading.Timer:
    """Press Ctrl-C so much later, unless the work is done by then."""
    timer = threading.Timer(seconds, lambda: done.is_set() or os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    return timer


@pytest.mark.skipif(sys.platform == "win32", reason="signals as POSIX has them")
def test_ctrl_c_is_seen_within_an_iteration() -> None:
    model, data = many_parameters(500, 1001)
    done = threading.Event()
    timers = press_after(0.5, done), press_after(0.7, done)  # the second leaves out the standard errors
    fit, seconds = overshoot(0.7, lambda: ph.estimate(model, data))
    done.set()
    [t.join() for t in timers]
    assert fit.status == "interrupted" and seconds < 2 * _SLACK
