"""Describe how a record differs from what its model says: by a disturbance, faulty data, an effect with memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["Attached", "Twist"]


@dataclass(frozen=True)
class Attached:
    """A small mass on a spring with little damping, attached to what moves: it is excited by the acceleration, and its
    spring acts back.

    equation   number of the state whose derivative is that acceleration.
    place      quantity in which the force of the spring stands; "" where it stands in the equation.
    frequency  rad/s, of the small mass where the other is at rest.
    damping    ratio.
    mass       of the small one, in parts of both together: what is slow moves as if it were rigid.
    """

    equation: int
    place: str
    frequency: float
    damping: float
    mass: float

    def push(self, z: np.ndarray, rigid: float) -> float:
        """Return what is added to the acceleration that both would have if they were rigid; displacement and rate of
        the small mass are the last states."""
        spring = self.frequency**2 * z[-2] + 2 * self.damping * self.frequency * z[-1]
        return float(self.mass / (1.0 - self.mass) * (rigid + spring))

    def slopes(self, z: np.ndarray, acceleration: float) -> list[float]:
        """Return the derivatives of displacement and rate, relative to what it is attached to."""
        w = self.frequency
        return [float(z[-1]), float(-(w**2) * z[-2] - 2 * self.damping * w * z[-1] - acceleration)]


@dataclass
class Twist:
    """Everything is left as it is unless set.

    force     (x, u, time) -> what is added to the derivatives.
    place     state and the quantity in which the force on it stands, which sensors of that measure too; None where the
              force stands in the equation.
    wind      time -> what is added to the states where forces and moments follow from them.
    acts      (u, memory, time) -> inputs as they act; memory is a dictionary of its own.
    drifts    time -> parameters.
    displaced (x, derivatives, outputs) -> outputs of sensors that are elsewhere, or turned.
    recorded  inputs -> inputs as they are recorded.
    control   (time, measured) -> what is added to the inputs.
    attached  a mode that the model has not.
    held      whether inputs are constant between samples.
    noise     of the sensors, see `noises`.
    """

    force: Callable[[Any, Any, float], Any] | None = None
    place: tuple[int, str] | None = None
    wind: Callable[[float], Any] | None = None
    acts: Callable[[list[float], dict[str, Any], float], list[float]] | None = None
    drifts: Callable[[float], Mapping[str, float]] | None = None
    displaced: Callable[[Any, Any, Mapping[str, Any]], Mapping[str, Any]] | None = None
    recorded: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]] | None = None
    control: Callable[[float, Mapping[str, float]], Mapping[str, float]] | None = None
    attached: Attached | None = None
    held: bool = False
    noise: str = "white"
