"""Situations of real records: disturbances, faults of data, effects with a memory, several records, and data with
nothing hidden.

The systems are those of the other cases. Terms of the physics in other sets of sensors and records are made as the
other cases are (`sets`); all else is integrated step by step (`twisted`).
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

import phugoid as ph

from .case import Unreachable
from .noises import NOISES
from .sensors import OF_SENSORS, coarse, sensed
from .sets import SETS, in_set
from .system import System, Vehicle
from .systems import SYSTEMS
from .twist import Twist
from .twisted import record
from .twists import DISPLACED, POSITIONS, STOPPED, WINDY, end_stop, twist_of

__all__ = ["SITUATIONS", "Situation", "situation"]

SITUATIONS = (
    "gust", "wind", "noisy input", "drift", "backlash", "rate limit", "event", "held input", "outside", "clipped",
    "hysteresis", "friction", "end stop", "mode", "displaced", "other parameter", *SETS, "closed loop", "coarse",
    "two rates", "gap", *NOISES,
)  # fmt: skip

SYSTEMS_OF = {
    "hysteresis": POSITIONS, "friction": POSITIONS, "wind": WINDY, "end stop": STOPPED, "displaced": DISPLACED,
}  # fmt: skip
"""Systems in which a situation can be, where that is not all."""

RINGS, HEAVIEST = 200.0, 0.6
"""A flexible part shows where the squares of what it adds at high frequencies, in units of the noise, sum up to this;
and its largest mass, in parts of the whole."""

CONTACTS = 3
"""An end stop is met so often, at least: once would be an event."""

ATTEMPTS = 8

RECORDS = 4
"""Number of records, where a parameter differs from record to record."""


@dataclass(frozen=True)
class Situation:
    """What is given to a diagnosis, and the names that it may say.

    data   a record, or several.
    truth  names any of which is right; () where nothing is to be named.
    """

    name: str
    system: str
    what: str
    seed: int
    model: ph.Model
    data: ph.Experiment | Sequence[ph.Experiment]
    validation: ph.Experiment
    truth: tuple[str, ...]
    sizes: dict[str, float] = field(default_factory=dict)


def situation(what: str, system: str, seed: int) -> Situation:
    """A record in a situation, and one for validation.

    Raises Unreachable where no manoeuvre stays within the system's limits.
    """
    if what not in SITUATIONS:
        raise ValueError(f"situation is one of {SITUATIONS}, not {what!r}")
    if system not in SYSTEMS_OF.get(what, SYSTEMS):
        raise Unreachable(f"{what}: {system} has no such thing")
    s = SYSTEMS[system]
    rng = np.random.default_rng([seed, zlib.crc32(f"{what} {system}".encode())])
    name = f"{what} {system} {seed}"
    if what in SETS:
        case = in_set(what, system, seed, rng)
        data = [case.data, *case.more] if case.more else case.data
        assert case.validation is not None
        return Situation(name, system, what, seed, case.model, data, case.validation, case.truth, case.coefficients)
    for _ in range(ATTEMPTS):
        vehicle = s.vehicle(rng)
        size = float(rng.uniform(0.7, 1.4))
        if what == "other parameter":
            found = _records(s, vehicle, rng, size)
            if found is None:
                continue
            several, parameter = found
            truth = (f"{parameter}:per_experiment",)
            return Situation(name, system, what, seed, s.model(), several[:-1], several[-1], truth)
        twist, truth, sizes = twist_of(what, s, vehicle, rng, size)
        if what == "end stop":
            frequency, loss, part = rng.uniform(0.4, 1.0), rng.uniform(0.5, 2.0), rng.uniform(0.3, 0.7)
            # Where the first record would go without the stop: the same random numbers.
            free = record(s, vehicle, deepcopy(rng), Twist(), "free")
            if free is None:
                continue
            x = free[1][STOPPED[system][0]]
            limit = float(np.median(x) + part * (x.max() - np.median(x)))
            twist, truth = end_stop(s, limit, frequency, loss), (f"{STOPPED[system][0]}:limit",)
            sizes = {"limit": limit}
        first = record(s, vehicle, rng, twist, "data")
        if what == "end stop" and (first is None or _contacts(first[1][STOPPED[system][0]], limit) < CONTACTS):
            continue
        if what == "mode":
            first = _visible(s, vehicle, rng, twist, first)
        if what == "event":  # it happened once
            twist.force = None
        if what in ("gust", "wind"):
            twist = _again(twist, s, rng)
        other = record(s, vehicle, rng, twist, "validation")
        if first is None or other is None:
            continue
        data, validation = first[0], other[0]
        if what in OF_SENSORS:
            data, validation, *of_sensor = sensed(what, s, (first, other), rng)
            truth, sizes = (of_sensor[0] or truth), (of_sensor[1] or sizes)
        if what == "coarse":
            data, validation = coarse(data), coarse(validation)
        return Situation(name, system, what, seed, s.model(), data, validation, truth, sizes)
    raise Unreachable(f"{what}, {system}, seed {seed}")


def _again(twist: Twist, s: System, rng: np.random.Generator) -> Twist:
    """Other air: the same gusts later on."""
    force, wind, away = twist.force, twist.wind, rng.uniform(0.3, 0.7) * s.t[-1]
    if wind is not None:
        return Twist(wind=lambda now: wind((now + away) % s.t[-1]))
    assert force is not None
    return Twist(force=lambda x, u, now: force(x, u, (now + away) % s.t[-1]))


def _visible(s: System, vehicle: Vehicle, rng: np.random.Generator, twist: Twist, first: Any) -> Any:
    """A first record in which a flexible part shows plainly, its mass doubled until it does; None where it does not."""
    part = twist.attached
    assert part is not None
    for mass in part.mass * 2.0 ** np.arange(4):
        if mass > HEAVIEST:
            return None
        twist.attached = replace(part, mass=float(mass))
        again = deepcopy(rng)
        first, rigid = record(s, vehicle, rng, twist, "data"), record(s, vehicle, again, Twist(), "rigid")
        if first is None or rigid is None:
            return None
        # What it rings with is quicker than the rigid motion, to which its mass adds.
        fast = part.frequency / (2.0 * np.pi) / 2.0
        rings = [_faster(first[1][n] - rigid[1][n], fast * s.step) / s.sigma[n] for n in s.outputs]
        if float(np.sum(np.square(rings))) > RINGS:
            return first
    return None


def _faster(x: np.ndarray, cycles: float) -> np.ndarray:
    """(n,) with frequencies above so many cycles in a sample interval only."""
    spectrum = np.fft.rfft(x - np.linspace(x[0], x[-1], x.size))
    spectrum[np.fft.rfftfreq(x.size) < cycles] = 0.0
    return np.fft.irfft(spectrum, x.size)


def _contacts(x: np.ndarray, limit: float) -> int:
    """Count how often a position goes beyond a limit."""
    return int(np.sum(np.diff((x > limit).astype(int)) > 0))


def _records(
    s: System, vehicle: Vehicle, rng: np.random.Generator, size: float
) -> tuple[list[ph.Experiment], str] | None:
    """Records of a vehicle of which one parameter differs from record to record, and its name; the last is for
    validation."""
    parameter = str(rng.choice(list(s.derivatives)))
    parts = 0.2 * size * rng.permutation(np.linspace(-1.0, 1.0, RECORDS + 1))
    found = []
    for k, part in enumerate(parts.tolist()):
        own = {**vehicle.parameters, parameter: vehicle.parameters[parameter] * (1.0 + part)}
        one = record(s, replace(vehicle, parameters=own), rng, Twist(), f"record {k + 1}")
        if one is None:
            return None
        found.append(one[0])
    return found, parameter
