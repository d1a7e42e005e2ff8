"""A diagnosis holds what was found, not the search that found it: its linearisations take much memory."""

from __future__ import annotations

import gc

import numpy as np

import phugoid as ph
from phugoid.discrepancy.search import Search, SearchSettings
from phugoid.discrepancy.search.refit import Refit
from phugoid.discrepancy.search.refit_cache import RefitCache
from phugoid.sensitivities.linearised import Linearised

T = np.arange(0.0, 20.0, 0.04)


def fit() -> ph.Fit:
    """A damped oscillator, driven, with a cubic spring that its model has not."""
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N")
    k, d = m.parameters(k=3.0, d=0.5)
    (force,) = m.quantities(F=u - k * x - d * v)
    m.dynamics(x=v, v=force)
    m.outputs(x=x)
    run = ph.Experiment(T, {"u": np.sign(np.sin(0.7 * T)) * (2.0 + np.sin(0.2 * T))}, name="run")
    hidden = m.with_terms({"F": -2.0 * x**3})
    y = ph.simulate(hidden, {"k": 3.0, "d": 0.5}, run).outputs["x"]
    noise = 0.005 * np.random.default_rng(0).standard_normal(T.size)
    return ph.estimate(m, run.with_outputs({"x": y + noise}))


def test_nothing_of_the_search_is_left() -> None:
    f = fit()
    gc.collect()
    before = {id(o) for o in gc.get_objects() if isinstance(o, (RefitCache, Refit, Linearised))}
    d = ph.diagnose(f)
    gc.collect()
    left = [o for o in gc.get_objects() if isinstance(o, (RefitCache, Refit, Linearised)) and id(o) not in before]
    assert left == []
    assert d.findings[0].cause == "F:x^3"
    assert d.extend().added[0] == "F:x^3" and d.extend().gain.log_likelihood_whitened > 100.0


def test_settings_of_a_search_are_data() -> None:
    """With no findings allowed nothing is searched; what evidence must be is a field of the settings."""
    base = Refit((), fit())
    candidates = [c for c in ph.candidates(base.fit.model, points=base.linear.points) if c.name == "F:x^3"]
    found = Search(base, candidates).run()
    assert [f.candidate.name for f in found.found if f.candidate] == ["F:x^3"] and not found.interrupted
    nothing = Search(base, candidates, settings=SearchSettings(most=0)).run()
    assert nothing.final is base and nothing.found == ()
