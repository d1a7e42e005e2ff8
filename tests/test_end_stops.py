"""Positions that may meet an end stop: where a candidate for one is offered, and where none is; and what is estimated
of one that bounces and of one that does not."""

from __future__ import annotations

import numpy as np
import pytest
from hidden import SYSTEMS

import phugoid as ph
from phugoid.discrepancy.candidates.limits import EndStop
from phugoid.discrepancy.search.refit import Refit, refit


@pytest.mark.parametrize(
    ("system", "limits"),
    [("duffing", ["x:limit"]), ("servo", ["angle:limit"]), ("hfb320", []), ("lateral", []), ("uav", [])],
)
def test_positions_have_stops_and_attitudes_have_none(system: str, limits: list[str]) -> None:
    names = ph.candidates(SYSTEMS[system].model()).names
    assert [n for n in names if n.endswith(":limit")] == limits


def test_a_stop_acts_where_the_force_stands() -> None:
    """An accelerometer on what meets the stop feels it."""
    model = SYSTEMS["duffing"].model()
    extended = ph.candidates(model)["x:limit"].extended(model)
    assert "limit_of_x" in extended.quantity_expressions()["f"].symbols


def test_a_pendulum_has_no_stop() -> None:
    m = ph.Model("pendulum")
    phi, w = m.states(phi="rad", w="rad/s")
    k, c = m.parameters("k c")
    m.dynamics(phi=w, w=-k * ph.sin(phi) - c * w)
    m.outputs(phi=phi)
    assert not [n for n in ph.candidates(m).names if n.endswith(":limit")]


LIMIT, SPRING, DAMPING = 0.45, 2.2, 0.35


def oscillator() -> ph.Model:
    m = ph.Model("oscillator")
    (u,), (x, v) = m.inputs("u"), m.states(x="m", v="m/s")
    k, d, b = m.parameters(k=2.0, d=0.4, b=1.0)
    m.dynamics(x=v, v=b * u - k * x - d * v)
    m.outputs(x=x)
    return m


STIFFNESS, LOSS = 150.0, 0.5


def stopped(rigid: bool) -> ph.Experiment:
    """A mass that comes to rest at a rigid stop, or that an elastic one with losses gives back a part of its speed."""
    rng, steps, step, n = np.random.default_rng(3), 20, 0.04, 600
    t = step * np.arange(n)
    u = sum(a * np.sin(w * t + p) for a, w, p in zip((0.7, 0.5, 0.6), (0.7, 1.3, 1.9), (0.0, 2.0, 4.0), strict=True))
    x, v, path = 0.0, 0.0, []
    for i in range(n):
        path.append(x)
        for j in range(steps if i + 1 < n else 0):
            push = 0.0 if rigid else max(STIFFNESS * max(x - LIMIT, 0.0) * (1.0 + LOSS * v), 0.0)
            v += step / steps * (u[i] + (u[i + 1] - u[i]) * j / steps - SPRING * x - DAMPING * v - push)
            x += step / steps * v
            if rigid and x >= LIMIT and v > 0.0:
                x, v = LIMIT, 0.0
    return ph.Experiment(t, {"u": u}, {"x": np.array(path) + 0.004 * rng.standard_normal(n)})


@pytest.mark.parametrize("rigid", [True, False])
def test_a_stop_is_estimated(rigid: bool) -> None:
    """Begin at the measured motion where the mass rests: the path of a fit without the stop goes where it cannot."""
    base = Refit((), ph.estimate(oscillator(), stopped(rigid)))
    points = base.linear.points
    stop = ph.candidates(oscillator(), points=points)["x:limit"]
    assert isinstance(stop, EndStop)
    stiffness, limit, loss = stop.parameters
    found = refit(base.fit, [stop], {limit: 0.97 * LIMIT}, measured=rigid)
    assert found is not None and found.merit > base.merit + 100.0
    values = {n: found.fit.parameters[n].value for n in ("k", *stop.parameters)}
    assert values["k"] == pytest.approx(SPRING, rel=0.05) and values[limit] == pytest.approx(LIMIT, abs=0.06)
    if not rigid:
        assert values[stiffness] == pytest.approx(STIFFNESS, rel=0.2) and values[loss] == pytest.approx(LOSS, abs=0.2)
    for name, (low, high) in stop.physical(points).items():
        assert low <= values[name] <= high


def test_samples_that_crowd_suggest_a_stop() -> None:
    base = Refit((), ph.estimate(oscillator(), stopped(True)))
    stop = ph.candidates(oscillator(), points=base.linear.points)["x:limit"]
    suggested = stop.suggested({"x": [stopped(True).output("x")]})
    assert suggested == {"limit_of_x": pytest.approx(LIMIT, abs=0.02)}
    assert stop.suggested({"x": [np.sin(0.1 * np.arange(600.0))]}) is None
