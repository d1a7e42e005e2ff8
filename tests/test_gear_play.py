"""Play between two bodies: a dead zone of a quantity that is declared, not of an input."""

from __future__ import annotations

import numpy as np
import pytest
from rigs import integrated, named

import phugoid as ph

_TIMES = np.arange(0.0, 12.0, 0.01)
_PLAY = 0.05


def _slider(seed: int, name: str) -> ph.Experiment:
    """A body that is driven through a spring with play of +-0.05 m at its end."""
    rng = np.random.default_rng(seed)
    drive = sum(0.12 * np.sin(w * _TIMES + rng.uniform(0.0, 6.28)) for w in (1.1, 2.3, 3.7))

    def f(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        stretch = u[0] - x[0]
        return np.array([x[1], 60.0 * np.sign(stretch) * max(abs(stretch) - _PLAY, 0.0) - 3.0 * x[1]])

    x = integrated(f, np.zeros(2), _TIMES, drive[:, None])
    outputs = {"x": x[:, 0] + 0.001 * rng.standard_normal(_TIMES.size)}
    outputs["v"] = x[:, 1] + 0.005 * rng.standard_normal(_TIMES.size)
    return ph.Experiment(_TIMES, {"drive": drive}, outputs, name=name)


def _model(measured: bool = False) -> ph.Model:
    m = ph.Model("slider")
    x, v = m.states(x="m", v="m/s")
    (drive,) = m.inputs(drive="m")
    k, c = m.parameters(k=30.0, c=1.0)
    (stretch,) = m.quantities(stretch=drive - x)
    m.dynamics(x=v, v=k * stretch - c * v)
    m.outputs(x=x, v=v)
    if measured:
        m.outputs(gap=stretch)
    return m


def test_play_in_a_declared_quantity_is_named() -> None:
    d = ph.diagnose(ph.estimate(_model(), _slider(1, "a")), validation=_slider(2, "b"))
    first = named(d)[0]
    assert first.cause == "stretch:deadband"
    (value, error) = first.parameters["deadband_stretch"]
    assert value == pytest.approx(_PLAY, abs=max(4.0 * error, 0.002))
    assert first.explained > 0.9


def test_a_measured_quantity_has_no_dead_zone_of_its_own() -> None:
    assert "stretch:deadband" in ph.candidates(_model()).names
    assert "stretch:deadband" not in ph.candidates(_model(measured=True)).names
