"""When a solver ends: limits as the user gives them, and the time that is left."""

from __future__ import annotations

import time
from numbers import Integral, Real
from typing import Any

from ..errors import OptionError

__all__ = ["Deadline", "check_limits"]

# What is told at the end may take so much longer, in s and as a part of the limit.
_GRACE, _GRACE_PART = 0.03, 0.03


class Deadline:
    """The time by which work is to end: so many seconds from now, or never (None)."""

    def __init__(self, seconds: float | None) -> None:
        self.seconds = seconds
        self._began = time.monotonic()

    def left(self) -> float | None:
        """Return the seconds that are left, at least 0; None where there is no limit."""
        return None if self.seconds is None else max(self.seconds - (time.monotonic() - self._began), 0.0)

    def passed(self) -> bool:
        """Return whether no time is left."""
        return self.left() == 0.0

    def with_grace(self) -> float | None:
        """Return the seconds that are left for what completes a result."""
        left = self.left()
        return None if left is None or self.seconds is None else left + max(_GRACE, _GRACE_PART * self.seconds)


def check_limits(solver: str, max_iterations: Any, tolerance: Any, time_limit: Any) -> None:
    """Raises OptionError, in the solver's name, for what these cannot be."""
    whole = isinstance(max_iterations, Integral) and not isinstance(max_iterations, bool)
    if not whole or max_iterations < 0:
        raise OptionError(f"{solver}: max_iterations is a whole number from 0, not {max_iterations!r}")
    if not isinstance(tolerance, Real) or not 0 < float(tolerance) < 1:
        raise OptionError(f"{solver}: tolerance is a number between 0 and 1, not {tolerance!r}")
    number = isinstance(time_limit, Real) and not isinstance(time_limit, bool)
    if time_limit is not None and not (number and float(time_limit) >= 0):
        raise OptionError(f"{solver}: time_limit is a number of seconds from 0, or None, not {time_limit!r}")
