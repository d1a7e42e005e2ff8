"""Covariance of the estimates, and their distance from the optimum, from one factorisation."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

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

    hessian = problem.hessian(xi, 1.0, multipliers)
    jacobian = problem.jacobian(xi)
    gradient = problem.gradient(xi)
    defects = problem.constraints(xi)
    if hessian is None or jacobian is None or gradient is None or defects is None:
        return None
    n, m, n_theta = problem.n, problem.m, problem.n_theta
    # States and constraints first, and parameters, which border them, last.
    order = np.concatenate([np.arange(n_theta, n + m), np.arange(n_theta)])
    kept = order[~np.isin(order, held)]
    place = np.full(n + m, -1)
    place[kept] = np.arange(kept.size)
    band = int(np.sum(kept >= n_theta))

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
    shape = (kept.size, kept.size)
    kkt = coo_matrix((value[keep], (place[row[keep]], place[column[keep]])), shape=shape).tocsc()

    right = np.zeros((kept.size, len(wanted) + 1))
    right[place[wanted], np.arange(len(wanted))] = 1.0
    slope = gradient + np.bincount(jc, jacobian * multipliers[jr], minlength=n)
    residual = np.concatenate([slope * unit / weight, defects * scaling.constraints])
    right[:, -1] = -residual[kept]

    solve = _bordered(kkt, band)
    if solve is None:
        return None
    solved = solve(right)
    solved += solve(right - kkt @ solved)  # one step of refinement
    if not np.isfinite(solved).all():
        return None
    at = place[wanted]
    block = solved[at, :-1] / weight
    block = 0.5 * (block + block.T)
    return Information(block * np.outer(unit[wanted], unit[wanted]), solved[at, -1] * unit[wanted])


def _bordered(kkt: Any, band: int) -> Callable[[_Array], _Array] | None:
    """Solves with the first ``band`` rows and columns as a sparse matrix and the rest as a dense border.

    The border must stay out of the sparse factorisation: its full rows would serve as pivots and fill it.
    """
    from scipy.linalg import LinAlgWarning, lu_factor, lu_solve
    from scipy.sparse.linalg import MatrixRankWarning, splu

    with warnings.catch_warnings():
        warnings.simplefilter("error", MatrixRankWarning)
        warnings.simplefilter("error", LinAlgWarning)
        try:
            factor = splu(kkt[:band, :band], permc_spec="COLAMD")
            side = kkt[:band, band:].toarray()
            inner = factor.solve(side)
            border = lu_factor(kkt[band:, band:].toarray() - side.T @ inner)
        except (RuntimeError, ValueError, MatrixRankWarning, LinAlgWarning):
            return None

    def solve(right: _Array) -> _Array:
        first = factor.solve(right[:band])
        last = lu_solve(border, right[band:] - side.T @ first)
        return np.vstack([first - inner @ last, last])

    return solve
