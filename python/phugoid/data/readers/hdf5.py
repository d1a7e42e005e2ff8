"""HDF5 files: datasets in groups; and MATLAB's version 7.3, which is one inside."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .nested import Leaf, from_leaves
from .source import Source, existing, load, reading, stem

__all__ = ["read_hdf5"]


def read_hdf5(path: Path, time: str | None, columns: Sequence[str] | None, matlab: bool = False) -> Source:
    """The datasets of an HDF5 file, called ``group.name``; of a compound one, the fields.

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
                Leaf(path_in, shape[::-1] if matlab else shape, _later(h5py, path, kind, key, field, matlab), unit, why)
            )

    with reading(path, kind), h5py.File(path, "r") as file:
        file.visititems(visit)
    return from_leaves(str(path), stem(path), leaves, time, columns)


def _later(h5py: Any, path: Path, kind: str, key: str, field: str | None, matlab: bool) -> Any:
    """Reads a dataset when it is asked for: a file may hold far more than is used."""

    def read() -> Any:
        with reading(f"{path}, dataset '{key}'", kind), h5py.File(path, "r") as file:
            values = file[key][()] if field is None else file[key][field]
        return np.squeeze(values.T if matlab else values)

    return read


def _text(value: Any) -> str:
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
