"""A diagnosis of records whose inputs change faster than their samples tell."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import phugoid as ph
from phugoid.discrepancy.search.recorded_input import sampled_inputs
from phugoid.discrepancy.search.refit import Refit
from phugoid.sensitivities.tangents import collocated

FINE, EACH = 0.01, 8  # s, and of how many samples one is kept


def mass(friction: float = 0.0) -> ph.Model:
    """A mass on a spring, with dry friction where it has any."""
    m = ph.Model("mass")
    (u,), (x, v) = m.inputs("u"), m.states(x="m", v="m/s")
    k, c = m.parameters(k=4.0, c=0.7)
    m.dynamics(x=v, v=u - k * x - c * v - (friction * ph.tanh(v / 0.02) if friction else 0.0))
    m.outputs(x=x, v=v)
    return m


def steps(seed: int, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Steps of any size, at any time between samples, no two of them within half a second."""
    rng = np.random.default_rng(seed)
    times = 1.0 + 2.4 * np.arange(24) + rng.uniform(0.0, 1.9, 24)
    levels = np.r_[0.0, rng.uniform(0.8, 2.0, 24) * np.resize([1.0, -1.0], 24)]
    return np.asarray(levels[np.searchsorted(times, t, side="right")])


def sweep(seed: int, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """A sine sweep up to 1.5 Hz, where 12.5 Hz is 8 samples a period."""
    return np.asarray(1.5 * np.sin(2.0 * np.pi * (0.1 * t + 0.5 * 1.4 / 60.0 * t**2) + seed))


def record(u: NDArray[np.float64], seed: int, friction: float = 0.0, each: int = EACH) -> ph.Experiment:
    """A record of every ``each``-th sample."""
    t = FINE * np.arange(u.size)
    run = ph.simulate(mass(friction), {"k": 4.0, "c": 0.7}, ph.Experiment(t, {"u": u}), initial={"x": 0.0, "v": 0.0})
    rng = np.random.default_rng(100 + seed)
    noise = {
        n: z + s * rng.standard_normal(t.size) for (n, z), s in zip(run.outputs.items(), (2e-3, 5e-3), strict=True)
    }
    return ph.Experiment(t[::each], {"u": u[::each]}, {n: y[::each] for n, y in noise.items()}, name=f"record {seed}")


T = FINE * np.arange(6001)


def test_the_time_of_a_step_between_two_samples_is_estimated() -> None:
    u = steps(1, T)
    run = record(u, 1)
    found = sampled_inputs(Refit((), collocated(ph.estimate(mass(), run))))
    assert found is not None and found.jumps["u"] > 15
    intervals = found.intervals[0]["u"]
    truth = []
    for k in intervals:
        within = u[k * EACH : (k + 1) * EACH + 1]
        area = np.trapezoid(within - np.linspace(within[0], within[-1], within.size)) / EACH
        truth.append(2.0 * area / abs(within[-1] - within[0]))
    error = found.marginal.coefficients - np.array(truth)
    assert np.std(truth) > 0.3
    assert np.all(np.abs(error) < 4.0 * found.marginal.deviations + 0.02)
    assert np.median(found.marginal.deviations) < 0.1
    assert 0.1 < found.marginal.variance < 0.8  # 1/3 where steps come at any time
    assert found.on([], None) == []  # a diagnosis without data held out


@pytest.mark.parametrize("seed", [11, 21])
def test_inputs_sampled_slowly_are_no_disturbance(seed: int) -> None:
    """It was called noise on the input, or on the acceleration."""
    first, second = (record(steps(s, T), s) for s in (seed, seed + 1))
    d = ph.diagnose(ph.estimate(mass(), first), validation=second)
    assert not d.findings and d.verdict == "nothing", d.summary()
    assert any("u in" in note and "faster than they were sampled" in note for note in d.notes)


def test_a_cause_is_found_beside_inputs_sampled_slowly() -> None:
    first, second = (record(steps(s, T), s, friction=0.15) for s in (31, 32))
    d = ph.diagnose(ph.estimate(mass(), first), validation=second)
    (f,) = [f for f in d.findings if f.status == "named"]
    assert "v':sign(v)" in (f.cause, *f.aliases), d.summary()
    assert abs(f.coefficient + 0.15) < 4.0 * f.std_error, d.summary()


def test_smooth_inputs_sampled_slowly_are_joined_by_splines() -> None:
    first, second = (record(sweep(s, T), s) for s in (41, 42))
    d = ph.diagnose(ph.estimate(mass(), first), validation=second)
    assert not d.findings and d.verdict == "nothing", d.summary()
    assert any("u is smooth between its samples" in note for note in d.notes)


def test_inputs_that_are_sampled_well_are_left_alone() -> None:
    u = np.repeat(steps(51, T[::EACH]), EACH)[: T.size]  # steps at samples, ramps of one fine step
    u = np.interp(T, T[::EACH], u[::EACH])
    d = ph.diagnose(ph.estimate(mass(), record(u, 51)), validation=record(u, 52))
    assert not d.findings, d.summary()
    assert not any("faster than" in note or "smooth between" in note for note in d.notes)
