"""A small system with coloured noise, for tests of uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

import phugoid as ph

TRUE = {"k": 4.0, "c": 1.0, "b": 2.0}
SIGMA = {"x": 0.05, "v": 0.1}


def model() -> ph.Model:
    """A driven oscillator: two outputs, three parameters."""
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs("u")
    k, c, b = m.parameters(**TRUE)
    m.dynamics(x=v, v=-k * x - c * v + b * u)
    m.outputs(x=x, v=v)
    return m


def clean(n: int, name: str = "run") -> ph.Experiment:
    """A manoeuvre and what the true system does."""
    return _clean(n).with_outputs(_clean(n).outputs, name)


@cache
def _clean(n: int) -> ph.Experiment:
    t = 0.05 * np.arange(n)
    u = np.zeros(n)
    for begin, end, sign in ((1, 4, 1), (4, 6, -1), (6, 7, 1), (7, 8, -1), (10, 11.5, 1), (13, 13.7, -1)):
        u[(t >= begin) & (t < end)] += sign
    run = ph.Experiment(t, {"u": u})
    return run.with_outputs(ph.simulate(model(), TRUE, run, initial={"x": 0.0, "v": 0.0}).outputs)


def autoregressive(rho: float, shocks: np.ndarray) -> np.ndarray:
    """Of variance 1, from white noise (n + 200,): (n,) of an AR(1) process."""
    out = shocks.copy()
    for i in range(1, out.size):
        out[i] = rho * out[i - 1] + np.sqrt(1 - rho**2) * shocks[i]
    return out[200:]


def measured(
    n: int, rho: Sequence[float], seed: int, common: float = 0.0, name: str = "run", size: float = 1.0
) -> ph.Experiment:
    """With noise of lag-one correlations ``rho``; innovations of the outputs are correlated by ``common``."""
    run, random = clean(n, name), np.random.default_rng(seed)
    shocks = random.standard_normal((2, n + 200))
    shocks[1] = common * shocks[0] + np.sqrt(1 - common**2) * shocks[1]
    noise = {o: size * SIGMA[o] * autoregressive(r, w) for o, r, w in zip(SIGMA, rho, shocks, strict=True)}
    return run.with_outputs({o: run.output(o) + noise[o] for o in SIGMA})


def covered(values: Mapping[str, float], errors: Mapping[str, float]) -> list[bool]:
    """Of each parameter, whether its true value lies within 1.96 standard errors."""
    return [abs(values[n] - TRUE[n]) <= 1.96 * errors[n] for n in TRUE]
