"""Linear aircraft whose trim is estimated: products of derivatives and offsets, from start values that are all 0.

There neither factor of a product has influence. A descent in the factors may lead to an offset that grows without limit
while its derivative goes to 0, since a constant is better than nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

import phugoid as ph

SPEED = 60.0  # m/s
SHORT_PERIOD = {
    "A": {"Za": -0.72, "Zd": -0.009, "Ma": -10.9, "Mq": -1.9, "Md": -4.9, "a0": 0.114, "d0": -0.067},
    "B": {"Za": -2.43, "Zd": -0.27, "Ma": -5.3, "Mq": -3.0, "Md": -13.4, "a0": 0.145, "d0": -0.015},
    "C": {"Za": -2.29, "Zd": -0.083, "Ma": -14.7, "Mq": -3.9, "Md": -11.8, "a0": -0.041, "d0": 0.021},
}


def short_period() -> ph.Model:
    """Angle of attack and elevator about their trim, and the normal acceleration."""
    m = ph.Model("short period with trim")
    alpha, q = m.states(alpha="rad", q="rad/s")
    (de,) = m.inputs(de="rad")
    za, zd, ma, mq, md, a0, d0 = m.parameters("Za Zd Ma Mq Md a0 d0")
    lift = za * (alpha - a0) + zd * de
    m.dynamics(alpha=q + lift, q=ma * (alpha - a0) + mq * q + md * (de - d0))
    m.outputs(alpha=alpha, q=q, az=(SPEED * lift, "m/s²"))
    return m


def doublets(t: np.ndarray, amplitude: float) -> np.ndarray:
    """A 3-2-1-1 from 1 s on."""
    found = np.zeros(t.size)
    for begin, end, sign in ((1.0, 4.0, 1), (4.0, 6.0, -1), (6.0, 7.0, 1), (7.0, 8.0, -1)):
        found[(t >= begin) & (t < end)] = sign * amplitude
    return found


def record(model: ph.Model, truth: Mapping[str, float], about: float, seed: int = 0) -> ph.Experiment:
    """Simulate the truth from an angle of attack of a0, the elevator about a value, and add noise."""
    t = np.arange(0.0, 20.0, 0.05)
    blank = {name: np.zeros(t.size) for name in model.output_names}
    inputs = {"de": about + doublets(t, 0.04)}
    clean = ph.simulate(model, truth, ph.Experiment(t, inputs, blank), initial={"alpha": truth["a0"], "q": 0.0})
    random = np.random.default_rng(seed)
    noisy = {n: y + 0.01 * y.std() * random.standard_normal(t.size) for n, y in clean.outputs.items()}
    return ph.Experiment(t, inputs, noisy)


@pytest.mark.parametrize("about", [0.0, 0.02])
@pytest.mark.parametrize("name", SHORT_PERIOD)
def test_trim_is_estimated_from_zeros(name: str, about: float) -> None:
    m, truth = short_period(), SHORT_PERIOD[name]
    data = record(m, truth, about)
    best = ph.estimate(m, data, start=truth)
    zeros = ph.estimate(m, data)
    assert zeros.status == best.status == "converged", zeros.message
    assert zeros.log_likelihood == pytest.approx(best.log_likelihood, abs=1e-4)
    assert zeros.iterations <= 60
