"""multistart: the same outcomes wherever they run, nothing lost on the way, and which optima there are."""

from __future__ import annotations

import json
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phugoid as ph
from phugoid import DataError, EvaluationError, Experiment, Model, ModelError, OptionError
from phugoid.results import Multistart, Outcome
from phugoid.starts.optima import group
from phugoid.starts.workers import _PROBLEMS

T = np.linspace(0.0, 8.0, 100)
TRUTH = {"tau": 0.8, "a": 2.0}
RANGES = {"tau": (0.2, 3.0), "a": (-4.0, 4.0)}
TRAPEZOID = ph.Collocation(order=2)


def square() -> Model:
    """A lag of which the output knows the gain by its square only: every optimum is there twice."""
    m = Model("lag with a squared gain")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    tau, a = m.parameters(tau=ph.Parameter(1.0, bounds=(0.01, 100.0), unit="s"), a=1.0)
    m.dynamics(x=(u - x) / tau)
    m.outputs(y=(a**2 * x, "m"))
    return m


@cache
def data(seed: int = 0) -> Experiment:
    e = Experiment(T, {"u": np.sign(np.sin(1.3 * T))}, name="run")
    clean = ph.simulate(square(), TRUTH, e, initial={"x": 0.1}).outputs["y"]
    return e.with_outputs({"y": clean + 0.05 * np.random.default_rng(seed).standard_normal(T.size)})


def run(n: int = 6, model: Model | None = None, **options: Any) -> Multistart:
    options = {"ranges": RANGES, "transcription": TRAPEZOID, **options}
    return ph.multistart(model or square(), options.pop("data", data()), n=n, **options)


def told(result: Multistart) -> list[tuple[Any, ...]]:
    """What a run must tell whatever executes it: all but the times."""
    return [(o.index, o.start, o.status, o.log_likelihood, o.parameters, o.iterations) for o in result.outcomes]


@cache
def reference(n: int = 6) -> list[tuple[Any, ...]]:
    return told(run(n))


# Solvers that tests can watch, or that misbehave. They are found again by name in worker processes.


@dataclass(frozen=True)
class Counting(ph.Newton):
    """Writes a byte to a file with each run."""

    regression: bool | None = False
    file: str = ""

    def solve(self, *args: Any, **kwargs: Any) -> Any:
        with open(self.file, "ab") as f:
            f.write(b".")
        return super().solve(*args, **kwargs)


@dataclass(frozen=True)
class Slow(ph.Newton):
    """Takes a while."""

    regression: bool | None = False
    seconds: float = 0.1

    def solve(self, *args: Any, **kwargs: Any) -> Any:
        time.sleep(self.seconds)
        return super().solve(*args, **kwargs)


@dataclass(frozen=True)
class Deadly(ph.Newton):
    """Kills its process: once, as long as the marker file is there; and always, from a start of tau above a limit."""

    regression: bool | None = False
    marker: str = ""
    limit: float = np.inf

    def solve(self, problem: Any, xi: Any, *args: Any, **kwargs: Any) -> Any:
        try:
            os.remove(self.marker)
            os.kill(os.getpid(), signal.SIGKILL)
        except FileNotFoundError:
            pass
        if xi[0] > self.limit:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().solve(problem, xi, *args, **kwargs)


def new_pool(workers: int = 2, **options: Any) -> ProcessPoolExecutor:
    # Not forked: the core may have threads.
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), **options)


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessPoolExecutor]:
    with new_pool() as executor:
        yield executor


@pytest.fixture(scope="module")
def dask() -> Iterator[Executor]:
    """An executor on a local cluster of two processes, which gives a task up at the first death of its worker."""
    distributed = pytest.importorskip("distributed", reason="dask[distributed] is not installed")
    import dask

    settings = {"distributed.scheduler.allowed-failures": 0, "distributed.worker.daemon": True}
    with (
        dask.config.set(settings),
        distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client.get_executor()


@pytest.fixture
def anywhere(request: pytest.FixtureRequest) -> Any:
    """The fixture that a test names in its parameters, or a pool of threads, or nothing."""
    if request.param == "threads":
        with ThreadPoolExecutor(2) as executor:
            yield executor
    else:
        yield request.param and request.getfixturevalue(request.param)


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


# ---------------------------------------------------------------- workers that die


def test_nothing_is_lost_with_a_process_that_dies(tmp_path: Path) -> None:
    (tmp_path / "marker").touch()
    seen: list[Outcome] = []
    with new_pool() as executor:
        result = run(executor=executor, solver=Deadly(marker=str(tmp_path / "marker")), progress=seen.append)
    assert not (tmp_path / "marker").exists()
    assert told(result) == reference()
    assert sorted(o.index for o in seen) == list(range(6))
    (warning,) = result.warnings
    assert "were run again; a fresh pool of the same kind went on" in warning


def test_nothing_is_lost_with_a_process_that_is_killed(tmp_path: Path) -> None:
    seen: list[Outcome] = []

    def kill_one(outcome: Outcome) -> None:
        if not seen:
            os.kill(next(iter(executor._processes)), signal.SIGKILL)
        seen.append(outcome)

    with new_pool() as executor:
        result = run(executor=executor, progress=kill_one, journal=tmp_path / "j", solver=Slow(seconds=0.05))
    assert told(result) == reference()
    assert len((tmp_path / "j").read_bytes().splitlines()) == 1 + 6


@pytest.mark.parametrize("kind", ["processes", "dask"])
def test_a_start_that_kills_its_worker_is_given_up_alone(kind: str, request: pytest.FixtureRequest) -> None:
    executor = new_pool() if kind == "processes" else request.getfixturevalue("dask")
    guilty = max(reference(), key=lambda o: o[1]["tau"])
    try:
        result = run(executor=executor, solver=Deadly(limit=guilty[1]["tau"] - 1e-9))
    finally:
        if kind == "processes":
            executor.shutdown()
    killed = result.outcomes[guilty[0]]
    assert (killed.status, killed.start) == ("killed", guilty[1])
    assert "its worker was lost each time that it ran, at last with no other start in flight" in killed.message
    assert [o for o in told(result) if o[0] != killed.index] == [o for o in reference() if o[0] != killed.index]
    assert "were run again" in result.warnings[0]
    assert f"killed: 1 start(s), number {killed.index}" in result.summary()


def test_nothing_is_lost_with_a_dask_worker_that_dies(dask: Executor, tmp_path: Path) -> None:
    (tmp_path / "marker").touch()
    result = run(executor=dask, solver=Deadly(marker=str(tmp_path / "marker")))
    assert not (tmp_path / "marker").exists()
    assert told(result) == reference()


class Failing(ThreadPoolExecutor):
    """Fails for good after a few tasks, with those in flight."""

    def __init__(self, error: Exception, after: int = 5) -> None:
        super().__init__(2)
        self.error, self.left = error, after

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.left -= 1
        if self.left < 0:
            raise self.error
        return super().submit(fn, *args, **kwargs)


@pytest.mark.parametrize("error", [BrokenExecutor("gone"), RuntimeError("shut down")], ids=["broken", "shut"])
def test_this_process_goes_on_where_no_executor_can(error: Exception) -> None:
    with Failing(error) as executor:
        result = run(executor=executor)
    assert told(result) == reference()
    assert "the rest was run in this process" in result.warnings[-1]
    assert "Warning: " in result.summary()


def die() -> None:
    os._exit(1)


def test_pool_that_never_works_is_said_to_want_a_guard() -> None:
    with new_pool(initializer=die) as executor:
        result = run(2, executor=executor)
    assert told(result) == reference()[:2]
    assert "a fresh pool breaks before it has any start to run" in result.warnings[-1]
    assert "if __name__ == '__main__'" in result.warnings[-1]


def test_executor_that_is_shut_is_refused() -> None:
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(OptionError, match="executor: it takes no work"):
        run(2, executor=executor)


# ---------------------------------------------------------------- interruption


def interrupt_after(count: int) -> Callable[[Outcome], None]:
    left = [count]

    def watch(_: Outcome) -> None:
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt

    return watch


@pytest.mark.parametrize("anywhere", [None, "threads", "pool"], indirect=True)
def test_ctrl_c_returns_the_outcomes_so_far(anywhere: Executor | None) -> None:
    seen: list[Outcome] = []

    def watch(outcome: Outcome) -> None:
        if not seen:
            threading.Timer(0.12, os.kill, (os.getpid(), signal.SIGINT)).start()
        seen.append(outcome)

    result = run(1000, executor=anywhere, solver=Slow(seconds=0.05), progress=watch)
    assert result.status == "interrupted"
    assert {o.index for o in seen} <= {o.index for o in result.outcomes}
    assert 1 <= len(result.outcomes) < 100
    assert all(o.converged for o in result.outcomes)
    assert result.n == 1000
    assert "of 1000 finished; the same call with the same journal goes on" in result.summary()
    assert "interrupted" in repr(result)
    assert result.best.converged


def test_ctrl_c_is_as_ever_afterwards() -> None:
    before = signal.getsignal(signal.SIGINT)
    run(2, progress=interrupt_after(1))
    assert signal.getsignal(signal.SIGINT) is before


# ---------------------------------------------------------------- journal


def lines(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines(keepends=True)


@pytest.mark.parametrize("anywhere", [None, "pool"], indirect=True)
def test_an_interrupted_run_goes_on_from_its_journal(anywhere: Executor | None, tmp_path: Path) -> None:
    path, runs = tmp_path / "starts.jsonl", tmp_path / "runs"
    options: dict[str, Any] = {"journal": path, "solver": Counting(file=str(runs)), "executor": anywhere}
    first = run(6, progress=interrupt_after(3), **options)
    assert (first.status, len(first.outcomes)) == ("interrupted", 3)
    assert len(lines(path)) == 1 + 3
    time.sleep(0.3 if anywhere else 0.0)  # what was in flight ends on its own
    before = runs.stat().st_size
    second = run(6, **options)
    assert (second.status, told(second)) == ("complete", reference())
    assert runs.stat().st_size - before == 3
    third = run(6, **options)
    assert told(third) == reference()
    assert runs.stat().st_size - before == 3
    assert len(lines(path)) == 1 + 6


def test_a_run_that_is_killed_goes_on_from_its_journal(tmp_path: Path) -> None:
    path = tmp_path / "j"
    script = f"""
from test_multistart import *
run(6, journal={str(path)!r}, progress=lambda outcome: outcome.index == 2 and os.kill(os.getpid(), signal.SIGKILL))
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parent)
    assert done.returncode == -signal.SIGKILL
    assert len(lines(path)) == 1 + 3
    seen: list[Outcome] = []
    assert told(run(6, journal=path, progress=seen.append)) == reference()
    assert [o.index for o in seen] == [3, 4, 5]


def test_a_journal_keeps_every_bit(tmp_path: Path) -> None:
    first, second = (run(3, journal=tmp_path / "j") for _ in range(2))
    for one, other in zip(first.outcomes, second.outcomes, strict=True):
        assert vars(one) == vars(other)


def test_more_starts_can_be_asked_of_a_journal_later(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    options: dict[str, Any] = {"journal": tmp_path / "j", "solver": Counting(file=str(runs))}
    run(2, **options)
    assert told(run(6, **options)) == reference()
    assert runs.stat().st_size == 6
    assert told(run(4, **options)) == reference()[:4]
    assert runs.stat().st_size == 6


@pytest.mark.parametrize("kept", [1, 20, -1], ids=["first byte", "some", "all but the end of line"])
def test_a_torn_last_line_is_run_again(kept: int, tmp_path: Path) -> None:
    path = tmp_path / "j"
    run(3, journal=path)
    whole = lines(path)
    path.write_bytes(b"".join(whole[:-1]) + whole[-1][:kept])
    assert told(run(3, journal=path)) == reference()[:3]
    assert [json.loads(line)["index"] for line in lines(path)[1:]] == [0, 1, 2]


def test_a_torn_header_is_written_again(tmp_path: Path) -> None:
    path = tmp_path / "j"
    run(2, journal=path)
    path.write_bytes(lines(path)[0][:30])
    assert told(run(2, journal=path)) == reference()[:2]
    assert told(run(2, journal=path)) == reference()[:2]


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "j"
    run(3, journal=path)
    whole = lines(path)
    path.write_bytes(b"".join([*whole[:2], whole[2][:20] + b"\n", *whole[3:]]))
    with pytest.raises(DataError, match="line 3 is damaged"):
        run(3, journal=path)


def renamed() -> Model:
    return Model.from_json(square().to_json().replace("squared", "second"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": renamed()}, "the model differs"),
        ({"data": data(1)}, "the data of experiment 'run' differ"),
        ({"data": data().with_outputs(data().outputs, name="b")}, "experiment 'b' differ; .* experiment 'run' differ"),
        ({"ranges": {**RANGES, "a": (0.0, 4.0)}}, r"ranges: 'a' is \[-4.0, 4.0\] there and \[0.0, 4.0\] here"),
        ({"ranges": {"a": (-4.0, 4.0)}}, r"ranges: 'tau' is \[0.2, 3.0\] there and absent here"),
        ({"seed": 1}, "seed is 0 there and 1 here"),
        ({"start": {"sigma_y": 0.1}}, "start: 'sigma_y' is absent there and 0.1 here"),
        ({"noise": ph.Gaussian({"y": 0.05})}, "noise: 'y' is absent there"),
        ({"transcription": ph.Collocation(order=3)}, "transcription is .*order=2.* there and .*order=3.* here"),
        ({"solver": ph.Ipopt(tolerance=1e-6)}, "solver is default there and .*1e-06.* here"),
        ({"ranges": None, "starts": [{}]}, "seed is 0 there and none: starts were given here"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_the_journal_of_another_problem_is_refused(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "j"
    run(1, journal=path)
    before = path.read_bytes()
    with pytest.raises(DataError, match=f"belongs to another problem: .*{message}"):
        run(1, journal=path, **change)
    assert path.read_bytes() == before


def test_starts_given_must_be_those_of_the_journal(tmp_path: Path) -> None:
    starts = [{"tau": 0.5, "x": np.zeros(T.size)}, {"tau": 1.5, "x": 0.3}]
    run(None, ranges=None, starts=starts, journal=tmp_path / "j")  # type: ignore[arg-type]
    again = run(1, ranges=None, starts=starts, journal=tmp_path / "j")
    np.testing.assert_array_equal(again.outcomes[0].start["x"], starts[0]["x"])
    starts[0] = {"tau": 0.5, "x": np.ones(T.size)}
    with pytest.raises(DataError, match="start 0 differs"):
        run(2, ranges=None, starts=starts, journal=tmp_path / "j")


def test_threads_and_lines_of_code_have_no_part_in_a_journal(tmp_path: Path) -> None:
    run(2, journal=tmp_path / "j")
    moved = json.loads(square().to_json())
    for entry in (*moved["dynamics"], *moved["outputs"]):
        entry["source"] = "elsewhere.py:1"
    one_thread = ph.Collocation(order=2, threads=1)
    again = run(2, Model.from_json(json.dumps(moved)), transcription=one_thread, journal=tmp_path / "j")
    assert told(again) == reference()[:2]


@pytest.mark.parametrize("text", ["t,y\n0,1\n", "no line end", '{"format": "other"}\n', "[]\n"])
def test_a_file_that_is_no_journal_stays_as_it_is(text: str, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(DataError, match="is no journal of a multistart"):
        run(1, journal=path)
    assert path.read_text() == text


def test_a_journal_of_a_newer_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "j"
    run(1, journal=path)
    path.write_bytes(path.read_bytes().replace(b'"version": 1', b'"version": 2', 1))
    with pytest.raises(DataError, match="has version 2"):
        run(1, journal=path)


def test_a_journal_needs_a_folder(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read and written"):
        run(1, journal=tmp_path / "nowhere" / "j")


# ---------------------------------------------------------------- optima


def outcome(
    index: int, log_likelihood: float, a: float = 1.0, error: float = 1.0, status: str = "converged"
) -> Outcome:
    return Outcome(index, {}, status, "", log_likelihood, {"a": a}, {"a": error})


@pytest.mark.parametrize(
    ("one", "other", "count"),
    [
        (outcome(0, 5.0), outcome(1, 5.0009), 1),
        (outcome(0, 5.0), outcome(1, 5.0011), 2),
        (outcome(0, 5.0, 1.0), outcome(1, 5.0, 1.009), 1),
        (outcome(0, 5.0, 1.0), outcome(1, 5.0, 1.011), 2),
        (outcome(0, 5.0, 1.0, 1e-3), outcome(1, 5.0, 1.001, 1e-3), 2),
        (outcome(0, 5.0, 100.0, np.nan), outcome(1, 5.0, 100.9, np.nan), 1),
        (outcome(0, 5.0, 100.0, np.nan), outcome(1, 5.0, 102.0, np.nan), 2),
        (outcome(0, 5.0, 0.0, np.nan), outcome(1, 5.0, 0.0, np.nan), 1),
        (outcome(0, 5.0), outcome(1, 5.0, status="acceptable"), 1),
        (outcome(0, 5.0), outcome(1, np.nan), 1),
    ],
)
def test_what_counts_as_the_same_optimum(one: Outcome, other: Outcome, count: int) -> None:
    assert len(group([one, other])) == count


def test_optima_come_best_first_with_their_starts() -> None:
    optima = group([outcome(0, 1.0), outcome(1, 3.0, 2.0), outcome(2, 1.0004), outcome(3, 3.0, -2.0), outcome(4, 1.0)])
    assert [(o.log_likelihood, o.count, o.index, o.indices) for o in optima] == [
        (3.0, 1, 1, (1,)),
        (3.0, 1, 3, (3,)),
        (1.0004, 3, 2, (0, 2, 4)),
    ]


@pytest.fixture(scope="module")
def twins() -> Multistart:
    return run(20)


def test_a_gain_known_by_its_square_has_two_optima(twins: Multistart) -> None:
    assert len(twins.optima) == 2
    assert {round(o.parameters["a"]) for o in twins.optima} == {-2, 2}
    assert sum(o.count for o in twins.optima) == 20
    assert twins.success_rate == 1.0
    for optimum in twins.optima:
        assert optimum.index in optimum.indices
        assert abs(optimum.parameters["tau"] - 0.8) < 4 * optimum.std_errors["tau"]
    assert "It is 2 optima with the same log-likelihood" in twins.summary()
    assert len(twins.group(parameters=1e9)) == 1


def sine() -> Model:
    """The frequency of a sine: many optima, and beyond -4 no function to evaluate."""
    m = Model("frequency of a sine, $1")
    (c,) = m.states("c")
    (a,) = m.parameters("a")
    m.dynamics(c=1e-9 * ph.sqrt(a + 4))
    m.outputs(y=ph.sin(a * m.time) + c)
    return m


@pytest.fixture(scope="module")
def rugged() -> Multistart:
    noise = 0.05 * np.random.default_rng(0).standard_normal(T.size)
    e = Experiment(T, outputs={"y": np.sin(2.0 * T) + 0.5 + noise})
    return run(60, sine(), data=e, ranges={"a": (-5.0, 6.0)}, solver=ph.Ipopt(max_iterations=12))


def test_failures_are_outcomes(rugged: Multistart) -> None:
    counts = rugged.counts
    assert set(counts) == {"converged", "iteration limit", "error"}
    assert sum(counts.values()) == 60
    for failed in (o for o in rugged.outcomes if o.status == "error"):
        assert failed.start["a"] < -4
        assert failed.message.startswith("EvaluationError: at the starting point, the equation of c' is not finite")
        assert np.isnan(failed.log_likelihood) and failed.parameters == {}


def test_summary_tells_the_optima_and_the_failures(rugged: Multistart) -> None:
    text = rugged.summary()
    assert str(rugged) == text
    best = rugged.optima[0]
    assert 1 < best.count < 30 and rugged.success_rate == best.count / 60
    assert f"{best.count} of 60 starts ({100 * best.count / 60:.3g} %) reached the best optimum" in text
    assert "evidence that it is the global one, not proof" in text
    assert "starts      60, all finished" in text
    assert "iterations  median " in text
    numbers = [o.index for o in rugged.outcomes if o.status == "error"]
    assert f"error: {len(numbers)} start(s), number {', '.join(map(str, numbers[:12]))}" in text
    assert "the first: EvaluationError" in text
    assert f"and {len(rugged.optima) - 10} more" in text or len(rugged.optima) <= 10


def test_a_single_start_at_the_best_is_no_evidence() -> None:
    assert "there may well be a better one" in run(1).summary()


def test_best_is_the_fit_of_the_best_outcome(rugged: Multistart) -> None:
    best = rugged.best
    assert best.converged and rugged.best is best
    assert best.log_likelihood == pytest.approx(rugged.optima[0].log_likelihood, abs=1e-6)
    assert best.parameters["a"].value == pytest.approx(2.0, abs=4 * best.parameters["a"].std_error)
    assert best.states["c"].shape == (T.size,)


def test_best_leaves_fixed_parameters_and_given_states_alone() -> None:
    document = json.loads(square().to_json())
    document["parameters"][1].update(fixed=True, start=2.0)
    fixed = Model.from_json(json.dumps(document))
    result = run(2, fixed, ranges={"tau": (0.5, 2.0)}, start={"x": np.sin(T)})
    assert result.best.converged
    assert result.best.parameters["a"].value == 2.0
    assert np.isnan(result.outcomes[0].std_errors["a"])


def test_best_without_any_that_converged_says_so() -> None:
    result = run(3, solver=ph.Ipopt(max_iterations=2))
    assert (result.optima, result.success_rate) == ((), 0.0)
    assert result.best.status == "iteration limit"
    assert result.best.log_likelihood == max(o.log_likelihood for o in result.outcomes)
    assert "iteration limit: 3 start(s), number 0, 1, 2" in result.summary()


def test_no_best_where_no_start_led_anywhere() -> None:
    e = Experiment(T, outputs={"y": np.sin(2.0 * T)})
    result = run(3, sine(), data=e, ranges={"a": (-9.0, -5.0)})
    assert result.counts == {"error": 3}
    with pytest.raises(EvaluationError, match="none of the 3 starts led to an estimate"):
        _ = result.best
    assert "error: 3 start(s)" in result.summary()


def test_result_survives_pickling(twins: Multistart) -> None:
    again = pickle.loads(pickle.dumps(twins))
    assert again.summary() == twins.summary()


# ---------------------------------------------------------------- table, figure, progress


def test_table_for_pandas(rugged: Multistart) -> None:
    pytest.importorskip("pandas")
    table = rugged.to_pandas()
    assert list(table.columns)[:6] == ["optimum", "status", "log_likelihood", "iterations", "time", "message"]
    assert list(table.columns)[6:] == ["a", "sigma_y", "std_error_a", "std_error_sigma_y", "start_a"]
    assert table.index.name == "start" and list(table.index) == list(range(60))
    assert (table["optimum"] == 1).sum() == rugged.optima[0].count
    assert table["optimum"].isna().sum() == sum(not o.converged for o in rugged.outcomes)
    assert table["start_a"].tolist() == [o.start["a"] for o in rugged.outcomes]


def test_table_without_pandas_says_what_to_install(twins: Multistart, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ph.MissingDependency, match=r'pip install "phugoid\[pandas\]"'):
        twins.to_pandas()


@pytest.fixture
def pyplot() -> Iterator[Any]:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    yield plt
    plt.close("all")


def plateaus(axis: Any) -> list[tuple[float, float]]:
    """Level and number of starts of each thick line."""
    thick = [line for line in axis.get_lines() if line.get_linewidth() == 4]
    return [(line.get_ydata()[0], float(np.diff(line.get_xdata())[0])) for line in thick]


def test_waterfall_of_two_optima_has_two_plateaus(twins: Multistart, pyplot: Any) -> None:
    figure, axes = twins.plot()
    assert list(axes) == ["gap"] and figure.axes == [axes["gap"]]
    counts = [o.count for o in twins.optima]
    assert [count for _, count in plateaus(axes["gap"])] == counts
    assert [t.get_text() for t in axes["gap"].texts] == [f"{counts[0]} starts", f"×{counts[1]}"]
    assert [level for level, _ in plateaus(axes["gap"])] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_waterfall_shows_every_start_once(rugged: Multistart, pyplot: Any) -> None:
    figure, axes = rugged.plot()
    several = [o for o in rugged.optima if o.count > 1]
    best = rugged.optima[0].log_likelihood
    assert plateaus(axes["gap"]) == [(best - o.log_likelihood, o.count) for o in several]
    ranks: list[float] = []
    for axis in axes.values():
        for dots in (line for line in axis.get_lines() if line.get_linestyle() == "None"):
            ranks += dots.get_xdata().tolist()
    assert ranks == list(range(1, 61))
    rows = [t.get_text() for t in axes["not converged"].get_yticklabels()]
    assert rows == [f"{status}, {count}" for status, count in rugged.counts.items() if status != "converged"]
    assert axes["gap"].get_ylim()[0] < 0 < best - rugged.optima[-1].log_likelihood < axes["gap"].get_ylim()[1]
    assert axes["gap"].texts[0].get_text() == f"{several[0].count} starts"
    figure.canvas.draw()


def test_counts_that_are_written_do_not_overlap(rugged: Multistart, pyplot: Any) -> None:
    figure, axes = rugged.plot()
    boxes = [text.get_window_extent(figure.canvas.get_renderer()) for text in axes["gap"].texts]
    assert len(boxes) >= 3
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_waterfall_without_any_optimum(pyplot: Any) -> None:
    figure, axes = run(2, solver=ph.Ipopt(max_iterations=1)).plot()
    assert list(axes) == ["gap", "not converged"]
    assert axes["gap"].texts[0].get_text() == "no start converged"
    figure.canvas.draw()


def test_progress_function_sees_each_outcome_once(tmp_path: Path) -> None:
    seen: list[Outcome] = []
    result = run(3, progress=seen.append, journal=tmp_path / "j")
    assert tuple(seen) == result.outcomes
    run(4, progress=seen.append, journal=tmp_path / "j")
    assert [o.index for o in seen] == [0, 1, 2, 3]


def test_progress_bar(capfd: pytest.CaptureFixture[str]) -> None:
    result = run(3, progress=True)
    out, err = capfd.readouterr()
    assert out == ""
    assert "lag with a squared gain" in err and "3/3" in err
    assert f"best logL {result.optima[0].log_likelihood:.3f}" in err


def test_quiet_unless_asked(capfd: pytest.CaptureFixture[str]) -> None:
    run(2)
    assert capfd.readouterr() == ("", "")


def test_error_of_the_progress_function_comes_out() -> None:
    def fail(_: Outcome) -> None:
        raise RuntimeError("from the callback")

    with pytest.raises(RuntimeError, match="from the callback"):
        run(2, progress=fail)


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("ranges", "error", "message"),
    [
        ({"Tau": (0, 1)}, ModelError, "'Tau' is no parameter, sigma or state. Did you mean 'tau'?"),
        ({"sigma_x": (0, 1)}, ModelError, "'sigma_x' is no parameter, sigma or state"),
        ({"tau": (2.0, 1.0)}, OptionError, "'tau' from 2 to 1 is reversed"),
        ({"tau": (0.5, np.inf)}, OptionError, "'tau' from 0.5 to inf is not finite"),
        ({"tau": (np.nan, 1.0)}, OptionError, "'tau' from nan to 1 is not finite"),
        ({"tau": (1.0, 1.0)}, OptionError, r"'tau' from 1 to 1 leaves no room: use start=\{'tau': 1\}"),
        ({"tau": 1.0}, OptionError, r"'tau' is a pair of numbers \(low, high\), not 1.0"),
        ({"tau": (1, 2, 3)}, OptionError, "'tau' is a pair of numbers"),
        ({"tau": ("a", "b")}, OptionError, "'tau' is a pair of numbers"),
        ({"tau": (0.0, 1.0)}, ModelError, r"'tau' from 0 to 1 reaches outside its bounds \(0.01, 100\)"),
        ({"tau": (1.0, 101.0)}, ModelError, "'tau' from 1 to 101 reaches outside its bounds"),
        ({"sigma_y": (-1.0, 1.0)}, OptionError, "'sigma_y' starts at -1: a standard deviation is positive"),
        ({}, OptionError, "give \\(low, high\\) by name"),
        ([("tau", 1, 2)], OptionError, "give \\(low, high\\) by name"),
    ],
)
def test_impossible_ranges_are_refused(ranges: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=f"ranges: {message}"):
        run(1, ranges=ranges)


def test_fixed_and_known_are_not_drawn() -> None:
    m = Model("fixed")
    (x,) = m.states("x")
    (a,) = m.parameters(a=ph.Parameter(2.0, fixed=True))
    m.dynamics(x=-a * x)
    m.outputs(x=x)
    e = Experiment(T, outputs={"x": np.exp(-T)})
    with pytest.raises(ModelError, match="ranges: 'a' is fixed at 2: take it out of the ranges, or free it"):
        run(1, m, data=e, ranges={"a": (0.0, 3.0)})
    with pytest.raises(ModelError, match="ranges: 'sigma_x' is known"):
        run(1, m, data=e, ranges={"sigma_x": (0.1, 3.0)}, noise=ph.Gaussian({"x": 0.1}))
    bounded = ph.Gaussian({"x": ph.Sigma(0.1, bounds=(0.05, 1.0))})
    with pytest.raises(ModelError, match="ranges: 'sigma_x' from 0.1 to 3 reaches outside its bounds"):
        run(1, m, data=e, ranges={"sigma_x": (0.1, 3.0)}, noise=bounded)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"n": 0}, OptionError, "n is a whole number from 1, not 0"),
        ({"n": 2.5}, OptionError, "n is a whole number from 1, not 2.5"),
        ({"n": True}, OptionError, "n is a whole number from 1"),
        ({"seed": -1}, OptionError, "seed is a whole number from 0, not -1"),
        ({"seed": None}, OptionError, "seed is a whole number from 0"),
        ({"ranges": None}, OptionError, "give either ranges to draw from, or starts"),
        ({"starts": [{}]}, OptionError, "give either ranges to draw from, or starts"),
        ({"ranges": None, "starts": []}, OptionError, "starts: give a list"),
        ({"ranges": None, "starts": "tau"}, OptionError, "starts: give a list"),
        ({"ranges": None, "starts": [{}], "n": 2}, OptionError, "starts: there are 1, but n = 2"),
        ({"ranges": None, "starts": [{}, 3], "n": 2}, OptionError, "starts: number 1 holds no values by name"),
        ({"ranges": None, "starts": [{"Tau": 1}]}, ModelError, "starts: number 0: .*Did you mean 'tau'"),
        ({"ranges": None, "starts": [{"tau": "x"}]}, ModelError, "number 0: start: 'tau' is 'x', not a finite number"),
        (
            {"ranges": None, "starts": [{"tau": 0.0}]},
            ModelError,
            "number 0: start: 'tau' = 0.0 lies outside its bounds",
        ),
        ({"ranges": None, "starts": [{"sigma_y": -1}]}, ModelError, "number 0: the start of sigma_y is a positive"),
        ({"ranges": None, "starts": [{"x": [1, 2]}]}, DataError, r"number 0: start: state 'x' has shape \(2,\)"),
        ({"executor": 4}, OptionError, r"executor: give a concurrent.futures.Executor, .* not 4"),
        ({"executor": ProcessPoolExecutor}, OptionError, "executor: give a concurrent.futures.Executor"),
        ({"progress": "yes"}, OptionError, "progress is True, False or a function"),
        ({"transcription": 2}, OptionError, "SingleShooting, not 2"),
        ({"noise": 2}, OptionError, "noise is a Gaussian, StudentT, .* not 2"),
        ({"start": 2}, OptionError, "start holds values by name, or is a fit"),
        ({"start": {"b": 2}}, ModelError, "start: 'b' is no parameter, sigma or state"),
        ({"solver": "newton"}, OptionError, "solver is Newton"),
        ({"solver": ph.Ipopt(options={"nonsense": 1})}, OptionError, "Ipopt has no option 'nonsense'"),
        ({"model": "lag"}, ModelError, "the first argument is a Model, not a str"),
        ({"data": [1]}, DataError, "data is an Experiment or a list of them"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_bad_options_are_refused(options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        run(**{"n": 1, **options})


def test_a_client_is_no_executor() -> None:
    class Client:
        get_executor = None

    with pytest.raises(OptionError, match=r"of a Dask client take client\.get_executor\(\)"):
        run(1, executor=Client())


def test_a_fault_of_the_call_comes_out_of_a_worker(pool: ProcessPoolExecutor) -> None:
    with pytest.raises(OptionError, match="Ipopt has no option 'nonsense'"):
        run(3, executor=pool, solver=ph.Ipopt(options={"nonsense": 1}))


def test_an_output_that_the_data_lack_is_named() -> None:
    e = Experiment(T, {"u": np.sin(T)}, {"z": np.sin(T)}, name="run")
    with pytest.raises(DataError, match="experiment 'run' has no output 'y'"):
        run(1, data=e)
