"""How strongly an effect shows: twice the log-likelihood that it is expected to gain.

With true noise covariance R, and y(c) the outputs with an effect of size c, the strength is the least of
(y(c) - y(0; theta, x0))ᵀ R⁻¹ (...) over the base model's parameters theta and initial states x0: what these cannot
imitate. Gauss-Newton from the true values; sensitivities by central differences, all in lanes of one integration.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .colour import Colour
from .effect import Effect, Part
from .flow import Flow
from .system import System, Vehicle

__all__ = ["Baseline"]

LANES = 24
STEP = 1e-3
ADAPTATIONS, SETTLED = 6, 0.01
REFINEMENTS = 3
LINEAR, HUGE = 0.03, 1e100
STEEPEST = 4.0
"""More than this from one size to the next is looked at more closely."""


class Baseline:
    """The base model along a record, and what its parameters and initial states can imitate.

    ``start`` is the true state at the first sample, ``colours`` and the system's sigma the true noise.
    """

    def __init__(
        self,
        system: System,
        vehicle: Vehicle,
        inputs: Mapping[str, np.ndarray],
        start: Mapping[str, float],
        colours: Mapping[str, Colour],
    ) -> None:
        self.system, self.vehicle, self.inputs, self.colours = system, vehicle, inputs, colours
        self.x0 = np.array([start[name] for name in system.states])
        biased = {n: s or 1.0 for n, s in system.biases.items()}
        sizes = [abs(vehicle.parameters[n]) + 1e-3 for n in system.derivatives] + list(biased.values())
        self.h = STEP * np.array([*sizes, *(10 * system.wander[name] for name in system.states)])
        self.y, columns = self._sensitivity(np.zeros(self.h.size))
        self.ok = bool(np.abs(columns).max() < HUGE)
        if self.ok:
            self.projection = _Projection(columns)

    def _sensitivity(self, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whitened outputs (rows, 1) with parameters and states moved, and their derivatives (rows, n) per step."""
        n = self.h.size
        steps = np.diag(self.h)
        y = self.whitened(self.moved(moves[:, None] + np.concatenate([np.zeros((n, 1)), steps, -steps], axis=1)))
        with np.errstate(all="ignore"):
            return y[:, :1], (y[:, 1 : n + 1] - y[:, n + 1 :]) / 2

    def moved(self, moves: np.ndarray) -> dict[str, np.ndarray]:
        """Outputs of the base model in lanes, parameters and initial states moved by ``moves`` (n, lanes)."""
        names = self.system.parameters
        p = {name: self.vehicle.parameters[name] + moves[i] for i, name in enumerate(names)}
        x0 = [x + move for x, move in zip(self.x0, moves[len(names) :], strict=True)]
        return Flow(self.system, self.vehicle, self.inputs, parameters=p).lanes(x0, moves.shape[1])

    def whitened(self, y: Mapping[str, np.ndarray]) -> np.ndarray:
        """(channels N, lanes) in units of the true noise, made white."""
        with np.errstate(all="ignore"):  # lanes that diverged
            return np.concatenate([self.colours[n].whiten(y[n] / self.system.sigma[n]) for n in self.system.outputs])

    def residual(self, y: np.ndarray) -> np.ndarray:
        """What is left of whitened outputs (rows, lanes) when parameters and initial states have adapted, with the
        sensitivities at the true values."""
        moves = np.zeros((self.h.size, y.shape[1]))
        left, before = y - self.y, np.zeros(y.shape[1])
        for _ in range(ADAPTATIONS):
            moves += self.h[:, None] * self.projection.steps(left)
            left = y - self.whitened(self.moved(moves))
            rest = self.projection.rest(left)
            with np.errstate(over="ignore"):
                now = (rest**2).sum(axis=0)
            if np.allclose(now, before, rtol=SETTLED):
                break
            before = now
        return rest

    def strength(self, y: np.ndarray) -> float:
        """Strength of what makes the whitened outputs (rows,), with new sensitivities at every iteration."""
        moves, projection = np.zeros(self.h.size), self.projection
        left, before = y[:, None] - self.y, np.inf
        for _ in range(ADAPTATIONS):
            moves = moves + self.h * projection.steps(left)[:, 0]
            there, columns = self._sensitivity(moves)
            if not np.abs(columns).max() < HUGE:
                return np.inf  # Gauss-Newton runs away
            try:
                projection, left = _Projection(columns), y[:, None] - there
            except np.linalg.LinAlgError:
                return np.inf
            now = float((projection.rest(left) ** 2).sum())
            if abs(now - before) < SETTLED * before:
                break
            before = now
        return now

    def with_effect(self, effect: Effect, coefficients: np.ndarray, shape: Mapping[str, float]) -> np.ndarray:
        """Whitened outputs (rows, lanes) with an effect of each size."""
        flow = Flow(self.system, self.vehicle, self.inputs, [Part(effect, coefficients, shape)])
        return self.whitened(flow.lanes(self.x0, coefficients.size))

    def coefficient(
        self, effect: Effect, sign: int, shape: Mapping[str, float], strength: float
    ) -> tuple[float, np.ndarray] | None:
        """The coefficient at which the effect has that strength, and what is left of it (rows,); None where no size
        within its span has."""
        sizes = np.geomspace(*effect.span, LANES)
        if effect.form == "saturation":
            sizes = sizes[::-1]  # from weak to strong
        for _ in range(REFINEMENTS):
            y = self.with_effect(effect, sign * sizes, shape)
            with np.errstate(all="ignore"):  # lanes that diverged
                linear = (self.projection.rest(y - self.y) ** 2).sum(axis=0)
            crude = linear.copy()
            # Where parameters move far to imitate it, the linear answer is off, but not by as much as this.
            near = np.flatnonzero(np.isfinite(crude) & (crude > strength / 4) & (crude < 4 * strength))
            if near.size:
                left = self.residual(y[:, near])
                crude[near] = (left**2).sum(axis=0)
            k = _crossing(crude, strength)
            if k is None:
                return None
            if {k, k + 1} <= {*near} and max(crude[k : k + 2]) < STEEPEST * min(crude[k : k + 2]):
                a, b = np.log(sizes[k : k + 2]), np.log(crude[k : k + 2] / strength)
                slope = (b[1] - b[0]) / (a[1] - a[0])
                found = float(np.exp(a[0] - b[0] / slope))
                if np.abs(linear[k : k + 2] / crude[k : k + 2] - 1).max() > LINEAR:
                    found = self._closer(effect, sign, shape, strength, found, slope)
                if not found:
                    return None
                return sign * found, left[:, np.searchsorted(near, k)]
            sizes = np.geomspace(sizes[k], sizes[k + 1], LANES)
        return None

    def _closer(
        self, effect: Effect, sign: int, shape: Mapping[str, float], strength: float, size: float, slope: float
    ) -> float:
        """The size, where parameters move so far that their sensitivities change; ``slope`` is the strength's. 0 where
        none is found."""
        for _ in range(ADAPTATIONS):
            got = self.strength(self.with_effect(effect, np.array([sign * size]), shape)[:, 0])
            if abs(got / strength - 1) < 2 * SETTLED:
                return size
            size *= float(np.clip((strength / got) ** (1 / slope), 0.7, 1.4))
        return 0.0


class _Projection:
    """Least squares on columns (rows, n)."""

    def __init__(self, columns: np.ndarray) -> None:
        self.norms = np.linalg.norm(columns, axis=0)
        u, s, vt = np.linalg.svd(columns / self.norms, full_matrices=False)
        kept = s > 1e-9 * s[0]
        self.u, self.inverse = u[:, kept], vt[kept].T / s[kept]

    def rest(self, left: np.ndarray) -> np.ndarray:
        """What the columns cannot imitate of (rows, lanes)."""
        return left - self.u @ (self.u.T @ left)

    def steps(self, left: np.ndarray) -> np.ndarray:
        """(n, lanes) of the columns that imitate the rest."""
        return (self.inverse @ (self.u.T @ left)) / self.norms[:, None]


def _crossing(strengths: np.ndarray, wanted: float) -> int | None:
    """The first lane after which the strength rises above the wanted one."""
    above, known = strengths > wanted, np.isfinite(strengths)
    found = np.flatnonzero(above[1:] & ~above[:-1] & known[1:] & known[:-1])
    return int(found[0]) if found.size else None
