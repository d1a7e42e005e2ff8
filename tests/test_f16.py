"""The F-16 example: the modes of a real vibration test, and where a linear model of it ends."""

from __future__ import annotations

import f16_vibration as f16
import numpy as np
import pytest
from records import find

import phugoid as ph

pytestmark = pytest.mark.skipif(find(f16.RECORD) is None, reason=f"the record {f16.RECORD} is not there")


@pytest.fixture(scope="module")
def runs() -> tuple[ph.Experiment, ph.Experiment]:
    run = f16.recorded()
    assert run is not None
    return f16.periods(run, *f16.ESTIMATED), f16.periods(run, *f16.HELD_OUT)


@pytest.fixture(scope="module")
def begin(runs: tuple[ph.Experiment, ph.Experiment]) -> ph.linear.StateSpace:
    return f16.start(runs[0])


@pytest.fixture(scope="module")
def fit(runs: tuple[ph.Experiment, ph.Experiment], begin: ph.linear.StateSpace) -> ph.Fit:
    return f16.estimate(runs[0], begin)


def test_the_modes_are_found(fit: ph.Fit) -> None:
    assert fit.converged
    modes = list(ph.linear.modes(fit))
    found = [float(m.frequency) for m in modes[:6]]
    # Where the empirical response has its peaks (tests/test_frequency_response.py), which is known to 0.05 Hz.
    np.testing.assert_allclose(found, [3.47, 3.96, 5.18, 6.59, 7.32, 9.18], atol=0.05)
    for k in (2, 4):
        assert modes[k].frequency.std_error < 0.002
        assert modes[k].damping.std_error < 0.05 * float(modes[k].damping) < 0.05 * 0.01
    assert all(not m.eigenvalue.real > 0.0 for m in modes)


def test_it_predicts_periods_held_out_better_than_the_subspace_method(
    runs: tuple[ph.Experiment, ph.Experiment], begin: ph.linear.StateSpace, fit: ph.Fit
) -> None:
    numeric = f16.as_fit(begin, runs[0])
    for run in runs:
        ours, theirs = (f16.fractions(f.validate(run)) for f in (fit, numeric))
        for n, most in zip(f16.OUTPUTS, (0.095, 0.107, 0.109), strict=True):
            assert ours[n] < most
            assert ours[n] < theirs[n]


def test_what_repeats_in_the_residuals_is_the_mode_that_softens(
    runs: tuple[ph.Experiment, ph.Experiment], fit: ph.Fit
) -> None:
    spectra = f16.Spectra(fit.records[0], "Acceleration3")
    _, near, noise = spectra.band(*f16.NEAR)
    _, whole, _ = spectra.band(f16.BANDS[0], f16.BANDS[-1])
    assert near > 50 * noise and near**2 > 0.85 * whole**2
    quarters = f16.by_amplitude(fit.records[0], "Acceleration3")
    assert quarters[0][2] > 10.0 > 0.0 > quarters[-1][2]  # degrees
    softer = f16.softening(fit, runs[0], f16.SOFTENING[:1])
    assert softer.converged
    k = softer.parameters["x_5b_dot_x_5a_abs_x_5a"]
    assert k.value > 50 * k.std_error
    held_out = f16.fractions(softer.validate(runs[1]))
    assert held_out["Acceleration2"] < 0.055 and held_out["Acceleration3"] < 0.055
