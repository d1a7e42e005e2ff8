"""Test inputs: what a pilot or an engineer does to excite a vehicle, of random kind, size and timing."""

from __future__ import annotations

import numpy as np

from .system import System, Vehicle

__all__ = ["KINDS", "manoeuvre"]


def _pulses(t: np.ndarray, begin: float, width: float, lengths: tuple[int, ...]) -> np.ndarray:
    """Pulses of alternating sign, lengths in widths."""
    u, sign = np.zeros(t.size), 1.0
    for length in lengths:
        u[(t >= begin) & (t < begin + length * width)] = sign
        begin, sign = begin + length * width, -sign
    return u


def _three_two_one_one(rng: np.random.Generator, t: np.ndarray, width: float) -> np.ndarray:
    """Two or three 3-2-1-1, each in its part of the record."""
    count = int(rng.integers(2, 4))
    return _repeated(rng, t, width, (3, 2, 1, 1), count)


def _doublets(rng: np.random.Generator, t: np.ndarray, width: float) -> np.ndarray:
    return _repeated(rng, t, width, (1, 1), int(rng.integers(3, 6)))


def _repeated(
    rng: np.random.Generator, t: np.ndarray, width: float, lengths: tuple[int, ...], count: int
) -> np.ndarray:
    u, part = np.zeros(t.size), t[-1] / count
    for k in range(count):
        one = width * rng.uniform(0.7, 1.4)
        begin = k * part + rng.uniform(0.05, 0.3) * part
        u += rng.choice([-1, 1]) * rng.uniform(0.5, 1) * _pulses(t, begin, one, lengths)
    return u


def _multisine(rng: np.random.Generator, t: np.ndarray, width: float) -> np.ndarray:
    """Harmonics up to the pulse's frequency, with random phases, faded in."""
    base = 1 / t[-1]
    harmonics = rng.choice(np.arange(2, max(int(0.6 / width / base), 12)), size=8, replace=False)
    waves = [np.sin(2 * np.pi * base * k * t + rng.uniform(0, 2 * np.pi)) for k in harmonics]
    return np.sum(waves, axis=0) * np.minimum(t / (2 * width), 1)


def _steps(rng: np.random.Generator, t: np.ndarray, width: float) -> np.ndarray:
    """Holds of random level and length, four of ten followed by a rest at trim."""
    u, now = np.zeros(t.size), rng.uniform(1, 3) * width
    while now < t[-1]:
        length = width * rng.uniform(1, 5)
        u[(t >= now) & (t < now + length)] = rng.uniform(-1, 1)
        now += length * (1 if rng.random() < 0.6 else rng.uniform(1.5, 3))
    return u


def _sweep(rng: np.random.Generator, t: np.ndarray, width: float) -> np.ndarray:
    """A sine of rising frequency, logarithmically, after a short wait."""
    low, high = 0.06 / width, rng.uniform(0.4, 0.7) / width
    begin = width
    s = np.clip((t - begin) / (t[-1] - begin), 0, 1)
    rate = np.log(high / low)
    phase = 2 * np.pi * low * (t[-1] - begin) * (np.exp(rate * s) - 1) / rate
    return rng.choice([-1, 1]) * np.sin(phase)


KINDS = (_three_two_one_one, _doublets, _multisine, _steps, _sweep)


def manoeuvre(
    system: System, vehicle: Vehicle, rng: np.random.Generator, moving: set[str], size: float = 1.0
) -> dict[str, np.ndarray]:
    """Inputs name -> (N,): those in ``moving``, those needed and the first move, others in half of all records.

    ``size`` shrinks all peaks.
    """
    t, inputs = system.t, {}
    for k, name in enumerate(system.inputs):
        u = KINDS[int(rng.integers(len(KINDS)))](rng, t, rng.uniform(*system.pulse))
        peak = size * rng.uniform(*system.amplitudes[name]) / max(float(np.abs(u).max()), 1e-9)
        still = bool(rng.random() < 0.5) and k > 0 and name not in {*moving, *system.needed}
        inputs[name] = vehicle.inputs[name] + (np.zeros(t.size) if still else peak * u)
    return inputs
