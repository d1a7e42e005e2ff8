"""One case: a base model, and data of a system that has more to it, or not."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import phugoid as ph

from .colour import WHITE, Colour
from .effect import Effect, Part
from .flow import Flow
from .manoeuvre import manoeuvre
from .strength import Baseline
from .system import System, Vehicle
from .systems import SYSTEMS

__all__ = ["STRENGTHS", "Case", "Unreachable", "draw", "make", "nothing"]

STRENGTHS = {"weak": 60.0, "medium": 250.0, "strong": 1000.0}
"""Expected gain of 2 log L."""

NOISES = ("white", "coloured")
ATTEMPTS = 4
FARTHEST = 100.0
"""Times the range of the first record."""
SIMILAR = 0.8
"""Two effects are not hidden together where what is left of one resembles the other more than this (cosine)."""


class Unreachable(ValueError):
    """No vehicle and manoeuvre was found in which the effect, at a physical size, is so strong."""


@dataclass(frozen=True)
class Case:
    """What is given to a diagnosis, and what it should find.

    name          to call it in a table.
    system        name of the system.
    model         the base model, without the effects.
    data          a record of the vehicle with them.
    validation    a record of another manoeuvre of the same vehicle, or None.
    truth         canonical names of the effects; () where nothing is hidden.
    strength      "weak", "medium" or "strong" (see STRENGTHS), a number, or "" where nothing is hidden.
    noise         "white" or "coloured".
    seed          that it was made from.
    coefficients  effect -> its first parameter, see `Effect`.
    shapes        effect -> its others.
    kinds         effect -> what kind it is.
    parameters    true ones of the base model.
    colours       output -> correlation of its noise.
    clean         output -> (N,) of ``data`` without noise.
    baseline      of ``data``: the strength of anything can be computed from it.
    more          further records of the vehicle, of other manoeuvres.
    """

    name: str
    system: str
    model: ph.Model
    data: ph.Experiment
    validation: ph.Experiment | None
    truth: tuple[str, ...]
    strength: str | float
    noise: str
    seed: int
    coefficients: dict[str, float]
    shapes: dict[str, dict[str, float]]
    kinds: dict[str, str]
    parameters: dict[str, float]
    colours: dict[str, Colour]
    clean: dict[str, np.ndarray]
    baseline: Baseline
    more: tuple[ph.Experiment, ...] = ()

    def again(self) -> str:
        """The call that makes this case."""
        if not self.truth:
            return f"nothing({self.system!r}, {self.noise!r}, {self.seed})"
        return f"make({self.system!r}, {self.truth!r}, {self.strength!r}, {self.noise!r}, {self.seed})"


@dataclass(frozen=True)
class _Setting:
    """A vehicle on one record."""

    system: System
    vehicle: Vehicle
    inputs: dict[str, np.ndarray]
    start: dict[str, float]

    @staticmethod
    def draw(
        system: System, vehicle: Vehicle, rng: np.random.Generator, moving: set[str], steady: bool
    ) -> _Setting | None:
        """A manoeuvre that stays within the system's limits; None where none does."""
        start = dict(vehicle.states)
        if not steady:
            start = {n: x + system.wander[n] * rng.standard_normal() for n, x in start.items()}
        number = int(rng.integers(2**32))
        for size in 0.75 ** np.arange(8):
            # The same manoeuvre, smaller: the same random numbers.
            inputs = manoeuvre(system, vehicle, np.random.default_rng(number), moving, float(size))
            path = Flow(system, vehicle, inputs).states(list(start.values()))
            away = [np.abs(x - vehicle.states[n]).max() / system.limits[n] for n, x in path.items()]
            if np.isfinite(away).all() and max(away) < 1:
                return _Setting(system, vehicle, inputs, start)
        return None

    def record(
        self, parts: Collection[Part], colours: Mapping[str, Colour], rng: np.random.Generator, name: str
    ) -> tuple[ph.Experiment, dict[str, np.ndarray]] | None:
        """A measured record and the same without noise; None where the motion diverges."""
        clean = Flow(self.system, self.vehicle, self.inputs, list(parts)).truth(list(self.start.values()))
        if not all(np.isfinite(y).all() for y in clean.values()):
            return None
        t, sigma = self.system.t, self.system.sigma
        outputs = {n: y + sigma[n] * colours[n].sample(t.size, rng) for n, y in clean.items()}
        return ph.Experiment(t, self.inputs, outputs, name=name), clean


def make(
    system: str | System,
    effects: str | Collection[str],
    strength: str | float,
    noise: str,
    seed: int,
    validation: bool = True,
    more: int = 0,
) -> Case:
    """A case that hides these effects of a system, each of that strength if it were alone; all else from the seed.

    ``system`` is the name of one, or one with other sensors; ``more`` is the number of further records.

    Raises Unreachable where a few vehicles and manoeuvres did not show an effect so strongly, KeyError for a system or
    an effect that is not there.
    """
    names = (effects,) if isinstance(effects, str) else tuple(effects)
    s = SYSTEMS[system] if isinstance(system, str) else system
    hidden = [s.effect(name) for name in names]
    wanted = STRENGTHS[strength] if isinstance(strength, str) and names else strength
    if noise not in NOISES:
        raise ValueError(f"noise is one of {NOISES}, not {noise!r}")
    rng = np.random.default_rng([seed, zlib.crc32(s.name.encode())])
    why = ""
    for _ in range(ATTEMPTS):
        vehicle = s.vehicle(rng)
        colours = {n: Colour.draw(rng) if noise == "coloured" else WHITE for n in s.outputs}
        moving = {e.moves for e in hidden} | {e.where for e in hidden if e.where in s.inputs}
        setting = _Setting.draw(s, vehicle, rng, moving, steady=bool(rng.random() < 0.5))
        other = _Setting.draw(s, vehicle, rng, moving, steady=False)
        if setting is None or other is None:
            why = "no manoeuvre stays within limits"
            continue
        baseline = Baseline(s, vehicle, setting.inputs, setting.start, colours)
        if not baseline.ok:
            why = "a sensitivity is not finite"
            continue
        parts = _sized(baseline, hidden, wanted, rng)
        if isinstance(parts, str):
            why = parts
            continue
        measured = setting.record(parts, colours, rng, "data")
        other_measured = other.record(parts, colours, rng, "validation") if validation else None
        if measured is None or (validation and other_measured is None):
            why = "the truth is not finite"
            continue
        (data, clean), held = measured, other_measured and other_measured[0]
        settings = [_Setting.draw(s, vehicle, rng, moving, steady=False) for _ in range(more)]
        found = [each.record(parts, colours, rng, f"data {k}") for k, each in enumerate(settings, 2) if each]
        records = [each[0] for each in found if each]
        if len(records) < more:
            why = "no further manoeuvre stays within limits"
            continue
        if any(_runs_away(data, e) for e in (held, *records) if e):
            why = "with the effect a record runs away"
            continue
        return Case(
            name=f"{s.name} {' + '.join(names) or 'nothing'} {strength} {noise} {seed}",
            system=s.name,
            model=s.model(),
            data=data,
            validation=held,
            truth=names,
            strength=strength,
            noise=noise,
            seed=seed,
            coefficients={p.effect.name: p.coefficient for p in parts},
            shapes={p.effect.name: dict(p.shape) for p in parts},
            kinds={e.name: e.kind for e in hidden},
            parameters=vehicle.parameters,
            colours=colours,
            clean=clean,
            baseline=baseline,
            more=tuple(records),
        )
    raise Unreachable(f"{s.name}, {' + '.join(names)}, {strength}, seed {seed}: {why}")


def _runs_away(data: ph.Experiment, other: ph.Experiment) -> bool:
    """Return whether another record exceeds the range of a vehicle: limits hold for the motion without the effect."""
    return any(not np.ptp(other.output(n)) < FARTHEST * np.ptp(data.output(n)) for n in data.outputs)


def _sized(baseline: Baseline, effects: Collection[Effect], wanted: Any, rng: np.random.Generator) -> list[Part] | str:
    """The effects with coefficients; or why not."""
    parts, left = [], []
    for effect in effects:
        sign, shape = effect.draw(rng)
        found = baseline.coefficient(effect, sign, shape, float(wanted))
        if found is None:
            return f"{effect.name} does not reach {wanted}"
        parts.append(Part(effect, found[0], shape))
        left.append(found[1] / np.linalg.norm(found[1]))
    if any(abs(a @ b) > SIMILAR for i, a in enumerate(left) for b in left[:i]):
        return "the effects resemble each other"
    return parts


def nothing(system: str, noise: str, seed: int, validation: bool = True) -> Case:
    """A case in which the base model is right."""
    return make(system, (), "", noise, seed, validation)


def draw(
    seed: int,
    systems: Collection[str] = tuple(SYSTEMS),
    strengths: Collection[str] = tuple(STRENGTHS),
    noises: Collection[str] = NOISES,
    doubles: float = 0.0,
    empty: float = 0.0,
    validation: bool = True,
    more: int = 0,
) -> Case:
    """A case picked at random: kinds of effect as often as the root of how many there are, effects of a kind alike.

    ``doubles`` and ``empty`` are the parts of cases with two effects and with none. Effects that a seed's vehicles and
    manoeuvres do not show strongly enough are passed over. ``more`` is the number of further records.
    """
    rng = np.random.default_rng([seed, 7])
    system, noise = str(rng.choice(list(systems))), str(rng.choice(list(noises)))
    strength = str(rng.choice(list(strengths)))
    share = rng.random()
    if share < empty:
        return nothing(system, noise, seed, validation)
    count = 2 if share < empty + doubles else 1
    for _ in range(60):
        names: list[str] = []
        while len(names) < count:
            effect = _any(SYSTEMS[system], rng)
            if all(effect.where != name.partition(":")[0] for name in names) or effect.form == "term":
                names += [effect.name] * (effect.name not in names)
        try:
            return make(system, tuple(names), strength, noise, seed, validation, more)
        except Unreachable:
            continue
    raise Unreachable(f"{system}, seed {seed}: no effect reaches {strength}")


def _any(system: System, rng: np.random.Generator) -> Effect:
    kinds = Counter(e.kind for e in system.effects)
    often = np.sqrt(list(kinds.values()))
    kind = rng.choice(list(kinds), p=often / often.sum())
    return system.effects[rng.choice([i for i, e in enumerate(system.effects) if e.kind == kind])]
