"""The published optima on the records they belong to: HFB-320 and the simulated unstable aircraft.

Optima: data of github.com/dimasad/aviation-2019-code, published with the paper (trapezoid, mesh = sample times). The
records are looked for in the folder that PHUGOID_DATA names, else in ../shared/data beside the checkout; the tests are
skipped where they are absent.
"""

from __future__ import annotations

import functools
from pathlib import Path

import hfb320
import numpy as np
import pytest
import unstable_aircraft
from records import find

import phugoid as ph
from phugoid import Collocation, Fit

HFB320 = {
    "CD0": 0.05802198227121576, "CDV": -0.031609345096558036, "CDa": 0.2453480135927723,
    "CL0": 0.18081496655016374, "CLV": 0.20117806265996505, "CLa": 3.090429255239013,
    "Cm0": 0.11836017813192333, "CmV": 0.013661249826858497, "Cma": -0.9940542701262957,
    "Cmq": -28.651655181649204, "Cmde": -1.471386926974763,
}  # fmt: skip
HFB320_BIASES = {
    "b_q": -0.00010091594526686652, "b_aq": -4.9217064663231145e-06,
    "b_ax": -0.12084522355941345, "b_az": -0.010969637096449545,
}  # fmt: skip
HFB320_SIGMAS = {
    "sigma_V": 0.8685280159552249, "sigma_alpha": 0.0022700468575119655, "sigma_theta": 0.002042851155865991,
    "sigma_q": 0.002463907639197214, "sigma_aq": 0.007884887575017764, "sigma_ax": 0.024723104791353933,
    "sigma_az": 0.20590254560216117,
}  # fmt: skip
HFB320_LOG_LIKELIHOOD = 15055.952975804  # without the constant -N n_y/2 ln 2 pi

UNSTABLE = {
    "Zw": -1.4266610873826133, "Zq": -1.5450850965346954, "Zde": -6.263202600623347,
    "Mw": 0.21660638419854875, "Mq": -3.7017914082981997, "Mde": -12.768768280554982,
}  # fmt: skip


def path(name: str) -> Path:
    found = find(name)
    if found is None:
        pytest.skip(f"the record {name} is neither in $PHUGOID_DATA nor in ../shared/data")
    return found


@functools.cache
def hfb_fit(order: int) -> Fit:
    """From all derivatives and biases 0, all sigma 1, states as measured."""
    start = dict.fromkeys([*HFB320, *HFB320_BIASES], 0.0) | dict.fromkeys(HFB320_SIGMAS, 1.0)
    data = hfb320.experiment(path(hfb320.RECORD))
    return ph.estimate(hfb320.model(), data, transcription=Collocation(order=order), start=start)


@functools.cache
def unstable_fit() -> Fit:
    """From all derivatives 0, all sigma 1, states as measured."""
    start = dict.fromkeys(UNSTABLE, 0.0) | {"sigma_w": 1.0, "sigma_q": 1.0, "sigma_az": 1.0}
    data = unstable_aircraft.experiment(path(unstable_aircraft.RECORD))
    return ph.estimate(unstable_aircraft.model(), data, transcription=Collocation(order=2), start=start)


@pytest.mark.parametrize("name", [*HFB320, *HFB320_SIGMAS])
def test_hfb320_derivatives_and_sigmas_are_those_published(name: str) -> None:
    published = (HFB320 | HFB320_SIGMAS)[name]
    assert hfb_fit(2).parameters[name].value == pytest.approx(published, rel=1e-6)


@pytest.mark.parametrize("name", HFB320_BIASES)
def test_hfb320_biases_are_those_published(name: str) -> None:
    assert hfb_fit(2).parameters[name].value == pytest.approx(HFB320_BIASES[name], rel=0, abs=1e-8)


def test_hfb320_log_likelihood_is_that_published() -> None:
    assert hfb_fit(2).log_likelihood == pytest.approx(HFB320_LOG_LIKELIHOOD, rel=0, abs=1e-4)


@pytest.mark.parametrize("order", [2, 3, 4, 5, 8])
def test_hfb320_converges_without_warning(order: int) -> None:
    fit = hfb_fit(order)
    assert (fit.status, fit.warnings) == ("converged", ())
    assert all(np.isfinite(e.std_error) for e in fit.parameters.values())


@pytest.mark.parametrize("order", [3, 5, 8])
@pytest.mark.parametrize("name", HFB320)
def test_hfb320_derivatives_agree_from_order_3_on(name: str, order: int) -> None:
    assert hfb_fit(order).parameters[name].value == pytest.approx(hfb_fit(4).parameters[name].value, rel=3e-4)


def test_hfb320_orders_3_to_8_agree_among_themselves() -> None:
    for name in HFB320:
        values = [hfb_fit(order).parameters[name].value for order in (3, 4, 5, 8)]
        assert np.ptp(values) <= 3e-4 * np.abs(values).min(), name


def test_hfb320_pitch_damping_differs_from_the_trapezoids() -> None:
    assert hfb_fit(4).parameters["Cmq"].value == pytest.approx(-28.2854, rel=0, abs=1e-3)
    assert hfb_fit(2).parameters["Cmq"].value == pytest.approx(-28.6517, rel=0, abs=1e-3)


@pytest.mark.parametrize("flat", [False, True])
def test_hfb320_with_a_full_covariance_from_zero(flat: bool) -> None:
    data, model = hfb320.experiment(path(hfb320.RECORD)), hfb320.model()
    start = dict.fromkeys([*HFB320, *HFB320_BIASES], 0.0) | dict.fromkeys(HFB320_SIGMAS, 1.0)
    if flat:
        start |= {"V": 100.0, "alpha": 0.1, "theta": 0.1, "q": 0.0}
    fit = ph.estimate(model, data, noise=ph.Gaussian(correlated=True), start=start)
    assert fit.converged and fit.iterations <= 30 and not fit.warnings
    # R is that of the residuals, and the log-likelihood follows from it.
    r = np.array([fit.residuals[name] for name in model.output_names])
    sample = r @ r.T / data.n
    sigma = np.sqrt(np.diag(sample))
    for i, a in enumerate(model.output_names):
        assert fit.parameters[f"sigma_{a}"].value == pytest.approx(sigma[i], rel=1e-6)
        for j, b in enumerate(model.output_names[i + 1 :], i + 1):
            expected = sample[i, j] / (sigma[i] * sigma[j])
            assert fit.parameters[f"corr_{a}_{b}"].value == pytest.approx(expected, abs=1e-6)
    expected = -data.n / 2 * (np.linalg.slogdet(sample)[1] + len(r))
    assert fit.log_likelihood == pytest.approx(expected, abs=1e-5)
    # The better of two optima that are known: the other, 14622.6, is where correlations come in too early.
    assert fit.log_likelihood == pytest.approx(15986.2215, abs=1e-3)


def test_hfb320_simulation_reproduces_the_fit() -> None:
    fit, data = hfb_fit(5), hfb320.experiment(path(hfb320.RECORD))
    simulated = ph.simulate(fit.model, fit, data)
    for name, y in fit.outputs.items():
        sigma = fit.parameters[f"sigma_{name}"].value
        np.testing.assert_allclose(simulated.outputs[name], y, rtol=0, atol=1e-6 * sigma)


@pytest.mark.parametrize("name", UNSTABLE)
def test_unstable_aircraft_derivatives_are_those_published(name: str) -> None:
    assert unstable_fit().parameters[name].value == pytest.approx(UNSTABLE[name], rel=1e-6)


def test_unstable_aircraft_converges() -> None:
    fit = unstable_fit()
    assert fit.converged
    assert all(np.isfinite(e.std_error) for e in fit.parameters.values())
