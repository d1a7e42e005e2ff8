"""Forces that one coordinate of a mechanism has from the motion of another, and an input whose effect depends on the
position: what a diagnosis names."""

from __future__ import annotations

import numpy as np
import pytest
from rigs import integrated, named

import phugoid as ph
from phugoid.discrepancy.search.admissibility import is_free_motion
from phugoid.discrepancy.search.refit import Refit, refit

_Array = np.ndarray


def _smooth(rng: np.random.Generator, t: _Array, size: float, frequencies: tuple[float, ...]) -> _Array:
    """Return a sum of sines (N,) of random phases."""
    phases = rng.uniform(0.0, 2.0 * np.pi, len(frequencies))
    return size * sum(np.sin(2.0 * np.pi * f * t + p) for f, p in zip(frequencies, phases, strict=True))


def _slide(seed: int, name: str) -> ph.Experiment:
    """A mass on a spring that slides along a turning arm."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 16.0, 0.02)
    force, torque = _smooth(rng, t, 0.5, (0.17, 0.31, 0.6)), _smooth(rng, t, 0.8, (0.11, 0.23, 0.4))

    def f(x: _Array, u: _Array) -> _Array:
        r, v, _, w = x
        return np.array([v, -9.0 * (r - 0.5) - 0.9 * v + r * w**2 + u[0], w, -0.6 * w + u[1]])

    x = integrated(f, np.array([0.5, 0.0, 0.0, 0.0]), t, np.stack([force, torque], axis=1))
    outputs = {
        "r": x[:, 0] + 0.002 * rng.standard_normal(t.size),
        "th": x[:, 2] + 0.004 * rng.standard_normal(t.size),
    }
    return ph.Experiment(t, {"F": force, "M": torque}, outputs, name=name, interpolation="hold")


def test_a_centrifugal_force_is_named() -> None:
    m = ph.Model("slide")
    r, v, th, w = m.states(r=ph.State("m", start=0.5), v="m/s", th="rad", w="rad/s")
    force, torque = m.inputs(F="N", M="N*m")
    k, c, d = m.parameters(k=8.0, c=1.0, d=0.5)
    m.dynamics(r=v, v=-k * (r - 0.5) - c * v + force, th=w, w=-d * w + torque)
    m.outputs(r=r, th=th)
    d = ph.diagnose(ph.estimate(m, _slide(1, "a")), validation=_slide(2, "b"))
    (found,) = named(d)
    assert found.cause == "v':r*w^2"
    assert found.coefficient == pytest.approx(1.0, abs=4.0 * found.std_error)
    assert found.std_error < 0.05
    assert "centrifugal" in found.explanation


def _crane(seed: int, name: str) -> ph.Experiment:
    """A trolley that a swinging load pulls."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.02)
    u = _smooth(rng, t, 0.8, (0.13, 0.29, 0.41))

    def f(x: _Array, u: float) -> _Array:
        _, v, th, w = x
        a = 2.0 * u - 1.2 * v + 0.5 * np.sin(th) * w**2
        return np.array([v, a, w, -9.81 / 1.2 * np.sin(th) - 0.1 * w - a / 1.2 * np.cos(th)])

    x = integrated(f, np.zeros(4), t, u)
    outputs = {
        "x": x[:, 0] + 0.001 * rng.standard_normal(t.size),
        "th": x[:, 2] + 0.002 * rng.standard_normal(t.size),
    }
    return ph.Experiment(t, {"u": u}, outputs, name=name, interpolation="hold")


def test_the_pull_of_a_swinging_load_is_named() -> None:
    m = ph.Model("crane")
    x, v, th, w = m.states(x="m", v="m/s", th="rad", w="rad/s")
    (u,) = m.inputs("u")
    b, c, g, d = m.parameters(b=1.5, c=1.0, g=8.0, d=0.2)
    (a,) = m.quantities(a=b * u - c * v)
    m.dynamics(x=v, v=a, th=w, w=-g * ph.sin(th) - d * w - a * ph.cos(th) / 1.2)
    m.outputs(x=x, th=th)
    found = named(ph.diagnose(ph.estimate(m, _crane(1, "a")), validation=_crane(2, "b")))
    assert found
    first = found[0]
    assert "a:sin(th)*w^2" in (first.cause, *first.aliases)
    if first.cause == "a:sin(th)*w^2":
        assert first.coefficient == pytest.approx(0.5, abs=4.0 * first.std_error)


def _magnet(seed: int, name: str) -> ph.Experiment:
    """A voice coil whose force is less away from the middle."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 3.0, 0.004)
    i = _smooth(rng, t, 1.1, (0.7, 2.3, 5.1))
    x = integrated(
        lambda x, i: np.array([x[1], -900.0 * x[0] - 14.0 * x[1] + 700.0 * (1.0 - 0.08 * x[0] ** 2) * i]),
        np.zeros(2),
        t,
        i,
    )
    return ph.Experiment(
        t, {"i": i}, {"x": x[:, 0] + 0.005 * rng.standard_normal(t.size)}, name=name, interpolation="hold"
    )


def test_a_force_that_falls_with_the_position_is_named() -> None:
    m = ph.Model("coil")
    x, v = m.states(x="mm", v="mm/s")
    (i,) = m.inputs(i="A")
    k, c, b = m.parameters(k=800.0, c=10.0, b=600.0)
    m.dynamics(x=v, v=-k * x - c * v + b * i)
    m.outputs(x=x)
    (found,) = named(ph.diagnose(ph.estimate(m, _magnet(1, "a")), validation=_magnet(2, "b")))
    assert found.cause == "v':x^2*i"
    assert found.coefficient == pytest.approx(-56.0, abs=4.0 * found.std_error)


def _buoyant(seed: int, name: str) -> ph.Experiment:
    """An underwater vehicle whose weight hangs below its centre of buoyancy."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 150.0, 0.5)
    u = 0.25 * np.sign(_smooth(rng, t, 1.0, (0.013, 0.031)))

    def f(x: _Array, u: float) -> _Array:
        q, th, w = x
        return np.array(
            [-0.3 * q + 0.12 * w - 0.04 * np.sin(th) + 0.1 * u, q, -0.45 * w + 0.6 * q - 0.1 * u],
        )

    x = integrated(f, np.zeros(3), t, u)
    outputs = {
        "q": x[:, 0] + 0.002 * rng.standard_normal(t.size),
        "th": x[:, 1] + 0.005 * rng.standard_normal(t.size),
        "w": x[:, 2] + 0.02 * rng.standard_normal(t.size),
    }
    return ph.Experiment(t, {"u": u}, outputs, name=name, interpolation="hold")


def test_a_term_is_told_without_which_the_estimation_has_no_optimum() -> None:
    """See that without the righting moment the damping and the effect of w grow without end, one against the other."""
    m = ph.Model("vehicle")
    q, th, w = m.states(q="rad/s", th="rad", w="m/s")
    (u,) = m.inputs(u="rad")
    a, b, e, z, y, d = m.parameters(a=-0.2, b=0.05, e=0.05, z=-0.3, y=0.5, d=0.0)
    m.dynamics(q=a * q + b * w + e * u, th=q, w=z * w + y * q + d * u)
    m.outputs(q=q, th=th, w=w)
    fit = ph.estimate(m, _buoyant(1, "a"))
    assert not fit.converged
    d = ph.diagnose(fit, validation=_buoyant(2, "b"))
    (found,) = d.findings
    assert d.verdict == found.status == "unexplained"
    assert "With one term more the estimation has an optimum: q':th" in found.advice


def _fan(seed: int, name: str, lost: float = 0.0) -> ph.Experiment:
    """A rig that a fan turns, the thrust of which falls at 11 s."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.05)
    u = _smooth(rng, t, 0.6, (0.11, 0.27, 0.53))
    gain = np.where(t > 11.0, 1.0 - lost, 1.0)
    x = integrated(lambda x, u: np.array([x[1], -7.0 * x[0] - 1.3 * x[1] + 10.0 * u]), np.zeros(2), t, gain * u)
    return ph.Experiment(
        t, {"u": u}, {"th": x[:, 0] + 0.008 * rng.standard_normal(t.size)}, name=name, interpolation="hold"
    )


def test_a_parameter_that_jumps_is_named_with_its_time() -> None:
    m = ph.Model("fan")
    th, w = m.states(th="rad", w="rad/s")
    (u,) = m.inputs("u")
    k, c, b = m.parameters(k=6.0, c=1.0, b=8.0)
    m.dynamics(th=w, w=-k * th - c * w + b * u)
    m.outputs(th=th)
    (found,) = named(ph.diagnose(ph.estimate(m, _fan(1, "a", 0.25)), validation=_fan(2, "b")))
    assert found.cause == "b:step"
    assert found.coefficient == pytest.approx(-2.5, abs=0.2)
    assert found.parameters["time_of_step_b"][0] == pytest.approx(11.0, abs=0.1)


def _joint(seed: int, name: str) -> ph.Experiment:
    """An arm of 0.1 kg m^2, to which its motor and its weight are known."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 12.0, 0.02)
    i = _smooth(rng, t, 0.9, (0.17, 0.41, 0.9))
    x = integrated(lambda x, i: np.array([x[1], (0.8 * i - 0.05 * x[1] - 2.0 * np.sin(x[0])) / 0.1]), np.zeros(2), t, i)
    return ph.Experiment(
        t, {"i": i}, {"th": x[:, 0] + 0.004 * rng.standard_normal(t.size)}, name=name, interpolation="hold"
    )


def test_a_wrong_inertia_is_named() -> None:
    m = ph.Model("joint")
    th, w = m.states(th="rad", w="rad/s")
    (i,) = m.inputs(i="A")
    (c,) = m.parameters(c=0.1)
    m.dynamics(th=w, w=(0.8 * i - c * w - 2.0 * ph.sin(th)) / 0.08)
    m.outputs(th=th)
    (found,) = named(ph.diagnose(ph.estimate(m, _joint(1, "a")), validation=_joint(2, "b")))
    assert found.cause == "w':scale"
    assert found.coefficient == pytest.approx(-0.2, abs=0.005)


def _circles(seed: int, name: str) -> ph.Experiment:
    """An aircraft that turns, whose speed over ground is taken for that in the air, in a wind of 3 m/s."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 100.0, 0.4)
    thrust, bank = _smooth(rng, t, 0.4, (0.021, 0.053)), 0.35 + _smooth(rng, t, 0.08, (0.017, 0.04))
    x = integrated(
        lambda x, u: np.array([u[0] - 0.1 * (x[0] - 22.0), 9.81 * np.tan(u[1]) / x[0]]),
        np.array([22.0, 0.0]),
        t,
        np.stack([thrust, bank], axis=1),
    )
    outputs = {
        "V": x[:, 0] + 3.0 * np.cos(x[:, 1] - 0.7) + 0.15 * rng.standard_normal(t.size),
        "psi": x[:, 1] + 0.01 * rng.standard_normal(t.size),
    }
    return ph.Experiment(t, {"T": thrust, "phi": bank}, outputs, name=name, interpolation="hold")


def test_wind_against_a_heading_is_named() -> None:
    m = ph.Model("turns")
    v, psi = m.states(V=ph.State("m/s", start=22.0), psi="rad")
    thrust, bank = m.inputs(T="m/s²", phi="rad")
    b, c, v0 = m.parameters(b=0.8, c=0.05, V0=20.0)
    m.dynamics(V=b * thrust - c * (v - v0), psi=9.81 * ph.tan(bank) / v)
    m.outputs(V=v, psi=psi)
    (found,) = named(ph.diagnose(ph.estimate(m, _circles(1, "a")), validation=_circles(2, "b")))
    assert found.cause == "V:periodic_psi"
    values = [value for value, _ in found.parameters.values()]
    assert np.hypot(*values[:2]) == pytest.approx(3.0, abs=0.1)
    assert values[2] == pytest.approx(1.0, abs=0.01)


def _rudder(seed: int, name: str) -> ph.Experiment:
    """A ship whose rudder acts more than in proportion, about the angle that balances its propeller."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 120.0, 0.2)
    d = 0.07 + _smooth(rng, t, 0.06, (0.013, 0.031, 0.052))

    def f(x: _Array, u: float) -> _Array:
        return np.array([x[1], -0.2 * x[1] - 0.01 + 0.1 * u + 0.6 * (u - 0.1) * abs(u - 0.1)])

    x = integrated(f, np.zeros(2), t, d)
    outputs = {"r": x[:, 1] + 2e-4 * rng.standard_normal(t.size)}
    return ph.Experiment(t, {"d": d}, outputs, name=name, interpolation="hold")


def test_the_trim_of_a_function_is_estimated() -> None:
    """With the trim a little off, |d| would be named beside it."""
    m = ph.Model("ship")
    (r,) = m.states(r="rad/s")
    (d,) = m.inputs(d="rad")
    a, b, c = m.parameters(a=0.3, b=0.2, c=0.0)
    m.dynamics(r=-a * r + b * d + c)
    m.outputs(r=r)
    diagnosis = ph.diagnose(ph.estimate(m, _rudder(1, "a")), validation=_rudder(2, "b"))
    (found,) = named(diagnosis)
    assert found.cause == "r':d|d|"
    assert found.coefficient == pytest.approx(0.6, abs=4.0 * found.std_error)
    trim = float(found.explanation.partition("(d - ")[2].partition(")")[0])
    assert trim == pytest.approx(0.1, abs=0.0005)


def _reaction(seed: int, name: str) -> ph.Experiment:
    """A stirred tank with a reaction of second order."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 80.0, 0.2)
    feed = 1.8 + _smooth(rng, t, 0.5, (0.011, 0.027, 0.06))
    x = integrated(lambda x, u: np.array([0.5 * (u - x[0]) - 0.7 * x[0] ** 2]), np.array([0.8]), t, feed)
    return ph.Experiment(
        t, {"feed": feed}, {"c": x[:, 0] + 0.002 * rng.standard_normal(t.size)}, name=name, interpolation="hold"
    )


def test_a_square_is_about_zero_where_a_constant_is_needed_beside_it_otherwise() -> None:
    m = ph.Model("tank")
    (c,) = m.states(c=ph.State("mol/L", start=1.0))
    (feed,) = m.inputs(feed="mol/L")
    q, k = m.parameters(q=0.3, k=0.3)
    m.dynamics(c=q * (feed - c) - k * c)
    m.outputs(c=c)
    d = ph.diagnose(ph.estimate(m, _reaction(1, "a")), validation=_reaction(2, "b"))
    (found,) = named(d)
    assert found.cause == "c':c^2"
    assert found.coefficient == pytest.approx(-0.7, abs=4.0 * found.std_error)
    assert "square of c" in found.explanation


def _arm(seed: int, name: str) -> ph.Experiment:
    """An arm on a spring whose inertia is least where it is bent."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.02)
    torque = _smooth(rng, t, 2.0, (0.15, 0.37, 0.61))

    def f(x: _Array, u: float) -> _Array:
        th, w = x
        return np.array([w, (u - 0.8 * w - 3.0 * th) * (1.0 + 0.5 * th**2)])

    x = integrated(f, np.zeros(2), t, torque)
    outputs = {
        "th": x[:, 0] + 0.003 * rng.standard_normal(t.size),
        "w": x[:, 1] + 0.01 * rng.standard_normal(t.size),
    }
    return ph.Experiment(t, {"M": torque}, outputs, name=name, interpolation="hold")


def test_an_inertia_that_depends_on_the_position_is_named() -> None:
    m = ph.Model("arm")
    th, w = m.states(th="rad", w="rad/s")
    (torque,) = m.inputs(M="N*m")
    b, d, k = m.parameters(b=0.5, d=1.0, k=2.0)
    m.dynamics(th=w, w=b * torque - d * w - k * th)
    m.outputs(th=th, w=w)
    d = ph.diagnose(ph.estimate(m, _arm(1, "a")), validation=_arm(2, "b"))
    (found,) = named(d)
    assert found.cause == "w':scale*th^2"
    assert found.coefficient == pytest.approx(0.5, abs=4.0 * found.std_error)
    assert found.explained > 0.95


def _satellite(seed: int, name: str) -> ph.Experiment:
    """A satellite that wheels turn in pitch, in the gradient of gravity."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, 0.1)
    u = _smooth(rng, t, 0.09, (0.013, 0.031, 0.07))
    x = integrated(
        lambda x, u: np.array([x[1], 1.2 * u - 0.09 * x[1] - 0.05 * np.sin(2.0 * x[0])]), np.array([0.3, 0.0]), t, u
    )
    outputs = {
        "th": x[:, 0] + 0.004 * rng.standard_normal(t.size),
        "w": x[:, 1] + 0.002 * rng.standard_normal(t.size),
    }
    return ph.Experiment(t, {"u": u}, outputs, name=name, interpolation="hold")


def test_the_sine_of_twice_an_angle_is_named() -> None:
    m = ph.Model("satellite")
    th, w = m.states(th="rad", w="rad/s")
    (u,) = m.inputs(u="N*m")
    b, d = m.parameters(b=1.0, d=0.05)
    m.dynamics(th=w, w=b * u - d * w)
    m.outputs(th=th, w=w)
    first, second = _satellite(1, "a"), _satellite(2, "b")
    assert min(float(np.ptp(e.outputs["th"])) for e in (first, second)) > 1.5
    (found,) = named(ph.diagnose(ph.estimate(m, first), validation=second))
    assert found.cause == "w':sin(2*th)"
    assert found.coefficient == pytest.approx(-0.05, abs=4.0 * found.std_error)
    assert found.explained > 0.95


def _with_panel(seed: int, name: str) -> ph.Experiment:
    """A satellite with a panel that swings, and does so when a record begins."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 160.0, 0.25)
    u = 20.0 * np.sign(_smooth(rng, t, 1.0, (0.011, 0.027, 0.05)))

    def f(x: _Array, u: float) -> _Array:
        _, w, e, rate = x
        spring = -0.01 * rate - 1.1**2 * e
        turn = (0.02 * u - 0.15 * spring) / 0.85
        return np.array([w, turn, rate, spring - turn])

    x = integrated(f, np.array([0.0, 0.0, 0.25, 0.0]), t, u)
    outputs = {
        "th": x[:, 0] + 0.1 * rng.standard_normal(t.size),
        "w": x[:, 1] + 0.02 * rng.standard_normal(t.size),
    }
    return ph.Experiment(t, {"u": u}, outputs, name=name, interpolation="hold")


def test_the_free_motion_of_a_mode_is_no_other_cause() -> None:
    m = ph.Model("satellite with a panel")
    th, w = m.states(th="mrad", w="mrad/s")
    (u,) = m.inputs(u="mN*m")
    (b,) = m.parameters(b=0.03)
    m.dynamics(th=w, w=b * u)
    m.outputs(th=th, w=w)
    fit = ph.estimate(m, _with_panel(1, "a"))
    d = ph.diagnose(fit, validation=_with_panel(2, "b"))
    (found,) = named(d)
    assert found.cause == "w':mode"
    frequency = 1.1 / np.sqrt(0.85)
    assert found.parameters["frequency_w_dot_mode"][0] == pytest.approx(frequency, rel=0.01)
    listed = [c for c in ph.candidates(m) if c.name in ("w':mode", "w':periodic")]
    mode, wave = sorted(listed, key=lambda c: c.name)
    free = dict(zip(wave.parameters, (0.01, 0.01, 1.1 * frequency), strict=True))
    held = [*free]
    for factor, expected in ((1.1, True), (1.5, False), (0.7, False)):
        free[held[-1]] = factor * frequency
        start = {**{n: e[0] for n, e in found.parameters.items()}, **free}
        both = refit(fit, [mode, wave], start, fit, Refit((), fit).linear.points, held=held)
        assert both is not None
        assert is_free_motion(both, wave) is expected
    assert not is_free_motion(both, mode)


def _hover(seed: int, name: str) -> ph.Experiment:
    """A rotorcraft that follows steps of a height near the ground, where its thrust is larger."""

    def motion(x: _Array, u: float) -> _Array:
        h, w, thrust = x
        return np.array([w, thrust * (1.0 + 0.35 * np.exp(-h / 0.3)) - 9.81 - 0.4 * w, (u - thrust) / 0.08])

    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 16.0, 0.02)
    x = np.array([1.0, 0.0, 9.81])
    rows, inputs, wanted = [], [], 1.0
    for k in range(t.size):
        if k % 80 == 0:
            wanted = rng.uniform(0.25, 1.6)
        u = 9.81 + float(np.clip(4.0 * (wanted - x[0]) - 3.0 * x[1], -4.0, 4.0)) + 0.1 * rng.standard_normal()
        rows.append(x)
        inputs.append(u)
        x = integrated(motion, x, np.array([0.0, 0.02]), np.array([u, u]))[-1]
    y = np.array(rows)[:, :2] + np.array([0.006, 0.02]) * rng.standard_normal((t.size, 2))
    return ph.Experiment(t, {"u": np.array(inputs)}, {"h": y[:, 0], "w": y[:, 1]}, name=name, interpolation="hold")


def test_a_thrust_that_is_larger_near_the_ground_is_named() -> None:
    m = ph.Model("hover")
    h, w, thrust = m.states(h="m", w="m/s", T="N/kg")
    (u,) = m.inputs(u="N/kg")
    k, d, tau = m.parameters(k=1.0, d=0.3, tau=0.1)
    m.dynamics(h=w, w=thrust - 9.81 - d * w, T=(k * u - thrust) / tau)
    m.outputs(h=h, w=w)
    (found,) = named(ph.diagnose(ph.estimate(m, _hover(1, "a")), validation=_hover(2, "b")))
    assert found.cause == "w':T*exp(-h)"
    assert found.explained > 0.95
    assert found.coefficient == pytest.approx(0.35, abs=3.0 * found.std_error)
    distance, error = found.parameters["distance_w_dot_T_h"]
    assert distance == pytest.approx(0.3, abs=3.0 * error)
