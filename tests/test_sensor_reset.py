"""The zero of a sensor that jumps within a record."""

from __future__ import annotations

import numpy as np
import pytest
from rigs import integrated, levels, named

import phugoid as ph

_TIMES = np.arange(0.0, 80.0, 0.2)


def _climb(seed: int, jump: float, name: str) -> ph.Experiment:
    """A vehicle that climbs and sinks, with an altimeter that is set anew after 47 s."""
    rng = np.random.default_rng(seed)
    thrust = levels(rng, _TIMES, -1.0, 1.0, (3.0, 8.0), 30)
    x = integrated(
        lambda x, u: np.array([x[1], 1.2 * u[0] - 0.5 * x[1]]), np.array([50.0, 0.0]), _TIMES, thrust[:, None]
    )
    outputs = {"h": x[:, 0] + jump * (_TIMES > 47.0) + 0.3 * rng.standard_normal(_TIMES.size)}
    outputs["v"] = x[:, 1] + 0.1 * rng.standard_normal(_TIMES.size)
    return ph.Experiment(_TIMES, {"T": thrust}, outputs, interpolation="hold", name=name)


def _model() -> ph.Model:
    m = ph.Model("climb")
    h, v = m.states(h="m", v="m/s")
    (thrust,) = m.inputs(T="1")
    a, d = m.parameters(a=1.0, d=0.3)
    m.dynamics(h=v, v=a * thrust - d * v)
    m.outputs(h=h, v=v)
    return m


def test_a_jump_of_the_zero_is_named_with_its_time() -> None:
    d = ph.diagnose(ph.estimate(_model(), _climb(1, 4.0, "a")), validation=_climb(2, 0.0, "b"))
    (found,) = named(d)
    assert found.cause == "h:step"
    assert found.coefficient == pytest.approx(4.0, abs=4.0 * found.std_error)
    when, _ = found.parameters["time_of_step_y_h"]
    assert when == pytest.approx(47.0, abs=0.4)
