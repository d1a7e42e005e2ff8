"""Longitudinal motion like the HFB-320's, as in examples/hfb320.py, with less noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import root

from .effect import Effect
from .system import System

__all__ = ["HFB320"]

G0, RHO, MASS = 9.80665, 0.792, 7472.0  # m/s², kg/m³, kg
S_M, SC_IY, LT_IY = 4.028e-3, 8.0027e-4, -7.0153e-6  # m²/kg, m/kg, 1/(kg m)
V_REF, HALF_CHORD, EPS_T = 104.67, 1.215, 0.0524  # m/s, m, rad


def quantities(x: Sequence[Any], u: Sequence[Any], p: Mapping[str, Any]) -> dict[str, Any]:
    """Lift, drag and pitching-moment coefficients."""
    V, alpha, _, q = x
    dV = V / V_REF - 1
    pitch = p["Cm0"] + p["CmV"] * dV + p["Cma"] * alpha + p["Cmq"] * (HALF_CHORD / V_REF) * q + p["Cmde"] * u[0]
    return {
        "CL": p["CL0"] + p["CLV"] * dV + p["CLa"] * alpha,
        "CD": p["CD0"] + p["CDV"] * dV + p["CDa"] * alpha,
        "Cm": pitch,
    }


def dynamics(x: Sequence[Any], u: Sequence[Any], c: Mapping[str, Any], p: Mapping[str, Any]) -> list[Any]:
    """V', alpha', theta', q'."""
    V, alpha, theta, q = x
    thrust, pressure = u[1], 0.5 * RHO * V * V
    lift = -S_M * pressure / V * c["CL"]
    return [
        -S_M * pressure * c["CD"] + thrust / MASS * np.cos(alpha + EPS_T) - G0 * np.sin(theta - alpha),
        lift + (G0 * np.cos(theta - alpha) - thrust / MASS * np.sin(alpha + EPS_T)) / V + q,
        q,
        SC_IY * pressure * c["Cm"] + LT_IY * thrust,
    ]


def measured(x: Sequence[Any], u: Sequence[Any], c: Mapping[str, Any], p: Mapping[str, Any]) -> dict[str, Any]:
    """The seven outputs."""
    V, alpha, theta, q = x
    specific, thrust = S_M * 0.5 * RHO * V * V, u[1] / MASS
    sin, cos = np.sin(alpha), np.cos(alpha)
    return {
        "V": V,
        "alpha": alpha,
        "theta": theta,
        "q": q + p["b_q"],
        "aq": SC_IY * 0.5 * RHO * V * V * c["Cm"] + LT_IY * u[1] + p["b_aq"],
        "ax": specific * (c["CL"] * sin - c["CD"] * cos) + thrust * np.cos(EPS_T) + p["b_ax"],
        "az": -specific * (c["CL"] * cos + c["CD"] * sin) - thrust * np.sin(EPS_T) + p["b_az"],
    }


def trim(p: dict[str, float], rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """Steady flight at a drawn speed, along a path inclined by up to 2 degrees."""
    V, path = rng.uniform(99, 112), rng.uniform(-0.035, 0.035)

    def unsteady(z: np.ndarray) -> list[Any]:
        x, u = (V, z[0], z[0] + path, 0.0), (z[1], 1e4 * z[2])
        f = dynamics(x, u, quantities(x, u, p), p)
        return [f[0], f[1], f[3]]

    alpha, de, thrust = root(unsteady, [0.1, -0.01, 1.1]).x.tolist()
    return {"V": V, "alpha": alpha, "theta": alpha + path, "q": 0.0}, {"de": de, "T": 1e4 * thrust}


def _effects() -> list[Effect]:
    aerodynamic = {
        "CL:alpha^2": (0.05, 20), "CL:alpha^3": (0.5, 400), "CD:alpha^2": (0.02, 10), "Cm:alpha^2": (0.02, 10),
        "Cm:alpha^3": (0.2, 150), "Cm:alpha*q": (0.02, 20), "Cm:de^2": (0.1, 30), "Cm:de|de|": (0.1, 40),
        "Cm:q|q|": (0.02, 10), "Cm:alpha*de": (0.1, 40), "CL:q": (0.002, 1), "CL:de": (0.01, 3), "CD:de": (0.01, 3),
        "CD:de^2": (0.2, 60), "CL:V*alpha": (1e-4, 0.2), "CD:q": (0.002, 1),
    }  # fmt: skip
    late, lag = (0.003, 0.4), (0.01, 0.6)
    found = [Effect(name, "aerodynamic", span) for name, span in aerodynamic.items()]
    found += [
        Effect("de:delay", "control", late, (1,)),
        Effect("de:lag", "control", lag, (1,)),
        Effect("de:deadband", "control", (5e-5, 0.01), (1,)),
        Effect("de:saturation", "control", (3e-3, 0.03), (1,)),
        Effect("T:scale", "control", (0.005, 0.3)),
        Effect("T:lag", "control", (0.02, 3), (1,)),
    ]
    tau = {"tau": (0.15, 1.0)}
    found += [
        Effect(name, "unmodelled state", span, shapes=tau)
        for name, span in {"CL:lag_alpha": (0.05, 5), "Cm:lag_alpha": (0.01, 2), "CL:lag_de": (0.05, 5)}.items()
    ]
    sensor = {
        "alpha:scale": (0.003, 0.4), "q:scale": (0.003, 0.4), "theta:scale": (0.003, 0.4), "V:scale": (0.003, 0.4),
        "alpha:drift": (1e-6, 2e-3), "theta:drift": (1e-6, 2e-3), "V:drift": (1e-4, 0.2), "q:drift": (1e-6, 1e-3),
        "ax:drift": (1e-5, 0.02), "alpha:bias": (1e-4, 0.05), "theta:bias": (1e-4, 0.05), "alpha:q": (2e-3, 1),
        "ax:q^2": (0.2, 15), "az:q": (0.02, 5),
    }  # fmt: skip
    found += [Effect(name, "sensor", span) for name, span in sensor.items()]
    found += [Effect(f"{name}:delay", "sensor", late, (1,)) for name in ("V", "alpha", "theta", "q", "az")]
    wave = {"frequency": (0.08, 1.5), "phase": (0, 2 * np.pi)}
    spans = {"Cm:periodic": (1e-5, 0.02), "CL:periodic": (1e-4, 0.1), "CD:periodic": (1e-4, 0.05)}
    return found + [Effect(name, "disturbance", span, (1,), wave) for name, span in spans.items()]


HFB320 = System(
    name="hfb320",
    states={"V": "m/s", "alpha": "rad", "theta": "rad", "q": "rad/s"},
    inputs={"de": "rad", "T": "N"},
    outputs={"V": "m/s", "alpha": "rad", "theta": "rad", "q": "rad/s", "aq": "rad/s²", "ax": "m/s²", "az": "m/s²"},
    derivatives={
        "CD0": 0.058, "CDV": -0.0316, "CDa": 0.245, "CL0": 0.181, "CLV": 0.201, "CLa": 3.09,
        "Cm0": 0.118, "CmV": 0.0137, "Cma": -0.994, "Cmq": -28.65, "Cmde": -1.471,
    },
    biases={"b_q": 1e-3, "b_aq": 2e-3, "b_ax": 0.1, "b_az": 0.1},
    quantities=quantities,
    dynamics=dynamics,
    measured=measured,
    # Half of that of the flight record, of which most is not noise of the sensors.
    sigma={"V": 0.4, "alpha": 1.1e-3, "theta": 1e-3, "q": 1.2e-3, "aq": 4e-3, "ax": 0.012, "az": 0.1},
    step=0.1,
    samples=601,
    amplitudes={"de": (0.01, 0.025), "T": (800, 2500)},
    pulse=(0.7, 1.6),
    wander={"V": 1.0, "alpha": 5e-3, "theta": 1e-2, "q": 5e-3},
    limits={"V": 15.0, "alpha": 0.08, "theta": 0.3, "q": 0.2},
    effects=_effects(),
    trim=trim,
)  # fmt: skip
