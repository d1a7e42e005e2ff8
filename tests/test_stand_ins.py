"""Terms that stand in for something that no candidate describes, and what tells a motion from noise of a sensor."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search.motion import is_motion, persistence
from phugoid.discrepancy.search.refit import Refit
from phugoid.discrepancy.search.stand_ins import StandInSettings
from phugoid.residual_noise.whitening import Whitening

STEP, LASTING = 0.01, 0.5
T = np.arange(0.0, 40.0, STEP)


def oscillator(cubic: float) -> ph.Model:
    m = ph.Model("oscillator")
    (u,), (x, v) = m.inputs("u"), m.states(x="m", v="m/s")
    k, c = m.parameters(k=1.0, c=0.3)
    m.dynamics(x=v, v=u - k * x - c * v - cubic * x**3)
    m.outputs(x=x)
    return m


def fitted(cubic: float, coloured: bool, every: int) -> Refit:
    """A linear oscillator fitted to one that may be stiffer where it is far out, with one sample in ``every``."""
    rng = np.random.default_rng(2)
    u = 1.5 * np.sin(0.8 * T + 0.004 * T**2)
    record = ph.Experiment(T, {"u": u}, {})
    x = ph.simulate(oscillator(cubic), {"k": 1.0, "c": 0.3}, record, initial={"x": 0.0, "v": 0.0})
    noise = 0.02 * rng.standard_normal(T.size)
    if coloured:
        keep = float(np.exp(-STEP / LASTING))
        for i in range(1, T.size):
            noise[i] = keep * noise[i - 1] + np.sqrt(1.0 - keep**2) * noise[i]
    y = x.outputs["x"] + noise
    return Refit((), ph.estimate(oscillator(0.0), ph.Experiment(T[::every], {"u": u[::every]}, {"x": y[::every]})))


def predictable(at: Refit) -> float:
    """The part of the residuals' power that their past predicts from one sample to the next."""
    (channel,) = Whitening.of(at.linear.residuals, at.linear.structure).channels
    return 1.0 - channel.power / float(np.mean(at.linear.residuals**2))


def test_a_motion_is_told_from_coloured_noise_at_any_sampling_rate() -> None:
    least = StandInSettings.persistent
    by_rate = []
    for every in (1, 2, 4):
        motion, noise = fitted(0.2, False, every), fitted(0.0, True, every)
        assert is_motion(motion, least), f"one sample in {every}"
        assert not is_motion(noise, least), f"one sample in {every}"
        by_rate.append([*persistence(motion), *persistence(noise)])
    assert np.ptp(by_rate, axis=0) == pytest.approx(0.0, abs=0.03)
    # What the next sample is predicted to is another thing at each rate, and the noise is well predicted at the first.
    assert predictable(fitted(0.0, True, 1)) > 0.95 > 0.9 > predictable(fitted(0.0, True, 4))
