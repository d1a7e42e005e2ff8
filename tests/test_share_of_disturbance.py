"""The power that a random disturbance gives the outputs follows from its variance, not from the noise it takes up."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search.disturbance import Disturbance, histories_at, powers_of
from phugoid.discrepancy.search.refit import Refit
from phugoid.sensitivities import Place

STEP, N, SIGMA = 0.05, 1000, 0.05


def disturbed(intensity: float, seed: int) -> tuple[Refit, Disturbance]:
    """A first-order lag that white noise drives, beside an input; and the likeliest disturbance of its state."""
    m = ph.Model("lag")
    (u,), (x,) = m.inputs("u"), m.states(x="")
    a, b = m.parameters(a=1.0, b=1.0)
    m.dynamics(x=b * u - a * x)
    m.outputs(x=x)
    rng = np.random.default_rng(seed)
    t, finer = STEP * np.arange(N), 10
    u = np.sin(0.7 * t) + np.sin(0.23 * t)
    path, x = [], 0.0
    for i in range(N):
        path.append(x)
        for j in range(finer if i + 1 < N else 0):
            acting = u[i] + (u[i + 1] - u[i]) * j / finer
            x += STEP / finer * (acting - x) + intensity * np.sqrt(STEP / finer) * rng.standard_normal()
    record = ph.Experiment(t, {"u": u}, {"x": np.array(path) + SIGMA * rng.standard_normal(N)})
    at = Refit((), ph.estimate(m, record))
    return at, histories_at(at, Place("equation", "x"))[0]


def test_it_is_the_variance_that_the_disturbance_gives() -> None:
    at, found = disturbed(0.2, 1)
    assert powers_of(at.linear, found) == pytest.approx(0.2**2 / 2.0, rel=0.4)  # that of the process, q² / 2 a


@pytest.mark.parametrize("seed", [2, 3])
def test_where_there_is_none_it_is_next_to_nothing(seed: int) -> None:
    at, found = disturbed(0.0, seed)
    assert powers_of(at.linear, found) < 0.03 * SIGMA**2
