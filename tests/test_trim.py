"""Trim points, models made linear there, and python-control."""

from __future__ import annotations

import sys

import hfb320
import numpy as np
import pytest

import phugoid as ph
from phugoid import EvaluationError, MissingDependency, ModelError, OptionError, sin

LEVEL = {"V": 106.0, "T": 11500.0}


@pytest.fixture(scope="module")
def model() -> ph.Model:
    return hfb320.model()


@pytest.fixture(scope="module")
def level(model: ph.Model) -> ph.results.Trim:
    return ph.linear.trim(model, hfb320.PUBLISHED, at=LEVEL)


def test_derivatives_vanish_at_the_trim(model: ph.Model, level: ph.results.Trim) -> None:
    assert level.found == ("alpha", "theta", "q", "de") and level.warnings == ()
    assert {n: level[n] for n in LEVEL} == LEVEL
    assert level["q"] == 0.0 and 0.0 < level["alpha"] < 0.2 and level["de"] < 0.0
    assert max(map(abs, level.rates.values())) < 1e-14
    assert set(level) == {"V", "alpha", "theta", "q", "de", "T", "time"} and len(level) == 7
    assert "held" in str(level) and "m/s²" in str(level)


def test_a_simulation_stays_at_the_trim(model: ph.Model, level: ph.results.Trim) -> None:
    t = np.linspace(0, 20, 41)
    e = ph.Experiment(t, {n: np.full(t.size, v) for n, v in level.inputs.items()})
    path = ph.simulate(model, hfb320.PUBLISHED, e, initial=level.states)
    for name, value in level.states.items():
        np.testing.assert_allclose(path.states[name], value, rtol=1e-7, atol=1e-9)
    for name, value in level.outputs.items():
        np.testing.assert_allclose(path.outputs[name], value, rtol=1e-7, atol=1e-9)


def test_hfb_320_has_a_phugoid_and_a_short_period(model: ph.Model, level: ph.results.Trim) -> None:
    """The phugoid against Lanchester: sqrt(2) g / V."""
    linear = ph.linear.linearise(model, hfb320.PUBLISHED, at=level)
    slow, fast = linear.modes
    assert slow.oscillates and fast.oscillates
    assert float(slow.frequency) == pytest.approx(np.sqrt(2) * 9.80665 / 106.0 / (2 * np.pi), rel=0.1)
    assert 0.0 < float(slow.damping) < 0.15 and 0.3 < float(fast.damping) < 0.6
    assert float(fast.frequency) > 10 * float(slow.frequency)


def test_the_linear_model_is_that_of_small_steps(model: ph.Model, level: ph.results.Trim) -> None:
    """Columns of A and B against the nonlinear equations a little away, by central differences."""
    linear = ph.linear.linearise(model, hfb320.PUBLISHED, at=level)
    evaluator = ph._core.Evaluator(model._core)
    theta = np.array([hfb320.PUBLISHED[n] for n in model.parameter_names])
    point = np.array([0.0, *level.inputs.values(), *level.states.values()])
    for names, first, f, g in (
        (linear.inputs, 1, linear.B, linear.D),
        (linear.states, 1 + len(linear.inputs), linear.A, linear.C),
    ):
        for k in range(len(names)):
            h = 1e-4 * max(abs(point[first + k]), 0.1)
            ends = np.repeat(point[:, None], 2, axis=1)
            ends[first + k] += (-h, h)
            for evaluate, column in ((evaluator.dynamics, f[:, k]), (evaluator.outputs, g[:, k])):
                low, high = evaluate(theta, ends).T
                np.testing.assert_allclose((high - low) / (2 * h), column, rtol=1e-5, atol=1e-7)


def test_python_control_agrees_on_the_modes(model: ph.Model, level: ph.results.Trim) -> None:
    control = pytest.importorskip("control", reason="needs python-control")
    linear = ph.linear.linearise(model, hfb320.PUBLISHED, at=level)
    system = linear.to_control("hfb")
    assert isinstance(system, control.StateSpace) and system.name == "hfb"
    assert system.state_labels == ["V", "alpha", "theta", "q"] and system.input_labels == ["de", "T"]
    assert system.output_labels == list(model.output_names)
    for block in "ABCD":
        np.testing.assert_array_equal(getattr(system, block), getattr(linear, block))
    modes = ph.linear.modes(model, hfb320.PUBLISHED, at=level)
    frequency, damping, _ = control.damp(system, doprint=False)
    ours = sorted((2 * np.pi * float(m.frequency), float(m.damping)) for m in modes)
    np.testing.assert_allclose(sorted(zip(frequency, damping, strict=True))[::2], ours, rtol=1e-9)
    poles = np.sort_complex(system.poles()[system.poles().imag > 0])
    np.testing.assert_allclose(poles, np.sort_complex([m.eigenvalue for m in modes]), rtol=1e-9)
    at = 0.3
    response = system(2j * np.pi * at)[3, 0]
    np.testing.assert_allclose(linear.frequency_response([at], "de", "q").response[0], response, rtol=1e-9)


def test_names_with_dots_go_to_python_control() -> None:
    pytest.importorskip("control", reason="needs python-control")
    system = ph.linear.StateSpace([[-1.0]], [[1.0]], [[1.0]], inputs=("log.de",), outputs=("log.q",)).to_control()
    assert (system.input_labels, system.output_labels, system.state_labels) == (["log_de"], ["log_q"], ["x"])


def test_without_python_control_the_command_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(MissingDependency, match=r'pip install "phugoid\[control\]"'):
        ph.linear.StateSpace([[-1.0]], [[1.0]], [[1.0]]).to_control()


def test_a_climb_and_an_output_that_is_to_have_a_value(model: ph.Model) -> None:
    descent = ph.linear.trim(model, hfb320.PUBLISHED, at={"V": 110.0}, outputs={"theta": 0.05}, start={"T": 1e4})
    assert descent.outputs["theta"] == pytest.approx(0.05, abs=1e-14)
    assert set(descent.found) == {"alpha", "theta", "q", "de", "T"}
    # Pulling up at a moment: the speed changes as it does.
    pull = ph.linear.trim(model, hfb320.PUBLISHED, at={**LEVEL, "theta": 0.1}, rates={"theta": 0.01, "V": None})
    assert pull.rates["theta"] == pytest.approx(0.01, abs=1e-14) and abs(pull.rates["V"]) > 0.01


def test_the_trim_of_a_fit_begins_at_its_record() -> None:
    """The equations have many trims (angles): the one near the record is found."""
    m = ph.Model("pendulum")
    phi, w = m.states(phi="rad", w="rad/s")
    (T,) = m.inputs("T")
    k, c = m.parameters(k=4.0, c=ph.Parameter(0.5, per_experiment=True))
    m.dynamics(phi=w, w=T - k * sin(phi) - 0.3 * w + c)
    m.outputs(phi=phi)
    t = 0.1 * np.arange(50)
    rng = np.random.default_rng(0)
    runs = []
    for name, turns, c0 in (("one", 1, 0.5), ("two", 0, 1.0)):
        e = ph.Experiment(t, {"T": np.zeros(t.size)}, name=name)
        phi1 = ph.simulate(m, {"k": 4.0, "c": c0}, e, initial={"phi": 2 * np.pi * turns + 0.3}).outputs["phi"]
        runs.append(e.with_outputs({"phi": phi1 + 0.001 * rng.standard_normal(t.size)}))
    fit = ph.estimate(m, runs)
    with pytest.raises(ModelError, match=r"each experiment has its own c: say which, experiment='one'"):
        ph.linear.trim(fit, at={"T": 0.0})
    for name, turns in (("one", 1), ("two", 0)):
        point = ph.linear.trim(fit, at={"T": 0.0}, experiment=name)
        angle = np.arcsin(fit.parameters[f"c[{name}]"].value / fit.parameters["k"].value)
        assert point["phi"] == pytest.approx(2 * np.pi * turns + angle, rel=1e-12)
        assert ph.linear.linearise(fit, at=point, experiment=name).order == 2


def test_a_late_input_is_as_the_input() -> None:
    m = ph.Model("late")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    (tau,) = m.parameters(tau=0.1)
    m.dynamics(x=2 * m.delay(u, tau) - x)
    m.outputs(x=x, sum=x + u)
    point = ph.linear.trim(m, {"tau": 0.1}, outputs={"sum": 3.0})
    assert point["x"] == pytest.approx(2.0) and point["u"] == point["u_delayed"] == pytest.approx(1.0)


def test_what_stays_open_is_named() -> None:
    m = ph.Model("cart")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    m.dynamics(x=v, v=u - v)
    m.outputs(x=x)
    point = ph.linear.trim(m, at={"u": 0.0}, start={"x": 7.0})
    assert point["x"] == 7.0 and point.warnings == ("x is not determined by the equations: give a value",)
    assert ph.linear.trim(m, at={"u": 0.0, "x": 1.0}).warnings == ()
    moving = ph.linear.trim(m, at={"u": 3.0, "x": 0.0}, rates={"x": None})
    assert moving["v"] == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"at": {"V": 106.0}}, OptionError, r"5 unknowns \(alpha, theta, q, de, T\) and 4 equations .* give 1 more"),
        ({"at": {"V": 106.0, "T": 11500.0, "de": 0.0}}, OptionError, r"no trim was found: .* comes no nearer than"),
        ({"at": {"V": 106.0, "T": 1e9}}, OptionError, "no trim was found"),
        ({"at": LEVEL, "bounds": {"de": (0.0, 1.0)}}, OptionError, "no trim was found"),
        ({"at": LEVEL, "bounds": {"de": (1.0, 0.0)}}, OptionError, "bounds of de"),
        ({"at": LEVEL, "bounds": {"V": (1.0, 2.0)}}, ModelError, "bounds: 'V' is not there"),
        ({"at": {"V": 0.0, "T": 1e4}}, EvaluationError, "not finite at alpha = 0.*give a start"),
        ({"at": {"Q": 0.0}}, ModelError, "at: 'Q' is not there. Did you mean 'q'"),
        ({"at": {"V": float("nan")}}, ModelError, "at: V is nan"),
        ({"rates": {"de": 0.0}}, ModelError, "rates: 'de' is not there"),
        ({"outputs": {"aZ": 0.0}}, ModelError, "outputs: 'aZ' is not there. Did you mean 'az'"),
        ({"start": {"bla": 0.0}}, ModelError, "start: 'bla' is not there"),
        (
            {"at": dict.fromkeys(("V", "alpha", "theta", "q", "de", "T"), 1.0)},
            OptionError,
            "all states and inputs are given",
        ),
    ],
)
def test_bad_input(model: ph.Model, options: dict[str, object], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        ph.linear.trim(model, hfb320.PUBLISHED, **options)  # type: ignore[arg-type]


def test_time_must_be_said_where_it_matters() -> None:
    m = ph.Model("clock")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    m.dynamics(x=u - x - m.time)
    m.outputs(x=x)
    with pytest.raises(ModelError, match="depend on time"):
        ph.linear.trim(m, at={"u": 1.0})
    assert ph.linear.trim(m, at={"u": 1.0, "time": 3.0})["x"] == pytest.approx(-2.0)
