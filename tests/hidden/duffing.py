"""A mass on a spring with a damper, driven by a force; linear in its base model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .effect import Effect
from .system import System

__all__ = ["DUFFING"]


def quantities(x: Sequence[Any], u: Sequence[Any], p: Mapping[str, Any]) -> dict[str, Any]:
    """Force per mass."""
    return {"f": p["f0"] - p["k"] * x[0] - p["d"] * x[1] + p["b"] * u[0]}


def dynamics(x: Sequence[Any], u: Sequence[Any], q: Mapping[str, Any], p: Mapping[str, Any]) -> list[Any]:
    """x', v'."""
    return [x[1], q["f"]]


def measured(x: Sequence[Any], u: Sequence[Any], q: Mapping[str, Any], p: Mapping[str, Any]) -> dict[str, Any]:
    """Position, speed and acceleration."""
    return {"x": x[0], "v": x[1], "a": q["f"] + p["b_a"]}


def _effects() -> list[Effect]:
    wave = {"frequency": (0.15, 3.0), "phase": (0, 2 * np.pi)}
    late = (1e-3, 0.2)
    found = [
        Effect("f:x^2", "stiffness", (0.01, 30)),
        Effect("f:x^3", "stiffness", (0.01, 60)),
        Effect("f:x|x|", "stiffness", (0.01, 30)),
        Effect("f:v|v|", "damping", (3e-3, 5), (-1,)),
        Effect("f:x^2*v", "damping", (0.01, 30)),
        Effect("f:x*v", "damping", (0.01, 10)),
        Effect("f:sign(v)", "friction", (1e-3, 1), (-1,)),
        Effect("f:u|u|", "control", (0.01, 1)),
        Effect("u:delay", "control", late, (1,)),
        Effect("u:lag", "control", (8e-3, 0.4), (1,)),
        Effect("u:deadband", "control", (1e-3, 1), (1,)),
        Effect("u:saturation", "control", (0.3, 3), (1,)),
        Effect("f:lag_x", "unmodelled state", (0.01, 5), shapes={"tau": (0.1, 1.0)}),
        Effect("f:lag_v", "unmodelled state", (0.01, 3), shapes={"tau": (0.1, 1.0)}),
        Effect("f:periodic", "disturbance", (1e-3, 1), (1,), wave),
    ]
    sensor = {
        "x:scale": (1e-3, 0.3), "v:scale": (1e-3, 0.3), "v:bias": (1e-3, 0.3), "x:drift": (1e-5, 0.02),
        "a:drift": (1e-4, 0.1), "v:drift": (1e-5, 0.02), "a:v": (5e-3, 1), "v:x": (5e-3, 1),
    }  # fmt: skip
    found += [Effect(name, "sensor", span) for name, span in sensor.items()]
    return found + [Effect(f"{name}:delay", "sensor", late, (1,)) for name in ("x", "v", "a")]


DUFFING = System(
    name="duffing",
    states={"x": "m", "v": "m/s"},
    inputs={"u": "N"},
    outputs={"x": "m", "v": "m/s", "a": "m/s²"},
    derivatives={"k": 9.0, "d": 0.7, "b": 1.0},
    biases={"f0": 0.2, "b_a": 0.1},
    quantities=quantities,
    dynamics=dynamics,
    measured=measured,
    sigma={"x": 0.015, "v": 0.05, "a": 0.2},
    step=0.05,
    samples=601,
    amplitudes={"u": (1.5, 3.5)},
    pulse=(0.4, 1.2),
    wander={"x": 0.1, "v": 0.3},
    limits={"x": 1.2, "v": 4.0},
    effects=_effects(),
    steep={"v": 0.01},
    substeps=2,
)
