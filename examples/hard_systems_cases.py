"""The four systems of hard_systems.py: equations, true values, and how each record is made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import single_shooting
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import phugoid as ph

Values = Sequence[Any]
"""Symbols of phugoid, or arrays over lanes: the equations are written once for both."""


@dataclass(frozen=True)
class System:
    """Equations, record and starting values of one system.

    ``rhs`` and ``outputs`` take states, inputs and parameters in the order of ``states``, ``inputs`` and ``truth``.
    ``sigma`` is the noise of each output; ``slice`` names the parameter along which the cost is drawn, and its range;
    ``order`` is collocation's; ``substeps`` are single shooting's between samples, unless the system is ``stiff``.
    """

    name: str
    title: str
    why: str
    states: dict[str, str]
    inputs: dict[str, str]
    units: dict[str, str]
    truth: dict[str, float]
    start: dict[str, float]
    rhs: Callable[[Values, Values, Values], list[Any]]
    outputs: Callable[[Values, Values, Values], dict[str, Any]]
    sigma: dict[str, float]
    record: Callable[[System], ph.Experiment]
    slice: tuple[str, float, float]
    order: int = 4
    substeps: int = 1
    stiff: bool = False

    def model(self) -> ph.Model:
        """The system as phugoid takes it."""
        m = ph.Model(self.title)
        x = m.states(**self.states)
        u = m.inputs(**self.inputs) if self.inputs else ()
        p = m.parameters(**{n: ph.Parameter(self.start[n], unit=self.units.get(n, "")) for n in self.truth})
        m.dynamics(**dict(zip(self.states, self.rhs(x, u, p), strict=True)))
        m.outputs(**{n: (y, self.units.get(n, "")) for n, y in self.outputs(x, u, p).items()})
        return m

    @property
    def shown(self) -> str:
        """The output that the figure shows."""
        return next(iter(self.sigma))

    def simulation(self, data: ph.Experiment) -> single_shooting.Simulation:
        """Outputs of single shooting for given unknowns: parameters, then the initial state."""
        u = np.array([data.input(n) for n in self.inputs]).reshape(len(self.inputs), data.n)

        def outputs(unknowns: np.ndarray) -> np.ndarray:
            p, x0 = np.split(unknowns, [len(self.truth)])
            if self.stiff:
                x = single_shooting.lsoda(self.rhs, p, x0, data.t)
            else:
                x = single_shooting.rk4(self.rhs, p, x0, data.t, u, self.substeps)
            return np.array(list(self.outputs(x, u[:, :, None], p).values()))

        return outputs


def noisy(system: System, t: np.ndarray, states: np.ndarray, seed: int) -> ph.Experiment:
    """The record of a system without inputs whose states (n_x, N) are known."""
    rng = np.random.default_rng(seed)
    clean = system.outputs(states, (), list(system.truth.values()))
    outputs = {n: y + system.sigma[n] * rng.standard_normal(t.size) for n, y in clean.items()}
    return ph.Experiment(t, {}, outputs, name=system.name)


def solved(system: System, t: np.ndarray, x0: list[float], method: str = "DOP853") -> np.ndarray:
    """True states (n_x, N) at times ``t``."""
    p = list(system.truth.values())
    tight = {"rtol": 1e-11, "atol": 1e-11, "t_eval": t}
    return np.asarray(solve_ivp(lambda _, x: system.rhs(x, (), p), t[[0, -1]], x0, method, **tight).y)


# ------------------------------------------------------------------------------------------------ unstable


SPEED = 150.0  # m/s


def aircraft_rhs(x: Values, u: Values, p: Values) -> list[Any]:
    """Short period."""
    alpha, q = x
    Za, Zde, Ma, Mq, Mde = p
    return [Za * alpha + q + Zde * u[0], Ma * alpha + Mq * q + Mde * u[0]]


def aircraft_outputs(x: Values, u: Values, p: Values) -> dict[str, Any]:
    Za, Zde, *_ = p
    return {"alpha": x[0], "q": x[1], "az": SPEED * (Za * x[0] + Zde * u[0])}


def aircraft_record(system: System) -> ph.Experiment:
    """A computer keeps the aircraft in the air: it reads the noisy sensors at 50 Hz and moves the elevator.

    The elevator runs linearly from one command to the next, which is how the model has it: the record is exact.
    """
    t, step = np.linspace(0, 12, 601), 0.02
    rng = np.random.default_rng(1)
    p = list(system.truth.values())
    unit = np.eye(3)
    columns = [aircraft_rhs(e[:2], e[2:], p) for e in unit]  # the equations are linear
    generator = np.zeros((4, 4))
    generator[:2, :3], generator[2, 3] = np.transpose(columns), 1 / step
    advance = expm(generator * step)[:2]

    pilot = 0.08 * np.select(
        [(t >= a) & (t < b) for a, b in ((1, 2.5), (2.5, 3.5), (3.5, 4), (4, 4.5))], [1, -1, 1, -1]
    )
    pilot += 0.05 * np.sin(2.0 * t) * (t > 6)
    x, de = np.zeros((2, t.size)), np.zeros(t.size)
    noise = np.array(list(system.sigma.values()))[:, None] * rng.standard_normal((3, t.size))
    for k in range(t.size - 1):
        alpha, q = x[:, k] + noise[:2, k]
        de[k + 1] = pilot[k] + 2.6 * alpha + 0.35 * q
        x[:, k + 1] = advance @ [*x[:, k], de[k], de[k + 1] - de[k]]
    clean = system.outputs(x, de[None], p)
    outputs = {n: y + e for (n, y), e in zip(clean.items(), noise, strict=True)}
    return ph.Experiment(t, {"de": de}, outputs, name=system.name)


# ------------------------------------------------------------------------------------------------ chaotic


def lorenz_rhs(x: Values, u: Values, p: Values) -> list[Any]:
    sigma, rho, beta = p
    return [sigma * (x[1] - x[0]), x[0] * (rho - x[2]) - x[1], x[0] * x[1] - beta * x[2]]


def lorenz_record(system: System) -> ph.Experiment:
    """25 time units are 22 Lyapunov times: errors grow by e^22."""
    t = np.linspace(0, 25, 1251)
    return noisy(system, t, solved(system, t, [-6.0, -8.0, 22.0]), seed=0)


# ------------------------------------------------------------------------------------------------ stiff


RELAXED = [1.9, -0.3]
"""Initial state."""


def relaxation_rhs(x: Values, u: Values, p: Values) -> list[Any]:
    """Van der Pol's oscillator in Liénard's coordinates, with FitzHugh's bias a and leak b."""
    mu, a, b = p
    return [mu * (x[0] - x[0] ** 3 / 3 - x[1]), (x[0] + a - b * x[1]) / mu]


def relaxation_record(system: System) -> ph.Experiment:
    """A recorder at 2 Hz that a jump switches to 100 Hz, from 0.1 s before it to 0.1 s after it."""
    t = np.linspace(0, 300, 30001)
    x = solved(system, t, RELAXED, "Radau")
    jumping = np.abs(x[0]) < 0.8
    kept = np.convolve(jumping, np.ones(21), "same") > 0
    kept[::50] = True
    return noisy(system, t[kept], x[:, kept], seed=0)


# ------------------------------------------------------------------------------------------------ many cycles


def pendulum_rhs(x: Values, u: Values, p: Values) -> list[Any]:
    frequency, _ = p  # of small swings
    return [x[1], -((2 * np.pi * frequency) ** 2) * np.sin(x[0])]


def pendulum_record(system: System) -> ph.Experiment:
    """64 swings, and no damping.

    Were damping unknown as well, single shooting could first damp the swings away and then sometimes find back.
    """
    t = np.linspace(0, 120, 1201)
    return noisy(system, t, solved(system, t, [0.6, 0.0]), seed=0)


SYSTEMS = (
    System(
        name="unstable",
        title="Unstable aircraft",
        why="in 12 s errors grow by $10^{22}$",
        states={"alpha": "rad", "q": "rad/s"},
        inputs={"de": "rad"},
        units={
            "alpha": "rad",
            "q": "rad/s",
            "az": "m/s²",
            "Za": "1/s",
            "Zde": "1/s",
            "Ma": "1/s²",
            "Mq": "1/s",
            "Mde": "1/s²",
        },
        truth={"Za": -1.2, "Zde": -0.12, "Ma": 28.0, "Mq": -1.0, "Mde": -18.0},
        start=dict.fromkeys(("Za", "Zde", "Ma", "Mq", "Mde"), 0.0),
        rhs=aircraft_rhs,
        outputs=aircraft_outputs,
        sigma={"alpha": 0.003, "q": 0.006, "az": 0.4},
        record=aircraft_record,
        slice=("Ma", -2.0, 36.0),
    ),
    System(
        name="chaotic",
        title="Lorenz attractor",
        why="in 22 Lyapunov times errors grow by $10^{10}$",
        states={"x": "", "y": "", "z": ""},
        inputs={},
        units={},
        truth={"sigma": 10.0, "rho": 28.0, "beta": 8 / 3},
        start={"sigma": 5.0, "rho": 20.0, "beta": 1.0},
        rhs=lorenz_rhs,
        outputs=lambda x, u, p: {"x": x[0], "z": x[2]},
        sigma={"x": 1.0, "z": 1.0},
        record=lorenz_record,
        slice=("rho", 18.0, 34.0),
        substeps=2,
    ),
    System(
        name="stiff",
        title="Relaxation oscillator",
        why="stiff: jumps of 0.05 s in a cycle of 170 s",
        states={"x": "V", "y": "V"},
        inputs={},
        units={"x": "V"},
        truth={"mu": 100.0, "a": 0.25, "b": 0.15},
        start={"mu": 50.0, "a": 0.0, "b": 0.0},
        rhs=relaxation_rhs,
        outputs=lambda x, u, p: {"x": x[0]},
        sigma={"x": 0.05},
        record=relaxation_record,
        slice=("mu", 45.0, 125.0),
        order=6,
        stiff=True,
    ),
    System(
        name="oscillating",
        title="Undamped pendulum",
        why="64 swings, frequency 18 % off at first",
        states={"angle": "rad", "rate": "rad/s"},
        inputs={},
        units={"angle": "rad", "f": "Hz", "bias": "rad"},
        truth={"f": 0.55, "bias": 0.05},
        start={"f": 0.65, "bias": 0.0},
        rhs=pendulum_rhs,
        outputs=lambda x, u, p: {"angle": x[0] + p[1]},
        sigma={"angle": 0.1},
        record=pendulum_record,
        slice=("f", 0.45, 0.67),
        substeps=2,
    ),
)
