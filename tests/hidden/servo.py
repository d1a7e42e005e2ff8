"""A servo motor: angle and rate, driven by a voltage; its base model knows viscous damping and an offset only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .effect import Effect
from .system import System

__all__ = ["SERVO"]


def quantities(x: Sequence[Any], u: Sequence[Any], p: Mapping[str, Any]) -> dict[str, Any]:
    """Torque per inertia."""
    return {"torque": p["m0"] - p["d"] * x[1] + p["b"] * u[0]}


def dynamics(x: Sequence[Any], u: Sequence[Any], q: Mapping[str, Any], p: Mapping[str, Any]) -> list[Any]:
    """angle', rate'."""
    return [x[1], q["torque"]]


def measured(x: Sequence[Any], u: Sequence[Any], q: Mapping[str, Any], p: Mapping[str, Any]) -> dict[str, Any]:
    """Angle (encoder) and rate (tachometer)."""
    return {"angle": x[0], "rate": x[1] + p["b_rate"]}


def _effects() -> list[Effect]:
    wave = {"frequency": (0.3, 6.0), "phase": (0, 2 * np.pi)}
    late = (1e-3, 0.1)
    found = [
        Effect("torque:sign(rate)", "friction", (0.02, 30), (-1,)),
        Effect("torque:rate|rate|", "damping", (3e-3, 3), (-1,)),
        Effect("torque:angle^2", "stiffness", (5e-4, 30)),
        Effect("torque:angle", "stiffness", (5e-4, 30), (-1,)),
        Effect("torque:angle^3", "stiffness", (1e-5, 60), (-1,)),
        Effect("torque:volts|volts|", "control", (0.01, 6)),
        Effect("volts:delay", "control", late, (1,)),
        Effect("volts:lag", "control", (3e-3, 0.2), (1,)),
        Effect("volts:deadband", "control", (1e-3, 1.5), (1,)),
        Effect("volts:saturation", "control", (0.5, 5), (1,)),
        Effect("torque:lag_rate", "unmodelled state", (0.02, 20), shapes={"tau": (0.04, 0.4)}),
        Effect("torque:periodic", "disturbance", (0.05, 20), (1,), wave),
    ]
    sensor = {
        "angle:scale": (1e-3, 0.3), "rate:scale": (1e-3, 0.3), "rate:drift": (1e-4, 0.2),
        "rate:angle": (2e-3, 2),
    }  # fmt: skip
    found += [Effect(name, "sensor", span) for name, span in sensor.items()]
    return found + [Effect(f"{name}:delay", "sensor", late, (1,)) for name in ("angle", "rate")]


SERVO = System(
    name="servo",
    states={"angle": "rad", "rate": "rad/s"},
    inputs={"volts": "V"},
    outputs={"angle": "rad", "rate": "rad/s"},
    derivatives={"d": 6.0, "b": 15.0},
    biases={"m0": 0.1, "b_rate": 0.02},
    quantities=quantities,
    dynamics=dynamics,
    measured=measured,
    sigma={"angle": 0.015, "rate": 0.1},
    step=0.02,
    samples=601,
    amplitudes={"volts": (1.5, 4.0)},
    pulse=(0.2, 0.6),
    wander={"angle": 0.2, "rate": 0.5},
    limits={"angle": 12.0, "rate": 25.0},
    effects=_effects(),
    steep={"rate": 0.05},
    substeps=2,
)
