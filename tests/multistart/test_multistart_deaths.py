"""Workers that die take nothing with them."""

from __future__ import annotations

import os
import signal
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from many import Deadly, Slow, new_pool, reference, run, told

from phugoid import OptionError
from phugoid.results import Outcome


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
