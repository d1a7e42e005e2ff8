"""Text tables as flight-test tools write them: CSV, TSV and the like, also gzipped."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DataError
from ..experiment import FloatArray
from . import KINDS, Column, Source, contents, split_unit, stem

__all__ = ["read_text"]


def read_text(path: Path, columns: Sequence[str] | None, delimiter: str | None) -> Source:
    """Read the columns of a text table, whose cells become numbers when they are asked for.

    columns    names of all columns in order, in place of a header.
    delimiter  None: found out from the file.

    Lines that begin with ``#`` or ``%`` are comments, and lines with fewer cells before the header are passed over. A
    column of words, such as remarks, is left out; a column of dates with times (ISO 8601) is one of ``datetime64``.
    DataError names the line of a row that has too many or too few cells, and the line and the column of a cell that is
    not a number.
    """
    table = _parse(path, columns, delimiter)
    parts = zip(table.names, table.units, table.headers, strict=True)
    found = [Column(n, partial(_numbers, table, j), unit, header) for j, (n, unit, header) in enumerate(parts)]
    left_out = {n: f"holds text ({cell!r})" for j, n in enumerate(table.names) if (cell := _remark(table, j))}
    return Source(table.file, stem(path), [column for column in found if column.name not in left_out], left_out)


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
# Numbers that stand for missing samples in many files; a column whose other values come near them may mean them.
_FILLED, _NEAR = (-9999.0, -99999.0), 0.5
# A number with a comma, which may be a decimal one or separate thousands, and one in which it may be either.
_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
_WORDS = re.compile(r"[^\W\d]")
# A date and a time of ISO 8601, with seconds and an offset from UTC where they are given.
_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d(?:[.,]\d{1,9})?)?)"  # date and time
    r"(?:Z|([+-])(\d\d):?(\d\d))?"  # offset
)


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
    # A line in the middle is surely data: a preamble, a header and a row of units may stand before it.
    split = _splitter(file, delimiter, content[max(len(content) // 2, min(2, len(content) - 1))][1])
    if columns is None:
        content = content[_header_at(content, split) :]
    first = split(_join_unit(content[0][1]))
    if columns is not None:
        if isinstance(columns, str):
            raise DataError(f"columns='{columns}' is text: give a list of names")
        headers = list(columns)
        start = 1 if all(_is_text(cell) for cell in first if cell) else 0
    elif _is_text(next((cell for cell in first if cell), "")):
        headers, start = first, 1
    elif len(split(_join_unit(comment))) == len(first) and all(map(_is_text, split(_join_unit(comment)))):
        headers, start = split(_join_unit(comment)), 0  # as numpy.savetxt(header=...) writes it
    else:
        raise DataError(
            f"{file}, line {content[0][0]}: a header is missing (the line holds numbers); "
            f"name its {len(first)} columns with columns=[...]"
        )
    headers = [header or f"column{j}" for j, header in enumerate(headers, start=1)]
    lines = [number for number, _ in content[start:]]
    rows = [split(line) for _, line in content[start:]]
    names, units = map(list, zip(*map(split_unit, headers), strict=True)) if headers else ([], [])
    if start == 1 and rows and len(rows[0]) == len(names) and all(_is_text(cell) for cell in rows[0] if cell):
        units = [cell.strip("[]()- ") for cell in rows.pop(0)]
        lines.pop(0)
    for number, row in zip(lines, rows, strict=True):
        if len(row) != len(names):
            source = "columns=[...] names" if columns is not None else "the header has"
            raise DataError(f"{file}, line {number}: has {len(row)} fields, but {source} {len(names)}")
    if not rows:
        raise DataError(f"{file}: has a header but no rows of data")
    if _decimal_commas(rows):
        rows = [[cell.replace(",", ".") if _COMMA.fullmatch(cell) else cell for cell in row] for row in rows]
    for name in names:
        if names.count(name) > 1:
            raise DataError(f"{file}: two columns are called '{name}'; name all columns with columns=[...]")
    return _Table(file, headers, names, units, lines, rows)


def _header_at(content: Sequence[tuple[int, str]], split: Callable[[str], list[str]]) -> int:
    """Return the number of the line that is the header: the first with as many cells as the last, where all before have
    fewer and it holds text alone; otherwise 0."""
    wide = len(split(content[-1][1]))
    for k, (_, line) in enumerate(content):
        cells = split(_join_unit(line))
        if len(cells) == wide:
            # A row of units beneath a header that lacks a name is not a header.
            named = all(_is_text(cell) and cell[0] not in "[(" for cell in cells if cell)
            return k if named and any(cells) else 0
        if len(cells) > wide:
            return 0
    return 0


def _text(path: Path) -> str:
    raw = contents(path)
    if raw.startswith(b"\x1f\x8b"):
        import gzip
        import zlib

        try:
            raw = gzip.decompress(raw)
        except (OSError, EOFError, zlib.error) as error:
            raise DataError(f"{path}: the gzip file is damaged or cut short ({error})") from None
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):  # "Unicode text" of spreadsheets
        with contextlib.suppress(UnicodeDecodeError):
            return raw.decode("utf-16")
    if b"\0" in raw[:4096]:
        raise DataError(
            f"{path}: is not a text table; other files are recognised by their endings ({KINDS}); load it "
            "with its own reader (pandas.read_excel) and give the table to ph.read"
        )
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")  # a degree sign in a unit, written by older Windows tools


def _splitter(file: str, delimiter: str | None, sample: str) -> Any:
    """Return a function that splits a line into stripped fields."""
    if delimiter is None:
        # A tab may only align columns between blanks: it delimits only where no field contains a blank.
        tabs = "\t" in sample and not any(" " in cell.strip() for cell in sample.split("\t"))
        delimiter = "\t" if tabs else ";" if ";" in sample else "," if "," in sample else None
    elif not delimiter.strip(" "):
        delimiter = None

    def split(line: str) -> list[str]:
        if delimiter is None:
            return line.split()
        if '"' in line:
            import csv

            try:
                return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
            except csv.Error as error:
                raise DataError(f"{file}: is not a table of text ({error})") from None
        return [cell.strip() for cell in line.split(delimiter)]

    return split


def _join_unit(header: str) -> str:
    """Remove the blanks before a unit where blanks delimit: ``alpha [deg]`` becomes ``alpha[deg]``."""
    return re.sub(r"\s+(?=[\[(])", "", header)


def _is_text(cell: str) -> bool:
    if cell.lower() in _MISSING or _DATE.fullmatch(cell) or _COMMA.fullmatch(cell):
        return False
    try:
        float(cell)
    except ValueError:
        return True
    return False


def _decimal_commas(rows: list[list[str]]) -> bool:
    """Return whether commas in numbers are decimal ones: no number has a point, and in one of them at least the comma
    cannot separate thousands."""
    commas = [cell for row in rows for cell in row if "," in cell and _COMMA.fullmatch(cell)]
    if not commas or all(map(_EITHER.fullmatch, commas)):
        return False
    return not any("." in cell and not _is_text(cell) for row in rows for cell in row)


def _numbers(table: _Table, j: int, name: str) -> NDArray[Any]:
    cells = [row[j] for row in table.rows]
    try:
        return _filled(table, name, np.fromiter(map(float, cells), dtype=np.float64, count=len(cells)))
    except ValueError:
        pass
    if any(map(_DATE.fullmatch, cells)):
        return np.array([_moment(table, i, name, cell) for i, cell in enumerate(cells)])
    values = np.empty(len(cells))
    for i, cell in enumerate(cells):
        try:
            values[i] = np.nan if cell.lower() in _MISSING else float(cell)
        except ValueError:
            comma = (
                " (decimal commas or thousands? The file does not show which: write points, or give "
                "ph.read(pandas.read_csv(..., sep=';', decimal=',')))"
                if _COMMA.match(cell)
                else ""
            )
            raise DataError(
                f"{table.file}, line {table.lines[i]}, column '{name}': '{cell}' is not a number{comma}; "
                "leave a missing sample empty or NaN, or leave the column out by naming inputs=[...] and "
                "outputs=[...]"
            ) from None
    return _filled(table, name, values)


def _remark(table: _Table, j: int) -> str:
    """Return the first text of a column that holds words and missing cells alone, such as remarks; "" for any other."""
    return words(row[j] for row in table.rows)


def words(cells: Iterable[str]) -> str:
    """Return the first text of cells that are words or missing, such as remarks; "" where others are among them."""
    there = (cell for cell in cells if cell.lower() not in _MISSING)
    first = next(there, "")
    if not _WORDS.match(first) or not _is_text(first):
        return ""
    return first if all(_WORDS.match(cell) and _is_text(cell) for cell in there) else ""


def _moment(table: _Table, i: int, name: str, cell: str) -> np.datetime64:
    """Return a date with its time in UTC; raise DataError for a cell that is neither that nor missing."""
    found = _DATE.fullmatch(cell)
    if found is None and cell.lower() in _MISSING:
        return np.datetime64("NaT", "ns")
    try:
        if found is None:
            raise ValueError
        day, clock, sign, hours, minutes = found.groups()
        moment = np.datetime64(f"{day}T{clock.replace(',', '.')}", "ns")
    except ValueError:
        raise DataError(
            f"{table.file}, line {table.lines[i]}, column '{name}': '{cell}' is not a date with its time, as other "
            "cells of the column are (2024-05-31T12:00:00.25)"
        ) from None
    offset = np.timedelta64(int(hours) * 60 + int(minutes), "m") if sign else np.timedelta64(0, "m")
    return moment + offset if sign == "-" else moment - offset


def _filled(table: _Table, name: str, values: FloatArray) -> FloatArray:
    """Return the values; raise DataError where some are numbers that stand for missing samples in many files."""
    for number in _FILLED:
        there = values == number
        if there.any() and not (np.abs(values[~there]) > _NEAR * abs(number)).any():
            first = table.lines[int(np.flatnonzero(there)[0])]
            raise DataError(
                f"{table.file}, line {first}, column '{name}': {number:g}, in {int(there.sum())} samples, stands for a "
                "missing sample in many files, and no other value comes near it: leave these cells empty, or give "
                f"ph.read(pandas.read_csv(..., na_values=[{number:g}]))"
            )
    return values
