"""Linearised models, and their frequency responses with standard errors and delays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, lfilter, lsim

import phugoid as ph
from phugoid.linear.linearise import linearise, model_response

HZ = np.linspace(0.05, 3.0, 20)


def late_lag() -> ph.Model:
    m = ph.Model("late lag")
    (x,) = m.states(x="m")
    u, w = m.inputs(u="N", w="N")
    a, b, tau, lag = m.parameters(a=2.0, b=3.0, tau=0.1, lag=0.05)
    m.dynamics(x=b * m.delay(u, tau) - a * x + 0.2 * u + w)
    m.outputs(x=x, ax=(b * u, "m/s²"))
    m.sensor_delay(x=lag)
    return m


VALUES = {"a": 2.0, "b": 3.0, "tau": 0.1, "lag": 0.05}


def test_delays_turn_the_phase() -> None:
    s = 2j * np.pi * HZ
    found = model_response(late_lag(), HZ, "u", "x", parameters=VALUES)
    np.testing.assert_allclose(found.response, (3 * np.exp(-0.1 * s) + 0.2) / (s + 2) * np.exp(-0.05 * s), rtol=1e-12)
    assert (found.unit, found.label) == ("m/N", "late lag")
    # An input that nothing delays.
    found = model_response(late_lag(), HZ, "w", "x", parameters=VALUES)
    np.testing.assert_allclose(found.response, 1 / (s + 2) * np.exp(-0.05 * s), rtol=1e-12)
    with pytest.raises(ph.ModelError, match="delays, which no finite state space holds"):
        linearise(late_lag(), VALUES)


def test_a_model_is_linearised_exactly_through_its_quantities() -> None:
    m = ph.Model("drag")
    V, x = m.states("V x")
    (T,) = m.inputs("T")
    (k,) = m.parameters("k")
    (D,) = m.quantities(D=k * V**2)
    m.dynamics(V=T - D, x=V)
    m.outputs(x=x, D=D * T)
    found = linearise(m, {"k": 0.5}, at={"V": 4.0, "T": 8.0})
    np.testing.assert_allclose(found.A, [[-4.0, 0.0], [1.0, 0.0]])
    np.testing.assert_allclose(found.B, [[1.0], [0.0]])
    np.testing.assert_allclose(found.C, [[0.0, 1.0], [32.0, 0.0]])
    np.testing.assert_allclose(found.D, [[0.0], [8.0]])
    with pytest.raises(ph.ModelError, match="depend on V, T; say where"):
        linearise(m, {"k": 0.5})


@pytest.fixture(scope="module")
def data() -> ph.Experiment:
    random = np.random.default_rng(0)
    t = 0.05 * np.arange(600)
    u = lfilter(*butter(2, 0.5), random.normal(size=(2, t.size)))
    A, B, C = [[-0.4, 5.0], [-5.0, -0.4]], [[1.0, 0.3], [0.0, 0.5]], [[1.0, 0.2]]
    _, y, _ = lsim((A, B, C, [[0.1, 0.0]]), u.T, t)
    return ph.Experiment(t, {"u1": u[0], "u2": u[1]}, {"y": y + 0.02 * random.normal(size=t.size)})


def test_the_standard_error_is_that_of_the_delta_method_whatever_is_redundant(data: ph.Experiment) -> None:
    start = ph.linear.subspace(data, 2)
    fit = ph.estimate(ph.models.modal(start=start), data)
    found = model_response(fit, HZ, "u2")
    names = [n for n in fit.parameters if n not in fit.noise_parameters]
    values = {n: fit.parameters[n].value for n in names}
    free = [n for n in names if not fit.parameters[n].fixed]

    def magnitude(change: dict[str, float]) -> np.ndarray:
        return model_response(fit.model, HZ, "u2", parameters={**values, **change}).magnitude

    J = np.array([(magnitude({n: values[n] + 1e-5}) - magnitude({n: values[n] - 1e-5})) / 2e-5 for n in free]).T
    at = [names.index(n) for n in free]
    expected = np.sqrt(np.diag(J @ fit.covariance[np.ix_(at, at)] @ J.T))
    np.testing.assert_allclose(found.std_error, expected, rtol=1e-4)
    for model in (ph.models.modal(start=start, scale="free"), ph.models.state_space(start=start, structure="full")):
        other = ph.estimate(model, data)
        assert other.status == "unidentifiable"
        redundant = model_response(other, HZ, "u2")
        np.testing.assert_allclose(redundant.magnitude, found.magnitude, rtol=1e-4)
        np.testing.assert_allclose(redundant.std_error, found.std_error, rtol=5e-3)


def test_a_delay_that_is_estimated_has_its_part_in_the_error() -> None:
    """A gain that depends on the delay through the sum of a prompt and a late path."""
    m = ph.Model("two paths")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, tau = m.parameters(a=1.0, tau=ph.Parameter(0.3, bounds=(0, 1)))
    m.dynamics(x=u + m.delay(u, tau) - a * x)
    m.outputs(x=x)
    t = 0.05 * np.arange(400)
    signal = np.sin(2 * t) + np.sin(5.3 * t)
    late = np.interp(t - 0.4, t, signal)
    _, z, _ = lsim(([[-1.5]], [[1.0]], [[1.0]], [[0.0]]), signal + late, t)
    z = z + 0.01 * np.random.default_rng(0).normal(size=t.size)
    fit = ph.estimate(m, ph.Experiment(t, {"u": signal}, {"x": z}))
    values = {n: fit.parameters[n].value for n in ("a", "tau")}
    found = model_response(fit, HZ)

    def magnitude(change: dict[str, float]) -> np.ndarray:
        return model_response(m, HZ, parameters={**values, **change}).magnitude

    J = np.array([(magnitude({n: v + 1e-5}) - magnitude({n: v - 1e-5})) / 2e-5 for n, v in values.items()]).T
    np.testing.assert_allclose(found.std_error, np.sqrt(np.diag(J @ fit.covariance[:2, :2] @ J.T)), rtol=1e-3)


def test_what_cannot_be_right_is_refused() -> None:
    integrator = ph.linear.StateSpace([[0.0]], [[1.0]], [[1.0]])
    m = late_lag()
    cases: list[tuple[type[Exception], str, Any]] = [
        (ph.ModelError, "is infinite", lambda: integrator.frequency_response([0.0, 1.0])),
        (ph.ModelError, "there are several inputs: say which", lambda: model_response(m, HZ, parameters=VALUES)),
        (ph.ModelError, "'v' is not an input", lambda: model_response(m, HZ, "v", "x", parameters=VALUES)),
        (ph.DataError, "increasing", lambda: model_response(m, HZ[::-1], "u", "x", parameters=VALUES)),
        (ph.ModelError, "a Fit or a Model", lambda: model_response(3, HZ)),  # type: ignore[arg-type]
    ]
    for kind, message, call in cases:
        with pytest.raises(kind) as error:
            call()
        assert message in str(error.value), str(error.value)


def test_one_name_asks_records_fits_models_and_numbers_alike(data: ph.Experiment) -> None:
    start = ph.linear.subspace(data, 2)
    fit = ph.estimate(ph.models.modal(start=start), data)
    found = ph.linear.frequency_response(fit, HZ, "u2", "y")
    np.testing.assert_array_equal(found.response, model_response(fit, HZ, "u2", "y").response)
    assert found.std_error is not None
    values = {n: fit.parameters[n].value for n in fit.model.parameter_names}
    at_values = ph.linear.frequency_response(fit.model, HZ, input="u2", parameters=values)
    np.testing.assert_array_equal(at_values.response, found.response)
    np.testing.assert_array_equal(
        ph.linear.frequency_response(start, HZ, "u2").response, start.frequency_response(HZ, "u2").response
    )
    seen = ph.linear.frequency_response(data, "u2", "y", "h1", segment=100)
    assert seen.coherence is not None and seen.label == "H1, segments of 100 samples"
    for wrong in ([data], "run1.csv"):
        with pytest.raises(ph.DataError, match="one Experiment, a Fit, a Model or a StateSpace, not a"):
            ph.linear.frequency_response(wrong, "u2", "y")  # type: ignore[call-overload]
