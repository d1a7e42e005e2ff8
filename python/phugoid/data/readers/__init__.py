"""Readers, one for each kind of file; each returns a `Source`, columns by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...errors import DataError
from .source import Source

__all__ = ["open_source"]


def open_source(
    data: Any, time: str | None, requested: set[str], columns: Sequence[str] | None, delimiter: str | None
) -> Source:
    """Return the columns of a table in memory, or of a file, whose ending gives its kind.

    time    name in the file of the column that gives the times; None: not given.
    requested  names that are asked for: columns that take long to read are skipped unless they are among them.
    """
    from .arrays import is_frame, read_frame

    if is_frame(data):
        return read_frame(data, time)
    path = _path(data)
    ending = path.suffix.lower()
    if not path.is_file():
        from .flight_logs import find_tables, read_px4_tables

        tables = find_tables(path)
        if tables:
            return read_px4_tables(path, tables, time)
        if path.is_dir():
            raise DataError(f"{path}: is a folder without tables of a PX4 log (such as log_vehicle_attitude_0.csv)")
    if ending == ".mat":
        from .arrays import read_matlab

        return read_matlab(path, time, columns)
    if ending in (".h5", ".hdf5", ".hdf", ".he5"):
        from .arrays import read_hdf5

        return read_hdf5(path, time, columns)
    if ending in (".parquet", ".pq"):
        from .arrays import read_parquet

        return read_parquet(path, time)
    if ending == ".ulg":
        from .flight_logs import read_ulog

        return read_ulog(path, time, requested)
    if ending == ".bin":
        from .flight_logs import read_ardupilot

        return read_ardupilot(path, time, requested)
    from .text import read_text

    return read_text(path, columns, delimiter)


def _path(data: Any) -> Path:
    try:
        return Path(data)
    except TypeError:
        raise DataError(
            f"read: give the path of a file, or a table of pandas, polars or xarray, not {data!r:.60}"
        ) from None
