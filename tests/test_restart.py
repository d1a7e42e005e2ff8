"""Fits that ended at no optimum, begun again from what short segments of the records tell, or left to these."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import short_period

import phugoid as ph
from phugoid.discrepancy.search import restart
from phugoid.estimation import estimate


@functools.cache
def record(seed: int) -> ph.Experiment:
    rng = np.random.default_rng(seed)
    de = short_period.elevator(rng, 0.05)

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        return np.array([-1.1 * x[0] + x[1], -6.0 * x[0] - 1.6 * x[1] - 9.0 * np.interp(t, short_period.T, de)])

    return short_period.record(seed, rng, de, slope)


@functools.cache
def ended_badly() -> ph.Fit:
    return replace(ph.estimate(short_period.model(), record(1)), status="infeasible", message="no path")


def failing(first: int, starts: list[Any]) -> Callable[..., Any]:
    """Estimate, but for so many first calls, which end as infeasible; what they started from is listed."""

    def tried(*args: Any, start: Any = None, **options: Any) -> Any:
        starts.append(start)
        found = estimate(*args, start=start, **options)
        return replace(found, status="infeasible") if len(starts) <= first else found

    return tried


@pytest.mark.parametrize(("failures", "words"), [(0, "estimated again"), (1, "estimated again"), (2, "short segments")])
def test_the_next_way_is_tried_where_one_fails(failures: int, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    starts: list[Any] = []
    monkeypatch.setattr(restart, "estimate", failing(failures, starts))
    found = restart.restarted(ended_badly(), ())
    assert found.fit is not None and found.fit.status == "converged" and found.segments is None
    assert words in found.words and "ended as 'infeasible' (no path)" in found.words
    # Continued; from the measured path; from the parameters that segments tell, without the path.
    assert len(starts) == failures + 1
    assert starts[0] is ended_badly() and all(s is None for s in starts[1:2])
    if failures == 2:
        assert {*starts[2]} == {"za", "ma", "mq", "md"} and starts[2]["md"] == pytest.approx(-9.0, rel=0.1)


def test_segments_are_what_is_diagnosed_where_only_they_can_be_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restart, "estimate", failing(100, []))
    found = restart.restarted(ended_badly(), [record(2)])
    assert found.fit is not None and found.segments is not None and "It converged over short segments" in found.words
    assert len(found.fit.records) > 5 and found.fit.parameters["ma"].value == pytest.approx(-6.0, rel=0.1)
    assert found.segments.base.fit is found.fit
    assert max(e.t[-1] - e.t[0] for e in found.segments.validation) < 1.5 * found.segments.horizon


def test_no_fit_is_an_answer_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restart, "estimate", failing(100, []))
    monkeypatch.setattr(restart, "fitted_to_segments", lambda base: (None, 0))
    found = restart.restarted(ended_badly(), ())
    assert found.fit is None and found.segments is None and "no cause can be named" in found.words


def test_ctrl_c_is_not_taken_for_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restart, "estimate", lambda *args, **options: replace(ended_badly(), status="interrupted"))
    with pytest.raises(KeyboardInterrupt):
        restart.restarted(ended_badly(), ())
