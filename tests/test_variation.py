"""Check what changes in the course of a record: parameters at one time, as by flaps or ice; a mass as fuel is burnt;
thrust as a battery is drawn."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

_STEP, _SAMPLES, _INNER, _TIME = 0.05, 600, 10, 13.0
_BEFORE = {"Za": -1.1, "Z0": 0.0, "Ma": -4.0, "Mq": -1.8, "M0": 0.0}


def _model() -> ph.Model:
    m = ph.Model("short period")
    alpha, q = m.states(alpha="rad", q="rad/s")
    (de,) = m.inputs(de="rad")
    Za, Z0, Ma, Mq, M0, Mde = m.parameters(Za=-1.0, Z0=0.0, Ma=-3.0, Mq=-1.0, M0=0.0, Mde=-5.0)
    m.dynamics(alpha=q + Za * alpha + Z0, q=Ma * alpha + Mq * q + M0 + Mde * de)
    m.outputs(alpha_m=(alpha, "rad"), q_m=(q, "rad/s"))
    return m


def _record(seed: int, change: dict[str, float]) -> ph.Experiment:
    """Return a record in which parameters change at a time."""
    rng = np.random.default_rng(seed)
    de = np.repeat(rng.uniform(-0.05, 0.05, _SAMPLES // 15), 15)
    x, h, path = np.zeros(2), _STEP / _INNER, np.zeros((_SAMPLES, 2))

    def rate(x: np.ndarray, u: float, t: float) -> np.ndarray:
        p = {n: v + (change.get(n, 0.0) if t >= _TIME else 0.0) for n, v in _BEFORE.items()}
        return np.array([x[1] + p["Za"] * x[0] + p["Z0"], p["Ma"] * x[0] + p["Mq"] * x[1] + p["M0"] - 6.0 * u])

    for k in range(_SAMPLES):
        path[k] = x
        for j in range(_INNER):
            t = k * _STEP + j * h
            x = x + h * rate(x + 0.5 * h * rate(x, de[k], t), de[k], t + 0.5 * h)
    alpha, q = (path + [0.001, 0.003] * rng.standard_normal(path.shape)).T
    t = np.arange(_SAMPLES) * _STEP
    return ph.Experiment(t, {"de": de}, {"alpha_m": alpha, "q_m": q}, interpolation="hold")


@pytest.mark.parametrize("change", [{"Z0": -0.05, "M0": -0.09, "Za": -0.4}, {"Ma": -1.2}])
def test_parameters_that_change_at_one_time_are_named_together(change: dict[str, float]) -> None:
    found = ph.diagnose(ph.estimate(_model(), _record(1, change))).findings
    (finding,) = (f for f in found if f.status == "named")
    names, what = finding.cause.split(":")
    assert what == "step"
    assert {*names.split(",")} == {*change}
    for name, size in change.items():
        value, error = finding.parameters[f"step_{name}"]
        assert abs(value - size) < 4.0 * error + 0.02 * abs(size)
    time = next(v for n, (v, _) in finding.parameters.items() if n.startswith("time_of"))
    assert abs(time - _TIME) < 2.0 * _STEP


def _climb(fuel: float, sag: float) -> ph.Model:
    """Return a vehicle that climbs by thrust, whose mass falls by a part ``fuel`` and its thrust by a part ``sag`` as
    the integral of the throttle reaches 25 s."""
    m = ph.Model("vertical flight")
    h, v = m.states(h="m", v="m/s")
    (throttle,) = m.inputs(throttle="1")
    thrust, drag = m.parameters(thrust=20.0, drag=0.1)
    used = 0.0
    if fuel or sag:
        (used,) = m.states(used="1")
    force = thrust * (1 - sag * used) * throttle - drag * v
    mass = 1 - fuel * used
    m.dynamics(h=v, v=force / mass - 9.81, **({"used": throttle / 25.0} if fuel or sag else {}))
    m.outputs(h_m=(h, "m"), v_m=(v, "m/s"), az=(force / mass, "m/s²"))
    return m


def _flight(seed: int, fuel: float, sag: float) -> ph.Experiment:
    rng = np.random.default_rng(seed)
    t = np.arange(800) * 0.05
    throttle = np.repeat(rng.uniform(0.2, 1.0, 10), 80)
    start = {"h": 5.0, "v": 1.0, **({"used": 0.0} if fuel or sag else {})}
    inputs = ph.Experiment(t, {"throttle": throttle}, interpolation="hold")
    true = ph.simulate(_climb(fuel, sag), {"thrust": 21.0, "drag": 0.3}, inputs, initial=start)
    noise = {"h_m": 0.3, "v_m": 0.1, "az": 0.1}
    outputs = {n: y + noise[n] * rng.standard_normal(t.size) for n, y in true.outputs.items()}
    return ph.Experiment(t, {"throttle": throttle}, outputs, interpolation="hold")


@pytest.mark.parametrize(("fuel", "sag", "cause"), [(0.35, 0.0, "v':scale"), (0.0, 0.25, "thrust:")])
def test_what_changes_with_the_integral_of_an_input_is_named(fuel: float, sag: float, cause: str) -> None:
    fit = ph.estimate(_climb(0.0, 0.0), _flight(1, fuel, sag))
    found = ph.diagnose(fit, validation=_flight(2, fuel, sag)).findings
    (finding,) = (f for f in found if f.status == "named")
    assert finding.cause.startswith(cause)
    assert finding.cause.endswith("integral_throttle")
    assert finding.explained > 0.9
