"""Tables of pandas and polars, datasets of xarray (none is imported here), Parquet files; and files of named arrays,
flat or in groups (MATLAB and HDF5): which arrays are channels, and where their times are."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import DataError
from . import TIMES, Column, Source, contents, existing, load, reading, split_unit, stem
from .text import words

__all__ = [
    "is_frame",
    "read_frame",
    "read_hdf5",
    "read_matlab",
    "read_parquet",
]


def is_frame(data: Any) -> bool:
    """Return whether an object is a table of pandas, polars or xarray, recognised by the name of its class."""
    return _kind(data) in _READERS


def read_frame(data: Any, time: str | None) -> Source:
    """Read the columns of a table in memory; the unit is part of a name such as ``alpha [deg]``, or in xarray the
    attribute ``units``.

    pandas: an index with a name, or one of times, is a column too, and the time unless there is one called so. An index
    of integers without a name numbers the rows, and is no time.
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
    columns, left_out = _without_words(columns, [kind.kind for kind in frame.dtypes])
    index = frame.index
    time_name = "t" if time is None else time
    if not _has_times(time, [column.name for column in columns]) and getattr(index, "nlevels", 1) == 1:
        own = index.name is None and np.asarray(index).dtype.kind not in "iu"
        if own or index.name is not None:
            name = time_name if own else str(index.name)
            clock = _column(name, lambda _: index.to_numpy())
            times = clock.name if time is None else None
            columns = [clock, *(Column(c.name, c.values, c.unit, c.header, times) for c in columns)]
            if times is not None:
                columns[0] = Column(clock.name, clock.values, clock.unit, clock.header, times)
    return _source(columns, "the DataFrame", left_out)


def _without_words(columns: list[Column], kinds: Sequence[str]) -> tuple[list[Column], dict[str, str]]:
    """Return the columns that do not hold words, and why the others are left out, as a text file's are; ``kinds`` are
    those of numpy's types, of which only "O" may be text."""
    left_out = {}
    for column, kind in zip(columns, kinds, strict=True):
        if kind != "O":
            continue
        values: Any = column.values(column.name)
        cells = [cell for cell in values if cell is not None and cell == cell]  # NaN is missing
        if all(isinstance(cell, str) for cell in cells) and (word := words(cells)):
            left_out[column.name] = f"holds text ({word!r})"
    return [c for c in columns if c.name not in left_out], left_out


def _has_times(time: str | None, names: Sequence[str]) -> bool:
    """Return whether a column has the name of the times: as given, else any that needs no ``time=``."""
    return time in names if time is not None else any(n == "t" or n.lower() in TIMES for n in names)


def _of_pandas(frame: Any, j: int, name: str) -> Any:
    return frame.iloc[:, j].to_numpy()


def _pandas_series(series: Any, time: str | None) -> Source:
    return _pandas(series.to_frame("value" if series.name is None else series.name), time)


def _polars(frame: Any, time: str | None) -> Source:
    if hasattr(frame, "collect"):
        frame = frame.collect()
    columns = [_column(n, lambda _, n=n: frame[n].to_numpy()) for n in frame.columns]
    kinds = ["O" if str(kind) in ("String", "Utf8", "Categorical", "Object") else "" for kind in frame.dtypes]
    columns, left_out = _without_words(columns, kinds)
    return _source(columns, "the DataFrame", left_out)


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
    labels = [split_unit(field.name)[0] for field in fields]
    columns = []
    for field in fields:
        name, unit = split_unit(field.name)
        metadata = field.metadata or {}
        unit = next((metadata[key].decode("utf-8", "replace") for key in (b"units", b"unit") if key in metadata), unit)
        if name == "__index_level_0__" and not _has_times(time, labels) and "int" not in str(field.type):
            name = time or "t"
        columns.append(Column(name, _reader(parquet, path, field.name), unit, field.name))
    return Source(str(path), stem(path), columns)


def _reader(parquet: Any, path: Path, column: str) -> Callable[[str], Any]:
    """Return a function that reads one column when it is called: the format stores columns one by one."""

    def values(name: str) -> Any:
        with reading(f"{path}, column '{name}'", _KIND):
            return parquet.ParquetFile(path).read(columns=[column]).column(0).to_numpy()

    return values


@dataclass(frozen=True)
class Leaf:
    """An array of a file, not yet read.

    path   group and name, each a part.
    shape  without axes of length 1.
    read   gives the array in that shape.
    why    what keeps it from being a channel, such as "holds text"; "" where nothing does.
    """

    path: tuple[str, ...]
    shape: tuple[int, ...]
    read: Callable[[], Any]
    unit: str = ""
    why: str = ""


def from_leaves(
    where: str, name: str, leaves: Sequence[Leaf], time: str | None, columns: Sequence[str] | None
) -> Source:
    """Return the columns of arrays, called ``group.name`` or, of a matrix, ``group.name[0]``, ``group.name[1]``...

    A group that holds everything is not named, but may be. The times of an array are called ``time`` (None: ``t``, else
    ``time``) and stand in its own group or in one above it. A matrix has a column for a channel, or a row where only
    the rows are as long as the times. ``columns`` names the columns of the one matrix that there is.
    """
    usable = [leaf for leaf in leaves if not leaf.why and leaf.shape]
    if not usable:
        reasons = [f"'{'.'.join(leaf.path)}' {leaf.why or 'is a single value'}" for leaf in leaves]
        raise DataError(f"{where}: has no arrays of numbers{': ' if reasons else ''}{'; '.join(reasons[:10])}")
    if columns is not None:
        return Source(where, name, _of_matrix(where, usable, columns))
    depth = 0
    while all(len(leaf.path) > depth + 1 and leaf.path[depth] == usable[0].path[depth] for leaf in usable):
        depth += 1
    group = "".join(f"{part}." for part in usable[0].path[:depth])
    time = None if time is None else time.removeprefix(group)
    known = {".".join(leaf.path[depth:]): leaf for leaf in usable}
    left_out = {
        ".".join(leaf.path[depth:] or leaf.path): leaf.why or "is a single value, no time history"
        for leaf in leaves
        if leaf.why or not leaf.shape
    }
    found: list[Column] = []
    for full, leaf in known.items():
        clock = _clock(full, known, time)
        samples = known[clock].shape[0] if clock is not None else None
        if samples is None or samples == leaf.shape[0]:
            axis = 0
        elif len(leaf.shape) == 2 and samples == leaf.shape[1]:
            axis = 1
        else:
            left_out[full] = f"has {_size(leaf)} values, but its times '{clock}' {samples}"
            continue
        for suffix, place in _places(leaf.shape, axis):
            found.append(Column(full + suffix, _channel_reader(leaf, place), leaf.unit, times=clock))
    return Source(where, name, found, left_out, group)


def _clock(full: str, known: dict[str, Leaf], time: str | None) -> str | None:
    """Return the name of the times nearest to an array, going up from its own group."""
    group = full.split(".")[:-1]
    for depth in range(len(group), -1, -1):
        for candidate in (time,) if time is not None else ("t", "time"):
            path = ".".join([*group[:depth], candidate])
            if path in known and len(known[path].shape) == 1:
                return path
    return None


def _places(shape: tuple[int, ...], axis: int) -> list[tuple[str, Any]]:
    """Return the suffix of the name and the index of each channel in an array whose samples run along an axis."""
    if len(shape) == 1:
        return [("", slice(None))]
    across = shape[:axis] + shape[axis + 1 :]
    places = []
    for place in np.ndindex(*across):
        ending = "".join(f"[{i}]" for i in place)
        places.append((ending, (*place[:axis], slice(None), *place[axis:])))
    return places


def _of_matrix(where: str, usable: Sequence[Leaf], columns: Sequence[str]) -> list[Column]:
    if isinstance(columns, str):
        raise DataError(f"columns='{columns}' is text: give a list of names")
    matrices = [leaf for leaf in usable if len(leaf.shape) == 2]
    fitting = [leaf for leaf in matrices if len(columns) in leaf.shape]
    if len(fitting) != 1:
        there = ", ".join(f"'{'.'.join(leaf.path)}' ({_size(leaf)})" for leaf in matrices) or "none"
        raise DataError(
            f"{where}: columns=[...] names {len(columns)}, for the columns of one matrix; the matrices are {there}"
        )
    repeated = [n for n in columns if list(columns).count(n) > 1]
    if repeated:
        raise DataError(f"{where}: columns=[...] names two columns '{repeated[0]}'")
    (leaf,) = fitting
    axis = 0 if leaf.shape[1] == len(columns) else 1
    places = _places(leaf.shape, axis)
    return [Column(n, _channel_reader(leaf, place), leaf.unit) for n, (_, place) in zip(columns, places, strict=True)]


def _channel_reader(leaf: Leaf, place: Any) -> Callable[[str], Any]:
    return lambda name: leaf.read()[place]


def _size(leaf: Leaf) -> str:
    return " x ".join(map(str, leaf.shape))


_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})
_KINDS = _NUMBERS | {_MATRIX, _COMPRESSED, 16, 17, 18}
_CHARACTERS, _FIRST_NUMERIC, _LAST_NUMERIC = 4, 6, 15  # classes of arrays


def is_whole(raw: bytes) -> bool:
    """Return False where a tag in the file names no known type, or more bytes than there are."""
    if len(raw) < 128 or raw[126:128] not in (b"IM", b"MI") or b"\0" in raw[:4]:
        return True  # of another version: scipy reports it
    order = "<" if raw[126:128] == b"IM" else ">"
    return _elements(raw, 128, len(raw), order) is not None


def _elements(raw: bytes, start: int, end: int, order: str) -> list[tuple[int, int, int]] | None:
    """Return type, first byte and size of each element; None where the bytes are not valid element."""
    found = []
    while start < end:
        if start + 8 > end:
            return None
        kind, size = struct.unpack_from(f"{order}II", raw, start)
        first, following = start + 8, start + 8 + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        if kind >> 16:  # up to 4 bytes within the tag itself
            kind, size, first, following = kind & 0xFFFF, kind >> 16, start + 4, start + 8
            if size > 4:
                return None
        if kind not in _KINDS or first + size > end:
            return None
        if kind == _MATRIX and size and not _matrix(raw, first, first + size, order):
            return None
        found.append((kind, first, size))
        start = following
    return found


def _matrix(raw: bytes, start: int, end: int, order: str) -> bool:
    parts = _elements(raw, start, end, order)
    if parts is None or not parts or parts[0][2] != 8:
        return False
    (flags,) = struct.unpack_from(f"{order}I", raw, parts[0][1])
    kind, is_complex = flags & 0xFF, bool(flags & 0x800)
    if _FIRST_NUMERIC <= kind <= _LAST_NUMERIC:
        return len(parts) == 4 + is_complex and all(part[0] in _NUMBERS for part in parts[1:2] + parts[3:])
    return kind != _CHARACTERS or len(parts) == 4


def read_hdf5(path: Path, time: str | None, columns: Sequence[str] | None, matlab: bool = False) -> Source:
    """Read the datasets of an HDF5 file, called ``group.name``; of a compound dataset its fields.

    A dataset's unit is its attribute ``units`` or ``unit``. ``matlab``: axes are reversed, and text is stored as
    numbers, as MATLAB does it.
    """
    existing(path)
    kind = "a MATLAB 7.3 file" if matlab else "an HDF5 file"
    h5py = load("h5py", kind, "hdf5")
    leaves: list[Leaf] = []

    def visit(key: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or key.startswith("#"):
            return
        parts = tuple(key.split("/"))
        unit = next((_text(item.attrs[a]) for a in ("units", "unit") if a in item.attrs), "")
        for field in item.dtype.names or (None,):
            dtype = item.dtype if field is None else item.dtype[field]
            text = matlab and _text(item.attrs.get("MATLAB_class", "")) in ("char", "cell", "string")
            why = "holds no numbers" if text or dtype.kind not in "biufc" or dtype.subdtype else ""
            shape = tuple(n for n in (item.shape or ()) if n != 1)
            shape = () if 0 in shape or "MATLAB_empty" in item.attrs else shape
            path_in = parts if field is None else (*parts, field)
            leaves.append(
                Leaf(
                    path_in,
                    shape[::-1] if matlab else shape,
                    _dataset_reader(h5py, path, kind, key, field, matlab),
                    unit,
                    why,
                )
            )

    with reading(path, kind), h5py.File(path, "r") as file:
        file.visititems(visit)
    return from_leaves(str(path), stem(path), leaves, time, columns)


def _dataset_reader(h5py: Any, path: Path, kind: str, key: str, field: str | None, matlab: bool) -> Any:
    """Return a function that reads a dataset when it is called: a file may hold far more than is used."""

    def read() -> Any:
        with reading(f"{path}, dataset '{key}'", kind), h5py.File(path, "r") as file:
            values = file[key][()] if field is None else file[key][field]
        return np.squeeze(values.T if matlab else values)

    return read


def _text(value: Any) -> str:
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def read_matlab(path: Path, time: str | None, columns: Sequence[str] | None) -> Source:
    """Read the arrays of a ``.mat`` file; a field of a structure is called ``structure.field``.

    Tables, timetables and timeseries are objects that MATLAB alone can read: there, save their columns.
    """
    raw = contents(path)
    head = raw[:520]
    if head.startswith(b"\x89HDF") or head[512:].startswith(b"\x89HDF"):
        return read_hdf5(path, time, columns, matlab=True)
    if not is_whole(raw):
        raise DataError(f"{path}: is not a MATLAB file, or is damaged or cut short (its parts do not fit together)")
    with reading(path, "a MATLAB file"):
        from scipy.io import loadmat

        content = loadmat(str(path), simplify_cells=True)
    leaves = [leaf for key, value in content.items() if not key.startswith("__") for leaf in _leaves((key,), value)]
    return from_leaves(str(path), stem(path), leaves, time, columns)


def _leaves(path: tuple[str, ...], value: Any) -> Iterator[Leaf]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves((*path, key), inner)
        return
    if isinstance(value, np.ndarray) and value.dtype.kind == "O" and all(isinstance(v, dict) for v in value.flat):
        for i, inner in enumerate(value.flat):
            yield from _leaves((*path[:-1], f"{path[-1]}[{i}]"), inner)
        return
    if type(value).__name__ in ("MatlabOpaque", "MatlabFunction") or (
        isinstance(value, np.ndarray) and value.dtype.names is not None
    ):
        why = "is an object that MATLAB alone can read (a table, a timeseries): save its columns there as arrays"
    elif (isinstance(value, np.ndarray) and value.dtype.kind in "biufc") or isinstance(
        value, (int, float, complex, np.generic)
    ):
        why = ""
    else:
        why = "holds no numbers"
    array = np.asarray(value) if not why else np.empty(0)
    yield Leaf(path, array.shape if array.size > 1 else (), lambda: array, why=why)
