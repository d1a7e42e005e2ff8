"""Stall: lift that is lost by flow that separates, with a lag (Kirchhoff's theory)."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import phugoid as ph

STEP, V = 0.04, 35.0
LIFT, BREAK, WIDTH, LATE = 4.9, 0.27, 0.04, 0.25


def model() -> ph.Model:
    """Lift that is linear in the angle of attack."""
    m = ph.Model("short period")
    (alpha, q), (de,) = m.states(alpha="rad", q="rad/s"), m.inputs(de="rad")
    CL0, CLa, CLde, M0, Ma, Mq, Mde = m.parameters("CL0 CLa CLde M0 Ma Mq Mde")
    (CL,) = m.quantities(CL=CL0 + CLa * alpha + CLde * de)
    m.dynamics(alpha=9.81 / V + q - 0.3 * CL, q=M0 + Ma * alpha + Mq * q + Mde * de)
    m.outputs(alpha=alpha, q=q, az=(-10.0 * CL, "m/s²"))
    return m


def lift(x: np.ndarray, de: float) -> float:
    attached = ((1.0 + np.sqrt(np.clip(x[2], 0.0, 1.0))) / 2.0) ** 2
    return float(0.28 + LIFT * x[0] * attached + 0.45 * de)


def record(seed: int) -> ph.Experiment:
    """Two slow pulls into the stall, and pulses of the elevator."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 32.0, STEP)
    pulls = np.interp(t, [5.0, 12.0, 13.0, 18.0, 24.0, 24.6], [0.0, -0.11, 0.0, 0.0, -0.13, 0.0])
    de = -0.02 + pulls + 0.03 * np.sign(np.sin((1.1 + 0.1 * seed) * t)) * (t < 30.0)
    x, path = np.array([0.13, 0.0, 1.0]), np.empty((t.size, 3))

    def slope(x: np.ndarray, u: float) -> np.ndarray:
        steady = 0.5 * (1.0 - np.tanh((x[0] - BREAK) / WIDTH))
        moment = 0.65 - 5.0 * x[0] - 2.5 * x[1] - 9.0 * u
        return np.array([9.81 / V + x[1] - 0.3 * lift(x, u), moment, (steady - x[2]) / LATE])

    for i in range(t.size):
        path[i] = x
        ends = de[i], de[min(i + 1, t.size - 1)]
        for k in range(8):
            u = ends[0] + (ends[1] - ends[0]) * (k + 0.5) / 8.0
            middle = x + 0.5 * STEP / 8.0 * slope(x, u)
            x = x + STEP / 8.0 * slope(middle, u)
    az = [-10.0 * lift(x, u) for x, u in zip(path, de, strict=True)]
    noise = {"alpha": 0.003, "q": 0.005, "az": 0.15}
    clean = dict(zip(noise, (path[:, 0], path[:, 1], np.array(az)), strict=True))
    y = {n: z + noise[n] * rng.standard_normal(t.size) for n, z in clean.items()}
    return ph.Experiment(t, {"de": de}, y, name=f"record {seed}")


@functools.cache
def fitted() -> ph.Fit:
    return ph.estimate(model(), record(1))


def test_stall_is_offered_where_the_angle_of_attack_acts() -> None:
    names = ph.candidates(model()).names
    assert "CL:stall" in names and "q':stall" in names
    assert not any(n.endswith(":stall") for n in ph.candidates(ph.models.servo()).names)


def test_the_signal_is_what_the_extended_model_adds() -> None:
    """A path with the true values: the lift that is lost is the coefficient times the signal."""
    c = ph.candidates(model())["CL:stall"]
    coefficient, (angle, width, late) = c.coefficients[0], c.shape_names
    true = {coefficient: -LIFT, angle: BREAK, width: WIDTH, late: LATE}
    known = {"CL0": 0.28, "CLa": LIFT, "CLde": 0.45, "M0": 0.65, "Ma": -5.0, "Mq": -2.5, "Mde": -9.0}
    run = record(1)
    path = ph.simulate(c.extended(model(), true), known | true, run, initial={"alpha": 0.13, "q": 0.0})
    for name, noise in (("alpha", 0.003), ("q", 0.005), ("az", 0.15)):
        assert np.std(run.outputs[name] - path.outputs[name]) == pytest.approx(noise, rel=0.15), name


def test_stall_is_named_with_its_angle_and_lag() -> None:
    d = ph.diagnose(fitted(), validation=record(2))
    (f,) = [f for f in d.findings if f.status == "named"]
    assert f.cause == "CL:stall", d.summary()
    for name, true in zip(f.parameters, (-LIFT, BREAK, WIDTH, LATE), strict=True):
        value, error = f.parameters[name]
        assert abs(value - true) < 4.0 * error < 0.5 * abs(true), name
    assert f.explained > 0.95
