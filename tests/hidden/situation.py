"""Situations of real records: disturbances, faults of data and effects with a memory, and data with nothing hidden.

The systems are those of the other cases; they are integrated here by Runge and Kutta's rule with many steps between
samples, since what happens depends on the past.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import phugoid as ph

from .case import Unreachable
from .manoeuvre import manoeuvre
from .system import System, Vehicle
from .systems import SYSTEMS

__all__ = ["SITUATIONS", "Situation", "situation"]

STEPS = 8
"""Steps of the integration in a sample interval."""

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

COARSE, SLOWER = 4, 3
"""Of so many samples a coarse record has one, and the slower sensor of a record with two rates."""

NOISES = ("white", "quantised", "growing", "outliers", "autoregressive", "pink", "random walk")


@dataclass(frozen=True)
class Situation:
    """What is given to a diagnosis, and the names that it may say.

    truth  names any of which is right; () where nothing is to be named.
    """

    name: str
    system: str
    what: str
    seed: int
    model: ph.Model
    data: ph.Experiment
    validation: ph.Experiment
    truth: tuple[str, ...]
    sizes: dict[str, float] = field(default_factory=dict)


@dataclass
class _Twist:
    """How a record differs from what its model says; everything is left as it is unless set.

    force    (x, u, time) -> what is added to the derivatives.
    wind     time -> what is added to the states where forces and moments follow from them.
    acts     (u, memory, time) -> inputs as they act; memory is a dictionary of its own.
    drifts   time -> parameters.
    recorded inputs -> inputs as they are recorded.
    sensed   outputs -> outputs as they are recorded, noise included.
    control  (time, measured) -> what is added to the inputs.
    """

    force: Callable[[Any, Any, float], Any] | None = None
    wind: Callable[[float], Any] | None = None
    acts: Callable[[list[float], dict[str, Any], float], list[float]] | None = None
    drifts: Callable[[float], Mapping[str, float]] | None = None
    recorded: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]] | None = None
    sensed: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]] | None = None
    control: Callable[[float, Mapping[str, float]], Mapping[str, float]] | None = None
    held: bool = False
    noise: str = "white"


def _record(
    s: System, vehicle: Vehicle, rng: np.random.Generator, twist: _Twist, name: str
) -> tuple[ph.Experiment, dict[str, np.ndarray]] | None:
    """A record, or None where its motion leaves the limits; and its outputs without noise."""
    number = int(rng.integers(2**32))
    start = {n: x + s.wander[n] * rng.standard_normal() for n, x in vehicle.states.items()}
    seed = int(rng.integers(2**32))
    for size in 0.75 ** np.arange(7):
        inputs = manoeuvre(s, vehicle, np.random.default_rng(number), set(s.inputs), float(size))
        found = _moved(s, vehicle, inputs, start, twist, np.random.default_rng(seed))
        if found is None:
            continue
        path, inputs, clean, noisy = found
        away = max(float(np.abs(path[:, i] - vehicle.states[n]).max() / s.limits[n]) for i, n in enumerate(s.states))
        if away < 1.2:
            recorded = twist.recorded(inputs) if twist.recorded else inputs
            outputs = twist.sensed(noisy) if twist.sensed else noisy
            return ph.Experiment(s.t, recorded, outputs, name=name), clean
    return None


def _moved(
    s: System, vehicle: Vehicle, inputs: Mapping[str, np.ndarray], start: Mapping[str, float], twist: _Twist, rng: Any
) -> Any:
    names, states, t, h = list(s.inputs), list(s.states), s.t, s.step / STEPS
    u = np.column_stack([inputs[n] for n in names])
    z = np.array([start[n] for n in states])
    noise = {n: s.sigma[n] * _noise(twist.noise, t.size, rng) for n in s.outputs}
    path = np.empty((t.size, z.size))
    memory: dict[str, Any] = {}
    clean: dict[str, list[float]] = {n: [] for n in s.outputs}
    noisy: dict[str, list[float]] = {n: [] for n in s.outputs}

    def at(now: float) -> list[float]:
        share = min(max(now / s.step, 0.0), t.size - 1 - 1e-9)
        k = int(share)
        held = u[k] if twist.held else u[k] + (share - k) * (u[min(k + 1, t.size - 1)] - u[k])
        return [float(v) for v in held]

    def rhs(now: float, x: np.ndarray, acting: list[float]) -> np.ndarray:
        p = {**vehicle.parameters, **(twist.drifts(now) if twist.drifts else {})}
        q = s.quantities(x + twist.wind(now) if twist.wind else x, acting, p)
        f = np.array([float(v) for v in s.dynamics(x, acting, q, p)])
        return f + twist.force(x, acting, now) if twist.force else f

    with np.errstate(all="ignore"):
        for k, now in enumerate(t):
            p = {**vehicle.parameters, **(twist.drifts(now) if twist.drifts else {})}
            acting = twist.acts(at(now), memory, now) if twist.acts else at(now)
            y = s.measured(z, acting, s.quantities(z + twist.wind(now) if twist.wind else z, acting, p), p)
            for n in s.outputs:
                clean[n].append(float(y[n]))
                noisy[n].append(float(y[n]) + noise[n][k])
            path[k] = z
            if twist.control and k + 1 < t.size:
                for n, more in twist.control(now, {m: noisy[m][-1] for m in s.outputs}).items():
                    u[k + 1, names.index(n)] += more
            if k + 1 == t.size:
                break
            for j in range(STEPS):
                a, b, c = now + j * h, now + (j + 0.5) * h, now + (j + 1) * h
                ua, ub, uc = (twist.acts(at(w), memory, w) if twist.acts else at(w) for w in (a, b, c - 1e-9))
                k1 = rhs(a, z, ua)
                k2 = rhs(b, z + h / 2 * k1, ub)
                k3 = rhs(b, z + h / 2 * k2, ub)
                k4 = rhs(c, z + h * k3, uc)
                z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            if not np.isfinite(z).all():
                return None
    inputs = {n: u[:, i].copy() for i, n in enumerate(names)}
    return path, inputs, {n: np.array(v) for n, v in clean.items()}, {n: np.array(v) for n, v in noisy.items()}


def _noise(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """(n,) of unit size, as a channel has it."""
    e = rng.standard_normal(n)
    if kind == "outliers":
        return np.where(rng.random(n) < 0.03, 8.0 * e, e)
    if kind == "autoregressive":
        a = rng.uniform(0.6, 0.95)
        return _filtered(e, a) * np.sqrt(1 - a * a)
    if kind == "pink":
        f = np.fft.rfftfreq(n)
        f[0] = f[1]
        x = np.fft.irfft(np.fft.rfft(e) / np.sqrt(f), n)
        return x / x.std()
    if kind == "random walk":
        return e + 0.1 * np.cumsum(rng.standard_normal(n))
    return e


def _filtered(e: np.ndarray, a: float) -> np.ndarray:
    x = np.empty(e.size)
    now = e[0] / np.sqrt(1 - a * a)
    for k, each in enumerate(e):
        now = a * now + each if k else now
        x[k] = now
    return x


def _gust(s: System, rng: np.random.Generator, size: float) -> tuple[_Twist, tuple[str, ...], dict[str, float]]:
    which = str(rng.choice(DRIVEN[s.name]))
    i, tau = list(s.states).index(which), rng.uniform(0.2, 0.8)

    def make(seed: int) -> Callable[..., Any]:
        own = np.random.default_rng(seed)
        a = float(np.exp(-s.step / tau))
        w = _filtered(own.standard_normal(s.samples), a) * np.sqrt(1 - a * a)
        force = np.zeros(len(s.states))

        def of(x: Any, u: Any, now: float) -> Any:
            force[i] = size * np.interp(now, s.t, w)
            return force

        return of

    return _Twist(force=make(int(rng.integers(2**31)))), (f"{which}':noise",), {"gust": size}


def _wind(s: System, rng: np.random.Generator, size: float) -> tuple[_Twist, tuple[str, ...], dict[str, float]]:
    """Turbulence of 0.3 to 1 s that the vehicle feels and the sensors of its motion over ground do not."""
    which, tau = WINDY[s.name], rng.uniform(0.3, 1.0)
    a = float(np.exp(-s.step / tau))
    history = _filtered(rng.standard_normal(s.samples), a) * np.sqrt(1 - a * a)
    unit = size * 0.15 * s.limits[which] * np.eye(len(s.states))[list(s.states).index(which)]
    return _Twist(wind=lambda now: unit * np.interp(now, s.t, history)), (f"{which}':noise",), {"wind": size}


def _twist(what: str, s: System, vehicle: Vehicle, rng: np.random.Generator, size: float) -> Any:
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

        return _Twist(recorded=recorded), (f"{u}:noise",), {}
    if what == "drift":
        p = str(rng.choice(list(s.derivatives)))
        value, sign = vehicle.parameters[p], rng.choice([-1, 1])
        part = 0.4 * size * sign

        def drifts(now: float) -> Mapping[str, float]:
            return {p: value * (1 + part * (now / s.t[-1] - 0.5))}

        return _Twist(drifts=drifts), (f"{p}:drift",), {p: value * part}
    if what == "backlash":
        width = 0.15 * size * peak

        def play(acting: list[float], memory: dict[str, Any], now: float) -> list[float]:
            last = memory.get("z", acting[k])
            memory["z"] = min(max(last, acting[k] - width), acting[k] + width)
            acting[k] = memory["z"]
            return acting

        return _Twist(acts=play), (f"{u}:backlash",), {"width": width}
    if what == "rate limit":
        rate = peak / (1.2 * size * float(np.mean(s.pulse)))

        def limited(acting: list[float], memory: dict[str, Any], now: float) -> list[float]:
            last, then = memory.get("z", acting[k]), memory.get("t", now)
            most = rate * max(now - then, 0.0)
            memory["z"] = last + min(max(acting[k] - last, -most), most)
            memory["t"] = max(now, then)
            acting[k] = memory["z"]
            return acting

        return _Twist(acts=limited), (f"{u}:rate_limit",), {"rate": rate}
    if what == "event":
        which = str(rng.choice(DRIVEN[s.name]))
        i, begin, width = list(s.states).index(which), rng.uniform(0.2, 0.8) * s.t[-1], rng.uniform(1, 3) * s.pulse[0]
        much = size * 0.5 * s.limits[which] / width * rng.choice([-1, 1])
        force = np.zeros(len(s.states))

        def once(x: Any, acting: Any, now: float) -> Any:
            force[i] = much * (begin <= now < begin + width)
            return force

        return _Twist(force=once), (f"{which}':event",), {"time": begin}
    if what == "held input":
        # All inputs are held: what is said of any of them is right.
        return _Twist(held=True), tuple(f"{n}:{what}" for n in s.inputs for what in ("hold", "delay")), {}
    if what == "clipped":
        return _Twist(), (), {}
    if what == "outside":
        which = str(rng.choice(DRIVEN[s.name]))
        i, span = list(s.states).index(which), s.limits[which]
        much = size * 1.5 * span / float(np.mean(s.pulse))
        force = np.zeros(len(s.states))

        def odd(x: Any, acting: Any, now: float) -> Any:
            d = (x[i] - vehicle.states[which]) / span
            force[i] = -much * (np.exp(-((d - 0.3) ** 2) / 0.02) * 0.3)
            return force

        return _Twist(force=odd), (), {}
    if what == "hysteresis":
        x, v, place = POSITIONS[s.name]
        much = size * 0.4 * s.limits[v] / float(np.mean(s.pulse))
        width = rng.uniform(0.05, 0.2) * s.limits[x]
        i, force = list(s.states).index(v), _yielding(s, x, width)
        unit = np.eye(len(s.states))[i]
        truth = (f"{place}:hysteresis_{x}",)
        return _Twist(force=lambda z, acting, now: -much * force(z, now) * unit), truth, {"yield": width}
    if what == "friction":
        _, v, place = POSITIONS[s.name]
        i, span = list(s.states).index(v), 0.005 * s.limits[v]
        dry = 0.2 * size * vehicle.parameters["b"] * peak
        levels = dry, dry * float(rng.uniform(0.4, 0.7))  # one direction, and the other
        unit = np.eye(len(s.states))[i]

        def rubs(z: Any, acting: Any, now: float) -> Any:
            return -levels[int(z[i] < 0.0)] * np.tanh(z[i] / span) * unit

        return _Twist(force=rubs), (f"{place}:sign({v})",), {"friction": 0.5 * sum(levels)}
    if what == "closed loop":
        return _Twist(control=_feedback(s, vehicle)), (), {}
    return _Twist(noise=what if what in NOISES else "white"), (), {}


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


SITUATIONS = (
    "gust", "wind", "noisy input", "drift", "backlash", "rate limit", "event", "held input", "outside", "clipped",
    "hysteresis", "friction", "closed loop", "coarse", "two rates", *NOISES,
)  # fmt: skip


def situation(what: str, system: str, seed: int) -> Situation:
    """A record in a situation, and one for validation.

    Raises Unreachable where no manoeuvre stays within the system's limits.
    """
    if what not in SITUATIONS:
        raise ValueError(f"situation is one of {SITUATIONS}, not {what!r}")
    if what in ("hysteresis", "friction") and system not in POSITIONS:
        raise Unreachable(f"{what}: {system} has no position with a force")
    if what == "wind" and system not in WINDY:
        raise Unreachable(f"{what}: {system} does not fly, or declares no forces")
    s = SYSTEMS[system]
    rng = np.random.default_rng([seed, zlib.crc32(f"{what} {system}".encode())])
    for _ in range(4):
        vehicle = s.vehicle(rng)
        size = float(rng.uniform(0.7, 1.4))
        twist, truth, sizes = _twist(what, s, vehicle, rng, size)
        first = _record(s, vehicle, rng, twist, "data")
        if what == "event":  # it happened once
            twist.force = None
        if what in ("gust", "wind"):
            twist = _again(twist, s, rng)
        other = _record(s, vehicle, rng, twist, "validation")
        if first is None or other is None:
            continue
        data, validation = first[0], other[0]
        if what in ("quantised", "growing", "clipped", "friction", "two rates"):
            data, validation, *of_sensor = _sensed(what, s, (first, other), rng)
            truth, sizes = (of_sensor[0] or truth), (of_sensor[1] or sizes)
        if what == "coarse":
            data, validation = _coarse(data), _coarse(validation)
        return Situation(f"{what} {system} {seed}", system, what, seed, s.model(), data, validation, truth, sizes)
    raise Unreachable(f"{what}, {system}, seed {seed}")


def _coarse(e: ph.Experiment) -> ph.Experiment:
    inputs, outputs = ({n: v[::COARSE] for n, v in group.items()} for group in (e.inputs, e.outputs))
    return ph.Experiment(e.t[::COARSE], inputs, outputs, name=e.name)


def _again(twist: _Twist, s: System, rng: np.random.Generator) -> _Twist:
    """Other air: the same gusts later on."""
    force, wind, away = twist.force, twist.wind, rng.uniform(0.3, 0.7) * s.t[-1]
    if wind is not None:
        return _Twist(wind=lambda now: wind((now + away) % s.t[-1]))
    assert force is not None
    return _Twist(force=lambda x, u, now: force(x, u, (now + away) % s.t[-1]))


def _sensed(what: str, s: System, records: Sequence[Any], rng: np.random.Generator) -> Any:
    """Records through sensors that quantise, clip, are slower than others, or whose noise grows with what they measure;
    names that may be said of these, and sizes."""
    y = str(rng.choice(list(s.outputs)))
    clean = records[0][1][y]
    high = float(np.quantile(clean, 0.97))
    limit = float(clean.max() - 0.25 * np.ptp(clean)) if what == "clipped" else np.inf
    limit = max(min(limit, high), float(np.median(clean)) + 3.0 * s.sigma[y])
    found = []
    for experiment, own in records:
        outputs = {}
        for n in s.outputs:
            z = experiment.output(n)
            if what in ("quantised", "friction"):
                z = np.round(own[n] / (4.0 * s.sigma[n])) * 4.0 * s.sigma[n]
            elif what == "growing":
                z = own[n] + (z - own[n]) * (0.3 + 3.0 * np.abs(own[n] - own[n].mean()) / max(np.ptp(own[n]), 1e-12))
            elif what == "two rates":
                z = np.where((n != y) | (np.arange(z.size) % SLOWER == 0), z, np.nan)
            elif n == y:
                z = np.minimum(z, limit)
            outputs[n] = z
        found.append(ph.Experiment(s.t, experiment.inputs, outputs, name=experiment.name))
    truth = (f"{y}:clipped",) if what == "clipped" else ()
    return *found, truth, {"limit": limit} if truth else {}
