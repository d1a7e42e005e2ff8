"""Modes of a fit: eigenvalues of the exact Jacobian, with standard errors that do not mind redundant parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, lfilter, lsim

import phugoid as ph
from phugoid.linear.state_space import table_of

POLES = (-0.4 + 5.0j, -0.8 + 12.0j)
TRUTH = ph.linear.StateSpace(
    [[-0.4, 5.0, 0, 0], [-5.0, -0.4, 0, 0], [0, 0, -0.8, 12.0], [0, 0, -12.0, -0.8]],
    [[1.0], [0.5], [-0.5], [1.0]],
    [[1.0, 0.2, -0.5, 1.0]],
)


def run(seed: int = 0, n: int = 500) -> ph.Experiment:
    random = np.random.default_rng(seed)
    t = 0.05 * np.arange(n)
    u = lfilter(*butter(2, 0.6), np.random.default_rng(99).normal(size=n))
    _, y, _ = lsim((TRUTH.A, TRUTH.B, TRUTH.C, TRUTH.D), u, t)
    return ph.Experiment(t, {"u": u}, {"y": y + 0.02 * random.normal(size=n)})


def errors(modes: ph.results.Modes) -> np.ndarray:
    return np.array([[m.frequency.std_error, m.damping.std_error, m.time_constant.std_error] for m in modes])


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(ph.models.modal(start=TRUTH, feedthrough=False), run())


def test_standard_errors_are_those_of_the_delta_method_by_differences(fit: ph.Fit) -> None:
    """In the observer form, where every mode depends on all coefficients."""
    fit = ph.estimate(ph.models.state_space(start=TRUTH, feedthrough=False), run())
    names = [n for n in fit.parameters if n not in fit.noise_parameters]
    values = {n: fit.parameters[n].value for n in names}

    def table(change: dict[str, float]) -> np.ndarray:
        found = ph.linear.modes(fit.model, {**values, **change})
        return np.array([[m.frequency.value, m.damping.value, m.time_constant.value] for m in found]).ravel()

    steps = {n: 1e-5 * max(1.0, abs(v)) for n, v in values.items()}
    J = np.array([(table({n: values[n] + h}) - table({n: values[n] - h})) / (2 * h) for n, h in steps.items()]).T
    k = len(names)
    expected = np.sqrt(np.diag(J @ fit.covariance[:k, :k] @ J.T))
    np.testing.assert_allclose(errors(ph.linear.modes(fit)).ravel(), expected, rtol=1e-5)


@pytest.mark.parametrize("kind", ["free", "full", "observer", "companion"])
def test_redundant_parameters_make_no_difference(fit: ph.Fit, kind: Any) -> None:
    if kind == "free":
        model = ph.models.modal(start=TRUTH, feedthrough=False, scale="free")
    else:
        model = ph.models.state_space(start=TRUTH, feedthrough=False, structure=kind)
    other = ph.estimate(model, run())
    assert other.converged == (kind in ("observer", "companion"))
    found, expected = ph.linear.modes(other), ph.linear.modes(fit)
    np.testing.assert_allclose(found.eigenvalues, expected.eigenvalues, rtol=1e-5)
    np.testing.assert_allclose(errors(found), errors(expected), rtol=2e-3)


def test_estimates_scatter_as_much_as_they_say(fit: ph.Fit) -> None:
    said = errors(ph.linear.modes(fit))[:, :2]
    model = ph.models.modal(start=TRUTH, feedthrough=False)
    found = []
    for seed in range(30):
        modes = ph.linear.modes(ph.estimate(model, run(seed, 250)))
        found.append(np.column_stack([modes.frequencies_hz, modes.damping_ratios]))
    said = errors(ph.linear.modes(ph.estimate(model, run(0, 250))))[:, :2]
    np.testing.assert_allclose(np.std(found, axis=0, ddof=1) / said, 1.0, atol=0.4)


def test_a_mode_that_the_data_leave_open_has_no_error() -> None:
    """Two unseen states beside a seen one: their frequency is open, the lag's time constant is not."""
    m = ph.Model("half unseen")
    x, v, y = m.states("x v y")
    (u,) = m.inputs("u")
    k, a = m.parameters(k=4.0, a=1.0)
    m.dynamics(x=v, v=-k * x, y=u - a * y)
    m.outputs(y=y)
    m.initial(x=1.0, v=0.0)
    t = 0.05 * np.arange(200)
    u_ = np.sin(t) + np.sin(3 * t)
    _, z, _ = lsim(([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), u_, t)
    noise = 0.01 * np.random.default_rng(0).normal(size=t.size)
    fit = ph.estimate(m, ph.Experiment(t, {"u": u_}, {"y": z + noise}))
    lag, unseen = ph.linear.modes(fit)
    assert lag.time_constant.value == pytest.approx(1.0, abs=0.05) and lag.time_constant.std_error > 0
    assert unseen.oscillates and np.isnan(unseen.frequency.std_error)


def pendulum() -> ph.Model:
    m = ph.Model("pendulum")
    th, om = m.states("th om")
    w2, d, T = m.parameters(w2=4.0, d=0.1, T=2.0)
    m.dynamics(th=om, om=-w2 * ph.sin(th) - d * om)
    m.outputs(th=T * th)
    return m


VALUES = {"w2": 4.0, "d": 0.4, "T": 1.0}


def test_a_model_that_is_not_linear_is_taken_at_a_point() -> None:
    down, up = (ph.linear.modes(pendulum(), VALUES, at={"th": th}) for th in (0.0, np.pi))
    assert down[0].frequency.value == pytest.approx(2.0 / (2 * np.pi))
    assert down[0].damping.value == pytest.approx(0.1)
    root = np.sqrt(0.2**2 + 4.0)
    np.testing.assert_allclose(up.eigenvalues, [-0.2 + root, -0.2 - root])
    assert not up[0].oscillates and not up[0].stable and up[1].stable
    assert up[0].damping.value == -1.0 and up[0].time_constant.value == pytest.approx(-1 / (root - 0.2))


def test_the_table_reads_well(fit: ph.Fit) -> None:
    lines = str(ph.linear.modes(fit)).splitlines()
    assert lines[0].split("  ")[0] == "frequency, Hz" and len(lines) == 4
    assert "±" in lines[2] and lines[2].endswith("j")
    assert repr(ph.linear.modes(fit)) == "<Modes: 2 oscillating, 0 not>"
    assert len(ph.linear.modes(fit)[:1]) == 1


def test_a_mode_held_without_damping_shows_no_error_of_it() -> None:
    held = np.diag([0.0, 1e-4])  # the real part at a bound
    row = str(table_of(np.array([3j, -3j]), np.stack([held, held]))).splitlines()[2]
    assert row.split() == ["0.4775", "±", "0.0016", "0", "inf", "0", "±", "3j"]


def test_an_integrator_has_no_time_constant() -> None:
    (mode,) = ph.linear.StateSpace([[0.0]], [[1.0]], [[1.0]]).modes
    assert mode.time_constant.value == np.inf and np.isnan(mode.damping.value) and mode.frequency.value == 0.0


def test_parameters_of_each_experiment_are_asked_for() -> None:
    m = ph.Model("lag")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    (a,) = m.parameters(a=ph.Parameter(1.0, per_experiment=True))
    m.dynamics(x=u - a * x)
    m.outputs(x=x)
    t = 0.1 * np.arange(100)
    runs = []
    for k, rate in enumerate((0.5, 2.0)):
        _, z, _ = lsim(([[-rate]], [[1.0]], [[1.0]], [[0.0]]), np.sin(t), t)
        z = z + 0.01 * np.random.default_rng(k).normal(size=100)
        runs.append(ph.Experiment(t, {"u": np.sin(t)}, {"x": z}, f"run{k}"))
    fit = ph.estimate(m, runs)
    with pytest.raises(ph.ModelError, match="each experiment has its own a: say which, experiment='run0'"):
        ph.linear.modes(fit)
    with pytest.raises(ph.ModelError, match="'run2' is not an experiment of the fit. Did you mean"):
        ph.linear.modes(fit, experiment="run2")
    for k, constant in enumerate((2.0, 0.5)):
        (mode,) = ph.linear.modes(fit, experiment=f"run{k}")
        e = fit.parameters[f"a[run{k}]"]
        assert mode.time_constant.value == pytest.approx(constant, rel=0.1)
        assert mode.time_constant.std_error == pytest.approx(e.std_error / e.value**2, rel=1e-6)


def test_what_cannot_be_right_is_refused() -> None:
    m = pendulum()
    cases: list[tuple[type[Exception], str, Any]] = [
        (ph.ModelError, "its derivatives depend on th; say where", lambda: ph.linear.modes(m, VALUES)),
        (ph.ModelError, "at: 'theta' is not a state or input", lambda: ph.linear.modes(m, VALUES, at={"theta": 0.0})),
        (ph.ModelError, "no value was given for d, T", lambda: ph.linear.modes(m, {"w2": 1.0}, at={"th": 0.0})),
        (ph.ModelError, "'w3' is not a parameter. There are: w2, d, T.", lambda: ph.linear.modes(m, {"w3": 1.0})),
        (
            ph.ModelError,
            "parameter 'd' is 'much', not a finite number",
            lambda: ph.linear.modes(m, {**VALUES, "d": "much"}),
        ),
        (ph.ModelError, "a model needs parameters={...}", lambda: ph.linear.modes(m)),
        (ph.ModelError, "is a Fit or a Model, not a str", lambda: ph.linear.modes("fit")),  # type: ignore[arg-type]
    ]
    for kind, message, call in cases:
        with pytest.raises(kind) as error:
            call()
        assert message in str(error.value), str(error.value)


def test_the_summary_is_the_table() -> None:
    modes = table_of(np.array([-0.1 + 2j, -0.1 - 2j, -0.5]))
    assert modes.summary() == str(modes) and "0.318708" in modes.summary()
