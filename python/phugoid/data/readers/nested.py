"""Files of named arrays, flat or in groups (MATLAB, HDF5): which arrays are channels, and where their times are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import DataError
from .source import Column, Source

__all__ = ["Leaf", "from_leaves"]


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
    """Columns of the arrays, called ``group.name`` or, of a matrix, ``group.name[0]``, ``group.name[1]``...

    A group that holds everything is not named. The times of an array are called ``time`` (None: ``t``, else ``time``)
    and stand in its own group or in one above it. A matrix has a column for a channel, or a row where only the rows are
    as long as the times. ``columns`` names the columns of the one matrix that there is.
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
            found.append(Column(full + suffix, _picked(leaf, place), leaf.unit, times=clock))
    return Source(where, name, found, left_out)


def _clock(full: str, known: dict[str, Leaf], time: str | None) -> str | None:
    """The times nearest to an array, going up from its own group."""
    group = full.split(".")[:-1]
    for depth in range(len(group), -1, -1):
        for candidate in (time,) if time is not None else ("t", "time"):
            path = ".".join([*group[:depth], candidate])
            if path in known and len(known[path].shape) == 1:
                return path
    return None


def _places(shape: tuple[int, ...], axis: int) -> list[tuple[str, Any]]:
    """Name's ending and index of each channel in an array whose samples run along an axis."""
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
    return [Column(n, _picked(leaf, place), leaf.unit) for n, (_, place) in zip(columns, places, strict=True)]


def _picked(leaf: Leaf, place: Any) -> Callable[[str], Any]:
    return lambda name: leaf.read()[place]


def _size(leaf: Leaf) -> str:
    return " x ".join(map(str, leaf.shape))
