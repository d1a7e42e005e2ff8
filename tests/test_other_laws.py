"""Friction whose law the records do not tell: a cart in a limit cycle, which has about one speed all the time."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search import Search
from phugoid.discrepancy.search.other_laws import other_laws, words_of_laws
from phugoid.discrepancy.search.refit import Refit
from phugoid.sensitivities.tangents import collocated

GAIN, STEP, COUNT, FRICTION = 0.5, 0.005, 1e-4, {1: 0.55, -1: 0.3}
MEAN, BIAS = 0.5 * (FRICTION[1] + FRICTION[-1]), -0.5 * (FRICTION[1] - FRICTION[-1])


def model() -> ph.Model:
    m = ph.Model("cart")
    (i,), (x, v) = m.inputs(i="A"), m.states(x="m", v="m/s")
    (c,) = m.parameters(c=ph.Parameter(0.5, unit="1/s"))
    m.dynamics(x=v, v=GAIN * i - c * v)
    m.outputs(x=x)
    return m


def record(name: str, sizes: tuple[float, ...], samples: int = 600) -> ph.Experiment:
    """A relay drives a cart with dry friction of its own in each direction forth and back; an encoder counts.
    ``sizes`` of the current, in A, one after the other."""
    t, parts = STEP * np.arange(samples), 20
    current, position = np.zeros(samples), np.zeros(samples)
    x, v, side = 0.0, 0.0, 1
    for k in range(samples):
        side = -1 if x > 0.004 else 1 if x < -0.004 else side
        current[k], position[k] = side * sizes[k * len(sizes) // samples], x
        for _ in range(parts):
            drive = GAIN * current[k]
            way = 1 if v > 0.0 else -1 if v < 0.0 else int(np.sign(drive))
            change = STEP / parts * (drive - way * FRICTION[way])
            v = 0.0 if v * (v + change) < 0.0 else v + change
            x += STEP / parts * v
    y = COUNT * np.round(position / COUNT)
    return ph.Experiment(t, {"i": current}, {"x": y}, name=name, interpolation="hold")


@functools.cache
def extended(sizes: tuple[float, ...]) -> tuple[Search, Refit]:
    """The search about a fit of viscous friction alone, and the model with the constant force."""
    fit = ph.estimate(model(), record("fitted", sizes))
    base = Refit((), collocated(fit))
    held_out = tuple(1.02 * s for s in sizes)
    search = Search(base, ph.candidates(fit.model, points=base.linear.points), [record("held out", held_out)])
    search.screen.shortlist(base)
    (bias,) = [c for c in search.cache.candidates if c.name == "v':bias"]
    final = search.cache.refit([bias])
    assert final is not None
    return search, final


def test_dry_friction_in_place_of_viscous_is_told_where_there_is_one_speed() -> None:
    search, final = extended((4.0,))
    assert final.fit.parameters["v_dot_bias"].value == pytest.approx(BIAS, rel=0.1)
    laws = {law.candidate.name: law for law in other_laws(search, final)}
    assert "v':sign(v)" in laws
    law = laws["v':sign(v)"]
    assert (law.parameter, law.variable) == ("c", "v")
    value, error = law.values["v_dot_sign_v"]
    assert value == pytest.approx(-MEAN, rel=0.1) and 0.0 < error < 0.1 * MEAN
    (words,) = words_of_laws([law])
    assert "in place of c, v':sign(v)" in words


def test_the_law_is_known_where_there_are_several_speeds() -> None:
    search, final = extended((1.5, 6.0))
    assert not other_laws(search, final)


def test_a_parameter_that_is_needless_has_no_law() -> None:
    """Beside the dry friction there is no viscous one, and any other law in its place explains as much."""
    search, final = extended((4.0,))
    (dry,) = [c for c in search.cache.candidates if c.name == "v':sign(v)"]
    both = search.cache.refit([*final.candidates, dry], final.fit)
    assert both is not None and abs(both.fit.parameters["v_dot_sign_v"].value + MEAN) < 0.1 * MEAN
    assert not other_laws(search, both)
