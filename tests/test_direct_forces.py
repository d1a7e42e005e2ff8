"""Forces that act in an equation beside its coefficients, such as a thrust off the centre of gravity."""

from __future__ import annotations

import numpy as np
import pytest
from rigs import integrated, named

import phugoid as ph

_TIMES = np.arange(0.0, 60.0, 0.1)
_ARM = 0.04


def _boat(seed: int, name: str) -> ph.Experiment:
    """A boat with a propeller beside its centre line, whose thrust turns it."""
    rng = np.random.default_rng(seed)
    at = np.cumsum(rng.uniform(2.0, 5.0, 40))
    rudder, thrust = (
        rng.uniform(low, high, 41)[np.searchsorted(at, _TIMES)] for low, high in ((-0.3, 0.3), (0.5, 4.0))
    )

    def f(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        moment = 0.3 * x[0] ** 2 * (0.5 * u[0] - 0.8 * x[1] / x[0])
        return np.array([u[1] - 0.4 * x[0] ** 2, moment + _ARM * u[1]])

    x = integrated(f, np.array([2.0, 0.0]), _TIMES, np.stack([rudder, thrust], axis=1))
    outputs = {"u": x[:, 0] + 0.01 * rng.standard_normal(_TIMES.size)}
    outputs["r"] = x[:, 1] + 0.003 * rng.standard_normal(_TIMES.size)
    return ph.Experiment(_TIMES, {"rudder": rudder, "T": thrust}, outputs, interpolation="hold", name=name)


def _model() -> ph.Model:
    m = ph.Model("boat")
    u, r = m.states(u="m/s", r="rad/s")
    rudder, thrust = m.inputs(rudder="rad", T="m/s²")
    n0, n1, n2, d = m.parameters(n0=0.0, n1=0.3, n2=-0.5, d=0.3)
    (cn,) = m.quantities(Cn=n0 + n1 * rudder + n2 * r / u)
    m.dynamics(u=thrust - d * u**2, r=0.3 * u**2 * cn)
    m.outputs(u=u, r=r)
    return m


def test_a_thrust_beside_the_centre_line_is_named_at_its_true_arm() -> None:
    d = ph.diagnose(ph.estimate(_model(), _boat(1, "a")), validation=_boat(2, "b"))
    (found,) = named(d)
    assert found.cause == "r':T"
    assert found.coefficient == pytest.approx(_ARM, abs=4.0 * found.std_error)
    assert found.explained > 0.95


def test_inputs_that_act_through_coefficients_alone_are_offered_there_alone() -> None:
    names = ph.candidates(_model()).names
    assert "r':T" in names
    assert "Cn:T" in names
    assert "r':rudder" not in names
