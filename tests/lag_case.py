"""A first-order lag and a record of it, for tests of files."""

from __future__ import annotations

import numpy as np

import phugoid as ph

T = 0.1 * np.arange(60)


def lag() -> ph.Model:
    m = ph.Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="N")
    (a,) = m.parameters(a=1.0)
    m.dynamics(x=a * (u - x))
    m.outputs(x=x)
    return m


def record() -> ph.Experiment:
    e = ph.Experiment(T, {"u": np.sin(2 * T)})
    x = ph.simulate(lag(), {"a": 1.5}, e).outputs["x"]
    return e.with_outputs({"x": x + 0.02 * np.random.default_rng(1).standard_normal(T.size)})
