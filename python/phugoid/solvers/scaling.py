"""Scaling of the nonlinear program from the data: a change by one then means about the same everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import _core

__all__ = ["Scaling", "scale"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scaling:
    """Factors that variables, constraints and the objective are multiplied by."""

    variables: _Array
    constraints: _Array
    objective: float


def scale(problem: _core.Collocation, xi: _Array, n_states: int, samples: int) -> Scaling:
    """Scaling at the starting point ``xi``.

    States by their spread along the starting path (the measurements, where they are measured); defects by the
    spread of their state, so that a scaled defect is a fraction of what the state does; a parameter by the norm of
    its column: the change that moves the defects and outputs by their own scale.
    """
    n_theta = problem.n_theta
    states = xi[n_theta:].reshape(-1, n_states)
    spread = states.std(axis=0)
    spread = np.where(spread > 0, spread, np.maximum(np.abs(states).max(axis=0), 0))
    spread = np.where(spread > 0, spread, 1.0)

    variables = np.ones(problem.n)
    variables[n_theta:] = np.tile(1 / spread, len(states))
    rows = problem.m // n_states
    constraints = np.tile(1 / spread, rows)

    objective = 1.0 / max(samples, 1)
    variables[:n_theta] = _columns(problem, xi, constraints, objective)
    return Scaling(variables, constraints, objective)


def _columns(problem: _core.Collocation, xi: _Array, constraints: _Array, objective: float) -> _Array:
    """For each parameter, the root of its diagonal entry in (scaled Jacobian)^T (scaled Jacobian) + |Hessian|."""
    n = problem.n_theta
    weight = np.zeros(n)
    values = problem.jacobian(xi)
    if values is not None:
        row, column = problem.jacobian_structure()
        of_theta = column < n
        scaled = values[of_theta] * constraints[row[of_theta]]
        weight += np.bincount(column[of_theta], scaled**2, minlength=n)
    curvature = problem.hessian(xi, objective, np.zeros(problem.m))
    if curvature is not None:
        row, column = problem.hessian_structure()
        diagonal = (row == column) & (row < n)
        weight += np.abs(np.bincount(row[diagonal], curvature[diagonal], minlength=n))
    # A column that is zero at the start says nothing; leave its parameter alone.
    return np.where(weight > 0, np.sqrt(weight), 1.0)
