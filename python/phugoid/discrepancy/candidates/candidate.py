"""One thing that a model may be missing."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...modelling.model import Model
from .points import Points

__all__ = ["Candidate", "Place"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """Where a candidate acts: what its signal is added to.

    An "input" stands for its symbol everywhere, an "equation" for the derivative of the state of that name.
    """

    kind: Literal["quantity", "equation", "output", "input"]
    name: str


class Candidate(ABC):
    """An effect at one place, with unknown coefficients.

    To first order the effect adds ``sum_k c_k signal_k(t)`` to its place; ``signals`` gives these signals along a
    fitted path for one *shape*, that is for given values of the unknowns that enter nonlinearly (a time constant, a
    frequency, a dead-band's width). ``extended`` adds the effect to a model exactly.

    name         canonical, ``where:what``: ``Cm:alpha*q``.
    place        what the signals are added to.
    explanation  one plain sentence for an engineer.
    coefficients names of the parameters that `extended` adds and that multiply the signals; where ``unit_amplitude``
                 holds there are none, for the signal at a shape is the whole effect (a delayed minus the plain input).
    shape_names  names of the other parameters that `extended` adds.
    shapes       values of those to try in a scan, a mapping each (one empty mapping where there are none).
    transferable whether its parameters are those of the vehicle, so the same in another record: the phase of a
                 disturbance is not.
    stage        terms (0) are added before inputs are transformed: dead-band (1), saturation (2), lag (3), delay (4).
    """

    name: str
    place: Place
    explanation: str
    coefficients: tuple[str, ...]
    shape_names: tuple[str, ...] = ()
    shapes: Sequence[Mapping[str, float]] = ({},)
    unit_amplitude: bool = False
    transferable: bool = True
    stage: int = 0

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all parameters that `extended` adds."""
        return (*self.coefficients, *self.shape_names)

    @abstractmethod
    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        """(k, n) signals at the points; k is the number of coefficients, or 1 with unit amplitude."""

    @abstractmethod
    def extended(self, model: Model, start: Mapping[str, float] | None = None) -> Model:
        """The model with this effect; its parameters start at the values given by name (coefficients else at 0)."""

    @abstractmethod
    def physical(self, points: Sequence[Points]) -> Mapping[str, tuple[float, float]]:
        """Range of each of its parameters, in its unit, outside of which it is no physical explanation."""
