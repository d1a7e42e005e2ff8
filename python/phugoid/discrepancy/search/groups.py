"""Columns in groups, one for each effect, and least squares within each."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

__all__ = ["Groups"]

_Array = NDArray[np.float64]
_Grams = list[_Array]

# A column, of length 1 as a whole, of which less than this is left in square is rounding; directions with less of the
# columns' squares are.
_ROUNDING, _SINGULAR = 1e-20, 1e-10


class Groups:
    """Groups of columns, ``sizes`` of them each, one after the other: ``slices``.

    Products of each group's columns with each other, *grams*, are held by size, (groups of that size, size, size): what
    follows is done for all groups of a size at once.
    """

    def __init__(self, sizes: Sequence[int]) -> None:
        self.sizes = list(sizes)
        ends = np.cumsum([0, *self.sizes])
        squares = np.cumsum([0, *(s * s for s in self.sizes)])
        self.slices = [slice(a, b) for a, b in pairwise(ends.tolist())]
        self._members: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []  # groups, and their columns
        self._squares: list[NDArray[np.intp]] = []
        for size in sorted(set(self.sizes)):
            which = np.flatnonzero(np.array(self.sizes) == size)
            self._members.append((which, ends[which, None] + np.arange(size)))
            self._squares.append((squares[which, None] + np.arange(size * size)).reshape(-1, size, size))

    def grams(self, squares: _Array) -> _Grams:
        """From one after the other."""
        return [squares[at] for at in self._squares]

    def put(self, grams: _Grams, group: int, gram: _Array) -> None:
        """Another one of a group."""
        for (which, _), own in zip(self._members, grams, strict=True):
            at = np.flatnonzero(which == group)
            if at.size:
                own[at[0]] = gram

    def squares(self, grams: _Grams) -> _Array:
        """(k,) of the columns."""
        out = np.empty(sum(self.sizes))
        for (_, columns), gram in zip(self._members, grams, strict=True):
            out[columns] = np.diagonal(gram, axis1=1, axis2=2)
        return out

    def without(self, grams: _Grams, along: _Array) -> _Grams:
        """Those of what is left of the columns beside orthonormal vectors, along which they have parts (k, m)."""
        parts = [along[columns] for _, columns in self._members]
        return [gram - p @ p.transpose(0, 2, 1) for gram, p in zip(grams, parts, strict=True)]

    def solved(self, grams: _Grams, parts: _Array) -> tuple[_Array, _Array]:
        """Least squares with each group's columns alone, from their products with what is to be explained (k,).

        (groups,) sums of squares that they explain, and (k,) coefficients.
        """
        explained, coefficients = np.empty(len(self.sizes)), np.empty(parts.size)
        for (which, columns), gram in zip(self._members, grams, strict=True):
            root = _root(gram)
            c = root.transpose(0, 2, 1) @ parts[columns][..., None]
            explained[which] = np.sum(c**2, axis=(1, 2))
            coefficients[columns] = (root @ c)[..., 0]
        return explained, coefficients

    def cosines(self, grams: _Grams, along: _Array) -> _Array:
        """(groups,) cosines of the angles between groups and a space, along whose orthonormal basis the columns have
        parts (k, m): how far the smaller lies within the other."""
        out = np.empty(len(self.sizes))
        for (which, columns), gram in zip(self._members, grams, strict=True):
            inner = _root(gram).transpose(0, 2, 1) @ along[columns]
            out[which] = np.linalg.svd(inner, compute_uv=False).min(axis=1)
        return out


def _root(gram: _Array) -> _Array:
    """(..., n, n) such that columns times it are orthonormal, or nothing where they are rounding."""
    squares = np.diagonal(gram, axis1=1, axis2=2)
    unit = np.where(squares > _ROUNDING, 1.0 / np.sqrt(np.maximum(squares, _ROUNDING)), 0.0)
    values, vectors = np.linalg.eigh(gram * unit[:, :, None] * unit[:, None, :])
    inverse = np.where(values > _SINGULAR, 1.0 / np.sqrt(np.maximum(values, _SINGULAR)), 0.0)
    return np.asarray(unit[:, :, None] * vectors * inverse[:, None, :])
