"""Thrust that grows near the ground."""

from __future__ import annotations

import numpy as np

import phugoid as ph

_STEP, _SAMPLES, _INNER = 0.05, 900, 10
_THRUST, _DRAG, _RISE, _HEIGHT, _WEIGHT = 19.0, 0.5, 4.0, 0.6, 9.81


def _model() -> ph.Model:
    m = ph.Model("multicopter, vertical")
    h, w = m.states(h="m", w="m/s")
    (thrust,) = m.inputs(thrust="1")
    k, d = m.parameters(k=ph.Parameter(12.0, bounds=(1.0, 60.0)), d=0.3)
    m.dynamics(h=w, w=k * thrust - d * w - _WEIGHT)
    m.outputs(h_m=(h, "m"), az=(k * thrust - d * w, "m/s²"))
    return m


def _record(seed: int, rise: float) -> ph.Experiment:
    """Return a flight with a height controller, down to 0.2 m above the ground."""
    rng = np.random.default_rng(seed)
    wanted = np.repeat(rng.uniform(0.2, 4.0, _SAMPLES // 60), 60)
    x, h = np.array([2.0, 0.0]), _STEP / _INNER
    path, inputs, forces = np.zeros((_SAMPLES, 2)), np.zeros(_SAMPLES), np.zeros(_SAMPLES)

    def force(x: np.ndarray, u: float) -> float:
        return _THRUST * u - _DRAG * x[1] + rise * np.exp(-x[0] / _HEIGHT)

    def rate(x: np.ndarray, u: float) -> np.ndarray:
        return np.array([x[1], force(x, u) - _WEIGHT])

    for k in range(_SAMPLES):
        u = np.clip(_WEIGHT / _THRUST + 0.1 * (wanted[k] - x[0]) - 0.12 * x[1], 0.2, 0.9)
        path[k], inputs[k], forces[k] = x, u, force(x, u)
        for _ in range(_INNER):
            x = x + h * rate(x + 0.5 * h * rate(x, u), u)
    outputs = {
        "h_m": path[:, 0] + 0.02 * rng.standard_normal(_SAMPLES),
        "az": forces + 0.1 * rng.standard_normal(_SAMPLES),
    }
    return ph.Experiment(np.arange(_SAMPLES) * _STEP, {"thrust": inputs}, outputs, interpolation="hold")


def test_ground_effect_is_named_with_the_height_over_which_it_decays() -> None:
    d = ph.diagnose(ph.estimate(_model(), _record(1, _RISE)), validation=_record(2, _RISE))
    (finding,) = (f for f in d.findings if f.status == "named")
    assert finding.cause == "w':exp(-h)"
    assert finding.explained > 0.9
    height, error = finding.parameters["distance_w_dot_h"]
    assert abs(height - _HEIGHT) < 4.0 * error


def test_no_ground_effect_is_named_where_there_is_none() -> None:
    assert not ph.diagnose(ph.estimate(_model(), _record(1, 0.0)), validation=_record(2, 0.0)).found
