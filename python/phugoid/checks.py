"""Checks of options that a user gives: one rule and one wording for each kind.

Errors about a number begin with ``what``, which names the function and the option: "bootstrap: n".
"""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import Any

from .errors import OptionError, PhugoidError

__all__ = ["check_progress", "finite", "is_whole", "part", "positive", "whole"]


def is_whole(value: Any) -> bool:
    """Return whether a value is a whole number."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def whole(what: str, value: Any, least: int) -> int:
    """Return a whole number not below ``least``; raise OptionError for anything else."""
    if not is_whole(value) or value < least:
        raise OptionError(f"{what} is a whole number from {least}, not {value!r}")
    return int(value)


def positive(what: str, value: Any, of: str = "") -> float:
    """Return a positive finite number; raise OptionError for anything else. ``of``: what it counts, for the message."""
    try:
        number = math.nan if isinstance(value, (bool, str)) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not 0.0 < number < math.inf:
        raise OptionError(f"{what} is a positive number{f' of {of}' if of else ''}, not {value!r}")
    return number


def part(what: str, value: Any, example: str = "") -> float:
    """Return a number between 0 and 1; raise OptionError for anything else."""
    if not isinstance(value, Real) or not 0.0 < float(value) < 1.0:
        such = f", such as {example}" if example else ""
        raise OptionError(f"{what} is a number between 0 and 1{such}, not {value!r}")
    return float(value)


def finite(what: str, value: Any, error: type[PhugoidError]) -> float:
    """Return a finite number; raise the error given for anything else."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise error(f"{what} is {value!r}, not a finite number")
    return number


def check_progress(caller: str, progress: Any) -> None:
    """Raise OptionError, in the caller's name, for what is neither a truth value nor a function."""
    if not isinstance(progress, bool) and not callable(progress):
        raise OptionError(f"{caller}: progress is True, False or a function, not {progress!r}")
