"""A fit is checked after it has ended: against known noise, against a constant, against its start, and
where the states do not satisfy the equations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import phugoid as ph

T = np.linspace(0.0, 10.0, 100)
RANDOM = np.random.default_rng(3)
NOISE = RANDOM.standard_normal(T.size)


def decay() -> ph.Model:
    m = ph.Model("decay")
    (x,) = m.states("x")
    (k,) = m.parameters(k=ph.Parameter(0.5))
    m.dynamics(x=-k * x)
    m.outputs(y=x)
    return m


def record(sigma: float, extra: float = 0.0) -> ph.Experiment:
    return ph.Experiment(T, outputs={"y": 2.0 * np.exp(-0.3 * T) + extra * np.sin(2.0 * T) + sigma * NOISE})


def test_residuals_far_beyond_the_noise_that_is_known_are_reported_first() -> None:
    found = ph.estimate(decay(), record(0.01, extra=0.15), noise=ph.Gaussian({"y": 0.01}))
    assert found.converged
    assert found.warnings[0].startswith("the residuals are 1")
    assert "times the noise that is given as known" in found.warnings[0]
    assert "98 degrees of freedom" in found.warnings[0]
    assert found.warnings[0] in found.summary()


def test_noise_that_is_known_too_large_is_reported() -> None:
    found = ph.estimate(decay(), record(0.01), noise=ph.Gaussian({"y": 0.05}))
    assert "too large" in found.warnings[0]


def test_a_covariance_that_is_known_is_tested_too() -> None:
    found = ph.estimate(decay(), record(0.03), noise=ph.Gaussian(covariance=[[1e-4]]))
    assert "times the noise" in found.warnings[0]


def test_the_right_noise_raises_no_warning() -> None:
    warned = 0
    for seed in range(100):
        z = 2.0 * np.exp(-0.3 * T) + 0.01 * np.random.default_rng(seed).standard_normal(T.size)
        warned += bool(
            ph.estimate(decay(), ph.Experiment(T, outputs={"y": z}), noise=ph.Gaussian({"y": 0.01})).warnings
        )
    assert warned <= 1  # a level of one in a thousand on each side, and a factor beside


def test_estimated_noise_is_not_tested() -> None:
    assert ph.estimate(decay(), record(0.01, extra=0.3)).warnings == ()


def test_a_fit_that_matches_no_better_than_a_constant_says_so_in_its_warnings() -> None:
    m = ph.Model("constant speed")
    (x,) = m.states("x")
    (a,) = m.parameters(a=ph.Parameter(0.1))
    m.dynamics(x=a)
    m.outputs(y=x)
    found = ph.estimate(m, ph.Experiment(T, outputs={"y": np.sin(20.0 * T) + 0.01 * NOISE}))
    assert any("No output is matched well" in w for w in found.warnings)


def test_a_fit_that_is_less_likely_than_its_start_says_so() -> None:
    e = record(0.05)
    best = ph.estimate(decay(), e)
    m = ph.Model("decay")  # the same model, whose parameter is kept from the optimum
    (x,) = m.states("x")
    (k,) = m.parameters(k=ph.Parameter(0.9, bounds=(0.8, 2.0)))
    m.dynamics(x=-k * x)
    m.outputs(y=x)
    start = replace(best, parameters=ph.estimate(m, e).parameters)
    found = ph.estimate(m, e, start=start)
    assert found.warnings[0].startswith("the log-likelihood is ")
    assert "below that of the fit it started from" in found.warnings[0]
    assert not ph.estimate(decay(), e, start=best).warnings


@pytest.fixture(scope="module")
def not_feasible() -> ph.Fit:
    """A run of one iteration from a path that satisfies no equation."""
    m = ph.Model("van der Pol")
    x, v = m.states("x v")
    (mu,) = m.parameters(mu=ph.Parameter(5.0))
    m.dynamics(x=v, v=mu * (1 - x**2) * v - x)
    m.outputs(x=x)
    z = 2.0 * np.sin(T) + 0.01 * NOISE
    return ph.estimate(m, ph.Experiment(T, outputs={"x": z}), solver=ph.Newton(max_iterations=0, regression=False))


def test_a_result_that_is_no_solution_shows_no_match(not_feasible: ph.Fit) -> None:
    assert not not_feasible.converged and not not_feasible.feasible
    found = ph.match(not_feasible.records, "x")
    assert found.samples == T.size
    assert math.isnan(found.rms) and math.isnan(found.r_squared) and math.isnan(found.theil)
    assert math.isnan(not_feasible.log_likelihood)
    assert np.isnan(not_feasible.parameters.std_errors_array).all()
    assert np.isnan(not_feasible.covariance).all()
    assert "do not satisfy the equations" in not_feasible.warnings[0]
    assert "1.0000" not in not_feasible.summary()


def test_it_is_saved_as_one(not_feasible: ph.Fit, tmp_path) -> None:
    not_feasible.save(tmp_path / "fit.json")
    assert not ph.load(tmp_path / "fit.json").feasible


def test_a_run_that_is_ended_at_a_solution_keeps_its_match() -> None:
    e = record(0.05)
    best = ph.estimate(decay(), e)
    found = ph.estimate(decay(), e, start=best, solver=ph.Newton(max_iterations=0))
    assert found.feasible
    assert math.isfinite(ph.match(found.records, "y").rms)
