"""The ATTAS example: both records in one fit, each validating the other; its twins without the records."""

from __future__ import annotations

import attas
import numpy as np
import pytest
from records import find

import phugoid as ph

needs_records = pytest.mark.skipif(
    not all(find(name) for name in attas.RECORDS), reason=f"the records {', '.join(attas.RECORDS)} are not there"
)


def test_the_truth_of_the_twins_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attas, "find", lambda name: None)
    fit = attas.estimate(attas.records())
    assert fit.converged
    for name, value in attas.TWIN.items():
        e = fit.parameters[name]
        assert abs(e.value - value) < 4 * e.std_error


@needs_records
def test_each_record_predicts_the_other() -> None:
    first, second = attas.records()
    for own, other in ((first, second), (second, first)):
        there = attas.validate(attas.estimate(own), other)
        assert there.converged
        assert set(there.fixed) == {*attas.SHARED, *attas.VANE}
        assert all(m.theil_about_mean < 0.05 for m in there.matches.values())


@needs_records
def test_a_vane_on_a_boom_misleads_the_regression() -> None:
    """With alpha put right for the place of the vane the regression comes near the fit; no scale factor is left."""
    runs, model = attas.records(), attas.model(vane=False)
    fit = attas.estimate(runs).parameters

    def right(run: ph.Experiment) -> ph.Experiment:
        alpha = run.outputs["alpha"] + attas.BOOM[0] * run.outputs["q"] / attas.V0
        return run.with_outputs({**run.outputs, "alpha": alpha})

    raw, put_right = (ph.equation_error(model, data).parameters for data in (runs, [right(run) for run in runs]))
    assert raw["Zde"].value > 0 > fit["Zde"].value
    for name, off in (("Zde", 0.02), ("Mq", 0.2)):
        assert abs(put_right[name].value - fit[name].value) < off < abs(raw[name].value - fit[name].value)


@needs_records
def test_the_place_of_the_vane_leaves_neither_scale_factor_nor_delay() -> None:
    """With a delay in its stead the vane seems to read too little, and the samples that both have are less likely."""
    runs, base = attas.records(), ph.estimate(attas.model(vane=False), attas.records())
    place = attas.estimate(runs)
    assert abs(place.parameters["K"].value - 1.0) < place.robust().parameters["K"].std_error
    late = ph.estimate(attas.model(late=True), runs, start=base)
    assert late.parameters["tau"].value == pytest.approx(attas.BOOM[0] / attas.V0, abs=0.012)
    assert late.parameters["K"].value < 1.0 - 5 * late.robust().parameters["K"].std_error
    for one, other in zip(place.records, late.records, strict=True):
        both = np.isfinite(other.residuals["alpha"])
        assert np.std(one.residuals["alpha"][both]) < np.std(other.residuals["alpha"][both])


@needs_records
def test_both_records_together() -> None:
    runs = attas.records()
    alone, both = [attas.estimate(run) for run in runs], attas.estimate(runs)
    assert both.converged and not both.warnings
    for name in (*attas.SHARED, *attas.VANE):
        first, second, joint = (fit.parameters[name] for fit in (*alone, both))
        assert joint.std_error < min(first.std_error, second.std_error)
        assert min(first.value, second.value) < joint.value < max(first.value, second.value)
    # Each record by itself finds that the vane is in scale.
    assert [fit.parameters["K"].value for fit in alone] == pytest.approx([1.0, 1.0], abs=0.01)
    for name in ("Z0", "M0", "b_az"):
        assert {f"{name}[first]", f"{name}[second]"} <= set(both.parameters)
