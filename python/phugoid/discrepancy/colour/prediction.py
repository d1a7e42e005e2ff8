"""What can be predicted of a channel's residual from its past, by an autoregressive model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .autoregression import burg

__all__ = ["Channel", "autoregressive"]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Channel:
    """The autoregressive model of one channel.

    predictors  predictors[k] (k,) is the best predictor from k samples: r_t is about sum_i predictors[k][i] r_{t-1-i}.
    sigmas      (p + 1,) standard deviations of their errors.
    """

    predictors: tuple[_Array, ...]
    sigmas: _Array

    @property
    def order(self) -> int:
        """p."""
        return len(self.predictors) - 1


def autoregressive(runs: Sequence[_Array]) -> Channel:
    """The model of residuals, runs of equally spaced samples."""
    model = burg(runs)
    return Channel(model.predictors, np.sqrt(np.maximum(model.powers, np.finfo(float).tiny)))
