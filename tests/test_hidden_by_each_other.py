"""Causes that hide behind each other, behind the beginning of a record, or behind a state that is not measured."""

from __future__ import annotations

import numpy as np
import pytest
from rigs import integrated, named, steps

import phugoid as ph

_Array = np.ndarray


def _oven(seed: int) -> ph.Experiment:
    """An oven that radiates, with a thermocouple that is late."""
    rng, t = np.random.default_rng(seed), 0.1 * np.arange(700)
    power = steps(rng, t, 0.0, 6.0, 4.0)

    def heat(x: _Array, u: float) -> _Array:
        return np.array([0.8 * u - 0.3 * x[0] - 0.0003 * ((x[0] + 3.0) ** 4 - 81.0), (x[0] - x[1]) / 0.6])

    x = integrated(heat, np.zeros(2), t, power)
    y = x[:, 1] + 0.02 * rng.standard_normal(t.size)
    return ph.Experiment(t, {"P": power}, {"T": y}, name=f"run {seed}", interpolation="hold")


def test_two_causes_are_named_together_where_none_is_confirmed_alone() -> None:
    m = ph.Model("oven")
    (temperature,) = m.states(T="hK")
    (power,) = m.inputs(P="W")
    b, h = m.parameters(b=0.6, h=0.4)
    m.dynamics(T=b * power - h * temperature)
    m.outputs(T=temperature)
    found = named(ph.diagnose(ph.estimate(m, _oven(1)), validation=_oven(2)))
    assert len(found) == 2
    lag = next(f for f in found if "T:lag" in (f.cause, *f.alternatives))
    radiation = next(f for f in found if f is not lag)
    assert "T':T^3" in (radiation.cause, *radiation.alternatives)
    assert lag.explained > 0.05 and radiation.explained > 0.9


def _turn(seed: int) -> ph.Experiment:
    """A heading that is steered through a slow actuator, from the middle of a manoeuvre on."""
    rng, t = np.random.default_rng(seed), 0.02 * np.arange(1100)
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    u = sum(0.2 * np.sin(2.0 * np.pi * f * t + p) for f, p in zip((0.11, 0.29, 0.53, 0.9), phases, strict=True))

    def motion(x: _Array, u: float) -> _Array:
        r, z = x
        return np.array([-2.0 * r + 5.0 * z, (u - z) / 0.3])

    x = integrated(motion, np.zeros(2), t, u)[100:]
    y = x[:, 0] + 0.004 * rng.standard_normal(len(x))
    return ph.Experiment(t[:1000], {"u": u[100:]}, {"r": y}, name=f"run {seed}", interpolation="hold")


def test_a_lag_may_be_in_motion_when_the_record_begins() -> None:
    m = ph.Model("turn")
    (r,) = m.states(r="rad/s")
    (u,) = m.inputs(u="rad")
    a, b = m.parameters(a=1.5, b=4.0)
    m.dynamics(r=b * u - a * r)
    m.outputs(r=r)
    data = _turn(1)
    d = ph.diagnose(ph.estimate(m, data), validation=_turn(2))
    (found,) = named(d)
    assert found.cause == "u:lag"
    # With a steady start the likeliest time constant is another one, and the fit is worse.
    tau, error = found.parameters["lag_u"]
    assert tau == pytest.approx(0.3, abs=3.0 * error)
    (record,) = d.extend().fit.records
    begun = record.mesh_states["u_lag"][0] - data.inputs["u"][0]
    assert abs(begun) > 0.02


def _pitch(seed: int) -> ph.Experiment:
    """An aircraft with a speed along z that is not measured, and an accelerometer ahead of the centre of gravity."""
    rng, t = np.random.default_rng(seed), 0.02 * np.arange(900)
    de = steps(rng, t, -0.1, 0.1, 0.7)

    def turning(x: _Array, u: float) -> float:
        return float(-0.4 * x[0] - 3.0 * x[1] - 20.0 * u)

    def motion(x: _Array, u: float) -> _Array:
        return np.array([-2.0 * x[0] + 25.0 * x[1] - 5.0 * u, turning(x, u)])

    x = integrated(motion, np.zeros(2), t, de)
    az = -2.0 * x[:, 0] - 5.0 * de - 0.5 * np.array([turning(s, u) for s, u in zip(x, de, strict=True)])
    outputs = {"q": x[:, 1] + 0.003 * rng.standard_normal(t.size), "az": az + 0.05 * rng.standard_normal(t.size)}
    return ph.Experiment(t, {"de": de}, outputs, name=f"run {seed}", interpolation="hold")


def test_a_lever_arm_is_told_though_an_unmeasured_state_hides_it() -> None:
    m = ph.Model("pitch")
    w, q = m.states(w="m/s", q="rad/s")
    (de,) = m.inputs(de="rad")
    zw, zd, mw, mq, md = m.parameters(Zw=-1.5, Zd=-6.0, Mw=-0.3, Mq=-4.0, Md=-15.0)
    m.dynamics(w=zw * w + 25.0 * q + zd * de, q=mw * w + mq * q + md * de)
    m.outputs(q=q, az=(zw * w + zd * de, "m/s²"))
    found = named(ph.diagnose(ph.estimate(m, _pitch(1)), validation=_pitch(2)))
    assert found
    assert any("az:q'" in (f.cause, *f.alternatives) for f in found)


def test_a_path_may_go_a_little_beyond_where_a_distance_begins() -> None:
    rng, t = np.random.default_rng(0), 0.005 * np.arange(1500)
    i = steps(rng, t, 0.5, 3.0, 0.4)

    def motion(x: _Array, u: float) -> _Array:
        return np.array([x[1], -300.0 * x[0] - 20.0 * x[1] + u * (200.0 + 900.0 * np.exp(-x[0] / 1.5))])

    x = integrated(motion, np.array([0.3, 0.0]), t, i)
    runs = [
        ph.Experiment(
            t[:750], {"i": i[k : k + 750]}, {"x": x[k : k + 750, 0] + 0.01 * rng.standard_normal(750)}, name=f"run {k}"
        )
        for k in (0, 750)
    ]
    m = ph.Model("solenoid")
    pos, v = m.states(x="mm", v="mm/s")
    (current,) = m.inputs(i="A")
    k, c, gain = m.parameters(k=250.0, c=15.0, K=400.0)
    m.dynamics(x=v, v=gain * current - k * pos - c * v)
    m.outputs(x=pos)
    (found,) = named(ph.diagnose(ph.estimate(m, runs[0]), validation=runs[1]))
    assert "v':i*exp(-x)" in (found.cause, *found.alternatives)
    assert found.explained > 0.95
