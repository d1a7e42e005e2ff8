"""Scaling of the nonlinear program from the data: a change by one then means about the same everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import _core

__all__ = ["Scaling", "scale_from_curvature", "scale_from_data"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scaling:
    """Factors that variables, constraints and the objective are multiplied by."""

    variables: _Array
    constraints: _Array
    objective: float


def scale_from_data(problem: _core.Problem, xi: _Array) -> Scaling:
    """Return the scaling for the steps towards the optimum, at the starting point ``xi``.

    States by their spread along the starting path (the measurements, where they are measured); defects by the
    spread of their state, so that a scaled defect is a fraction of what the state does; a parameter by the root
    mean square of its column of the scaled defects, and by its curvature.
    """
    states = xi[problem.n_theta :].reshape(-1, problem.n_states)
    size = np.abs(states).max(axis=0)
    spread = states.std(axis=0)
    spread = np.where(spread > 1e-12 * size, spread, size)  # a constant has rounding errors only
    units = 1 / np.where(spread > 0, spread, 1.0)
    outputs = [len(y) for e in range(len(problem.first_point) - 1) for y in problem.outputs(xi, e)]
    return _scaling(problem, xi, units, 1 / max(problem.m, 1), 1.0 / max(sum(outputs), 1))


def scale_from_curvature(problem: _core.Problem, xi: _Array, first: Scaling) -> Scaling:
    """Return the scaling for the last steps, near the optimum ``xi``: everything in units of its own uncertainty.

    A state by the root of the mean curvature of the log-likelihood with respect to it, a parameter by the norm of
    its column then. Gradients are then of order one whatever the noise: with noise eight orders below the signal,
    any scaling by the signal leaves them beyond the reach of rounding. States that no output depends on keep the
    units that they had.
    """
    n, n_theta, n_states = problem.n, problem.n_theta, problem.n_states
    units = first.variables[n_theta : n_theta + n_states]
    curvature = problem.gauss_newton(xi, 1.0)
    if curvature is not None:
        row, column = problem.hessian_structure()
        diagonal = row == column
        total = np.bincount(row[diagonal], curvature[diagonal], minlength=n)
        mean = total[n_theta:].reshape(-1, n_states).mean(axis=0)
        units = np.where(mean > 0, np.sqrt(np.maximum(mean, 0)), units)
    return _scaling(problem, xi, units, 1.0, 1.0)


def _scaling(problem: _core.Problem, xi: _Array, units: _Array, column_weight: float, objective: float) -> Scaling:
    """Return the scaling made of factors for the states; ``column_weight`` multiplies the squared column norms."""
    n_theta = problem.n_theta
    ends = problem.boundary_states
    constraints = np.concatenate(
        [np.tile(units, (problem.m - len(ends)) // units.size), units[np.array(ends, dtype=np.intp)]]
    )
    variables = np.concatenate([np.ones(n_theta), np.tile(units, (problem.n - n_theta) // units.size)])
    weight = np.zeros(n_theta)
    values = problem.jacobian(xi)
    if values is not None:
        row, column = problem.jacobian_structure()
        of_theta = column < n_theta
        scaled = values[of_theta] * constraints[row[of_theta]]
        weight += np.bincount(column[of_theta], scaled**2, minlength=n_theta) * column_weight
    curvature = problem.gauss_newton(xi, objective)
    if curvature is not None:
        row, column = problem.hessian_structure()
        diagonal = (row == column) & (row < n_theta)
        weight += np.abs(np.bincount(row[diagonal], curvature[diagonal], minlength=n_theta))
    # A column that is zero at the start has no information; its parameter is not scaled.
    variables[:n_theta] = np.where(weight > 0, np.sqrt(weight), 1.0)
    return Scaling(variables, constraints, objective)
