"""Triangular factors of data matrices too tall to store, and the subspace that past and future outputs share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Observability", "observability", "triangle"]

_Array: TypeAlias = NDArray[np.float64]

# Rows reduced at once, few enough for the cache; and columns of a panel.
_ROWS, _PANEL = 1000, 16


def triangle(blocks: Iterable[_Array]) -> _Array:
    """Return R (k, k) of the QR factorisation of the stacked blocks (rows, k); the blocks are overwritten."""
    from scipy.linalg.lapack import dtpqrt

    R: _Array | None = None
    for block in blocks:
        k = block.shape[1]
        if R is None:
            R = np.zeros((k, k), order="F")
        # R is triangular and stays so: LAPACK's triangular-pentagonal QR makes use of it.
        R, *_ = dtpqrt(0, min(_PANEL, k), R, np.asfortranarray(block), overwrite_a=True, overwrite_b=True)
    assert R is not None
    return np.asarray(R)


def rows_at_once(columns: int) -> int:
    """Return the rows of a block with so many columns: at least as many as columns, or the work is in R."""
    return max(columns, _ROWS)


@dataclass(frozen=True)
class Observability:
    """The extended observability matrix, (i p, n) for each order n, in a basis of falling importance.

    singular_values  canonical correlations of past and future ("cva"), or singular values over the greatest ("moesp").
    """

    singular_values: _Array
    directions: _Array

    def system(self, order: int, outputs: int) -> tuple[_Array, _Array]:
        """Return the discrete A (n, n) and C (p, n), from the shift of the matrix."""
        from scipy.linalg import lstsq

        gamma = self.directions[:, :order]
        A = lstsq(gamma[:-outputs], gamma[outputs:])[0]
        return np.asarray(A), gamma[:outputs]


def observability(runs: Sequence[tuple[_Array, _Array]], block_rows: int, weighting: str) -> Observability:
    """Estimate the extended observability matrix from what past inputs and outputs predict of future outputs.

    ``runs``: of each experiment inputs (m, N) and outputs (p, N), of about unit size. Rows of the block Hankel matrices
    are, with i block rows: future inputs, past inputs and outputs, future outputs. With the L of their LQ factorisation
    the projection of MOESP is L32 (Verhaegen, Automatica 30(1), 1994: past outputs as instruments), and canonical
    variates weigh it with the inverse root of L32 L32' + L33 L33' (Van Overschee and De Moor, Subspace Identification
    for Linear Systems, 1996, sec. 4.3). The mean of each row is taken out, in each experiment: a constant of its own in
    any channel makes no difference.
    """
    from scipy.linalg import cholesky, solve_triangular, svd

    i, m, p = block_rows, runs[0][0].shape[0], runs[0][1].shape[0]
    L = triangle(block for u, y in runs for block in _blocks(u, y, i)).T
    past, future = m * i, m * i + (m + p) * i
    shared, rest = L[future:, past:future], L[future:, future:]
    if weighting == "moesp":
        U, s, _ = svd(shared, full_matrices=False)
        return Observability(s / s[0], U * np.sqrt(s / s[0]))
    # A part in 1e12 more than there is: noise-free outputs have no inverse root.
    power = shared @ shared.T + rest @ rest.T
    power[np.diag_indices_from(power)] += 1e-12 * np.trace(power) / power.shape[0]
    root = cholesky(power, lower=True)
    U, s, _ = svd(solve_triangular(root, shared, lower=True), full_matrices=False)
    return Observability(s, root @ (U * np.sqrt(s)))


def _blocks(u: _Array, y: _Array, i: int) -> Iterator[_Array]:
    """Yield the columns of the Hankel matrices of one experiment, transposed, block by block."""
    m, p, count = u.shape[0], y.shape[0], u.shape[1] - 2 * i + 1
    # Column k of the block is channel `row` delayed by `lag`.
    channels = [(u[r], lag) for lag in range(i, 2 * i) for r in range(m)]
    channels += [(u[r], lag) for lag in range(i) for r in range(m)]
    channels += [(y[r], lag) for lag in range(2 * i) for r in range(p)]
    means = [float(w[lag : lag + count].mean()) for w, lag in channels]
    step = rows_at_once(len(channels))
    for first in range(0, count, step):
        last = min(first + step, count)
        block = np.empty((last - first, len(channels)), order="F")
        for k, ((w, lag), mean) in enumerate(zip(channels, means, strict=True)):
            block[:, k] = w[first + lag : last + lag] - mean
        yield block
