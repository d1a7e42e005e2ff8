"""Runs many starts, here or on an executor: a few in flight at a time, no start lost with a worker that dies, and the
outcomes there after Ctrl-C.

A task is a start and the key of the problem. The problem itself travels only to a worker that does not know the key
yet: it answers None, and the same start is sent again with the problem.

A start whose worker died is run again: first beside others that were in flight with it, and then, if that ends in
another death, alone. What dies alone is to blame itself, and is given up; nothing else ever is.
"""

from __future__ import annotations

import os
import pickle
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import chain
from typing import Any, TypeAlias

from ..errors import OptionError, check_progress
from ..filter_error import FilterError
from ..fit_result import ENDED_WELL, FitResult, dataset
from ..progress import StatusLine, bar, remaining
from ..solvers import Deadline, check_time, interrupts
from ..solvers.newton import Newton
from .starts import Outcome, Problem

__all__ = [
    "NEAR",
    "Crew",
    "Runs",
    "Watch",
    "again",
    "collect",
    "common_to",
    "is_loss",
    "run_all",
]

# Wake up so often (s), since on some systems Ctrl-C does not interrupt a wait.
_POLL = 0.5
# Ask a cluster so often (s) how large it is.
_CENSUS = 2.0
# The pool fails its tasks within moments once it is broken; and a fresh pool starts its first worker (s).
_BREAKING, _STARTING = 10.0, 60.0
# Deaths after which a start runs alone, and is given up if it dies again.
_ALONE = 2

# Status of a run that the limit of the whole cut short: it is not an outcome.
_LATE = "out of time"
_KEPT = 4
_PROBLEMS: dict[str, Problem] = {}
"""In a worker: the problems that it knows, by key."""


def run(
    key: str, payload: bytes | None, index: int, start: Mapping[str, Any], ticket: int, left: float | None = None
) -> Outcome | None:
    """Run a task; return None where the worker does not have the problem and was not sent it.

    ``left``: seconds that it may take.
    ``ticket`` makes every task differ: Dask takes equal ones for the same, and answers from memory.
    """
    problem = _PROBLEMS.get(key)
    if problem is None:
        if payload is None:
            return None
        problem = pickle.loads(payload)
        if len(_PROBLEMS) >= _KEPT:
            _PROBLEMS.clear()
        _PROBLEMS[key] = problem
    with Deadline(left).in_force() as deadline:
        outcome: Outcome = problem.outcome(index, start)
    return replace(outcome, status=_LATE) if _cut(outcome) and deadline.passed() else outcome


def _cut(outcome: Outcome) -> bool:
    """Return whether a run ended early, by its own solver's limit or by that of the whole."""
    return outcome.status in ("interrupted", "time limit")


@dataclass
class _StartTask:
    index: int
    start: Mapping[str, Any]
    deaths: int = 0
    carries: bool = False  # the problem


class Crew:
    """Runs starts of a problem on an executor (None: in this process).

    Raises OptionError for what is not an executor, or one that takes no work.
    """

    def __init__(self, executor: Any, problem: Problem) -> None:
        if executor is not None and not isinstance(executor, Executor):
            hint = "; of a Dask client take client.get_executor()" if hasattr(executor, "get_executor") else ""
            raise OptionError(
                f"executor: give a concurrent.futures.Executor, such as ProcessPoolExecutor(), not {executor!r}{hint}"
            )
        self.executor: Executor | None = executor
        self.problem = problem
        self._ours = False
        self._heard = False
        self._run_again: set[int] = set()
        self._ended = ""
        self._fresh: Iterator[_StartTask] = iter(())
        self._waiting: tuple[deque[_StartTask], ...] = (deque(), deque(), deque())  # by deaths
        self._flying: dict[Future[Outcome | None], _StartTask] = {}
        self._tickets = 0
        self._size, self._counted = 0, -_CENSUS

    @property
    def warnings(self) -> tuple[str, ...]:
        """What went wrong with workers, in words."""
        found = []
        if self._run_again:
            again = f"{len(self._run_again)} start(s) were in flight and were run again"
            pool = "a fresh pool of the same kind went on" if self._ours else "the executor went on"
            where = pool if not self._ended else "the executor did not recover"
            found.append(f"worker processes died: {again}; {where}")
        if self._ended:
            found.append(f"the executor took no more work ({self._ended}): the rest was run in this process")
        return tuple(found)

    def outcomes(self, starts: Iterable[tuple[int, Mapping[str, Any]]]) -> Generator[Outcome, None, None]:
        """Yield the outcomes as they come in. At Ctrl-C, and at the time limit, yields those that are there, and then
        raises KeyboardInterrupt."""
        self._fresh = (_StartTask(index, start) for index, start in starts)
        try:
            if self.executor is not None:
                payload = pickle.dumps(self.problem.single_threaded(), pickle.HIGHEST_PROTOCOL)
                yield from self._there(payload, sha256(payload).hexdigest())
            yield from self._here()
        except KeyboardInterrupt:
            for future in self._flying:
                future.cancel()
            with interrupts():
                there = [f for f in self._flying if f.done() and not f.cancelled() and f.exception() is None]
                landed = [outcome for future in there if (outcome := self._land(future)) is not None]
            yield from landed
            raise
        finally:
            idle = not self._flying
            for future in self._flying:
                future.cancel()
            self._dismiss(wait=idle)

    def _here(self) -> Iterator[Outcome]:
        """Run what is left in this process; last what was in flight when a worker died."""
        for task in chain(self._waiting[0], self._fresh, self._waiting[1], self._waiting[2]):
            check_time()
            outcome = self.problem.outcome(task.index, task.start)
            if _cut(outcome):
                check_time()
            if outcome.status == "interrupted":
                raise KeyboardInterrupt
            yield outcome

    def _there(self, payload: bytes, key: str) -> Iterator[Outcome]:
        """Run on the executor, until all is done or it takes no more."""
        deadline = Deadline(None)
        while True:
            check_time()
            broken = self._submit(payload, key)
            if not broken:
                if not self._flying:
                    return
                left = deadline.left()
                poll = _POLL if left is None else min(_POLL, left)
                done, _ = wait(self._flying, timeout=poll, return_when=FIRST_COMPLETED)
                broken = any(isinstance(_failure(f), BrokenExecutor) for f in done)
            if broken:
                wait(self._flying, timeout=_BREAKING)
                done = set(self._flying)
            for future in done:
                outcome = self._land(future)
                if outcome is not None:
                    yield outcome
            if broken:
                self._replace()

    def _submit(self, payload: bytes, key: str) -> bool:
        """Send tasks up to the limit; return whether the executor turned out to be broken."""
        while self.executor is not None and (task := self._next()):
            self._tickets += 1
            carried = payload if task.carries else None
            left = Deadline(None).left()
            try:
                future = self.executor.submit(run, key, carried, task.index, task.start, self._tickets, left)
            except Exception as error:
                self._waiting[task.deaths].appendleft(task)
                if isinstance(error, BrokenExecutor):
                    return True
                if not self._heard and not self._flying:
                    raise OptionError(f"executor: it takes no work ({error}); give one that is open") from error
                self._end(f"{type(error).__name__}: {error}")
            else:
                self._flying[future] = task
        return False

    def _next(self) -> _StartTask | None:
        """Return the next task to send, if one more may be in flight. Those with more deaths behind them come first."""
        deaths = next((k for k in (2, 1) if self._waiting[k]), 0)
        limit = 1 if deaths == _ALONE else self._workers() * (1 if deaths else 2)
        if len(self._flying) >= limit or any(t.deaths != deaths for t in self._flying.values()):
            return None
        waiting = self._waiting[deaths]
        return waiting.popleft() if waiting else next(self._fresh, None)

    def _workers(self) -> int:
        """Return how many starts the executor runs at a time."""
        fixed = getattr(self.executor, "_max_workers", None)
        if isinstance(fixed, int):
            return max(fixed, 1)
        now = time.monotonic()
        if now - self._counted >= _CENSUS:
            self._counted = now
            client = getattr(self.executor, "_client", None)  # Dask's
            try:
                self._size = sum(client.nthreads().values())  # type: ignore[union-attr]
            except Exception:
                self._size = 0
        return self._size or os.cpu_count() or 1

    def _land(self, future: Future[Outcome | None]) -> Outcome | None:
        """Return the outcome of a task that is done; None where it goes back among those that wait."""
        task = self._flying.pop(future)
        error = _failure(future)
        if error is None:
            outcome = future.result()
            if outcome is None:
                task.carries = True
                self._waiting[task.deaths].appendleft(task)
                return None
            if outcome.status == _LATE:
                self._waiting[task.deaths].appendleft(task)
                return None
            if outcome.status != "interrupted":
                self._heard = True
                return outcome
            error = CancelledError("the worker was interrupted")
        elif not is_loss(error):
            raise error
        self._run_again.add(task.index)
        if task.deaths == _ALONE:
            message = "its worker was lost each time that it ran, at last with no other start in flight"
            return Outcome(task.index, task.start, "killed", f"{message} ({type(error).__name__}: {error})")
        # Dask has tried several times when it says so.
        task.deaths = _ALONE if type(error).__name__ == "KilledWorker" else task.deaths + 1
        task.carries = False
        self._waiting[task.deaths].append(task)
        return None

    def _replace(self) -> None:
        """Return a new pool in place of the broken one, if it works."""
        fresh = again(self.executor)
        self._dismiss(wait=False)
        if fresh is None:
            self._end("it is broken, and no other of its kind could be made")
            return
        self.executor, self._ours = fresh, True
        try:
            fresh.submit(os.getpid).result(timeout=_STARTING)
        except Exception as error:
            self._end(
                f"a fresh pool breaks before it has any start to run: {type(error).__name__}; does the script start "
                "its work under if __name__ == '__main__'?"
            )

    def _end(self, why: str) -> None:
        self._dismiss(wait=False)
        self.executor, self._ended = None, why

    def _dismiss(self, wait: bool) -> None:
        """Shuts the pool, if it is ours."""
        if self._ours and self.executor is not None:
            self.executor.shutdown(wait=wait, cancel_futures=True)


def _failure(future: Future[Any]) -> BaseException | None:
    """Why a task gave no result."""
    if not future.done():
        return BrokenExecutor("no answer")
    return CancelledError("cancelled") if future.cancelled() else future.exception()


def is_loss(error: BaseException) -> bool:
    """Return whether an error concerns the worker rather than the task."""
    lost = (BrokenExecutor, CancelledError, KeyboardInterrupt, SystemExit)
    return isinstance(error, lost) or type(error).__module__.partition(".")[0] == "distributed"


def again(executor: Executor | None) -> Executor | None:
    """Another pool of processes like the one given; None for any other executor."""
    from concurrent.futures import ProcessPoolExecutor

    if not isinstance(executor, ProcessPoolExecutor):
        return None
    names = ("max_workers", "mp_context", "initializer", "initargs", "max_tasks_per_child")
    options = {name: getattr(executor, f"_{name}", None) for name in names}
    try:
        return type(executor)(**{name: value for name, value in options.items() if value})
    except Exception:
        return None


Watch: TypeAlias = Callable[[Outcome], None]


def collect(
    crew: Crew,
    work: Iterable[tuple[int, Mapping[str, Any]]],
    progress: bool | Watch,
    title: str,
    total: int,
    *,
    known: Mapping[int, Outcome] | None = None,
    keep: Watch | None = None,
    best: bool = False,
) -> dict[int, Outcome]:
    """Return the outcomes by number, in order; Ctrl-C and the time limit end the work with the outcomes so far.

    ``known``: outcomes that are there already, among ``total``. ``keep`` is called with each new one before it is
    shown. ``best``: the bar shows the greatest log-likelihood.
    """
    done = dict(known or {})
    with _watching(progress, title, total, tuple(done.values()), best) as watch, closing(crew.outcomes(work)) as coming:
        try:
            for outcome in coming:
                if keep is not None:
                    keep(outcome)
                done[outcome.index] = outcome
                watch(outcome)
        except KeyboardInterrupt:
            with interrupts():  # one more, while workers are dismissed, loses nothing
                coming.close()
    return {i: done[i] for i in sorted(done)}


@contextmanager
def _watching(progress: bool | Watch, title: str, total: int, done: tuple[Outcome, ...], best: bool) -> Iterator[Watch]:
    """Return what is called with each outcome: nothing, our bar, or the user's own function."""
    if callable(progress):
        yield progress
        return
    if not progress:
        yield lambda outcome: None
        return
    reached = [o.log_likelihood for o in done if o.at_optimum]
    line, began, count = StatusLine(), time.monotonic(), len(done)
    every = 1 if line.is_overwritten else max(total // 10, 1)

    def advance(outcome: Outcome) -> None:
        nonlocal count
        count += 1
        if outcome.at_optimum:
            reached[:] = [max([*reached, outcome.log_likelihood])]
        if count % every == 0 or count == total:
            left = remaining(began, count - len(done), total - len(done))
            good = f"best logL {reached[0]:.3f}" if best and reached else ""
            line.show("  ".join(part for part in (title, bar(count, total), left, good) if part))

    try:
        yield advance
    finally:
        line.keep()


NEAR = Newton(regression=False)
"""The solver: the path is known, so there is no need of a regression on measured states."""


@dataclass(frozen=True)
class Runs:
    """What came of the runs: outcomes by number, "complete" where all are there or else why not, and what went wrong
    with workers."""

    outcomes: Mapping[int, Outcome]
    status: str
    warnings: tuple[str, ...]


def common_to(fit: FitResult, caller: str) -> dict[str, Any]:
    """Return what all runs share, as `Problem` takes it. Raises OptionError where they cannot share it."""
    if fit.status not in ENDED_WELL:
        raise OptionError(f"{caller}: the fit has not converged ({fit.status}): {fit.message or 'see its summary'}")
    if all(e.fixed for e in fit.parameters.values()):
        raise OptionError(f"{caller}: the fit has no free parameters")
    filtered = fit.transcription if isinstance(fit.transcription, FilterError) else None
    return {
        "model": fit.model,
        "experiments": tuple(dataset(fit)),
        # The time limit of the filter-error method was that of the fit itself.
        "transcription": replace(filtered, time_limit=None) if filtered else fit.transcription,
        "noise": fit.noise,
        "solver": None if filtered else NEAR,  # which has its own
        "base": replace(fit, history=()),
    }


def run_all(
    problem: Problem,
    starts: Sequence[Mapping[str, Any]],
    executor: Any,
    progress: bool | Watch,
    caller: str,
    deadline: Deadline,
) -> Runs:
    """Run all starts; Ctrl-C and the deadline end it with the outcomes so far."""
    check_progress(caller, progress)
    crew = Crew(executor, problem)
    with deadline.in_force():
        done = collect(crew, enumerate(starts), progress, f"{problem.model.name}: {caller}", len(starts))
    return Runs(done, "complete" if len(done) == len(starts) else deadline.ended(), crew.warnings)
