"""Checks of the numbers of a record: values that would spoil an estimate without a trace are refused, with
their place."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import phugoid._core as _core

from ..errors import DataError, OptionError, listing

__all__ = [
    "FloatArray",
    "check_input",
    "check_moves",
    "check_output",
    "checked_gaps",
    "columns",
    "gap_intervals",
    "merged_spans",
    "moves",
    "pieces",
    "real",
    "times",
    "units",
    "where",
]

FloatArray = NDArray[np.float64]


def where(experiment: str, kind: str, channel: str) -> str:
    """Return the name of a channel for error messages."""
    return f"experiment '{experiment}', {kind} '{channel}'"


def times(experiment: str, t: ArrayLike) -> FloatArray:
    """Return (N,) times in s, checked: at least 2, strictly increasing; raise DataError otherwise."""
    where = f"experiment '{experiment}', time"
    time = real(t, where)
    if time.ndim != 1:
        raise DataError(f"{where}: has shape {time.shape}; give one value per sample (1-D)")
    if time.size < 2:
        raise DataError(f"{where}: has {time.size} sample(s); at least 2 are needed")
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        raise DataError(f"{where}: sample {bad[0]} is {time[bad[0]]}: drop samples without a time")
    bad = np.flatnonzero(np.diff(time) <= 0.0)
    if bad.size:
        i = int(bad[0]) + 1
        raise DataError(
            f"{where}: sample {i} ({float(time[i])!r}) does not come after sample {i - 1} "
            f"({float(time[i - 1])!r}); time must increase strictly: "
            "sort the record or drop repeated samples"
        )
    return time


def columns(experiment: str, kind: str, group: Mapping[str, ArrayLike] | None, t: FloatArray) -> dict[str, FloatArray]:
    """Return name -> (N,) of channels at the times ``t`` (N,); raise DataError for anything else."""
    if group is None:
        return {}
    if not isinstance(group, Mapping):
        raise DataError(
            f"experiment '{experiment}': {kind}s must be a mapping of names to arrays, "
            f"such as {{'q': q}}, but is a {type(group).__name__}"
        )
    found = {}
    for channel, values in group.items():
        place = where(experiment, kind, channel)
        column = real(values, place, t)
        if column.ndim != 1:
            raise DataError(f"{place}: has shape {column.shape}; give one value per sample (1-D)")
        if column.size != t.size:
            raise DataError(f"{place}: has {column.size} values, but time has {t.size}")
        found[str(channel)] = column
    return found


def check_input(where: str, values: FloatArray, t: FloatArray) -> None:
    """Raise DataError for an input with a missing or infinite sample."""
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise DataError(
            f"{where}: {_sample(bad[0], t)} is {values[bad[0]]}"
            f"{f' (and {bad.size - 1} more)' if bad.size > 1 else ''}; "
            "inputs may not have missing values: interpolate them, or cut the record there"
        )


def check_output(where: str, values: FloatArray, t: FloatArray) -> None:
    """Raise DataError for an output with an infinite sample, or without any sample."""
    bad = np.flatnonzero(np.isinf(values))
    if bad.size:
        raise DataError(f"{where}: {_sample(bad[0], t)} is {values[bad[0]]}; mark a missing sample with NaN")
    if np.isnan(values).all():
        raise DataError(f"{where}: is NaN throughout; remove the output from model and data")


def moves(values: FloatArray) -> bool:
    """Return whether the finite samples differ by more than rounding errors."""
    present = values[np.isfinite(values)]
    return bool(present.size) and bool(np.ptp(present) > 4.0 * np.finfo(np.float64).eps * np.abs(present).max())


def check_moves(where: str, values: FloatArray) -> None:
    """Raise DataError for an output that never changes, whose σ cannot be estimated."""
    if not moves(values):
        present = values[~np.isnan(values)]
        what = f"is {present[0]:g} throughout" if present.size > 1 else "has a single sample"
        raise DataError(
            f"{where}: {what} (zero variance), so its σ cannot be estimated; "
            "remove the output from the model or give its σ as known"
        )


def _sample(i: int | np.intp, t: FloatArray | None) -> str:
    return f"sample {i}" if t is None or i >= t.size else f"sample {i} (t = {t[i]:.6g})"


def units(name: str, given: Mapping[str, str] | None, channels: Iterable[str]) -> dict[str, str]:
    """Return the units of the channels of the experiment ``name``; raise DataError unless they are texts by name, each
    of one of the ``channels``."""
    if not isinstance(given, (Mapping, type(None))) or not all(isinstance(u, str) for u in (given or {}).values()):
        raise DataError(f"experiment '{name}': units are texts by name, such as {{'q': 'rad/s'}}, not {given!r}")
    known = dict.fromkeys([*channels, "time"])
    for channel in given or {}:
        if channel not in known:
            near = listing(str(channel), known)
            raise DataError(f"experiment '{name}': units: there is no channel '{channel}'.{near}")
    return dict(given or {})


def real(values: ArrayLike, where: str, t: FloatArray | None = None) -> FloatArray:
    """Return a read-only float64 copy of an array of any shape; None, pandas' NA and masked samples become NaN."""
    masked = sys.modules.get("numpy.ma")  # without it, which takes its time to import, nothing is masked
    if masked is not None and isinstance(values, masked.MaskedArray):
        # np.asarray would drop the mask and take the values beneath it as data.
        values = masked.filled(values.astype(np.float64), np.nan)
    try:
        raw = np.asarray(values)
    except ValueError as error:
        raise DataError(f"{where}: is not an array of numbers ({error})") from None
    if raw.dtype.kind == "O":
        numbers = [_scalar(value, i, where, t) for i, value in enumerate(raw.flat)]
        raw = np.array(numbers, dtype=np.float64).reshape(raw.shape)
    if raw.dtype.kind not in "biuf":
        advice = {
            "c": "holds complex numbers: give real ones",
            "U": "holds text: convert it to numbers",
            "S": "holds text: convert it to numbers",
            "M": "holds dates: give numbers, such as (t - t[0]) / np.timedelta64(1, 's')",
            "m": "holds time differences: give numbers, such as t / np.timedelta64(1, 's')",
        }
        raise DataError(f"{where}: {advice.get(raw.dtype.kind, f'has type {raw.dtype}: give numbers')}")
    result = np.array(raw, dtype=np.float64)
    result.setflags(write=False)
    return result


def _scalar(value: Any, i: int, where: str, t: FloatArray | None) -> float:
    # pandas' NA is known by its type's name: importing pandas only to compare would take long.
    if value is None or type(value).__name__ in ("NAType", "NaTType"):
        return float("nan")
    # float() would drop the imaginary part of numpy's complex numbers.
    if not isinstance(value, (str, complex, np.complexfloating)):
        try:
            return float(value)
        except (TypeError, ValueError):
            pass
    raise DataError(f"{where}: {_sample(i, t)} is {value!r}, which is not a real number")


def checked_gaps(caller: str, gaps: Any) -> bool | float:
    """Return True (the automatic rule) or a positive length in s; raise OptionError for anything else."""
    if gaps is True:
        return True
    if isinstance(gaps, bool) or not isinstance(gaps, Real) or not 0 < float(gaps) < np.inf:
        raise OptionError(
            f"{caller}: gaps is the length in s beyond which an interval between samples is a gap, or True for ten "
            f"times the intervals beside it, not {gaps!r}"
        )
    return float(gaps)


def merged_spans(caller: str, spans: Sequence[Any]) -> list[tuple[float, float]]:
    """Return begin and end (s) of spans in order, those that overlap as one; raise DataError for anything else."""
    pairs: list[tuple[float, float]] = []
    for span in spans:
        try:
            begin, end = map(float, getattr(span, "span", span))
        except (TypeError, ValueError):
            raise DataError(f"{caller}: spans are pairs of times, (t0, t1), not {span!r}") from None
        if not begin < end:
            raise DataError(f"{caller}: the span {begin:g} to {end:g} ends before it begins")
        pairs.append((begin, end))
    merged: list[tuple[float, float]] = []
    for begin, end in sorted(pairs):
        if merged and begin <= merged[-1][1]:
            merged[-1] = merged[-1][0], max(end, merged[-1][1])
        else:
            merged.append((begin, end))
    return merged


def gap_intervals(t: FloatArray, gaps: bool | float) -> list[tuple[float, float]]:
    """Return begin and end (s) of the gaps between the sample times ``t`` (N,), s.

    True: intervals that are longer than ten times those beside them, see `Experiment.split`. A number: longer than so
    many s.
    """
    at = _core.gaps(t.tolist()) if gaps is True else np.flatnonzero(np.diff(t) > gaps).tolist()
    return [(float(t[i]), float(t[i + 1])) for i in at]


def pieces(t: FloatArray, intervals: Sequence[tuple[float, float]]) -> list[tuple[int, int]]:
    """Return the numbers of the first and last sample of each piece between gaps; samples within gaps are in none."""
    slack = 1e-9 * float(t[-1] - t[0])
    inside = np.zeros(t.size, dtype=bool)
    parts = np.zeros(t.size, dtype=int)
    for begin, end in intervals:
        inside |= (t > begin + slack) & (t < end - slack)
        parts += t > begin + slack
    left = np.flatnonzero(~inside)
    ends = np.flatnonzero(np.diff(parts[left])) if left.size else np.empty(0, dtype=int)
    firsts, lasts = [0, *(ends + 1).tolist()], [*ends.tolist(), left.size - 1]
    return [(int(left[a]), int(left[b])) for a, b in zip(firsts, lasts, strict=True) if b >= a]
