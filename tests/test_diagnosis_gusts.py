"""Gusts in the records: process noise, also where they bias the parameters of the model that knows of none."""

from __future__ import annotations

import numpy as np
import short_period
from short_period import T, model

import phugoid as ph


def record(seed: int, gust: float) -> ph.Experiment:
    """``gust``: standard deviation of the angle of attack by gusts, rad."""
    rng = np.random.default_rng(seed)
    de = short_period.elevator(rng, 0.05)
    wind = np.zeros(T.size)
    keep = float(np.exp(-0.04 / 0.8))
    for k in range(1, T.size):
        wind[k] = keep * wind[k - 1] + gust * np.sqrt(1.0 - keep**2) * rng.standard_normal()

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        air = x[0] + np.interp(t, T, wind)
        return np.array([-1.1 * air + x[1], -6.0 * air - 1.6 * x[1] - 9.0 * np.interp(t, T, de)])

    return short_period.record(seed, rng, de, slope)


def test_gusts_that_bias_the_parameters_are_named() -> None:
    """With the biased parameters the other record spoke against gusts, and the diagnosis ended as unexplained."""
    for seed in (2, 3):
        fit = ph.estimate(model(), record(seed, 0.012))
        d = ph.diagnose(fit, validation=record(seed + 10, 0.012))
        (f,) = [f for f in d.findings if f.status == "named"]
        assert f.cause in ("alpha':noise", "q':noise"), d.summary()
        assert f.held_out_gain > 0.0 and "FilterError" in f.advice
