"""estimate and Fit on small problems whose answer is known: by simulation, by algebra, by a second way."""

from __future__ import annotations

import json
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot as plt

import phugoid as ph
from phugoid import Collocation, DataError, Experiment, Fit, Gaussian, Ipopt, Model, Parameter, Sigma, estimate
from phugoid.initialisation import parameter_start, state_start
from phugoid.solvers import Iteration

T = np.linspace(0.0, 10.0, 101)
SQUARE = np.sign(np.sin(1.3 * T))
SMOOTH = np.sin(1.3 * T) + 0.5 * np.sin(2.9 * T)
LAG = {"tau": 0.8, "gain": 2.0}
OSCILLATOR = {"mu": 0.8, "k": 1.5}


def lag(**parameters: Any) -> Model:
    """x' = (gain u - x)/tau, x measured."""
    m = Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="V")
    tau, gain = m.parameters(**{"tau": Parameter(0.5, bounds=(0.01, 10.0), unit="s"), "gain": 1.0, **parameters})
    m.dynamics(x=(gain * u - x) / tau)
    m.outputs(x=x)
    return m


def oscillator() -> Model:
    """Van der Pol's, position measured, speed not."""
    m = Model("van der Pol")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    mu, k = m.parameters("mu k")
    m.dynamics(x=v, v=mu * (1 - x**2) * v - k * x + u)
    m.outputs(x=x)
    return m


def record(
    model: Model,
    truth: dict[str, float],
    t: np.ndarray,
    u: np.ndarray,
    sigma: float = 0.05,
    seed: int = 0,
    **options: Any,
) -> Experiment:
    """A simulated record: the output x with noise."""
    e = Experiment(t, {"u": u}, **{"name": "run", **options})
    clean = ph.simulate(model, truth, e, initial={"x": 0.4}).outputs["x"]
    return e.with_outputs({"x": clean + sigma * np.random.default_rng(seed).standard_normal(t.size)})


def lag_record(seed: int = 0, t: np.ndarray = T, **options: Any) -> Experiment:
    return record(lag(), LAG, t, np.interp(t, T, SQUARE), seed=seed, **options)


def oscillator_record(seed: int = 0) -> Experiment:
    return record(oscillator(), OSCILLATOR, T, 0.5 * np.sin(T), seed=seed)


def line(a: Any = 0.0) -> Model:
    """Linear regression y = a u + c as a model: the state c is constant, its initial value the intercept."""
    m = Model("line")
    (c,) = m.states("c")
    (u,) = m.inputs("u")
    (slope,) = m.parameters(a=a)
    m.dynamics(c=0.0)
    m.outputs(y=slope * u + c)
    return m


def line_record(seed: int = 0, name: str = "run", intercept: float = 0.5) -> Experiment:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(T.size)
    return Experiment(T, {"u": u}, {"y": 2.0 * u + intercept + 0.1 * rng.standard_normal(T.size)}, name=name)


def regression(e: Experiment) -> tuple[np.ndarray, np.ndarray, float]:
    """Least squares of (a, c): estimate, inverse of the normal matrix, sigma."""
    A = np.column_stack([e.inputs["u"], np.ones(e.n)])
    inverse = np.linalg.inv(A.T @ A)
    estimate = inverse @ A.T @ e.outputs["y"]
    return estimate, inverse, float(np.sqrt(np.mean((e.outputs["y"] - A @ estimate) ** 2)))


def values(fit: Fit) -> dict[str, float]:
    return fit.parameters.to_dict()


def close(fit: Fit, truth: dict[str, float], factor: float = 4.0) -> bool:
    """Whether every true value lies within so many standard errors."""
    off = {n: abs(fit.parameters[n].value - v) / fit.parameters[n].std_error for n, v in truth.items()}
    return fit.converged and all(o < factor for o in off.values())


def distance(one: Fit, other: Fit) -> float:
    """Largest relative difference of parameters."""
    return max(abs(e.value / other.parameters[n].value - 1) for n, e in one.parameters.items())


@pytest.fixture(scope="module")
def lag_fit() -> Fit:
    return ph.estimate(lag(), lag_record())


# ---------------------------------------------------------------- the truth is found


@pytest.mark.parametrize("seed", range(5))
def test_recovers_a_first_order_lag(seed: int) -> None:
    assert close(ph.estimate(lag(), lag_record(seed)), {**LAG, "sigma_x": 0.05})


@pytest.mark.parametrize("seed", range(5))
def test_recovers_an_oscillator_with_an_unmeasured_state(seed: int) -> None:
    assert close(ph.estimate(oscillator(), oscillator_record(seed)), {**OSCILLATOR, "sigma_x": 0.05})


def test_recovers_an_unstable_system_that_single_shooting_cannot_follow() -> None:
    m = Model("unstable")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, b = m.parameters("a b")
    m.dynamics(x=a * x + b * u)
    m.outputs(x=x)
    # Feedback within the input keeps the motion bounded, as a pilot does; without it x grows by e^30.
    t = np.linspace(0.0, 10.0, 501)
    x_true = np.sin(t) + 0.3 * np.cos(3.1 * t)
    u = np.gradient(x_true, t, edge_order=2) - 3.0 * x_true
    e = Experiment(t, {"u": u}, {"x": x_true + 0.01 * np.random.default_rng(0).standard_normal(t.size)})
    fit = ph.estimate(m, e)
    assert fit.converged
    assert values(fit)["a"] == pytest.approx(3.0, rel=0.01)
    assert values(fit)["b"] == pytest.approx(1.0, rel=0.01)


def vane() -> Model:
    """Return a model whose angle of attack and airspeed are measured by sensors that other states act on, too."""
    m = Model("vane")
    V, alpha, q = m.states("V alpha q")
    (de,) = m.inputs("de")
    a, b = m.parameters("a b")
    m.dynamics(V=-0.1 * (V - 50.0), alpha=q - 2.0 * alpha, q=a * alpha - 3.0 * q + b * de)
    m.outputs(q=q, alpha_v=alpha - 4.0 * q / V, V_p=V * 1.02 + 0.5 * q)
    return m


def test_states_start_where_outputs_have_them_that_measure_others_as_well() -> None:
    t = np.linspace(0.0, 5.0, 101)
    true = {"V": 50.0 + 5.0 * np.exp(-0.1 * t), "alpha": 0.1 * np.sin(t), "q": 0.2 * np.cos(2.0 * t)}
    outputs = {
        "q": true["q"],
        "alpha_v": true["alpha"] - 4.0 * true["q"] / true["V"],
        "V_p": true["V"] * 1.02 + 0.5 * true["q"],
    }
    model = vane()
    e = Experiment(t, {"de": np.zeros_like(t)}, outputs)
    start = state_start(model, e, t, parameter_start(model, {}), {})
    # q alone is measured by itself, V beside it, and alpha beside both.
    np.testing.assert_allclose(start[0], true["V"], rtol=1e-12)
    np.testing.assert_allclose(start[1], true["alpha"], atol=1e-12)
    np.testing.assert_allclose(start[2], true["q"], atol=1e-12)


def test_recovers_from_missing_samples() -> None:
    e = lag_record()
    gaps = e.outputs["x"].copy()
    gaps[np.random.default_rng(3).random(T.size) < 0.4] = np.nan
    fit = ph.estimate(lag(), e.with_outputs({"x": gaps}))
    assert close(fit, LAG)
    np.testing.assert_array_equal(np.isnan(fit.residuals["x"]), np.isnan(gaps))
    assert np.isfinite(fit.outputs["x"]).all()


def test_missing_samples_have_no_part_in_the_likelihood() -> None:
    e = line_record()
    gaps = e.outputs["y"].copy()
    gaps[::3] = np.nan
    kept = ~np.isnan(gaps)
    full = ph.estimate(line(), e.with_outputs({"y": gaps}))
    # The regression does not care where in time its points lie.
    cut = ph.estimate(line(), Experiment(T[kept], {"u": e.inputs["u"][kept]}, {"y": gaps[kept]}))
    assert full.log_likelihood == pytest.approx(cut.log_likelihood, rel=1e-12)
    assert values(full) == pytest.approx(values(cut), rel=1e-9)


def test_recovers_from_irregular_sample_times() -> None:
    t = np.sort(np.random.default_rng(5).uniform(0.0, 10.0, 120))
    assert close(ph.estimate(lag(), lag_record(t=t)), LAG)


# ---------------------------------------------------------------- transcription


def test_substeps_of_the_trapezoid_reduce_its_error_by_their_square() -> None:
    e = record(lag(), LAG, T, SMOOTH)
    exact = ph.estimate(lag(), e, transcription=Collocation(order=6))
    coarse, fine = (ph.estimate(lag(), e, transcription=Collocation(order=2, substeps=n)) for n in (1, 4))
    assert distance(coarse, exact) / distance(fine, exact) == pytest.approx(16.0, rel=0.05)


def test_segments_need_not_coincide_with_the_samples() -> None:
    e = record(lag(), LAG, T, SMOOTH, interpolation="cubic")
    reference = ph.estimate(lag(), e, transcription=Collocation(order=5))
    fit = ph.estimate(lag(), e, transcription=Collocation(order=8, segments=37))
    assert fit.records[0].mesh_t.size == 37 * 7 + 1
    assert distance(fit, reference) < 1e-7
    assert fit.log_likelihood == pytest.approx(reference.log_likelihood, rel=1e-7)


def test_explicit_segment_ends() -> None:
    e = record(lag(), LAG, T, SMOOTH, interpolation="cubic")
    reference = ph.estimate(lag(), e, transcription=Collocation(order=5))
    ends = [0.0, *np.sort(np.random.default_rng(1).uniform(0.05, 9.95, 99)), 10.0]
    fit = ph.estimate(lag(), e, transcription=Collocation(order=8, segments=ends))
    assert np.isin(ends, fit.records[0].mesh_t).all()
    assert distance(fit, reference) < 1e-6


def test_cubic_inputs_are_closer_to_a_smooth_truth_than_linear_ones() -> None:
    # x' = (g sin 2t - x)/tau has the solution g (sin 2t - 2 tau cos 2t)/(1 + 4 tau^2) without transient.
    t = np.linspace(0.0, 10.0, 41)
    tau, gain = LAG.values()
    x = gain * (np.sin(2 * t) - 2 * tau * np.cos(2 * t)) / (1 + 4 * tau**2)
    error = {}
    for kind in ("linear", "cubic"):
        e = Experiment(t, {"u": np.sin(2 * t)}, {"x": x}, interpolation=kind)
        fit = ph.estimate(lag(), e, noise=Gaussian({"x": 0.01}))
        error[kind] = max(abs(values(fit)[n] / v - 1) for n, v in LAG.items())
    assert error["cubic"] < 1e-3
    assert error["linear"] > 10 * error["cubic"]


@pytest.mark.parametrize("order", [3, 5, 8])
def test_high_orders_agree(order: int, lag_fit: Fit) -> None:
    fit = ph.estimate(lag(), lag_record(), transcription=Collocation(order=order))
    assert distance(fit, lag_fit) < 1e-6


def test_number_of_threads_does_not_change_the_result() -> None:
    fits = [ph.estimate(oscillator(), oscillator_record(), transcription=Collocation(threads=n)) for n in (1, 2)]
    assert values(fits[0]) == pytest.approx(values(fits[1]), rel=1e-10)
    assert fits[0].iterations == fits[1].iterations


# ---------------------------------------------------------------- statistics, against algebra


def test_linear_regression_is_exact() -> None:
    e = line_record()
    (a, c), inverse, sigma = regression(e)
    fit = ph.estimate(line(), e)
    slope, noise, intercept = fit.parameters["a"], fit.parameters["sigma_y"], fit.initial_states["run"]["c"]
    assert (slope.value, intercept.value, noise.value) == pytest.approx((a, c, sigma), rel=1e-9)
    assert slope.std_error == pytest.approx(sigma * np.sqrt(inverse[0, 0]), rel=1e-9)
    assert intercept.std_error == pytest.approx(sigma * np.sqrt(inverse[1, 1]), rel=1e-9)
    assert noise.std_error == pytest.approx(sigma / np.sqrt(2 * e.n), rel=1e-9)
    assert fit.log_likelihood == pytest.approx(-e.n * (np.log(sigma) + 0.5), rel=1e-12)
    np.testing.assert_allclose(fit.covariance, np.diag([slope.std_error**2, noise.std_error**2]), rtol=1e-9, atol=1e-12)


def test_known_sigma_sets_the_standard_errors() -> None:
    e = line_record()
    (a, _), inverse, _ = regression(e)
    fit = ph.estimate(line(), e, noise=Gaussian({"y": 0.3}))
    assert list(fit.parameters) == ["a"]
    assert fit.parameters["a"].value == pytest.approx(a, rel=1e-9)
    assert fit.parameters["a"].std_error == pytest.approx(0.3 * np.sqrt(inverse[0, 0]), rel=1e-9)


def test_noise_of_the_model_is_used_unless_another_is_given() -> None:
    m, e = line(), line_record()
    m.noise(y=0.3)
    assert list(ph.estimate(m, e).parameters) == ["a"]
    assert list(ph.estimate(m, e, noise=Gaussian({"y": Sigma(0.2)})).parameters) == ["a", "sigma_y"]


def test_prior_pulls_as_one_more_measurement() -> None:
    e, sigma, mean, std = line_record(), 0.3, 1.5, 0.02
    A = np.column_stack([e.inputs["u"], np.ones(e.n)])
    information = A.T @ A / sigma**2 + np.diag([1 / std**2, 0.0])
    a, _ = np.linalg.solve(information, A.T @ e.outputs["y"] / sigma**2 + [mean / std**2, 0.0])
    fit = ph.estimate(line(Parameter(prior=(mean, std))), e, noise=Gaussian({"y": sigma}))
    assert fit.parameters["a"].value == pytest.approx(a, rel=1e-10)
    assert fit.parameters["a"].std_error == pytest.approx(np.sqrt(np.linalg.inv(information)[0, 0]), rel=1e-9)


def test_prior_is_no_part_of_the_log_likelihood() -> None:
    e = line_record()
    fit = ph.estimate(line(Parameter(prior=(1.5, 0.02))), e, noise=Gaussian({"y": 0.3}))
    r = fit.residuals["y"]
    assert fit.log_likelihood == pytest.approx(-e.n * np.log(0.3) - 0.5 * np.sum((r / 0.3) ** 2), rel=1e-12)


def test_experiments_share_parameters_but_not_initial_states() -> None:
    both = [line_record(0, "first", 0.5), line_record(1, "second", -3.0)]
    A = np.zeros((2 * T.size, 3))
    A[:, 0] = np.concatenate([e.inputs["u"] for e in both])
    A[: T.size, 1] = A[T.size :, 2] = 1.0
    z = np.concatenate([e.outputs["y"] for e in both])
    a, first, second = np.linalg.lstsq(A, z, rcond=None)[0]
    fit = ph.estimate(line(), both)
    assert fit.parameters["a"].value == pytest.approx(a, rel=1e-10)
    assert fit.initial_states["first"]["c"].value == pytest.approx(first, rel=1e-9)
    assert fit.initial_states["second"]["c"].value == pytest.approx(second, rel=1e-9)
    assert fit.parameters["sigma_y"].value == pytest.approx(
        np.sqrt(np.mean((z - A @ [a, first, second]) ** 2)), rel=1e-9
    )
    assert [r.name for r in fit.records] == ["first", "second"]
    with pytest.raises(DataError, match=r"2 experiments \('first', 'second'\): use fit\.records\[i\]\.states"):
        _ = fit.states


def test_experiments_of_different_length_and_mesh() -> None:
    both = [lag_record(0, name="long"), lag_record(1, t=np.linspace(0.0, 3.0, 17), name="short")]
    options = Collocation(segments=[np.linspace(0.0, 10.0, 101), [0.0, 0.6, 1.0, 1.7, 2.2, 3.0]], order=6)
    fit = ph.estimate(lag(), both, transcription=options)
    assert close(fit, LAG)
    assert [r.mesh_t.size for r in fit.records] == [501, 26]


def test_standard_errors_are_the_spread_of_estimates() -> None:
    fits = [ph.estimate(lag(), lag_record(seed)) for seed in range(50)]
    for name in LAG:
        spread = np.std([f.parameters[name].value for f in fits], ddof=1)
        mean = np.mean([f.parameters[name].std_error for f in fits])
        assert 0.6 < spread / mean < 1.4  # 4 standard deviations of a spread from 50


# ---------------------------------------------------------------- bounds, fixed, identifiability


def test_fixed_parameter_stays_and_has_no_error() -> None:
    fit = ph.estimate(lag(gain=Parameter(1.9, fixed=True)), lag_record())
    gain = fit.parameters["gain"]
    assert (gain.value, gain.fixed, gain.remark) == (1.9, True, "fixed")
    assert np.isnan(gain.std_error)
    assert np.isfinite(fit.parameters["tau"].std_error)


@pytest.mark.parametrize(
    ("bounds", "side", "value"), [((-1.0, 1.5), "upper", 1.5), ((2.5, 9.0), "lower", 2.5)], ids=["upper", "lower"]
)
def test_active_bound_is_reported(bounds: tuple[float, float], side: str, value: float) -> None:
    fit = ph.estimate(line(Parameter(value, bounds=bounds)), line_record())
    a = fit.parameters["a"]
    assert (a.bounds_active, a.remark) == (side, f"at {side} bound")
    assert a.value == pytest.approx(value, rel=1e-6)
    assert bounds[0] <= a.value <= bounds[1]
    assert np.isnan(a.std_error)
    assert f"at {side} bound" in fit.summary()


def test_bound_that_does_not_bind_changes_nothing() -> None:
    e = line_record()
    free, bounded = ph.estimate(line(), e), ph.estimate(line(Parameter(0.0, bounds=(-5.0, 5.0))), e)
    assert bounded.parameters["a"].bounds_active is None
    assert values(bounded) == pytest.approx(values(free), rel=1e-7)


def test_parameters_that_cannot_be_told_apart_are_named() -> None:
    m = Model("product")
    (c,) = m.states("c")
    (u,) = m.inputs("u")
    a, b = m.parameters(a=1.0, b=1.0)
    m.dynamics(c=0.0)
    m.outputs(y=a * b * u + c)
    fit = ph.estimate(m, line_record())
    # Rounding decides on which side of singular the information matrix ends.
    (warning,) = fit.warnings
    assert warning.startswith("a, b cannot be distinguished") or "no standard error for a, b" in warning
    assert not fit.parameters["a"].std_error < 1e3


def test_sigma_of_a_perfect_fit_is_said_to_sit_at_its_bound() -> None:
    e = line_record()
    fit = ph.estimate(line(), e.with_outputs({"y": 2.0 * e.inputs["u"] + 0.5}))
    assert fit.parameters["sigma_y"].bounds_active == "lower"
    assert any("sigma_y sits at its lower bound" in w for w in fit.warnings)
    assert "Warning: sigma_y sits at its lower bound" in fit.summary()
    assert values(fit)["a"] == pytest.approx(2.0, rel=1e-9)


# ---------------------------------------------------------------- starts


def test_start_values_are_used() -> None:
    e = lag_record()
    seen: list[Iteration] = []
    near = {**LAG, "sigma_x": 0.05, "x": e.outputs["x"]}
    ph.estimate(lag(), e, start=near, progress=seen.append)
    far: list[Iteration] = []
    ph.estimate(lag(), e, progress=far.append)
    assert seen[0].log_likelihood > far[0].log_likelihood + 50


def test_start_from_useless_values() -> None:
    e = lag_record()
    fit = ph.estimate(lag(), e, start={"tau": 10.0, "gain": -50.0, "sigma_x": 1e3, "x": 7.0})
    assert values(fit) == pytest.approx(values(ph.estimate(lag(), e)), rel=1e-6)


def test_warm_start_goes_on_from_a_fit() -> None:
    e = oscillator_record()
    cold = ph.estimate(oscillator(), e)
    warm = ph.estimate(oscillator(), e, start=cold)
    assert cold.iterations > 5
    assert warm.converged and warm.iterations <= 3
    assert values(warm) == pytest.approx(values(cold), rel=1e-9)


def test_warm_start_on_another_mesh() -> None:
    e = oscillator_record()
    coarse = ph.estimate(oscillator(), e, transcription=Collocation(order=2))
    fine = ph.estimate(oscillator(), e, start=coarse)
    assert fine.converged
    assert values(fine) == pytest.approx(values(ph.estimate(oscillator(), e)), rel=1e-7)


def test_warm_start_from_a_loaded_fit(tmp_path: Path) -> None:
    e = oscillator_record()
    cold = ph.estimate(oscillator(), e)
    cold.save(tmp_path / "fit.json")
    warm = ph.estimate(oscillator(), e, start=ph.load(tmp_path / "fit.json"))
    assert warm.converged and warm.iterations < cold.iterations
    assert values(warm) == pytest.approx(values(cold), rel=1e-9)


# ---------------------------------------------------------------- solver


def test_exact_hessian_from_the_start_finds_the_same(lag_fit: Fit) -> None:
    fit = ph.estimate(lag(), lag_record(), solver=Ipopt(gauss_newton=False))
    assert values(fit) == pytest.approx(values(lag_fit), rel=1e-8)


def test_scaling_by_ipopt_finds_the_same(lag_fit: Fit) -> None:
    fit = ph.estimate(lag(), lag_record(), solver=Ipopt(scaling=False))
    assert values(fit) == pytest.approx(values(lag_fit), rel=1e-6)


def test_every_option_of_ipopt_is_reachable(capfd: pytest.CaptureFixture[str]) -> None:
    ph.estimate(lag(), lag_record(), solver=Ipopt(options={"print_level": 5}))
    assert "EXIT: Optimal Solution Found" in capfd.readouterr().out


def test_ipopt_is_quiet_unless_asked(capfd: pytest.CaptureFixture[str]) -> None:
    ph.estimate(lag(), lag_record())
    assert capfd.readouterr() == ("", "")


def test_iteration_limit_is_a_status() -> None:
    fit = ph.estimate(oscillator(), oscillator_record(), solver=Ipopt(max_iterations=3))
    assert (fit.status, fit.iterations, fit.converged) == ("iteration limit", 3, False)
    assert "allow more iterations, or go on with start=fit" in fit.message


def test_time_limit_is_a_status() -> None:
    def slow(_: Iteration) -> None:
        time.sleep(0.05)

    fit = ph.estimate(oscillator(), oscillator_record(), solver=Ipopt(time_limit=0.06), progress=slow)
    assert fit.status == "time limit"
    assert fit.iterations < 5
    assert "allow more time" in fit.message


def test_fit_that_did_not_converge_can_be_gone_on_with() -> None:
    e = oscillator_record()
    first = ph.estimate(oscillator(), e, solver=Ipopt(max_iterations=4))
    second = ph.estimate(oscillator(), e, start=first)
    assert values(second) == pytest.approx(values(ph.estimate(oscillator(), e)), rel=1e-8)


# ---------------------------------------------------------------- progress and interruption


def test_progress_function_sees_every_iteration() -> None:
    seen: list[Iteration] = []
    fit = ph.estimate(lag(), lag_record(), progress=seen.append)
    assert [i.number for i in seen] == list(range(fit.iterations + 1))
    assert seen[-1].log_likelihood == pytest.approx(fit.log_likelihood, rel=1e-9)
    assert list(fit.history) == seen


def test_progress_true_prints(capfd: pytest.CaptureFixture[str]) -> None:
    ph.estimate(lag(), lag_record(), progress=True)
    assert "lag: iteration   0  logL" in capfd.readouterr().err


def test_error_of_the_progress_function_comes_out() -> None:
    def fail(i: Iteration) -> None:
        if i.number == 2:
            raise RuntimeError("from the callback")

    with pytest.raises(RuntimeError, match="from the callback"):
        ph.estimate(lag(), lag_record(), progress=fail)


def interrupted_at(act: Callable[[], None]) -> Fit:
    """The fit of a run in which something happens at iteration 4."""

    def watch(i: Iteration) -> None:
        if i.number == 4:
            act()

    return ph.estimate(oscillator(), oscillator_record(), progress=watch)


def raise_keyboard_interrupt() -> None:
    raise KeyboardInterrupt


def press_ctrl_c() -> None:
    """SIGINT from another thread, while this one works."""
    sent = threading.Event()

    def send() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        sent.set()

    threading.Timer(0.02, send).start()
    while not sent.is_set():
        time.sleep(0.005)


@pytest.mark.parametrize("act", [raise_keyboard_interrupt, press_ctrl_c])
def test_interruption_returns_the_point_reached(act: Callable[[], None]) -> None:
    fit = interrupted_at(act)
    assert fit.status == "interrupted"
    assert 4 <= fit.iterations <= 5
    assert "stopped by the user" in fit.message
    assert fit.log_likelihood == pytest.approx(fit.history[-1].log_likelihood, rel=1e-9)
    assert fit.log_likelihood > fit.history[0].log_likelihood
    again = ph.estimate(oscillator(), oscillator_record(), start=fit)
    assert close(again, OSCILLATOR)


def test_ctrl_c_is_as_ever_after_an_estimation() -> None:
    before = signal.getsignal(signal.SIGINT)
    interrupted_at(press_ctrl_c)
    assert signal.getsignal(signal.SIGINT) is before


def test_estimates_in_threads_do_not_disturb_each_other() -> None:
    with ThreadPoolExecutor(2) as pool:
        fits = list(pool.map(lambda seed: ph.estimate(lag(), lag_record(seed)), range(4)))
    for seed, fit in enumerate(fits):
        assert values(fit) == values(ph.estimate(lag(), lag_record(seed)))


# ---------------------------------------------------------------- what a fit holds


def test_attributes_of_a_fit(lag_fit: Fit) -> None:
    e = lag_record()
    assert (lag_fit.status, lag_fit.model.name) == ("converged", "lag")
    assert lag_fit.iterations == lag_fit.history[-1].number
    assert 0 < lag_fit.time < 60
    assert list(lag_fit.parameters) == ["tau", "gain", "sigma_x"]
    assert all(type(p.value) is float for p in lag_fit.parameters.values())
    assert (lag_fit.parameters["tau"].unit, lag_fit.parameters["sigma_x"].unit) == ("s", "m")
    assert lag_fit.parameters["tau"].start == 0.5
    assert lag_fit.parameters["tau"].bounds == (0.01, 10.0)
    assert lag_fit.covariance.shape == (3, 3)
    np.testing.assert_allclose(np.sqrt(np.diag(lag_fit.covariance)), lag_fit.parameters.std_errors_array)
    assert lag_fit.states["x"].shape == lag_fit.outputs["x"].shape == (e.n,)
    np.testing.assert_array_equal(lag_fit.residuals["x"], e.outputs["x"] - lag_fit.outputs["x"])
    assert lag_fit.initial_states["run"]["x"].value == lag_fit.states["x"][0]
    (r,) = lag_fit.records
    np.testing.assert_array_equal(r.t, e.t)
    np.testing.assert_array_equal(r.inputs["u"], e.inputs["u"])
    np.testing.assert_array_equal(r.measured["x"], e.outputs["x"])
    assert r.mesh_t.size == r.mesh_states["x"].size == 3 * (e.n - 1) + 1
    assert np.isin(e.t, r.mesh_t).all()


def test_sigma_is_the_root_mean_square_of_the_residuals(lag_fit: Fit) -> None:
    assert lag_fit.parameters["sigma_x"].value == pytest.approx(lag_fit.records[0].rms()["x"], rel=1e-9)


def test_unknown_parameter_is_a_key_error_with_a_hint(lag_fit: Fit) -> None:
    with pytest.raises(KeyError, match="there is no parameter 'Tau'. Did you mean 'tau'?"):
        lag_fit.parameters["Tau"]


def test_summary_names_everything(lag_fit: Fit) -> None:
    text = lag_fit.summary()
    for part in ("lag", "converged", "tau", "gain", "sigma_x", "collocation of order 4", "101 samples"):
        assert part in text
    assert str(lag_fit) == text


def test_repr_is_short(lag_fit: Fit) -> None:
    assert repr(lag_fit).startswith("<Fit of 'lag': converged, log-likelihood ")


def test_plot_shows_outputs_residuals_and_inputs(lag_fit: Fit) -> None:
    figure, axes = lag_fit.plot()
    assert list(axes) == ["x", "x residual", "u"]
    assert set(axes.values()) == set(figure.axes)
    plt.close(figure)


# ---------------------------------------------------------------- saving


def test_saved_fit_is_read_back_exactly(tmp_path: Path) -> None:
    e = lag_record()
    gaps = e.outputs["x"].copy()
    gaps[7] = np.nan
    m = lag(gain=Parameter(2.0, fixed=True))
    m.noise(x=Sigma(0.1, bounds=(1e-3, 1.0)))
    fit = ph.estimate(m, e.with_outputs({"x": gaps}), transcription=Collocation(segments=[0.0, *T[5:-1:7], 10.0]))
    fit.save(tmp_path / "fit.json")
    again = ph.load(tmp_path / "fit.json")
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "fit.json").read_bytes()
    assert values(again) == values(fit)
    assert repr(again.parameters) == repr(fit.parameters)
    assert again.summary() == fit.summary()
    assert (again.noise, again.transcription) == (fit.noise, fit.transcription)
    assert again.model.to_json() == fit.model.to_json()
    assert (again.log_likelihood, again.time, again.message) == (fit.log_likelihood, fit.time, fit.message)
    assert list(again.history) == list(fit.history)
    np.testing.assert_array_equal(again.covariance, fit.covariance)
    for one, other in zip(again.records, fit.records, strict=True):
        for group in ("inputs", "outputs", "states", "measured", "residuals", "mesh_states"):
            np.testing.assert_equal(getattr(one, group), dict(getattr(other, group)))
        np.testing.assert_array_equal(one.mesh_t, other.mesh_t)


def test_loaded_fit_can_be_plotted_and_simulated(tmp_path: Path, lag_fit: Fit) -> None:
    lag_fit.save(tmp_path / "fit.json")
    again = ph.load(tmp_path / "fit.json")
    plt.close(again.plot()[0])
    np.testing.assert_array_equal(
        ph.simulate(again.model, again, lag_record()).outputs["x"],
        ph.simulate(lag_fit.model, lag_fit, lag_record()).outputs["x"],
    )


def test_fit_survives_pickling(lag_fit: Fit) -> None:
    again = pickle.loads(pickle.dumps(lag_fit))
    assert values(again) == values(lag_fit)
    assert again.summary() == lag_fit.summary()


def damaged(change: Callable[[dict[str, Any]], Any]) -> Callable[[str], str]:
    def spoil(text: str) -> str:
        document = json.loads(text)
        change(document)
        return json.dumps(document)

    return spoil


@pytest.mark.parametrize(
    "spoil",
    [
        lambda text: text[: len(text) // 2],
        lambda text: "",
        lambda text: "[]",
        damaged(lambda d: d.pop("parameters")),
        damaged(lambda d: d["parameters"][0].pop("value")),
        damaged(lambda d: d["parameters"][0].update(value="high")),
        damaged(lambda d: d.update(model="{}")),
        damaged(lambda d: d.update(model=None)),
        damaged(lambda d: d.update(records=None)),
        damaged(lambda d: d["records"][0].pop("t")),
        damaged(lambda d: d["transcription"].update(order=1)),
        damaged(lambda d: d.update(noise=[])),
        damaged(lambda d: d.update(history=[{}])),
        damaged(lambda d: d.update(format="other")),
        damaged(lambda d: d.update(version=99)),
    ],
)
def test_damaged_file_is_refused(spoil: Callable[[str], str], tmp_path: Path, lag_fit: Fit) -> None:
    path = tmp_path / "fit.json"
    lag_fit.save(path)
    path.write_text(spoil(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(DataError, match=r"fit\.json"):
        ph.load(path)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="there is no such file"):
        ph.load(tmp_path / "nothing.json")


def test_output_constant_in_one_experiment_is_fine_where_it_moves_in_another() -> None:
    m = Model("two outputs")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    (a,) = m.parameters("a")
    m.dynamics(x=a * u - x)
    m.outputs(x=x, y=2 * x)
    t = np.linspace(0, 5, 60)
    noise = np.random.default_rng(0).standard_normal((3, t.size))
    path = 3 * (1 - np.exp(-t))
    moving = {"x": path + 0.01 * noise[0], "y": 2 * path + 0.02 * noise[1]}
    still = Experiment(t, {"u": 0 * t}, {"x": 0.01 * noise[2], "y": 0 * t}, name="still")
    fit = estimate(m, [still, Experiment(t, {"u": 0 * t + 1}, moving, name="moving")])
    assert fit.parameters["a"].value == pytest.approx(3, abs=4 * fit.parameters["a"].std_error)
    with pytest.raises(DataError, match="'y'"):
        estimate(m, still)
