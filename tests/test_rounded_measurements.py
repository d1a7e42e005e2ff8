"""A turntable whose controller acts on its own coarse encoder: rounding errors go with the motion, and are no cause."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

_STEP, _SAMPLES, _INNER, _DIGIT = 0.01, 1200, 10, 2.0 * np.pi / 1000.0
_GAIN, _DAMPING, _TORQUE = 38.0, 2.8, 2.5


def _record(seed: int) -> ph.Experiment:
    rng = np.random.default_rng(seed)
    t = np.arange(_SAMPLES) * _STEP
    wanted = 0.3 * np.sin((0.7 + 0.2 * (seed % 4)) * t) + 0.15 * np.sign(np.sin((1.1 + 0.1 * (seed % 3)) * t))
    shown, commands, turning = np.empty(_SAMPLES), np.empty(_SAMPLES), np.empty(_SAMPLES)
    angle, w, before, slope = float(wanted[0]), 0.0, 0.0, 0.0
    for k in range(_SAMPLES):
        shown[k] = _DIGIT * np.round(angle / _DIGIT)
        slope = 0.8 * slope + 0.2 * (shown[k] - before) / _STEP if k else 0.0
        before = shown[k]
        commands[k] = np.clip(0.7 * (wanted[k] - shown[k]) - 0.08 * slope + _TORQUE / _GAIN, -2.0, 2.0)
        turning[k] = _GAIN * commands[k] - _DAMPING * w - _TORQUE
        for _ in range(_INNER):
            w += _STEP / _INNER * (_GAIN * commands[k] - _DAMPING * w - _TORQUE)
            angle += _STEP / _INNER * w
    turning = 0.3 * np.round((turning + 0.3 * rng.standard_normal(_SAMPLES)) / 0.3)
    outputs = {"angle": shown, "turning": turning}
    return ph.Experiment(t, {"u": commands}, outputs, interpolation="hold", name=f"run {seed}")


@pytest.mark.parametrize("seed", [10, 20, 30])
def test_nothing_is_named_where_only_an_encoder_rounds(seed: int) -> None:
    m = ph.Model("turntable")
    angle, w = m.states(theta="rad", w="rad/s")
    (u,) = m.inputs(u="A")
    gain, damping, torque = m.parameters(gain=30.0, damping=1.0, torque=0.0)
    rate = gain * u - damping * w - torque
    m.dynamics(theta=w, w=rate)
    m.outputs(angle=(angle, "rad"), turning=(rate, "rad/s²"))
    d = ph.diagnose(ph.estimate(m, [_record(seed), _record(seed + 1)]), validation=_record(seed + 2))
    assert not [f for f in d.findings if f.status == "named"], d.summary()
