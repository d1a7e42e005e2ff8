"""Records of a system with a twist, integrated by Runge and Kutta's rule with many steps between samples, since what
happens depends on the past."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import phugoid as ph

from .manoeuvre import manoeuvre
from .noises import noise
from .system import System, Vehicle
from .twist import Twist

__all__ = ["STEPS", "record"]

STEPS = 8
"""Steps of the integration in a sample interval."""


def record(
    s: System, vehicle: Vehicle, rng: np.random.Generator, twist: Twist, name: str
) -> tuple[ph.Experiment, dict[str, np.ndarray]] | None:
    """A record, or None where its motion leaves the limits; and its outputs without noise."""
    number = int(rng.integers(2**32))
    start = {n: x + s.wander[n] * rng.standard_normal() for n, x in vehicle.states.items()}
    seed = int(rng.integers(2**32))
    for size in 0.75 ** np.arange(7):
        inputs = manoeuvre(s, vehicle, np.random.default_rng(number), set(s.inputs), float(size))
        found = _moved(s, vehicle, inputs, start, twist, np.random.default_rng(seed))
        if found is None:
            continue
        path, inputs, clean, noisy = found
        away = max(float(np.abs(path[:, i] - vehicle.states[n]).max() / s.limits[n]) for i, n in enumerate(s.states))
        if away < 1.2:
            recorded = twist.recorded(inputs) if twist.recorded else inputs
            return ph.Experiment(s.t, recorded, noisy, name=name), clean
    return None


class _Motion:
    """The right-hand side of a system with a twist; the states of an attached mode come last."""

    def __init__(self, s: System, vehicle: Vehicle, twist: Twist) -> None:
        self.s, self.vehicle, self.twist, self.n = s, vehicle, twist, len(s.states)

    def parameters(self, now: float) -> dict[str, float]:
        drifts = self.twist.drifts
        return {**self.vehicle.parameters, **(drifts(now) if drifts else {})}

    def quantities(self, now: float, z: np.ndarray, acting: list[float], p: Mapping[str, float]) -> dict[str, Any]:
        x, wind, attached = z[: self.n], self.twist.wind, self.twist.attached
        q = self.s.quantities(x + wind(now) if wind else x, acting, p)
        if self.twist.force and self.twist.place:
            i, place = self.twist.place
            _, gain = self._slope(i, place, x, acting, q, p)
            q[place] = q[place] + float(self.twist.force(x, acting, now)[i]) / gain
        if attached and attached.place:
            i, place = attached.equation, attached.place
            rigid, gain = self._slope(i, place, x, acting, q, p)
            q[place] = q[place] + attached.push(z, rigid) / gain
        return q

    def _slope(
        self, i: int, place: str, x: Any, acting: list[float], q: Mapping[str, Any], p: Mapping[str, float]
    ) -> tuple[float, float]:
        """Return the derivative of a state, and that of it by a quantity in which it is linear."""
        rigid = float(self.s.dynamics(x, acting, q, p)[i])
        return rigid, float(self.s.dynamics(x, acting, {**q, place: q[place] + 1.0}, p)[i]) - rigid

    def rhs(self, now: float, z: np.ndarray, acting: list[float]) -> np.ndarray:
        x, p, attached = z[: self.n], self.parameters(now), self.twist.attached
        q = self.quantities(now, z, acting, p)
        f = np.array([float(v) for v in self.s.dynamics(x, acting, q, p)])
        if self.twist.force and not self.twist.place:
            f = f + self.twist.force(x, acting, now)
        if not attached:
            return f
        if not attached.place:
            f[attached.equation] += attached.push(z, f[attached.equation])
        return np.concatenate([f, attached.slopes(z, f[attached.equation])])

    def measured(self, now: float, z: np.ndarray, acting: list[float]) -> Mapping[str, Any]:
        x, p, displaced = z[: self.n], self.parameters(now), self.twist.displaced
        y = self.s.measured(x, acting, self.quantities(now, z, acting, p), p)
        return displaced(x, self.rhs(now, z, acting)[: self.n], y) if displaced else y


def _moved(
    s: System, vehicle: Vehicle, inputs: Mapping[str, np.ndarray], start: Mapping[str, float], twist: Twist, rng: Any
) -> Any:
    names, states, t, h = list(s.inputs), list(s.states), s.t, s.step / STEPS
    u = np.column_stack([inputs[n] for n in names])
    z = np.array([*(start[n] for n in states), *((0.0, 0.0) if twist.attached else ())])
    of_sensors = {n: s.sigma[n] * noise(twist.noise, t.size, rng) for n in s.outputs}
    path = np.empty((t.size, len(states)))
    memory: dict[str, Any] = {}
    clean: dict[str, list[float]] = {n: [] for n in s.outputs}
    noisy: dict[str, list[float]] = {n: [] for n in s.outputs}
    motion = _Motion(s, vehicle, twist)

    def at(now: float) -> list[float]:
        share = min(max(now / s.step, 0.0), t.size - 1 - 1e-9)
        k = int(share)
        held = u[k] if twist.held else u[k] + (share - k) * (u[min(k + 1, t.size - 1)] - u[k])
        return [float(v) for v in held]

    with np.errstate(all="ignore"):
        for k, now in enumerate(t):
            acting = twist.acts(at(now), memory, now) if twist.acts else at(now)
            y = motion.measured(now, z, acting)
            for n in s.outputs:
                clean[n].append(float(y[n]))
                noisy[n].append(float(y[n]) + of_sensors[n][k])
            path[k] = z[: len(states)]
            if twist.control and k + 1 < t.size:
                for n, more in twist.control(now, {m: noisy[m][-1] for m in s.outputs}).items():
                    u[k + 1, names.index(n)] += more
            if k + 1 == t.size:
                break
            for j in range(STEPS):
                a, b, c = now + j * h, now + (j + 0.5) * h, now + (j + 1) * h
                ua, ub, uc = (twist.acts(at(w), memory, w) if twist.acts else at(w) for w in (a, b, c - 1e-9))
                k1 = motion.rhs(a, z, ua)
                k2 = motion.rhs(b, z + h / 2 * k1, ub)
                k3 = motion.rhs(b, z + h / 2 * k2, ub)
                k4 = motion.rhs(c, z + h * k3, uc)
                z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            if not np.isfinite(z).all():
                return None
    inputs = {n: u[:, i].copy() for i, n in enumerate(names)}
    return path, inputs, {n: np.array(v) for n, v in clean.items()}, {n: np.array(v) for n, v in noisy.items()}
