"""The filter-error method against a Kalman filter, dense algebra and simulated turbulence."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.polynomial.legendre import Legendre
from scipy.linalg import expm

import phugoid as ph
from phugoid import DataError, EvaluationError, Experiment, FilterError, Fit, Model, ModelError, OptionError, Parameter
from phugoid.filter_error import FEWEST
from phugoid.solvers import Deadline, Iteration

U0 = 44.57  # m/s
TRUTH = {"Zw": -1.4, "Zq": -1.5, "Zde": -6.3, "Mw": -0.15, "Mq": -2.7, "Mde": -12.8}
SIGMA = {"w": 0.1, "q": 0.003, "az": 0.05}
BOTH = FilterError(("w", "q"))
COARSE = replace(BOTH, substeps=FEWEST[0], terms=FEWEST[1])  # where the likelihood is asked for by itself
MAXIMISED = {"w": None, "q": None}  # initial states as in the output-error method


def short_period(**parameters: Any) -> Model:
    """w and q after the elevator."""
    m = Model("short period")
    w, q = m.states(w="m/s", q="rad/s")
    (de,) = m.inputs(de="rad")
    Zw, Zq, Zde, Mw, Mq, Mde = m.parameters(**{**dict.fromkeys(TRUTH, 0.0), **parameters})
    az = Zw * w + Zq * q + Zde * de
    m.dynamics(w=az + U0 * q, q=Mw * w + Mq * q + Mde * de)
    m.outputs(w=w, q=q, az=(az, "m/s²"))
    return m


class Linear:
    """The same in matrices, with plain Runge-Kutta steps."""

    def __init__(self, p: dict[str, float]) -> None:
        self.A = np.array([[p["Zw"], U0 + p["Zq"]], [p["Mw"], p["Mq"]]])
        self.B = np.array([p["Zde"], p["Mde"]])
        self.C = np.array([[1, 0], [0, 1], [p["Zw"], p["Zq"]]])
        self.D = np.array([0, 0, p["Zde"]])

    def step(
        self, x: np.ndarray, ua: float, ub: float, h: float, noise: np.ndarray | None = None, steps: int = 1
    ) -> np.ndarray:
        """Over an interval, with slopes ``noise`` (2, terms) of orthonormal polynomials over it."""

        def f(x: np.ndarray, share: float) -> np.ndarray:
            slope = self.A @ x + self.B * (ua + share * (ub - ua))
            return slope if noise is None else slope + noise @ polynomials(share, noise.shape[1]) / np.sqrt(h)

        d = h / steps
        for i in range(steps):
            a, m, b = (i + np.array([0, 0.5, 1])) / steps
            k1 = f(x, a)
            k2 = f(x + d / 2 * k1, m)
            k3 = f(x + d / 2 * k2, m)
            x = x + d / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + d * k3, b))
        return np.asarray(x)

    def transition(self, h: float, steps: int = 1) -> np.ndarray:
        return np.array([self.step(e, 0.0, 0.0, h, steps=steps) - self.step(0 * e, 0.0, 0.0, h) for e in np.eye(2)]).T

    def gathered(self, h: float, q: np.ndarray, mesh: tuple[int, int] | None) -> np.ndarray:
        """Covariance of the noise that gathers over an interval: by polynomials, or exactly (van Loan 1978)."""
        if mesh is None:
            blocks = np.zeros((4, 4))
            blocks[:2, :2], blocks[:2, 2:], blocks[2:, 2:] = -self.A, np.diag(q**2), self.A.T
            e = expm(blocks * h)
            return np.asarray(e[2:, 2:].T @ e[:2, 2:])
        steps, terms = mesh
        columns = []
        for i in range(2):
            for j in range(terms):
                noise = np.zeros((2, terms))
                noise[i, j] = q[i]
                columns.append(self.step(np.zeros(2), 0.0, 0.0, h, noise, steps))
        return np.array(columns).T @ np.array(columns)


def polynomials(share: float, terms: int) -> np.ndarray:
    """Orthonormal on (0, 1)."""
    return np.array([np.sqrt(2 * j + 1) * Legendre.basis(j, domain=[0, 1])(share) for j in range(terms)])


def kalman(
    p: dict[str, float],
    e: Experiment,
    q: np.ndarray,
    x: np.ndarray,
    P: np.ndarray,
    mesh: tuple[int, int] | None = FEWEST,
) -> tuple[float, np.ndarray]:
    """Log-likelihood, without the constant, and innovations (n_y, N), from mean and covariance of the first state.

    ``mesh``: steps and terms of the noise between samples; None: its exact covariance, and one step.
    """
    s, u, t = Linear(p), e.input("de"), e.t
    steps = 1 if mesh is None else mesh[0]
    z = np.array([e.output(n) for n in SIGMA])
    R = np.diag([s**2 for s in SIGMA.values()])
    total, innovations = 0.0, np.full(z.shape, np.nan)
    for k in range(t.size):
        there = np.isfinite(z[:, k])
        C, r = s.C[there], R[np.ix_(there, there)]
        v = z[there, k] - C @ x - s.D[there] * u[k]
        innovations[there, k] = v
        S = C @ P @ C.T + r
        total -= 0.5 * (v @ np.linalg.solve(S, v) + np.linalg.slogdet(S)[1])
        K = P @ C.T @ np.linalg.inv(S)
        F = np.eye(2) - K @ C
        x, P = x + K @ v, F @ P @ F.T + K @ r @ K.T
        if k + 1 < t.size:
            h = t[k + 1] - t[k]
            x, phi = s.step(x, u[k], u[k + 1], h, steps=steps), s.transition(h, steps)
            P = phi @ P @ phi.T + s.gathered(h, q, mesh)
    return float(total), innovations


def turbulent(
    seed: int,
    q: tuple[float, float],
    n: int = 200,
    t: np.ndarray | None = None,
    sigma: dict[str, float] = SIGMA,
) -> Experiment:
    """A record of `short_period` in which white noise of these intensities drives w and q."""
    rng = np.random.default_rng(seed)
    t = 0.05 * np.arange(n) if t is None else t
    de = 0.05 * np.select([t < 1, t < 2.5, t < 3.5, t < 5, t < 6.5], [0, 1, -1, 0.7, -0.5], 0)
    s, x = Linear(TRUTH), np.array([0.3, -0.01])
    path = [x]
    for k in range(t.size - 1):
        h = t[k + 1] - t[k]
        values, vectors = np.linalg.eigh(s.gathered(h, np.array(q), None))
        x = s.step(x, de[k], de[k + 1], h, steps=4) + vectors @ (
            np.sqrt(np.maximum(values, 0)) * rng.standard_normal(2)
        )
        path.append(x)
    y = s.C @ np.array(path).T + s.D[:, None] * de
    noise = np.array(list(sigma.values()))[:, None] * rng.standard_normal(y.shape)
    return Experiment(t, {"de": de}, dict(zip(SIGMA, y + noise, strict=True)), name="run")


def uneven(seed: int = 3) -> Experiment:
    """Uneven times, and samples missing singly, in a row, at both ends, and all at once."""
    rng = np.random.default_rng(seed)
    e = turbulent(seed, (0.8, 0.05), t=np.cumsum(rng.uniform(0.02, 0.09, 150)))
    z = {n: e.output(n).copy() for n in SIGMA}
    z["w"][20:30] = np.nan
    z["q"][[0, 7, 25, 149]] = np.nan
    z["az"][25] = np.nan
    return e.with_outputs(z)


def marginal(
    options: FilterError,
    e: Experiment,
    q: tuple[float, ...],
    sigma: dict[str, float] = SIGMA,
    at: dict[str, float] = TRUTH,
) -> Any:
    """The core's log-likelihood and gradient, at the true parameters unless others are given."""
    m = short_period(**at)
    problem = options.problem(m, [e], [(True, s, s, s) for s in sigma.values()])
    theta = np.array([*at.values(), *q])
    found = problem.evaluate(theta, problem.start(np.zeros(2 * e.n)), True)
    assert not isinstance(found, str), found
    return found


@pytest.mark.parametrize("q", [(0.7, 0.05), (0.0, 0.0), (1e-6, 2.0), (30.0, 0.0)])
@pytest.mark.parametrize("record", ["even", "uneven"])
def test_linear_system_has_the_likelihood_of_a_kalman_filter(q: tuple[float, float], record: str) -> None:
    e = turbulent(0, (0.8, 0.05)) if record == "even" else uneven()
    options = replace(BOTH, initial={"w": (0.2, 0.5), "q": (0.0, 0.1)})
    expected, _ = kalman(TRUTH, e, np.array(q), np.array([0.2, 0.0]), np.diag([0.25, 0.01]))
    assert marginal(options, e, q)[0] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("mesh", [(1, 1), (3, 2), (2, 4)])
def test_terms_and_steps_of_the_noise_between_samples(mesh: tuple[int, int]) -> None:
    e = uneven()
    options = FilterError(("w", "q"), *mesh, initial={"w": (0.2, 0.5), "q": (0.0, 0.1)})
    expected, _ = kalman(TRUTH, e, np.array([0.8, 0.05]), np.array([0.2, 0.0]), np.diag([0.25, 0.01]), mesh)
    assert marginal(options, e, (0.8, 0.05))[0] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("q", [(0.8, 0.05), (0.0, 0.3), (2.0, 0.0)])
def test_the_covariance_of_the_noise_is_the_exact_one(q: tuple[float, float]) -> None:
    """Noise that comes at samples alone, Q h, is wrong by the first order of h; here each term brings two more."""
    s, h, of = Linear(TRUTH), 0.05, np.array(q)
    exact = s.gathered(h, of, None)
    size = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))

    def off(covariance: np.ndarray) -> float:
        return float(np.abs((covariance - exact) / size).max())

    plain, *found = (off(c) for c in (np.diag(of**2) * h, *(s.gathered(h, of, (32, n)) for n in (1, 2, 3))))
    assert plain > 0.05 and found[1] < 2e-3 and found[2] < 2e-5, (plain, found)
    assert off(s.gathered(h, of, FEWEST)) < 2e-3


def test_noise_in_one_state_alone() -> None:
    e = uneven()
    options = FilterError("q", initial={"w": (0.2, 0.5), "q": (0.0, 0.1)})
    expected, _ = kalman(TRUTH, e, np.array([0.0, 0.05]), np.array([0.2, 0.0]), np.diag([0.25, 0.01]))
    assert marginal(options, e, (0.05,))[0] == pytest.approx(expected, rel=1e-10)


def test_free_first_states_are_integrated_out_or_maximised_over() -> None:
    # From a first state known exactly, the likelihood is a quadratic function of it: six values give its maximum.
    e, q = uneven(), np.array([0.8, 0.05])

    def at(x: np.ndarray) -> float:
        return kalman(TRUTH, e, q, np.asarray(x), np.zeros((2, 2)))[0]

    zero, (i, j) = at(np.zeros(2)), np.eye(2) * [1.0, 0.1]
    slope = np.array([at(i) - at(-i), at(j) - at(-j)]) / 2
    bend = np.diag([at(i) + at(-i) - 2 * zero, at(j) + at(-j) - 2 * zero])
    bend[0, 1] = bend[1, 0] = (at(i + j) + at(-i - j) - at(i - j) - at(j - i)) / 4
    best = zero - 0.5 * slope @ np.linalg.solve(bend, slope)
    assert marginal(replace(BOTH, initial=MAXIMISED), e, (0.8, 0.05))[0] == pytest.approx(best, rel=1e-8)
    bend *= np.outer([1, 10], [1, 10])
    flat = best - 0.5 * np.linalg.slogdet(-bend)[1]
    assert marginal(BOTH, e, (0.8, 0.05))[0] == pytest.approx(flat, rel=1e-8)


def test_without_noise_it_is_the_likelihood_of_output_error() -> None:
    e = turbulent(1, (0.0, 0.0))
    fixed = short_period(**{n: Parameter(v, fixed=True) for n, v in TRUTH.items()})
    fit = ph.estimate(fixed, e, noise=ph.Gaussian(SIGMA))
    assert marginal(replace(BOTH, substeps=16, initial=MAXIMISED), e, (0.0, 0.0))[0] == pytest.approx(
        fit.log_likelihood, abs=1e-6
    )


def test_states_and_their_deviations_are_those_of_dense_algebra() -> None:
    e, q = uneven().window(0.5, 1.6), np.array([0.8, 0.05])
    m = short_period(**{n: Parameter(v, fixed=True) for n, v in TRUTH.items()})
    options = replace(BOTH, initial={"w": (0.2, 0.5), "q": (0.0, 0.1)})
    problem = options.problem(m, [e], [(True, s, s, s) for s in SIGMA.values()])
    theta = np.array([*TRUTH.values(), *q])
    found = problem.smooth(theta, problem.start(np.zeros(2 * e.n)))
    assert found is not None
    ((states, deviations), (_, output_deviations), (innovations, spreads), _), first, _ = found[0]

    s, u, n = Linear(TRUTH), e.input("de"), 2 * e.n
    precision, right = np.zeros((n, n)), np.zeros(n)

    def add(rows: np.ndarray, target: np.ndarray, variance: np.ndarray) -> None:
        nonlocal precision, right
        precision = precision + rows.T @ (rows / variance[:, None])
        right = right + rows.T @ (target / variance)

    pick = np.eye(n).reshape(e.n, 2, n)
    add(pick[0], np.array([0.2, 0.0]), np.array([0.25, 0.01]))
    for k in range(e.n):
        z = np.array([e.output(c)[k] for c in SIGMA])
        there = np.isfinite(z)
        add(s.C[there] @ pick[k], (z - s.D * u[k])[there], np.array(list(SIGMA.values()))[there] ** 2)
        if k + 1 < e.n:
            h = e.t[k + 1] - e.t[k]
            forced = s.step(np.zeros(2), u[k], u[k + 1], h)
            root = np.linalg.cholesky(s.gathered(h, q, FEWEST))
            rows = pick[k + 1] - s.transition(h) @ pick[k]
            add(np.linalg.solve(root, rows), np.linalg.solve(root, forced), np.ones(2))
    covariance = np.linalg.inv(precision)
    np.testing.assert_allclose(states.T.ravel(), covariance @ right, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(deviations.T.ravel(), np.sqrt(np.diag(covariance)), rtol=1e-7)
    np.testing.assert_allclose(first.reshape(2, 2), covariance[:2, :2], rtol=1e-6)
    for k in range(e.n):  # of outputs that are missing, too
        expected = s.C @ pick[k] @ covariance @ pick[k].T @ s.C.T
        np.testing.assert_allclose(output_deviations[:, k] ** 2, np.diag(expected), rtol=1e-6)
    _, expected = kalman(TRUTH, e, q, np.array([0.2, 0.0]), np.diag([0.25, 0.01]))
    np.testing.assert_allclose(innovations, expected, rtol=1e-7, atol=1e-9)
    assert (spreads[np.isfinite(spreads)] > 0).all()


@pytest.fixture(scope="module")
def gust() -> tuple[Experiment, Fit]:
    e = turbulent(5, (1.0, 0.05))
    return e, ph.estimate(short_period(), e, transcription=BOTH)


def test_the_fit_is_a_maximum_and_its_errors_are_the_curvature_there(gust: tuple[Experiment, Fit]) -> None:
    e, fit = gust
    assert fit.converged and not fit.warnings

    def likelihood(moved: dict[str, float]) -> float:
        p = {n: v.value for n, v in fit.parameters.items()} | moved
        sigma = {n: p[f"sigma_{n}"] for n in SIGMA}
        problem = COARSE.problem(fit.model, [e], [(True, s, s, s) for s in sigma.values()])
        theta = np.array([p[n] for n in (*TRUTH, "q_w", "q_q")])
        found = problem.evaluate(theta, problem.start(np.zeros(2 * e.n)), False)
        return float(found[0])

    assert likelihood({}) == pytest.approx(fit.log_likelihood, rel=1e-10)
    names = [*fit.parameters]
    information = np.linalg.inv(fit.covariance)
    for k, name in enumerate(names):
        v, d = fit.parameters[name].value, 0.02 / np.sqrt(information[k, k])
        up, down = likelihood({name: v + d}), likelihood({name: v - d})
        assert up < fit.log_likelihood and down < fit.log_likelihood
        assert abs(up - down) / (2 * d) < 1e-3 * np.sqrt(information[k, k])  # the slope is nothing
        bend = -(up + down - 2 * fit.log_likelihood) / d**2
        # In ln sigma, where it was computed, third derivatives enter otherwise.
        assert bend == pytest.approx(information[k, k], rel=5e-3)


def test_innovations_are_white_where_residuals_of_output_error_are_not(gust: tuple[Experiment, Fit]) -> None:
    e, fit = gust

    def lag_one(r: np.ndarray) -> float:
        return float(r[1:] @ r[:-1] / (r @ r))

    ordinary = ph.estimate(short_period(), e)
    record = fit.records[0]
    for name in SIGMA:
        scaled = record.innovations[name] / record.innovation_std[name]
        assert abs(lag_one(scaled)) < 3 / np.sqrt(e.n)
        assert 0.85 < scaled.std() < 1.15
        assert lag_one(ordinary.residuals[name]) > 0.7


def test_twenty_records_in_turbulence() -> None:
    """Output error says far too small errors; the filter-error method's are right, and it finds the turbulence."""
    q = (1.0, 0.05)
    truth = {**TRUTH, "q_w": q[0], "q_q": q[1]}
    deviations: dict[str, list[float]] = {"filter": [], "ordinary": []}
    found = {n: [] for n in truth}  # type: ignore[var-annotated]
    for seed in range(20):
        e = turbulent(100 + seed, q)
        ordinary = ph.estimate(short_period(), e)
        fit = ph.estimate(short_period(), e, transcription=BOTH)
        assert fit.converged and fit.log_likelihood > ordinary.log_likelihood + 100
        for name, value in truth.items():
            each = fit.parameters[name]
            found[name].append((each.value - value) / each.std_error)
        for kind, result in (("filter", fit), ("ordinary", ordinary)):
            deviations[kind] += [
                (result.parameters[n].value - v) / result.parameters[n].std_error for n, v in TRUTH.items()
            ]
    rms = {kind: np.sqrt(np.mean(np.square(d))) for kind, d in deviations.items()}
    assert 0.75 < rms["filter"] < 1.3, rms
    assert rms["ordinary"] > 2.5, rms
    for name, each in found.items():
        # The mean of twenty has a standard error of 0.22.
        assert abs(np.mean(each)) < 0.8, (name, np.mean(each))


def test_without_turbulence_it_agrees_with_output_error() -> None:
    for seed in range(3):
        e = turbulent(seed, (0.0, 0.0))
        ordinary = ph.estimate(short_period(), e)
        fit = ph.estimate(short_period(), e, transcription=BOTH)
        assert fit.converged
        for name in TRUTH:
            each, other = fit.parameters[name], ordinary.parameters[name]
            assert abs(each.value - other.value) < 0.5 * other.std_error
            assert each.std_error < 2 * other.std_error
        assert fit.parameters["q_w"].value < 0.1 and fit.parameters["q_q"].value < 0.005
        none = [n for n in ("q_w", "q_q") if fit.parameters[n].bounds_active == "lower"]
        assert [w.split()[0] for w in fit.warnings] == none


def test_starts_agree(gust: tuple[Experiment, Fit]) -> None:
    e, fit = gust
    ordinary = ph.estimate(short_period(), e)
    for options, start in (
        (BOTH, ordinary),
        (replace(BOTH, output_error=True), None),
        (replace(BOTH, output_error=True), {"q_w": 0.01}),
        (BOTH, {"q_w": 0.02, "q_q": 0.5, "sigma_q": 0.05, "Mq": -5.0}),
        (BOTH, fit),
    ):
        again = ph.estimate(short_period(), e, transcription=options, start=start)
        assert again.converged and again.log_likelihood == pytest.approx(fit.log_likelihood, abs=1e-5)
    assert again.iterations <= 3


def test_several_records_priors_bounds_and_known_noise() -> None:
    runs = [replace_name(turbulent(7, (1.0, 0.05)), "a"), replace_name(turbulent(8, (1.0, 0.05), n=120), "b")]
    m = short_period(
        Mw=Parameter(-0.1, bounds=(-0.1, 0.0)), Zq=Parameter(0.0, prior=(-1.5, 1e-4)), Zde=Parameter(-6.3, fixed=True)
    )
    fit = ph.estimate(m, runs, transcription=BOTH, noise=ph.Gaussian({"q": 0.003}))
    assert fit.converged and "sigma_q" not in fit.parameters
    assert fit.parameters["Mw"].bounds_active == "upper" or fit.parameters["Mw"].bounds_active == "lower"
    assert fit.parameters["Mw"].value == -0.1 and np.isnan(fit.parameters["Mw"].std_error)
    assert fit.parameters["Zq"].value == pytest.approx(-1.5, abs=5e-4)
    assert fit.parameters["Zde"].fixed and fit.parameters["Zde"].value == -6.3
    assert [r.n for r in fit.records] == [200, 120]
    assert set(fit.initial_states) == {"a", "b"} and fit.initial_states["b"]["w"].std_error > 0


def test_biases_of_each_record() -> None:
    """Derivatives shared, a bias of q of each: as with two parameters that inputs switch. All local: as two fits."""
    runs = [replace_name(turbulent(7, (1.0, 0.05)), "a"), replace_name(turbulent(8, (1.0, 0.05), n=120), "b")]
    biased = [e.with_outputs({**e.outputs, "q": e.output("q") + b}) for e, b in zip(runs, (0.02, -0.03), strict=True)]

    other = Model("short period, biased")
    w, q = other.states(w="m/s", q="rad/s")
    (de,) = other.inputs(de="rad")
    Zw, Zq, Zde, Mw, Mq, Mde = other.parameters(*TRUTH)
    (b,) = other.parameters(bias=Parameter(0.0, per_experiment=True))
    az = Zw * w + Zq * q + Zde * de
    other.dynamics(w=az + U0 * q, q=Mw * w + Mq * q + Mde * de)
    other.outputs(w=w, q=q + b, az=az)
    fit = ph.estimate(other, biased, transcription=BOTH)
    assert fit.converged
    for i, true in enumerate((0.02, -0.03)):
        e = fit.parameters[f"bias[{'ab'[i]}]"]
        assert abs(e.value - true) < 4 * e.std_error
    plain = ph.estimate(short_period(), runs, transcription=BOTH)
    for name in TRUTH:
        e = plain.parameters[name]
        assert abs(fit.parameters[name].value - e.value) < 2 * e.std_error
    assert set(fit.records[0].inputs) == set(other.input_names)
    again = ph.estimate(other, biased, transcription=BOTH, start=fit)
    assert again.log_likelihood == pytest.approx(fit.log_likelihood, abs=1e-4)
    assert again.iterations < fit.iterations

    local = short_period(**{n: Parameter(0.0, per_experiment=True) for n in TRUTH})
    apart = ph.estimate(local, runs, transcription=BOTH, noise=ph.Gaussian(SIGMA))
    total = 0.0
    for e in runs:
        own = {n: apart.parameters[f"{n}[{e.name}]"].value for n in TRUTH}
        q = apart.parameters["q_w"].value, apart.parameters["q_q"].value
        total += marginal(BOTH, e, q, at=own)[0]
    assert apart.log_likelihood == pytest.approx(total, rel=1e-8)


def replace_name(e: Experiment, name: str) -> Experiment:
    return e.window(e.t[0], e.t[-1], name=name)


def test_default_is_fine_enough_for_precise_sensors() -> None:
    """The likelihood of noise that comes at samples alone is far off there."""
    sigma = {n: 0.1 * s for n, s in SIGMA.items()}
    e = turbulent(5, (1.0, 0.05), sigma=sigma)
    fit = ph.estimate(short_period(), e, transcription=BOTH)
    fine = ph.estimate(short_period(), e, transcription=replace(BOTH, terms=4, substeps=8), start=fit)
    assert fit.converged and fine.converged and isinstance(fit.transcription, FilterError)
    assert (fit.transcription.substeps, fit.transcription.terms) == FEWEST
    one, other = fit.parameters.values_array, fine.parameters.values_array
    # sigma_w sits at its bound: gusts hide it.
    assert np.nanmax(np.abs(one - other) / fine.parameters.std_errors_array) < 0.02


def test_terms_are_added_until_they_move_nothing() -> None:
    """Samples far apart for such motion."""
    e = turbulent(5, (1.0, 0.05), t=0.5 * np.arange(80))
    fit = ph.estimate(short_period(), e, transcription=BOTH)
    assert fit.converged and isinstance(fit.transcription, FilterError)
    steps, terms = fit.transcription.mesh
    assert steps > FEWEST[0] and terms > FEWEST[1] and f"of {terms} terms and {steps} steps" in str(fit.transcription)
    fine = ph.estimate(short_period(), e, transcription=replace(BOTH, terms=6, substeps=20), start=fit)
    coarse = ph.estimate(short_period(), e, transcription=COARSE, start=fit)

    def off(other: Fit) -> float:
        one, two = other.parameters.values_array, fine.parameters.values_array
        return float(np.nanmax(np.abs(one - two) / fine.parameters.std_errors_array))

    assert off(fit) < 0.1 < off(coarse)
    # What is given is kept, the other chosen.
    kept = ph.estimate(short_period(), e, transcription=replace(BOTH, terms=3), start=fit).transcription
    assert isinstance(kept, FilterError) and kept.terms == 3 and (kept.substeps or 0) > 1


def test_motion_too_fast_for_the_samples_is_told_of() -> None:
    """A state forgets its noise many times between two samples."""
    rng = np.random.default_rng(0)
    t, rate, q = 1.0 * np.arange(400), -12.0, 2.0
    m = Model("fast")
    (x,) = m.states("x")
    m.dynamics(x=rate * x)
    m.outputs(x=x)
    e = Experiment(t, outputs={"x": q / np.sqrt(-2 * rate) * rng.standard_normal(t.size)}, name="run")
    known = ph.Gaussian({"x": 0.01})
    fit = ph.estimate(m, e, transcription=FilterError("x", substeps=30), noise=known)
    assert fit.converged and any("last refinement of the noise between samples" in w for w in fit.warnings)
    more = ph.estimate(m, e, transcription=FilterError("x", terms=12, substeps=30), noise=known)
    assert more.converged and not more.warnings
    assert more.parameters["q_x"].value == pytest.approx(q, rel=0.1)


def test_a_fit_is_saved_plotted_simulated_and_gone_on_from(gust: tuple[Experiment, Fit], tmp_path: Path) -> None:
    e, fit = gust
    assert fit.experiments == (e,)
    fit.save(tmp_path / "fit.json")
    again = ph.load(tmp_path / "fit.json")
    np.testing.assert_array_equal(again.experiments[0].output("w"), e.output("w"))
    assert again.transcription == fit.transcription and again.summary() == fit.summary()
    np.testing.assert_array_equal(again.records[0].state_std["w"], fit.records[0].state_std["w"])
    assert "filter error, process noise in w, q" in fit.summary()
    assert fit.parameters["q_w"].unit == "m/s/√s"
    simulated = ph.simulate(fit.model, fit, e)
    assert simulated.outputs["w"][0] == pytest.approx(fit.outputs["w"][0], rel=1e-9)
    assert ph.estimate(short_period(), e, start=fit).converged


def test_known_intensities_are_held(gust: tuple[Experiment, Fit], tmp_path: Path) -> None:
    e, fit = gust
    known = {n: fit.parameters[f"q_{n}"].value for n in ("w", "q")}
    held = ph.estimate(short_period(), e, transcription=replace(BOTH, intensities=known))
    assert held.converged and held.log_likelihood == pytest.approx(fit.log_likelihood, abs=1e-6)
    for name, q in known.items():
        assert held.parameters[f"q_{name}"].value == q and held.parameters[f"q_{name}"].fixed
        assert np.isnan(held.parameters[f"q_{name}"].std_error)
    for name in TRUTH:
        a, b = held.parameters[name], fit.parameters[name]
        assert abs(a.value - b.value) < 1e-2 * b.std_error and a.std_error < 1.001 * b.std_error
    held.save(tmp_path / "held.json")
    assert ph.load(tmp_path / "held.json").transcription == held.transcription
    # A fit with unknown ones is a start; and none in q is noise in w alone.
    one = ph.estimate(short_period(), e, transcription=replace(BOTH, intensities={"q": 0.0}), start=fit)
    alone = ph.estimate(short_period(), e, transcription=FilterError("w"))
    assert one.log_likelihood == pytest.approx(alone.log_likelihood, abs=1e-5) and one.parameters["q_q"].value == 0.0


def test_interrupt_gives_the_best_point_so_far() -> None:
    lines: list[Iteration] = []

    def watch(line: Iteration) -> None:
        lines.append(line)
        if line.number == 3:
            raise KeyboardInterrupt

    fit = ph.estimate(short_period(), turbulent(5, (1.0, 0.05)), transcription=BOTH, progress=watch)
    assert fit.status == "interrupted" and len(lines) == 3
    assert fit.log_likelihood == pytest.approx(lines[-1].log_likelihood, rel=1e-12)
    assert np.isnan(fit.parameters["Mq"].std_error) and any("no standard errors" in w for w in fit.warnings)


def test_without_time_for_the_smoother_its_part_is_missing(
    gust: tuple[Experiment, Fit], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    e, smoothed = gust
    monkeypatch.setattr(Deadline, "with_grace", lambda deadline: 0.0)
    fit = ph.estimate(short_period(), e, transcription=BOTH)
    assert fit.converged and any("no innovations" in w for w in fit.warnings)
    assert fit.log_likelihood == pytest.approx(smoothed.log_likelihood, rel=1e-12)
    for name in ("w", "q"):
        np.testing.assert_allclose(fit.states[name], smoothed.states[name], atol=1e-4 * SIGMA[name])
        assert np.isnan(fit.records[0].state_std[name]).all()
        assert np.isnan(fit.initial_states["run"][name].std_error)
    assert np.isnan(fit.records[0].innovations["az"]).all() and fit.parameters["Mq"].std_error > 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit.report(tmp_path / "report.html")
    fit.save(tmp_path / "fit.json")
    assert ph.load(tmp_path / "fit.json").summary() == fit.summary()


def test_all_that_takes_long_looks_at_the_clock() -> None:
    e = turbulent(5, (1.0, 0.05))
    problem = COARSE.problem(short_period(**TRUTH), [e], [(True, s, s, s) for s in SIGMA.values()])
    theta, path = np.array([*TRUTH.values(), 1.0, 0.05]), problem.start(np.zeros(2 * e.n))
    for work in (lambda: problem.evaluate(theta, path, True, 0.0), lambda: problem.information(theta, path, 0.0)):
        with pytest.raises(TimeoutError):
            work()
    with pytest.raises(TimeoutError):
        problem.smooth(theta, path, 0.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"states": ()}, "states names the states"),
        ({"states": "W"}, "'W' is not a state. Did you mean 'w'?"),
        ({"states": ("w", "w")}, "named twice"),
        ({"substeps": 0}, "substeps is a whole number from 1"),
        ({"terms": 0}, "terms is a whole number from 1"),
        ({"terms": 1.5}, "terms is a whole number from 1"),
        ({"initial": {"w": 1.0}}, "initial 'w' is a mean and a positive standard deviation, or None"),
        ({"initial": {"v": (0, 1)}}, "'v' is not a state"),
        ({"intensities": {"q": 1.0}}, "intensity of 'q', which is none of states=('w',)"),
        ({"intensities": {"w": -1.0}}, "intensity of 'w' is a number from 0, not -1.0"),
        ({"intensities": 1.0}, "intensities are given by state"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=words.replace("(", r"\(").replace(")", r"\)")):
        ph.estimate(
            short_period(), turbulent(0, (1.0, 0.05)), transcription=FilterError(**{"states": ("w",), **options})
        )


def test_what_cannot_be_is_refused() -> None:
    e = turbulent(0, (1.0, 0.05))
    with pytest.raises(OptionError, match="a solver of its own"):
        ph.estimate(short_period(), e, transcription=BOTH, solver=ph.Newton())
    with pytest.raises(ModelError, match="'q_v' is not a parameter"):
        ph.estimate(short_period(), e, transcription=BOTH, start={"q_v": 1.0})
    with pytest.raises(ModelError, match="start of q_w is a positive number"):
        ph.estimate(short_period(), e, transcription=BOTH, start={"q_w": -0.0})
    with pytest.raises(ModelError, match="q_w is known"):
        ph.estimate(short_period(), e, transcription=replace(BOTH, intensities={"w": 1.0}), start={"q_w": 1.0})
    with pytest.raises(DataError, match="no output 'az'"):
        ph.estimate(
            short_period(), Experiment(e.t, e.inputs, {n: e.outputs[n] for n in ("w", "q")}), transcription=BOTH
        )

    m = Model("hidden")
    x, v = m.states("x v")
    (k,) = m.parameters("k")
    m.dynamics(x=v, v=-k * x)
    m.outputs(x=x)
    hidden = Experiment(e.t, outputs={"x": e.output("w")})
    with pytest.raises(OptionError, match="nothing to start 'q_v' from"):
        ph.estimate(m, hidden, transcription=FilterError("v"))

    m = Model("unseen")
    x, y = m.states("x y")
    (k,) = m.parameters("k")
    m.dynamics(x=k * x, y=x)
    m.outputs(x=x)
    with pytest.raises(EvaluationError, match="do not determine the initial value of state 'y': give initial="):
        ph.estimate(m, hidden, transcription=FilterError("x"))
    known = FilterError("x", initial={"y": (0.0, 1.0)})
    assert ph.estimate(m, hidden, transcription=known).converged
