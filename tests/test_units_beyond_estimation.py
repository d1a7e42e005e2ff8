"""Simulation, diagnosis and all that is asked of a fit are the same in any unit."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import phugoid as ph

UNITS = [{"length": 1e-12}, {"length": 1e12}, {"force": 1e-12}, {"force": 1e12}, {"time": 1e-8}, {"time": 1e6}]
N = 300
T = 0.05 * np.arange(N)
PARAMETERS = {"k": 6.3, "c": 0.83, "b": 3.09}


def oscillator() -> ph.Model:
    m = ph.Model("oscillator")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    k, c, b = m.parameters(k=0, c=0, b=0)
    m.dynamics(x=v, v=b * u - k * x - c * v)
    m.outputs(y=x, w=v)
    return m


@cache
def measured(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the input (N,) and the outputs (N, 2) of an oscillator with a cubic spring that its model has not."""
    u = np.sign(np.sin(0.9 * T + seed)) + 0.5 * np.sin(2.2 * T)

    def slope(t: float, z: np.ndarray) -> list[float]:
        return [z[1], 3.0 * np.interp(t, T, u) - 4.0 * z[0] - 0.8 * z[1] - 1.5 * z[0] ** 3]

    path = solve_ivp(slope, (0.0, T[-1]), [0.0, 0.0], t_eval=T, max_step=0.05, rtol=1e-8).y.T
    return u, path + [0.01, 0.03] * np.random.default_rng(seed).standard_normal((N, 2))


def record(seed: int, length: float, force: float, time: float) -> ph.Experiment:
    u, y = measured(seed)
    outputs = {"y": length * y[:, 0], "w": length / time * y[:, 1]}
    return ph.Experiment(time * T, {"u": force * u}, outputs, f"run {seed}")


@cache
def fitted(length: float = 1.0, force: float = 1.0, time: float = 1.0) -> ph.Fit:
    return ph.estimate(oscillator(), [record(seed, length, force, time) for seed in (1, 2)])


def factors(length: float = 1.0, force: float = 1.0, time: float = 1.0) -> dict[str, float]:
    """Return what makes parameters of a unit those of the first."""
    return {"k": time**2, "c": time, "b": time**2 * force / length}


@cache
def reference_diagnosis() -> ph.results.Diagnosis:
    return ph.diagnose(fitted())


@pytest.mark.parametrize("units", UNITS, ids=str)
def test_a_diagnosis_has_the_same_verdict(units: dict[str, float]) -> None:
    found, reference = ph.diagnose(fitted(**units)), reference_diagnosis()
    assert [f.cause for f in reference.findings] == ["v':x^3"]
    assert [(f.cause, f.status) for f in found.findings] == [(f.cause, f.status) for f in reference.findings]
    each = {"length": 1.0, "force": 1.0, "time": 1.0, **units}
    expected = reference.findings[0].coefficient / each["time"] ** 2 / each["length"] ** 2
    assert found.findings[0].coefficient == pytest.approx(expected, rel=1e-6)
    assert found.findings[0].std_error / abs(found.findings[0].coefficient) == pytest.approx(
        reference.findings[0].std_error / abs(reference.findings[0].coefficient), rel=1e-6
    )


@pytest.mark.parametrize("method", ["DOP853", "Radau"])
@pytest.mark.parametrize("units", [*UNITS, {"length": 1e-30}, {"length": 1e30}], ids=str)
def test_a_simulation_of_few_samples_is_as_exact(units: dict[str, float], method: str) -> None:
    def path(length: float = 1.0, force: float = 1.0, time: float = 1.0) -> np.ndarray:
        values = {name: PARAMETERS[name] / factor for name, factor in factors(length, force, time).items()}
        inputs = {"u": force * np.array([0.0, 1.0, 0.0, 2.0, 1.0, 0.0, 0.0])}
        few = ph.Experiment(time * np.linspace(0.0, 60.0, 7), inputs)
        simulated = ph.simulate(oscillator(), values, few, initial={"x": 0.0, "v": 0.0}, method=method)
        return np.array([simulated.outputs["y"] / length, simulated.outputs["w"] * time / length])

    np.testing.assert_allclose(path(**units), path(), atol=1e-7)


@pytest.mark.parametrize("units", UNITS, ids=str)
def test_what_is_asked_of_a_fit(units: dict[str, float]) -> None:
    found, reference, of = fitted(**units), fitted(), factors(**units)
    each = {"length": 1.0, "force": 1.0, "time": 1.0}
    validated = found.validate(record(3, **{**each, **units})), reference.validate(record(3, **each))
    assert validated[0].status == validated[1].status == "converged"
    for name in ("y", "w"):
        assert validated[0].matches[name].r_squared == pytest.approx(validated[1].matches[name].r_squared, rel=1e-7)
    profiles = found.profile("k")["k"], reference.profile("k")["k"]
    assert profiles[0].ends == profiles[1].ends == ("found", "found")
    np.testing.assert_allclose(of["k"] * np.array(profiles[0].interval), profiles[1].interval, rtol=1e-6)
    misfits = ph.misfit(found), ph.misfit(reference)
    assert misfits[0].worst == misfits[1].worst
    for name, channel in misfits[0].channels.items():
        assert channel.structured == misfits[1].channels[name].structured
        assert channel.ratio == pytest.approx(misfits[1].channels[name].ratio, rel=1e-6)


@pytest.mark.parametrize("units", UNITS, ids=str)
def test_regressions_and_linear_fits(units: dict[str, float]) -> None:
    found, reference, of = fitted(**units), fitted(), factors(**units)
    regressed = [ph.equation_error(oscillator(), list(f.experiments)).parameters for f in (found, reference)]
    for name, factor in of.items():
        each, other = (estimates[name] for estimates in regressed)
        assert factor * each.value == pytest.approx(other.value, rel=1e-7)
        assert factor * each.std_error == pytest.approx(other.std_error, rel=1e-7)
    linear = [
        ph.linear.fit_linear(ph.linear.subspace(list(f.experiments), 2), list(f.experiments))
        for f in (found, reference)
    ]
    time = units.get("time", 1.0)
    poles = [
        np.sort_complex(np.linalg.eigvals(system.A)) * scale for system, scale in zip(linear, (time, 1.0), strict=True)
    ]
    np.testing.assert_allclose(poles[0], poles[1], rtol=1e-6)
