"""Oscillations of which one state is measured: from a start at rest, output injection leads to those of the data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rigs import integrated

import phugoid as ph

_Array = np.ndarray

# Goodwin's oscillator with saturated degradation.
TRUTH = {
    "v": 3.0, "k": 0.5, "h": 8.0, "vx": 1.8, "kx": 0.6, "ky": 1.1, "vy": 0.9, "ky2": 0.4, "kz": 0.8, "vz": 0.7,
    "kz2": 0.3, "x0": 0.3, "y0": 1.0, "z0": 0.6, "s": 0.03,
}  # fmt: skip


def test_an_oscillation_is_found_from_a_start_at_rest() -> None:
    m = ph.Model("Goodwin")
    x, y, z = m.states("x", "y", "z")
    bounds = {n: (1.0, 12.0) if n == "h" else (1e-4, 1e4) for n in TRUTH}
    declared = {n: ph.Parameter(v, bounds=bounds[n], transform="log") for n, v in TRUTH.items()}
    declared["h"] = ph.Parameter(TRUTH["h"], bounds=bounds["h"])
    p = dict(zip(TRUTH, m.parameters(**declared), strict=True))
    production = p["v"] * p["k"] ** p["h"] / (p["k"] ** p["h"] + z ** p["h"])
    m.dynamics(
        x=production - p["vx"] * x / (p["kx"] + x),
        y=p["ky"] * x - p["vy"] * y / (p["ky2"] + y),
        z=p["kz"] * y - p["vz"] * z / (p["kz2"] + z),
    )
    m.initial(x=p["x0"], y=p["y0"], z=p["z0"])
    m.outputs(x=x)
    m.noise(ph.Gaussian({"x": p["s"]}))
    t = np.linspace(0.0, 40.0, 101)
    exact = np.asarray(ph.simulate(m, TRUTH, ph.Experiment(t, {}, name="run")).outputs["x"])
    measured = exact + TRUTH["s"] * np.random.default_rng(0).standard_normal(t.size)
    rng = np.random.default_rng(1)
    start = {
        n: float(np.clip(v * 10 ** rng.uniform(-0.7, 0.7), *bounds[n])) if n != "h" else 4.0 for n, v in TRUTH.items()
    }
    fit = ph.estimate(m, ph.Experiment(t, {}, {"x": measured}, name="run"), start=start)
    # The optimum next to the truth is at 313; all restarts without injection end below 45, at rest or damped.
    assert fit.log_likelihood > 300.0
    assert fit.parameters["s"].value < 2 * TRUTH["s"]


Case = tuple[ph.Model, ph.Experiment, dict[str, float]]


def pendulum() -> Case:
    """An undamped pendulum over 20 swings of which the angle is measured, with noise of a quarter of its amplitude."""
    m = ph.Model("pendulum")
    angle, rate = m.states("angle", "rate")
    f, offset = m.parameters(f=1.0, offset=0.0)
    m.dynamics(angle=rate, rate=-((2.0 * np.pi * f) ** 2) * ph.sin(angle))
    m.outputs(angle=angle + offset)
    t = np.linspace(0.0, 40.0, 401)
    truth = {"f": 0.5, "offset": 0.1}
    return m, measured(m, truth, {"angle": 0.8, "rate": 0.0}, t, {"angle": 0.2}), truth


def rossler() -> Case:
    """A chaotic system of which one state is measured."""
    m = ph.Model("Rössler")
    x, y, z = m.states("x", "y", "z")
    a, b, c = m.parameters(a=0.0, b=0.0, c=0.0)
    m.dynamics(x=-y - z, y=x + a * y, z=b + z * (x - c))
    m.outputs(x=x, y=y)
    t = np.linspace(0.0, 60.0, 601)
    truth = {"a": 0.2, "b": 0.2, "c": 5.7}
    return m, measured(m, truth, {"x": 1.0, "y": -5.0, "z": 0.02}, t, {"x": 0.5, "y": 0.5}), truth


def measured(
    m: ph.Model, truth: dict[str, float], initial: dict[str, float], t: np.ndarray, sigma: dict[str, float]
) -> ph.Experiment:
    clean = ph.simulate(m, truth, ph.Experiment(t, {}, name="run"), initial=initial).outputs
    rng = np.random.default_rng(3)
    outputs = {n: np.asarray(clean[n]) + s * rng.standard_normal(t.size) for n, s in sigma.items()}
    return ph.Experiment(t, {}, outputs, name="run")


@pytest.mark.parametrize(("make", "share"), [(pendulum, 8), (rossler, 6)])
def test_dense_records_of_oscillations_are_fitted_from_wild_starts(make: Callable[[], Case], share: int) -> None:
    """Starts a decade about the truth, from most of which the iterations end at an optimum with another period.

    Without output injection one start of eight reaches the optimum of Rössler's system.
    """
    m, run, truth = make()
    best = ph.estimate(m, run, start=truth).log_likelihood
    rng = np.random.default_rng(4)
    reached, led = 0, 0
    for _ in range(8):
        fit = ph.estimate(m, run, start={n: v * 10 ** rng.uniform(-1.0, 1.0) for n, v in truth.items()})
        reached += fit.converged and fit.log_likelihood > best - 0.01
        led += "output injection" in fit.message
    assert reached >= share
    assert led >= 4


def test_noise_about_a_constant_is_not_a_motion_to_look_for() -> None:
    """One output is noise alone, the other is matched: no way but the first is taken."""
    m = ph.Model("lag")
    (x,), (u,) = m.states("x"), m.inputs("u")
    tau, level = m.parameters(tau=0.5, level=1.0)
    m.dynamics(x=(u - x) / tau)
    m.outputs(x=x, y=level)
    t = np.linspace(0.0, 20.0, 201)
    run = ph.Experiment(t, {"u": np.sign(np.sin(t))}, name="run")
    clean = ph.simulate(m, {"tau": 1.0, "level": 2.0}, run, initial={"x": 0.0}).outputs
    rng = np.random.default_rng(0)
    outputs = {n: np.asarray(clean[n]) + 0.1 * rng.standard_normal(t.size) for n in ("x", "y")}
    fit = ph.estimate(m, run.with_outputs(outputs))
    assert fit.converged and fit.iterations < 20


# A rotary pendulum that a controller balances: masses in kg, lengths in m, inertias in kg m², resistance in ohm.
_BOB, _ARM, _ROD, _INERTIA, _GRAVITY, _OHM = 0.024, 0.085, 0.0645, 1.33e-4, 9.81, 8.4
_PENDULUM = {"kt": 0.0378, "b_arm": 3e-4, "b_rod": 2e-5, "J": 2.3e-4}
# The torque constant, friction of arm and rod, and inertia: from a fortieth of the true values to thirty times.
_FAR = (
    (0.063, 0.0015, 3.7e-6, 2e-4),
    (0.02, 0.001, 1.9e-5, 0.0022),
    (0.8, 0.0011, 1.5e-5, 3.4e-4),
    (0.0021, 2.1e-5, 4e-6, 0.0062),
)


def _accelerations(
    state: Any, v: Any, kt: Any, b_arm: Any, b_rod: Any, j: Any, sin: Callable[[Any], Any], cos: Callable[[Any], Any]
) -> tuple[Any, Any]:
    """Return those of the arm and of the rod, which stands upright at zero."""
    _, up, w, a = state
    s, c = sin(up), cos(up)
    on_arm = kt * (v - kt * w) / _OHM - b_arm * w - 2.0 * _BOB * _ROD**2 * s * c * w * a + _BOB * _ARM * _ROD * s * a**2
    on_rod = _BOB * _ROD**2 * s * c * w**2 + _BOB * _GRAVITY * _ROD * s - b_rod * a
    m11, m12 = j + _BOB * _ROD**2 * s**2, _BOB * _ARM * _ROD * c
    det = m11 * _INERTIA - m12**2
    return (_INERTIA * on_arm - m12 * on_rod) / det, (m11 * on_rod - m12 * on_arm) / det


def _balanced(seed: int) -> tuple[_Array, _Array, _Array]:
    """Return 8 s at 100 Hz of encoders with 2,048 counts, from which the controller has its speeds, too."""
    rng = np.random.default_rng(seed)
    dt, count = 0.01, 2.0 * np.pi / 2048
    gains = np.array([-2.75, -30.05, -1.25, -2.58])

    def f(x: _Array, v: float) -> _Array:
        return np.array([x[2], x[3], *_accelerations(x, v, *_PENDULUM.values(), np.sin, np.cos)])

    x, speeds, aim = np.array([0.0, 0.02, 0.0, 0.0]), np.zeros(2), 0.0
    before: _Array | None = None
    rows: list[_Array] = []
    volts: list[float] = []
    for k in range(800):
        aim = 0.35 * rng.choice([-1.0, 1.0]) if k % 150 == 0 else aim
        seen = np.round(x[:2] / count) * count
        if before is not None:
            speeds = speeds + 0.4 * ((seen - before) / dt - speeds)
        before = seen
        v = float(np.clip(gains @ np.array([aim - seen[0], -seen[1], -speeds[0], -speeds[1]]), -10.0, 10.0))
        rows.append(seen)
        volts.append(v)
        x = integrated(f, x, np.array([0.0, dt]), np.array([v, v]), finer=5)[-1]
    seen = np.array(rows)
    return np.arange(800) * dt, np.array(volts), seen


def test_a_pendulum_that_a_controller_balances_is_found_from_far() -> None:
    """Speeds are not measured, the motion is unstable, and the controller acts on what encoders show.

    With output injection into the positions alone none of these starts reached the optimum.
    """
    t, volts, seen = _balanced(3)
    m = ph.Model("rotary pendulum")
    arm, up, w, a = m.states(arm="rad", up="rad", w="rad/s", a="rad/s")
    (v,) = m.inputs(v="V")
    p = m.parameters(**_PENDULUM)
    of_arm, of_rod = _accelerations((arm, up, w, a), v, *p, ph.sin, ph.cos)
    m.dynamics(arm=w, up=a, w=of_arm, a=of_rod)
    m.outputs(arm=arm, up=up)
    run = ph.Experiment(t, {"v": volts}, {"arm": seen[:, 0], "up": seen[:, 1]}, name="balanced", interpolation="hold")
    best = ph.estimate(m, run, start=_PENDULUM)
    assert best.converged
    reached = []
    for start in _FAR:
        fit = ph.estimate(m, run, start=dict(zip(_PENDULUM, start, strict=True)))
        reached.append(fit.converged and fit.log_likelihood > best.log_likelihood - 0.1)
    assert all(reached)
