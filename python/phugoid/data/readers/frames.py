"""Tables of pandas and polars, datasets of xarray (none is imported here); Parquet files, read by pyarrow."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import DataError
from .source import Column, Source, existing, load, reading, split_unit, stem

__all__ = ["is_frame", "read_frame", "read_parquet"]


def is_frame(data: Any) -> bool:
    """Return whether an object is a table of pandas, polars or xarray, recognised by the name of its class."""
    return _kind(data) in _READERS


def read_frame(data: Any, time: str | None) -> Source:
    """Read the columns of a table in memory; the unit is part of a name such as ``alpha [deg]``, or in xarray the
    attribute ``units``.

    pandas: an index with a name, or one of times, is a column too, and the time unless there is one called so.
    xarray: each dimension is a clock of its own, whose times are its coordinate, or ``time`` along it.
    """
    return _READERS[_kind(data)](data, time)


def _kind(data: Any) -> str:
    return f"{type(data).__module__.partition('.')[0]}.{type(data).__name__}"


def _pandas(frame: Any, time: str | None) -> Source:
    if getattr(frame.columns, "nlevels", 1) > 1:
        frame = frame.set_axis([".".join(map(str, name)) for name in frame.columns], axis=1)
    names = [str(name) for name in frame.columns]
    columns = [_column(name, partial(_of_pandas, frame, j)) for j, name in enumerate(names)]
    index = frame.index
    time_name = "t" if time is None else time
    if time_name not in [column.name for column in columns] and getattr(index, "nlevels", 1) == 1:
        own = index.name is None and type(index).__name__ != "RangeIndex"
        if own or index.name is not None:
            name = time_name if own else str(index.name)
            clock = _column(name, lambda _: index.to_numpy())
            times = clock.name if time is None else None
            columns = [clock, *(Column(c.name, c.values, c.unit, c.header, times) for c in columns)]
            if times is not None:
                columns[0] = Column(clock.name, clock.values, clock.unit, clock.header, times)
    return _source(columns, "the DataFrame")


def _of_pandas(frame: Any, j: int, name: str) -> Any:
    return frame.iloc[:, j].to_numpy()


def _pandas_series(series: Any, time: str | None) -> Source:
    return _pandas(series.to_frame("value" if series.name is None else series.name), time)


def _polars(frame: Any, time: str | None) -> Source:
    if hasattr(frame, "collect"):
        frame = frame.collect()
    return _source([_column(n, lambda _, n=n: frame[n].to_numpy()) for n in frame.columns], "the DataFrame")


def _xarray(data: Any, time: str | None) -> Source:
    columns, left_out = [], {}
    for key, variable in data.variables.items():
        name = str(key)
        if not variable.dims:
            left_out[name] = "is a single value, no time history"
            continue
        clock = _dimension(data, variable, time)
        unit = str(variable.attrs.get("units", variable.attrs.get("unit", "")))
        along, *across = (clock[0], *(d for d in variable.dims if d != clock[0]))
        values = variable.transpose(along, *across)
        for place in np.ndindex(*values.shape[1:]):
            ending = "".join(f"[{i}]" for i in place)
            columns.append(Column(name + ending, partial(_of_xarray, values, place), unit, times=clock[1]))
    return _source(columns, "the Dataset", left_out)


def _dimension(data: Any, variable: Any, time: str | None) -> tuple[Any, str | None]:
    """Return the dimension that samples of a variable run along, and the coordinate that has its times."""
    for name in (time,) if time is not None else ("t", "time"):
        if name in data.variables and len(data[name].dims) == 1 and data[name].dims[0] in variable.dims:
            return data[name].dims[0], name
    timed = [d for d in variable.dims if d in data.variables]
    return (timed[0], str(timed[0])) if timed else (variable.dims[0], None)


def _of_xarray(values: Any, place: tuple[int, ...], name: str) -> Any:
    samples: tuple[Any, ...] = (slice(None), *place)
    return np.asarray(values.values)[samples]


def _xarray_array(array: Any, time: str | None) -> Source:
    return _xarray(array.to_dataset(name="value" if array.name is None else array.name), time)


def _column(header: str, values: Any) -> Column:
    name, unit = split_unit(header)
    return Column(name, values, unit, header)


def _source(columns: list[Column], where: str, left_out: dict[str, str] | None = None) -> Source:
    names = [column.name for column in columns]
    for name in names:
        if names.count(name) > 1:
            raise DataError(f"{where}: two columns are called '{name}'")
    if not columns:
        raise DataError(f"{where}: has no columns")
    return Source(where, "experiment", columns, left_out or {})


_READERS = {
    "pandas.DataFrame": _pandas,
    "pandas.Series": _pandas_series,
    "polars.DataFrame": _polars,
    "polars.LazyFrame": _polars,
    "xarray.Dataset": _xarray,
    "xarray.DataArray": _xarray_array,
}


_KIND = "a Parquet file"


def read_parquet(path: Path, time: str | None) -> Source:
    """Read the columns of a Parquet file; a unit is part of the name, or ``unit`` or ``units`` in the field's metadata.

    The index of a pandas frame without a name is the time where no column is called so.
    """
    existing(path)
    parquet = load("pyarrow.parquet", _KIND, "parquet")
    with reading(path, _KIND):
        schema = parquet.read_schema(path)
        fields = list(schema)
    names = [field.name for field in fields]
    columns = []
    for field in fields:
        name, unit = split_unit(field.name)
        metadata = field.metadata or {}
        unit = next((metadata[key].decode("utf-8", "replace") for key in (b"units", b"unit") if key in metadata), unit)
        if name == "__index_level_0__" and (time or "t") not in names:
            name = time or "t"
        columns.append(Column(name, _reader(parquet, path, field.name), unit, field.name))
    return Source(str(path), stem(path), columns)


def _reader(parquet: Any, path: Path, column: str) -> Callable[[str], Any]:
    """Return a function that reads one column when it is called: the format stores columns one by one."""

    def values(name: str) -> Any:
        with reading(f"{path}, column '{name}'", _KIND):
            return parquet.ParquetFile(path).read(columns=[column]).column(0).to_numpy()

    return values
