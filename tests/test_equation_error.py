"""equation_error: against truth without noise, algebra, a Monte Carlo of coloured residuals, and real records."""

from __future__ import annotations

from typing import Any

import hfb320
import numpy as np
import pytest
import unstable_aircraft
from matplotlib import pyplot as plt
from records import find

import phugoid as ph
from phugoid import Experiment, FourierSmoothing, Model, Parameter, SavitzkyGolay, SmoothingSpline, equation_error

T = np.linspace(0.0, 20.0, 401)
U = np.sin(1.3 * T) + 0.5 * np.sin(2.9 * T)
TRUTH = {"Zw": -1.4, "Mw": -1.9, "Mq": -2.2, "Md": -6.0}


def short_period(**parameters: Any) -> Model:
    """w' = Zw w + q, q' = Mw w + Mq q + Md d; both measured, and az = Zw w."""
    m = Model("short period")
    w, q = m.states(w="m/s", q="rad/s")
    (d,) = m.inputs(d="rad")
    Zw, Mw, Mq, Md = m.parameters(**{**dict.fromkeys(TRUTH, 0.0), **parameters})
    m.dynamics(w=Zw * w + q, q=Mw * w + Mq * q + Md * d)
    m.outputs(w=w, q=q, az=(Zw * w, "m/s²"))
    return m


def record(sigma: float = 0.0, seed: int = 0, u: np.ndarray = U, name: str = "run", t: np.ndarray = T) -> Experiment:
    e = Experiment(t, {"d": u}, name=name, interpolation="cubic")
    clean = ph.simulate(short_period(), TRUTH, e, initial={"w": 0.3, "q": 0.0}).outputs
    rng = np.random.default_rng(seed)
    return e.with_outputs({n: y + sigma * y.std() * rng.standard_normal(t.size) for n, y in clean.items()})


def values(result: ph.results.EquationError) -> dict[str, float]:
    return result.parameters.to_dict()


@pytest.mark.parametrize("way", [SmoothingSpline(), FourierSmoothing(), SavitzkyGolay(5, 4)])
def test_without_noise_the_truth_comes_back(way: Any) -> None:
    # What is left is the error of numerical differentiation, largest at the ends of the record.
    assert values(equation_error(short_period(), record(), differentiation=way)) == pytest.approx(TRUTH, rel=5e-3)


@pytest.mark.parametrize("way", [SmoothingSpline(), FourierSmoothing(), SavitzkyGolay()])
def test_noise_of_a_percent_is_smoothed_away(way: Any) -> None:
    assert values(equation_error(short_period(), record(0.01), differentiation=way)) == pytest.approx(TRUTH, rel=0.06)


def test_smoothing_beats_differences() -> None:
    t, rng = T, np.random.default_rng(0)
    z, slope = np.sin(1.3 * t), 1.3 * np.cos(1.3 * t)
    z = z + 0.01 * rng.standard_normal(t.size)
    raw = np.std(np.gradient(z, t) - slope)
    for way, gain in ((SmoothingSpline(), 5), (FourierSmoothing(), 5), (SavitzkyGolay(15, 3), 2)):
        assert np.std(way.smooth(t, z)[1] - slope) < raw / gain


def test_equations_that_share_no_parameter_are_solved_apart() -> None:
    assert equation_error(short_period(), record()).groups == [("w'", "az"), ("q'",)]


def test_a_linear_group_is_weighted_least_squares() -> None:
    """q' by hand: the same regressors, numpy's least squares."""
    data = record(0.02)
    result = equation_error(short_period(), data)
    smooth = {n: SmoothingSpline().smooth(data.t, data.outputs[n]) for n in ("w", "q")}
    A = np.column_stack([smooth["w"][0], smooth["q"][0], U])
    found, squares, *_ = np.linalg.lstsq(A, smooth["q"][1], rcond=None)
    assert [values(result)[n] for n in ("Mw", "Mq", "Md")] == pytest.approx(found.tolist(), rel=1e-9)
    variance = float(squares[0]) / (T.size - 3) * np.linalg.inv(A.T @ A)
    assert [result.white_std_errors[n] for n in ("Mw", "Mq", "Md")] == pytest.approx(
        np.sqrt(np.diag(variance)), rel=1e-9
    )
    left = smooth["q"][1]
    assert result.r_squared["q'"] == pytest.approx(1 - float(squares[0]) / np.sum((left - left.mean()) ** 2), rel=1e-9)


def test_joint_weights_are_those_of_maximum_likelihood() -> None:
    """Zw of w' and az together: at the estimate, the score with the reported sigmas is zero."""
    result = equation_error(short_period(), record(0.05))
    r, w = result.residuals, result.records[0].states["w"]
    score = sum(np.sum(r[n] * w) / np.mean(r[n] ** 2) for n in ("w'", "az"))
    scale = sum(np.sum(np.abs(r[n] * w)) / np.mean(r[n] ** 2) for n in ("w'", "az"))
    assert abs(score) < 1e-6 * scale


def nonlinear(**tau: Any) -> tuple[Model, Experiment]:
    m = Model("lag")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    time, gain = m.parameters(tau=Parameter(0.5, bounds=(0.01, 10.0), **tau), gain=1.0)
    m.dynamics(x=(gain * u - x) / time)
    m.outputs(x=x)
    e = Experiment(T, {"u": U}, name="lag", interpolation="cubic")
    return m, e.with_outputs({"x": ph.simulate(m, {"tau": 0.8, "gain": 2.0}, e, initial={"x": 0.4}).outputs["x"]})


def test_parameters_that_enter_nonlinearly_are_found_by_gauss_newton() -> None:
    assert values(equation_error(*nonlinear())) == pytest.approx({"tau": 0.8, "gain": 2.0}, rel=5e-3)


def test_a_bias_of_a_measured_state_is_told_by_kinematics() -> None:
    m = Model("kinematics")
    theta, q = m.states("theta q")
    (u,) = m.inputs("u")
    a, b = m.parameters("a bias")
    m.dynamics(theta=q, q=a * q + u)
    m.outputs(theta=theta, q=q + b)
    e = Experiment(T, {"u": U}, interpolation="cubic")
    clean = ph.simulate(m, {"a": -0.7, "bias": 0.0}, e, initial={"theta": 0.0, "q": 0.0}).outputs
    found = equation_error(m, e.with_outputs({"theta": clean["theta"], "q": clean["q"] + 0.05}))
    assert values(found) == pytest.approx({"a": -0.7, "bias": 0.05}, rel=1e-2)
    np.testing.assert_allclose(found.records[0].states["q"], clean["q"], atol=2e-3)


def test_a_measured_slope_replaces_the_differentiated_one() -> None:
    m = Model("measured slope")
    x, y = m.states("x y")
    (u,) = m.inputs("u")
    a, b, c = m.parameters("a b c")
    m.dynamics(y=b * y + u, x=a * x + u)
    m.outputs(x=x, y=y, xdot=u + a * x, ydot=b * y + u + c)
    e = Experiment(T, {"u": U}, interpolation="cubic")
    data = e.with_outputs(ph.simulate(m, {"a": -1.0, "b": -2.0, "c": 0.1}, e, initial={"x": 0, "y": 0}).outputs)
    result = equation_error(m, data)
    # y' stays beside ydot: without it nothing would tell a bias of ydot from a constant of the equation.
    assert set(result.r_squared) == {"y'", "xdot", "ydot"}
    assert values(result) == pytest.approx({"a": -1.0, "b": -2.0, "c": 0.1}, rel=2e-2)


def test_standard_errors_hold_for_coloured_residuals() -> None:
    """Scatter of 150 estimates under AR(1) noise of a = 0.9, against the mean of the standard errors."""
    m = Model("static")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    gain, offset = m.parameters("gain offset")
    m.dynamics(x=u - x)
    m.outputs(x=x, y=gain * u + offset)
    rng = np.random.default_rng(3)
    found, errors, white = [], [], []
    for _ in range(150):
        e = rng.standard_normal(T.size + 100)
        for k in range(1, e.size):
            e[k] += 0.9 * e[k - 1]
        data = Experiment(T, {"u": U}, {"x": np.cos(T), "y": 2.0 * U + 0.3 * e[100:]})
        result = equation_error(m, data, differentiation=FourierSmoothing())
        found.append(result.parameters["gain"].value)
        errors.append(result.parameters["gain"].std_error)
        white.append(result.white_std_errors["gain"])
    assert np.mean(errors) == pytest.approx(np.std(found), rel=0.2)
    assert np.mean(white) < 0.6 * np.std(found)


def test_on_white_residuals_both_standard_errors_agree() -> None:
    rng = np.random.default_rng(0)
    m = Model("static")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    (gain,) = m.parameters("gain")
    m.dynamics(x=u - x)
    m.outputs(x=x, y=gain * u)
    t = np.arange(4000) * 0.1
    u = rng.standard_normal(t.size)
    data = Experiment(t, {"u": u}, {"x": np.cos(t), "y": 2.0 * u + rng.standard_normal(t.size)})
    result = equation_error(m, data, differentiation=FourierSmoothing())
    assert result.parameters["gain"].std_error == pytest.approx(result.white_std_errors["gain"], rel=0.1)
    assert result.white_std_errors["gain"] == pytest.approx(1 / np.sqrt(t.size), rel=0.1)


def test_missing_samples_cost_rows_only() -> None:
    full = record(0.005)
    rng = np.random.default_rng(1)
    outputs = {n: np.where(rng.uniform(size=T.size) < 0.2, np.nan, y) for n, y in full.outputs.items()}
    gaps = full.with_outputs(outputs)
    result = equation_error(short_period(), gaps)
    assert values(result) == pytest.approx(TRUTH, rel=0.06)
    counts = np.isfinite(result.residuals["az"]).sum()
    assert 0.7 * T.size < counts <= np.isfinite(outputs["az"]).sum()
    assert all(np.isfinite(e.std_error) for e in result.parameters.values())


def test_uneven_times_need_the_spline() -> None:
    t = np.sort(np.concatenate([T[::2], T[1::4] + 0.013]))
    data = record(u=np.sin(1.3 * t) + 0.5 * np.sin(2.9 * t), t=t)
    assert values(equation_error(short_period(), data)) == pytest.approx(TRUTH, rel=1e-2)
    for way in (FourierSmoothing(), SavitzkyGolay()):
        with pytest.raises(ph.DataError, match=r"experiment 'run', output 'w'.*evenly spaced.*SmoothingSpline"):
            equation_error(short_period(), data, differentiation=way)


def test_two_experiments_together_are_better_than_each() -> None:
    one, two = record(0.05, 1, name="one"), record(0.05, 2, u=np.cos(0.7 * T) + 0.5 * np.sin(2.1 * T), name="two")
    errors = [
        equation_error(short_period(), data, differentiation=FourierSmoothing()).parameters["Md"].std_error
        for data in (one, two, [one, two])
    ]
    assert errors[2] < min(errors[:2])
    both = equation_error(short_period(), [one, two])
    assert [r.name for r in both.records] == ["one", "two"]
    with pytest.raises(ph.DataError, match="2 experiments"):
        _ = both.residuals


def test_parameters_of_each_experiment() -> None:
    m = Model("biases")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, bias = m.parameters(a=0.0, bias=Parameter(per_experiment=True))
    m.dynamics(x=a * x + u + bias)
    m.outputs(x=x)
    runs = []
    for name, value in (("one", 0.3), ("two", -0.2)):
        e = Experiment(T, {"u": U}, name=name, interpolation="cubic")
        clean = ph.simulate(m, {"a": -0.9, "bias": value}, e, initial={"x": 0.0}).outputs
        runs.append(e.with_outputs({"x": clean["x"]}))
    result = equation_error(m, runs)
    assert values(result) == pytest.approx({"a": -0.9, "bias[one]": 0.3, "bias[two]": -0.2}, rel=1e-2)
    assert all(np.isfinite(e.std_error) for e in result.parameters.values())
    alone = equation_error(m, runs[1])
    assert values(alone)["bias[two]"] == pytest.approx(-0.2, rel=1e-2)
    assert ph.estimate(m, runs, start=result).converged


def test_positive_parameters_stay_positive() -> None:
    m = Model("decay")
    (x,) = m.states("x")
    (rate,) = m.parameters(rate=Parameter(1.0, transform="log"))
    m.dynamics(x=-rate * x)
    m.outputs(x=x)
    growing = Experiment(T, {}, {"x": np.exp(0.1 * T)})
    assert 0 < equation_error(m, growing).parameters["rate"].value < 1e-9


def test_fixed_bounded_and_prior_parameters() -> None:
    data = record(0.01)
    fixed = equation_error(short_period(Mw=Parameter(-1.5, fixed=True)), data)
    assert values(fixed)["Mw"] == -1.5 and np.isnan(fixed.parameters["Mw"].std_error)
    bounded = equation_error(short_period(Mq=Parameter(-1.0, bounds=(-1.5, 0.0))), data).parameters
    assert (bounded["Mq"].value, bounded["Mq"].bounds_active) == (-1.5, "lower")
    assert np.isfinite(bounded["Md"].std_error)
    free = equation_error(short_period(), data).parameters["Mq"]
    for std, nearer in ((1e-6, -1.0), (1e6, free.value)):
        found = equation_error(short_period(Mq=Parameter(0.0, prior=(-1.0, std))), data).parameters["Mq"]
        assert found.value == pytest.approx(nearer, rel=1e-4)


def test_collinear_regressors_are_named() -> None:
    m = Model("collinear")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, b, c, d = m.parameters("a b c d")
    m.dynamics(x=a * x + b * u + c * u + d * 0.0)
    m.outputs(x=x)
    e = Experiment(T, {"u": U}, interpolation="cubic")
    data = e.with_outputs(ph.simulate(m, {"a": -1, "b": 2, "c": 0, "d": 0}, e, initial={"x": 0}).outputs)
    result = equation_error(m, data, start={"b": 0.5})
    assert (("b", "c"), np.inf) in result.collinear
    assert any("b, c cannot be distinguished" in w for w in result.warnings)
    # The determined sum is right, the undetermined difference stays where it started.
    assert values(result)["b"] + values(result)["c"] == pytest.approx(2.0, rel=1e-2)
    assert values(result)["b"] - values(result)["c"] == pytest.approx(0.5, abs=1e-9)
    assert np.isnan(result.parameters["b"].std_error) and np.isfinite(result.parameters["a"].std_error)


def test_nearly_collinear_regressors_are_named_with_their_index() -> None:
    near = U + 1e-3 * np.cos(7 * T)
    m = Model("nearly collinear")
    (x,) = m.states("x")
    u, v = m.inputs("u v")
    a, b, c = m.parameters("a b c")
    m.dynamics(x=a * x + b * u + c * v)
    m.outputs(x=x)
    e = Experiment(T, {"u": U, "v": near}, interpolation="cubic")
    data = e.with_outputs(ph.simulate(m, {"a": -1, "b": 2, "c": 1}, e, initial={"x": 0}).outputs)
    ((names, index),) = equation_error(m, data).collinear
    assert names == ("b", "c") and 100 < index < 1e5


def test_an_unmeasured_state_is_named() -> None:
    m = Model("half")
    x, v = m.states("x v")
    (k,) = m.parameters("k")
    m.dynamics(x=v, v=-k * x)
    m.outputs(x=x)
    data = Experiment(T, {}, {"x": np.cos(T)})
    with pytest.raises(ph.ModelError, match="the state v is not measured by an output of its own"):
        equation_error(m, data)


def test_an_equation_that_is_not_finite_is_named() -> None:
    m = Model("root")
    (x,) = m.states("x")
    (k,) = m.parameters("k")
    m.dynamics(x=k * ph.sqrt(x))
    m.outputs(x=x)
    with pytest.raises(ph.EvaluationError, match=r"the equation of x' is not finite at t = "):
        equation_error(m, Experiment(T, {}, {"x": np.cos(T)}))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"differentiation": "spline"}, "SmoothingSpline"),
        ({"start": 3}, "values by name"),
        ({"start": {"Mx": 1.0}}, "Did you mean 'Mw'|Did you mean 'Mq'|'Mx' is not a parameter"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises((ph.OptionError, ph.ModelError), match=message):
        equation_error(short_period(), record(), **options)


def test_wrong_differentiators_are_refused() -> None:
    for make in (
        lambda: SmoothingSpline(-1.0),
        lambda: FourierSmoothing(0.0),
        lambda: SavitzkyGolay(8),
        lambda: SavitzkyGolay(3, 5),
        lambda: SavitzkyGolay(2.5),  # type: ignore[arg-type]
    ):
        with pytest.raises(ph.OptionError):
            make()


def test_it_starts_an_estimation() -> None:
    data = record(0.02)
    result = equation_error(short_period(), data)
    # Without regression of its own, the solver's first value is that of the start.
    plain = ph.estimate(short_period(), data, solver=ph.Newton(regression=False))
    fit = ph.estimate(short_period(), data, start=result, solver=ph.Newton(regression=False))
    assert fit.converged and fit.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-9)
    assert fit.iterations < plain.iterations


def test_summary_and_plot() -> None:
    result = equation_error(short_period(), record(0.02))
    text = result.summary()
    assert all(word in text for word in ("q'", "az", "R²", "lag-1 corr.", "std error, if white", "Md", "rad/s²"))
    figure, axes = result.plot()
    assert set(axes) >= {"w'", "w' residual", "q'", "az", "d"}
    plt.close(figure)


def test_t_statistics_are_ratios() -> None:
    result = equation_error(short_period(), record(0.02))
    for name, t in result.t_statistics.items():
        assert t == result.parameters[name].value / result.parameters[name].std_error


@pytest.mark.skipif(find(hfb320.RECORD) is None, reason=f"the record {hfb320.RECORD} is not there")
def test_hfb320_is_near_the_output_error_estimate() -> None:
    """Real data: noise in alpha and q, and what the model lacks, keep the two apart; the start is good all the same."""
    path = find(hfb320.RECORD)
    assert path is not None
    data = hfb320.experiment(path)
    result = equation_error(hfb320.model(), data)
    fit = ph.estimate(hfb320.model(), data, start=result)
    assert fit.converged and fit.iterations <= 8
    for name in ("CD0", "Cm0", "Cma", "Cmde"):
        assert values(result)[name] == pytest.approx(fit.parameters[name].value, rel=0.12)
    assert any({"CL0", "CLa"} <= set(names) for names, _ in result.collinear)


@pytest.mark.skipif(find(unstable_aircraft.RECORD) is None, reason=f"{unstable_aircraft.RECORD} is not there")
def test_unstable_aircraft_is_near_the_truth() -> None:
    path = find(unstable_aircraft.RECORD)
    assert path is not None
    result = equation_error(unstable_aircraft.model(), unstable_aircraft.experiment(path))
    assert values(result) == pytest.approx(unstable_aircraft.PUBLISHED, rel=0.05)
