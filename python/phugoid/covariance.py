"""Covariance of the estimates from the inverse of the reduced Hessian."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from . import _core

__all__ = ["covariance"]

_Array = NDArray[np.float64]


def covariance(
    problem: _core.Collocation, xi: _Array, multipliers: _Array, scale: _Array, rows: _Array, wanted: NDArray[np.intp], held: NDArray[np.intp]
) -> _Array | None:
    """Covariance of the variables ``wanted``, shape (len(wanted),)*2; None where the problem is singular.

    With H the Hessian of the Lagrangian and A the Jacobian of the constraints, the inverse of the KKT matrix
    [[H, A^T], [A, 0]] has Z (Z^T H Z)^-1 Z^T for its first block, Z a basis of the null space of A: the inverse of
    the observed information of the parameters, states following. Variables ``held`` (fixed, at a bound) do not
    vary. ``scale`` and ``rows`` are the scaling of variables and constraints.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import MatrixRankWarning, splu

    hessian = problem.hessian(xi, 1.0, multipliers)
    jacobian = problem.jacobian(xi)
    if hessian is None or jacobian is None:
        return None
    n, m = problem.n, problem.m
    free = np.ones(n, dtype=bool)
    free[held] = False
    size = int(free.sum())
    place = np.full(n + m, -1)
    place[:n][free] = np.arange(size)
    place[n:] = size + np.arange(m)

    unit = 1 / scale  # variables in units in which they are of order 1
    hr, hc = (i.astype(np.intp) for i in problem.hessian_structure())
    jr, jc = (i.astype(np.intp) for i in problem.jacobian_structure())
    h = hessian * unit[hr] * unit[hc]
    # Constraints and likelihood in comparable units, or the factorisation pivots badly.
    weight = max(float(np.median(np.abs(h[h != 0]))) if np.any(h) else 1.0, 1e-300)
    h = h / weight
    j = jacobian * rows[jr] * unit[jc]
    off = hr != hc
    row = np.concatenate([hr, hc[off], jr + n, jc])
    column = np.concatenate([hc, hr[off], jc, jr + n])
    value = np.concatenate([h, h[off], j, j])
    keep = (place[row] >= 0) & (place[column] >= 0)
    kkt = coo_matrix((value[keep], (place[row[keep]], place[column[keep]])), shape=(size + m, size + m)).tocsc()
    right = np.zeros((size + m, len(wanted)))
    right[place[wanted], np.arange(len(wanted))] = 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("error", MatrixRankWarning)
        try:
            factor = splu(kkt)
        except (RuntimeError, MatrixRankWarning):
            return None
    solved = factor.solve(right)
    solved += factor.solve(right - kkt @ solved)  # one step of refinement
    if not np.isfinite(solved).all():
        return None
    block = solved[place[wanted]] / weight
    block = 0.5 * (block + block.T)
    return block * np.outer(unit[wanted], unit[wanted])
