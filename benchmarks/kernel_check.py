"""Whether two peers of kernels.py computed the same: defects, Jacobian and Hessian, entry by entry.

Left out of the Hessian are the rows and columns of the noise, which is sigma for one and 1/sigma for another.
Entries that a peer returns for the same place are added up first.
"""

import hfb320_case as hfb
import numpy as np
from scipy.sparse import coo_array

NOISE = range(len(hfb.PARAMETERS) - len(hfb.SIGMAS), len(hfb.PARAMETERS))


def matrices(callbacks, places, mesh):
    """Defects (m,), Jacobian (m, n) and lower triangle of the Hessian (n, n) without the noise."""
    n, m = mesh.xi.size, mesh.multipliers.size
    defects, jacobian, hessian = callbacks
    defects = np.concatenate([part.ravel() for part in defects()])
    values = np.concatenate([part.ravel() for part in jacobian()[1:]])
    jacobian = coo_array((values, places[0]), shape=(m, n)).tocsr()
    values = np.concatenate([part.ravel() for part in hessian()])
    row, column = places[1]
    row, column = np.maximum(row, column), np.minimum(row, column)
    kept = (row >= NOISE.stop) | (row < NOISE.start)
    kept &= (column >= NOISE.stop) | (column < NOISE.start)
    hessian = coo_array((values[kept], (row[kept], column[kept])), shape=(n, n)).tocsr()
    return defects, jacobian, hessian


def difference(mine, other):
    """Largest difference of two results of `matrices`: (defects, Jacobian, Hessian).

    Each entry is compared with the largest of its kind: the same state's defect, the same pair of variables.
    """
    return tuple(max(_differences(a, b), default=0.0) for a, b in zip(mine, other, strict=True))


def _differences(a, b):
    if a.ndim == 1:
        a, b = coo_array(a[:, None]), coo_array(b[:, None])
    square = a.shape[0] == a.shape[1]
    largest, apart = _by_kind(b, square), _by_kind(a - b, square)
    return (apart[kind] / largest.get(kind, 0.0) if apart[kind] else 0.0 for kind in apart)


def _by_kind(matrix, square):
    """Kind of row and of column -> largest magnitude; states are of kinds -4 to -1, parameters of 0 to 21."""
    entries = matrix.tocoo()
    row, column = entries.coords
    states = len(hfb.STATES)
    kinds = [_kind(row) if square else row % states - states, _kind(column)]
    key = (kinds[0] + states) * (NOISE.stop + states) + kinds[1] + states
    size = np.zeros((NOISE.stop + states) ** 2)
    np.maximum.at(size, key, np.abs(entries.data))
    return {int(k): float(size[k]) for k in np.unique(key)}


def _kind(index):
    states = len(hfb.STATES)
    return np.where(index < NOISE.stop, index, (index - NOISE.stop) % states - states)
