"""A parameter that changes in the course of a record: found, and one rule for what it means in another record."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

T = np.arange(0.0, 20.0, 0.04)


def model() -> ph.Model:
    m = ph.Model("short period")
    (de,), (a, q) = m.inputs(de="rad"), m.states(alpha="rad", q="rad/s")
    za, ma, mq, md = m.parameters(za=-1.0, ma=-5.0, mq=-1.0, md=-8.0)
    m.dynamics(alpha=za * a + q, q=ma * a + mq * q + md * de)
    m.outputs(alpha=a, q=q)
    return m


def record(seed: int, change: float) -> ph.Experiment:
    """``change`` of the static stability over the record, in parts."""
    rng = np.random.default_rng(seed)
    de = 0.06 * np.repeat(rng.uniform(-1.0, 1.0, 30), 25)[: T.size]

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        ma = -6.0 * (1.0 + change * (t / T[-1] - 0.5))
        return np.array([-1.1 * x[0] + x[1], ma * x[0] - 1.6 * x[1] - 9.0 * np.interp(t, T, de)])

    x = np.zeros((T.size, 2))
    for k, t in enumerate(T[:-1]):
        h = T[k + 1] - t
        k1 = slope(t, x[k])
        k2 = slope(t + h / 2, x[k] + h / 2 * k1)
        k3 = slope(t + h / 2, x[k] + h / 2 * k2)
        x[k + 1] = x[k] + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(t + h, x[k] + h * k3))
    y = x + np.array([0.003, 0.004]) * rng.standard_normal(x.shape)
    return ph.Experiment(T, {"de": de}, {"alpha": y[:, 0], "q": y[:, 1]}, name=f"record {seed}")


@pytest.mark.parametrize("other", [0.5, -0.4])
def test_the_table_and_a_validation_agree(other: float) -> None:
    """The table put the drift to zero in the validation record, and the extended model did not."""
    fit, validation = ph.estimate(model(), record(1, 0.5)), record(2, other)
    d = ph.diagnose(fit, validation=validation)
    assert [f.cause for f in d.findings if f.status == "named"] == ["ma:drift"], d.summary()
    extension = d.extend()
    # With the drift of another record the simulation of this one is worse: then it is not part of the model.
    assert extension.added == (("ma:drift",) if other > 0.0 else ())
    matches = extension.fit.validate(validation).matches
    for name, rms in extension.gain.held_out_rms_after.items():
        assert matches[name].rms == pytest.approx(rms, rel=0.02)
        assert rms <= extension.gain.held_out_rms_before[name] * 1.001
    if other < 0.0:
        assert any("Of the records of the fit alone: ma:drift" in note for note in d.notes)
        better = ph.improve(fit, validation)
        assert better.added == () and better.steps[0].rejected == {"ma:drift": "of its record alone"}


def test_a_drift_is_not_taken_for_process_noise() -> None:
    """Blocks fitted each for itself hid the drift: a parameter is nearly constant within a block."""
    for seed in (3, 4):
        d = ph.diagnose(ph.estimate(model(), record(seed, 0.35)), validation=record(seed + 10, 0.35))
        assert [f.cause for f in d.findings if f.status == "named"] == ["ma:drift"], d.summary()
