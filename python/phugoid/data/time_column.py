"""Which column holds the times, and in which unit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .checked import FloatArray
from .readers import TIME_UNITS, TIMES, Source

__all__ = ["PX4_TIME", "are_microseconds", "bare", "likely_times", "seconds", "time_of", "unit_in_name"]

# Of logs, taken where there is none of `TIMES`: the first is in microseconds, the second where its values show it.
_ARDUPILOT, PX4_TIME = "timeus", "timestamp"


def unit_in_name(clock: str) -> str:
    """Return the unit with which the name of a time column ends, as in ``t_us`` or ArduPilot's ``TimeUS``; "" where
    there is none."""
    if clock.lower() == _ARDUPILOT:
        return "us"
    name, _, unit = clock.lower().rpartition("_")
    return unit if name in ("t", "time", "timestamp") and unit in TIME_UNITS else ""


# Steps of a log in microseconds: 2 kHz to 5 Hz.
_STEPS = (500.0, 200_000.0)
# Seconds and milliseconds since 1970 of the years 1998 to 2052, where stamps may be no microseconds.
_DATES = ((9e8, 2.6e9), (9e11, 2.6e12))


def are_microseconds(stamps: FloatArray) -> bool:
    """Return whether stamps are whole numbers in steps of microseconds, and can be no seconds or milliseconds since
    1970."""
    there = stamps[np.isfinite(stamps)]
    if there.size < 2 or (there != np.round(there)).any():
        return False
    low, high = float(there.min()), float(there.max())
    dated = any(first < low and high < last for first, last in _DATES)
    return not dated and _STEPS[0] <= float(np.median(np.diff(there))) <= _STEPS[1]


def time_of(source: Source, names: Sequence[str], named: str | None) -> str:
    """Return the name of the time column: as given, or the one whose header is as given; else ``t`` or one of
    `TIMES`, or that of a log."""
    name = "t" if named is None else named
    if name in names:
        return name
    if named is None:
        tiers = (TIMES, *((name,) for name in (_ARDUPILOT, PX4_TIME)))
        found = next(filter(None, ([n for n in names if n.lower() in tier] for tier in tiers)), [])
    else:
        header = bare(named)
        found = [n for n, c in zip(names, source.columns, strict=True) if header and bare(c.header) == header]
    return found[0] if len(found) == 1 else name


def likely_times(names: Sequence[str]) -> str:
    """Return the column that may hold the times: one that is named after time, else the first."""
    return next((n for n in names if "time" in n.lower()), next(iter(names), "t"))


def bare(header: str) -> str:
    """Return a header without blanks, so that headers compare with or without one before the unit."""
    return "".join(header.split())


def seconds(values: Any) -> tuple[Any, bool]:
    """Return dates as seconds since the first and time differences as seconds, anything else unchanged; and which."""
    array = np.asarray(values)
    if array.dtype.kind == "M" and array.size:
        array = array - array[0]
    dates = array.dtype.kind == "m"
    return (array / np.timedelta64(1, "s") if dates else values), dates
