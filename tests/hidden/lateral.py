"""Lateral-directional motion of a business jet about straight and level flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .effect import Effect
from .system import System

__all__ = ["LATERAL"]

G0, SPEED, ALPHA = 9.80665, 110.0, 0.08  # m/s², m/s, rad
HALF_SPAN = 14.5 / (2 * SPEED)  # s
SIDE, ROLL, YAW = 19.3, 78.0, 30.0  # dynamic pressure times area over mass, m/s²; times span over inertia, 1/s²


def quantities(x: Sequence[Any], u: Sequence[Any], p: Mapping[str, Any]) -> dict[str, Any]:
    """Side-force, rolling- and yawing-moment coefficients."""
    beta, roll, yaw = x[0], HALF_SPAN * x[1], HALF_SPAN * x[2]
    da, dr = u
    return {
        "CY": p["CYb"] * beta + p["CYr"] * yaw + p["CYdr"] * dr,
        "Cl": p["Clb"] * beta + p["Clp"] * roll + p["Clr"] * yaw + p["Clda"] * da + p["Cldr"] * dr,
        "Cn": p["Cnb"] * beta + p["Cnp"] * roll + p["Cnr"] * yaw + p["Cnda"] * da + p["Cndr"] * dr,
    }


def dynamics(x: Sequence[Any], u: Sequence[Any], c: Mapping[str, Any], p: Mapping[str, Any]) -> list[Any]:
    """beta', p', r', phi'."""
    _, roll, yaw, phi = x
    side = SIDE / SPEED * c["CY"] + G0 / SPEED * np.cos(ALPHA) * np.sin(phi)
    return [
        side + np.sin(ALPHA) * roll - np.cos(ALPHA) * yaw,
        ROLL * c["Cl"],
        YAW * c["Cn"],
        roll + np.tan(ALPHA) * np.cos(phi) * yaw,
    ]


def measured(x: Sequence[Any], u: Sequence[Any], c: Mapping[str, Any], p: Mapping[str, Any]) -> dict[str, Any]:
    """Sideslip, rates, bank angle and lateral acceleration."""
    return {"beta": x[0], "p": x[1] + p["b_p"], "r": x[2] + p["b_r"], "phi": x[3], "ay": SIDE * c["CY"] + p["b_ay"]}


def _effects() -> list[Effect]:
    aerodynamic = {
        "Cl:beta^3": (0.03, 60), "Cn:beta^3": (0.02, 60), "CY:beta^3": (1, 400), "Cn:beta|beta|": (2e-3, 5),
        "CY:beta|beta|": (0.1, 40), "Cn:beta^2": (1e-3, 5), "Cl:beta^2": (1e-3, 5), "CY:p": (2e-3, 2),
        "CY:da": (2e-3, 1), "Cl:da|da|": (0.02, 5), "Cn:dr|dr|": (0.02, 5), "Cn:beta*dr": (5e-3, 10),
        "Cl:p|p|": (3e-4, 1), "Cn:beta*p": (1e-3, 5), "Cn:r|r|": (2e-3, 10), "Cl:p*r": (1e-3, 5),
    }  # fmt: skip
    late, lag, tau = (2e-3, 0.3), (5e-3, 0.5), {"tau": (0.1, 0.8)}
    found = [Effect(name, "aerodynamic", span) for name, span in aerodynamic.items()]
    for name in ("da", "dr"):
        found += [
            Effect(f"{name}:delay", "control", late, (1,)),
            Effect(f"{name}:lag", "control", lag, (1,)),
            Effect(f"{name}:deadband", "control", (1e-4, 0.06), (1,)),
            Effect(f"{name}:saturation", "control", (0.01, 0.15), (1,)),
            Effect(f"{name}:bias", "control", (1e-4, 0.05)),
        ]
    found += [
        Effect(name, "unmodelled state", span, shapes=tau)
        for name, span in {"Cn:lag_beta": (5e-4, 0.5), "CY:lag_beta": (0.02, 3), "Cl:lag_beta": (5e-4, 0.5)}.items()
    ]
    sensor = {
        "beta:scale": (3e-3, 0.4), "p:scale": (3e-3, 0.4), "r:scale": (3e-3, 0.4), "phi:scale": (3e-3, 0.4),
        "beta:drift": (1e-5, 5e-3), "phi:drift": (1e-5, 5e-3), "p:drift": (1e-5, 2e-3), "ay:drift": (1e-4, 0.05),
        "beta:bias": (1e-4, 0.05), "phi:bias": (1e-4, 0.1), "beta:p": (1e-3, 0.3), "beta:r": (2e-3, 0.5),
        "p:r": (3e-3, 0.4), "r:p": (3e-3, 0.4), "ay:p": (5e-3, 3), "ay:p^2": (0.05, 15),
    }  # fmt: skip
    found += [Effect(name, "sensor", span) for name, span in sensor.items()]
    found += [Effect(f"{name}:delay", "sensor", late, (1,)) for name in ("beta", "p", "r", "phi", "ay")]
    wave = {"frequency": (0.1, 2.0), "phase": (0, 2 * np.pi)}
    spans = {"Cn:periodic": (1e-5, 0.02), "Cl:periodic": (1e-5, 0.02), "CY:periodic": (1e-4, 0.1)}
    return found + [Effect(name, "disturbance", span, (1,), wave) for name, span in spans.items()]


LATERAL = System(
    name="lateral",
    states={"beta": "rad", "p": "rad/s", "r": "rad/s", "phi": "rad"},
    inputs={"da": "rad", "dr": "rad"},
    outputs={"beta": "rad", "p": "rad/s", "r": "rad/s", "phi": "rad", "ay": "m/s²"},
    derivatives={
        "CYb": -0.85, "CYr": 0.4, "CYdr": 0.2, "Clb": -0.09, "Clp": -0.45, "Clr": 0.14, "Clda": -0.12, "Cldr": 0.012,
        "Cnb": 0.11, "Cnp": -0.05, "Cnr": -0.18, "Cnda": 0.006, "Cndr": -0.08,
    },
    biases={"b_p": 2e-3, "b_r": 2e-3, "b_ay": 0.02},
    quantities=quantities,
    dynamics=dynamics,
    measured=measured,
    sigma={"beta": 2e-3, "p": 3e-3, "r": 2e-3, "phi": 3e-3, "ay": 0.05},
    step=0.05,
    samples=601,
    amplitudes={"da": (0.03, 0.1), "dr": (0.03, 0.1)},
    pulse=(0.5, 1.5),
    wander={"beta": 0.01, "p": 0.02, "r": 0.01, "phi": 0.05},
    limits={"beta": 0.2, "p": 0.7, "r": 0.4, "phi": 0.9},
    effects=_effects(),
    needed=("dr",),
)  # fmt: skip
