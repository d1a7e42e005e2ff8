"""Measured time histories: `Experiment` holds one record, `read` takes it from a text table.

Everything that could spoil an estimate without a trace (unsorted time, gaps in an input, a text cell, a dead
sensor) is refused here, with the channel, the sample and the time.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import DataError, did_you_mean

__all__ = ["Experiment", "FloatArray", "Interpolation", "read"]

FloatArray = NDArray[np.float64]
Interpolation = Literal["linear", "cubic"]


class Experiment:
    """One record of measured inputs and outputs over N samples; immutable.

    t              (N,) time in s, strictly increasing, at least 2 samples; the spacing may vary.
    inputs         name -> (N,), finite.
    outputs        name -> (N,); NaN marks a missing sample.
    name           how messages and plots call the record.
    interpolation  how inputs run between samples: ``"linear"`` or ``"cubic"``. A wrong assumption here looks
                   like an error of the model.
    channels       name -> (N,): columns not yet told apart. A model finds here what it does not find in
                   ``inputs`` and ``outputs``; extra channels do no harm.
    units          name -> unit, for labels; nothing is converted.

    Lists, numpy arrays and pandas Series are taken (and copied). Bad input raises DataError, which names the
    channel, the sample's index and its time.

    >>> run = Experiment([0.0, 0.1, 0.2], inputs={"de": [0, 1, 1]}, outputs={"q": [0.0, float("nan"), 0.2]})
    >>> run
    Experiment('experiment', 3 samples, 0 to 0.2 s, inputs: de, outputs: q (1 missing))
    >>> run.window(0.1, 0.2).t
    array([0.1, 0.2])
    """

    def __init__(
        self,
        t: ArrayLike,
        inputs: Mapping[str, ArrayLike] | None = None,
        outputs: Mapping[str, ArrayLike] | None = None,
        name: str = "experiment",
        interpolation: Interpolation = "linear",
        *,
        channels: Mapping[str, ArrayLike] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> None:
        self._name = str(name)
        if interpolation not in get_args(Interpolation):
            raise DataError(
                f"experiment '{self._name}': interpolation '{interpolation}' is not known; "
                "take 'linear' or 'cubic'"
            )
        self._interpolation: Interpolation = interpolation
        self._t = self._checked_time(t)
        self._inputs = self._columns(inputs, "input")
        self._outputs = self._columns(outputs, "output")
        self._channels = self._columns(channels, "channel")
        self._units = dict(units or {})
        for channel, values in self._inputs.items():
            self._check_input(channel, values)
        for channel, values in self._outputs.items():
            self._check_output(channel, values)

    @property
    def name(self) -> str:
        """How messages and plots call the record."""
        return self._name

    @property
    def t(self) -> FloatArray:
        """Time of the samples in s, shape (N,), read-only."""
        return self._t

    @property
    def inputs(self) -> Mapping[str, FloatArray]:
        """The channels given as inputs: name -> (N,), read-only."""
        return MappingProxyType(self._inputs)

    @property
    def outputs(self) -> Mapping[str, FloatArray]:
        """The channels given as outputs: name -> (N,), read-only; NaN where a sample is missing."""
        return MappingProxyType(self._outputs)

    @property
    def channels(self) -> Mapping[str, FloatArray]:
        """The columns that may serve as either: name -> (N,), read-only."""
        return MappingProxyType(self._channels)

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the channels where known (from the file's header, or as given)."""
        return MappingProxyType(self._units)

    @property
    def interpolation(self) -> Interpolation:
        """How inputs run between samples."""
        return self._interpolation

    @property
    def n(self) -> int:
        """Number of samples, N."""
        return int(self._t.size)

    def __len__(self) -> int:
        return self.n

    def __repr__(self) -> str:
        parts = [f"{self.n} samples", f"{self._t[0]:g} to {self._t[-1]:g} s"]
        groups = {"inputs": self._inputs, "outputs": self._outputs, "channels": self._channels}
        parts += [f"{kind}: {' '.join(group)}" for kind, group in groups.items() if group]
        missing = sum(int(np.isnan(values).sum()) for values in self._outputs.values())
        return f"Experiment('{self._name}', {', '.join(parts)}{f' ({missing} missing)' if missing else ''})"

    def input(self, name: str) -> FloatArray:
        """The input channel ``name``, shape (N,); DataError where there is none."""
        return self._resolve(name, self._inputs, "input")

    def output(self, name: str) -> FloatArray:
        """The output channel ``name``, shape (N,), NaN where missing; DataError where there is none."""
        return self._resolve(name, self._outputs, "output")

    def check_for(
        self, model_inputs: Sequence[str], model_outputs: Sequence[str], known_sigma: Collection[str] = ()
    ) -> None:
        """Raises DataError unless a model with these inputs and outputs can be estimated from this record.

        Every name must be there, inputs without gaps, outputs with at least one sample. An output that never
        changes is refused, since its σ cannot be estimated, unless it is in ``known_sigma``.
        """
        for name in model_inputs:
            self._check_input(name, self.input(name))
        for name in model_outputs:
            values = self.output(name)
            self._check_output(name, values)
            present = values[~np.isnan(values)]
            rounding = 4.0 * np.finfo(np.float64).eps * np.abs(present).max()
            if name not in known_sigma and np.ptp(present) <= rounding:
                what = f"is {present[0]:g} throughout" if present.size > 1 else "has a single sample"
                raise DataError(
                    f"{self._where('output', name)}: {what} (zero variance), so its σ cannot be estimated; "
                    "remove the output from the model or give its σ as known"
                )

    def window(self, t0: float, t1: float, name: str | None = None) -> Experiment:
        """The samples with ``t0 <= t <= t1`` (s), time unchanged; DataError where fewer than 2 are left."""
        # Sample times such as 0.1*k carry rounding: without slack window(0, 0.3) would lose its last sample.
        slack = 1e-6 * float(np.median(np.diff(self._t)))
        kept = (self._t >= t0 - slack) & (self._t <= t1 + slack)
        if int(kept.sum()) < 2:
            raise DataError(
                f"experiment '{self._name}': the window {t0:g} to {t1:g} s holds {int(kept.sum())} samples; "
                f"the record runs from {self._t[0]:g} to {self._t[-1]:g} s"
            )

        def cut(group: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
            return {key: values[kept] for key, values in group.items()}

        return Experiment(
            self._t[kept],
            cut(self._inputs),
            cut(self._outputs),
            self._name if name is None else name,
            self._interpolation,
            channels=cut(self._channels),
            units=self._units,
        )

    def rename(self, names: Mapping[str, str]) -> Experiment:
        """The same record with channels renamed, ``{"old": "new"}``; DataError for unknown or taken names."""
        present = self._names()
        for old in names:
            if old not in present:
                raise DataError(f"{self._absent('channel', old)}{_listing(old, present)}")

        def renamed(group: Mapping[str, Any]) -> dict[str, Any]:
            result = {names.get(key, key): values for key, values in group.items()}
            if len(result) < len(group):
                taken = next(new for old, new in names.items() if old in group and new in group)
                raise DataError(f"experiment '{self._name}': two channels would be called '{taken}'")
            return result

        units = {names.get(key, key): unit for key, unit in self._units.items()}
        return Experiment(
            self._t,
            renamed(self._inputs),
            renamed(self._outputs),
            self._name,
            self._interpolation,
            channels=renamed(self._channels),
            units=units,
        )

    def with_outputs(self, outputs: Mapping[str, ArrayLike], name: str | None = None) -> Experiment:
        """The same inputs with ``outputs`` (name -> (N,)) in place of the measured ones: simulated data."""
        return Experiment(
            self._t,
            self._inputs,
            outputs,
            self._name if name is None else name,
            self._interpolation,
            channels=self._channels,
            units=self._units,
        )

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Pickling (multistart in other processes) forgets that the arrays are read-only.
        self.__dict__.update(state)
        for values in (self._t, *self._inputs.values(), *self._outputs.values(), *self._channels.values()):
            values.setflags(write=False)

    def _where(self, kind: str, channel: str) -> str:
        return f"experiment '{self._name}', {kind} '{channel}'"

    def _absent(self, kind: str, channel: str) -> str:
        return f"experiment '{self._name}' has no {kind} '{channel}'."

    def _names(self) -> list[str]:
        return list(dict.fromkeys([*self._inputs, *self._outputs, *self._channels]))

    def _resolve(self, name: str, group: Mapping[str, FloatArray], kind: str) -> FloatArray:
        for source in (group, self._channels):
            if name in source:
                return source[name]
        if name in self._names():
            other = "output" if kind == "input" else "input"
            raise DataError(
                f"{self._absent(kind, name)} It is there as an {other}: "
                f"give it among the {kind}s too if the model uses it as an {kind}."
            )
        there = [*group, *self._channels]
        raise DataError(
            f"{self._absent(kind, name)}{_listing(name, there)} Use .rename({{...}}) where names differ."
        )

    def _checked_time(self, t: ArrayLike) -> FloatArray:
        where = f"experiment '{self._name}', time"
        time = _real(t, where)
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
                f"{where}: sample {i} ({float(time[i])!r} s) does not come after sample {i - 1} "
                f"({float(time[i - 1])!r} s); time must increase strictly: "
                "sort the record or drop repeated samples"
            )
        return time

    def _columns(self, group: Mapping[str, ArrayLike] | None, kind: str) -> dict[str, FloatArray]:
        if group is None:
            return {}
        if not isinstance(group, Mapping):
            raise DataError(
                f"experiment '{self._name}': {kind}s must be a mapping of names to arrays, "
                f"such as {{'q': q}}, but is a {type(group).__name__}"
            )
        columns = {}
        for channel, values in group.items():
            where = self._where(kind, channel)
            column = _real(values, where, self._t)
            if column.ndim != 1:
                raise DataError(f"{where}: has shape {column.shape}; give one value per sample (1-D)")
            if column.size != self.n:
                raise DataError(f"{where}: has {column.size} values, but time has {self.n}")
            columns[str(channel)] = column
        return columns

    def _check_input(self, channel: str, values: FloatArray) -> None:
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise DataError(
                f"{self._where('input', channel)}: {_sample(bad[0], self._t)} is {values[bad[0]]}"
                f"{f' (and {bad.size - 1} more)' if bad.size > 1 else ''}; "
                "inputs may not have missing values: fill or cut"
            )

    def _check_output(self, channel: str, values: FloatArray) -> None:
        where = self._where("output", channel)
        bad = np.flatnonzero(np.isinf(values))
        if bad.size:
            sample = _sample(bad[0], self._t)
            raise DataError(f"{where}: {sample} is {values[bad[0]]}; mark a missing sample with NaN")
        if np.isnan(values).all():
            raise DataError(f"{where}: is NaN throughout; remove the output from model and data")


def _sample(i: int | np.intp, t: FloatArray | None) -> str:
    return f"sample {i}" if t is None or i >= t.size else f"sample {i} (t = {t[i]:.6g} s)"


def _listing(name: str, available: Collection[str]) -> str:
    """The tail of a message on a missing name: the nearest name, and what there is."""
    return f"{did_you_mean(name, available)} There are: {', '.join(available) or 'none'}."


def _real(values: ArrayLike, where: str, t: FloatArray | None = None) -> FloatArray:
    """A read-only float64 copy of any shape; None, pandas' NA and masked samples become NaN."""
    if isinstance(values, np.ma.MaskedArray):
        # np.asarray would drop the mask and let the junk beneath pass for data.
        values = np.ma.filled(values.astype(np.float64), np.nan)
    try:
        raw = np.asarray(values)
    except ValueError as error:
        raise DataError(f"{where}: is no array of numbers ({error})") from None
    if raw.dtype.kind == "O":
        numbers = [_scalar(value, i, where, t) for i, value in enumerate(raw.flat)]
        raw = np.array(numbers, dtype=np.float64).reshape(raw.shape)
    if raw.dtype.kind not in "biuf":
        advice = {
            "c": "holds complex numbers: give real ones",
            "U": "holds text: convert it to numbers",
            "S": "holds text: convert it to numbers",
            "M": "holds dates: give seconds, such as (t - t[0]) / np.timedelta64(1, 's')",
            "m": "holds time differences: give seconds, such as t / np.timedelta64(1, 's')",
        }
        raise DataError(f"{where}: {advice.get(raw.dtype.kind, f'has type {raw.dtype}: give numbers')}")
    result = np.array(raw, dtype=np.float64)
    result.setflags(write=False)
    return result


def _scalar(value: Any, i: int, where: str, t: FloatArray | None) -> float:
    # pandas' NA is known by its type's name: importing pandas only to compare would be dear.
    if value is None or type(value).__name__ in ("NAType", "NaTType"):
        return float("nan")
    if not isinstance(value, str):
        try:
            return float(value)
        except (TypeError, ValueError):
            pass
    raise DataError(f"{where}: {_sample(i, t)} is {value!r}, which is not a real number")


def read(
    path: str | PathLike[str],
    time: str = "t",
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    rename: Mapping[str, str] | None = None,
    columns: Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
    delimiter: str | None = None,
    name: str | None = None,
    interpolation: Interpolation = "linear",
    window: tuple[float, float] | None = None,
) -> Experiment:
    """Reads a record from a text table: CSV, TSV or columns apart by blanks, also gzipped.

    time       name of the time column, in s (after ``rename``).
    inputs     names of the input columns; None: a model finds its inputs among all columns.
    outputs    the same for outputs. With both given, the other columns are not even looked at.
    rename     ``{"name in the file": "name in the model"}``.
    columns    names of all columns in order, for a file without a header (or in place of the header).
    units      ``{"name": "unit"}`` for labels; a header such as ``alpha [deg]`` or ``alpha (deg)``, or a row
               of units beneath it, is understood. Nothing is converted.
    delimiter  None: found out from the file.
    name       name of the experiment; None: the file's name without its ending.
    window     ``(t0, t1)`` in s keeps a part.

    Lines that begin with ``#`` or ``%`` are comments. Empty cells, ``NaN`` and ``NA`` are missing samples.
    Raises DataError with the line and the column for a cell that is no number, with the line for a row that
    has too many or too few cells, and with the names there are for a column that is not there.
    """
    table = _parse(Path(path), columns, delimiter)
    names = _renamed(table, rename or {})
    if time not in names:
        raise DataError(f"{table.file}: has no time column '{time}'.{_listing(time, names)} Give time='...'.")
    available = [n for n in names if n != time]
    for kind, wanted in (("input", inputs), ("output", outputs), ("unit", units)):
        if isinstance(wanted, str):
            raise DataError(f"{kind}s='{wanted}' is text: give a list of names, such as {kind}s=['{wanted}']")
        for n in wanted or ():
            if n not in available and not (kind == "unit" and n == time):
                raise DataError(f"{table.file}: has no column '{n}' ({kind}s=...).{_listing(n, available)}")
    used = available if inputs is None or outputs is None else list(dict.fromkeys([*inputs, *outputs]))
    data = {n: _numbers(table, names.index(n), n) for n in (time, *used)}
    experiment = Experiment(
        data.pop(time),
        {n: data[n] for n in inputs or ()},
        {n: data[n] for n in outputs or ()},
        name=_stem(Path(path)) if name is None else name,
        interpolation=interpolation,
        channels=data if used is available else None,
        units={n: u for n, u in {**dict(zip(names, table.units, strict=True)), **(units or {})}.items() if u},
    )
    return experiment if window is None else experiment.window(*window)


@dataclass(frozen=True)
class _Table:
    """A text table cut into cells; ``headers`` as written, ``names`` and ``units`` split from them."""

    file: str
    headers: list[str]
    names: list[str]
    units: list[str]
    lines: list[int]
    rows: list[list[str]]


_MISSING = frozenset({"", "nan", "na", "n/a", "null", "none"})


def _parse(path: Path, columns: Sequence[str] | None, delimiter: str | None) -> _Table:
    file = str(path)
    content: list[tuple[int, str]] = []
    comment = ""
    for number, line in enumerate(_text(path).replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1):
        stripped = line.strip()
        if stripped.startswith(("#", "%")):
            comment = comment if content else stripped.lstrip("#% ")
        elif stripped:
            content.append((number, line))
    if not content:
        raise DataError(f"{file}: is empty")
    # The third line is surely data: a header and a row of units may stand before it.
    split = _splitter(delimiter, content[min(2, len(content) - 1)][1])
    first = split(_glued(content[0][1]))
    if columns is not None:
        if isinstance(columns, str):
            raise DataError(f"columns='{columns}' is text: give a list of names")
        headers = list(columns)
        start = 1 if all(_is_text(cell) for cell in first if cell) else 0
    elif _is_text(next((cell for cell in first if cell), "")):
        headers, start = first, 1
    elif len(split(_glued(comment))) == len(first) and all(map(_is_text, split(_glued(comment)))):
        headers, start = split(_glued(comment)), 0  # as numpy.savetxt(header=...) writes it
    else:
        raise DataError(
            f"{file}, line {content[0][0]}: a header is missing (the line holds numbers); "
            f"name its {len(first)} columns with columns=[...]"
        )
    headers = [header or f"column{j}" for j, header in enumerate(headers, start=1)]
    lines = [number for number, _ in content[start:]]
    rows = [split(line) for _, line in content[start:]]
    names, units = _split_units(headers)
    if start == 1 and rows and len(rows[0]) == len(names) and all(_is_text(cell) for cell in rows[0] if cell):
        units = [cell.strip("[]()- ") for cell in rows.pop(0)]
        lines.pop(0)
    for number, row in zip(lines, rows, strict=True):
        if len(row) != len(names):
            source = "columns=[...] names" if columns is not None else "the header has"
            raise DataError(f"{file}, line {number}: has {len(row)} fields, but {source} {len(names)}")
    if not rows:
        raise DataError(f"{file}: has a header but no rows of data")
    for name in names:
        if names.count(name) > 1:
            raise DataError(f"{file}: two columns are called '{name}'; name all columns with columns=[...]")
    return _Table(file, headers, names, units, lines, rows)


def _text(path: Path) -> str:
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        near = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
        raise DataError(f"{path}: there is no such file.{did_you_mean(path.name, near)}") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error
    if raw.startswith(b"\x1f\x8b"):
        import gzip
        import zlib

        try:
            raw = gzip.decompress(raw)
        except (OSError, EOFError, zlib.error) as error:
            raise DataError(f"{path}: the gzip file is damaged or cut short ({error})") from None
    if b"\0" in raw[:4096]:
        raise DataError(
            f"{path}: is not a text table; load it with its own reader (scipy.io.loadmat, pandas.read_excel) "
            "and give the arrays to Experiment(t, inputs={...}, outputs={...})"
        )
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")  # a degree sign in a unit, written by older Windows tools


def _splitter(delimiter: str | None, sample: str) -> Any:
    """A function that cuts a line into stripped fields."""
    if delimiter is None:
        # A tab may be mere alignment among blanks: it delimits only where no field has a blank inside.
        tabs = "\t" in sample and not any(" " in cell.strip() for cell in sample.split("\t"))
        delimiter = "\t" if tabs else ";" if ";" in sample else "," if "," in sample else None
    elif not delimiter.strip(" "):
        delimiter = None

    def split(line: str) -> list[str]:
        if delimiter is None:
            return line.split()
        if '"' in line:
            import csv

            return [
                cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
            ]
        return [cell.strip() for cell in line.split(delimiter)]

    return split


def _glued(header: str) -> str:
    """Keeps a unit with its name where blanks delimit: ``alpha [deg]`` becomes ``alpha[deg]``."""
    return re.sub(r"\s+(?=[\[(])", "", header)


def _is_text(cell: str) -> bool:
    if cell.lower() in _MISSING:
        return False
    try:
        float(cell)
    except ValueError:
        return True
    return False


def _split_units(headers: Iterable[str]) -> tuple[list[str], list[str]]:
    names, units = [], []
    for header in headers:
        match = re.fullmatch(r"(.+?)\s*[\[(]\s*([^\[\]()]+?)\s*[\])]", header)
        # A whole number in brackets is an index, as in PX4's "xyz[0]", and part of the name.
        if match and not match[2].isdigit():
            names.append(match[1])
            units.append("" if match[2] == "-" else match[2])
        else:
            names.append(header)
            units.append("")
    return names, units


def _renamed(table: _Table, rename: Mapping[str, str]) -> list[str]:
    names = list(table.names)
    for old, new in rename.items():
        if old in table.names:
            names[table.names.index(old)] = new
        elif old in table.headers:
            names[table.headers.index(old)] = new
        else:
            raise DataError(f"{table.file}: rename: there is no column '{old}'.{_listing(old, table.names)}")
    for name in names:
        if names.count(name) > 1:
            raise DataError(f"{table.file}: rename: two columns would be called '{name}'")
    return names


def _numbers(table: _Table, j: int, name: str) -> FloatArray:
    cells = [row[j] for row in table.rows]
    try:
        return np.fromiter(map(float, cells), dtype=np.float64, count=len(cells))
    except ValueError:
        pass
    values = np.empty(len(cells))
    for i, cell in enumerate(cells):
        try:
            values[i] = np.nan if cell.lower() in _MISSING else float(cell)
        except ValueError:
            comma = " (a decimal comma? write a point)" if re.fullmatch(r"[+-]?\d+,\d+.*", cell) else ""
            raise DataError(
                f"{table.file}, line {table.lines[i]}, column '{name}': '{cell}' is not a number{comma}; "
                "leave a missing sample empty or NaN, or leave the column out by naming inputs=[...] and "
                "outputs=[...]"
            ) from None
    return values


def _stem(path: Path) -> str:
    name = path.name.removesuffix(".gz")
    return name.rsplit(".", 1)[0] if "." in name[1:] else name
