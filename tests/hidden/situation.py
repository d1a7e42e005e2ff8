"""Situations of real records: disturbances, faults of data, effects with a memory, several records, and data with
nothing hidden.

The systems are those of the other cases. Terms of the physics in other sets of sensors and records are made as the other
cases are (`sets`); all else is integrated step by step (`twisted`).
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace

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
    for _ in range(4):
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
            limit = _limit(s, vehicle, rng)
            if limit is None:
                continue
            twist, truth, sizes = end_stop(s, rng, limit), (f"{STOPPED[system][0]}:limit",), {"limit": limit}
        first = record(s, vehicle, rng, twist, "data")
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


def _limit(s: System, vehicle: Vehicle, rng: np.random.Generator) -> float | None:
    """Where a stop is met: at 0.5 to 0.8 of the way from the middle to the end that the free motion of the first record
    reaches."""
    part = float(rng.uniform(0.5, 0.8))
    free = record(s, vehicle, deepcopy(rng), Twist(), "free")
    if free is None:
        return None
    x = free[1][STOPPED[s.name][0]]
    return float(np.median(x) + part * (x.max() - np.median(x)))


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
