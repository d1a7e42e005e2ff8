"""Gusts in the records: process noise, also where they bias the parameters of the model that knows of none."""

from __future__ import annotations

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


def record(seed: int, gust: float) -> ph.Experiment:
    """``gust``: standard deviation of the angle of attack by gusts, rad."""
    rng = np.random.default_rng(seed)
    de = 0.05 * np.repeat(rng.uniform(-1.0, 1.0, 30), 25)[: T.size]
    wind = np.zeros(T.size)
    keep = float(np.exp(-0.04 / 0.8))
    for k in range(1, T.size):
        wind[k] = keep * wind[k - 1] + gust * np.sqrt(1.0 - keep**2) * rng.standard_normal()

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        air = x[0] + np.interp(t, T, wind)
        return np.array([-1.1 * air + x[1], -6.0 * air - 1.6 * x[1] - 9.0 * np.interp(t, T, de)])

    x = np.zeros((T.size, 2))
    for k, t in enumerate(T[:-1]):
        h = T[k + 1] - t
        k1 = slope(t, x[k])
        k2 = slope(t + h / 2, x[k] + h / 2 * k1)
        k3 = slope(t + h / 2, x[k] + h / 2 * k2)
        x[k + 1] = x[k] + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(t + h, x[k] + h * k3))
    y = x + np.array([0.003, 0.004]) * rng.standard_normal(x.shape)
    return ph.Experiment(T, {"de": de}, {"alpha": y[:, 0], "q": y[:, 1]}, name=f"record {seed}")


def test_gusts_that_bias_the_parameters_are_named() -> None:
    """With the biased parameters the other record spoke against gusts, and the diagnosis ended as unexplained."""
    for seed in (2, 3):
        fit = ph.estimate(model(), record(seed, 0.012))
        d = ph.diagnose(fit, validation=record(seed + 10, 0.012))
        (f,) = [f for f in d.findings if f.status == "named"]
        assert f.cause in ("alpha':noise", "q':noise"), d.summary()
        assert f.held_out_gain > 0.0 and "FilterError" in f.advice
