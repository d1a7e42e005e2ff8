"""What is missing is found where the base model has little to do with the record: cogging, gravity in a position loop,
a hardening spring driven through its resonance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rigs import integrated, named, steps

import phugoid as ph


def diagnosed(m: ph.Model, record: Callable[[int], ph.Experiment], *names: str) -> ph.Diagnosis:
    fit = ph.estimate(m, record(1))
    return ph.diagnose(fit, ph.candidates(m).only(*names), validation=record(2))


def motor() -> ph.Model:
    m = ph.Model("motor")
    (u,) = m.inputs(u="V")
    th, w = m.states(th="rad", w="rad/s")
    c, b = m.parameters(c=5.0, b=30.0)
    m.dynamics(th=w, w=b * u - c * w)
    m.outputs(th=th, w=w)
    return m


def test_cogging_is_found_by_its_number_a_turn_over_many_turns() -> None:
    def record(seed: int) -> ph.Experiment:
        rng, t = np.random.default_rng(seed), 0.001 * np.arange(8000)
        u = steps(rng, t, -0.8, 1.6, 0.4)

        def motion(x: np.ndarray, u: float) -> np.ndarray:
            return np.array([x[1], 40.0 * u - 6.0 * x[1] - 15.0 * np.sin(14.0 * x[0])])

        x = integrated(motion, np.zeros(2), t, u, finer=1)[::8]
        th = np.round(x[:, 0] / 0.0015) * 0.0015
        w = x[:, 1] + 0.08 * rng.normal(size=len(x))
        return ph.Experiment(t[::8], {"u": u[::8]}, {"th": th, "w": w}, interpolation="hold")

    d = diagnosed(motor(), record, "w':periodic_th", "w':sign(w)", "w':w|w|", "u:deadband", "w':bias", "w':th")
    assert [f.cause for f in named(d)] == ["w':periodic_th"], d.summary()
    (found,) = named(d)
    number, error = found.parameters["wave_number_w_dot_th"]
    assert abs(number - 14.0) < 0.02 and error < 0.02
    assert found.explained > 0.95


def test_gravity_in_a_position_loop_is_no_end_stop() -> None:
    m = motor()

    def record(seed: int) -> ph.Experiment:
        rng, fine, every = np.random.default_rng(seed), 0.002, 5
        reference = steps(rng, fine * np.arange(6000), -1.3, 1.3, 1.4)
        x, path, acting = np.zeros(2), [], []
        u = 0.0
        for k, r in enumerate(reference.tolist()):
            if k % every == 0:
                u = float(np.clip(14.0 * (r - x[0]) - 2.2 * x[1], -12.0, 12.0))
                path.append(x)
                acting.append(u)
            half = x + 0.5 * fine * np.array([x[1], 4.5 * u - 0.7 * x[1] - 9.6 * np.sin(x[0])])
            x = x + fine * np.array([half[1], 4.5 * u - 0.7 * half[1] - 9.6 * np.sin(half[0])])
        states = np.array(path)
        th = np.round(states[:, 0] / 0.0008) * 0.0008
        w = states[:, 1] + 0.02 * rng.normal(size=len(states))
        t = fine * every * np.arange(len(states))
        return ph.Experiment(t, {"u": np.array(acting)}, {"th": th, "w": w}, interpolation="hold")

    d = diagnosed(m, record, "w':th", "w':th^3", "th:limit", "w':bias", "w':th|th|", "w':sign(w)", "u:lag")
    assert [f.cause for f in named(d)][:1] == ["w':th"] and "th:limit" not in [f.cause for f in named(d)], d.summary()


def test_a_hardening_spring_is_found_on_the_other_branch_of_its_resonance() -> None:
    m = ph.Model("beam")
    (force,) = m.inputs(F="N/kg")
    x, v = m.states(x="mm", v="mm/s")
    k, c = m.parameters(k=600.0, c=2.0)
    m.dynamics(x=v, v=1000.0 * force - k * x - c * v)
    m.outputs(x=x)

    def record(seed: int) -> ph.Experiment:
        rng, t = np.random.default_rng(seed), 0.001 * np.arange(8000)
        ends = (2.0, 7.0) if seed == 1 else (6.5, 2.5)
        u = 9.0 * np.sin(2.0 * np.pi * (ends[0] * t + 0.5 * (ends[1] - ends[0]) * t**2 / t[-1]))

        def motion(x: np.ndarray, u: float) -> np.ndarray:
            return np.array([x[1], 1000.0 * u - 650.0 * x[0] - 2.2 * x[1] - 2.4 * x[0] ** 3])

        path = integrated(motion, np.zeros(2), t, u, finer=1)
        y = path[::4, 0] + 0.04 * rng.normal(size=2000)
        return ph.Experiment(t[::4], {"F": u[::4]}, {"x": y}, interpolation="cubic")

    d = diagnosed(m, record, "v':x^3", "v':x|x|", "x:x^3", "v':v|v|", "v':bias")
    assert [f.cause for f in named(d)] == ["v':x^3"], d.summary()
    (found,) = named(d)
    assert abs(found.coefficient + 2.4) < 0.05 and found.explained > 0.95
