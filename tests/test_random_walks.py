"""A drift and a random walk of a sensor: which of the two is the likelier."""

from __future__ import annotations

import numpy as np
import pytest
from hidden import make
from hidden.situation import situation

import phugoid as ph
from phugoid.discrepancy.search import Search
from phugoid.discrepancy.search.randomness import in_a_tenth
from phugoid.discrepancy.search.refit import Refit, refit
from phugoid.discrepancy.search.ringing import random_walk_gain
from phugoid.sensitivities.tangents import collocated


def with_drift(model: ph.Model, data: ph.Experiment, cause: str) -> tuple[Refit, Refit]:
    fit = collocated(ph.estimate(model, data))
    base = Refit((), fit)
    candidate = ph.candidates(fit.model, points=base.linear.points)[cause]
    more = refit(fit, [candidate], {}, None, base.linear.points)
    assert more is not None
    return base, more


@pytest.mark.parametrize("strength", ["weak", "strong"])
def test_a_drift_is_likelier_than_a_random_walk_and_leaves_none(strength: str) -> None:
    case = make("servo", "rate:drift", strength, "white", 7)
    base, more = with_drift(case.model, case.data, "rate:drift")
    assert more.own.lenient_merit - base.own.lenient_merit > random_walk_gain(base, ["rate"]) > 0.0
    assert random_walk_gain(more, ["rate"]) == 0.0


@pytest.mark.parametrize(("seed", "output"), [(942, "theta"), (947, "q")])
def test_a_drift_that_is_a_random_walk_leaves_one(seed: int, output: str) -> None:
    """These were named as drifts: they gain much by autoregressive noise, and other data confirmed them by chance."""
    s = situation("random walk", "uav", seed)
    base, more = with_drift(s.model, s.data, f"{output}:drift")
    gain, left = more.own.lenient_merit - base.own.lenient_merit, random_walk_gain(more, [output])
    assert gain > 10.0 and left > 1.0
    assert gain + left - random_walk_gain(base, [output]) < 8.0


@pytest.mark.parametrize("tone", [True, False])
def test_a_slow_tone_is_distinguished_from_a_random_walk(tone: bool) -> None:
    """The walk was named as a tone: it swings slowly by chance."""
    s = make("servo", "torque:periodic", "medium", "white", 7) if tone else situation("random walk", "servo", 6102)
    base = Refit((), collocated(ph.estimate(s.model, s.data)))
    listed = [c for c in ph.candidates(s.model, points=base.linear.points) if c.name == "torque:periodic"]
    search = Search(base, listed)
    search.screen.shortlist(base)
    (candidate,) = search.cache.candidates
    more = search.cache.refit([candidate])
    assert more is not None and search.assessment.gain(base, more) > 20.0
    assert search.assessment.is_random_walk(base, more, candidate) != tone


def test_white_noise_is_no_random_walk() -> None:
    s = situation("white", "duffing", 3)
    base = Refit((), collocated(ph.estimate(s.model, s.data)))
    assert random_walk_gain(base, s.model.output_names) < 1.0


def test_bursts_are_told_from_normal_values() -> None:
    rng = np.random.default_rng(0)
    normal = rng.standard_normal(20_000)
    assert in_a_tenth(normal) == pytest.approx(0.438, abs=0.01)
    assert in_a_tenth(normal * (np.arange(normal.size) % 100 < 8)) == pytest.approx(1.0)
