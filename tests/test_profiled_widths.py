"""Dead-bands are begun at the likeliest of several widths: along the width the likelihood has several maxima."""

from __future__ import annotations

from typing import Any

import pytest
from hidden import make

import phugoid as ph
from phugoid.discrepancy.search import Search, starts
from phugoid.discrepancy.search.refit import Refit


def test_a_dead_band_is_found_where_the_estimation_goes_over_its_width() -> None:
    """From the value of first order, 0.021 rad, it ends at 0.040, 28 in log-likelihood below the truth."""
    case = make("lateral", ("dr:deadband",), "strong", "white", 960046)
    d = ph.diagnose(ph.estimate(case.model, case.data), validation=case.validation)
    (found,) = [f for f in d.findings if f.status == "named"]
    assert found.cause == "dr:deadband"
    low, high = found.interval
    assert low < case.coefficients["dr:deadband"] < high


def test_a_width_that_is_known_from_a_fit_nearby_is_not_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    held: list[bool] = []
    original = starts.refit

    def watched(*args: Any, **options: Any) -> Refit | None:
        held.append(bool(options.get("held")))
        return original(*args, **options)

    monkeypatch.setattr(starts, "refit", watched)
    case = make("lateral", ("dr:deadband",), "strong", "white", 960046)
    base = Refit((), ph.estimate(case.model, case.data))
    search = Search(base, ph.candidates(case.model, points=base.linear.points))
    (band,) = [c for c in search.cache.candidates if c.name == "dr:deadband"]
    search.screen.shortlist(base)
    found = search.cache.refit([band])
    assert found is not None and sum(held) > 2
    (name,) = band.shape_names
    assert found.fit.parameters[name].value == pytest.approx(case.coefficients[band.name], rel=0.1)
    held.clear()
    other = next(c for c in search.cache.candidates if c.name == "Cn:sign(dr)")
    assert search.cache.refit([other, band], found.fit) is not None
    assert held and not any(held)
