"""A force that depends on a position: a coil that leaves the gap of its magnet."""

from __future__ import annotations

import numpy as np
from rigs import integrated, named

import phugoid as ph

_TIMES = np.arange(0.0, 120.0, 0.1)


def _record(seed: int, name: str) -> ph.Experiment:
    """A coil whose force per ampere, and voltage per speed, fall with the square of its excursion."""
    rng = np.random.default_rng(seed)
    volts = 3.0 * np.sin(0.9 * _TIMES + seed) + 2.5 * np.sin(0.37 * _TIMES) + 2.0 * np.sin(1.63 * _TIMES)

    def f(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        pull = 0.5 * (1.0 - 0.15 * x[0] ** 2)
        return np.array([x[1], pull * x[2] - 0.8 * x[0] - 0.3 * x[1], u[0] - 2.0 * x[2] - 0.6 * pull * x[1]])

    x = integrated(f, np.zeros(3), _TIMES, volts[:, None])
    outputs = {"x": x[:, 0] + 0.01 * rng.standard_normal(_TIMES.size)}
    outputs["i"] = x[:, 2] + 0.01 * rng.standard_normal(_TIMES.size)
    return ph.Experiment(_TIMES, {"u": volts}, outputs, interpolation="hold", name=name)


def test_a_force_per_ampere_that_falls_with_the_excursion_is_named() -> None:
    m = ph.Model("loudspeaker")
    x, v, i = m.states(x="mm", v="mm/s", i="A")
    (u,) = m.inputs(u="V")
    k, d, b, e, r = m.parameters(k=0.6, d=0.2, b=0.4, e=0.2, r=1.5)
    m.dynamics(x=v, v=b * i - k * x - d * v, i=u - r * i - e * v)
    m.outputs(x=x, i=i)
    d = ph.diagnose(ph.estimate(m, _record(1, "a")), validation=_record(2, "b"))
    found = {f.cause: f for f in named(d)}
    assert "v':x^2*i" in found
    assert {*found} <= {"v':x^2*i", "i':x^2*v"}
    assert abs(found["v':x^2*i"].coefficient + 0.075) < 4.0 * found["v':x^2*i"].std_error
