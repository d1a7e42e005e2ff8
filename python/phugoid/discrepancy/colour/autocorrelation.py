"""The autocorrelation of residuals that may have gaps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .series import Series

__all__ = ["autocorrelation_of"]

_Array = NDArray[np.float64]

_LAGS = 100


def autocorrelation_of(series: Sequence[Series]) -> tuple[_Array, _Array, _Array]:
    """Lags in s, autocorrelation about zero, and its variance if residuals are white, of all experiments together.

    The variance is that of residuals of which the size may change (Diebold 1986): a noisy stretch is no colour.
    """
    grids = [s.on_grid(s.r) for s in series]
    n = sum(s.r.size for s in series)
    power = sum(float(s.r @ s.r) for s in series) / n
    lags = range(min(_LAGS, n // 4) + 1)
    rho, scatter = [], []
    for k in lags:
        products = np.concatenate([g[k:] * g[: g.size - k] for g in grids if g.size > k])
        products = products[np.isfinite(products)]
        rho.append(float(products.mean()) / power if products.size else 0.0)
        squares = float(np.mean(products**2)) if products.size else 0.0
        scatter.append(squares / power**2 / products.size if squares > 0.0 else np.inf)
    return np.array(lags) * series[0].dt, np.array(rho), np.array(scatter)
