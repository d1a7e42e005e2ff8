"""Records from text tables: CSV, TSV and their kin, as flight-test tools write them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .errors import DataError, did_you_mean, listing
from .experiment import Experiment, FloatArray, Interpolation

__all__ = ["read"]


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
    rate: float | None = None,
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
    rate       samples a second, for a file without a time column: time runs from 0, and ``time`` is not looked for.

    Lines that begin with ``#`` or ``%`` are comments. Empty cells, ``NaN`` and ``NA`` are missing samples.
    Raises DataError with the line and the column for a cell that is no number, with the line for a row that
    has too many or too few cells, and with the names there are for a column that is not there.
    """
    table = _parse(Path(path), columns, delimiter)
    names = _renamed(table, rename or {})
    if rate is not None and not (isinstance(rate, Real) and 0 < rate < float("inf")):
        raise DataError(f"{table.file}: rate is a positive number of samples a second, not {rate!r}")
    if rate is None and time not in names:
        raise DataError(
            f"{table.file}: has no time column '{time}'.{listing(time, names)} Give time='...', or for even sampling "
            "rate=... in Hz."
        )
    available = [n for n in names if n != time or rate is not None]
    for kind, wanted in (("input", inputs), ("output", outputs), ("unit", units)):
        if isinstance(wanted, str):
            raise DataError(f"{kind}s='{wanted}' is text: give a list of names, such as {kind}s=['{wanted}']")
        for n in wanted or ():
            if n not in available and not (kind == "unit" and n == time):
                raise DataError(f"{table.file}: has no column '{n}' ({kind}s=...).{listing(n, available)}")
    used = available if inputs is None or outputs is None else list(dict.fromkeys([*inputs, *outputs]))
    columns_read = used if rate is not None else (time, *used)
    data = {n: _numbers(table, names.index(n), n) for n in columns_read}
    experiment = Experiment(
        data.pop(time) if rate is None else np.arange(len(table.rows)) / float(rate),
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

            return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
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
            raise DataError(f"{table.file}: rename: there is no column '{old}'.{listing(old, table.names)}")
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
