"""Flight-path reconstruction: the kinematics of a rigid body, driven by its accelerometers and gyros."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from .._core import Expr
from ..errors import OptionError, listing
from ..functions import atan2, cos, sin, sqrt, tan
from ..modelling.constant import Constant
from ..modelling.model import Model
from ..parameters import Parameter

__all__ = ["flight_path"]

Vector: TypeAlias = tuple[Any, Any, Any]


def in_plane(m: Model, s: Mapping[str, Any], a: Mapping[str, Any], q: Any, g: Expr) -> Vector:
    """Add the equations of motion with wings level; return the body-axis velocity relative to the air.

    ``s``: states; ``a``: specific forces at the centre of gravity, by ``ax_true``, ...
    """
    V, alpha, theta = s["V"], s["alpha"], s["theta"]
    Fx, Fz = m.quantities(Fx=a["ax_true"] - g * sin(theta), Fz=a["az_true"] + g * cos(theta))
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
    g: Expr,
    air: dict[str, Expr],
) -> Vector:
    """Add the equations in six degrees of freedom, and speeds over ground to ``s``; return the body-axis velocity.
    ``air``: components of the wind."""
    V, alpha, beta, phi, theta = (s[n] for n in ("V", "alpha", "beta", "phi", "theta"))
    p, q, r = rates
    Fx, Fy, Fz = m.quantities(
        Fx=a["ax_true"] - g * sin(theta),
        Fy=a["ay_true"] + g * cos(theta) * sin(phi),
        Fz=a["az_true"] + g * cos(theta) * cos(phi),
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
    """Return the acceleration due to rotation at a point off the centre of gravity."""
    of_turning, inwards = cross(turning, arm), cross(rates, cross(rates, arm))
    return tuple(plus(a, b) for a, b in zip(of_turning, inwards, strict=True))


def _nothing(x: Any) -> bool:
    return isinstance(x, float) and x == 0.0


def plus(x: Any, y: Any) -> Any:
    return x if _nothing(y) else y if _nothing(x) else x + y


def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product; zero terms are left out, so that equations stay short."""

    def product(x: Any, y: Any) -> Any:
        return 0.0 if _nothing(x) or _nothing(y) else x * y

    def minus(x: Any, y: Any) -> Any:
        return x if _nothing(y) else -y if _nothing(x) else x - y

    return tuple(minus(product(a[i], b[j]), product(a[j], b[i])) for i, j in ((1, 2), (2, 0), (0, 1)))


def _over_ground(body: Vector, phi: Expr, theta: Expr, psi: Expr | None, air: dict[str, Expr]) -> dict[str, Any]:
    """Return the speeds over ground: the sum of the velocity relative to the air and the wind."""
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


_UNITS = {
    "V": "m/s", "alpha": "rad", "beta": "rad", "phi": "rad", "theta": "rad", "psi": "rad", "h": "m",
    "north": "m", "east": "m", "v_north": "m/s", "v_east": "m/s", "v_down": "m/s",
}  # fmt: skip
_INERTIAL = {"ax": "m/s²", "ay": "m/s²", "az": "m/s²", "p": "rad/s", "q": "rad/s", "r": "rad/s"}
_GROUND = ("north", "east", "v_north", "v_east")
_LONGITUDINAL = ("V", "alpha", "theta", "h")
_LONGITUDINAL_INPUTS = ("ax", "az", "q")
_FAR = 100.0  # m
_LATE = 2.0  # s; pneumatic lines of small aircraft may take a second


def flight_path(
    outputs: str | Sequence[str] = ("V", "alpha", "beta", "phi", "theta"),
    *,
    longitudinal: bool = False,
    biases: Collection[str] | None = None,
    scales: Collection[str] | None = None,
    delayed: Collection[str] = (),
    accelerometer: Sequence[float] | None = None,
    alpha_vane: Sequence[float | None] | None = None,
    beta_vane: Sequence[float | None] | None = None,
    flank: bool = False,
    wind: Collection[str] | None = None,
    per_experiment: Collection[str] = (),
    gravity: float = 9.80665,
    name: str = "flight path",
    late: Collection[str] | None = None,
) -> Model:
    """Return a model of the kinematic equations alone: whatever the aerodynamics, the sensors of a flight must be
    consistent.

    States are V (true airspeed, m/s), alpha, beta, phi, theta, and where outputs need them psi (all rad), h (m,
    upwards), north and east (m). Inputs are what accelerometers and gyros read: specific forces ax, ay, az (m/s², along
    the body's axes; at rest az = -9.81) and rates p, q, r (rad/s). With F = a + gravity in body axes,

        V'     = Fx cos(alpha) cos(beta) + Fy sin(beta) + Fz sin(alpha) cos(beta)
        alpha' = q - tan(beta) (p cos(alpha) + r sin(alpha)) + (Fz cos(alpha) - Fx sin(alpha))/(V cos(beta))
        beta'  = p sin(alpha) - r cos(alpha) + (Fy cos(beta) - (Fx cos(alpha) + Fz sin(alpha)) sin(beta))/V

    and the usual equations of Euler's angles and of the position. Wind is steady: it moves the air, and so the position
    over ground alone. (Klein and Morelli, Aircraft System Identification, 2006, ch. 10; Jategaonkar, Flight Vehicle
    System Identification, 2015, ch. 10.)

    outputs        which of these the record has: V (always), alpha, beta, phi, theta, psi, h, north, east, v_north,
                   v_east, v_down (speeds over ground, m/s). psi must not jump at ±180 deg: see `phugoid.reconstruct`,
                   which unwraps it, or numpy.unwrap.
    longitudinal   V, alpha, theta (and h) only, inputs ax, az, q: wings level, no sideslip.
    biases         channels, inputs or outputs, with a bias ``b_<channel>``: measured = true + b. Unless given, those
                   inertial sensors whose bias the outputs determine: ax by V, ay by beta, az by alpha or h, p by phi,
                   q by theta, r by psi; and alpha where h or v_down gives the flight path. In steady flight biases of
                   one axis look alike (b_ay and b_r; b_ax and an error of theta): manoeuvres separate them, standard
                   errors show how well.
    scales         channels with a scale factor ``K_<channel>``: measured = K true + b. Unless given alpha and beta,
                   where they are outputs: the fuselage deflects the air at vanes and probes.
    delayed        outputs that are measured with a delay, ``tau_<output>`` (s, 0 to 2). `estimate` needs ``start={"V":
                   ...}`` where V is among them.
    accelerometer  (x, y, z) of the accelerometers from the centre of gravity (m; forward, right, down). Then the
                   angular accelerations are inputs too: pdot, qdot, rdot (rad/s²).
    alpha_vane, beta_vane  (x, y, z) of the vanes from the centre of gravity (m; forward, right, down): they measure the
                   local flow, which rotation changes. A vane ahead of the centre of gravity by x looks much like one
                   that is delayed by x/V: give its position before estimating its delay. A coordinate that is None is
                   estimated: ``(None, 0, 0)`` gives the parameter ``x_alpha_vane`` (m, -100 to 100).
    flank          the sideslip sensor reads the flank angle atan(v/u), as a vane does; else asin(v/V).
    wind           of "north", "east", "up" the components ``wind_<which>`` (m/s, where the air goes to) that are
                   estimated, each experiment its own. Unless given north and east, where an output is over ground.
    per_experiment biases with a value for each experiment, by channel.
    gravity        m/s².

    Noise of the inertial sensors is neglected: it enters the states, as process noise would, and colours the residuals.
    Raises OptionError for unknown channels, or options that contradict each other.

    >>> print(flight_path("V alpha theta", longitudinal=True, scales=()))
    flight path
      q_true = q - b_q
      ax_true = ax - b_ax
      az_true = az - b_az
      Fx = ax_true - g*sin(theta)
      Fz = az_true + g*cos(theta)
      V' = Fx*cos(alpha) + Fz*sin(alpha)
      alpha' = q_true + (Fz*cos(alpha) - Fx*sin(alpha))/V
      theta' = q_true
      V (measured) = V
      alpha (measured) = alpha
      theta (measured) = theta
      g = 9.80665 m/s² (acceleration of gravity)
    """
    measured = _names("outputs", outputs)
    allowed = _LONGITUDINAL if longitudinal else tuple(_UNITS)
    for n in measured:
        if n not in allowed:
            raise OptionError(f"flight_path: '{n}' is not an output of it.{listing(n, allowed)}")
    if "V" not in measured:
        raise OptionError("flight_path: V, the true airspeed, must be among the outputs: all depends on it")
    if longitudinal and (flank or beta_vane is not None or wind):
        raise OptionError("flight_path: flank, beta_vane and wind are for the motion in six degrees of freedom")
    inertial = _LONGITUDINAL_INPUTS if longitudinal else tuple(_INERTIAL)
    known = {*inertial, *measured}
    biased = _chosen("biases", biases, _observable_biases(measured, inertial), known)
    scaled = _chosen("scales", scales, {"alpha", "beta"}.intersection(measured), known)
    own = _chosen("per_experiment", per_experiment, set(), biased)
    if late is not None:
        warnings.warn("the option late of flight_path is now delayed", DeprecationWarning, stacklevel=2)
        delayed = late
    lagging = _chosen("delayed", delayed, set(), set(measured))
    ground = [n for n in measured if n in _GROUND]
    blowing = _winds(wind, bool(ground), measured)

    m = Model(name)
    needed = ["V", "alpha", *([] if longitudinal else ["beta", "phi"]), "theta"]
    needed += ["psi"] if "psi" in measured or ground else []
    needed += [n for n in ("h", "north", "east") if n in measured]
    s = dict(zip(needed, m.states(**{n: _UNITS[n] for n in needed}), strict=True))
    u = dict(zip(inertial, m.inputs(**{n: _INERTIAL[n] for n in inertial}), strict=True))
    arm = _arm("accelerometer", accelerometer)
    turning: Vector = (0.0, 0.0, 0.0)
    if arm is not None:
        names = ("qdot",) if longitudinal else ("pdot", "qdot", "rdot")
        found = m.inputs(**dict.fromkeys(names, "rad/s²"))
        turning = (0.0, found[0], 0.0) if longitudinal else (found[0], found[1], found[2])

    def unit(channel: str) -> str:
        return _INERTIAL[channel] if channel in _INERTIAL else _UNITS[channel]

    # By channel, since the letters q and p are inputs, and alpha may be both state and output.
    b = {
        c: m.parameters(**{f"b_{c}": Parameter(unit=unit(c), per_experiment=c in own)})[0]
        for c in (*inertial, *measured)
        if c in biased
    }
    K = {
        c: m.parameters(**{f"K_{c}": Parameter(1.0, bounds=(0.2, 5.0))})[0]
        for c in (*inertial, *measured)
        if c in scaled
    }
    air = {c: m.parameters(**{f"wind_{c}": Parameter(unit="m/s", per_experiment=True)})[0] for c in blowing}

    def read(channel: str, true: Any) -> Any:
        """Return the expression of what a sensor reads for a true value."""
        value = K[channel] * true if channel in K else true
        return value + b[channel] if channel in b else value

    def true(channel: str) -> Any:
        """Return the expression of the true value of an inertial channel."""
        value = u[channel] - b[channel] if channel in b else u[channel]
        return value / K[channel] if channel in K else value

    rates = {f"{c}_true": true(c) for c in inertial if c in "pqr"}
    turn = dict(zip(rates, m.quantities(**rates), strict=True))
    p, q, r = (turn.get(f"{c}_true", 0.0) for c in "pqr")
    turning_rates: Vector = (p, q, r)
    forces = dict(zip(("ax", "ay", "az"), (true(c) if c in u else 0.0 for c in ("ax", "ay", "az")), strict=True))
    if arm is not None:
        added = rotation(arm, turning_rates, turning)
        forces = {c: forces[c] - more for c, more in zip(forces, added, strict=True)}
    at_cg = {f"{c}_true": forces[c] for c in ("ax", "ay", "az") if c in inertial}
    a = dict(zip(at_cg, m.quantities(**at_cg), strict=True))
    (g,) = m.constants(g=Constant(gravity, "m/s²", "acceleration of gravity"))
    body = in_plane(m, s, a, q, g) if longitudinal else in_space(m, s, a, turning_rates, g, air)
    seen = dict(s)
    for channel, vane in (("alpha", alpha_vane), ("beta", beta_vane)):
        if vane is None and not (channel == "beta" and flank):
            continue
        x, y, z = _place(m, f"{channel}_vane", (0.0, 0.0, 0.0) if vane is None else vane)
        uv, vv, wv = (plus(v, more) for v, more in zip(body, cross(turning_rates, (x, y, z)), strict=True))
        if channel == "alpha":
            seen["alpha"] = atan2(wv, uv)
        else:
            seen["beta"] = atan2(vv, uv if flank else sqrt(uv**2 + wv**2))
    m.outputs(**{n: (read(n, seen[n]), _UNITS[n]) for n in measured})
    for n in measured:
        if n in lagging:
            (tau,) = m.parameters(**{f"tau_{n}": Parameter(0.05, bounds=(0.0, _LATE), unit="s")})
            m.sensor_delay(**{n: tau})
    return m


def _names(what: str, given: str | Collection[str]) -> list[str]:
    names = given.replace(",", " ").split() if isinstance(given, str) else list(given)
    if not all(isinstance(n, str) for n in names) or len(set(names)) < len(names):
        raise OptionError(f"flight_path: {what} holds names of channels, each once, not {given!r}")
    return names


def _chosen(what: str, given: Collection[str] | None, usual: set[str], known: set[str]) -> set[str]:
    if given is None:
        return usual
    names = _names(what, given)
    for n in names:
        if n not in known:
            raise OptionError(f"flight_path: {what}: there is no such channel '{n}'.{listing(n, sorted(known))}")
    return set(names)


def _observable_biases(measured: Collection[str], inertial: Collection[str]) -> set[str]:
    """Return the channels whose bias is observable from the others."""
    path = {"h", "v_down"}.intersection(measured)
    determining = {
        "ax": {"V"}, "ay": {"beta"}, "az": {"alpha", *path}, "p": {"phi"}, "q": {"theta"}, "r": {"psi"},
    }  # fmt: skip
    found = {c for c in inertial if determining[c].intersection(measured)}
    return found | ({"alpha"} if path and "alpha" in measured else set())


def _winds(wind: Collection[str] | None, ground: bool, measured: Collection[str]) -> list[str]:
    if wind is None:
        return ["north", "east"] if ground else []
    names = _names("wind", wind)
    for n in names:
        if n not in ("north", "east", "up"):
            raise OptionError(f"flight_path: wind is of north, east, up, not '{n}'")
    vertical = {"h", "v_down"}.intersection(measured)
    if ({"north", "east"}.intersection(names) and not ground) or ("up" in names and not vertical):
        raise OptionError("flight_path: wind shows only in outputs over ground: position, speed over ground, or height")
    return names


def _place(m: Model, what: str, given: Sequence[float | None]) -> Vector:
    """Return the position of a vane, with a parameter for each coordinate that is None."""
    try:
        unknown = [n for n, v in zip("xyz", given, strict=True) if v is None]
    except (TypeError, ValueError):
        unknown = []
    if not unknown:
        return _arm(what, given) or (0.0, 0.0, 0.0)  # type: ignore[arg-type]
    known = _arm(what, [0.0 if v is None else v for v in given])
    assert known is not None
    declared = {n: Parameter(0.0, bounds=(-_FAR, _FAR), unit="m") for n in unknown}
    found = dict(zip(unknown, m.parameters(**{f"{n}_{what}": p for n, p in declared.items()}), strict=True))
    x, y, z = (found.get(n, v) for n, v in zip("xyz", known, strict=True))
    return x, y, z


def _arm(what: str, given: Sequence[float] | None) -> tuple[float, float, float] | None:
    if given is None:
        return None
    try:
        x, y, z = (float(v) for v in given)
    except (TypeError, ValueError):
        raise OptionError(f"flight_path: {what} is its position (x, y, z) in m, not {given!r}") from None
    if not np.isfinite([x, y, z]).all():
        raise OptionError(f"flight_path: {what} is its position (x, y, z) in m, not {given!r}")
    return x, y, z
