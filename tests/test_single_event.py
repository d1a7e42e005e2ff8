"""Whether a disturbance is one event: the rest of the records, and data held out, are free of it."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import short_period
from short_period import T

import phugoid as ph
from phugoid.discrepancy.search import Search, SearchResult
from phugoid.discrepancy.search.disturbance import histories_at
from phugoid.discrepancy.search.process_noise import _parts, is_disturbed, single_event
from phugoid.discrepancy.search.refit import Refit
from phugoid.discrepancy.search.refit_cache import RefitCache
from phugoid.discrepancy.search.remainder import Remainder, RemainderSettings, remainder_of
from phugoid.sensitivities import Place
from phugoid.sensitivities.tangents import collocated

AT, LASTING = 8.0, 1.2
PITCHING = Place("equation", "q")
STRUCTURE, MARGIN = RemainderSettings.structure, RemainderSettings.margin


def record(seed: int, event: float = 0.0, gust: float = 0.0) -> ph.Experiment:
    """A moment of ``event`` rad/s² for 1.2 s, and gusts of ``gust`` all the time."""
    rng = np.random.default_rng(seed)
    de = short_period.elevator(rng, 0.05)
    moment = np.zeros(T.size)
    for k in range(1, T.size):
        moment[k] = 0.93 * moment[k - 1] + 0.37 * gust * rng.standard_normal()
    moment += event * ((T >= AT) & (T < AT + LASTING))

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        acts = np.interp(t, T, moment) - 9.0 * np.interp(t, T, de)
        return np.array([-1.1 * x[0] + x[1], -6.0 * x[0] - 1.6 * x[1] + acts])

    return short_period.record(seed, rng, de, slope)


@functools.cache
def fitted(event: float, gust: float) -> Refit:
    return Refit((), collocated(ph.estimate(short_period.model(), record(1, event, gust))))


def asked(event: float, gust: float, held_out: ph.Experiment | None = None) -> tuple[object, bool]:
    at = fitted(event, gust)
    cache = RefitCache(at, [], [held_out] if held_out else [])
    return single_event(cache, at, histories_at(at, PITCHING)[0], STRUCTURE, MARGIN)


def test_an_event_is_found_with_its_span() -> None:
    found, known = asked(2.0, 0.0, record(2))
    assert known and found is not None
    assert (found.kind, found.place, found.counts) == ("event", PITCHING, ())
    name, begin, end = found.span
    assert name == 0 and begin < AT + 0.2 and end > AT + LASTING - 0.2 and end - begin < 3.0 * LASTING
    assert found.knots[0] == begin and found.knots[-1] == end
    assert found.values.size == found.knots.size
    assert np.argmax(np.abs(found.values)) not in (0, found.values.size - 1)


def test_gusts_are_no_event() -> None:
    found, _ = asked(0.0, 0.6)
    assert found is None


def test_what_other_records_have_too_is_no_event() -> None:
    """The same span of the fitted record is left out, and the other record is disturbed all the time."""
    found, known = asked(2.0, 0.0, record(2, gust=0.8))
    assert found is None and known


def test_records_are_disturbed_or_not() -> None:
    of = histories_at(fitted(2.0, 0.0), PITCHING)[0]
    assert is_disturbed(fitted(2.0, 0.0), of, STRUCTURE, MARGIN)
    assert not is_disturbed(fitted(0.0, 0.0), of, STRUCTURE, MARGIN)


def test_the_parts_beside_a_span_are_those_that_are_long_enough() -> None:
    e = record(1)
    before, after = _parts(e, 8.0, 9.0)
    assert before.t[-1] < 8.0 and after.t[0] > 9.0
    assert before.n + after.n == e.n - np.count_nonzero((e.t >= 8.0) & (e.t <= 9.0))
    (after,) = _parts(e, 0.5, 9.0)
    assert after.t[0] > 9.0


def tanks() -> ph.Model:
    m = ph.Model("tanks")
    h1, h2 = m.states(h1="cm", h2="cm")
    (u,) = m.inputs("u")
    k, c1, c2 = m.parameters(k=0.2, c1=0.3, c2=0.3)
    m.dynamics(h1=k * u - c1 * ph.sqrt(h1), h2=c1 * ph.sqrt(h1) - c2 * ph.sqrt(h2))
    m.outputs(h1=h1, h2=h2)
    return m


def levels(seed: int, poured: bool, leaks: float) -> ph.Experiment:
    """Levels of two tanks with a controller of the second: water that is poured into it for 6 s, and a leak that is
    proportional to the product of both levels."""
    rng, dt = np.random.default_rng(seed), 0.02
    t = np.arange(0.0, 60.0, dt)
    wanted = 11.0 + np.repeat(rng.uniform(-2.0, 2.0, 6), t.size // 6)
    x, integral, u, path = np.array([9.0, 11.0]), 4.0, np.zeros(t.size), np.zeros((t.size, 2))
    for i, now in enumerate(t):
        path[i] = x
        if i % 5:
            u[i] = u[i - 1]
        else:
            integral += 0.005 * (wanted[i] - x[1])
            u[i] = np.clip(integral + 0.7 * (wanted[i] - x[1]), 0.0, 12.0)
        between = 0.42 * np.sqrt(x[0])
        more = 0.55 * (poured and 31.0 <= now < 37.0) - leaks * x[0] * x[1]
        x = x + dt * np.array([0.30 * u[i] - between, between - 0.36 * np.sqrt(x[1]) + more])
    y = path[::5] + 0.12 * rng.standard_normal((t.size // 5, 2))
    held = {"u": "hold"}
    outputs = {"h1": y[:, 0], "h2": y[:, 1]}
    return ph.Experiment(t[::5], {"u": u[::5]}, outputs, interpolation=held, name=f"record {seed}")


def left_beside_the_product(leaks: float) -> Remainder | None:
    """Return what is left beside a term h1 h2, which is taken to predict data held out."""
    base = Refit((), collocated(ph.estimate(tanks(), levels(3, True, leaks))))
    candidates = ph.candidates(tanks(), points=base.linear.points)
    search = Search(base, candidates, [levels(4, False, leaks)])
    search.cache.try_validation()
    search.screen.shortlist(base)
    (term,) = [c for c in search.cache.candidates if c.name == "h2':h1*h2"][:1]
    final = search.cache.refit([term])
    assert final is not None and final.merit > base.merit
    result = SearchResult(final, final, (search.confirmation.found(final, term, True),))
    return remainder_of(search, result, RemainderSettings(most=-10.0))


def test_a_term_that_undoes_what_an_event_did_to_the_estimates_gives_way_to_it() -> None:
    left = left_beside_the_product(0.0)
    assert left is not None and left.disturbance.name == "h2':event" and left.at.names == ()
    assert left.disturbance.span is not None and left.disturbance.span[1:] == pytest.approx((31.0, 37.0), abs=2.0)


def test_an_event_alone_does_not_take_the_place_of_what_data_held_out_lack_too() -> None:
    left = left_beside_the_product(0.004)
    assert left is None or left.disturbance.kind != "event" or left.at.names
