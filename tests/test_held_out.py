"""Data held out are predicted with the transcription of the fit."""

from __future__ import annotations

import numpy as np
import pytest
from oscillator import measured, model

import phugoid as ph
from phugoid.discrepancy.search.refit import Refit, on_other_data


@pytest.mark.parametrize(
    "mesh",
    [ph.Collocation(order=2), ph.Collocation(order=6, substeps=2), ph.Collocation(order=5, segments=50)],
    ids=str,
)
def test_the_validation_record_is_fitted_as_the_record_was(mesh: ph.Collocation) -> None:
    fit = ph.estimate(model(), measured(300, (0.0, 0.0), 1), transcription=mesh)
    other = measured(200, (0.0, 0.0), 2, name="other")
    found = on_other_data(Refit((), fit), [other]).fit
    assert isinstance(found.transcription, ph.Collocation)
    assert found.transcription.order == mesh.order and found.transcription.substeps == mesh.substeps
    per_second = [f.records[0].mesh_t.size / np.ptp(f.records[0].t) for f in (fit, found)]
    assert per_second[1] == pytest.approx(per_second[0], rel=0.05)
    # It is what a validation of the fit finds.
    validated = fit.validate(other)
    assert found.log_likelihood == pytest.approx(validated.log_likelihood, abs=1e-6)


def test_a_refined_mesh_is_refined_anew() -> None:
    fit = ph.estimate(model(), measured(300, (0.0, 0.0), 1), transcription=ph.Collocation(order=2, refine=True))
    assert fit.refinement is not None
    found = on_other_data(Refit((), fit), [measured(200, (0.0, 0.0), 2, name="other")]).fit
    assert found.refinement is not None and found.converged
