"""A joint with friction that is larger at rest, written as a torque or as the resistance that is subtracted."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

_STEP, _SAMPLES, _INNER = 0.01, 1500, 20
_INERTIA, _VISCOUS, _DRY, _MORE, _SPEED, _WIDTH = 0.05, 0.15, 0.5, 0.25, 0.15, 0.02


def _model(sign: float) -> ph.Model:
    m = ph.Model("joint")
    angle, w = m.states(angle="rad", w="rad/s")
    (torque,) = m.inputs(torque="N*m")
    inertia, viscous, dry = m.parameters(inertia=ph.Parameter(0.06, bounds=(0.005, 0.5)), viscous=0.1, dry=0.4)
    (friction,) = m.quantities(friction=-sign * dry * ph.tanh(w / _WIDTH))
    m.dynamics(angle=w, w=(torque + sign * friction - viscous * w) / inertia)
    m.outputs(angle_m=(angle, "rad"), w_m=(w, "rad/s"))
    return m


def _record(seed: int) -> ph.Experiment:
    """Return a record under position control on measured angles."""
    rng = np.random.default_rng(seed)
    t = np.arange(_SAMPLES) * _STEP
    wanted = 0.6 * np.sin((0.9 + 0.3 * (seed % 3)) * t) + 0.2 * np.sin(2.3 * t + seed)
    measured, torques = np.empty((_SAMPLES, 2)), np.empty(_SAMPLES)
    angle = w = 0.0
    for k in range(_SAMPLES):
        measured[k] = angle + 0.002 * rng.standard_normal(), w + 0.01 * rng.standard_normal()
        torques[k] = 15.0 * (wanted[k] - measured[k, 0]) - 1.0 * measured[k, 1]
        for _ in range(_INNER):
            friction = (_DRY + _MORE * np.exp(-((w / _SPEED) ** 2))) * np.tanh(w / _WIDTH)
            w += (torques[k] - _VISCOUS * w - friction) / _INERTIA * _STEP / _INNER
            angle += w * _STEP / _INNER
    outputs = {"angle_m": measured[:, 0], "w_m": measured[:, 1]}
    return ph.Experiment(t, {"torque": torques}, outputs, interpolation="hold")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_friction_that_is_larger_at_rest_is_named_however_it_enters(sign: float) -> None:
    found = ph.diagnose(ph.estimate(_model(sign), _record(1)), validation=_record(2)).findings
    (named,) = (f for f in found if f.status == "named")
    assert named.cause == "friction:stribeck_w"
    assert named.parameters["friction_stribeck_w"][0] * sign < 0.0
    assert named.explained > 0.8
