"""What simulated rigs share: held steps, an integration in steps shorter than samples, and what a diagnosis names."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import phugoid as ph

_Array = np.ndarray


def steps(rng: np.random.Generator, t: _Array, low: float, high: float, each: float) -> _Array:
    """Return levels that are held for a while, each."""
    levels = rng.uniform(low, high, int(t[-1] / each) + 2)
    return levels[(t / each).astype(int)]


def levels(
    rng: np.random.Generator, t: _Array, low: float, high: float, lasting: tuple[float, float], count: int
) -> _Array:
    """Return so many levels, and one more, that change after random times between two bounds."""
    at = np.cumsum(rng.uniform(*lasting, count))
    return rng.uniform(low, high, count + 1)[np.searchsorted(at, t)]


def integrated(f: Callable[[_Array, float], _Array], x: _Array, t: _Array, u: _Array, finer: int = 4) -> _Array:
    """Return states at the samples, by Runge and Kutta's method, inputs held."""
    h, found = (t[1] - t[0]) / finer, [x]
    for now in u[:-1]:
        for _ in range(finer):
            a = f(x, now)
            b = f(x + h / 2 * a, now)
            c = f(x + h / 2 * b, now)
            x = x + h / 6 * (a + 2 * b + 2 * c + f(x + h * c, now))
        found.append(x)
    return np.array(found)


def named(d: ph.Diagnosis) -> list[ph.results.Finding]:
    """Return the findings that are named."""
    return [f for f in d.findings if f.status == "named"]
