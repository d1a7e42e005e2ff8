"""MATLAB files: variables and the fields of structures, as version 4 to 7.2 and, by h5py, 7.3 write them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import DataError
from .hdf5 import read_hdf5
from .mat5 import is_whole
from .nested import Leaf, from_leaves
from .source import Source, contents, reading, stem

__all__ = ["read_matlab"]


def read_matlab(path: Path, time: str | None, columns: Sequence[str] | None) -> Source:
    """The arrays of a ``.mat`` file; a field of a structure is called ``structure.field``.

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
