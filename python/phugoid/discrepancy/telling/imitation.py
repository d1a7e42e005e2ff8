"""What a rival could imitate of a difference, in the metric of the noise."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..colour.joint import Filter
from ..colour.strands import strands_of
from ..colour.whitening import Rows

__all__ = ["Imitation", "rows_of"]

_Array = NDArray[np.float64]
_Mask = NDArray[np.bool_]

# Of the greatest: what is below is rounding.
_NOTHING = 1e-12


class Imitation:
    """``moved`` (k, n_y, N): how the rival's outputs move with what is free in it, by units; ``tied`` (k,) is how
    firmly each is held to its estimate, in units too. ``present`` (n_y, N) tells which samples there are."""

    def __init__(self, present: _Mask, channels: Filter, moved: _Array, tied: _Array) -> None:
        self._present, self._tied = present, tied
        self._filter = channels.on(rows_of(present))
        self._columns = self._filter(moved[:, present])
        # Of first states and parameters of any unit: as large as each other.
        gram = self._columns @ self._columns.T + np.diag(tied**2)
        size = np.sqrt(np.diag(gram))
        self._size = np.where(size > 0.0, size, 1.0)
        values, self._vectors = np.linalg.eigh(gram / np.outer(self._size, self._size))
        self._inverse = np.where(values > _NOTHING * values[-1], 1.0 / np.maximum(values, 1e-300), 0.0)

    def whitened(self, difference: _Array) -> _Array:
        """A difference (n_y, N) of outputs in units of the noise, (n_rows,)."""
        return self._filter(difference[self._present])

    def step(self, whitened: _Array, at: _Array) -> _Array:
        """(k,) units by which to move from ``at`` (k,), so that the least is left of the difference."""
        slope = (self._columns @ whitened - self._tied**2 * at) / self._size
        return np.asarray((self._vectors @ (self._inverse * (self._vectors.T @ slope))) / self._size)

    def gain(self, whitened: _Array, at: _Array) -> float:
        """Half the sum of squares of what is left of the difference then, to first order."""
        left = whitened - self.step(whitened, at) @ self._columns
        return 0.5 * float(left @ left)

    def cost(self, whitened: _Array, at: _Array) -> float:
        """Minus the log-likelihood, of the estimates too."""
        with np.errstate(over="ignore", invalid="ignore"):  # where the motion ran away
            return 0.5 * float(whitened @ whitened) + 0.5 * float(np.sum((self._tied * at) ** 2))


def rows_of(present: _Mask) -> Rows:
    """How rows of equally spaced samples hang together, those of one output after those of another."""
    table = np.full(present.shape, -1)
    table[present] = np.arange(int(present.sum()))
    ends = np.cumsum([0, *present.sum(axis=1)]).tolist()
    strands = [
        [s.from_row(a) for s in strands_of(np.flatnonzero(line).astype(float))]
        for (a, _), line in zip(pairwise(ends), present, strict=True)
    ]
    pattern = 2.0 ** np.arange(present.shape[0]) @ present
    together = []
    for number in np.unique(pattern[pattern > 0.0]).tolist():
        there = np.flatnonzero(present[:, np.argmax(pattern == number)])
        together.append((tuple(there.tolist()), np.ascontiguousarray(table[there][:, pattern == number].T)))
    whole = np.flatnonzero(present.all(axis=0))
    complete = [table[:, whole[s.rows][run]].T for s in strands_of(whole.astype(float)) for run in s.runs]
    return Rows(strands, together, complete)
