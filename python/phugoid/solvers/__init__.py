"""What all solvers have in common: result, display of iterations, limits, deadlines, deferred Ctrl-C."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import check_time_limit, counted, part, whole
from ..notebook import Rows, notebook_page, table
from ..progress import StatusLine

__all__ = [
    "HINTS",
    "Deadline",
    "History",
    "Iteration",
    "Progress",
    "Solution",
    "TimeUp",
    "check_limits",
    "check_time",
    "interrupts",
    "limited",
    "one_blas_thread",
    "time_is_up",
]


HINTS = {
    "converged": "a local optimum was found; other starts (ph.multistart) show whether it is the global one",
    "acceptable": "stopped at an acceptable point: tolerances were not all met, often for want of precision; "
    "check the standard errors",
    "interrupted": "stopped by the user; this is the best point so far; continue with start=fit",
    "iteration limit": "not converged; allow more iterations, or go on with start=fit",
    "time limit": "not converged; allow more time, or go on with start=fit",
    "infeasible": "no state path near this point satisfies the equations; check start values, bounds and units",
    "diverging": "the unknowns grow without limit; a parameter may have no influence: bound or fix it",
    "unidentifiable": "the data do not determine all parameters: fix some of those named, or give them priors",
    "failed": "the solver made no further progress; try other start values, "
    "bounds that keep functions finite, or another order",
}
"""For each status, what it means and what to do."""


@dataclass(frozen=True)
class Iteration:
    """One line of the iteration table."""

    number: int
    log_likelihood: float
    defect: float
    """Largest scaled constraint violation."""
    dual: float
    """Distance from the optimum: of Ipopt the largest scaled entry of the gradient of the Lagrangian; of Newton
    what the next step promises to gain in log-likelihood, half the square of the distance in standard errors."""
    step: float
    trials: int


class History(list[Iteration]):
    """The iterations of a fit in order: a list, which notebooks show as a table."""

    def rows(self) -> Rows:
        """Return heads, rows and alignment of a table."""
        heads = ["iteration", "log-likelihood", "largest defect", "distance", "step", "trials"]
        rows = [
            [
                str(i.number),
                f"{i.log_likelihood:.6f}",
                f"{i.defect:.2e}",
                f"{i.dual:.2e}",
                f"{i.step:.3g}",
                str(i.trials),
            ]
            for i in self
        ]
        return heads, rows, "rrrrrr"

    def _repr_html_(self) -> str:
        return notebook_page(counted(len(self), "iteration"), table(*self.rows()))


@dataclass(frozen=True)
class Solution:
    """The end point of a solver, and how it was reached."""

    xi: NDArray[np.float64]
    """Decision variables, shape (n,)."""
    multipliers: NDArray[np.float64]
    """Multipliers of the constraints, shape (m,)."""
    bound_multipliers: tuple[NDArray[np.float64], NDArray[np.float64]]
    """Multipliers of the lower and upper bounds, shape (n,) each."""
    status: str
    message: str
    iterations: int
    time: float
    history: list[Iteration] = field(default_factory=list, repr=False)
    evaluations: dict[str, int] = field(default_factory=dict, repr=False)
    """How often each function was evaluated and the Newton system solved, where the solver counts."""
    flops: int = 0
    """Floating-point operations of one factorisation, where the solver counts."""

    def multipliers_by_name(self) -> dict[str, NDArray[np.float64]]:
        """Return the multipliers under Ipopt's names."""
        lower, upper = self.bound_multipliers
        return {"mult_g": self.multipliers, "mult_x_L": lower, "mult_x_U": upper}


Watch = Callable[[Iteration], None]

_TITLE = 22  # characters of a title beside which the rest fits in a line of 80


class Progress:
    """Shows the iterations: one line that is overwritten, or every tenth iteration where lines are not."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.line = StatusLine()
        self.shown = -1

    def __call__(self, line: Iteration) -> None:
        if line.number < self.shown:  # another pass
            self.line.keep()
        if self.line.is_overwritten or line.number % 10 == 0:
            self.line.show(
                f"{self.title[:_TITLE]}: iteration {line.number:3d}  logL {line.log_likelihood:.3f}  "
                f"defect {line.defect:.0e}  to gain {line.dual:.0e}"
            )
        self.shown = line.number

    def close(self) -> None:
        """End the line."""
        self.line.keep()

    @staticmethod
    @contextmanager
    def of(progress: bool | Watch, title: str) -> Iterator[Watch | None]:
        """Yield the function to call with each iteration: None, a printed line, or the user's own function."""
        if callable(progress):
            yield progress
        elif progress:
            line = Progress(title)
            try:
                yield line
            finally:
                line.close()
        else:
            yield None


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
    check_time_limit(caller, time_limit)
    return Deadline(time_limit)


def check_limits(solver: str, max_iterations: Any, tolerance: Any, time_limit: Any) -> None:
    """Raise OptionError, in the solver's name, for invalid limits."""
    whole(f"{solver}: max_iterations", max_iterations, 0)
    part(f"{solver}: tolerance", tolerance)
    limited(solver, time_limit)
