"""Parquet files, read by pyarrow."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from .source import Column, Source, existing, load, reading, split_unit, stem

__all__ = ["read_parquet"]

_KIND = "a Parquet file"


def read_parquet(path: Path, time: str | None) -> Source:
    """The columns of a Parquet file; a unit is told by the name, or by ``unit`` or ``units`` in the field's metadata.

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
        told = field.metadata or {}
        unit = next((told[key].decode("utf-8", "replace") for key in (b"units", b"unit") if key in told), unit)
        if name == "__index_level_0__" and (time or "t") not in names:
            name = time or "t"
        columns.append(Column(name, _later(parquet, path, field.name), unit, field.name))
    return Source(str(path), stem(path), columns)


def _later(parquet: Any, path: Path, column: str) -> Callable[[str], Any]:
    """Reads a column when it is asked for: the format lies by columns."""

    def values(name: str) -> Any:
        with reading(f"{path}, column '{name}'", _KIND):
            return parquet.ParquetFile(path).read(columns=[column]).column(0).to_numpy()

    return values
