"""Twists by the name of the situation: disturbances, inputs that act otherwise, forces with a memory, other sensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .noises import NOISES, filtered
from .system import System, Vehicle
from .twist import Attached, Twist
from .twisted import STEPS

__all__ = ["DISPLACED", "POSITIONS", "STOPPED", "WINDY", "end_stop", "twist_of"]

DRIVEN = {
    "hfb320": ("V", "alpha", "q"),
    "duffing": ("v",),
    "servo": ("rate",),
    "lateral": ("beta", "p", "r"),
    "uav": ("u", "w", "q"),
}
"""States whose equations hold what a disturbance acts on."""

WINDY = {"hfb320": "alpha", "lateral": "beta"}
"""States that the forces have as they are relative to the air, of systems whose forces are declared quantities."""

POSITIONS = {"servo": ("angle", "rate", "torque")}
"""A position, its rate, and the place of the model where its force stands, of systems that have one that no sensor
measures too."""

STOPPED = {"duffing": ("x", "v"), "servo": ("angle", "rate")}
"""A position that a stop may limit, and its rate."""

MODES = {
    "hfb320": ("q", "Cm"),
    "duffing": ("v", "f"),
    "servo": ("rate", "torque"),
    "lateral": ("r", "Cn"),
    "uav": ("q", ""),
}
"""Say where a flexible part is attached: the state that it moves with, and the quantity in its equation."""

FORCES = {
    ("duffing", "v"): "f", ("servo", "rate"): "torque", ("hfb320", "alpha"): "CL", ("hfb320", "q"): "Cm",
    ("lateral", "beta"): "CY", ("lateral", "p"): "Cl", ("lateral", "r"): "Cn",
}  # fmt: skip
"""Quantities in which the forces and moments of equations stand: sensors that measure these feel what acts there."""

DISPLACED = {
    "hfb320": ("vane", "accelerometer"),
    "lateral": ("vane", "accelerometer", "gyro"),
    "uav": ("vane", "accelerometer"),
}
"""Sensors that may be ahead of the centre of gravity, or turned."""

ARMS = {
    "hfb320": {"vane": 9.0, "accelerometer": 2.0},
    "lateral": {"vane": 8.0, "accelerometer": 2.0},
    "uav": {"vane": 0.6, "accelerometer": 0.2},
}
SPEEDS = {"lateral": 110.0, "uav": 18.0}
"""Distances ahead of the centre of gravity, m, and airspeeds, m/s, of systems without that state."""


def _gust(s: System, rng: np.random.Generator, size: float) -> tuple[Twist, tuple[str, ...], dict[str, float]]:
    which = str(rng.choice(DRIVEN[s.name]))
    i, tau = list(s.states).index(which), rng.uniform(0.2, 0.8)

    def make(seed: int) -> Callable[..., Any]:
        own = np.random.default_rng(seed)
        a = float(np.exp(-s.step / tau))
        w = filtered(own.standard_normal(s.samples), a) * np.sqrt(1 - a * a)
        force = np.zeros(len(s.states))

        def of(x: Any, u: Any, now: float) -> Any:
            force[i] = size * np.interp(now, s.t, w)
            return force

        return of

    return Twist(force=make(int(rng.integers(2**31)))), (f"{which}':noise",), {"gust": size}


def _wind(s: System, rng: np.random.Generator, size: float) -> tuple[Twist, tuple[str, ...], dict[str, float]]:
    """Turbulence of 0.3 to 1 s that the vehicle feels and the sensors of its motion over ground do not."""
    which, tau = WINDY[s.name], rng.uniform(0.3, 1.0)
    a = float(np.exp(-s.step / tau))
    history = filtered(rng.standard_normal(s.samples), a) * np.sqrt(1 - a * a)
    unit = size * 0.15 * s.limits[which] * np.eye(len(s.states))[list(s.states).index(which)]
    return Twist(wind=lambda now: unit * np.interp(now, s.t, history)), (f"{which}':noise",), {"wind": size}


def twist_of(what: str, s: System, vehicle: Vehicle, rng: np.random.Generator, size: float) -> Any:
    """The twist, what may be named, and its sizes; ``size`` 1 is what a record shows plainly."""
    u = str(rng.choice([n for n in s.inputs if n in (s.needed or list(s.inputs)[:1])]))
    k = list(s.inputs).index(u)
    peak = float(np.mean(s.amplitudes[u]))
    if what == "gust":
        # Slopes of states as a manoeuvre has them: a limit within a second or so.
        which = DRIVEN[s.name]
        return _gust(s, rng, size * 0.25 * float(np.mean([s.limits[n] for n in which])))
    if what == "wind":
        return _wind(s, rng, size)
    if what == "noisy input":
        own = np.random.default_rng(int(rng.integers(2**31)))

        def recorded(inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
            return {n: v + (n == u) * 0.05 * size * peak * own.standard_normal(v.size) for n, v in inputs.items()}

        return Twist(recorded=recorded), (f"{u}:noise",), {}
    if what == "drift":
        p = str(rng.choice(list(s.derivatives)))
        value, sign = vehicle.parameters[p], rng.choice([-1, 1])
        part = 0.4 * size * sign

        def drifts(now: float) -> Mapping[str, float]:
            return {p: value * (1 + part * (now / s.t[-1] - 0.5))}

        return Twist(drifts=drifts), (f"{p}:drift",), {p: value * part}
    if what == "backlash":
        width = 0.15 * size * peak

        def play(acting: list[float], memory: dict[str, Any], now: float) -> list[float]:
            last = memory.get("z", acting[k])
            memory["z"] = min(max(last, acting[k] - width), acting[k] + width)
            acting[k] = memory["z"]
            return acting

        return Twist(acts=play), (f"{u}:backlash",), {"width": width}
    if what == "rate limit":
        rate = peak / (1.2 * size * float(np.mean(s.pulse)))

        def limited(acting: list[float], memory: dict[str, Any], now: float) -> list[float]:
            last, then = memory.get("z", acting[k]), memory.get("t", now)
            most = rate * max(now - then, 0.0)
            memory["z"] = last + min(max(acting[k] - last, -most), most)
            memory["t"] = max(now, then)
            acting[k] = memory["z"]
            return acting

        return Twist(acts=limited), (f"{u}:rate_limit",), {"rate": rate}
    if what == "event":
        which = str(rng.choice(DRIVEN[s.name]))
        i, begin, width = list(s.states).index(which), rng.uniform(0.2, 0.8) * s.t[-1], rng.uniform(1, 3) * s.pulse[0]
        much = size * 0.5 * s.limits[which] / width * rng.choice([-1, 1])
        force = np.zeros(len(s.states))

        def once(x: Any, acting: Any, now: float) -> Any:
            force[i] = much * (begin <= now < begin + width)
            return force

        return Twist(force=once), (f"{which}':event",), {"time": begin}
    if what == "held input":
        # All inputs are held: what is said of any of them is right.
        return Twist(held=True), tuple(f"{n}:{what}" for n in s.inputs for what in ("hold", "delay")), {}
    if what == "mode":
        return _mode(s, rng, size)
    if what == "displaced":
        return _displaced(s, rng, size)
    if what == "outside":
        which = str(rng.choice(DRIVEN[s.name]))
        i, span = list(s.states).index(which), s.limits[which]
        much = size * 1.5 * span / float(np.mean(s.pulse))
        force = np.zeros(len(s.states))

        def odd(x: Any, acting: Any, now: float) -> Any:
            d = (x[i] - vehicle.states[which]) / span
            force[i] = -much * (np.exp(-((d - 0.3) ** 2) / 0.02) * 0.3)
            return force

        place = FORCES.get((s.name, which))
        return Twist(force=odd, place=(i, place) if place else None), (), {}
    if what == "hysteresis":
        x, v, place = POSITIONS[s.name]
        much = size * 0.4 * s.limits[v] / float(np.mean(s.pulse))
        width = rng.uniform(0.05, 0.2) * s.limits[x]
        i, force = list(s.states).index(v), _yielding(s, x, width)
        unit = np.eye(len(s.states))[i]
        truth = (f"{place}:hysteresis_{x}",)
        return Twist(force=lambda z, acting, now: -much * force(z, now) * unit), truth, {"yield": width}
    if what == "friction":
        _, v, place = POSITIONS[s.name]
        i, span = list(s.states).index(v), 0.005 * s.limits[v]
        dry = 0.2 * size * vehicle.parameters["b"] * peak
        levels = dry, dry * float(rng.uniform(0.4, 0.7))  # one direction, and the other
        unit = np.eye(len(s.states))[i]

        def rubs(z: Any, acting: Any, now: float) -> Any:
            return -levels[int(z[i] < 0.0)] * np.tanh(z[i] / span) * unit

        return Twist(force=rubs), (f"{place}:sign({v})",), {"friction": 0.5 * sum(levels)}
    if what == "closed loop":
        return Twist(control=_feedback(s, vehicle)), (), {}
    return Twist(noise=what if what in NOISES else "white"), (), {}


def _yielding(s: System, x: str, width: float) -> Callable[[Any, float], float]:
    """A force of unit size that follows a state elastically and yields (Bouc and Wen), by its exact steps."""
    i, memory = list(s.states).index(x), {"x": np.nan, "z": 0.0, "t": -np.inf}

    def follows(z: Any, now: float) -> float:
        if now == 0.0 or np.isnan(memory["x"]):
            memory.update(x=float(z[i]), z=0.0, t=now)
        step = (float(z[i]) - memory["x"]) / width
        side, left, it = np.sign(step), abs(step), memory["z"]
        if it * side < 0.0:
            back = min(left, -it * side)
            it, left = it + side * back, left - back
        it = side - (side - it) * float(np.exp(-left)) if left else it
        if now >= memory["t"] + 0.99 * s.step / STEPS:  # the first stage of a new step
            memory.update(x=float(z[i]), z=it, t=now)
        return it

    return follows


def _feedback(s: System, vehicle: Vehicle) -> Callable[..., Any]:
    """Proportional feedback of a rate to the first input, as a stability augmentation has it."""
    rate = {"hfb320": "q", "duffing": "v", "servo": "rate", "lateral": "r", "uav": "q"}[s.name]
    u = (list(s.needed) or list(s.inputs))[0]
    gain = 0.5 * float(np.mean(s.amplitudes[u])) / s.limits[rate]
    sign = {"hfb320": 1.0, "duffing": -1.0, "servo": -1.0, "lateral": 1.0, "uav": 1.0}[s.name]
    return lambda now, measured: {u: sign * gain * measured[rate]}


def _mode(s: System, rng: np.random.Generator, size: float) -> tuple[Twist, tuple[str, ...], dict[str, float]]:
    """A flexible part with 5 to 10 samples in a period and 1 to 4 % of critical damping."""
    which, place = MODES[s.name]
    frequency = float(rng.uniform(0.6, 1.3)) / s.step
    damping, mass = float(rng.uniform(0.01, 0.04)), size * float(rng.uniform(0.1, 0.3))
    part = Attached(list(s.states).index(which), place, frequency, damping, mass)
    return Twist(attached=part), (f"{place or which + chr(39)}:mode",), {"frequency": frequency, "damping": damping}


def _displaced(s: System, rng: np.random.Generator, size: float) -> tuple[Twist, tuple[str, ...], dict[str, float]]:
    """A vane or an accelerometer ahead of the centre of gravity, or a gyro that is turned, by the exact kinematics."""
    which = str(rng.choice(DISPLACED[s.name]))
    names = list(s.states)
    if which == "gyro":
        angle = size * float(rng.uniform(0.04, 0.1)) * rng.choice([-1, 1])
        i = names.index("r")

        def turned(x: Any, f: Any, y: Mapping[str, Any]) -> Mapping[str, Any]:
            own = y["p"] - x[names.index("p")]
            return {**y, "p": np.cos(angle) * x[names.index("p")] + np.sin(angle) * x[i] + own}

        return Twist(displaced=turned), ("p:r",), {"angle": float(angle)}
    rate, arm = ("r" if s.name == "lateral" else "q"), size * ARMS[s.name][which] * float(rng.uniform(0.7, 1.3))
    sensor = {
        "vane": "beta" if s.name == "lateral" else "alpha",
        "accelerometer": "ay" if s.name == "lateral" else "az",
    }
    y_name, i, side = sensor[which], names.index(rate), 1.0 if s.name == "lateral" else -1.0

    def ahead(x: Any, f: Any, y: Mapping[str, Any]) -> Mapping[str, Any]:
        if which == "accelerometer":
            return {**y, y_name: y[y_name] + side * arm * f[i]}
        speed = x[names.index("V")] if s.name == "hfb320" else SPEEDS[s.name]
        flow = np.tan(y[y_name]) + side * arm * x[i] / (speed * np.cos(y[y_name]))
        return {**y, y_name: np.arctan(flow)}

    return Twist(displaced=ahead), (f"{y_name}:{rate}" + "'" * (which == "accelerometer"),), {"arm": arm}


def end_stop(s: System, limit: float, frequency: float, loss: float) -> Twist:
    """A stop of the position beyond the limit: an elastic contact with losses (Hunt and Crossley 1975, exponent 1) that
    only pushes. ``frequency`` is that of a mass on the spring of the contact, rad in a sample interval; ``loss`` the
    part by which the force is greater at the greatest speed inwards."""
    x, v = STOPPED[s.name]
    i, j = list(s.states).index(x), list(s.states).index(v)
    stiffness, loss = (frequency / s.step) ** 2, loss / s.limits[v]
    unit = np.eye(len(s.states))[j]

    def push(z: Any) -> float:
        return -max(stiffness * max(float(z[i]) - limit, 0.0) * (1.0 + loss * float(z[j])), 0.0)

    def feels(x: Any, f: Any, y: Mapping[str, Any]) -> Mapping[str, Any]:
        return {**y, "a": y["a"] + push(x)} if "a" in y else y

    return Twist(force=lambda z, acting, now: push(z) * unit, displaced=feels)
