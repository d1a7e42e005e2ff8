"""The short period of an aircraft, and records of it with an effect that its model does not have."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import phugoid as ph

T = np.arange(0.0, 20.0, 0.04)


def model() -> ph.Model:
    m = ph.Model("short period")
    (de,), (a, q) = m.inputs(de="rad"), m.states(alpha="rad", q="rad/s")
    za, ma, mq, md = m.parameters(za=-1.0, ma=-5.0, mq=-1.0, md=-8.0)
    m.dynamics(alpha=za * a + q, q=ma * a + mq * q + md * de)
    m.outputs(alpha=a, q=q)
    return m


def elevator(rng: np.random.Generator, size: float) -> np.ndarray:
    """Return steps of a second between ``-size`` and ``size``, rad."""
    return size * np.repeat(rng.uniform(-1.0, 1.0, 30), 25)[: T.size]


def record(
    seed: int, rng: np.random.Generator, de: np.ndarray, slope: Callable[[float, np.ndarray], np.ndarray]
) -> ph.Experiment:
    """Return a noisy record of the motion whose state equations ``slope`` gives."""
    x = np.zeros((T.size, 2))
    for k, t in enumerate(T[:-1]):
        h = T[k + 1] - t
        k1 = slope(t, x[k])
        k2 = slope(t + h / 2, x[k] + h / 2 * k1)
        k3 = slope(t + h / 2, x[k] + h / 2 * k2)
        x[k + 1] = x[k] + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(t + h, x[k] + h * k3))
    y = x + np.array([0.003, 0.004]) * rng.standard_normal(x.shape)
    return ph.Experiment(T, {"de": de}, {"alpha": y[:, 0], "q": y[:, 1]}, name=f"record {seed}")
