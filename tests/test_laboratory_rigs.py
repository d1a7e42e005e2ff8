"""Laboratory rigs whose models lack what such rigs have: orifices, gauges with a curved scale, motors with cogging.

The records are integrated here, in steps much shorter than the samples, with laws of their own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from rigs import integrated, named, steps

import phugoid as ph
from phugoid.sensitivities import shown_by_outputs

_Array = np.ndarray


def tank(seed: int, name: str, gauge: float = 0.0) -> ph.Experiment:
    rng, t = np.random.default_rng(seed), np.arange(0.0, 1500.0, 2.5)
    u = steps(rng, t, 0.1, 1.0, 110.0)
    (h,) = integrated(lambda x, u: 0.03 * u - 0.0125 * np.sqrt(np.maximum(x, 0.0)), np.array([1.0]), t, u).T
    read = h + gauge * h**2 + 0.01 * rng.standard_normal(t.size)
    return ph.Experiment(t, {"u": u}, {"h": read}, name=name, interpolation="hold")


def tank_model(outlet: Callable[[ph.Expr], ph.Expr]) -> ph.Model:
    m = ph.Model("tank")
    (h,) = m.states(h="m")
    (u,) = m.inputs(u="1")
    k, c = m.parameters(k=0.02, c=0.01)
    m.dynamics(h=k * u - c * outlet(h))
    m.outputs(h=h)
    return m


def test_flow_through_an_orifice_is_named() -> None:
    d = ph.diagnose(ph.estimate(tank_model(lambda h: h), tank(1, "one")), validation=tank(2, "other"))
    (found,) = named(d)
    assert found.cause == "h':sqrt(h)", d.summary()
    extended = d.extend()
    assert extended.fit.parameters[next(iter(found.parameters))].value == pytest.approx(-0.0125, rel=0.02)
    assert extended.fit.parameters["c"].value == pytest.approx(0.0, abs=2e-4)
    assert extended.gain.held_out_rms_after["h"] < 0.011


def test_a_gauge_that_is_not_straight_is_named() -> None:
    level = tank_model(lambda h: ph.sqrt(ph.smooth_max(h, 0.001, 0.001)))
    d = ph.diagnose(ph.estimate(level, tank(3, "one", 0.05)), validation=tank(4, "other", 0.05))
    (found,) = named(d)
    assert "h:h^2" in (found.cause, *found.aliases), d.summary()
    nothing = ph.diagnose(ph.estimate(level, tank(3, "one")), validation=tank(4, "other"))
    assert nothing.verdict == "nothing", nothing.summary()


def axis(seed: int, name: str, cogging: float) -> ph.Experiment:
    """A linear axis whose current follows a plan, by an encoder: the motor's poles are 12 mm apart."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 3.0, 0.004)
    u = np.convolve(steps(rng, t, -1.0, 1.0, 0.15), np.full(10, 0.1), "same")

    def f(x: _Array, u: float) -> _Array:
        return np.array([x[1], 900.0 * u - 6.0 * x[1] + cogging * np.sin(2.0 * np.pi * x[0] / 12.0)])

    x = integrated(f, np.zeros(2), t, u)[:, 0]
    return ph.Experiment(t, {"u": u}, {"x": np.round(x / 0.01) * 0.01}, name=name, interpolation="hold")


def axis_model() -> ph.Model:
    m = ph.Model("axis")
    x, v = m.states(x="mm", v="mm/s")
    (u,) = m.inputs(u="A")
    k, b = m.parameters(k=500.0, b=2.0)
    m.dynamics(x=v, v=k * u - b * v)
    m.outputs(x=x)
    return m


def test_cogging_of_a_motor_is_named_with_its_pitch() -> None:
    d = ph.diagnose(ph.estimate(axis_model(), axis(5, "one", 150.0)), validation=axis(6, "other", 150.0))
    (found,) = named(d)
    assert found.cause == "v':periodic_x", d.summary()
    wave_number = next(value for n, (value, _) in found.parameters.items() if n.startswith("wave_number"))
    assert 2.0 * np.pi / wave_number == pytest.approx(12.0, rel=0.01)


def shaker_model() -> ph.Model:
    """Its accelerometer is written out, as who reads the sensors' equations from left to right does."""
    m = ph.Model("shaker")
    x, v = m.states(x="m", v="m/s")
    (force,) = m.inputs(force="N")
    k, c, b = m.parameters(k=150.0, c=3.0, b=0.04)
    m.dynamics(x=v, v=b * force - c * v - k * x)
    m.outputs(x=x, a=(-k * x - c * v + b * force, "m/s²"))
    return m


def shaker(seed: int, name: str) -> ph.Experiment:
    """A mass on a spring that hardens."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 8.0, 0.01)
    force = 60.0 * np.convolve(steps(rng, t, -1.0, 1.0, 0.25), np.full(20, 0.05), "same")

    def rate(x: _Array, u: float) -> _Array:
        return np.array([x[1], 0.05 * u - 4.0 * x[1] - 200.0 * x[0] - 1.2e5 * x[0] ** 3])

    path = integrated(rate, np.zeros(2), t, force)
    a = np.array([rate(p, u)[1] for p, u in zip(path, force, strict=True)])
    outputs = {"x": path[:, 0] + 2e-4 * rng.standard_normal(t.size), "a": a + 0.1 * rng.standard_normal(t.size)}
    return ph.Experiment(t, {"force": force}, outputs, name=name, interpolation="hold")


def test_a_force_that_is_missing_is_missing_in_the_accelerometer_too() -> None:
    m = shaker_model()
    assert shown_by_outputs(m._right_hand_sides(), m.parameter_names) == {"v": {"a": pytest.approx(1.0)}}
    d = ph.diagnose(ph.estimate(m, shaker(7, "one")), validation=shaker(8, "other"))
    (found,) = named(d)
    assert found.cause == "v':x^3", d.summary()
    assert found.coefficient == pytest.approx(-1.2e5, rel=0.03)
    after = d.extend().gain.held_out_rms_after
    assert after["x"] < 2.2e-4 and after["a"] < 0.11


def drive(seed: int, name: str) -> ph.Experiment:
    """A motor whose driver limits the current."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 8.0, 0.01)
    u = steps(rng, t, -8.0, 8.0, 0.5)

    def rate(w: _Array, u: float) -> _Array:
        return 60.0 * np.clip(u - 0.1 * w, -5.0, 5.0)

    (w,) = integrated(rate, np.zeros(1), t, u).T
    return ph.Experiment(t, {"u": u}, {"w": w + 0.3 * rng.standard_normal(t.size)}, name=name, interpolation="hold")


def test_a_limited_torque_is_named() -> None:
    m = ph.Model("drive")
    (w,) = m.states(w="rad/s")
    (u,) = m.inputs(u="V")
    a, b = m.parameters(a=3.0, b=30.0)
    m.dynamics(w=b * u - a * w)
    m.outputs(w=w)
    d = ph.diagnose(ph.estimate(m, drive(9, "one")), validation=drive(10, "other"))
    (found,) = named(d)
    assert found.cause == "w':saturation", d.summary()
    assert found.coefficient == pytest.approx(300.0, rel=0.02)


def test_a_wrong_sign_is_named_with_its_reason() -> None:
    m = shaker_model()
    one, other = (shaker(seed, "record") for seed in (11, 12))
    turned = [
        ph.Experiment(
            e.t,
            {"force": e.input("force")},
            {"x": e.output("x"), "a": -e.output("a")},
            name=name,
            interpolation="hold",
        )
        for e, name in ((one, "one"), (other, "other"))
    ]
    spring = ph.candidates(m)["v':x^3"].extended(m)
    d = ph.diagnose(ph.estimate(spring, turned[0]), validation=turned[1])
    (found,) = named(d)
    assert found.cause == "a:scale" and "wrong sign" in found.explanation, d.summary()
    assert found.coefficient == pytest.approx(-2.0, abs=0.01)


def positioning(seed: int, name: str) -> ph.Experiment:
    """A linear axis in a position loop, by a fine encoder: a screw with dry friction, and a cable that pulls."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.01)
    goal = 0.24 * rng.random(12)
    path = np.interp(t, np.linspace(0.0, t[-1], 36), np.repeat(goal, 3))
    h, q, v, before = 0.0005, 0.0, 0.0, 0.0
    positions, volts = np.zeros(t.size), np.zeros(t.size)
    for k in range(t.size):
        positions[k] = np.round(q / 5e-6) * 5e-6
        u = float(np.clip(20.0 * (15.0 * (path[k] - positions[k]) - (positions[k] - before) / 0.01), -10.0, 10.0))
        before, volts[k] = positions[k], u
        for _ in range(20):
            free = v + h * (0.37 * u - 2.1 * v + 0.033)
            after = free - np.clip(free, -0.2 * h, 0.2 * h)  # friction of 0.2 m/s^2, which holds what it can
            q, v = q + h * (v + after) / 2.0, after
    return ph.Experiment(t, {"u": volts}, {"q": positions}, name=name, interpolation="hold")


def test_friction_and_a_constant_force_are_named_in_a_position_loop() -> None:
    """What is left beside them is motion that sticks: error of the model, by whose likelihood as noise nothing can be
    judged."""
    m = ph.Model("axis")
    q, v = m.states(q="m", v="m/s")
    (u,) = m.inputs(u="V")
    gain, damping = m.parameters(gain=0.3, damping=1.0)
    m.dynamics(q=v, v=gain * u - damping * v)
    m.outputs(q=q)
    library = ph.candidates(m).only("v':sign(v)", "v':bias", "v':|v|", "v':v*u", "q:v")
    d = ph.diagnose(ph.estimate(m, positioning(21, "one")), candidates=library, validation=positioning(22, "other"))
    found = {f.cause: f for f in named(d)}
    assert set(found) == {"v':sign(v)", "v':bias"}, d.summary()
    assert found["v':sign(v)"].coefficient == pytest.approx(-0.2, rel=0.05)
    assert found["v':bias"].coefficient == pytest.approx(0.033, rel=0.1)


def cascade(seed: int, name: str) -> ph.Experiment:
    """Two tanks, one above the other, of which the gauge of the lower one ends at its brim."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 2400.0, 4.0)
    u = steps(rng, t, 1.0, 5.0, 130.0)

    def f(x: _Array, u: float) -> _Array:
        upper, lower = np.sqrt(np.maximum(x, 0.0))
        return np.array([0.055 * u - 0.06 * upper, (0.055 * upper - 0.05 * lower) * (x[1] < 10.0 or upper < lower)])

    h = integrated(f, np.array([6.0, 8.0]), t, u)[:, 1]
    return ph.Experiment(
        t, {"u": u}, {"h": np.minimum(h, 10.0) + 0.01 * rng.standard_normal(t.size)}, name=name, interpolation="hold"
    )


def test_a_tank_that_is_full_is_named_where_one_scale_is_free() -> None:
    """Of the scale of the upper tank, which is not measured, and the three coefficients only one is not determined."""
    m = ph.Model("cascade")
    upper, lower = m.states(upper=ph.State("m", start=6.0), lower=ph.State("m", start=8.0))
    (u,) = m.inputs(u="V")
    k1, k2, k3, k4 = m.parameters(k1=0.05, k2=0.05, k3=0.05, k4=0.05)
    m.dynamics(upper=k4 * u - k1 * ph.sqrt(upper), lower=k2 * ph.sqrt(upper) - k3 * ph.sqrt(lower))
    m.outputs(h=lower)
    fit = ph.estimate(m, cascade(23, "one"))
    assert fit.status == "unidentifiable"
    d = ph.diagnose(fit, validation=cascade(24, "other"))
    assert any("with k1 fixed" in note for note in d.notes), d.notes
    found = named(d)[0]
    assert {"lower:limit", "h:clipped"} & {found.cause, *found.aliases}, d.summary()


def test_a_sensor_without_a_sign_is_named() -> None:
    """A pulse counter behind a drive that turns either way: a model of the speed follows its record nowhere."""

    def drive(seed: int, name: str, drag: float = 0.0) -> ph.Experiment:
        rng, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.04)
        u = steps(rng, t, -1.0, 1.0, 0.6)
        (w,) = integrated(lambda x, u: 30.0 * u - 2.0 * x - drag * x * np.abs(x), np.zeros(1), t, u).T
        read = np.abs(w) + 0.02 * rng.standard_normal(t.size)
        return ph.Experiment(t, {"u": u}, {"w": read}, name=name, interpolation="hold")

    m = ph.Model("drive")
    (w,) = m.states(w="rad/s")
    (u,) = m.inputs(u="V")
    gain, damping = m.parameters(gain=20.0, damping=1.0)
    m.dynamics(w=gain * u - damping * w)
    m.outputs(w=w)
    library = ph.candidates(m).only("w':w|w|", "w':w^3", "w:scale", "w':sign(w)")
    for drag, also in ((0.0, []), (0.2, ["w':w|w|"])):
        fit = ph.estimate(m, drive(31, "one", drag))
        d = ph.diagnose(fit, candidates=library, validation=drive(32, "other", drag))
        assert [f.cause for f in named(d)] == ["w:unsigned", *also], d.summary()
        assert d.extend().fit.parameters["gain"].value == pytest.approx(30.0, rel=0.01)
    plain = drive(33, "with its sign")
    w_signed = ph.simulate(m, {"gain": 30.0, "damping": 2.0}, plain.with_outputs({}), initial={"w": 0.0}).outputs["w"]
    level = ph.estimate(m, plain.with_outputs({"w": np.maximum(w_signed, 0.0)}))
    assert not any(f.cause == "w:unsigned" for f in ph.diagnose(level, candidates=library).findings)


def test_play_before_a_load_encoder_is_named() -> None:
    """A motor with a tachometer moves a load through a gear with play of 0.04 rad."""
    gear = 0.02

    def record(seed: int, name: str) -> ph.Experiment:
        rng, t = np.random.default_rng(seed), np.arange(0.0, 10.0, 0.01)
        u = steps(rng, t, -1.0, 1.0, 0.4)
        angle, rate = integrated(lambda x, u: np.array([x[1], 6.0 * u - 4.0 * x[1]]), np.zeros(2), t, u, finer=8).T
        load, now = np.zeros(t.size), 0.0
        for k, at in enumerate(angle):
            now = min(max(now, at - gear), at + gear)
            load[k] = now
        outputs = {"w": rate + 0.02 * rng.standard_normal(t.size), "load": np.round(load / 0.001) * 0.001}
        return ph.Experiment(t, {"u": u}, outputs, name=name, interpolation="hold")

    m = ph.Model("geared motor")
    angle, w = m.states(angle="rad", w="rad/s")
    (u,) = m.inputs(u="V")
    gain, damping = m.parameters(gain=4.0, damping=3.0)
    m.dynamics(angle=w, w=gain * u - damping * w)
    m.outputs(w=w, load=(angle, "rad"))
    library = ph.candidates(m).only("load:*", "w:delay", "w':lag_*", "u:*", "w':sign(w)")
    d = ph.diagnose(ph.estimate(m, record(41, "one")), candidates=library, validation=record(42, "other"))
    assert [f.cause for f in named(d)] == ["load:backlash"], d.summary()
    assert named(d)[0].coefficient == pytest.approx(gear, rel=0.05)


def _coil(seed: int, name: str) -> ph.Experiment:
    """A coil that an inverter feeds, the dead time of which takes a voltage against the current."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 8.0, 0.01)
    u = steps(rng, t, -6.0, 6.0, 0.4)
    i = integrated(lambda x, u: (u - 2.0 * x - 0.7 * np.tanh(x / 0.02)) / 0.3, np.zeros(1), t, u)[:, 0]
    return ph.Experiment(t, {"u": u}, {"i": i + 0.02 * rng.standard_normal(t.size)}, name=name, interpolation="hold")


def test_a_voltage_against_the_current_is_named() -> None:
    m = ph.Model("coil")
    (i,) = m.states(i="A")
    (u,) = m.inputs(u="V")
    resistance, inductance = m.parameters(R=1.0, L=0.5)
    m.dynamics(i=(u - resistance * i) / inductance)
    m.outputs(i=i)
    (found,) = named(ph.diagnose(ph.estimate(m, _coil(1, "a")), validation=_coil(2, "b")))
    assert found.cause == "i':sign(i)"
    assert found.coefficient == pytest.approx(-0.7 / 0.3, rel=0.03)
    assert found.explained > 0.9
