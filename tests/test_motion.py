"""Meshes that follow the motion where samples are few: stiff and fast systems from their initial values."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph


def fitted(m: ph.Model, truth: dict[str, float], t: list[float], sigma: float, start: dict[str, float]) -> ph.Fit:
    blank = ph.Experiment(t, outputs={n: np.zeros(len(t)) for n in m.output_names})
    clean = ph.simulate(m, truth, blank)
    random = np.random.default_rng(3)
    e = ph.Experiment(t, outputs={n: y + sigma * random.standard_normal(len(t)) for n, y in clean.outputs.items()})
    fit = ph.estimate(m, e, noise=ph.Gaussian(dict.fromkeys(m.output_names, sigma)), start=start)
    # The path of the fit is that of an integration with its parameters.
    again = ph.simulate(m, fit, e)
    for name, y in again.outputs.items():
        assert np.abs(y - fit.records[0].outputs[name]).max() < 0.05 * sigma
    return fit


def test_a_fast_transient_between_few_samples() -> None:
    m = ph.Model("fast")
    x, y = m.states("x", "y")
    a, b = m.parameters(a=ph.Parameter(1.0, transform="log"), b=ph.Parameter(1.0, transform="log"))
    m.dynamics(x=-a * (x**2 - y), y=-b * y)
    m.initial(x=3, y=1)
    m.outputs(x=x)
    truth = {"a": 10.0, "b": 0.2}
    fit = fitted(m, truth, [0.0, 0.02, 0.05, 0.5, 1.0, 2.0, 4.0, 6.0, 10.0], 0.01, {"a": 0.3, "b": 0.5})
    assert fit.converged
    for name, value in truth.items():
        assert abs(fit.parameters[name].value - value) < 4.0 * fit.parameters[name].std_error
    assert not isinstance(fit.transcription.segments, int) and fit.transcription.segments is not None
    again = ph.estimate(m, fit.experiments[0], noise=fit.noise, start=fit)
    assert again.log_likelihood == pytest.approx(fit.log_likelihood, abs=0.01)


@pytest.mark.parametrize("order", [2, 3, 6])
def test_other_orders_are_as_exact(order: int) -> None:
    m = ph.Model("prey")
    x, y = m.states("x", "y")
    a, b = m.parameters(a=ph.Parameter(0.5, transform="log"), b=ph.Parameter(0.05, transform="log"))
    m.dynamics(x=a * x - b * x * y, y=0.02 * x * y - 0.8 * y)
    m.initial(x=30, y=4)
    m.outputs(x=x)
    t = np.linspace(0.0, 15.0, 16)
    clean = ph.simulate(m, {"a": 0.6, "b": 0.03}, ph.Experiment(t, outputs={"x": t}))
    e = ph.Experiment(t, outputs={"x": clean.outputs["x"] + np.random.default_rng(0).standard_normal(t.size)})
    noise = ph.Gaussian({"x": 1.0})
    exact = ph.estimate(
        m, e, noise=noise, transcription=ph.Collocation(order=4, substeps=16), start={"a": 0.6, "b": 0.03}
    )
    fit = ph.estimate(m, e, noise=noise, transcription=ph.Collocation(order=order))
    assert fit.converged
    for name in ("a", "b"):
        off = fit.parameters[name].value - exact.parameters[name].value
        assert abs(off) < 0.05 * exact.parameters[name].std_error


def test_stiff_kinetics_over_eight_decades_of_time() -> None:
    m = ph.Model("Robertson")
    x, y, z = m.states("x", "y", "z")
    k = {"k1": 0.04, "k2": 3e7, "k3": 1e4}
    k1, k2, k3 = m.parameters(**{n: ph.Parameter(v, transform="log") for n, v in k.items()})
    m.dynamics(x=-k1 * x + k3 * y * z, y=k1 * x - k3 * y * z - k2 * y**2, z=k2 * y**2)
    m.initial(x=1, y=0, z=0)
    m.outputs(x=x, y=1e4 * y)
    t = [1e-4, 1e-2, 1.0, 10.0, 100.0, 1e3, 1e4]
    fit = fitted(m, k, t, 0.005, {"k1": 0.1, "k2": 1e7, "k3": 3e4})
    for name, value in k.items():
        assert fit.parameters[name].value == pytest.approx(value, rel=0.2)


def test_starts_from_initial_values_that_divide() -> None:
    m = ph.Model("share")
    x, y = m.states("x", "y")
    (k,) = m.parameters(k=ph.Parameter(0.1, bounds=(1e-3, 10.0), transform="log"))
    m.dynamics(x=-k * x, y=k * x)
    m.initial(x=100, y=1)
    m.outputs(share=x / (x + y))
    fit = fitted(m, {"k": 0.5}, [0.0, 1.0, 2.0, 4.0, 8.0], 0.01, {})
    assert fit.converged
    assert abs(fit.parameters["k"].value - 0.5) < 4.0 * fit.parameters["k"].std_error


def test_a_mesh_that_the_user_gave_is_kept() -> None:
    m = ph.Model("lag")
    (x,) = m.states("x")
    (k,) = m.parameters(k=1.0)
    m.dynamics(x=-k * x)
    m.initial(x=1)
    m.outputs(x=x)
    e = ph.Experiment([0.0, 1.0, 2.0], outputs={"x": [1.0, 0.5, 0.3]})
    fit = ph.estimate(m, e, noise=ph.Gaussian({"x": 0.05}), transcription=ph.Collocation(segments=7))
    assert fit.records[0].mesh_t.size == 7 * 3 + 1
