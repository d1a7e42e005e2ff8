"""Covariance of the estimates, and their distance from the optimum, from one factorisation."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import _core
from .solvers.scaling import Scaling

__all__ = ["Information", "information"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Information:
    """What the Newton system at a point tells about some of the variables.

    covariance  (k, k) of the variables asked for.
    step        (k,) the Newton step that is left: how far they are from the optimum.
    """

    covariance: _Array
    step: _Array


def information(
    problem: _core.Collocation,
    xi: _Array,
    multipliers: _Array,
    scaling: Scaling,
    wanted: NDArray[np.intp],
    held: NDArray[np.intp],
) -> Information | None:
    """Covariance and remaining Newton step of the variables ``wanted``; None where the system is singular.

    With H the Hessian of the Lagrangian and A the Jacobian of the constraints, the inverse of the KKT matrix
    [[H, A^T], [A, 0]] has Z (Z^T H Z)^-1 Z^T for its first block, Z a basis of the null space of A: the inverse of
    the observed information of the parameters, states following. Variables ``held`` (fixed, at a bound) do not
    vary.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import MatrixRankWarning, splu

    hessian = problem.hessian(xi, 1.0, multipliers)
    jacobian = problem.jacobian(xi)
    gradient = problem.gradient(xi)
    defects = problem.constraints(xi)
    if hessian is None or jacobian is None or gradient is None or defects is None:
        return None
    n, m = problem.n, problem.m
    free = np.ones(n, dtype=bool)
    free[held] = False
    size = int(free.sum())
    place = np.full(n + m, -1)
    place[:n][free] = np.arange(size)
    place[n:] = size + np.arange(m)

    unit = 1 / scaling.variables  # variables in units in which they are of order 1
    hr, hc = (i.astype(np.intp) for i in problem.hessian_structure())
    jr, jc = (i.astype(np.intp) for i in problem.jacobian_structure())
    h = hessian * unit[hr] * unit[hc]
    # Constraints and likelihood in comparable units, or the factorisation pivots badly.
    weight = max(float(np.median(np.abs(h[h != 0]))) if np.any(h) else 1.0, 1e-300)
    h = h / weight
    j = jacobian * scaling.constraints[jr] * unit[jc]
    off = hr != hc
    row = np.concatenate([hr, hc[off], jr + n, jc])
    column = np.concatenate([hc, hr[off], jc, jr + n])
    value = np.concatenate([h, h[off], j, j])
    keep = (place[row] >= 0) & (place[column] >= 0)
    kkt = coo_matrix((value[keep], (place[row[keep]], place[column[keep]])), shape=(size + m, size + m)).tocsc()

    right = np.zeros((size + m, len(wanted) + 1))
    right[place[wanted], np.arange(len(wanted))] = 1.0
    slope = gradient + np.bincount(jc, jacobian * multipliers[jr], minlength=n)
    right[:size, -1] = -(slope * unit / weight)[free]
    right[size:, -1] = -defects * scaling.constraints
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
    at = place[wanted]
    block = solved[at, :-1] / weight
    block = 0.5 * (block + block.T)
    return Information(block * np.outer(unit[wanted], unit[wanted]), solved[at, -1] * unit[wanted])
