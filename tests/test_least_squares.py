"""Fits seen through a whitening filter: intervals that hold for coloured noise, and the likeliest filter."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

import phugoid as ph
from phugoid.discrepancy.search.refit import Refit
from phugoid.residual_noise.whitening import Whitening
from phugoid.sensitivities.linearised import Linearised
from phugoid.sensitivities.whitened import Whitened, climbed, own_whitening

TRUTH = {"k": 2.0, "c": 0.6, "g": 1.3, "b": 0.2}
SIGMA = {"x": 0.02, "a": 0.05}
POLE = 0.9
SEEDS = 60


def model() -> ph.Model:
    """A driven mass, of which the acceleration is measured with a bias."""
    m = ph.Model("mass")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N/kg")
    k, c, g, b = m.parameters(k=1.0, c=0.1, g=1.0, b=0.0)
    acceleration = -k * x - c * v + g * u
    m.dynamics(x=v, v=acceleration)
    m.outputs(x=x, a=acceleration + b)
    return m


@cache
def clean() -> tuple[ph.Experiment, dict[str, np.ndarray]]:
    t = 0.1 * np.arange(500)
    u = np.sign(np.sin(0.7 * t)) + np.sin(0.13 * t**1.3)
    e = ph.Experiment(t, {"u": u}, {})
    return e, dict(ph.simulate(model(), TRUTH, e, initial={"x": 0.3, "v": 0.0}).outputs)


def fit(seed: int, pole: float, missing: float = 0.0) -> ph.Fit:
    """To a record with noise of AR(1), stationary from the first sample on."""
    e, outputs = clean()
    random = np.random.default_rng(seed)
    z = {}
    for name, y in outputs.items():
        noise = lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], random.standard_normal(y.size + 300))[300:]
        z[name] = y + SIGMA[name] * noise
        z[name][random.random(y.size) < missing] = np.nan
    return ph.estimate(model(), e.with_outputs(z))


@cache
def coloured(missing: float = 0.0) -> tuple[list[ph.Fit], list[Whitened]]:
    fits = [fit(seed, POLE, missing) for seed in range(SEEDS)]
    assert all(f.converged for f in fits)
    return fits, [own_whitening(Linearised(f)) for f in fits]


def covered(estimates: list[tuple[float, float]], true: float) -> float:
    return float(np.mean([abs(value - true) < 1.96 * error for value, error in estimates]))


# ---------------------------------------------------------------- intervals


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_intervals_hold_in_coloured_noise_where_those_of_the_fit_do_not(missing: float) -> None:
    """95 % intervals of four parameters in 60 fits; the noise goes on where samples are missing."""
    fits, seen = coloured(missing)
    honest = {n: covered([w.parameter(n) for w in seen], true) for n, true in TRUTH.items()}
    plain = {
        n: covered([(f.parameters[n].value, f.parameters[n].std_error) for f in fits], true)
        for n, true in TRUTH.items()
    }
    assert 0.90 <= np.mean(list(honest.values())) <= 0.98, honest
    assert min(honest.values()) >= 0.85, honest
    # A bias is slow, and noise that is slow looks like one.
    assert plain["b"] < 0.6 and np.mean(list(plain.values())) < 0.85, plain


def test_estimates_are_nearer_to_the_truth() -> None:
    """What whitening claims, it has: the step is that of efficient estimates, and its errors as large as said."""
    fits, seen = coloured()
    for name, true in TRUTH.items():
        errors = np.array([w.parameter(name)[0] - true for w in seen])
        claimed = np.mean([w.parameter(name)[1] for w in seen])
        before = np.array([f.parameters[name].value - true for f in fits])
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(claimed, rel=0.3), name
        assert np.sqrt(np.mean(errors**2)) < 1.05 * np.sqrt(np.mean(before**2)), name


def test_in_white_noise_they_are_those_of_the_fit() -> None:
    found = fit(0, 0.0)
    w = own_whitening(Linearised(found))
    assert [c.order for c in w.filter.channels] == [0, 0] and w.filter.correlation is None
    for name in TRUTH:
        e = found.parameters[name]
        value, error = w.parameter(name)
        assert value == pytest.approx(e.value, abs=0.02 * e.std_error)
        assert error == pytest.approx(e.std_error, rel=0.02)
    assert w.log_likelihood == pytest.approx(found.log_likelihood, abs=0.1)


def test_a_refit_says_them_for_the_data_that_there_are() -> None:
    """Standard errors of a candidate's parameters are larger by what the unknowns take of the residuals."""
    _, seen = coloured()
    w = seen[0]
    (candidate,) = ph.candidates(model(), points=w.linear.points).only("a:v^2")
    base = Refit((), w.linear.fit)
    extended = Refit(
        (candidate,), ph.estimate(candidate.extended(model()), w.linear.fit.experiments, start=w.linear.fit)
    )
    value, error = extended.parameters(candidate)[candidate.coefficients[0]]
    plain = extended.own.parameter(candidate.coefficients[0])
    freedom = extended.linear.n_rows - extended.own.basis.shape[1]
    # And by what the filter does not know of how its errors go together.
    doubt = extended.own.inflation(candidate.coefficients[0])
    assert value == plain[0] and error == pytest.approx(plain[1] * np.sqrt(doubt * extended.linear.n_rows / freedom))
    assert abs(value) < 4 * error  # it is not there
    assert base.own.log_likelihood <= extended.through(base.own.filter).log_likelihood + 3.0


# ---------------------------------------------------------------- least squares


def test_errors_are_beside_all_tangents() -> None:
    _, seen = coloured()
    w = seen[1]
    tangents = (w.linear.moves[0] * w.linear.scale()[:, None]).T
    seen_through = w.filter(tangents)
    size = np.linalg.norm(seen_through, axis=1)
    assert np.abs(seen_through @ w.errors).max() < 1e-8 * size.min() * np.linalg.norm(w.errors)
    assert np.linalg.norm(w.beside(tangents), axis=1) == pytest.approx(0 * size, abs=1e-9 * size.min())
    # The residuals after the step are those whose errors these are.
    assert w.filter(w.residuals) == pytest.approx(w.errors, abs=1e-8)
    assert w.basis.shape[1] == len(TRUTH) + 2


def test_the_step_is_that_of_generalised_least_squares() -> None:
    """Against the normal equations in parameters and initial states, and the fit that the step leads to."""
    found, w = (part[2] for part in coloured())
    outputs, moves = w.linear.moves
    columns = w.filter((outputs * w.linear.scale()[:, None]).T).T
    assert columns.shape[1] >= len(TRUTH) + 2
    inverse = np.linalg.pinv(columns, rcond=1e-9)
    assert w.step == pytest.approx(moves @ inverse @ w.filter(w.linear.residuals), abs=1e-9)
    assert w.covariance == pytest.approx(moves @ inverse @ inverse.T @ moves.T, rel=1e-6, abs=1e-15)
    for name in TRUTH:
        i = w.linear.place(name)
        assert w.parameter(name)[0] == pytest.approx(found.parameters[name].value + w.step[i], rel=1e-12)
    i, j = w.linear.place("k"), w.linear.place("c")
    cosine = w.covariance[i, j] / np.sqrt(w.covariance[i, i] * w.covariance[j, j])
    assert w.correlation(["k"], ["c"]) == pytest.approx(abs(cosine))


# ---------------------------------------------------------------- the likeliest filter


@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_its_likelihood_is_not_below_that_of_its_start(missing: float) -> None:
    gains = []
    for seed in range(12):
        linear = Linearised(fit(seed, (0.0, 0.5, 0.9, 0.98)[seed % 4], missing))
        rows = linear.structure
        first = Whitening.of(linear.residuals, rows)
        other = Whitening.of(np.random.default_rng(seed).standard_normal(linear.n_rows) * linear.scale(), rows)
        for start in (first, other):
            begin = Whitened(linear, start)
            gains.append(climbed(begin).log_likelihood - begin.log_likelihood)
        assert own_whitening(linear).log_likelihood == climbed(Whitened(linear, first)).log_likelihood
    assert min(gains) >= 0.0 and max(gains) > 100.0


def test_densities_add_up_to_the_likelihood() -> None:
    for seed, missing in ((0, 0.0), (1, 0.2)):
        linear = Linearised(fit(seed, POLE, missing))
        w = own_whitening(linear)
        assert w.log_densities.size == linear.n_measured == linear.n_rows
        assert w.log_densities.sum() == pytest.approx(w.log_likelihood, rel=1e-12)
