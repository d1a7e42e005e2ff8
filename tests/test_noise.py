"""Noise models: densities against scipy.stats, derivatives, what they recover, and what they survive."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy import integrate, special, stats

import phugoid as ph
from phugoid import Density, Gaussian, Huber, Laplace, Model, PerOutput, Sigma, StudentT, _core, exp, log

ROOT = np.sqrt(2 * np.pi)  # log-likelihoods are without the Gaussian's constant
NAMES = ("y1", "y2", "y3")


def steady(n: int, names: tuple[str, ...] = NAMES) -> Model:
    """n outputs, each a constant level of its own and all the state of one decay: linear least squares."""
    m = Model("levels")
    (x,) = m.states("x")
    levels = m.parameters(" ".join(f"level_{name}" for name in names[:n]))
    m.dynamics(x=-0.4 * x)
    m.outputs(**{name: x + level for name, level in zip(names[:n], levels, strict=True)})
    return m


def record(noise: np.ndarray, names: tuple[str, ...] = NAMES) -> ph.Experiment:
    """Outputs of `steady` at levels 1, 2, 3 with noise (n_y, N)."""
    t = np.linspace(0.0, 6.0, noise.shape[1])
    levels = np.arange(1.0, len(noise) + 1)[:, None]
    y = 2 * np.exp(-0.4 * t) + levels + noise
    return ph.Experiment(t, outputs=dict(zip(names, y, strict=False)))


def problem_of(m: Model, e: ph.Experiment, noise: Any, start: dict[str, float] | None = None) -> _core.Collocation:
    resolved = noise.resolve(m.output_names, dict.fromkeys(m.output_names, 1.0), start or {})
    return ph.Collocation(order=2).problem(m, [e], resolved)


def point(problem: _core.Collocation, seed: int = 1) -> np.ndarray:
    """Model parameters and states at random, noise where it starts."""
    xi = np.random.default_rng(seed).uniform(-1, 1, problem.n)
    k = len(problem.noise_start)
    xi[problem.n_theta - k : problem.n_theta] = problem.noise_start
    return xi


def residuals(problem: _core.Collocation, xi: np.ndarray, e: ph.Experiment, m: Model) -> np.ndarray:
    return np.array([e.output(name) for name in m.output_names]) - np.array(problem.outputs(xi, 0))


def some_noise(n_y: int, n: int, seed: int = 0) -> np.ndarray:
    return 0.3 * np.random.default_rng(seed).standard_normal((n_y, n))


def cauchy(r: Any, sigma: Any) -> Any:
    return -log(1 + (r / sigma) ** 2) - log(sigma) + np.log(ROOT / np.pi)


def some_bad(r: Any, sigma: Any, share: Any, wide: Any) -> Any:
    def good(e: Any) -> Any:
        return exp(-(e**2) / 2)

    return log((1 - share) * good(r / sigma) + share / wide * good(r / (wide * sigma))) - log(sigma)


BAD = {"share": ph.Parameter(0.1, bounds=(0.001, 0.5)), "wide": ph.Parameter(8.0, fixed=True)}


def huber(e: np.ndarray, k: float) -> np.ndarray:
    size = np.abs(e)
    norm = ROOT * (2 * stats.norm.cdf(k) - 1) + 2 / k * np.exp(-(k**2) / 2)
    return np.where(size <= k, -(e**2) / 2, -k * size + k**2 / 2) - np.log(norm)


def laplace(e: np.ndarray, s: float) -> np.ndarray:
    return -np.sqrt(e**2 + s**2) - np.log(2 * s * special.k1(s))


def mixture(e: np.ndarray) -> np.ndarray:
    return np.log(0.9 * stats.norm.pdf(e) + 0.1 * stats.norm.pdf(e, scale=8))


# name -> noise for known sigma, log-density of e = residual / sigma, up to -log sigma
DENSITIES: dict[str, tuple[Callable[..., Any], Callable[[np.ndarray], np.ndarray]]] = {
    "gaussian": (Gaussian, stats.norm.logpdf),
    "t, 4": (lambda s: StudentT(s, 4), stats.t(4).logpdf),
    "t, 1": (lambda s: StudentT(s, 1), stats.t(1).logpdf),
    "t, 37.5": (lambda s: StudentT(s, 37.5), stats.t(37.5).logpdf),
    "t, by output": (lambda s: StudentT(s, {"y1": 2.5}), stats.t(2.5).logpdf),
    "huber": (Huber, lambda e: huber(e, 1.345)),
    "huber, 0.2": (lambda s: Huber(s, 0.2), lambda e: huber(e, 0.2)),
    "laplace": (Laplace, lambda e: laplace(e, 0.1)),
    "laplace, 1e-3": (lambda s: Laplace(s, 1e-3), stats.laplace.logpdf),
    "user's": (lambda s: Density(cauchy, s), stats.cauchy.logpdf),
    "user's, fixed": (
        lambda s: Density(some_bad, s, {"share": ph.Parameter(0.1, fixed=True), "wide": BAD["wide"]}),
        mixture,
    ),
    "per output": (lambda s: PerOutput({"y1": StudentT(s, 3)}), stats.t(3).logpdf),
}


@pytest.mark.parametrize("name", DENSITIES)
def test_log_likelihood_is_the_sum_of_log_densities(name: str) -> None:
    make, logpdf = DENSITIES[name]
    m, e = steady(1), record(some_noise(1, 23))
    z = e.output("y1").copy()
    z[[4, 17]] = np.nan
    e = e.with_outputs({"y1": z})
    problem = problem_of(m, e, make({"y1": 0.7}))
    xi = point(problem)
    r = residuals(problem, xi, e, m)[0]
    expected = np.nansum(logpdf(r / 0.7) - np.log(0.7) + np.log(ROOT))
    tolerance = 3e-3 if name == "laplace, 1e-3" else 1e-11  # the first is smoothed
    assert -problem.objective(xi) == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize("noise", [Huber(k=0.7), Laplace(smoothing=0.5), StudentT(dof=2)])
def test_the_package_s_densities_integrate_to_one(noise: Any) -> None:
    m = steady(1)
    at = np.linspace(-1, 1, 3)

    def density(r: float) -> float:
        e = ph.Experiment(at, outputs={"y1": [np.nan, r, np.nan]})
        problem = problem_of(m, e, type(noise)(**{**vars(noise), "sigma": {"y1": 1.0}}))
        return float(np.exp(-problem.objective(np.zeros(problem.n))) / ROOT)

    half = integrate.quad(density, 0, np.inf, epsabs=1e-7, epsrel=1e-7)[0]
    assert 2 * half == pytest.approx(1.0, abs=1e-6)


def gaps(n_y: int, n: int) -> np.ndarray:
    """Every pattern of missing outputs, all missing too."""
    patterns = np.array(list(product([False, True], repeat=n_y)))
    return np.resize(patterns, (n, n_y)).T


NOISES = {
    "t": StudentT(),
    "t, dof": StudentT(dof=None, bounds=(1.5, 60)),
    "huber": Huber(),
    "laplace": Laplace(),
    "user's": Density(some_bad, parameters=BAD),
    "user's, known scale": Density(cauchy, {"y1": 0.4}),
    "per output": PerOutput({"y1": StudentT(dof=None), "y2": Laplace()}),
    "correlated": Gaussian(correlated=True),
    "covariance": Gaussian(covariance=[[0.09, 0.04, 0.0], [0.04, 0.16, -0.05], [0.0, -0.05, 0.2]]),
}


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("name", NOISES)
def test_derivatives(name: str, missing: bool) -> None:
    m, e = steady(3), record(some_noise(3, 19))
    if missing:
        z = np.array([e.output(n) for n in NAMES])
        z[gaps(3, e.n)] = np.nan
        e = e.with_outputs(dict(zip(NAMES, z, strict=True)))
    start = {"corr_y1_y2": 0.4, "corr_y2_y3": -0.3, "corr_y1_y3": 0.2} if name == "correlated" else {}
    problem = problem_of(m, e, NOISES[name], {**start, "sigma_y2": 0.3, "sigma_y3": 0.8} if start else {})
    xi, multipliers = point(problem), np.random.default_rng(2).uniform(-1, 1, problem.m)
    assert problem.check_derivatives(xi, multipliers, range(problem.n_theta + 3), 2e-6) == []
    # Gauss-Newton's is positive semidefinite.
    rows, columns = problem.hessian_structure()
    matrix = np.zeros((problem.n, problem.n))
    np.add.at(matrix, (rows, columns), problem.gauss_newton(xi, 1.0))
    eigenvalues = np.linalg.eigvalsh(matrix + np.tril(matrix, -1).T)
    assert eigenvalues.min() > -1e-10 * eigenvalues.max()


R3 = np.array([[0.04, 0.03, -0.02], [0.03, 0.09, 0.01], [-0.02, 0.01, 0.16]])


@pytest.mark.parametrize("unknown", [False, True])
def test_samples_in_part_have_the_marginal_density(unknown: bool) -> None:
    m, e = steady(3), record(some_noise(3, 32))
    z = np.array([e.output(n) for n in NAMES])
    z[gaps(3, e.n)] = np.nan
    e = e.with_outputs(dict(zip(NAMES, z, strict=True)))
    sigma = np.sqrt(np.diag(R3))
    start = {f"sigma_{n}": s for n, s in zip(NAMES, sigma, strict=True)}
    pairs = [(0, 1), (0, 2), (1, 2)]
    start |= {f"corr_{NAMES[i]}_{NAMES[j]}": R3[i, j] / (sigma[i] * sigma[j]) for i, j in pairs}
    problem = problem_of(
        m, e, Gaussian(correlated=True) if unknown else Gaussian(covariance=R3), start if unknown else {}
    )
    xi = point(problem)
    r = residuals(problem, xi, e, m)
    expected = 0.0
    for k in range(e.n):
        there = np.flatnonzero(~np.isnan(r[:, k]))
        if there.size:
            expected += stats.multivariate_normal.logpdf(r[there, k], cov=R3[np.ix_(there, there)])
            expected += there.size * np.log(ROOT)
    assert -problem.objective(xi) == pytest.approx(expected, rel=1e-12)
    if unknown:
        found = {name: value for name, _, value, *_ in problem.noise_report(xi)}
        assert found == pytest.approx(start, rel=1e-12)


def correlated_noise(n: int, seed: int) -> np.ndarray:
    return np.linalg.cholesky(R3) @ np.random.default_rng(seed).standard_normal((3, n))


def test_full_covariance_is_that_of_the_residuals() -> None:
    m, e = steady(3), record(correlated_noise(800, 3))
    fit = ph.estimate(m, e, noise=Gaussian(correlated=True))
    assert fit.converged and fit.iterations < 12
    r = np.array([fit.residuals[n] for n in NAMES])
    sample = r @ r.T / e.n
    sigma = np.sqrt(np.diag(sample))
    for i, a in enumerate(NAMES):
        p = fit.parameters[f"sigma_{a}"]
        assert p.value == pytest.approx(sigma[i], rel=1e-7)
        # Cramér-Rao for a standard deviation, and below for a correlation (Kendall and Stuart, 26.15)
        assert p.std_error == pytest.approx(sigma[i] / np.sqrt(2 * e.n), rel=0.01)
        for j, b in list(enumerate(NAMES))[i + 1 :]:
            c = fit.parameters[f"corr_{a}_{b}"]
            assert c.value == pytest.approx(sample[i, j] / (sigma[i] * sigma[j]), abs=1e-7)
            assert c.std_error == pytest.approx((1 - c.value**2) / np.sqrt(e.n), rel=0.01)
            truth = R3[i, j] / np.sqrt(R3[i, i] * R3[j, j])
            assert abs(c.value - truth) < 4 * c.std_error
    expected = -e.n / 2 * (np.linalg.slogdet(sample)[1] + 3)
    assert fit.log_likelihood == pytest.approx(expected, rel=1e-9)


def test_full_covariance_uses_what_other_outputs_say_of_missing_samples() -> None:
    noise = correlated_noise(2000, 5)
    noise[0, 400:] = np.nan
    e, m = record(noise), steady(3)
    full = ph.estimate(m, e, noise=Gaussian(correlated=True))
    assert full.converged
    truth = {f"sigma_{n}": np.sqrt(R3[i, i]) for i, n in enumerate(NAMES)} | {"level_y1": 1.0}
    for name, value in truth.items():
        p = full.parameters[name]
        assert abs(p.value - value) < 4 * p.std_error, name
    # A little noise of y1 is known from that of y2 and y3.
    diagonal = ph.estimate(m, e)
    assert full.parameters["level_y1"].std_error < 0.95 * diagonal.parameters["level_y1"].std_error


def test_too_many_combinations_of_missing_outputs_are_refused() -> None:
    names = tuple(f"y{i}" for i in range(8))
    noise = some_noise(8, 300)
    noise[np.random.default_rng(1).random(noise.shape) < 0.1] = np.nan
    m, e = steady(8, names), record(noise, names)
    with pytest.raises(ph.DataError, match="different combinations, more than noise with an unknown covariance"):
        ph.estimate(m, e, noise=Gaussian(correlated=True))
    assert ph.estimate(m, e, noise=Gaussian(covariance=0.09 * np.eye(8))).converged


def test_known_diagonal_covariance_is_as_known_standard_deviations() -> None:
    m, e = steady(3), record(some_noise(3, 50))
    sigma = {"y1": 0.3, "y2": 0.2, "y3": 0.4}
    one = ph.estimate(m, e, noise=Gaussian(sigma))
    for covariance in (np.diag(np.square(list(sigma.values()))), {n: {n: s**2} for n, s in sigma.items()}):
        other = ph.estimate(m, e, noise=Gaussian(covariance=covariance))
        assert other.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-12)
        np.testing.assert_allclose(other.parameters.values_array, one.parameters.values_array, rtol=1e-9)
        np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-9)


def test_known_covariance_gives_generalised_least_squares() -> None:
    e = record(correlated_noise(60, 8))
    fit = ph.estimate(steady(3), e, noise=Gaussian(covariance=R3), transcription=ph.Collocation(order=6))
    # z = levels + x0 exp(-0.4 t)
    A = np.concatenate([np.column_stack([np.tile(np.eye(3)[i], (e.n, 1)), np.exp(-0.4 * e.t)]) for i in range(3)])
    weight = np.kron(np.linalg.inv(R3), np.eye(e.n))
    z = np.concatenate([e.output(n) for n in NAMES])
    information = A.T @ weight @ A
    expected = np.linalg.solve(information, A.T @ weight @ z)
    np.testing.assert_allclose(fit.parameters.values_array, expected[:3], rtol=1e-8)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(information)[:3, :3], rtol=1e-6)


ROBUST = {
    "t": StudentT(),
    "t, dof": StudentT(dof=None),
    "huber": Huber(),
    "laplace": Laplace(),
    "user's": Density(some_bad, parameters=BAD),
}


def spoilt(seed: int) -> ph.Experiment:
    """10 % of the samples are far too large."""
    random = np.random.default_rng(seed)
    noise = 0.05 * random.standard_normal((1, 400))
    bad = random.random(400) < 0.1
    noise[0, bad] += random.uniform(1.0, 3.0, bad.sum())
    return record(noise)


@pytest.mark.parametrize("name", ROBUST)
def test_robust_fits_survive_outliers(name: str) -> None:
    m, e = steady(1), spoilt(1)
    fit = ph.estimate(m, e, noise=ROBUST[name])
    assert fit.converged
    clean = ph.estimate(m, record(0.05 * np.random.default_rng(1).standard_normal((1, 400))))
    unit = clean.parameters["level_y1"].std_error
    gaussian = ph.estimate(m, e)
    assert abs(gaussian.parameters["level_y1"].value - 1) > 10 * unit
    error = abs(fit.parameters["level_y1"].value - 1)
    if name in ("huber", "laplace"):
        # The pull of an outlier is bounded, but does not fall off: those on one side move the estimate somewhat.
        assert error < abs(gaussian.parameters["level_y1"].value - 1) / 5
    else:
        assert error < 3 * unit
        assert 0.02 < fit.parameters["sigma_y1"].value < 0.12 < gaussian.parameters["sigma_y1"].value


@pytest.mark.parametrize("dof", [2.0, 5.0])
def test_degrees_of_freedom_are_found(dof: float) -> None:
    e = record(0.2 * stats.t(dof).rvs((1, 4000), random_state=7))
    fit = ph.estimate(steady(1), e, noise=StudentT(dof=None))
    found, sigma = fit.parameters["dof_y1"], fit.parameters["sigma_y1"]
    assert fit.converged and abs(found.value - dof) < 3 * found.std_error < 0.5 * dof
    assert abs(sigma.value - 0.2) < 3 * sigma.std_error
    # The same by scipy, of the residuals.
    shape, _, scale = stats.t.fit(fit.residuals["y1"], floc=0)
    assert (found.value, sigma.value) == pytest.approx((shape, scale), rel=1e-3)


def test_degrees_of_freedom_of_gaussian_noise_end_at_their_bound() -> None:
    e = record(0.2 * np.random.default_rng(4).uniform(-1, 1, (1, 500)))
    fit = ph.estimate(steady(1), e, noise=StudentT(dof=None, bounds=(1, 50)))
    assert fit.parameters["dof_y1"].bounds_active == "upper"
    assert fit.parameters["dof_y1"].value == pytest.approx(50)


def test_parameters_of_the_user_s_density_are_estimated() -> None:
    random = np.random.default_rng(2)
    wide = np.where(random.random((1, 3000)) < 0.2, 8.0, 1.0)
    e = record(0.1 * wide * random.standard_normal((1, 3000)))
    fit = ph.estimate(steady(1), e, noise=Density(some_bad, parameters=BAD))
    share, sigma = fit.parameters["share_y1"], fit.parameters["sigma_y1"]
    assert fit.converged and abs(share.value - 0.2) < 3 * share.std_error < 0.1
    assert abs(sigma.value - 0.1) < 3 * sigma.std_error


def test_user_s_gaussian_is_the_gaussian() -> None:
    m, e = steady(1), record(some_noise(1, 60))
    own = Density(lambda r, sigma: -((r / sigma) ** 2) / 2 - log(sigma))
    one, other = ph.estimate(m, e), ph.estimate(m, e, noise=own)
    assert other.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-12)
    np.testing.assert_allclose(other.parameters.values_array, one.parameters.values_array, rtol=1e-8)
    np.testing.assert_allclose(other.parameters.std_errors_array, one.parameters.std_errors_array, rtol=1e-6)


@pytest.mark.parametrize("name", ["t, dof", "laplace", "correlated"])
def test_ipopt_finds_the_same(name: str) -> None:
    pytest.importorskip("cyipopt")
    m, e = steady(3), record(correlated_noise(150, 6))
    one = ph.estimate(m, e, noise=NOISES[name])
    other = ph.estimate(m, e, noise=NOISES[name], solver=ph.Ipopt())
    assert one.converged and other.converged
    assert other.log_likelihood == pytest.approx(one.log_likelihood, abs=1e-5)
    np.testing.assert_allclose(other.parameters.values_array, one.parameters.values_array, rtol=2e-3, atol=2e-3)


def test_sigma_at_its_floor_with_full_covariance() -> None:
    m, e = steady(3), record(correlated_noise(60, 6))
    fit = ph.estimate(m, e, noise=Gaussian({"y3": Sigma(bounds=(1.0, 3.0))}, correlated=True))
    assert fit.converged
    assert fit.parameters["sigma_y3"].bounds_active == "lower"
    assert fit.parameters["sigma_y3"].value == pytest.approx(1.0, rel=1e-6)
    assert np.isnan(fit.parameters["sigma_y3"].std_error)


SAVED = [
    Gaussian(),
    Gaussian({"y1": 0.1, "y2": Sigma(0.2, (0.1, 1.0))}),
    Gaussian(correlated=True),
    Gaussian(covariance=R3),
    Gaussian(covariance={"y1": {"y1": 1.0, "y2": 0.5}, "y2": {"y2": 2.0}}),
    StudentT({"y1": 0.1}),
    StudentT(dof={"y1": None, "y2": 7}, bounds=(2, 30)),
    Huber(k=2.0),
    Laplace(smoothing=0.3),
    Density(some_bad, {"y1": 0.4}, BAD),
    PerOutput({"y1": StudentT({"y1": 0.3}), "y2": Density(cauchy)}, {"y3": 0.2}),
]


@pytest.mark.parametrize("noise", SAVED, ids=lambda n: n.kind)
def test_noise_is_saved_with_the_model(noise: Any) -> None:
    m = steady(3)
    m.noise(noise)
    assert Model.from_json(m.to_json()).noise_model == noise


@pytest.mark.parametrize("noise", [Gaussian(correlated=True), StudentT(dof=None), Density(some_bad, parameters=BAD)])
def test_fit_is_saved_summarised_and_gone_on_from(noise: Any, tmp_path: Any) -> None:
    m, e = steady(3), record(correlated_noise(300, 9))
    fit = ph.estimate(m, e, noise=noise)
    assert list(fit.parameters) == [*m.parameter_names, *noise.names(NAMES)]
    text = fit.summary()
    assert noise.description in text and all(name in text for name in noise.names(NAMES))
    fit.save(tmp_path / "fit.json")
    loaded = ph.load(tmp_path / "fit.json")
    assert loaded.noise == noise and loaded.parameters.to_dict() == fit.parameters.to_dict()
    again = ph.estimate(m, e, noise=noise, start=fit)
    assert again.iterations <= 1
    by_value = ph.estimate(m, e, noise=noise, start=fit.parameters.to_dict())
    assert by_value.log_likelihood == pytest.approx(fit.log_likelihood, rel=1e-10)
    # Another noise takes what it knows, and a simulation none of it.
    assert ph.estimate(m, e, start=fit).converged
    assert set(ph.simulate(m, fit, e).outputs) == set(NAMES)


def test_density_that_underflows_at_the_start() -> None:
    noise = Density(some_bad, parameters=BAD)
    with pytest.raises(ph.EvaluationError, match="the log-density of the noise is not finite: a residual is too large"):
        ph.estimate(steady(2), record(some_noise(2, 30)), noise=noise, start={"sigma_y2": 1e-6})


def test_noise_by_output_from_the_model() -> None:
    m = steady(3)
    m.noise(y1=StudentT(dof=None), y2=0.3)
    fit = ph.estimate(m, record(some_noise(3, 200)))
    assert list(fit.parameters)[3:] == ["sigma_y1", "sigma_y3", "dof_y1"]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: StudentT(dof=-1), "dof is a positive number"),
        (lambda: StudentT(bounds=(5, 2)), "bounds of dof"),
        (lambda: Huber(k=0), "k is a positive number"),
        (lambda: Laplace(smoothing=-1), "smoothing is a positive number"),
        (lambda: Gaussian({"y1": 0.1}, correlated=True), "sigma_y1 is known"),
        (lambda: Gaussian(correlated=True, covariance=R3), "leave out sigma and correlated"),
        (lambda: Gaussian(covariance=[1.0, 2.0]), "a square matrix"),
        (lambda: Gaussian(covariance={"a": {"b": 1.0}, "b": {"a": 2.0}}), "is not one number"),
        (lambda: Density(3.0), "is a function of residual"),
        (lambda: Density(lambda r, sigma: 1.0), "returned 1.0"),
        (lambda: Density(cauchy, parameters={"sigma": 1.0}), "cannot be the name"),
        (lambda: PerOutput({"y1": Gaussian(correlated=True)}), "is an independent noise model"),
        (lambda: steady(1).noise(3.0), "a noise model is a Gaussian"),
    ],
)
def test_what_cannot_be_noise(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(ph.ModelError, match=words):
        make()


@pytest.mark.parametrize(
    ("noise", "words"),
    [
        (Gaussian(covariance=np.eye(2)), r"shape \(2, 2\), but there are 3 outputs"),
        (Gaussian(covariance=-np.eye(3)), "variance -1 of output number 1 is not positive"),
        (Gaussian(covariance=np.eye(3) + np.eye(3, k=1)), "not symmetric in 'y2' and 'y1'"),
        (Gaussian(covariance=np.ones((3, 3))), "not positive definite"),
        (Gaussian(covariance={"y1": {"Y2": 1.0}}), "Did you mean 'y2'"),
        (StudentT(dof={"z": 3}), "'z', which is not an output"),
        (Density(ph.Expr.symbol("residul") * ph.Expr.symbol("sigma")), "Did you mean 'residual'"),
        (Density(ph.Expr.symbol("sigma") * 1.0), "does not depend on 'residual'"),
        (PerOutput({"y9": Huber()}), "'y9' is not an output"),
    ],
)
def test_noise_that_does_not_fit_the_outputs(noise: Any, words: str) -> None:
    with pytest.raises(ph.PhugoidError, match=words):
        ph.estimate(steady(3), record(some_noise(3, 20)), noise=noise)


@pytest.mark.parametrize(
    ("noise", "start", "words"),
    [
        (Gaussian(correlated=True), {"corr_y1_y2": 1.5}, r"'corr_y1_y2' = 1\.5 lies outside its bounds"),
        (
            Gaussian(correlated=True),
            {"corr_y1_y2": 0.9, "corr_y2_y3": 0.9, "corr_y1_y3": -0.9},
            "contradict each other",
        ),
        (Gaussian(covariance=R3), {"sigma_y1": 1.0}, "the covariance is known, and it contains sigma_y1"),
        (Gaussian(), {"corr_y1_y2": 0.5}, "'corr_y1_y2' is not a parameter"),
        (StudentT(dof=None), {"dof_y1": 1000.0}, "'dof_y1' = 1000.0 lies outside its bounds"),
        (Density(some_bad, parameters=BAD), {"share_y1": 0.9}, "'share_y1' = 0.9 lies outside its bounds"),
    ],
)
def test_starts_of_noise(noise: Any, start: dict[str, float], words: str) -> None:
    with pytest.raises(ph.PhugoidError, match=words):
        ph.estimate(steady(3), record(some_noise(3, 20)), noise=noise, start=start)
