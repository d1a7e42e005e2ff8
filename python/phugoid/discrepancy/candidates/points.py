"""Time histories along a fitted path, at the points where candidates act."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Points"]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Points:
    """One experiment along the fitted path, at n times: the mesh points, or the samples.

    experiment  name of the experiment.
    t           (n,) time, s.
    values      name -> (n,): states, inputs and quantities.
    rates       name -> (n,): time derivatives of states and inputs, per second.
    outputs     name -> (n,): outputs of the model.
    output_rates  name -> (n,): their time derivatives, per second.
    """

    experiment: str
    t: _Array
    values: Mapping[str, _Array]
    rates: Mapping[str, _Array]
    outputs: Mapping[str, _Array]
    output_rates: Mapping[str, _Array]

    @property
    def n(self) -> int:
        """Number of points."""
        return int(self.t.size)
