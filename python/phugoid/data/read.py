"""Records from files and tables as flight-test people have them: `read`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal, overload

import numpy as np

from ..errors import DataError
from .experiment import Experiment, FloatArray
from .gaps import checked_gaps
from .interpolation import Interpolations
from .multirate import multirate
from .readers import open_source
from .readers.record import Record, Units, some

__all__ = ["read"]


@overload
def read(
    path: str | PathLike[str] | Any,
    time: str | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    rename: Mapping[str, str] | None = None,
    columns: Sequence[str] | None = None,
    units: Units | None = None,
    delimiter: str | None = None,
    name: str | None = None,
    interpolation: Interpolations = "linear",
    window: tuple[float, float] | None = None,
    rate: float | None = None,
    convert: bool = False,
    split_gaps: Literal[False] = False,
) -> Experiment: ...


@overload
def read(
    path: str | PathLike[str] | Any,
    time: str | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    rename: Mapping[str, str] | None = None,
    columns: Sequence[str] | None = None,
    units: Units | None = None,
    delimiter: str | None = None,
    name: str | None = None,
    interpolation: Interpolations = "linear",
    window: tuple[float, float] | None = None,
    rate: float | None = None,
    convert: bool = False,
    *,
    split_gaps: Literal[True] | float,
) -> list[Experiment]: ...


def read(
    path: str | PathLike[str] | Any,
    time: str | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    rename: Mapping[str, str] | None = None,
    columns: Sequence[str] | None = None,
    units: Units | None = None,
    delimiter: str | None = None,
    name: str | None = None,
    interpolation: Interpolations = "linear",
    window: tuple[float, float] | None = None,
    rate: float | None = None,
    convert: bool = False,
    split_gaps: bool | float = False,
) -> Experiment | list[Experiment]:
    """Reads a record from a file, whose ending says what it is, or from a table in memory.

    path       a text table (CSV, TSV or columns apart by blanks, also gzipped), MATLAB ``.mat``, HDF5 ``.h5`` or
               ``.hdf5``, ``.parquet``; a log of PX4 (``.ulg``, or a folder of its CSV tables, or what their names
               begin with) or of ArduPilot (``.bin``); or a table of pandas, polars or xarray. Variables in structures
               and groups are called ``group.name``, those of logs ``topic.field`` (of a second instance
               ``topic[1].field``), columns of matrices ``name[0]``.
    time       name of the time column, in s; None: ``t``, or what the file itself takes for time.
               In a log, the field with the stamps, such as ``timestamp_sample``, of each topic that has it.
    inputs     names of the input columns; None: a model finds its inputs among all columns.
    outputs    the same for outputs. With both given, the other columns are not even looked at.
    rename     ``{"name in the file": "name in the model"}``; the other arguments take either name.
    columns    names of all columns in order, for a text file without a header (or in place of the header), or for
               the one matrix of a file.
    units      ``{"name": "unit"}`` for labels, in place of what the file says, and ``{"name": ("deg", "rad")}`` to
               convert. A header such as ``alpha [deg]`` or ``alpha (deg)``, or a row of units beneath it, is
               understood.
    delimiter  of a text file; None: found out from the file.
    name       name of the experiment; None: the file's name without its ending.
    interpolation  how inputs behave between samples, as `Experiment` takes it.
    window     ``(t0, t1)`` in s keeps a part.
    rate       samples a second, for a file without a time column: time runs from 0, and ``time`` is not looked for.
    split_gaps  True or a length in s: the parts between gaps in the sampling, as `Experiment.split` has them, are
               returned as a list.
    convert    True brings each column whose unit is known to SI. Times whose unit is told become seconds in any case.

    Channels with time stamps of their own keep them, see `multirate`; ``inputs`` and ``outputs`` must then be given.
    In a text table, lines that begin with ``#`` or ``%`` are comments, and empty cells, ``NaN`` and ``NA`` are missing
    samples.

    Raises DataError with the line and the column for a cell that is no number, with the line for a row that
    has too many or too few cells, with the names there are for a column that is not there, with the units for those
    that are unknown or of different kinds, and with the path for a damaged file; MissingDependency, with the command
    that installs it, where a package is needed to read a file.
    """
    if not isinstance(rename, (Mapping, type(None))):
        raise DataError(f"rename={rename!r}: give names by name, such as rename={{'ALFCG': 'alpha'}}")
    if not isinstance(units, (Mapping, type(None))):
        raise DataError(f"units={units!r}: give units by name, such as units={{'alpha': ('deg', 'rad')}}")
    if time is not None and not isinstance(time, str):
        raise DataError(f"time={time!r}: give the name of the time column, or rate=... in Hz where there is none")
    renaming, labels = dict(rename or {}), dict(units or {})
    window = _span(window)
    if split_gaps is not False:
        checked_gaps("read: split_gaps", split_gaps)
    for kind, wanted in (("input", inputs), ("output", outputs), ("unit", units)):
        if isinstance(wanted, str):
            raise DataError(f"{kind}s='{wanted}' is text: give a list of names, such as {kind}s=['{wanted}']")
    now = {old: new for old, new in renaming.items() if isinstance(old, str) and old not in renaming.values()}
    time = None if time is None else now.get(time, time)
    inputs, outputs = _called(inputs, now), _called(outputs, now)
    if isinstance(interpolation, Mapping):
        interpolation = {now.get(n, n): kind for n, kind in interpolation.items()}
    labels = {now.get(n, n): unit for n, unit in labels.items()}
    called = [old for old, new in renaming.items() if new == time] or ([] if time is None else [time])
    asked = {*(inputs or ()), *(outputs or ()), *labels}
    wanted_names = {*asked, *(old for old, new in renaming.items() if new in asked)}
    source = open_source(path, called[0] if called else None, wanted_names, columns, delimiter)
    record = Record(source, renaming, "t" if time is None else time, rate, labels, convert)
    record.check(inputs, "inputs")
    record.check(outputs, "outputs")
    record.check([n for n in labels if n not in record.clocks], "units")
    given = inputs is not None and outputs is not None
    used = list(dict.fromkeys([*(inputs or ()), *(outputs or ())])) if given else record.available
    result = _one_rate(record, used, inputs, outputs, name, interpolation, window, not given)
    if result is None:
        result = _many_rates(record, inputs, outputs, name, interpolation, window)
    return result if split_gaps is False else result.split(split_gaps)


def _called(names: Sequence[str] | None, now: Mapping[str, str]) -> Sequence[str] | None:
    """Names as they are after renaming, from names before or after."""
    return None if names is None else [now.get(n, n) if isinstance(n, str) else n for n in names]


def _span(window: Any) -> tuple[float, float] | None:
    """The window as two numbers; DataError for anything else."""
    if window is None:
        return None
    try:
        first, last = window
        return float(first) + 0.0, float(last) + 0.0
    except (TypeError, ValueError):
        raise DataError(f"window={window!r}: give its begin and end in s, such as window=(2.0, 30.0)") from None


def _one_rate(
    record: Record,
    used: Sequence[str],
    inputs: Sequence[str] | None,
    outputs: Sequence[str] | None,
    name: str | None,
    interpolation: Interpolations,
    window: tuple[float, float] | None,
    open_ended: bool,
) -> Experiment | None:
    """The record where one clock gives the times of all columns that are used; None where there are several."""
    if record.rate is not None:
        if not used:
            raise DataError(f"{record.where}: has no columns")
        t = np.arange(record.values(used[0]).size) / float(record.rate)
    else:
        clocks = {record.clock(n) for n in used} or record.clocks
        if len(clocks) > 1 and open_ended:
            raise DataError(
                f"{record.where}: its channels have times of their own ({some(sorted(clocks))}): name inputs=[...] "
                f"and outputs=[...] ([] for none). There are: {some(record.available)}."
            )
        if len(clocks) != 1:
            return None
        t = record.times(next(iter(clocks)))
    data = {n: record.values(n) for n in used}
    experiment = Experiment(
        t,
        {n: data[n] for n in inputs or ()},
        {n: data[n] for n in outputs or ()},
        name=record.name if name is None else name,
        interpolation=interpolation,
        channels=data if open_ended else None,
        units=record.units(),
    )
    experiment._left_out = record.left_out
    experiment._after(experiment, *record.history())
    return experiment if window is None else experiment.window(*window)


def _many_rates(
    record: Record,
    inputs: Sequence[str] | None,
    outputs: Sequence[str] | None,
    name: str | None,
    interpolation: Interpolations,
    window: tuple[float, float] | None,
) -> Experiment:
    def channel(n: str, beyond: int) -> tuple[FloatArray, FloatArray]:
        """Times and values in the window, and so many samples on either side of it."""
        t, values = record.times(record.clock(n)), record.values(n)
        if t.size != values.size:
            raise DataError(
                f"{record.where}: '{n}' has {values.size} values, but its times '{record.clock(n)}' {t.size}"
            )
        if window is None:
            return t, values
        first, last = np.searchsorted(t, window[0], side="left"), np.searchsorted(t, window[1], side="right")
        if last - first < 1:
            raise DataError(
                f"{record.where}: no sample of '{n}' lies in the window {window[0]:g} to {window[1]:g} s; "
                f"it runs from {t[0]:g} to {t[-1]:g} s"
            )
        kept = slice(max(first - beyond, 0), last + beyond)
        return t[kept], values[kept]

    # An input is taken a sample further, so that it covers the window.
    experiment = multirate(
        {n: channel(n, 1) for n in inputs or ()},
        {n: channel(n, 0) for n in outputs or ()},
        record.name if name is None else name,
        interpolation,
        units=record.units(),
    )
    return experiment._after(experiment, *record.history())
