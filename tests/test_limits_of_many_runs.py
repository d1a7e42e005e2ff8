"""A time limit ends whatever consists of many runs with what is done so far. The clock is the tests' own: what counts
is how much is done after the limit."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from linear_case import run
from test_linear_fit import system

import phugoid as ph
from phugoid import solvers
from phugoid.estimation import workers
from phugoid.estimation.starts import Problem


@pytest.fixture
def pass_limit(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """What makes the clock go past every limit."""
    now = [0.0]
    monkeypatch.setattr(solvers, "time", SimpleNamespace(monotonic=lambda: now[0]))
    return lambda: now.__setitem__(0, 1e9)


def after(count: int, then: Callable[[], None]) -> tuple[Callable[[Any], None], list[Any]]:
    """A progress function that does something at the count-th call, and what it was told."""
    told: list[Any] = []

    def progress(what: Any) -> None:
        told.append(what)
        if len(told) == count:
            then()

    return progress, told


def square() -> tuple[ph.Model, ph.Experiment]:
    m = ph.Model("rise")
    (x,) = m.states("x")
    a, b = m.parameters(a=1.5, b=0.8)
    m.dynamics(x=b * (1 - x))
    m.outputs(y=a**2 * x)
    t = np.linspace(0, 5, 60)
    noise = 0.05 * np.random.default_rng(0).standard_normal(60)
    return m, ph.Experiment(t, outputs={"y": 4 * (1 - np.exp(-t)) + noise}, name="run")


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(*square())


@pytest.mark.parametrize("threads", [0, 1])
def test_many_starts(threads: int, pass_limit: Callable[[], None]) -> None:
    progress, told = after(2, pass_limit)
    executor = ThreadPoolExecutor(threads) if threads else None
    m, e = square()
    found = ph.multistart(m, e, {"a": (0.5, 3)}, n=30, progress=progress, time_limit=60, executor=executor)
    assert found.status == "time limit" and 2 <= len(found.outcomes) == len(told) <= 2 + 2 * threads
    assert all(o.converged for o in found.outcomes) and not found.warnings


def test_a_start_cut_short_is_no_outcome(pass_limit: Callable[[], None]) -> None:
    m, e = square()
    problem = Problem(m, (e,), ph.Collocation(), m.noise_model)
    task = ("some key", pickle.dumps(problem), 0, {"a": 1.0}, 0)
    assert workers.run(*task, left=60.0).status == "converged"  # type: ignore[union-attr]
    assert workers.run(*task, left=0.0).status == workers._LATE  # type: ignore[union-attr]


def test_bootstrap(fit: ph.Fit, pass_limit: Callable[[], None]) -> None:
    progress, told = after(5, pass_limit)
    found = fit.bootstrap(50, progress=progress, time_limit=60)
    assert found.status == "time limit" and len(found.estimates) == len(told) == 5 and found.failed == 0


def test_profile(fit: ph.Fit, pass_limit: Callable[[], None]) -> None:
    progress, told = after(1, pass_limit)
    found = fit.profile(progress=progress, time_limit=60)
    assert found.status == "time limit" and len(told) == 1
    assert found["a"].ends == ("found", "missing") and found["b"].ends == ("missing", "missing")
    assert "time limit" in found.summary()


def test_linear_fit(pass_limit: Callable[[], None]) -> None:
    truth = system((-0.3 + 6.0j, -0.5 + 14.0j))
    progress, told = after(2, pass_limit)
    found = ph.linear.fit_linear(system((-0.1 + 5.0j, -0.5 + 17.0j)), run(truth), progress=progress, time_limit=60)
    assert len(told) == 2 and found.log_likelihood == max(line.log_likelihood for line in told)
    assert found.warnings[0].startswith("time limit")


def misfitting() -> tuple[ph.Model, ph.Experiment]:
    m = ph.Model("slow")
    (x,), (u,) = m.states("x"), m.inputs("u")
    (a,) = m.parameters(a=-1.0)
    m.dynamics(x=a * x + u)
    m.outputs(x=x)
    t = np.arange(400) * 0.05
    u_t = np.sin(t) + np.sin(2.7 * t)
    x_t = [0.0]
    for value in u_t[:-1]:
        x_t.append(x_t[-1] + 0.05 * (-x_t[-1] - 0.4 * x_t[-1] ** 3 + value))
    noise = 0.01 * np.random.default_rng(0).standard_normal(400)
    return m, ph.Experiment(t, {"u": u_t}, {"x": np.array(x_t) + noise}, name="run")


@pytest.mark.parametrize("step", [1, 4])
def test_diagnosis(step: int, pass_limit: Callable[[], None]) -> None:
    fit = ph.estimate(*misfitting())
    progress, told = after(step, pass_limit)
    found = ph.diagnose(fit, progress=progress, time_limit=60)
    assert found.interrupted and len(told) == step
    assert any("time limit" in note for note in found.notes) and "nan" not in found.summary()


def test_the_best_plan(pass_limit: Callable[[], None]) -> None:
    m = misfitting()[0]
    made: list[float] = []

    def make(period: float) -> ph.Experiment:
        made.append(period)
        if len(made) == 5:
            pass_limit()
        t = np.arange(100) * 0.1
        return ph.Experiment(t, {"u": np.sin(2 * math.pi * t / period)}, name="sine")

    found = ph.design.optimal_plan(m, make, {"period": (0.5, 20.0)}, noise={"x": 0.1}, time_limit=60)
    assert len(made) == 5 and found.choice["period"] in made
    assert found.warnings == ("time limit: this is the best plan so far",) and "time limit" in found.summary()


def test_process_noise(pass_limit: Callable[[], None]) -> None:
    progress, told = after(2, pass_limit)
    method = ph.FilterError("x", time_limit=60)
    fit = ph.estimate(*misfitting(), transcription=method, progress=progress)
    assert fit.status == "time limit" and len(told) == 2 and fit.iterations == 2
    assert fit.log_likelihood == pytest.approx(told[-1].log_likelihood, rel=1e-12)
    nothing = ph.estimate(*misfitting(), transcription=ph.FilterError("x", time_limit=0))
    assert nothing.status == "time limit" and nothing.parameters["a"].value == -1.0


def test_validation_and_simulation(fit: ph.Fit) -> None:
    m, e = square()
    assert fit.validate(e, time_limit=0).status == "time limit"
    with solvers.Deadline(0).in_force(), pytest.raises(ph.EvaluationError, match="time limit"):
        ph.simulate(m, fit, e)


def test_inner_limits_are_no_longer_than_outer_ones(pass_limit: Callable[[], None]) -> None:
    with solvers.Deadline(10).in_force():
        assert [solvers.Deadline(seconds).left() for seconds in (20, 5, None)] == [10, 5, 10]
        solvers.check_time()
        pass_limit()
        with pytest.raises(solvers.TimeUp):
            solvers.check_time()
    solvers.check_time()


@pytest.mark.parametrize("limit", [-1.0, math.nan, "1 min", True])
def test_what_is_no_time(limit: Any, fit: ph.Fit) -> None:
    m, e = square()
    calls: list[Callable[[], object]] = [
        lambda: ph.multistart(m, e, {"a": (1, 2)}, time_limit=limit),
        lambda: fit.bootstrap(time_limit=limit),
        lambda: fit.profile(time_limit=limit),
        lambda: fit.validate(e, time_limit=limit),
        lambda: ph.diagnose(fit, time_limit=limit),
        lambda: ph.linear.fit_linear(system((-0.3 + 6.0j,)), e, time_limit=limit),
        lambda: ph.design.optimal_plan(m, lambda: e, {}, time_limit=limit),
        lambda: ph.FilterError("x", time_limit=limit),
        lambda: ph.simulate(m, fit, e, time_limit=limit),
    ]
    for call in calls:
        with pytest.raises(ph.OptionError, match="time_limit is a number of seconds from 0"):
            call()
