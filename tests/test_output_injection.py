"""Oscillations of which one state is measured: from a start at rest, output injection leads to those of the data."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import phugoid as ph

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
