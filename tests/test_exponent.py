"""A body cooled by a fan, by a power of its speed that the model does not have."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

_STEP, _SAMPLES, _INNER = 5.0, 700, 20
_COOLING, _CAPACITY, _AROUND = 0.5, 60.0, 20.0


def _record(seed: int, power: float) -> ph.Experiment:
    rng = np.random.default_rng(seed)
    heat, speed = (np.repeat(rng.uniform(low, high, _SAMPLES // 35), 35) for low, high in ((2.0, 12.0), (0.3, 1.7)))
    body, temperature = np.empty(_SAMPLES), 30.0
    for k in range(_SAMPLES):
        body[k] = temperature
        for _ in range(_INNER):
            flow = _COOLING * speed[k] ** power * (temperature - _AROUND)
            temperature += _STEP / _INNER * (heat[k] - flow) / _CAPACITY
    outputs = {"T_m": body + 0.1 * rng.standard_normal(_SAMPLES)}
    return ph.Experiment(np.arange(_SAMPLES) * _STEP, {"heat": heat, "speed": speed}, outputs, interpolation="hold")


@pytest.mark.parametrize("power", [0.6, 1.0])
def test_another_exponent_of_an_input_is_named_where_there_is_one(power: float) -> None:
    m = ph.Model("cooled body")
    (temperature,) = m.states(T="degC")
    heat, speed = m.inputs(heat="W", speed="1")
    cooling, capacity = m.parameters(cooling=ph.Parameter(1.0, bounds=(0.01, 10.0)), capacity=100.0)
    m.dynamics(T=(heat - cooling * speed * (temperature - _AROUND)) / capacity)
    m.outputs(T_m=(temperature, "degC"))
    found = ph.diagnose(ph.estimate(m, _record(1, power)), validation=_record(2, power)).findings
    named = [f for f in found if f.status == "named"]
    assert [f.cause for f in named] == (["cooling:exponent_speed"] if power != 1.0 else [])
    for f in named:
        value, error = f.parameters["exponent_cooling_speed"]
        assert abs(1.0 + value - power) < 4.0 * error + 0.02 or abs(value - power) < 4.0 * error + 0.02
