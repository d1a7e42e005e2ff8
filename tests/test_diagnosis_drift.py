"""A parameter that changes in the course of a record: found, and one rule for what it means in another record."""

from __future__ import annotations

import numpy as np
import pytest
import short_period
from short_period import T, model

import phugoid as ph


def record(seed: int, change: float) -> ph.Experiment:
    """``change`` of the static stability over the record, in parts."""
    rng = np.random.default_rng(seed)
    de = short_period.elevator(rng, 0.06)

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        ma = -6.0 * (1.0 + change * (t / T[-1] - 0.5))
        return np.array([-1.1 * x[0] + x[1], ma * x[0] - 1.6 * x[1] - 9.0 * np.interp(t, T, de)])

    return short_period.record(seed, rng, de, slope)


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
        assert any("Only in the records of the fit: ma:drift" in note for note in d.notes)
        better = ph.improve(fit, validation)
        assert better.added == () and better.steps[0].rejected == {"ma:drift": "of its record alone"}


def test_a_drift_is_not_taken_for_process_noise() -> None:
    """Blocks fitted each for itself hid the drift: a parameter is nearly constant within a block."""
    for seed in (3, 4):
        d = ph.diagnose(ph.estimate(model(), record(seed, 0.35)), validation=record(seed + 10, 0.35))
        assert [f.cause for f in d.findings if f.status == "named"] == ["ma:drift"], d.summary()
