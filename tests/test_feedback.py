"""A controller that acts on noisy measurements, so that the input goes with their noise."""

from __future__ import annotations

import numpy as np

import phugoid as ph

_STEP, _SAMPLES, _INNER = 0.05, 800, 5
_GAIN, _DRAG = 8.0, 0.6


def _model(trim: float = 0.0) -> ph.Model:
    m = ph.Model("cart with a controller")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="1")
    k, d = m.parameters(k=5.0, d=0.2)
    m.dynamics(x=v, v=k * (u - trim) - d * v)
    m.outputs(x_m=(x, "m"), v_m=(v, "m/s"))
    return m


def _record(seed: int, size: float, direct: float, trim: float = 0.0) -> ph.Experiment:
    """Return a record in which the controller acts on what the sensors show, with noise of a size, and the sensor of
    the speed shows a part of the input, which holds the cart on a slope where it is at its trim."""
    rng = np.random.default_rng(seed)
    wanted = np.repeat(rng.uniform(-1.0, 1.0, _SAMPLES // 40), 40)
    noise = size * np.array([0.2, 0.1]) * rng.standard_normal((_SAMPLES, 2))
    x, v, h, u = 0.0, 0.0, _STEP / _INNER, 0.0
    inputs, outputs = np.zeros(_SAMPLES), np.zeros((_SAMPLES, 2))
    for k in range(_SAMPLES):
        x_m, v_m = x + noise[k, 0], v + noise[k, 1]
        u = trim + 0.9 * (wanted[k] - x_m) - 0.5 * v_m
        inputs[k], outputs[k] = u, (x_m, v_m + direct * u)
        for _ in range(_INNER):
            half = v + 0.5 * h * (_GAIN * (u - trim) - _DRAG * v)
            x, v = x + h * half, v + h * (_GAIN * (u - trim) - _DRAG * half)
    x_m, v_m = outputs.T
    return ph.Experiment(np.arange(_SAMPLES) * _STEP, {"u": inputs}, {"x_m": x_m, "v_m": v_m}, interpolation="hold")


def test_an_input_that_follows_the_noise_of_a_sensor_is_no_term_of_that_output() -> None:
    d = ph.diagnose(ph.estimate(_model(), _record(1, 1.0, 0.0)), validation=_record(2, 1.0, 0.0))
    assert not d.found
    assert "follows the noise of" in str(d)


def test_noise_is_a_small_part_of_an_input_with_a_large_trim() -> None:
    trim = 100.0
    d = ph.diagnose(ph.estimate(_model(trim), _record(1, 1.0, 0.0, trim)), validation=_record(2, 1.0, 0.0, trim))
    assert not d.found, str(d)


def test_a_term_of_an_input_in_an_output_is_named_where_its_noise_is_fed_back() -> None:
    d = ph.diagnose(ph.estimate(_model(), _record(1, 0.3, 0.15)), validation=_record(2, 0.3, 0.15))
    named = {f.cause: f for f in d.findings if f.status == "named"}
    assert [*named] == ["v_m:u"]
    value, error = named["v_m:u"].parameters["y_v_m_u"]
    assert abs(value - 0.15) < 4.0 * error
