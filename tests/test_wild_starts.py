"""Starts far from a known truth: others are tried if asked for, and where a motion is finite no end is infeasible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import phugoid as ph

Slopes = Callable[[Sequence[Any], Sequence[Any]], list[Any]]


def van_der_pol(x: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    return [x[1], p[0] * (1 - x[0] ** 2) * x[1] - p[1] ** 2 * x[0]]


def lorenz(x: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    return [p[0] * (x[1] - x[0]), x[0] * (p[1] - x[2]) - x[1], x[0] * x[1] - p[2] * x[2]]


CASES: dict[str, tuple[Slopes, dict[str, float], list[float], np.ndarray, float]] = {
    "van der Pol": (van_der_pol, {"mu": 3.0, "w": 1.5}, [0.5, 0.0], np.linspace(0, 30, 301), 0.05),
    "Lorenz": (lorenz, {"s": 10.0, "r": 28.0, "b": 8 / 3}, [-6.0, -8.0, 22.0], np.linspace(0, 15, 751), 1.0),
}


def estimated(case: str, start: dict[str, float], **options: Any) -> ph.Fit:
    """Estimate from the first state alone, measured with noise."""
    slopes, truth, first, t, sigma = CASES[case]
    p = list(truth.values())
    x = solve_ivp(lambda _, x: slopes(x, p), t[[0, -1]], first, "DOP853", t, rtol=1e-10, atol=1e-12).y
    data = ph.Experiment(t, {}, {"x": x[0] + sigma * np.random.default_rng(0).standard_normal(t.size)})
    m = ph.Model(case)
    names = "xyz"[: len(first)]
    states = m.states(**dict.fromkeys(names, ""))
    parameters = m.parameters(**start)
    m.dynamics(**dict(zip(names, slopes(states, parameters), strict=True)))
    m.outputs(x=states[0])
    return ph.estimate(m, data, **options)


FAR = [
    ("van der Pol", {"mu": 25.144, "w": 4.2235}),
    ("van der Pol", {"mu": 17.142823367330116, "w": 2.388480541285533}),
    ("van der Pol", {"mu": 29.617, "w": 13.733}),
    ("Lorenz", {"s": 2.5522, "r": 9.371, "b": 8.4469}),
]


@pytest.mark.parametrize(("case", "start"), FAR)
def test_the_truth_is_found_from_afar(case: str, start: dict[str, float]) -> None:
    fit = estimated(case, start, solver=ph.Newton(restarts=8))
    assert fit.converged, fit.message
    for name, true in CASES[case][1].items():
        assert abs(fit.parameters[name].value - true) < 4 * fit.parameters[name].std_error, name


@pytest.mark.parametrize("start", [{"mu": 90.0, "w": 10.0}, {"mu": 45.0, "w": 12.0}])
def test_an_end_without_a_solution_is_put_on_the_motion_of_its_parameters(start: dict[str, float]) -> None:
    fit = estimated("van der Pol", start)
    assert not fit.converged
    assert fit.status == "iteration limit" and "that of the model integrated" in fit.message
    assert fit.feasible and np.isfinite(fit.log_likelihood)


def test_logarithms_of_parameters_need_few_iterations_where_the_model_is_linear_in_them() -> None:
    """A regression on measured states leads starts that are decades away next to the optimum."""
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
    assert all(fit.converged and fit.iterations <= 20 for fit in ends), [f.iterations for f in ends]
    assert [f.log_likelihood for f in ends] == pytest.approx([ends[0].log_likelihood] * 3, abs=1e-6)
