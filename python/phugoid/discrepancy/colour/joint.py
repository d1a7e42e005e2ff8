"""Coloured residuals made white together: a vector autoregressive model of all channels.

Turbulence moves a vehicle, and its motion appears in all channels one after the other: the pitch acceleration now is
the pitch rate of the next sample and the attitude of the one after. Channel by channel such a motion would count as
evidence several times over. r_t = A_1 r_{t-1} + ... + A_p r_{t-p} + e_t with the covariance of e_t in full knows how
one follows from the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .whitening import Rows, Whitening

__all__ = ["Filter", "JointWhitening"]

_Array = NDArray[np.float64]

# The greatest order, and samples that there are to be for each coefficient of a channel.
_MOST, _SAMPLES_EACH = 4, 8


@dataclass(frozen=True, eq=False)
class _Order:
    """The best predictor from p samples: coefficients (n_y p, n_y), and the root of the covariance of its errors."""

    coefficients: _Array
    root: _Array


class JointWhitening:
    """What makes rows of residuals and sensitivities white and independent of each other.

    orders  predictors from 0, 1, ..., p samples: the first samples of a run have none before them.
    rows    what it is applied to. Rows at times at which a channel is missing are only scaled.
    """

    def __init__(self, orders: tuple[_Order, ...], scale: _Array, rows: Rows) -> None:
        self.orders, self.scale, self.rows = orders, scale, rows

    @classmethod
    def fitted(cls, residuals: _Array, rows: Rows) -> list[JointWhitening]:
        """Models of order 1, 2, ... of residuals (n_rows,), as many as the samples allow."""
        n_y = len(rows.strands)
        runs = [residuals[run] for run in rows.complete]
        total = sum(run.shape[0] for run in runs)
        if n_y < 2 or total * n_y < 0.9 * rows.n:
            return []
        scale = np.sqrt(sum(np.sum(run**2, axis=0) for run in runs) / total)
        scale = np.maximum(scale, np.finfo(float).tiny)
        runs = [run / scale for run in runs]
        orders: list[_Order] = []
        for p in range(_MOST + 1):
            if total < _SAMPLES_EACH * n_y * max(p, 1):
                break
            now, past = _regression(runs, p)
            coefficients = np.linalg.lstsq(past, now, rcond=1e-12)[0] if p else np.empty((0, n_y))
            e = now - past @ coefficients
            covariance = e.T @ e / e.shape[0] + 1e-12 * np.eye(n_y)
            orders.append(_Order(np.asarray(coefficients), np.asarray(np.linalg.cholesky(covariance))))
        return [cls(tuple(orders[: p + 1]), scale, rows) for p in range(1, len(orders))]

    @property
    def parameters(self) -> int:
        """Number of coefficients and correlations."""
        n_y, p = len(self.scale), len(self.orders) - 1
        return n_y * n_y * p + n_y * (n_y - 1) // 2

    def on(self, rows: Rows) -> JointWhitening:
        """The same model on other rows."""
        return JointWhitening(self.orders, self.scale, rows)

    def __call__(self, rows: _Array) -> _Array:
        """Rows (..., n_rows) as independent prediction errors of unit size."""
        flat = rows.reshape(-1, rows.shape[-1])
        out = np.empty(flat.shape)
        for channel, line in enumerate(self.rows.strands):
            for strand in line:
                out[:, strand.rows] = flat[:, strand.rows] / self.scale[channel]
        whitened = out.copy()
        n_y, p = len(self.scale), len(self.orders) - 1
        inverses = [np.linalg.inv(order.root) for order in self.orders]
        for run in self.rows.complete:
            x = out[:, run.ravel()].reshape(-1, *run.shape)  # (k, times, n_y)
            e = np.empty_like(x)
            n = run.shape[0]
            for q in range(min(p, n)):  # the first samples, from the few before them
                past = x[:, q - 1 :: -1][:, :q].reshape(-1, q * n_y) if q else np.empty((x.shape[0], 0))
                e[:, q] = (x[:, q] - past @ self.orders[q].coefficients) @ inverses[q].T
            if n > p:
                a = self.orders[p].coefficients
                rest = x[:, p:].copy()
                for i in range(p):
                    rest -= x[:, p - 1 - i : n - 1 - i] @ a[i * n_y : (i + 1) * n_y]
                e[:, p:] = rest @ inverses[p].T
            whitened[:, run.ravel()] = e.reshape(x.shape[0], -1)
        return whitened.reshape(rows.shape)

    def log_densities(self, errors: _Array) -> _Array:
        """(n_rows,) log-likelihood of each row, given those before it, of errors (n_rows,) that were whitened; without
        the constant of the normal density."""
        out = -0.5 * errors**2
        for channel, line in enumerate(self.rows.strands):
            for strand in line:
                out[strand.rows] -= np.log(self.scale[channel])
        p, logs = len(self.orders) - 1, [np.log(np.diag(order.root)) for order in self.orders]
        for run in self.rows.complete:
            for t in range(run.shape[0]):
                out[run[t]] -= logs[min(t, p)]
        return out


Filter: TypeAlias = Whitening | JointWhitening


def _regression(runs: list[_Array], p: int) -> tuple[_Array, _Array]:
    """Samples, and the p before each, (times, n_y) and (times, n_y p), the latest first."""
    now = [run[p:] for run in runs if run.shape[0] > p]
    past = [
        np.hstack([np.empty((run.shape[0] - p, 0)), *(run[p - 1 - i : run.shape[0] - 1 - i] for i in range(p))])
        for run in runs
        if run.shape[0] > p
    ]
    return np.vstack(now), np.vstack(past)
