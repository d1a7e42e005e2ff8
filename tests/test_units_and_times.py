"""Estimates, standard errors, status and iterations are the same in any unit, and wherever time begins."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

import phugoid as ph

N, STEP = 120, 0.05
T = STEP * np.arange(N)
U = np.sign(np.sin(0.9 * T)) + 0.3 * np.sin(2.2 * T)
SYSTEM = np.array([[0.0, 1.0], [-4.0, -0.8]]), np.array([[0.0], [3.0]]), np.eye(2), np.zeros((2, 1))
RANDOM = np.random.default_rng(1)
MEASURED = lsim(SYSTEM, U[:, None], T)[1] + [0.02, 0.05] * RANDOM.standard_normal((N, 2))
# The same oscillator in turbulence: a force that no input tells of.
TURBULENT = lsim(SYSTEM, U[:, None] + RANDOM.standard_normal((N, 1)), T)[1]
TURBULENT += [0.02, 0.2] * RANDOM.standard_normal((N, 2))


def fit(
    length: float = 1.0,
    force: float = 1.0,
    time: float = 1.0,
    begin: float = 0.0,
    speed: bool = True,
    measured: np.ndarray = MEASURED,
    **options: Any,
) -> ph.Fit:
    """Return the fit of an oscillator in units that are so many times smaller; its speed may be unmeasured."""
    m = ph.Model("oscillator")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    # Without a measured speed no regression leads from zero, so these starts are scaled as the truth is.
    first = (0.0, 0.0, 0.0) if speed else (1.0 / time**2, 0.1 / time, length / force / time**2)
    k, c, b = m.parameters(**dict(zip("kcb", first, strict=True)))
    m.dynamics(x=v, v=b * u - k * x - c * v)
    m.outputs(**({"y": x, "w": v} if speed else {"y": x}))
    outputs = {"y": length * measured[:, 0], "w": length / time * measured[:, 1]}
    record = ph.Experiment(time * (T + begin), {"u": force * U}, {n: outputs[n] for n in m.output_names})
    return ph.estimate(m, record, **options)


def in_common_units(found: ph.Fit, length: float, force: float, time: float) -> np.ndarray:
    """Return values and standard errors, shape (2, n), in the units of the first fit."""
    factors = {"k": time**2, "c": time, "b": time**2 * force / length, "sigma_y": 1 / length, "sigma_w": time / length}
    factors["q_v"] = time**1.5 / length
    each = [(factors.get(e.name, 1.0), e) for e in found.parameters.values()]
    return np.array([[factor * e.value, factor * e.std_error] for factor, e in each]).T


REFERENCE = {speed: fit(speed=speed) for speed in (True, False)}
EXPONENT = st.floats(-30.0, 30.0)


@pytest.mark.parametrize("speed", [True, False])
@settings(max_examples=25, deadline=None, derandomize=True)
@given(length=EXPONENT, force=EXPONENT, time=st.floats(-10.0, 10.0))
def test_units_change_nothing(speed: bool, length: float, force: float, time: float) -> None:
    units = (10.0**length, 10.0**force, 10.0**time)
    found, reference = fit(*units, speed=speed), REFERENCE[speed]
    assert (found.status, found.iterations) == ("converged", reference.iterations)
    expected = in_common_units(reference, 1.0, 1.0, 1.0)
    np.testing.assert_allclose(in_common_units(found, *units), expected, rtol=1e-9)
    assert not found.warnings
    assert not any(e.bounds_active for e in found.parameters.values())


@pytest.mark.parametrize("unit", [1e-30, 1e30])
@pytest.mark.parametrize("which", ["length", "force", "time"])
@pytest.mark.parametrize("speed", [True, False])
def test_a_single_unit_at_its_extremes(which: str, unit: float, speed: bool) -> None:
    units = {"length": 1.0, "force": 1.0, "time": 1.0, which: unit}
    found = fit(**units, speed=speed)
    assert (found.status, found.iterations) == ("converged", REFERENCE[speed].iterations)
    expected = in_common_units(REFERENCE[speed], 1.0, 1.0, 1.0)
    np.testing.assert_allclose(in_common_units(found, **units), expected, rtol=1e-9)


@pytest.mark.parametrize(
    "options",
    [
        {"transcription": ph.MultipleShooting(segments=10)},
        {"transcription": ph.SingleShooting()},
        {"noise": ph.StudentT()},
        {"noise": ph.Huber()},
        {"noise": ph.Gaussian(correlated=True)},
    ],
    ids=["multiple shooting", "single shooting", "Student", "Huber", "correlated"],
)
def test_other_formulations_and_noise(options: dict[str, Any]) -> None:
    reference = fit(**options)
    for units in (
        {"length": 1e-30},
        {"length": 1e30},
        {"force": 1e-30},
        {"force": 1e30},
        {"time": 1e-8},
        {"time": 1e8},
    ):
        found = fit(**units, **options)
        assert (found.status, found.iterations) == ("converged", reference.iterations)
        expected = in_common_units(reference, 1.0, 1.0, 1.0)
        each = {"length": 1.0, "force": 1.0, "time": 1.0, **units}
        np.testing.assert_allclose(in_common_units(found, **each), expected, rtol=1e-9)


FILTERS = {
    "initial states estimated": ph.FilterError("v"),
    "flat prior": ph.FilterError("v", initial={"x": None, "v": None}),
    "from output error": ph.FilterError("v", output_error=True),
}


@pytest.mark.parametrize("which", FILTERS)
@settings(max_examples=8, deadline=None, derandomize=True)
@given(length=EXPONENT, force=EXPONENT, time=st.floats(-10.0, 10.0))
def test_process_noise_in_any_unit(which: str, length: float, force: float, time: float) -> None:
    options = {"transcription": FILTERS[which], "measured": TURBULENT}
    units = (10.0**length, 10.0**force, 10.0**time)
    found, reference = fit(*units, **options), fit(**options)
    assert found.status == reference.status == "converged"
    assert found.warnings == reference.warnings == ()
    assert "q_v" in found.parameters
    assert found.iterations == reference.iterations
    each, expected = in_common_units(found, *units), in_common_units(reference, 1.0, 1.0, 1.0)
    np.testing.assert_allclose(each, expected, rtol=1e-8)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(length=EXPONENT, force=EXPONENT, time=st.floats(-10.0, 10.0))
def test_ipopt_in_any_unit(length: float, force: float, time: float) -> None:
    pytest.importorskip("cyipopt")
    units = (10.0**length, 10.0**force, 10.0**time)
    found = fit(*units, solver=ph.Ipopt())
    assert found.status == "converged"
    expected = in_common_units(REFERENCE[True], 1.0, 1.0, 1.0)
    np.testing.assert_allclose(in_common_units(found, *units), expected, rtol=1e-6)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(begin=st.floats(-1e5, 1e5))
def test_it_does_not_matter_when_a_record_begins(begin: float) -> None:
    found = fit(begin=begin)
    assert (found.status, found.iterations) == ("converged", REFERENCE[True].iterations)
    # Sample times of 1e5 s are rounded by 1e-11 s.
    np.testing.assert_allclose(
        in_common_units(found, 1.0, 1.0, 1.0), in_common_units(REFERENCE[True], 1.0, 1.0, 1.0), rtol=1e-7
    )
