"""The columns of a source under the user's names, as numbers in the units that are asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

from ...errors import DataError, did_you_mean
from ..checked import FloatArray, real
from .source import Source
from .units import convert as converted
from .units import si

__all__ = ["Record", "Units", "some"]

Units = Mapping[str, "str | tuple[str, str]"]


class Record:
    """The columns of a source under the names that the user gave them, as numbers in the units that he asked for."""

    def __init__(
        self, source: Source, rename: Mapping[str, str], time: str, rate: float | None, units: Units, convert: bool
    ) -> None:
        self.where, self.name, self.rate = source.where, source.name, rate
        self.left_out, self._time, self._units, self._convert = source.left_out, time, units, convert
        self._steps: dict[str, str] = {}
        self._labels: dict[str, str] = {}
        self._read: dict[str, FloatArray] = {}
        names = _renamed(source, rename)
        self._columns = dict(zip(names, source.columns, strict=True))
        by_file = {column.name: new for new, column in self._columns.items()}
        if rate is not None and not (isinstance(rate, Real) and 0 < rate < float("inf")):
            raise DataError(f"{self.where}: rate is a positive number of samples a second, not {rate!r}")
        self._clock = {n: by_file.get(c.times, time) if c.times else time for n, c in self._columns.items()}
        self.clocks = set() if rate is not None else set(self._clock.values())
        if rate is None and self.clocks == {time} and time not in self._columns:
            raise DataError(
                f"{self.where}: has no time column '{time}'.{_listing(time, names)} Give time='...', or for even "
                "sampling rate=... in Hz."
            )
        self.available = [n for n in names if n not in self.clocks]

    def check(self, wanted: Sequence[str] | None, option: str) -> None:
        for n in wanted or ():
            if n in self.available:
                continue
            if n in self.left_out:
                raise DataError(f"{self.where}: '{n}' ({option}=...) {self.left_out[n]}")
            raise DataError(f"{self.where}: has no column '{n}' ({option}=...).{_listing(n, self.available)}")

    def clock(self, name: str) -> str:
        """The name of the column with the times of this one."""
        clock = self._clock[name]
        if clock not in self._columns:
            raise DataError(f"{self.where}: has no time column '{clock}' for '{name}'.{_listing(clock, self._columns)}")
        return clock

    def times(self, clock: str) -> FloatArray:
        """Times in s: a unit that the file or the user tells is converted."""
        if clock not in self._read:
            where = f"{self.where}, time '{clock}'"
            values = real(_seconds(self._columns[clock].values(clock)), where)
            unit = self._labels[clock] = self._label(clock)
            if unit:
                # Seconds "since" some date, as the CF conventions write it, are seconds; a step of time is all we need.
                measure = unit.partition(" since ")[0]
                if si(measure) != "s":
                    raise DataError(
                        f"{where}: '{unit}' is no unit of time that is known; tell what it is, units={{'{clock}': 's'}}"
                    )
                values = converted(values, measure, "s", where)
                self._labels[clock] = "s"
            self._read[clock] = values
        return self._read[clock]

    def values(self, name: str) -> FloatArray:
        """The column's numbers, converted where that is asked for; the step and the label are kept."""
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
            into = si(unit)
            if into is None:
                raise DataError(
                    f"{where}: convert=True, but its unit '{unit}' is not known; tell what it is with "
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
        return {n: unit for n, unit in self._labels.items() if unit}

    def history(self) -> list[str]:
        return [f"converted {', '.join(self._steps.values())}"] if self._steps else []

    def _label(self, name: str) -> str:
        given = self._units.get(name, self._columns[name].unit)
        if isinstance(given, str):
            return given
        if not (isinstance(given, tuple) and len(given) == 2 and all(isinstance(unit, str) for unit in given)):
            raise DataError(f"{self.where}: units: give '{name}' its unit, or (from, to) as two, not {given!r}")
        return given[0]


def _renamed(source: Source, rename: Mapping[str, str]) -> list[str]:
    names = [column.name for column in source.columns]
    headers = [_bare(column.header) for column in source.columns]
    renamed = list(names)
    for old, new in rename.items():
        header = _bare(old)
        if old not in names and header not in headers:
            why = f" ('{old}' {source.left_out[old]})" if old in source.left_out else ""
            raise DataError(f"{source.where}: rename: there is no column '{old}'{why}.{_listing(old, names)}")
        renamed[names.index(old) if old in names else headers.index(header)] = new
    seen: set[str] = set()
    for name in renamed:
        if name in seen:
            raise DataError(f"{source.where}: rename: two columns would be called '{name}'")
        seen.add(name)
    return renamed


def _bare(header: str) -> str:
    """A header without its blanks: whether one stands before the unit is no matter."""
    return "".join(header.split())


def _seconds(values: Any) -> Any:
    """Dates as seconds since the first, time differences as seconds; all else as it is."""
    array = np.asarray(values)
    if array.dtype.kind == "M" and array.size:
        array = array - array[0]
    return array / np.timedelta64(1, "s") if array.dtype.kind == "m" else values


def _listing(name: str, available: Any) -> str:
    return f"{did_you_mean(name, available)} There are: {some(list(available)) or 'none'}."


def some(names: Sequence[str], most: int = 40) -> str:
    """Names in a row; of the hundreds in a log the first few only."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
