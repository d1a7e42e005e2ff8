"""Limits of solvers as the user gives them, deadlines, and deferred Ctrl-C."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from numbers import Real
from typing import Any

from ..errors import OptionError, part, whole

__all__ = ["Deadline", "TimeUp", "check_limits", "check_time", "interrupts", "limited", "one_blas_thread", "time_is_up"]

# Number of presses that are counted; one more raises KeyboardInterrupt, for a user who needs no result at all.
_COUNTED = 2


@contextmanager
def interrupts() -> Iterator[Callable[[], int]]:
    """Defer Ctrl-C within the context; yield a function that returns how often it was pressed. The third one raises.

    In another thread than the main one, and where someone has a handler of their own, nothing is changed, and nothing
    counted.
    """
    count = 0

    def pressed() -> int:
        return count

    def on_interrupt(number: int, frame: Any) -> None:
        nonlocal count
        count += 1
        if count >= _COUNTED:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield pressed
        return
    signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let the linear algebra of numpy and scipy use one thread within the context, in the whole process.

    For matrices of some hundred rows more threads gain nothing, and where the processors are shared they wait for each
    other without end: a search of 7 s took more than 100 s of processor time on a busy machine.
    """
    import scipy.linalg  # noqa: F401  # it brings a BLAS of its own, which is to be there
    from threadpoolctl import threadpool_limits  # not at import: it takes its time

    with threadpool_limits(limits=1, user_api="blas"):
        yield


# The completion of a result may take so much longer, in s and as a part of the limit.
_GRACE, _GRACE_PART = 0.015, 0.03


# Time of the monotonic clock, in s, at which the work of this thread is to end.
_END: ContextVar[float] = ContextVar("end of the limit in force", default=math.inf)


class TimeUp(KeyboardInterrupt):
    """Raised where the limit in force is passed.

    It is caught wherever Ctrl-C is: work that ends early for either reason keeps what it has.
    """


class Deadline:
    """The time by which work is to end: so many seconds from now, or never (None), but no later than the limit in
    force."""

    def __init__(self, seconds: float | None) -> None:
        now = time.monotonic()
        self._end = min(_END.get(), math.inf if seconds is None else now + float(seconds))
        self.seconds = None if math.isinf(self._end) else max(self._end - now, 0.0)

    def left(self) -> float | None:
        """Return the seconds that are left, at least 0; None where there is no limit."""
        return None if self.seconds is None else max(self._end - time.monotonic(), 0.0)

    def passed(self) -> bool:
        """Return whether no time is left."""
        return self.left() == 0.0

    def with_grace(self) -> float | None:
        """Return the seconds that are left for what completes a result."""
        left = self.left()
        return None if left is None or self.seconds is None else left + max(_GRACE, _GRACE_PART * self.seconds)

    def ended(self) -> str:
        """Return the status of work that ended early: "time limit" or "interrupted"."""
        return "time limit" if self.passed() else "interrupted"

    @contextmanager
    def in_force(self) -> Iterator[Deadline]:
        """Limit all that is called within, on this thread."""
        before = _END.set(self._end)
        try:
            yield self
        finally:
            _END.reset(before)


def time_is_up() -> bool:
    """Return whether the limit in force is passed."""
    return time.monotonic() >= _END.get()


def check_time() -> None:
    """Raise TimeUp where the limit in force is passed: to be called between the parts of long work."""
    if time_is_up():
        raise TimeUp


def limited(caller: str, time_limit: Any) -> Deadline:
    """Return the deadline of a call with this option; OptionError, in the caller's name, for an invalid time."""
    number = isinstance(time_limit, Real) and not isinstance(time_limit, bool)
    if time_limit is not None and not (number and float(time_limit) >= 0):
        raise OptionError(f"{caller}: time_limit is a number of seconds from 0, or None, not {time_limit!r}")
    return Deadline(time_limit)


def check_limits(solver: str, max_iterations: Any, tolerance: Any, time_limit: Any) -> None:
    """Raise OptionError, in the solver's name, for invalid limits."""
    whole(f"{solver}: max_iterations", max_iterations, 0)
    part(f"{solver}: tolerance", tolerance)
    limited(solver, time_limit)
