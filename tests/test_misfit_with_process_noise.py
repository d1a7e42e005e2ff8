"""The misfit of fits with process noise: a right model raises no alarm, a wrong one does."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import phugoid as ph

T = 0.05 * np.arange(400)
U = np.sign(np.sin(0.7 * T))
Signal = NDArray[np.float64]


def driven(seed: int) -> tuple[Signal, np.random.Generator]:
    """A lag of 1 s behind its input and behind noise of 0.5/√s."""
    rng, x, steps = np.random.default_rng(seed), np.zeros(T.size), 10
    d = (T[1] - T[0]) / steps
    for k in range(T.size - 1):
        x[k + 1] = x[k]
        for j in range(steps):
            u = U[k] + j / steps * (U[k + 1] - U[k])
            x[k + 1] += d * (u - x[k + 1]) + 0.5 * np.sqrt(d) * rng.standard_normal()
    return x, rng


def fitted(z: Signal) -> ph.Fit:
    m = ph.Model("lag")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, b = m.parameters(a=1.0, b=1.0)
    m.dynamics(x=-a * x + b * u)
    m.outputs(x=x)
    return ph.estimate(m, ph.Experiment(T, {"u": U}, {"x": z}, name="run"), transcription=ph.FilterError(("x",)))


def noisy(seed: int, sparse: bool) -> Signal:
    x, rng = driven(seed)
    z: Signal = x + 0.05 * rng.standard_normal(T.size)
    if sparse:  # the second half is read at every fourth sample, and predicted the less well
        z[(T > 10.0) & (np.arange(T.size) % 4 != 0)] = np.nan
    return z


@pytest.mark.parametrize("sparse", [False, True], ids=["every sample", "fewer samples later"])
def test_a_right_model_raises_no_alarm(sparse: bool) -> None:
    """Each of half a dozen claims may be false once in a thousand records."""
    alarms = [m.summary() for seed in range(20) if (m := ph.misfit(fitted(noisy(seed, sparse)))).structured]
    assert len(alarms) <= 1, alarms


def test_a_wrong_model_raises_one() -> None:
    """The sensor has a hum of 1 Hz, which no process noise in the state explains."""
    m = ph.misfit(fitted(noisy(0, False) + 0.3 * np.sin(2.0 * np.pi * T)))
    assert m.channels["x"].coloured and m.structured


def test_what_is_predicted_is_there_and_saved(tmp_path: object) -> None:
    """An innovation is what is measured less what the predicted states give: here the state itself is the output."""
    z = noisy(1, True)
    fit = fitted(z)
    (record,) = fit.records
    there = np.isfinite(z)
    np.testing.assert_allclose((z - record.innovations["x"])[there], record.predicted_states["x"][there], atol=1e-9)
    fit.save(f"{tmp_path}/fit.json")
    again = ph.load(f"{tmp_path}/fit.json")
    np.testing.assert_array_equal(again.records[0].predicted_states["x"], record.predicted_states["x"])
    assert ph.misfit(again).summary() == ph.misfit(fit).summary()


def test_the_match_is_that_of_the_prediction() -> None:
    """The most probable path follows the measurements, and its residuals are not white though the model is right."""
    fit = fitted(noisy(2, False))
    (record,) = fit.records
    m = ph.match(fit.records, "x")
    assert m.rms == pytest.approx(float(np.sqrt(np.mean(record.innovations["x"] ** 2))))
    assert m.whiteness > 0.01 and abs(m.lag_one) < 0.15
    assert "RMS innovation" in fit.summary() and f"{m.rms:.4g}" in fit.summary()
