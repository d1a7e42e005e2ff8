"""Kinks of state equations are smoothed over widths that fall until the estimates settle; else they are named."""

import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phugoid as ph

TRUE = {"w": 4.0, "z": 0.3, "c": 0.8}
T = np.linspace(0, 20, 401)
U = 3 * np.sin(0.3 * T**1.3)
NOISE = 0.005
DATA = Path(os.environ.get("PHUGOID_DATA", Path(__file__).parents[2] / "shared" / "data"))


def slide(w: float, z: float, c: float, x: float = 1.0, v: float = 0.0) -> np.ndarray:
    """The path of an oscillator with Coulomb friction, in short steps with events where it sticks and slides."""
    steps = 50
    h = float(T[1]) / steps
    fine = np.interp((np.arange(400 * steps) + 0.5) * h, T, U)
    path = [x]
    for k, force in enumerate(fine):
        rest = force - w * x
        if v != 0 or abs(rest) > c:
            friction = c * np.sign(v if v != 0 else rest)
            middle = v + h / 2 * (rest - z * v - friction)
            after = v + h * (force - w * (x + h / 2 * v) - z * middle - friction)
            if after * v < 0:  # it stops within the step, and goes on unless friction holds it
                part = after / (after - v)
                after = part * h * np.sign(rest) * max(abs(rest) - c, 0)
                middle = ((1 - part) * v + part * after) / 2
            x, v = x + h * middle, after
        if (k + 1) % steps == 0:
            path.append(x)
    return np.array(path)


@cache
def record(seed: int) -> ph.Experiment:
    noise = NOISE * np.random.default_rng(seed).standard_normal(T.size)
    return ph.Experiment(T, {"u": U}, {"x": slide(**TRUE) + noise})


def oscillator(sign: Callable[[Any], Any]) -> ph.Model:
    m = ph.Model("friction")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    w, z, c = m.parameters(w=1.0, z=1.0, c=0.1)
    m.dynamics(x=v, v=u - w * x - z * v - c * sign(v))
    m.outputs(x=x)
    return m


@cache
def friction(seed: int) -> ph.Fit:
    return ph.estimate(oscillator(ph.sign), record(seed))


def sprung(force: Callable[..., Any], **parameters: tuple[float, float]) -> tuple[ph.Model, ph.Experiment]:
    """An oscillator with another force, and a record of it; ``parameters``: start and true value."""
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    m.dynamics(x=v, v=u - force(x, v, *m.parameters(**{name: start for name, (start, _) in parameters.items()})))
    m.outputs(x=x)
    true = {name: value for name, (_, value) in parameters.items()}
    path = ph.simulate(m, true, ph.Experiment(T, {"u": U}), initial={"x": 1.0, "v": 0.0})
    noise = NOISE * np.random.default_rng(1).standard_normal(T.size)
    return m, ph.Experiment(T, {"u": U}, {"x": path.outputs["x"] + noise})


@pytest.mark.parametrize("seed", range(3))
def test_friction_is_estimated(seed: int) -> None:
    fit = friction(seed)
    assert fit.status == "converged" and fit.warnings == ()
    for name, true in TRUE.items():
        e = fit.parameters[name]
        assert abs(e.value - true) < max(3 * e.std_error, 0.02 * true)
    assert fit.parameters["z"].std_error == pytest.approx(0.0021, rel=0.1)
    # The sharp model itself, simulated with the estimates, leaves the noise.
    start = fit.initial_states["experiment"]
    path = slide(**{n: fit.parameters[n].value for n in TRUE}, x=start["x"].value)
    assert np.std(record(seed).outputs["x"] - path) == pytest.approx(NOISE, rel=0.1)


def test_what_was_smoothed_is_told() -> None:
    fit = friction(0)
    assert fit.smoothing is not None and list(fit.smoothing.widths) == ["sign(v) in v'"]
    width, unit = fit.smoothing.widths["sign(v) in v'"]
    assert width < 1e-3 and unit == "m/s"
    told = re.search(r"sign\(v\) in v' over (\S+) m/s", fit.message)
    assert told is not None and float(told[1]) == pytest.approx(width, rel=0.05)
    assert "left by smoothing" in fit.summary()
    assert [name for name, _ in fit.model._core.kinks()] == ["sign"]  # the model as it was given
    parts = [abs(left) / error for left, error in fit.smoothing.left.values()]
    assert max(parts) < 0.25


def test_smoothing_is_saved(tmp_path: Path) -> None:
    fit = friction(0)
    fit.save(tmp_path / "fit.json")
    loaded = ph.load(tmp_path / "fit.json")
    assert loaded.smoothing == fit.smoothing and loaded.summary() == fit.summary()


def test_a_validation_is_smoothed_as_far() -> None:
    held = friction(0).validate(record(1)).records[0]
    assert np.std(held.residuals["x"]) == pytest.approx(NOISE, rel=0.1)


def test_a_jump_within_segments_is_resolved_and_its_place_estimated() -> None:
    m, run = sprung(
        lambda x, v, k, z, r, d: k * x + z * v + r * (x > d), k=(2, 4), z=(1, 0.3), r=(0.1, 0.8), d=(0.1, 0.25)
    )
    fit = ph.estimate(m, run)
    assert fit.status == "converged" and fit.smoothing is not None
    for name, true in {"k": 4, "z": 0.3, "r": 0.8, "d": 0.25}.items():
        e = fit.parameters[name]
        assert abs(e.value - true) < 3 * e.std_error < 0.03 * true


@pytest.mark.parametrize(
    "force",
    [
        lambda x, v, k, z: k * x + z * v * abs(v),
        lambda x, v, k, z: k * ph.minimum(ph.maximum(x, -0.4), 0.4) + x + z * v,
        lambda x, v, k, z: k * (ph.maximum(x - 0.3, 0) + ph.minimum(x + 0.3, 0)) + z * v,
        lambda x, v, k, z: ph.where(x > 0, k, 3.0) * x + z * v,
        lambda x, v, k, z: k * x + z * v + ph.sign(x - 100.0),  # never reached
    ],
)
def test_kinks_that_the_mesh_resolves_stay(force: Callable[..., Any]) -> None:
    m, run = sprung(force, k=(2, 5), z=(1, 0.3))
    fit = ph.estimate(m, run)
    assert fit.status == "converged" and fit.smoothing is None and fit.warnings == ()
    for name, true in {"k": 5, "z": 0.3}.items():
        assert abs(fit.parameters[name].value - true) < 3 * fit.parameters[name].std_error


def test_passes_share_the_time() -> None:
    fit = ph.estimate(oscillator(ph.sign), record(0), solver=ph.Newton(time_limit=0.05))
    assert fit.status == "time limit"


def test_the_kink_is_named_where_it_cannot_be_smoothed() -> None:
    fit = ph.estimate(oscillator(ph.sign), record(0), transcription=ph.MultipleShooting())
    assert fit.status == "infeasible" and "kinks or jumps" in fit.message
    assert "sign(v) in v'" in fit.warnings[0] and "ph.smooth_sign(x, width)" in fit.warnings[0]


def test_a_model_without_kinks_is_not_told_of_them() -> None:
    assert oscillator(ph.tanh)._core.kinks() == []


def test_friction_is_estimated_as_the_width_falls_by_hand() -> None:
    fit = None
    for width in (1.0, 0.3, 0.1, 0.03, 0.01, 0.003):
        fit = ph.estimate(oscillator(lambda v, width=width: ph.smooth_sign(v, width)), record(0), start=fit)
    assert fit is not None and fit.status == "converged"
    assert fit.parameters["w"].value == pytest.approx(TRUE["w"], rel=0.02)
    assert fit.parameters["c"].value == pytest.approx(TRUE["c"], rel=0.02)


def test_dry_friction_of_a_real_pendulum_is_estimated() -> None:
    path = DATA / "known" / "pendulum2.csv"
    if not path.exists():
        pytest.skip("the record known/pendulum2.csv is neither in $PHUGOID_DATA nor in ../shared/data")
    t, theta, _ = np.loadtxt(path, delimiter=",", skiprows=1)[198:3600:2].T
    m = ph.Model("pendulum")
    phi, w = m.states(phi="rad", w="rad/s")
    w2, p0, f, d = m.parameters(w2=48.0, p0=0.0, f=0.1, d=0.001)
    m.dynamics(phi=w, w=-w2 * ph.sin(phi - p0) - f * ph.sign(w) - d * w * abs(w))
    m.outputs(phi=phi)
    fit = ph.estimate(m, ph.Experiment(t - t[0], {}, {"phi": theta - np.pi}))
    assert fit.status == "converged"
    assert fit.parameters["f"].value == pytest.approx(0.553, rel=0.02)
    assert fit.parameters["d"].value == pytest.approx(0.00096, rel=0.05)


def test_a_fit_that_goes_on_smooths_as_the_last_pass_did() -> None:
    first = ph.estimate(oscillator(ph.sign), record(0))
    assert first.smoothing is not None and len(first.smoothing.steps) > 2
    again = ph.estimate(oscillator(ph.sign), record(0), start=first)
    assert again.status == "converged" and again.smoothing is not None
    assert len(again.smoothing.steps) == 1
    assert again.smoothing.widths == first.smoothing.widths
    changes = [{name: change for name, (change, _) in s.left.items()} for s in (again.smoothing, first.smoothing)]
    assert changes[0] == changes[1]
    assert again.iterations < first.iterations / 3
    for name, e in first.parameters.items():
        assert abs(again.parameters[name].value - e.value) < 0.05 * e.std_error


def test_other_data_are_smoothed_from_the_beginning() -> None:
    first = ph.estimate(oscillator(ph.sign), record(0))
    shorter = record(0).window(0.0, 15.0)
    other = ph.estimate(oscillator(ph.sign), shorter, start=first)
    assert other.smoothing is not None and len(other.smoothing.steps) > 2
