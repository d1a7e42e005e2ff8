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


def lagging(seed: int) -> ph.Experiment:
    """A part of the elevator's moment builds up over 1.5 s, which no model without a further state can follow."""
    rng = np.random.default_rng(seed)
    de = short_period.elevator(rng, 0.05)
    late = np.zeros(T.size)
    for k in range(1, T.size):
        late[k] = late[k - 1] + 0.04 / 1.5 * (de[k - 1] - late[k - 1])

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        moment = -9.0 * np.interp(t, T, de) - 6.0 * np.interp(t, T, late)
        return np.array([-1.1 * x[0] + x[1], -6.0 * x[0] - 1.6 * x[1] + moment])

    return short_period.record(seed, rng, de, slope)


def test_dynamics_that_answer_the_inputs_are_not_called_gusts() -> None:
    """Leave out all candidates with a state of their own: the filter-error method follows what the missing one does."""
    fit = ph.estimate(model(), lagging(2))
    with_states = ["lag", "delay", "variation", "step", "drift", "mode", "periodic"]
    known = ph.candidates(fit.model, leave_out=with_states)
    d = ph.diagnose(fit, validation=lagging(12), candidates=known)
    assert d.verdict == "unexplained" and not d.found, d.summary()
    assert "past inputs" in d.findings[0].explanation
