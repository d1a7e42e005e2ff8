"""A fitted model along its trajectory: time histories of its variables, and where terms can be added to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["AddedTerm", "Place", "Points"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """Where a candidate acts: what its signal is added to.

    An "input" or a "parameter" stands for its symbol everywhere, an "equation" for the derivative of the state of that
    name, a "state" for what a state is in the forces, but neither in the kinematics nor at its own sensor: with wind
    the motion through the air is another than that over ground.
    """

    kind: Literal["quantity", "equation", "output", "input", "parameter", "state"]
    name: str


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


class AddedTerm(Protocol):
    """What is added to a model at one place, to first order: ``sum_k c_k signal_k(t)``, for values of its shape.

    Without coefficients (``unit_amplitude``) its one signal is the whole effect.
    """

    @property
    def place(self) -> Place: ...

    @property
    def coefficients(self) -> tuple[str, ...]: ...

    @property
    def unit_amplitude(self) -> bool: ...

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        """Return the signals (k, n) at the points; k is the number of coefficients, or 1 with unit amplitude."""
        ...
