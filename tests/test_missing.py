"""Missing samples count for nothing, whatever the model says there."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph


def test_output_may_be_undefined_where_nothing_was_measured() -> None:
    m = ph.Model("emptying tank, level on a logarithmic gauge")
    (x,) = m.states(x="m")
    (a,) = m.parameters(a=ph.Parameter(0.05, unit="m/s"))
    m.dynamics(x=-a)
    m.outputs(y=ph.log(x))
    t = np.linspace(0, 20, 101)
    rng = np.random.default_rng(3)
    with np.errstate(invalid="ignore", divide="ignore"):
        y = np.log(1 - 0.1 * t) + 0.01 * rng.standard_normal(t.size)
    y[t > 9.5] = np.nan
    fit = ph.estimate(m, ph.Experiment(t, outputs={"y": y}), start={"x": np.maximum(1 - 0.05 * t, -1)})
    assert fit.converged
    assert fit.parameters["a"].value == pytest.approx(0.1, abs=4 * fit.parameters["a"].std_error)
    assert fit.states["x"][-1] < 0
