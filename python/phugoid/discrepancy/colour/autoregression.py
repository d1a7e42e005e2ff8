"""Autoregressive (AR) models of residuals, order by order: Burg's recursion over runs of samples, Schwarz's order.

``r[t] = a_1 r[t-1] + ... + a_p r[t-p] + e[t]``. Reflection coefficients are below 1, so that the models are stationary
whatever the data, and each order follows from the one before (Burg 1967).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Autoregression", "burg"]

_Array = NDArray[np.float64]

# The greatest order.
_LONGEST = 12
# Samples for each coefficient, and samples whose lags are all there for each.
_SAMPLES_EACH, _PAIRS_EACH = 10, 5
# Of all samples, the part whose lags are all there: of a record in tatters little can be said.
_TATTERS = 4
# A reflection coefficient this near to 1 is as good as a unit root: the filter stays invertible.
_EDGE = 1.0 - 1e-6
# What is left of the variance where the next sample is known from those before it: rounding.
_EXACT = 1e-14


@dataclass(frozen=True, eq=False)
class Autoregression:
    """AR models of one series, of all orders up to the best.

    predictors  predictors[k] (k,) are a_1 ... a_k, the best prediction from k samples.
    powers      (p + 1,) variances of their errors, from that of the residuals on.
    """

    predictors: tuple[_Array, ...]
    powers: _Array

    @property
    def order(self) -> int:
        """p."""
        return len(self.predictors) - 1


def burg(runs: Sequence[_Array]) -> Autoregression:
    """The AR models of residuals: ``runs`` are (n,) each, equally spaced and without a gap.

    Runs (k, n) are k sequences that stand for the same samples: their squares are added, and samples count once.

    The order has the least BIC (Schwarz 1978), of those up to 12 and a tenth of the samples, as long as the lags are
    there for a quarter of the samples. What an order gains counts for the samples that have its lags: where there are
    gaps, few have long ones. The mean is not removed, for that of residuals should be zero.
    """
    n = sum(run.shape[-1] for run in runs)
    power = sum(_product(run, run) for run in runs) / max(n, 1)
    predictors, powers = [np.empty(0)], [power]
    forward, backward = list(runs), list(runs)
    best, bic, best_bic = 0, 0.0, 0.0
    for p in range(1, min(_LONGEST, n // _SAMPLES_EACH) + 1):
        # Runs that are shorter than the lags say nothing more.
        pairs = [(f[..., 1:], b[..., :-1]) for f, b in zip(forward, backward, strict=True) if f.shape[-1] > 1]
        size = sum(_product(f, f) + _product(b, b) for f, b in pairs)
        count = sum(f.shape[-1] for f, _ in pairs)
        if size <= 0.0 or count < max(n // _TATTERS, _PAIRS_EACH * p):
            break
        k = float(np.clip(2.0 * sum(_product(f, b) for f, b in pairs) / size, -_EDGE, _EDGE))
        predictors.append(np.r_[predictors[-1] - k * predictors[-1][::-1], k])
        powers.append(powers[-1] * (1.0 - k * k))
        forward, backward = [f - k * b for f, b in pairs], [b - k * f for f, b in pairs]
        bic += count * math.log1p(-k * k) + math.log(n)
        if bic < best_bic:
            best, best_bic = p, bic
        if abs(k) == _EDGE or powers[-1] <= _EXACT * power:  # as a constant and a pure sine are
            break
    return Autoregression(tuple(predictors[: best + 1]), np.array(powers[: best + 1]))


def _product(a: _Array, b: _Array) -> float:
    return float(a @ b) if a.ndim == 1 else float(np.einsum("ij,ij->", a, b))
