"""Samples at which nothing was measured cost an estimation with a moving mesh nothing, and are in its result."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

TRUTH = {"a": 0.5, "b": 2.0}


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    """Return the estimate of two states that come to rest before an input is switched on, at 60 unmeasured times."""
    m = ph.Model("relaxation")
    x, y = m.states("x", "y")
    (u,) = m.inputs("u")
    a, b = m.parameters(**{n: ph.Parameter(v, bounds=(1e-3, 1e3), transform="log") for n, v in TRUTH.items()})
    m.dynamics(x=1 + u - a * x, y=a * x - b * y)
    m.initial(x=0, y=0)
    m.outputs(y=y)
    t = np.concatenate([np.linspace(-60, 0, 60, endpoint=False), [0.0, 0.5, 1.0, 2.0, 4.0, 8.0]])
    u = {"u": np.where(t < 0, 0.0, 3.0)}
    bare = ph.Experiment(t, u, name="on", interpolation={"u": "hold"})
    exact = np.asarray(ph.simulate(m, TRUTH, bare).outputs["y"])
    noise = 0.01 * np.random.default_rng(3).standard_normal(t.size)
    z = np.where(t < 0, np.nan, exact + noise)
    record = ph.Experiment(t, u, {"y": z}, name="on", interpolation={"u": "hold"})
    return ph.estimate(m, record, start={"a": 0.05, "b": 0.3})


def test_the_mesh_need_not_have_points_at_these_samples(fit: ph.Fit) -> None:
    # With a segment of order 4 between all samples it has 196.
    record = fit.records[0]
    assert record.mesh_t.size < 2 * record.t.size


def test_the_result_has_all_samples(fit: ph.Fit) -> None:
    record = fit.records[0]
    values = {n: p.value for n, p in fit.parameters.items()}
    simulated = ph.simulate(fit.model, values, fit.experiments[0])
    assert record.t.size == record.outputs["y"].size == 66
    assert np.allclose(record.outputs["y"], simulated.outputs["y"], atol=2e-3)
    assert np.allclose(record.states["x"], simulated.states["x"], atol=1e-2)
    assert np.isnan(record.residuals["y"][:60]).all()
    assert np.isfinite(record.residuals["y"][60:]).all()


def test_the_truth_is_estimated(fit: ph.Fit) -> None:
    for name, value in TRUTH.items():
        assert abs(fit.parameters[name].value - value) < 4 * fit.parameters[name].std_error
