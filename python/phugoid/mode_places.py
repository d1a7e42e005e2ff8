"""Where a mode that is to be added to a linear system would fit best."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .hankel import triangle
from .modal_blocks import Blocks
from .modal_regression import Layout, Regression, rows
from .sampled import Sampled

__all__ = ["best_places"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]

# Natural frequencies tried, from this part of the lowest of the others to this multiple of the highest (but no higher
# than this part of the Nyquist frequency); and damping ratios.
_FREQUENCIES, _BELOW, _ABOVE, _NYQUIST = 25, 0.6, 1.3, 0.8
_DAMPING = (0.01, 0.1, 0.6)


def best_places(
    records: Sampled,
    blocks: Blocks,
    found: Regression,
    direct: tuple[bool, ...],
    offset: bool,
) -> list[Blocks]:
    """Pairs, one a `Blocks`, in the order of how much they would lower the weighted sum of squares.

    All are judged from one orthogonal factorisation of each output of each experiment: what the modes that are there
    cannot do anew with other B. Of several outputs C of the new mode is the direction in which these answer most.
    """
    places = _grid(records, blocks)
    values, C, _ = blocks.modal()
    layout = Layout(values.imag != 0.0, len(records.inputs), direct, offset, len(records.runs))
    m = len(records.inputs)
    width = 2 * m  # columns of a place: two for each input
    gains = np.zeros(places.size)
    residues = np.zeros((places.size, len(records.outputs), m), dtype=np.complex128)
    for j, name in enumerate(records.outputs):
        tall = []
        for e, driven in enumerate(records.driven):
            run = driven.run
            columns = np.empty((places.size, m, 2, run.n))
            for k, xi in enumerate(driven.forced(places)):
                columns[:, k, 0], columns[:, k, 1] = xi.real, -xi.imag
            motion, modes = driven.free(values), driven.forced(values)
            seen = driven.u if direct[j] else driven.u[:0]
            more = columns.reshape(-1, run.n)
            R = triangle(rows(C[j], layout.paired, motion, modes, seen, run.output(name), offset, more))
            wide = np.zeros((R.shape[0], layout.total + len(more) + 1))
            wide[:, [*layout.columns(e, j), *range(layout.total, wide.shape[1])]] = R / found.rms[j]
            tall.append(wide)
        whole = triangle(tall)[layout.total :, layout.total :]
        for i in range(places.size):
            own = whole[:, i * width : (i + 1) * width]
            b, _, _, _ = np.linalg.lstsq(own, whole[:, -1], rcond=1e-10)
            gains[i] += np.sum(whole[:, -1] ** 2) - np.sum((whole[:, -1] - own @ b) ** 2)
            residues[i, j] = b[0::2] + 1j * b[1::2]
    return [_block(places[i], residues[i], blocks.units) for i in np.argsort(-gains)]


def _grid(records: Sampled, blocks: Blocks) -> _Complex:
    """Eigenvalues to try, 1/s."""
    nyquist = np.pi * records.rate
    size = np.abs(blocks.modal()[0])
    size = size[(size > 0.0) & (size < nyquist)]
    slowest = 2.0 * np.pi * records.rate / max(records.lengths)
    low = max(_BELOW * size.min(), slowest) if size.size else slowest
    high = min(_ABOVE * size.max(), _NYQUIST * nyquist) if size.size else _NYQUIST * nyquist
    w = np.geomspace(min(low, 0.5 * high), high, _FREQUENCIES)
    return np.array([each * (-z + 1j * np.sqrt(1.0 - z * z)) for each in w for z in _DAMPING])


def _block(value: complex, residue: _Complex, units: _Array) -> Blocks:
    """A pair with the C (p, 1) of the residue (p, m) nearest to one of rank one."""
    left, _, _ = np.linalg.svd(residue / units[:, None])
    return Blocks.of(np.array([value]), np.asarray(left[:, :1] * units[:, None], dtype=np.complex128), units)
