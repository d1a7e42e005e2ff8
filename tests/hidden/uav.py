"""Longitudinal motion of a small unmanned aircraft, all four states, by dimensional derivatives in its equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .effect import Effect
from .system import System

__all__ = ["UAV"]

G0, SPEED = 9.80665, 18.0  # m/s², m/s; u and w are the changes of the velocity's components from trim


def quantities(x: Sequence[Any], u: Sequence[Any], p: Mapping[str, Any]) -> dict[str, Any]:
    """None: effects stand in state equations."""
    return {}


def dynamics(x: Sequence[Any], u: Sequence[Any], c: Mapping[str, Any], p: Mapping[str, Any]) -> list[Any]:
    """u', w', q', theta'."""
    ahead, w, q, theta = x
    de = u[0]
    return [
        p["Xu"] * ahead + p["Xw"] * w - G0 * np.sin(theta),
        p["Zu"] * ahead + p["Zw"] * w + (SPEED + p["Zq"]) * q + p["Zde"] * de,
        p["Mw"] * w + p["Mq"] * q + p["Mde"] * de,
        q,
    ]


def measured(x: Sequence[Any], u: Sequence[Any], c: Mapping[str, Any], p: Mapping[str, Any]) -> dict[str, Any]:
    """Airspeed's change, angle of attack, rate, attitude and normal acceleration."""
    ahead, w, q, theta = x
    force = p["Zu"] * ahead + p["Zw"] * w + p["Zq"] * q + p["Zde"] * u[0]
    return {"V": ahead, "alpha": w / SPEED, "q": q + p["b_q"], "theta": theta, "az": force + p["b_az"]}


def _effects() -> list[Effect]:
    late = (3e-3, 0.3)
    terms = {
        "q':w^2": (0.02, 5), "q':w^3": (0.01, 5), "q':w*q": (0.05, 10), "q':q|q|": (0.05, 30), "q':de|de|": (0.5, 400),
        "u':w^2": (5e-3, 2), "u':de": (0.05, 30), "u':u^2": (2e-3, 1), "w':w^2": (0.01, 5),
        "w':w^3": (5e-3, 5), "u':w*q": (0.01, 3),
    }  # fmt: skip
    found = [Effect(name, "aerodynamic", span) for name, span in terms.items()]
    found += [
        Effect("de:delay", "control", late, (1,)),
        Effect("de:lag", "control", (0.01, 0.5), (1,)),
        Effect("de:deadband", "control", (1e-4, 0.05), (1,)),
        Effect("de:saturation", "control", (0.01, 0.2), (1,)),
        Effect("q':lag_w", "unmodelled state", (0.05, 10), shapes={"tau": (0.08, 0.8)}),
        Effect("w':lag_w", "unmodelled state", (0.1, 10), shapes={"tau": (0.08, 0.8)}),
        Effect("q':periodic", "disturbance", (5e-3, 5), (1,), {"frequency": (0.1, 3.0), "phase": (0, 2 * np.pi)}),
    ]
    sensor = {
        "V:scale": (5e-3, 0.4), "alpha:scale": (5e-3, 0.4), "q:scale": (5e-3, 0.4), "V:drift": (1e-4, 0.1),
        "alpha:drift": (1e-5, 5e-3), "theta:drift": (1e-5, 5e-3), "alpha:q": (2e-3, 0.5), "theta:bias": (1e-4, 0.1),
        "alpha:bias": (1e-4, 0.1), "az:q": (0.01, 5), "az:q^2": (0.05, 5),
    }  # fmt: skip
    found += [Effect(name, "sensor", span) for name, span in sensor.items()]
    return found + [Effect(f"{name}:delay", "sensor", late, (1,)) for name in ("V", "alpha", "q", "theta", "az")]


UAV = System(
    name="uav",
    states={"u": "m/s", "w": "m/s", "q": "rad/s", "theta": "rad"},
    inputs={"de": "rad"},
    outputs={"V": "m/s", "alpha": "rad", "q": "rad/s", "theta": "rad", "az": "m/s²"},
    derivatives={
        "Xu": -0.15, "Xw": 0.5, "Zu": -1.0, "Zw": -5.0, "Zq": -0.8, "Zde": -6.0, "Mw": -2.2, "Mq": -5.0, "Mde": -45.0,
    },
    biases={"b_q": 0.01, "b_az": 0.1},
    quantities=quantities,
    dynamics=dynamics,
    measured=measured,
    sigma={"V": 0.1, "alpha": 3e-3, "q": 0.01, "theta": 3e-3, "az": 0.15},
    step=0.04,
    samples=601,
    amplitudes={"de": (0.05, 0.14)},
    pulse=(0.25, 0.8),
    wander={"u": 0.5, "w": 0.2, "q": 0.05, "theta": 0.03},
    limits={"u": 6.0, "w": 3.5, "q": 2.0, "theta": 0.7},
    effects=_effects(),
    substeps=2,
)  # fmt: skip
