"""Where a mode that is to be added to a linear system would fit best."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..solvers.limits import check_time
from .hankel import triangle
from .modal_blocks import Blocks
from .modal_regression import Regression, rows
from .sampled import Sampled

__all__ = ["best_places"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]

# Natural frequencies tried, from this part of the lowest of the others to this multiple of the highest (but no higher
# than this part of the Nyquist frequency).
_BELOW, _ABOVE, _NYQUIST = 0.6, 1.3, 0.8
# Damping ratios, each with the ratio of frequencies that lie next to each other: a resonance must not fall between.
_DAMPING = ((0.01, 1.02), (0.03, 1.06), (0.1, 1.2), (0.6, 1.5))
# Places that differ by less than this part lead to the same end: the better one stands for both.
_APART = 0.15
# Places whose responses are held at once; directions below this part of the greatest are none.
_AT_ONCE, _RANK = 8, 1e-10


def best_places(
    records: Sampled, blocks: Blocks, found: Regression, direct: tuple[bool, ...], offset: bool
) -> list[Blocks]:
    """Pairs, one a `Blocks`, that differ, in the order of how much they would lower the weighted sum of squares.

    What the modes that are there can do with another B, in each experiment and output by itself, is projected out of
    the outputs and of the response of each new mode; first states of the new mode are left out. Of several outputs C
    of the new mode is the direction in which these answer most.
    """
    places = _grid(records, blocks)
    m, p = len(records.inputs), len(records.outputs)
    # Normal equations of each place and output: two unknowns for each input.
    squares, sides = np.zeros((places.size, p, 2 * m, 2 * m)), np.zeros((places.size, p, 2 * m))
    weights = np.where(found.rms > 0.0, found.rms, 1.0) ** 2
    values, C, _ = blocks.modal()
    for driven in records.driven:
        answers = driven.answers(values)
        bases = []
        for j, name in enumerate(records.outputs):
            z = driven.run.output(name)
            q = _basis(np.vstack(list(rows(C[j], answers, direct[j], z, offset)))[:, :-1])
            there = np.isfinite(z)
            r = z[there] - q @ (q.T @ z[there])
            # Missing samples have no part in any product.
            whole = np.zeros((z.size, q.shape[1] + 1))
            whole[there] = np.column_stack([q, r])
            bases.append((there, whole))
        for a in range(0, places.size, _AT_ONCE):
            check_time()
            some = slice(a, min(a + _AT_ONCE, places.size))
            parts = np.empty((some.stop - a, m, 2, driven.run.n))
            for k, xi in enumerate(driven.forced(places[some])):
                parts[:, k, 0], parts[:, k, 1] = xi.real, -xi.imag
            every = parts.reshape(-1, driven.run.n)
            for j, (there, whole) in enumerate(bases):
                found_in = (every @ whole).reshape(-1, 2 * m, whole.shape[1])
                inside, new = found_in[:, :, :-1], parts.reshape(-1, 2 * m, driven.run.n)
                if not there.all():
                    new = new[:, :, there]
                squares[some, j] += (new @ new.swapaxes(1, 2) - inside @ inside.swapaxes(1, 2)) / weights[j]
                sides[some, j] += found_in[:, :, -1] / weights[j]
    gains = np.zeros(places.size)
    residues = np.zeros((places.size, p, m), dtype=np.complex128)
    for i in range(places.size):
        for j in range(p):
            b = np.linalg.lstsq(squares[i, j], sides[i, j], rcond=_RANK)[0]
            gains[i] += b @ sides[i, j]
            residues[i, j] = b[0::2] + 1j * b[1::2]
    chosen: list[int] = []
    for i in np.argsort(-gains):
        if all(abs(places[i] - places[k]) > _APART * abs(places[k]) for k in chosen):
            chosen.append(int(i))
    return [_block(places[i], residues[i], blocks.units) for i in chosen]


def _basis(columns: _Array) -> _Array:
    """Orthonormal columns of the same span."""
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0.0, size, 1.0)
    _, s, Vt = np.linalg.svd(triangle([scaled.copy()]))
    kept = s > _RANK * s[0]
    # Rounding has grown by 1 / s: once more, of columns that are about orthonormal.
    q = scaled @ (Vt[kept].T / s[kept])
    return np.asarray(np.linalg.solve(triangle([q.copy()]).T, q.T).T)


def _grid(records: Sampled, blocks: Blocks) -> _Complex:
    """Eigenvalues to try, 1/s."""
    nyquist = np.pi * records.rate
    size = np.abs(blocks.modal()[0])
    size = size[(size > 0.0) & (size < nyquist)]
    slowest = 2.0 * np.pi * records.rate / max(records.lengths)
    low = max(_BELOW * size.min(), slowest) if size.size else slowest
    high = min(_ABOVE * size.max(), _NYQUIST * nyquist) if size.size else _NYQUIST * nyquist
    low = min(low, 0.5 * high)
    found = []
    for z, ratio in _DAMPING:
        frequencies = np.geomspace(low, high, max(2, round(np.log(high / low) / np.log(ratio))))
        found += [w * (-z + 1j * np.sqrt(1.0 - z * z)) for w in frequencies]
    return np.array(found)


def _block(value: complex, residue: _Complex, units: _Array) -> Blocks:
    """A pair with the C (p, 1) of the residue (p, m) nearest to one of rank one."""
    left, _, _ = np.linalg.svd(residue / units[:, None])
    return Blocks.of(np.array([value]), np.asarray(left[:, :1] * units[:, None], dtype=np.complex128), units)
