"""Dry friction so strong that the motion without it is another one: it is found, however many iterations that takes."""

from __future__ import annotations

import numpy as np

import phugoid as ph
from phugoid.discrepancy.search.refit import refit
from phugoid.sensitivities.linearised import Linearised

T = 0.02 * np.arange(700)
FRICTION = 7.0


def motor() -> ph.Model:
    m = ph.Model("motor")
    i, w = m.states(i="A", w="rad/s")
    (u,) = m.inputs(u="V")
    r, e, a, f = m.parameters(r=4.0, e=1.0, a=8.0, f=0.5)
    m.dynamics(i=2.0 * u - r * i - e * w, w=a * i - f * w)
    m.outputs(i=i, w=w)
    return m


def record(seed: int) -> ph.Experiment:
    """A motor that sticks where its torque is less than the friction, by steps of 0.4 ms."""
    rng = np.random.default_rng(seed)
    u = 3.0 * np.sin((0.9 + 0.1 * seed) * T) + 2.0 * np.sin(2.3 * T + seed)
    i = w = 0.0
    rows, fine, h = [], 50, 0.02 / 50
    for k in range(T.size):
        rows.append((i, w))
        for j in range(fine):
            now = u[k] + (u[min(k + 1, T.size - 1)] - u[k]) * j / fine
            torque = 8.0 * i - 0.5 * w
            free = w + h * torque
            i += h * (2.0 * now - 4.0 * i - w)
            w = np.sign(free) * max(abs(free) - h * FRICTION, 0.0)
    y = np.array(rows) + np.array([0.03, 0.05]) * rng.standard_normal((T.size, 2))
    return ph.Experiment(T, {"u": u}, {"i": y[:, 0], "w": y[:, 1]}, name=f"run {seed}")


def test_strong_friction_is_fitted_and_named() -> None:
    fit = ph.estimate(motor(), record(1))
    points = Linearised(fit).points
    friction = next(c for c in ph.candidates(fit.model, points=points) if c.name == "w':sign(w)")
    alone = refit(fit, [friction], {}, points=points)
    assert alone is not None
    estimate = alone.fit.parameters[friction.parameters[0]]
    assert abs(estimate.value + FRICTION) < 0.02 * FRICTION
    d = ph.diagnose(fit, validation=record(2))
    assert d.findings[0].cause == "w':sign(w)" and d.findings[0].status == "named"
    assert d.findings[0].explained > 0.95
