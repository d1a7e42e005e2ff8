"""An input that rests at its trim most of the time has the levels that it takes beside that."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import phugoid as ph

Array = NDArray[np.float64]
T = np.arange(0.0, 60.0, 0.1)


def pulses(sizes: list[float]) -> Array:
    """Return an input at zero but for pulses of 0.9 s, one every 60 / (number of sizes) s."""
    u, each = np.zeros(T.size), T.size // len(sizes)
    for k, size in enumerate(sizes):
        u[k * each + 10 : k * each + 19] = size
    return u


def diagnosed(sizes: list[float]) -> ph.Diagnosis:
    """Return the diagnosis of a first-order system whose input is cut off at 0.7."""
    m = ph.Model("lag")
    (u,), (x,) = m.inputs("u"), m.states("x")
    k, g = m.parameters(k=1.0, g=1.0)
    m.dynamics(x=g * u - k * x)
    m.outputs(x=x)
    rng = np.random.default_rng(3)

    def record(u: Array, name: str) -> ph.Experiment:
        run = ph.Experiment(T, {"u": np.clip(u, -0.7, 0.7)}, interpolation="hold", name=name)
        clean = ph.simulate(m, {"k": 0.8, "g": 1.5}, run, initial={"x": 0.0}).outputs["x"]
        return ph.Experiment(
            T, {"u": u}, {"x": clean + 0.005 * rng.standard_normal(T.size)}, interpolation="hold", name=name
        )

    first, second = record(pulses(sizes), "first"), record(pulses([-s for s in reversed(sizes)]), "second")
    return ph.diagnose(ph.estimate(m, first), validation=second)


def test_pulses_of_several_sizes_show_a_saturation() -> None:
    d = diagnosed([1.0, -0.5, 0.6, -1.0, 0.5, -0.6])
    (named,) = [f for f in d.findings if f.status == "named"]
    assert "u:saturation" in {named.cause, *named.aliases}
    assert d.extend().fit.parameters["saturation_u"].value == pytest.approx(0.7, abs=0.02)


def test_pulses_of_one_size_do_not() -> None:
    d = diagnosed([1.0, -1.0, 1.0, -1.0])
    assert not {"u:saturation", "u:deadband"} & {s.name for s in d.ranking}
    assert not [f for f in d.findings if f.status == "named"]
