"""Starts far from a known truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import phugoid as ph


def test_logarithms_of_parameters_need_no_iterations_where_the_model_is_linear_in_them() -> None:
    """A regression on measured states leads starts that are decades away to the same point."""
    t = np.linspace(0, 10, 201)
    x = solve_ivp(lambda t, x: [x[1], -2 * x[0] - 0.4 * x[1]], (0, 10), [1.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-10).y
    noisy = x + 0.01 * np.random.default_rng(0).standard_normal(x.shape)
    data = ph.Experiment(t, {}, {"x": noisy[0], "v": noisy[1]})
    ends = []
    for factor in (1.0, 1e-2, 1e3):
        m = ph.Model("spring")
        x, v = m.states("x v")
        k, c = m.parameters(
            k=ph.Parameter(2.0 * factor, transform="log"), c=ph.Parameter(0.4 / factor, transform="log")
        )
        m.dynamics(x=v, v=-k * x - c * v)
        m.outputs(x=x, v=v)
        ends.append(ph.estimate(m, data))
    assert all(fit.converged and fit.iterations <= ends[0].iterations + 1 for fit in ends), [f.iterations for f in ends]
    assert [f.log_likelihood for f in ends] == pytest.approx([ends[0].log_likelihood] * 3, abs=1e-6)
