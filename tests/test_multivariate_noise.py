"""Noise of all channels together: a vector autoregressive model, and what it is for."""

from __future__ import annotations

import numpy as np
import pytest
from hidden import nothing
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

import phugoid as ph
from phugoid import _core
from phugoid.residual_noise import UniformSegment
from phugoid.residual_noise.whitening import MultivariateWhitening, RowStructure

A = np.array([[0.8, 0.1, 0.0], [0.5, 0.3, 0.0], [-0.2, 0.4, 0.6]])
ROOT = np.array([[1.0, 0.0, 0.0], [0.5, 0.2, 0.0], [0.0, 0.1, 2.0]])


def rows(n: int, n_y: int) -> RowStructure:
    """All channels at n times."""
    at = np.arange(n * n_y).reshape(n_y, n).T
    strands = [[UniformSegment(slice(i * n, (i + 1) * n), np.arange(n))] for i in range(n_y)]
    return RowStructure(strands, [(tuple(range(n_y)), at)], [at])


def process(n: int, seed: int) -> NDArray[np.float64]:
    """(n_rows,) of the process with A."""
    random = np.random.default_rng(seed)
    x, path = np.zeros(3), []
    for _ in range(n + 200):
        x = A @ x + ROOT @ random.standard_normal(3)
        path.append(x)
    return np.array(path[200:]).T.ravel()


def test_the_process_is_found_and_made_white() -> None:
    n = 4000
    r, first = process(n, 0), MultivariateWhitening.fitted(process(n, 0), rows(n, 3))[0]
    found = first.orders[1].coefficients.T * np.outer(first.scale, 1.0 / first.scale)
    assert np.abs(found - A).max() < 0.06
    e = first(r).reshape(3, n)
    for lag in range(4):
        c = e[:, lag:] @ e[:, : n - lag].T / n
        assert np.abs(c - (np.eye(3) if lag == 0 else 0.0)).max() < 0.06


def test_its_likelihood_is_that_of_a_normal_distribution() -> None:
    n = 12
    whitening = MultivariateWhitening.fitted(process(2000, 1), rows(2000, 3))[0].on(rows(n, 3))
    r = process(n, 2)
    # The transform is linear and triangular in time: its matrix gives the covariance.
    transform = whitening(np.eye(3 * n)).T
    covariance = np.linalg.inv(transform.T @ transform)
    exact = multivariate_normal(np.zeros(3 * n), covariance).logpdf(r) + 1.5 * n * np.log(2 * np.pi)
    assert float(whitening.log_densities(whitening(r)).sum()) == pytest.approx(exact, rel=1e-8)


def test_records_too_short_and_single_channels_have_none() -> None:
    assert MultivariateWhitening.fitted(np.ones(20), rows(20, 1)) == []
    assert len(MultivariateWhitening.fitted(process(60, 3), rows(60, 3))) < 4


def test_short_pieces_between_gaps_tell_of_no_high_order() -> None:
    pieces, each = 40, 4
    n = pieces * each
    at = np.arange(3 * n).reshape(3, n).T
    grid = np.arange(n) + np.repeat(np.arange(pieces), each)  # a sample is missing after each piece
    strands = [[UniformSegment(slice(i * n, (i + 1) * n), grid)] for i in range(3)]
    complete = [at[k : k + each] for k in range(0, n, each)]
    found = MultivariateWhitening.fitted(process(n, 4), RowStructure(strands, [(tuple(range(3)), at)], complete))
    assert 1 <= len(found) < each


def gusts(seed: int, size: float) -> tuple[ph.Model, ph.Experiment]:
    """The HFB-320-like aircraft in turbulence: gusts of angle of attack, a first-order process of 1 s."""
    case = nothing("hfb320", "white", seed)
    m, random = case.model, np.random.default_rng(seed)
    equations = _core.Evaluator(m._core)
    theta = np.array([case.parameters[n] for n in m.parameter_names])
    t, parts = case.data.t, 10
    h = (t[1] - t[0]) / parts
    fine = t[0] + h * np.arange((t.size - 1) * parts + 1)
    u = np.vstack([np.interp(fine, t, case.data.input(n)) for n in m.input_names])
    fit = ph.estimate(m, case.data)
    x, gust, path = np.array([fit.states[n][0] for n in m.state_names]), 0.0, []
    alpha, theta_angle, q = (m.state_names.index(n) for n in ("alpha", "theta", "q"))
    for i, now in enumerate(fine):
        felt = x.copy()
        felt[alpha] += gust
        if i % parts == 0:
            path.append(felt)
        slope = equations.dynamics(theta, np.r_[now, u[:, i], felt][:, None])[:, 0]
        slope[theta_angle] = x[q]
        x = x + h * slope
        gust += h * -gust + size * np.sqrt(2 * h) * random.standard_normal()
    clean = equations.outputs(theta, np.vstack([t, u[:, ::parts], np.array(path).T]))
    noise = {n: np.std(case.data.output(n) - case.clean[n]) for n in m.output_names}
    z = {n: y + noise[n] * random.standard_normal(t.size) for n, y in zip(m.output_names, clean, strict=True)}
    return m, ph.Experiment(t, {n: case.data.input(n) for n in m.input_names}, z, name="in gusts")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_turbulence_is_no_missing_physics(seed: int) -> None:
    """Each gust moves all channels: taken one by one they would be evidence of a disturbance in Cm."""
    m, data = gusts(seed, 0.005)
    fit = ph.estimate(m, data)
    lag = [np.corrcoef(r[1:], r[:-1])[0, 1] for r in fit.residuals.values()]
    assert max(lag) > 0.85  # strong colour
    d = ph.diagnose(fit)
    # It is not a term of the physics, but a disturbance on the state that it acts on.
    assert [f.cause for f in d.findings if f.status != "unexplained"] == ["alpha':noise"], d
    assert not d.extend().added
