"""Kinematics of a rigid body, as equations of a model; what is zero is left out, so that they stay short."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from .._core import Expr
from ..modelling.model import Model
from ..symbols import cos, sin, tan

__all__ = ["Vector", "cross", "in_plane", "in_space", "plus", "rotation"]

Vector: TypeAlias = tuple[Any, Any, Any]


def in_plane(m: Model, s: Mapping[str, Any], a: Mapping[str, Any], q: Any, gravity: float) -> Vector:
    """Gives the equations of motion with wings level; returns the body's speeds through the air, along its axes.

    ``s``: states; ``a``: specific forces at the centre of gravity, by ``ax_true``, ...
    """
    V, alpha, theta = s["V"], s["alpha"], s["theta"]
    Fx, Fz = m.quantities(Fx=a["ax_true"] - gravity * sin(theta), Fz=a["az_true"] + gravity * cos(theta))
    m.dynamics(
        V=Fx * cos(alpha) + Fz * sin(alpha),
        alpha=q + (Fz * cos(alpha) - Fx * sin(alpha)) / V,
        theta=q,
    )
    if "h" in s:
        m.dynamics(h=V * sin(theta - alpha))
    return (V * cos(alpha), 0.0, V * sin(alpha))


def in_space(
    m: Model,
    s: dict[str, Any],
    a: Mapping[str, Any],
    rates: Vector,
    gravity: float,
    air: dict[str, Expr],
) -> Vector:
    """The same in six degrees of freedom; adds speeds over ground to ``s``. ``air``: components of the wind."""
    V, alpha, beta, phi, theta = (s[n] for n in ("V", "alpha", "beta", "phi", "theta"))
    p, q, r = rates
    Fx, Fy, Fz = m.quantities(
        Fx=a["ax_true"] - gravity * sin(theta),
        Fy=a["ay_true"] + gravity * cos(theta) * sin(phi),
        Fz=a["az_true"] + gravity * cos(theta) * cos(phi),
    )
    m.dynamics(
        V=Fx * cos(alpha) * cos(beta) + Fy * sin(beta) + Fz * sin(alpha) * cos(beta),
        alpha=q - tan(beta) * (p * cos(alpha) + r * sin(alpha)) + (Fz * cos(alpha) - Fx * sin(alpha)) / (V * cos(beta)),
        beta=p * sin(alpha) - r * cos(alpha) + (Fy * cos(beta) - (Fx * cos(alpha) + Fz * sin(alpha)) * sin(beta)) / V,
        phi=p + tan(theta) * (q * sin(phi) + r * cos(phi)),
        theta=q * cos(phi) - r * sin(phi),
    )
    if "psi" in s:
        m.dynamics(psi=(q * sin(phi) + r * cos(phi)) / cos(theta))
    body = (V * cos(alpha) * cos(beta), V * sin(beta), V * sin(alpha) * cos(beta))
    over = _over_ground(body, phi, theta, s.get("psi"), air)
    for state, speed, sign in (("h", "down", -1.0), ("north", "north", 1.0), ("east", "east", 1.0)):
        if state in s:
            m.dynamics(**{state: sign * over[speed]})
    s |= {f"v_{n}": v for n, v in over.items()}
    return body


def rotation(arm: tuple[float, float, float], rates: Vector, turning: Vector) -> Vector:
    """Acceleration that rotation adds at a place off the centre of gravity."""
    of_turning, inwards = cross(turning, arm), cross(rates, cross(rates, arm))
    return tuple(plus(a, b) for a, b in zip(of_turning, inwards, strict=True))


def _nothing(x: Any) -> bool:
    return isinstance(x, float) and x == 0.0


def plus(x: Any, y: Any) -> Any:
    return x if _nothing(y) else y if _nothing(x) else x + y


def cross(a: Vector, b: Vector) -> Vector:
    """The vector product; what is zero is left out, so that equations stay short."""

    def product(x: Any, y: Any) -> Any:
        return 0.0 if _nothing(x) or _nothing(y) else x * y

    def minus(x: Any, y: Any) -> Any:
        return x if _nothing(y) else -y if _nothing(x) else x - y

    return tuple(minus(product(a[i], b[j]), product(a[j], b[i])) for i, j in ((1, 2), (2, 0), (0, 1)))


def _over_ground(body: Vector, phi: Expr, theta: Expr, psi: Expr | None, air: dict[str, Expr]) -> dict[str, Any]:
    """Speeds over ground: of the body through the air, and of the air."""
    u, v, w = body
    down = -u * sin(theta) + (v * sin(phi) + w * cos(phi)) * cos(theta)
    found = {"down": down - air["up"] if "up" in air else down}
    if psi is not None:
        level = u * cos(theta) + (v * sin(phi) + w * cos(phi)) * sin(theta)
        side = v * cos(phi) - w * sin(phi)
        north, east = level * cos(psi) - side * sin(psi), level * sin(psi) + side * cos(psi)
        found["north"] = north + air["north"] if "north" in air else north
        found["east"] = east + air["east"] if "east" in air else east
    return found
