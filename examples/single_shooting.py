"""The usual way, for comparison: simulate from the first sample, and let least_squares turn the knobs.

Unknowns are the parameters and the initial state. The weights are the true standard deviations of the noise, which
collocation is not told; simulations that overflow count as large residuals.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

DIVERGED = 1e6
"""Weighted residual in place of one that is not finite or greater."""

Rhs = Callable[[Sequence[np.ndarray], Sequence[np.ndarray], Sequence[np.ndarray]], Sequence[np.ndarray]]
"""x' of states, inputs and parameters; each an array over lanes."""

Simulation = Callable[[np.ndarray], np.ndarray]
"""Unknowns (n, lanes) to outputs (n_y, N, lanes): all columns of a Jacobian in one call."""


@dataclass(frozen=True)
class Shot:
    """Where single shooting ended.

    ``rms`` is the root mean square of residuals over noise at the best point, ``status`` "stopped" where
    least_squares sees no way down, "out of time", or "diverged" where not one simulation came to its end.
    """

    unknowns: np.ndarray
    rms: float
    status: str
    evaluations: int
    time: float


def rk4(rhs: Rhs, p: np.ndarray, x0: np.ndarray, t: np.ndarray, u: np.ndarray, substeps: int = 1) -> np.ndarray:
    """States (n_x, N, lanes) with fixed steps, from sample to sample; inputs ``u`` (n_u, N) linear in between."""
    fine = np.interp(np.arange(2 * substeps * (t.size - 1) + 1) / (2 * substeps), np.arange(t.size), t)
    between = np.array([np.interp(fine, t, each) for each in u]).reshape(len(u), fine.size).T.tolist()
    x = np.array(x0, dtype=float)
    path = np.empty((x.shape[0], t.size, x.shape[1]))
    path[:, 0] = x

    def slope(state: np.ndarray, at: int) -> np.ndarray:
        return np.array(rhs(state, between[at], p))

    with np.errstate(all="ignore"):
        for i in range(0, fine.size - 1, 2):
            h = fine[i + 2] - fine[i]
            k1 = slope(x, i)
            k2 = slope(x + h / 2 * k1, i + 1)
            k3 = slope(x + h / 2 * k2, i + 1)
            x = x + h / 6 * (k1 + 2 * (k2 + k3) + slope(x + h * k3, i + 2))
            if (i + 2) % (2 * substeps) == 0:
                path[:, (i + 2) // (2 * substeps)] = x
    return path


def lsoda(rhs: Rhs, p: np.ndarray, x0: np.ndarray, t: np.ndarray, rtol: float = 1e-9) -> np.ndarray:
    """States (n_x, N, lanes) with an adaptive integrator that turns implicit where the system is stiff; no inputs."""
    path = np.full((x0.shape[0], t.size, x0.shape[1]), np.nan)
    for lane in range(x0.shape[1]):
        parameters = p[:, lane].tolist()
        with np.errstate(all="ignore"):
            found = solve_ivp(
                lambda _, x, values=parameters: rhs(x.tolist(), (), values),
                t[[0, -1]], x0[:, lane], "LSODA", t_eval=t, rtol=rtol, atol=0.01 * rtol,
            )  # fmt: skip
        path[:, : found.y.shape[1], lane] = found.y
    return path


def fit(
    simulate: Simulation,
    z: np.ndarray,
    sigma: np.ndarray,
    start: np.ndarray,
    scale: np.ndarray,
    seconds: float = 8.0,
) -> Shot:
    """Least squares from ``start`` (n,), with forward differences in steps of the unknowns' ``scale``.

    ``z`` measurements (n_y, N), ``sigma`` their noise (n_y,), ``seconds`` the time allowed.
    """
    begin = time.perf_counter()
    steps = 1e-7 * scale
    best, smallest, evaluations, slopes = start, np.inf, 0, np.empty(0)

    def residuals(unknowns: np.ndarray) -> np.ndarray:
        """Weighted residuals; their derivatives come from the same simulation of n + 1 lanes."""
        nonlocal best, smallest, evaluations, slopes
        if time.perf_counter() - begin > seconds:
            raise TimeoutError
        lanes = unknowns[:, None] + np.column_stack([np.zeros(steps.size), np.diag(steps)])
        misfit = (z[:, :, None] - simulate(lanes)) / sigma[:, None, None]
        found = np.clip(np.nan_to_num(misfit, nan=DIVERGED), -DIVERGED, DIVERGED).reshape(z.size, -1)
        evaluations += lanes.shape[1]
        size = float(np.sqrt(np.mean(found[:, 0] ** 2)))
        if size < smallest:  # least_squares asks for the Jacobian only where the residuals are smaller
            best, smallest, slopes = unknowns.copy(), size, (found[:, 1:] - found[:, :1]) / steps
        return found[:, 0]

    try:
        with np.errstate(all="ignore"):
            found = least_squares(residuals, start, lambda _: slopes, x_scale="jac", ftol=1e-6, max_nfev=300)
        status = "stopped" if found.status > 0 else "out of evaluations"
    except TimeoutError:
        status = "out of time"
    if smallest >= DIVERGED:
        status = "diverged"
    return Shot(best, smallest, status, evaluations, time.perf_counter() - begin)


def rms(simulate: Simulation, z: np.ndarray, sigma: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """Root mean square of residuals over noise for each lane of ``unknowns`` (n, lanes); inf where not finite."""
    with np.errstate(all="ignore"):
        square = ((z[:, :, None] - simulate(unknowns)) / sigma[:, None, None]) ** 2
        return np.sqrt(np.nan_to_num(square.mean(axis=(0, 1)), nan=np.inf))
