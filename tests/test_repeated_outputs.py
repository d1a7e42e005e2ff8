"""A measurement that is given twice makes standard errors too small, and the fit says so, with the names."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import phugoid as ph

T = 0.05 * np.arange(300)
U = np.sign(np.sin(0.9 * T))


def fitted(scale: float = 1.0, own_noise: float = 0.0, digits: int | None = None, **options: Any) -> ph.Fit:
    """A lag whose state is measured as x, and again as y, times a constant, with noise of its own or none."""
    m = ph.Model("lag")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, b, off = m.parameters(a=1.0, b=1.0, off=0.0)
    m.dynamics(x=-a * x + b * u)
    m.outputs(x=x, y=scale * x + off, w=x)
    e = ph.Experiment(T, {"u": U}, name="run")
    clean = ph.simulate(m, {"a": 1.2, "b": 2.0, "off": 0.3}, e, initial={"x": 0.0}).outputs["x"]
    rng = np.random.default_rng(3)
    z = clean + 0.05 * rng.standard_normal(T.size)
    y = scale * z + 0.3 + own_noise * abs(scale) * rng.standard_normal(T.size)
    y = y if digits is None else np.round(y, digits)
    w = clean + 0.05 * rng.standard_normal(T.size)
    return ph.estimate(m, e.with_outputs({"x": z, "y": y, "w": w}), **options)


def said(fit: ph.Fit) -> list[str]:
    return [w for w in fit.warnings if "hold the same measurement" in w]


@pytest.mark.parametrize("scale", [1.0, 57.29578, -3.0])
def test_the_same_measurement_in_any_unit_is_told_of(scale: float) -> None:
    fit = fitted(scale)
    assert fit.converged
    (warning,) = said(fit)
    assert "outputs x and y hold" in warning and "√2" in warning and "w" not in warning.split()


def test_rounded_digits_hide_nothing() -> None:
    assert said(fitted(57.29578, digits=1))


def test_missing_samples_hide_nothing() -> None:
    fit = fitted()
    z = fit.experiments[0].outputs
    thinned = {n: np.where(np.arange(T.size) % k == 0, z[n], np.nan) for n, k in (("x", 2), ("y", 3), ("w", 1))}
    assert said(ph.estimate(fit.model, fit.experiments[0].with_outputs(thinned)))


def test_with_process_noise_too() -> None:
    assert said(fitted(transcription=ph.FilterError(("x",))))


def test_two_sensors_of_the_same_quantity_are_two() -> None:
    """They share most of their noise, but half as much each has of its own."""
    assert not said(fitted(own_noise=0.025))


def test_noise_that_goes_together_is_counted_once() -> None:
    """Where the covariance of the noise is estimated, nothing is counted twice."""
    assert not said(fitted(own_noise=0.001, noise=ph.Gaussian(correlated=True)))


@pytest.mark.parametrize("scale", [1.0, 57.29578, -3.0])
def test_slight_noise_of_its_own_hides_nothing(scale: float) -> None:
    fit = fitted(scale, own_noise=0.005)
    residuals = fit.records[0].residuals
    assert 0.99 < abs(np.corrcoef(residuals["x"], residuals["y"])[0, 1]) < 0.999
    (warning,) = said(fit)
    assert "outputs x and y hold" in warning
