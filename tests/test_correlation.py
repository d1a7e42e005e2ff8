"""Correlations of estimates, and combinations of parameters that data hardly determine."""

from __future__ import annotations

import numpy as np
import pytest
from oscillator import measured, model

import phugoid as ph


def redundant() -> ph.Fit:
    """Two parameters of which the data determine the sum, and the difference hardly at all."""
    m = ph.Model("two dampers")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    k, c, d, b = m.parameters(k=4.0, c=0.5, d=0.5, b=2.0)
    # The input is steady but for a small part, so that c and d * (1 + u / 200) are nearly alike.
    m.dynamics(x=v, v=-k * x - (c + d * (1.0 + 0.005 * u)) * v + b * u)
    m.outputs(x=x, v=v)
    return ph.estimate(m, measured(300, (0.0, 0.0), 3))


def test_matrix_is_the_covariance_in_units_of_the_errors() -> None:
    fit = ph.estimate(model(), measured(300, (0.0, 0.0), 0))
    c = fit.correlation
    size = fit.parameters.std_errors_array
    assert c.matrix * np.outer(size, size) == pytest.approx(fit.covariance)
    assert np.asarray(c) == pytest.approx(c.matrix)
    assert c["k", "b"] == c["b", "k"] == c.matrix[0, 2]
    assert c.names == tuple(fit.parameters)
    with pytest.raises(ph.errors.UnknownName, match="'kk'"):
        _ = c["k", "kk"]


def test_pairs_are_named_the_strongest_first() -> None:
    fit = ph.estimate(model(), measured(300, (0.0, 0.0), 0))
    strength = sorted((abs(fit.correlation[a, b]) for a, b in [("k", "c"), ("k", "b"), ("c", "b")]), reverse=True)
    found = fit.correlation.pairs(0.0)[:3]
    assert [abs(rho) for *_, rho in found] == pytest.approx(strength)
    assert fit.correlation.pairs(0.999) == []


def test_good_data_have_nothing_named() -> None:
    fit = ph.estimate(model(), measured(300, (0.0, 0.0), 0))
    assert fit.correlation.weak == ()
    assert "Weakly identified" not in fit.summary()


def test_weak_direction_is_named_as_a_combination() -> None:
    fit = redundant()
    (weak,) = fit.correlation.weak
    assert set(weak.steps) == {"c", "d"}
    assert weak.steps["c"] == pytest.approx(-weak.steps["d"], rel=0.01)
    # A step of one standard error along it: nearly that of either parameter.
    assert abs(weak.steps["c"]) == pytest.approx(fit.parameters["c"].std_error, rel=0.05)
    assert weak.index > 100
    text = fit.summary()
    assert "Weakly identified: c and d are hardly distinguishable" in text
    assert "Correlated above 0.9: c and d -" in text


def test_a_step_along_a_weak_direction_costs_half() -> None:
    """By its meaning: with parameters moved by one standard error along it the log-likelihood is lower by 1/2."""
    fit = redundant()
    (weak,) = fit.correlation.weak
    moved = {name: fit.parameters[name].value + step for name, step in weak.steps.items()}
    m = ph.Model("two dampers")
    x, v = m.states("x v")
    (u,) = m.inputs("u")
    k, b = m.parameters(k=4.0, b=2.0)
    m.dynamics(x=v, v=-k * x - (moved["c"] + moved["d"] * (1.0 + 0.005 * u)) * v + b * u)
    m.outputs(x=x, v=v)
    other = ph.estimate(m, fit.experiments, start={"k": fit.parameters["k"].value})
    assert fit.log_likelihood - other.log_likelihood == pytest.approx(0.5, abs=0.1)


def test_fixed_parameters_have_no_correlation() -> None:
    m2 = ph.Model("fixed")
    x, v = m2.states("x v")
    (u,) = m2.inputs("u")
    k, c, b = m2.parameters(k=4.0, c=ph.Parameter(1.0, fixed=True), b=2.0)
    m2.dynamics(x=v, v=-k * x - c * v + b * u)
    m2.outputs(x=x, v=v)
    fit = ph.estimate(m2, measured(200, (0.0, 0.0), 0))
    assert np.isnan(fit.correlation["k", "c"]) and np.isfinite(fit.correlation["k", "b"])
    assert "c" in str(fit.correlation)
