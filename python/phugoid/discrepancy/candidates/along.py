"""Signals along a path: expressions, late and lagged variables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ... import _core
from ..._core import Expr
from ...errors import DataError
from .scales import Points

__all__ = ["evaluated", "lagged", "late", "late_smooth", "of"]

_Array = NDArray[np.float64]


def of(group: Mapping[str, _Array], name: str, points: Points, what: str) -> _Array:
    """A time history by name; DataError where the points have none."""
    try:
        return group[name]
    except KeyError:
        raise DataError(f"experiment '{points.experiment}': the points have no {what} '{name}'") from None


def evaluated(e: Expr, points: Points) -> _Array:
    """(n,) values of an expression in states, inputs, quantities and time."""
    core = _core.Model("")
    names = [name for name in e.symbols if name != "time"]
    for name in names:
        core.input(name, "")
    core.state("no_state__", "")  # a model has one
    core.equation("no_state__", 0.0, None)
    core.output("value", e, "", None)
    columns = [points.t, *(of(points.values, name, points, "state, input or quantity") for name in names)]
    empty = np.zeros(0)
    return np.asarray(_core.Evaluator(core).outputs(empty, np.vstack([*columns, np.zeros(points.n)]))[0])


def lagged(t: _Array, u: _Array, tau: float) -> _Array:
    """(n,) solution z of tau z' + z = u, z = u at first; exact for u linear between the (n,) times, which increase.

    Within an interval z - u + tau u' decays as exp(-t/tau); the recursion is solved as a bidiagonal system.
    """
    from scipy.linalg import solve_banded

    x = np.diff(t) / tau
    decay, share = np.exp(-x), -np.expm1(-x) / x
    band = np.ones((2, t.size))
    band[1, :-1] = -decay
    right = np.empty(t.size)
    right[0] = u[0]
    right[1:] = u[1:] - u[:-1] * decay - np.diff(u) * share
    return np.asarray(solve_banded((1, 0), band, right, overwrite_b=True, check_finite=False))


def late(t: _Array, u: _Array, tau: float) -> _Array:
    """(n,) u(t - tau) for u linear between its times and constant beyond them."""
    return np.interp(t - tau, t, u)


def late_smooth(t: _Array, y: _Array, rate: _Array, tau: float) -> _Array:
    """(n,) y(t - tau) by cubic Hermite interpolation; NaN where that lies outside the record."""
    from scipy.interpolate import CubicHermiteSpline

    return np.asarray(CubicHermiteSpline(t, y, rate, extrapolate=False)(t - tau))
