"""The example of turbulence: output error is wrong and sure of it, the filter-error method knows how far it is off."""

from __future__ import annotations

import hfb320
import numpy as np
import pytest
import turbulence
from records import find
from turbulence import INTENSITY, TRUTH, Pair

import phugoid as ph


@pytest.fixture(scope="module")
def pairs() -> list[Pair]:
    return [turbulence.solve(seed) for seed in range(20)]


def test_all_converge_without_warning(pairs: list[Pair]) -> None:
    assert all(p.filtered.converged for p in pairs)
    warned = [w for p in pairs for w in p.filtered.warnings]
    # The gust moves az by 0.36 m/s² from sample to sample: a record may leave nothing of 0.05 m/s² for its noise.
    assert all(w.startswith("sigma_az sits at its lower bound") for w in warned) and len(warned) <= 2


def test_nothing_is_lost_with_a_noise_that_cannot_be_told(pairs: list[Pair]) -> None:
    """Where sigma_az ends at its bound, the true one is as likely."""
    for p in pairs:
        if p.filtered.parameters["sigma_az"].bounds_active:
            known = ph.Gaussian({"az": turbulence.SIGMA["az"]})
            other = ph.estimate(
                p.filtered.model, p.data, transcription=p.filtered.transcription, noise=known, start=p.filtered
            )
            assert other.converged and p.filtered.log_likelihood - other.log_likelihood < 2.0


def test_errors_are_as_large_as_they_are_said_to_be(pairs: list[Pair]) -> None:
    def ratio(fits: list[ph.Fit]) -> float:
        return float(np.sqrt(np.mean([e**2 for e in turbulence.errors(fits, TRUTH).values()])))

    assert 0.75 < ratio([p.filtered for p in pairs]) < 1.25
    assert ratio([p.ordinary for p in pairs]) > 2.5


def test_estimates_are_not_biased(pairs: list[Pair]) -> None:
    truth = {**TRUTH, "q_wg": INTENSITY}
    for name, each in turbulence.errors([p.filtered for p in pairs], truth).items():
        assert abs(each.mean()) < 0.7, name  # in standard errors; the mean of twenty has one of 0.22
    for name in TRUTH:
        scatter = {
            kind: np.std([getattr(p, kind).parameters[name].value for p in pairs]) for kind in ("ordinary", "filtered")
        }
        assert scatter["filtered"] < 0.2 * scatter["ordinary"], name


def test_the_gust_is_found(pairs: list[Pair]) -> None:
    inside = [
        np.mean(np.abs(p.filtered.records[0].states["wg"] - p.gust) < 2 * p.filtered.records[0].state_std["wg"])
        for p in pairs
    ]
    assert 0.9 < np.mean(inside) <= 1.0
    # Its changes; its level is that of the motion, which is little known.
    correlation = [np.corrcoef(p.filtered.records[0].states["wg"], p.gust)[0, 1] for p in pairs]
    assert min(correlation) > 0.9


def test_table_and_figure(pairs: list[Pair]) -> None:
    assert len(turbulence.table(pairs).splitlines()) == 4 + len(TRUTH) + 1
    assert len(turbulence.draw(pairs).axes) == 3


@pytest.mark.skipif(find(hfb320.RECORD) is None, reason=f"{hfb320.RECORD} is not there (see README, Start)")
def test_flight_record_of_the_hfb_320() -> None:
    """Residuals of output error are strongly coloured there; innovations are less so in every channel."""
    path = find(hfb320.RECORD)
    assert path is not None
    m, data = hfb320.model(), hfb320.experiment(path)
    ordinary = ph.estimate(m, data)
    fit = ph.estimate(m, data, transcription=ph.FilterError(m.state_names), start=ordinary)
    assert fit.converged and fit.log_likelihood > ordinary.log_likelihood + 3000

    def colour(r: np.ndarray) -> float:
        return abs(float(r[1:] @ r[:-1] / (r @ r)))

    innovations = fit.records[0].innovations
    before = {n: colour(r) for n, r in ordinary.residuals.items()}
    after = {n: colour(r) for n, r in innovations.items()}
    assert all(after[n] < before[n] for n in after), (before, after)
