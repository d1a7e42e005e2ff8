"""Sends the parts of a fleet to an executor, and again where a worker was lost."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import phugoid._core as _core

from ..errors import DataError, OptionError
from ..estimation.workers import again, is_loss
from ..solvers import Deadline
from .worker import Part, Spec, Trial, first_estimate, work

__all__ = ["FleetCrew", "Stopped", "of_executors", "workers_of"]

# Wake up so often (s), since on some systems Ctrl-C does not interrupt a wait.
_POLL = 0.2
# A task that was lost so often is to blame itself.
_DEATHS = 4


class Stopped(Exception):
    """The user or the time limit ended the work."""


def of_executors(executor: Any) -> list[Executor]:
    """Return executors from one, from a Dask client, or from a list of executors.

    Raises OptionError for anything else.
    """
    if hasattr(executor, "get_executor"):
        executor = executor.get_executor(pure=False, retries=_DEATHS)
    found = list(executor) if isinstance(executor, (list, tuple)) else [executor]
    if not found or not all(isinstance(e, Executor) for e in found):
        raise OptionError(
            "estimate: executor is a concurrent.futures.Executor, a list of these, or a client of Dask, "
            f"not {executor!r}"
        )
    return found


def workers_of(executors: Sequence[Executor]) -> int:
    """Return how many tasks the executors run at a time."""

    def of(executor: Executor) -> int:
        client = getattr(executor, "_client", None)  # Dask's
        if client is not None:
            return max(len(client.nthreads()), 1)
        fixed = getattr(executor, "_max_workers", None)
        return max(fixed, 1) if isinstance(fixed, int) else 1

    return sum(of(e) for e in executors)


@dataclass
class _PartTask:
    part: int
    carries: bool = False
    deaths: int = 0


class FleetCrew:
    """Evaluates trials of all parts. A part goes to the executor, and on a Dask cluster to the worker, where it was
    before, which has its records and paths; to another one where that is lost.

    spec   what all workers need to know.
    parts  the records, divided.
    """

    def __init__(
        self, executors: Sequence[Executor], spec: Spec, parts: Sequence[Part], pressed: Callable[[], int]
    ) -> None:
        self._executors = list(executors)
        self._ours: set[int] = set()
        self._payload = pickle.dumps(spec, pickle.HIGHEST_PROTOCOL)
        try:
            self._parts = [pickle.dumps(p, pickle.HIGHEST_PROTOCOL) for p in parts]
        except (AttributeError, TypeError, pickle.PicklingError) as error:
            raise DataError(
                f"estimate: a record's source cannot be pickled ({error}); give a function of a module, or "
                "functools.partial of one"
            ) from error
        self._key = sha256(self._payload + b"".join(sha256(p).digest() for p in self._parts)).hexdigest()
        self._pressed = pressed
        self._ticket = 0
        self._sent: set[int] = set()
        self._lost = 0

    @property
    def warnings(self) -> tuple[str, ...]:
        """What went wrong with workers, in words."""
        if not self._lost:
            return ()
        return (f"workers were lost: {self._lost} task(s) were run again, and nothing is missing",)

    def first(self, runs: Sequence[Any], start: Mapping[str, float] | None) -> Mapping[str, Any]:
        """Return the first estimate from a few records, made by a worker."""

        def send(task: _PartTask) -> Future[Any]:
            executor = self._executors[0]
            return executor.submit(first_estimate, self._payload, runs, start, _core.__version__, self._number())

        found: Mapping[str, Any] = next(self._all([_PartTask(0)], send))[1]
        return found

    def evaluate(self, trial: Trial, parts: Sequence[int] | None = None) -> Iterator[Mapping[str, Any]]:
        """Yield the answers of all parts, or of some, in the order in which they come."""
        numbers = range(len(self._parts)) if parts is None else parts
        tasks = [_PartTask(k, carries=k not in self._sent) for k in numbers]

        def send(task: _PartTask) -> Future[Any]:
            carried = (self._payload, self._parts[task.part]) if task.carries else (None, None)
            executor = self._executors[task.part % len(self._executors)]
            arguments = (self._key, carried[0], task.part, carried[1], trial, _core.__version__, self._number())
            return executor.submit(work, *arguments, **self._where(executor, task.part))

        for part, found in self._all(tasks, send):
            self._sent.add(part)
            yield {**found, "part": part}

    def close(self) -> None:
        """Shut the pools that were made in place of broken ones."""
        for k in self._ours:
            self._executors[k].shutdown(wait=False, cancel_futures=True)

    def _number(self) -> int:
        self._ticket += 1
        return self._ticket

    @staticmethod
    def _where(executor: Executor, part: int) -> dict[str, Any]:
        """Return what tells a Dask cluster which worker has the part: the same one as long as there are the same."""
        client = getattr(executor, "_client", None)
        if client is None:
            return {}
        addresses = sorted(client.nthreads())
        if not addresses:
            return {}
        return {"workers": [addresses[part % len(addresses)]], "allow_other_workers": True}

    def _all(self, tasks: Sequence[_PartTask], send: Callable[[_PartTask], Future[Any]]) -> Iterator[tuple[int, Any]]:
        """Yield part and answer of each task, in the order in which they come.

        Raises Stopped at Ctrl-C and at the time limit, OptionError where the workers do not serve.
        """
        waiting, flying = list(tasks), dict[Future[Any], _PartTask]()
        try:
            while waiting or flying:
                if self._pressed() or Deadline(None).passed():
                    raise Stopped
                broken = False
                while waiting and not broken:
                    try:
                        flying[send(waiting[-1])] = waiting[-1]
                        waiting.pop()
                    except BrokenExecutor:
                        broken = True
                    except RuntimeError as closed:
                        raise OptionError(
                            f"estimate: executor takes no work ({closed}); give one that is open"
                        ) from closed
                done, _ = wait(flying, timeout=0 if broken else _POLL, return_when=FIRST_COMPLETED)
                for future in done:
                    task = flying.pop(future)
                    error = future.exception()
                    if error is None:
                        found = future.result()
                        if found is None:
                            task.carries = True
                            waiting.append(task)
                            continue
                        if "wrong" in found:
                            raise OptionError(f"estimate: worker {found['worker']} {found['wrong']}; install the same")
                        yield task.part, found
                        continue
                    broken |= isinstance(error, BrokenExecutor)
                    waiting.append(self._again(task, error))
                if broken:
                    waiting.extend(self._again(task, BrokenExecutor()) for task in flying.values())
                    flying.clear()
                    self._replace()
        except KeyboardInterrupt:
            raise Stopped from None
        finally:
            for future in flying:
                future.cancel()

    def _again(self, task: _PartTask, error: BaseException) -> _PartTask:
        """Return the task to be sent once more. Raises OptionError where that makes no sense."""
        if isinstance(error, ModuleNotFoundError):
            raise OptionError(
                f"estimate: a worker lacks what it needs ({error}); install phugoid {_core.__version__} and what the "
                "sources of the records import on all workers"
            ) from error
        if not is_loss(error):
            raise error
        task.deaths += 1
        self._lost += 1
        if task.deaths > _DEATHS:
            raise OptionError(
                f"estimate: a worker was lost each of the {task.deaths} times that it had part {task.part} of the "
                f"fleet ({type(error).__name__}: {error}): does it have memory enough?"
            ) from error
        task.carries = True
        return task

    def _replace(self) -> None:
        """Put a new pool in place of each broken one. Raises OptionError where none like it can be made."""
        for k, executor in enumerate(self._executors):
            if not getattr(executor, "_broken", False):
                continue
            fresh = again(executor)
            if fresh is None:
                raise OptionError(f"estimate: executor {executor!r} is broken, and no other of its kind could be made")
            if k in self._ours:
                executor.shutdown(wait=False, cancel_futures=True)
            self._executors[k] = fresh
            self._ours.add(k)
            time.sleep(_POLL)
