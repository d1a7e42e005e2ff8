"""A run that ends for want of a step at a path that is a solution is not "infeasible"."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from test_sparse_samples import _record, infection

import phugoid as ph


@pytest.mark.parametrize(
    "start",
    [
        {
            "growth": 20.308104256912184,
            "kill": 0.015619390003465917,
            "call": 3.1145714057253837,
            "fade": 5.74068877742467,
        },
        {
            "growth": 0.052287579517003566,
            "kill": 0.0015310773042474149,
            "call": 0.01803699759020125,
            "fade": 0.2243872818223836,
        },
        {
            "growth": 0.38615117044837777,
            "kill": 0.0006975665557854053,
            "call": 0.007975541523117684,
            "fade": 1.104850341182722,
        },
    ],
)
def test_a_path_that_is_a_solution_is_not_infeasible(start: Mapping[str, float]) -> None:
    """A single run ends for want of a step, at a path that is that of the integration."""
    case = infection()
    data = _record(case)
    noise = ph.Gaussian(dict.fromkeys(case.model.output_names, case.sigma))
    fit = ph.estimate(case.model, data, noise=noise, start=start, solver=ph.Newton(restarts=0))
    ph.simulate(case.model, fit, data)
    assert fit.status != "infeasible" and fit.feasible, fit.summary()
