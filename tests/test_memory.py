"""A diagnosis of systems with hysteresis, stops, overflows, modes and friction that is larger at rest.

They are integrated here by Runge and Kutta's rule, with kinks as they are.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import phugoid as ph

Array = NDArray[np.float64]
STEPS = 20


def mass() -> ph.Model:
    m = ph.Model("mass")
    (u,), (x, v) = m.inputs("u"), m.states(x="m", v="m/s")
    k, c = m.parameters("k c")
    m.dynamics(x=v, v=u - k * x - c * v)
    m.outputs(x=x, v=v)
    return m


def tanks() -> ph.Model:
    m = ph.Model("tanks")
    (u,) = m.inputs("u")
    level = ph.State("m", start=2.0, bounds=(0.01, 50.0))
    h1, h2 = m.states(h1=level, h2=level)
    k1, k2, k3 = m.parameters(k1=0.3, k2=0.3, k3=0.3)
    m.dynamics(h1=-k1 * ph.sqrt(h1) + k3 * u, h2=k1 * ph.sqrt(h1) - k2 * ph.sqrt(h2))
    m.outputs(h1=h1, h2=h2)
    return m


def hysteresis(x: Array, u: float) -> list[float]:
    v, z = x[1], x[2]
    return [v, u - 4.0 * x[0] - 0.5 * v - 0.8 * z, (v - 0.5 * (abs(v) * z + v * abs(z))) / 0.12]


def stop(x: Array, u: float) -> list[float]:
    return [x[1], u - 4.0 * x[0] - 0.5 * x[1] - 40.0 * max(x[0] - 0.9, 0.0)]


def mode(x: Array, u: float) -> list[float]:
    it = u - 4.0 * x[0] - 0.5 * x[1]
    return [x[1], it + 0.3 * x[2], x[3], 64.0 * (it - x[2]) - 2.0 * 0.04 * 8.0 * x[3]]


def stribeck(x: Array, u: float) -> list[float]:
    v = x[1]
    return [v, u - 4.0 * x[0] - 0.5 * v - np.tanh(v / 0.01) * (0.2 + 0.4 * np.exp(-((v / 0.3) ** 2)))]


def overflow(x: Array, u: float) -> list[float]:
    rate = -0.5 * np.sqrt(max(x[0], 0.0)) + 0.4 * u
    full = x[0] >= 3.6 and rate > 0.0
    return [0.0 if full else rate, 0.5 * np.sqrt(max(x[0], 0.0)) - 0.55 * np.sqrt(max(x[1], 0.0))]


def integrated(f: Callable[[Array, float], list[float]], first: list[float], t: Array, u: Array) -> Array:
    x, out = np.array(first), [np.array(first)]
    for k in range(t.size - 1):
        h = (t[k + 1] - t[k]) / STEPS
        for j in range(STEPS):
            a, b, c = (u[k] + (u[k + 1] - u[k]) * (j + part) / STEPS for part in (0.0, 0.5, 1.0))
            k1 = np.array(f(x, a))
            k2 = np.array(f(x + 0.5 * h * k1, b))
            k3 = np.array(f(x + 0.5 * h * k2, b))
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + np.array(f(x + h * k3, c)))
        out.append(x.copy())
    return np.array(out)


def records(f: Callable[[Array, float], list[float]], states: int, seed: int) -> list[ph.Experiment]:
    rng, found = np.random.default_rng(seed), []
    for number in range(2):
        slow = f is overflow
        t = np.arange(0.0, 400.0, 1.0) if slow else np.arange(0.0, 40.0, 0.05)
        low, high, size = (0.002, 0.02, 1.2) if slow else (0.05, 1.2, 3.0)
        frequencies, phases = rng.uniform(low, high, 8), rng.uniform(0.0, 2.0 * np.pi, 8)
        u = size / 2.0 * sum(np.sin(2.0 * np.pi * w * t + p) for w, p in zip(frequencies, phases, strict=True))
        u = np.clip(2.0 + u, 0.3, None) if slow else u
        z = integrated(f, [2.0, 1.6] if slow else [0.0] * states, t, u)
        names, sizes = (("h1", "h2"), (0.02, 0.02)) if slow else (("x", "v"), (0.005, 0.01))
        y = {n: z[:, i] + s * rng.standard_normal(t.size) for i, (n, s) in enumerate(zip(names, sizes, strict=True))}
        found.append(ph.Experiment(t, {"u": u}, y, name=f"record {number}"))
    return found


@pytest.mark.parametrize(
    ("f", "states", "seed", "cause", "truth"),
    [
        (hysteresis, 3, 11, "v':hysteresis_x", {"v_dot_hysteresis_x": (-0.8, 0.03), "yield_v_dot_x": (0.12, 0.01)}),
        (stop, 2, 12, "x:limit", {"stop_of_x": (40.0, 2.0), "limit_of_x": (0.9, 0.01)}),
        (
            mode,
            4,
            13,
            "v':mode",
            {"v_dot_mode": (0.3, 0.01), "frequency_v_dot_mode": (8.0, 0.05), "damping_v_dot_mode": (0.04, 0.003)},
        ),
        (overflow, 2, 14, "h1:limit", {"limit_of_h1": (3.6, 0.1)}),
    ],
)
def test_what_remembers_or_limits_is_named_with_its_size(
    f: Callable[[Array, float], list[float]],
    states: int,
    seed: int,
    cause: str,
    truth: dict[str, tuple[float, float]],
) -> None:
    first, second = records(f, states, seed)
    d = ph.diagnose(ph.estimate(tanks() if f is overflow else mass(), first), validation=second)
    named = [x for x in d.findings if x.status == "named"]
    assert [x.cause for x in named] == [cause], d.summary()
    assert named[0].explained > 0.9
    for name, (value, most) in truth.items():
        assert abs(named[0].parameters[name][0] - value) < most, d.summary()


def test_friction_that_is_larger_at_rest_is_no_plain_friction() -> None:
    first, second = records(stribeck, 2, 15)
    d = ph.diagnose(ph.estimate(mass(), first), validation=second)
    named = {x.cause for x in d.findings if x.status == "named"}
    assert "v':stribeck_v" in named and named <= {"v':stribeck_v", "v':sign(v)"}, d.summary()
    extended = d.extend(minor=True).gain
    assert all(extended.held_out_rms_after[n] < 0.6 * extended.held_out_rms_before[n] for n in ("x", "v"))


def test_a_limit_is_offered_for_stores_and_positions_only() -> None:
    names = set(ph.candidates(mass()).names)
    assert {"x:limit", "v':hysteresis_x", "v':stribeck_v", "v':mode"} <= names
    assert not {"v:limit", "v':hysteresis_v", "v':stribeck_x"} & names
    assert {"h1:limit", "h2:limit"} <= set(ph.candidates(tanks()).names)
    # An angle that turns freely, as its sine says, has no stop; one of which no sine is taken may.
    for torque, stops in ((ph.sin, False), (lambda angle: angle, True)):
        m = ph.Model("attitude")
        a, q = m.states(a="rad", q="rad/s")
        k, c = m.parameters("k c")
        m.dynamics(a=q, q=-k * torque(a) - c * q)
        m.outputs(a=a)
        assert ("a:limit" in ph.candidates(m).names) == stops
