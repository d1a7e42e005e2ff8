"""A step of Newton's method within bounds and a trust region, for few variables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Quadratic"]

_Array = NDArray[np.float64]

# Bisections for the radius of a step.
_HALVINGS = 80


@dataclass(frozen=True)
class Quadratic:
    """The second-order model of an objective about a point, with bounds on the variables.

    x         (n,) the point.
    gradient  (n,).
    hessian   (n, n), symmetric.
    lower, upper  (n,) bounds, equal where a variable is fixed.
    """

    x: _Array
    gradient: _Array
    hessian: _Array
    lower: _Array
    upper: _Array

    @property
    def scale(self) -> _Array:
        """Units of the variables, (n,): standard deviations where the curvature is positive."""
        curvature = np.abs(np.diag(self.hessian))
        size = np.maximum(np.abs(self.x), 1e-8)
        return np.where(curvature > 0.0, 1.0 / np.sqrt(np.where(curvature > 0.0, curvature, 1.0)), size)

    def step(self, radius: float) -> tuple[_Array, float]:
        """Return the step that minimises the model within bounds and a radius, in units of `scale`, and the decrease
        that it promises (Nocedal and Wright, section 4.3). Variables that would leave their bounds go there, one after
        the other, and the rest is minimised anew."""
        n = self.x.size
        d = np.zeros(n)
        low, high = np.minimum(self.lower - self.x, 0.0), np.maximum(self.upper - self.x, 0.0)
        held = self.lower >= self.upper
        for _ in range(n + 1):
            free = ~held
            if not free.any():
                break
            pulled = self.gradient + self.hessian @ np.where(held, d, 0.0)
            d[free] = self._within(free, pulled, radius)
            outside = free & ((d < low) | (d > high))
            if not outside.any():
                break
            # What stands at a bound and is pushed out of it is held first.
            standing = outside & np.where(d < 0.0, low == 0.0, high == 0.0)
            to_hold = standing if standing.any() else outside
            d[to_hold] = np.clip(d, low, high)[to_hold]
            held = held | to_hold
        return d, float(-(self.gradient @ d + 0.5 * d @ self.hessian @ d))

    def length(self, d: _Array) -> float:
        """Return the length of a step in units of `scale`."""
        return float(np.linalg.norm(d / self.scale))

    def free(self) -> NDArray[np.bool_]:
        """Return which variables are neither fixed nor at a bound that the gradient pushes them against."""
        at_lower = (self.x <= self.lower) & (self.gradient > 0.0)
        at_upper = (self.x >= self.upper) & (self.gradient < 0.0)
        return ~((self.lower >= self.upper) | at_lower | at_upper)

    def _within(self, free: NDArray[np.bool_], gradient: _Array, radius: float) -> _Array:
        s = self.scale[free]
        h = self.hessian[np.ix_(free, free)] * np.outer(s, s)
        values, vectors = np.linalg.eigh(0.5 * (h + h.T))
        along = vectors.T @ (gradient[free] * s)
        most = float(np.abs(values).max())

        def at(shift: float) -> _Array:
            return -along / (values + shift)

        least = float(values.min())
        low = 0.0 if least > 1e-12 * most else float(max(-least, 0.0) + 1e-14 * most + np.finfo(float).tiny)
        found = at(low)
        if np.linalg.norm(found) > radius:
            below, above = max(low, 1e-300), max(low, most) + float(np.linalg.norm(along)) / radius
            while np.linalg.norm(at(above)) > radius:
                above *= 4.0
            for _ in range(_HALVINGS):
                middle = float(np.sqrt(below * above))
                if np.linalg.norm(at(middle)) > radius:
                    below = middle
                else:
                    above = middle
            found = at(above)
        return np.asarray(s * (vectors @ found))
