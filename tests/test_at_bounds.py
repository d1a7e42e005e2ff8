"""Estimates that end at bounds: a warning names all of them, and one that is there only since another one was held."""

from __future__ import annotations

import numpy as np

import phugoid as ph


def decay(**bounds: tuple[float, float]) -> ph.Fit:
    """Estimate sums of two exponentials from data whose rates lie beyond some of the bounds."""
    t = np.linspace(0, 3, 61)
    noise = 0.01 * np.random.default_rng(0).standard_normal((2, t.size))
    m = ph.Model("decay")
    x, y = m.states("x y")
    a, b = m.parameters(**{n: ph.Parameter(float(np.mean(bounds[n])), bounds=bounds[n]) for n in "ab"})
    m.dynamics(x=-a * x, y=-b * y)
    m.outputs(x=x, y=y)
    return ph.estimate(m, ph.Experiment(t, {}, {"x": np.exp(-2 * t) + noise[0], "y": np.exp(-t) + noise[1]}))


def test_all_parameters_at_bounds_are_named() -> None:
    both = [w for w in decay(a=(0.1, 1.5), b=(1.2, 3.0)).warnings if "bound" in w]
    assert len(both) == 1 and "a lies at its upper bound 1.5, b at its lower bound 1.2" in both[0]
    one = [w for w in decay(a=(0.1, 1.5), b=(0.1, 3.0)).warnings if "bound" in w]
    assert len(one) == 1 and one[0].startswith("a lies at its upper bound 1.5: it has no standard error")
    assert not any("bound" in w for w in decay(a=(0.1, 9.0), b=(0.1, 3.0)).warnings)


def test_a_parameter_beside_one_that_was_held_is_named_with_it() -> None:
    """Only the product of k and s shows: with one held at 1, the other cannot reach the product 5 within its bounds."""
    t = np.linspace(0, 3, 61)
    m = ph.Model("product")
    (x,) = m.states("x")
    k, s = m.parameters(k=ph.Parameter(1.0, bounds=(0.1, 2.0)), s=ph.Parameter(1.0, bounds=(0.1, 2.0)))
    m.dynamics(x=-x)
    m.initial(x=1.0)
    m.outputs(y=k * s * x)
    noisy = 5 * np.exp(-t) + 0.01 * np.random.default_rng(1).standard_normal(t.size)
    fit = ph.estimate(m, ph.Experiment(t, {}, {"y": noisy}))
    held = next(n for n, e in fit.parameters.items() if n in "ks" and not e.bounds_active)
    other = "k" if held == "s" else "s"
    (text,) = [w for w in fit.warnings if "bound" in w]
    assert f"{other} lies at its upper bound" in text
    assert f"{other} may be there only because {held}, which no output tells, was held at 1" in text
