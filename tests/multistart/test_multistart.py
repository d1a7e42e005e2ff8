"""multistart: the same outcomes wherever they run, from starts that are drawn or given."""

from __future__ import annotations

import pickle
import subprocess
import sys
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from many import RANGES, TRAPEZOID, Slow, T, data, reference, run, square, told

import phugoid as ph
from phugoid.estimation.workers import _PROBLEMS

# ---------------------------------------------------------------- the same everywhere


@pytest.mark.parametrize("anywhere", [None, "threads", "pool", "dask"], indirect=True)
def test_outcomes_do_not_depend_on_the_executor(anywhere: Executor | None) -> None:
    result = run(executor=anywhere)
    assert (result.status, result.warnings) == ("complete", ())
    assert told(result) == reference()
    assert all(o.converged for o in result.outcomes)


def test_a_start_depends_on_its_number_and_the_seed_alone() -> None:
    assert reference(6)[:3] == told(run(3))
    assert told(run(3, ranges=dict(reversed(RANGES.items())))) == told(run(3))
    starts = {str(o.start) for seed in (0, 1) for o in run(3, seed=seed).outcomes}
    assert len(starts) == 6


def test_starts_fill_their_ranges() -> None:
    ranges = {**RANGES, "sigma_y": (0.01, 0.5), "x": (-1.0, 1.0)}
    result = run(40, ranges=ranges, solver=ph.Ipopt(max_iterations=0))
    for name, (low, high) in ranges.items():
        drawn = np.array([o.start[name] for o in result.outcomes])
        assert low <= drawn.min() < low + 0.1 * (high - low)
        assert high >= drawn.max() > high - 0.1 * (high - low)


def test_forked_workers_do_not_wait_for_threads_that_were_not_forked() -> None:
    script = """
import multiprocessing, sys
from concurrent.futures import ProcessPoolExecutor
import numpy as np, phugoid as ph
m = ph.Model("lag")
(x,) = m.states("x"); (u,) = m.inputs("u"); (a,) = m.parameters(a=1.0)
m.dynamics(x=a * (u - x)); m.outputs(x=x)
t = np.linspace(0, 10, 1501)
e = ph.Experiment(t, {"u": t}, {"x": np.sin(t)})
ph.estimate(m, e, solver=ph.Ipopt(max_iterations=1))     # so long a record is evaluated on several threads
with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork")) as pool:
    result = ph.multistart(m, e, {"a": (0.5, 2)}, n=2, solver=ph.Ipopt(max_iterations=1), executor=pool)
print(result.counts)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.stdout == "{'iteration limit': 2}\n", done.stderr


def test_importing_phugoid_loads_no_executors() -> None:
    code = "import sys, phugoid; print('concurrent.futures' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False\n"


# ---------------------------------------------------------------- starts that are given


def test_published_starts_can_be_given() -> None:
    def legacy(i: int) -> dict[str, float]:
        random = np.random.RandomState(i)
        return {"tau": random.uniform(0.2, 3.0), "a": random.uniform(-4.0, 4.0)}

    starts = [legacy(i) for i in range(4)]
    result = run(None, ranges=None, starts=starts)  # type: ignore[arg-type]
    assert [o.start for o in result.outcomes] == starts
    solver = ph.Newton(regression=False)  # that of multistart: the same in every digit
    fit = ph.estimate(square(), data(), start=starts[3], transcription=TRAPEZOID, solver=solver)
    assert result.outcomes[3].parameters == fit.parameters.to_dict()
    assert result.outcomes[3].log_likelihood == fit.log_likelihood
    assert len(run(2, ranges=None, starts=starts).outcomes) == 2


def test_a_function_may_draw_the_starts() -> None:
    def draw(i: int, random: np.random.Generator) -> dict[str, Any]:
        return {"tau": random.lognormal(), "x": np.sin(T + i)}

    result, again = (run(n, ranges=None, starts=draw) for n in (3, 2))
    assert [o.start["tau"] for o in again.outcomes] == [o.start["tau"] for o in result.outcomes[:2]]
    assert len({o.start["tau"] for o in result.outcomes}) == 3


def test_common_start_gives_what_the_ranges_do_not() -> None:
    frozen = ph.Ipopt(max_iterations=0)
    result = run(2, ranges={"tau": (0.5, 2.0)}, start={"a": 1.7, "tau": 9.0}, solver=frozen)
    for outcome in result.outcomes:
        assert outcome.parameters["a"] == pytest.approx(1.7)
        assert outcome.parameters["tau"] == pytest.approx(outcome.start["tau"])
    fit = ph.estimate(square(), data(), transcription=TRAPEZOID)
    result = run(1, ranges={"tau": (0.5, 2.0)}, start=fit, solver=frozen)
    assert result.outcomes[0].parameters["a"] == pytest.approx(fit.parameters["a"].value)


# ---------------------------------------------------------------- tasks


class Spy(ThreadPoolExecutor):
    """Notes what is sent, and how much is in flight."""

    def __init__(self) -> None:
        super().__init__(2)
        self.payloads: list[int] = []
        self.sizes: list[int] = []
        self.flying = 0
        self.most = 0

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.flying += 1
        self.most = max(self.most, self.flying)
        key, payload, *rest = args
        self.payloads.append(len(payload or b""))
        self.sizes.append(len(pickle.dumps(rest)))
        future = super().submit(fn, *args, **kwargs)
        future.add_done_callback(self._landed)
        return future

    def _landed(self, _: Any) -> None:
        self.flying -= 1


def test_tasks_are_small_and_few_in_flight_and_the_data_travel_once_a_worker() -> None:
    with Spy() as spy:
        result = run(20, executor=spy, solver=Slow(seconds=0.01))
    assert len(result.outcomes) == 20
    assert spy.most <= 4
    assert max(spy.sizes) < 200
    assert 1 <= sum(size > 0 for size in spy.payloads) <= 4
    assert max(spy.payloads) > 100 * 8 * 3


def test_a_worker_does_not_collect_problems() -> None:
    with ThreadPoolExecutor(1) as executor:
        for seed in range(6):
            run(1, data=data(seed), executor=executor)
    assert len(_PROBLEMS) <= 4
