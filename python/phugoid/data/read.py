"""Records from files and tables: `read`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, Literal, overload

import numpy as np

from ..errors import DataError, did_you_mean, some
from ..time_unit import UNKNOWN, TimeUnit
from .checked import FloatArray, checked_gaps, real
from .experiment import Experiment
from .filtering import Interpolations
from .multirate import multirate
from .readers import Source
from .time_column import PX4_TIME, are_microseconds, bare, likely_times, seconds, time_of, unit_in_name
from .units import convert as converted
from .units import differ, si, target

__all__ = ["read"]

Units = Mapping[str, "str | tuple[str, str]"]

_HDF5, _PARQUET = (".h5", ".hdf5", ".hdf", ".he5"), (".parquet", ".pq")


def _open_source(
    data: Any, time: str | None, requested: set[str], columns: Sequence[str] | None, delimiter: str | None
) -> Source:
    """Return the columns of a table in memory, or of a file, whose ending gives its kind; the reader is imported
    here.

    time       name in the file of the column that gives the times; None: not given.
    requested  names that are asked for: columns that take long to read are skipped unless they are among them.
    """
    if not isinstance(data, (str, PathLike)):
        from .readers import arrays

        if arrays.is_frame(data):
            return arrays.read_frame(data, time)
    path = _path(data)
    ending = path.suffix.lower()
    if ending in (".ulg", ".bin") or not path.is_file():
        from .readers import flight_logs

        tables = {} if path.is_file() else flight_logs.find_tables(path)
        if tables:
            return flight_logs.read_px4_tables(path, tables, time)
        if path.is_dir():
            raise DataError(f"{path}: is a folder without tables of a PX4 log (such as log_vehicle_attitude_0.csv)")
        if ending == ".ulg":
            return flight_logs.read_ulog(path, time, requested)
        if ending == ".bin":
            return flight_logs.read_ardupilot(path, time, requested)
    if ending in (".mat", *_HDF5, *_PARQUET):
        from .readers import arrays

        if ending == ".mat":
            return arrays.read_matlab(path, time, columns)
        return arrays.read_hdf5(path, time, columns) if ending in _HDF5 else arrays.read_parquet(path, time)
    from .readers import text

    return text.read_text(path, columns, delimiter)


def _path(data: Any) -> Path:
    try:
        return Path(data)
    except TypeError:
        raise DataError(
            f"read: give the path of a file, or a table of pandas, polars or xarray, not {data!r:.60}"
        ) from None


class _Columns:
    """The columns of a source under the user's names, as numbers in the units asked for."""

    def __init__(
        self,
        source: Source,
        rename: Mapping[str, str],
        named: str | None,
        rate: float | None,
        units: Units,
        convert: bool | Mapping[str, str],
        time_unit: str,
    ) -> None:
        self.where, self.name, self.rate = source.where, source.name, rate
        self.left_out, self._units, self._convert = source.left_out, units, convert
        self._time_unit, self._time_is_named = time_unit, named is not None
        self._steps: dict[str, str] = {}
        self._notes: list[str] = []
        self._labels: dict[str, str] = {}
        self._read: dict[str, FloatArray] = {}
        names = _renamed(source, rename)
        time = time_of(source, names, named)
        self._columns = dict(zip(names, source.columns, strict=True))
        by_file = {column.name: new for new, column in self._columns.items()}
        if rate is not None and not (isinstance(rate, Real) and 0 < rate < float("inf")):
            raise DataError(f"{self.where}: rate is a positive number of samples per unit of time, not {rate!r}")
        self._clock = {n: by_file.get(c.times, time) if c.times else time for n, c in self._columns.items()}
        self.clocks = set() if rate is not None else set(self._clock.values())
        if rate is None and self.clocks == {time} and time not in self._columns:
            # A column that the user has given another name is known not to be the time.
            others = [n for n in names if n not in rename.values()]
            such = f", such as time='{likely_times(others)}'" if others else " by time='...'"
            raise DataError(
                f"{self.where}: has no time column '{time}'.{_listing(time, names)} Give the name of the one "
                f"with times{such}, or rate=... (samples per second) for even sampling"
            )
        self.available = [n for n in names if n not in self.clocks]

    def check(self, names: Sequence[str] | None, option: str) -> None:
        for n in names or ():
            if n in self.available:
                continue
            if n in self.left_out:
                raise DataError(f"{self.where}: '{n}' ({option}=...) {self.left_out[n]}")
            raise DataError(f"{self.where}: has no column '{n}' ({option}=...).{_listing(n, self.available)}")

    def clock(self, name: str) -> str:
        """Return the name of the column with the times of a column."""
        clock = self._clock[name]
        if clock not in self._columns:
            raise DataError(f"{self.where}: has no time column '{clock}' for '{name}'.{_listing(clock, self._columns)}")
        return clock

    def times(self, clock: str) -> FloatArray:
        """Return times, converted from the unit that the file or the user gives."""
        if clock not in self._read:
            where = f"{self.where}, time '{clock}'"
            values, dates = seconds(self._columns[clock].values(clock))
            values = real(values, where)
            unit = "s" if dates else self._label(clock) or unit_in_name(clock) or self._unit_of_stamps(clock, values)
            self._labels[clock] = unit
            if unit:
                # Seconds "since" some date, as the CF conventions write it, are seconds; a step of time is all we need.
                measure = unit.partition(" since ")[0]
                if si(measure) != "s":
                    raise DataError(
                        f"{where}: '{unit}' is not a unit of time that is known; give it, units={{'{clock}': 's'}}"
                    )
                values = converted(values, measure, self._time_unit or "s", where)
                self._labels[clock] = self._time_unit or "s"
            self._read[clock] = values
        return self._read[clock]

    def _unit_of_stamps(self, clock: str, values: FloatArray) -> str:
        """Return the unit of a column `timestamp` that has none, ``"us"`` where its values are such as logs of PX4 have
        them, else ""; raise DataError for other values where the user has named neither the column nor a unit."""
        if clock.lower() != PX4_TIME or self._time_unit:
            return ""
        if are_microseconds(values):
            self._notes.append(f"times '{clock}' read as microseconds")
            return "us"
        if self._time_is_named:
            return ""
        raise DataError(
            f"{self.where}, time '{clock}': its values do not show in which unit they are; give it, "
            f"units={{'{clock}': 's'}} (or 'ms', 'us', 'ns')"
        )

    def values(self, name: str) -> FloatArray:
        """Return the numbers of a column, converted where asked for; the step and the label are recorded."""
        if name in self._read:
            return self._read[name]
        where = f"{self.where}, column '{name}'"
        raw = self._columns[name].values(name)
        try:
            values = real(raw, where)
        except DataError as error:
            raise DataError(f"{error}, or leave it out by naming inputs=[...] and outputs=[...]") from None
        unit = self._label(name)
        given = self._units.get(name)
        into: str | None = None
        if given is not None and not isinstance(given, str):
            into = given[1]
        elif self._convert and unit:
            into = target(unit, self._convert.get(name, "") if isinstance(self._convert, Mapping) else "")
            if into is None:
                raise DataError(
                    f"{where}: convert=True, but its unit '{unit}' is not known; give it with "
                    f"units={{'{name}': 'unit'}}, where '' is none"
                )
        if into is not None:
            values = converted(values, unit, into, where)
            if into != unit:
                self._steps[name] = f"{name} from {unit} to {into or '1'}"
        self._labels[name] = unit if into is None else into
        self._read[name] = values
        return values

    def units(self) -> dict[str, str]:
        """Return the units of the columns read, and that of time where it is known."""
        time = self._time_unit or next((self._labels[n] for n in self.clocks if self._labels.get(n)), "")
        found = {n: unit for n, unit in self._labels.items() if unit and n not in self.clocks}
        return {**found, "time": time} if time else found

    def history(self) -> list[str]:
        return [*self._notes, *([f"converted {', '.join(self._steps.values())}"] if self._steps else [])]

    def _label(self, name: str) -> str:
        given = self._units.get(name, self._columns[name].unit)
        if isinstance(given, str):
            return given
        if not (isinstance(given, tuple) and len(given) == 2 and all(isinstance(unit, str) for unit in given)):
            raise DataError(f"{self.where}: units: give '{name}' its unit, or (from, to) as two, not {given!r}")
        return given[0]

    def other_labels(self) -> list[str]:
        """Return a warning for each column read whose unit, as the user gives it, is not that of the file."""
        texts = []
        for name, given in self._units.items():
            stated = self._columns[name].unit if name in self._read and name in self._columns else ""
            if stated and given and isinstance(given, str) and differ(stated, given):
                text = (
                    f"{self.where}, column '{name}': the file states the unit '{stated}', and units={{'{name}': "
                    f"'{given}'}} replaces it"
                )
                if not self._convert:
                    text += (
                        " without converting the numbers; to convert them give "
                        f"units={{'{name}': ('{stated}', '{given}')}}, or convert=True without units"
                    )
                texts.append(text)
        return texts


def _renamed(source: Source, rename: Mapping[str, str]) -> list[str]:
    names = [column.name for column in source.columns]
    headers = [bare(column.header) for column in source.columns]
    renamed = list(names)
    for old, new in rename.items():
        header = bare(old)
        if old not in names and header not in headers:
            why = f" ('{old}' {source.left_out[old]})" if old in source.left_out else ""
            known = isinstance(new, str) and (new in names or bare(new) in headers)
            turned = f" rename is {{column: name}}: {{{new!r}: {old!r}}}." if known else ""
            raise DataError(f"{source.where}: rename: there is no column '{old}'{why}.{turned}{_listing(old, names)}")
        renamed[names.index(old) if old in names else headers.index(header)] = new
    seen: set[str] = set()
    for name in renamed:
        if name in seen:
            raise DataError(f"{source.where}: rename: two columns would be called '{name}'")
        seen.add(name)
    return renamed


def _listing(name: str, available: Any) -> str:
    return f"{did_you_mean(name, available)} There are: {some(list(available)) or 'none'}."


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
    convert: bool | Mapping[str, str] = False,
    split_gaps: Literal[False] = False,
    time_unit: str | None = None,
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
    convert: bool | Mapping[str, str] = False,
    *,
    split_gaps: Literal[True] | float,
    time_unit: str | None = None,
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
    convert: bool | Mapping[str, str] = False,
    split_gaps: bool | float = False,
    time_unit: str | None = None,
) -> Experiment | list[Experiment]:
    """Read a record from a file, whose ending gives the format, or from a table in memory.

    path       a text table (CSV, TSV or columns apart by blanks, also gzipped), MATLAB ``.mat``, HDF5 ``.h5`` or
               ``.hdf5``, ``.parquet``; a log of PX4 (``.ulg``, or a folder of its CSV tables, or what their names
               begin with) or of ArduPilot (``.bin``); or a table of pandas, polars or xarray. Variables in structures
               and groups are called ``group.name`` (or ``name`` alone where one group holds everything), those of logs
               ``topic.field`` (of a second instance ``topic[1].field``), columns of matrices ``name[0]``.
    time       name of the time column, with its unit as in the header or without; None: ``t``, or what the file
               itself takes for time, or the one column that is called ``time``, ``Elapsed Time``, ``t_us`` or the like;
               a unit with which the name ends is that of the column. Where there is none, ``TimeUS`` (microseconds)
               or ``timestamp``, which is read as microseconds where it holds whole numbers with steps of 500 to
               200,000, and otherwise needs its unit in ``units``.
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
    window     ``(t0, t1)``, in the unit of the record, keeps a part.
    rate       samples per unit of time, for a file without a time column: time runs from 0, and ``time`` is not used.
    split_gaps  True or a length of time: the parts between gaps in the sampling, as `Experiment.split` has them, are
               returned as a list.
    convert    True converts each column whose unit is known to SI; ``m.units`` (name -> unit) to the units of the
               model m, and the other columns to SI. A number per minute or hour becomes one in Hz. Times whose unit is
               given become s, or ``time_unit``, in any case.
    time_unit  unit of the times of the record, as the model has it: ``"h"``. Times without a unit are in it already.

    Channels with time stamps of their own keep them, see `multirate`; ``inputs`` and ``outputs`` must then be given.
    In a text table, lines that begin with ``#`` or ``%`` are comments, lines with fewer cells before the header are
    passed over, and empty cells, ``NaN`` and ``NA`` are missing samples. Decimal commas are read where commas cannot
    separate thousands. Times may be dates with times of ISO 8601,
    such as ``2024-05-31T12:00:00.25Z``: time runs from the first.

    Raises DataError with the line and the column for a cell that is not a number, with the line for a row that
    has too many or too few cells, with the names there are for an unknown column, with the units for those
    that are unknown or of different kinds, and with the path for a damaged file; MissingDependency, with the command
    that installs it, where a package is needed to read a file.
    """
    if not isinstance(rename, (Mapping, type(None))):
        raise DataError(f"rename={rename!r}: give names by name, such as rename={{'ALFCG': 'alpha'}}")
    if not isinstance(units, (Mapping, type(None))):
        raise DataError(f"units={units!r}: give units by name, such as units={{'alpha': ('deg', 'rad')}}")
    if time is not None and not isinstance(time, str):
        raise DataError(f"time={time!r}: give the name of the time column, or rate=... where there is none")
    unit = UNKNOWN if time_unit is None else TimeUnit.checked(time_unit, "read", DataError)
    renaming, labels = dict(rename or {}), dict(units or {})
    window = _span(window)
    if split_gaps is not False:
        checked_gaps("read: split_gaps", split_gaps)
    for kind, names in (("input", inputs), ("output", outputs), ("unit", units)):
        if isinstance(names, str):
            raise DataError(f"{kind}s='{names}' is text: give a list of names, such as {kind}s=['{names}']")
    now = {old: new for old, new in renaming.items() if isinstance(old, str) and old not in renaming.values()}
    time = None if time is None else now.get(time, time)
    inputs, outputs = _called(inputs, now), _called(outputs, now)
    if isinstance(interpolation, Mapping):
        interpolation = {now.get(n, n): kind for n, kind in interpolation.items()}
    labels = {now.get(n, n): unit for n, unit in labels.items()}
    called = [old for old, new in renaming.items() if new == time] or ([] if time is None else [time])
    asked = {*(inputs or ()), *(outputs or ()), *labels}
    wanted_names = {*asked, *(old for old, new in renaming.items() if new in asked)}
    source = _open_source(path, called[0] if called else None, wanted_names, columns, delimiter)
    if source.group:  # names may have it or not
        renaming = {source.bare(old): new for old, new in renaming.items()}

        def own(name: Any) -> Any:
            bare = source.bare(name)
            return name if name in renaming.values() else renaming.get(bare, bare)

        time = None if time is None else own(time)
        inputs, outputs = (None if names is None else [own(n) for n in names] for names in (inputs, outputs))
        labels = {own(n): unit for n, unit in labels.items()}
        if isinstance(interpolation, Mapping):
            interpolation = {own(n): kind for n, kind in interpolation.items()}
    record = _Columns(source, renaming, time, rate, labels, convert, unit)
    record.check(inputs, "inputs")
    record.check(outputs, "outputs")
    record.check([n for n in labels if n not in record.clocks], "units")
    given = inputs is not None and outputs is not None
    used = list(dict.fromkeys([*(inputs or ()), *(outputs or ())])) if given else record.available
    result = _one_rate(record, used, inputs, outputs, name, interpolation, window, not given)
    if result is None:
        result = _many_rates(record, inputs, outputs, name, interpolation, window)
    result._read_as = _options(time, rate, rename, units, convert, columns)
    for warning in record.other_labels():
        warnings.warn(warning, stacklevel=2)
    return result if split_gaps is False else result.split(split_gaps)


def _options(
    time: str | None,
    rate: float | None,
    rename: Mapping[str, str] | None,
    units: Units | None,
    convert: bool | Mapping[str, str],
    columns: Sequence[str] | None,
) -> dict[str, Any]:
    """Return the options that change names and units of a file, those that are given, to read another file likewise."""
    given = {
        "time": time,
        "rate": None if rate is None else float(rate),
        "rename": dict(rename or {}),
        "units": dict(units or {}),
        "convert": bool(convert),
        "columns": list(columns or ()),
    }
    return {option: value for option, value in given.items() if value}


def _called(names: Sequence[str] | None, now: Mapping[str, str]) -> Sequence[str] | None:
    """Return names as they are after renaming, from names before or after it."""
    return None if names is None else [now.get(n, n) if isinstance(n, str) else n for n in names]


def _span(window: Any) -> tuple[float, float] | None:
    """Return the window as two numbers; raise DataError for anything else."""
    if window is None:
        return None
    try:
        first, last = window
        return float(first) + 0.0, float(last) + 0.0
    except (TypeError, ValueError):
        raise DataError(f"window={window!r}: give its begin and end, such as window=(2.0, 30.0)") from None


def _one_rate(
    record: _Columns,
    used: Sequence[str],
    inputs: Sequence[str] | None,
    outputs: Sequence[str] | None,
    name: str | None,
    interpolation: Interpolations,
    window: tuple[float, float] | None,
    open_ended: bool,
) -> Experiment | None:
    """Return the record where one column gives the times of all columns used; None where there are several."""
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
    record: _Columns,
    inputs: Sequence[str] | None,
    outputs: Sequence[str] | None,
    name: str | None,
    interpolation: Interpolations,
    window: tuple[float, float] | None,
) -> Experiment:
    def channel(n: str, beyond: int) -> tuple[FloatArray, FloatArray]:
        """Return times and values in the window, with ``beyond`` more samples on either side of it."""
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
                f"{record.where}: no sample of '{n}' lies in the window {window[0]:g} to {window[1]:g}; "
                f"it runs from {t[0]:g} to {t[-1]:g}"
            )
        kept = slice(max(first - beyond, 0), last + beyond)
        return t[kept], values[kept]

    # One more sample of an input on each side, so that it covers the window.
    experiment = multirate(
        {n: channel(n, 1) for n in inputs or ()},
        {n: channel(n, 0) for n in outputs or ()},
        record.name if name is None else name,
        interpolation,
        units=record.units(),
    )
    return experiment._after(experiment, *record.history())
