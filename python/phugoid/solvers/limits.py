"""What every solver is told of when to end."""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import Any

from ..errors import OptionError

__all__ = ["check_limits"]


def check_limits(solver: str, max_iterations: Any, tolerance: Any, time_limit: Any) -> None:
    """Raises OptionError, in the solver's name, for what these cannot be."""
    whole = isinstance(max_iterations, Integral) and not isinstance(max_iterations, bool)
    if not whole or max_iterations < 0:
        raise OptionError(f"{solver}: max_iterations is a whole number from 0, not {max_iterations!r}")
    if not isinstance(tolerance, Real) or not 0 < float(tolerance) < 1:
        raise OptionError(f"{solver}: tolerance is a number between 0 and 1, not {tolerance!r}")
    if time_limit is not None and not (isinstance(time_limit, Real) and 0 < float(time_limit) < math.inf):
        raise OptionError(f"{solver}: time_limit is a positive number of seconds, not {time_limit!r}")
