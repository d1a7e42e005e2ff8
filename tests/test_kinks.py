"""Kinks of the state equations are named where a fit fails for them, and fitted by smooth functions made narrow."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

import phugoid as ph

TRUE = {"w": 4.0, "z": 0.3, "c": 0.8}


@cache
def record(seed: int) -> ph.Experiment:
    """An oscillator with Coulomb friction, integrated in short steps with events where it sticks and slides."""
    t = np.linspace(0, 20, 401)
    u = 3 * np.sin(0.3 * t**1.3)
    steps = 50
    h = float(t[1]) / steps
    fine = np.interp((np.arange(400 * steps) + 0.5) * h, t, u)
    x, v, path = 1.0, 0.0, [1.0]
    for k, force in enumerate(fine):
        rest = force - TRUE["w"] * x
        if v != 0 or abs(rest) > TRUE["c"]:
            friction = TRUE["c"] * np.sign(v if v != 0 else rest)
            middle = v + h / 2 * (rest - TRUE["z"] * v - friction)
            after = v + h * (force - TRUE["w"] * (x + h / 2 * v) - TRUE["z"] * middle - friction)
            x, v = x + h * middle, 0.0 if after * v < 0 else after
        if (k + 1) % steps == 0:
            path.append(x)
    noise = 0.005 * np.random.default_rng(seed).standard_normal(t.size)
    return ph.Experiment(t, {"u": u}, {"x": np.array(path) + noise})


def oscillator(sign: Callable[[Any], Any]) -> ph.Model:
    m = ph.Model("friction")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    w, z, c = m.parameters(w=1.0, z=1.0, c=0.1)
    m.dynamics(x=v, v=u - w * x - z * v - c * sign(v))
    m.outputs(x=x)
    return m


def test_the_kink_is_named_with_its_smooth_function() -> None:
    fit = ph.estimate(oscillator(ph.sign), record(0))
    assert fit.status == "infeasible" and "kinks or jumps" in fit.message
    assert "sign(v) in v'" in fit.warnings[0] and "ph.smooth_sign(x, width)" in fit.warnings[0]


def test_a_model_without_kinks_is_not_told_of_them() -> None:
    assert oscillator(ph.tanh)._core.kinks() == []


@pytest.mark.parametrize("seed", range(3))
def test_friction_is_estimated_as_the_width_falls(seed: int) -> None:
    fit = None
    for width in (1.0, 0.3, 0.1, 0.03, 0.01, 0.003):
        fit = ph.estimate(oscillator(lambda v, width=width: ph.smooth_sign(v, width)), record(seed), start=fit)
    assert fit is not None and fit.status == "converged"
    assert fit.parameters["w"].value == pytest.approx(TRUE["w"], rel=0.02)
    assert fit.parameters["c"].value == pytest.approx(TRUE["c"], rel=0.02)
