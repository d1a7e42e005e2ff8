"""Effects that are hidden in other sets of sensors or records: a state that is not measured, two sensors of one
quantity, several records of one vehicle."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from .case import Case, Unreachable, make
from .effect import Effect
from .system import System
from .systems import SYSTEMS

__all__ = ["SETS", "in_set"]

SETS = ("unmeasured", "redundant", "several records", "nothing in several")

UNMEASURED = {
    "hfb320": (("q", "aq"), "Cm"),
    "duffing": (("v", "a"), "f"),
    "servo": (("rate",), "torque"),
    "lateral": (("r",), "Cn"),
    "uav": (("q",), "q'"),
}
"""Outputs that are missing, and where the effect acts: on the state that these would measure."""

RECORDS = 3
STRENGTH = {"unmeasured": (150.0, 1200.0), "redundant": (150.0, 1200.0), "several records": (60.0, 400.0)}
"""Range of the expected gain of 2 log L, in the first record."""

LEFT_OUT = ("disturbance",)
"""Kinds that several records have not in common: a periodic disturbance has another phase in each."""


def in_set(what: str, system: str, seed: int, rng: np.random.Generator) -> Case:
    """A case with white noise; Unreachable where no effect of the system shows there."""
    s = SYSTEMS[system]
    if what == "nothing in several":
        return _of(s, (), "", seed)
    low, high = np.log(STRENGTH[what])
    for _ in range(30):
        strength = float(np.exp(rng.uniform(low, high)))
        if what == "unmeasured":
            missing, where = UNMEASURED[system]
            own = _without(s, missing)
            effects = [e for e in own.effects if e.where == where and e.form == "term"]
            name = effects[int(rng.integers(len(effects)))].name
        elif what == "redundant":
            own, name = _twice(s, rng)
        else:
            effects = [e for e in s.effects if e.kind not in LEFT_OUT and e.form != "drift"]
            own, name = s, effects[int(rng.integers(len(effects)))].name
        try:
            return _of(own, name, strength, seed, RECORDS - 1 if what == "several records" else 0)
        except Unreachable:
            continue
    raise Unreachable(f"{what}, {system}, seed {seed}")


def _of(s: System, effects: Any, strength: Any, seed: int, more: int = RECORDS - 1) -> Case:
    return make(s, effects, strength, "white", seed, more=more)


def _without(s: System, missing: tuple[str, ...]) -> System:
    """The system without these sensors, and their biases."""
    kept = [n for n in s.outputs if n not in missing]

    def measured(x: Any, u: Any, q: Any, p: Any) -> dict[str, Any]:
        y = s.measured(x, u, q, {**dict.fromkeys(s.biases, 0.0), **p})
        return {n: y[n] for n in kept}

    return replace(
        s,
        name=f"{s.name} without {', '.join(missing)}",
        outputs={n: s.outputs[n] for n in kept},
        sigma={n: s.sigma[n] for n in kept},
        biases={n: b for n, b in s.biases.items() if n.removeprefix("b_") not in missing},
        measured=measured,
        effects=[e for e in s.effects if e.where not in missing],
    )


def _twice(s: System, rng: np.random.Generator) -> tuple[System, str]:
    """The system with a second sensor of an output, and the name of a fault of one of the two."""
    faults = ("scale", "bias", "drift", "delay")
    doubled = [n for n in s.outputs if f"b_{n}" not in s.biases]
    known = [e for e in s.effects if e.where in doubled and e.what in faults]
    fault = known[int(rng.integers(len(known)))]
    y, second = fault.where, f"{fault.where}_2"

    def measured(x: Any, u: Any, q: Any, p: Any) -> dict[str, Any]:
        found = s.measured(x, u, q, p)
        return {**found, second: found[y]}

    faulty: Effect = replace(fault, name=f"{second}:{fault.what}") if rng.random() < 0.5 else fault
    own = replace(
        s,
        name=f"{s.name} with {second}",
        outputs={**s.outputs, second: s.outputs[y]},
        sigma={**s.sigma, second: s.sigma[y] * float(2.0 ** rng.uniform(-1, 1))},
        measured=measured,
        effects=[*s.effects, faulty] if faulty is not fault else s.effects,
    )
    return own, faulty.name
